"""What every scheme is: an order, declared properties, and its family's coefficients."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, ClassVar

from coadjoint.program.sweeps import Sweep
from coadjoint.systems.kinds import System
from coadjoint.wording import short

LONGEST = 200  # characters of a parameter in a message


@dataclass(frozen=True)
class Properties:
    """What a scheme keeps to round-off on a given system.

    Parameters
    ----------
    poisson : bool
        Whether each step is a Poisson map.
    energy : bool
        Whether the energy is kept.
    casimirs : str
        ``"all"``, ``"polynomial"`` (those that are polynomials), ``"quadratic"`` (of degree at most two) or ``"none"``.
    attitude : str
        ``"every representation"``, ``"coadjoint"`` (and representations that are orthogonal for a fixed form and
        contain the coadjoint one), ``"integrated"`` (as a differential equation, nothing kept) or ``"none"``.
    """

    poisson: bool
    energy: bool
    casimirs: str
    attitude: str


class Method(ABC):
    """A scheme."""

    failures: ClassVar[Mapping[int, str]] = {}
    """What statuses of a step other than the common ones (no convergence, overflow) mean, for messages."""

    def __str__(self) -> str:
        """Return the scheme with the parameters that are not its defaults, and its order or stages."""
        if not is_dataclass(self):
            return repr(self)
        shown = []
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in ("order", "stages") or value != field.default:
                shown.append(f"{field.name}={value if isinstance(value, Method) else short(value, LONGEST)}")
        return f"{type(self).__name__}({', '.join(shown)})"

    @property
    @abstractmethod
    def order(self) -> int:
        """Order of accuracy: the error over a fixed time is O(step^order)."""

    @property
    @abstractmethod
    def explicit(self) -> bool:
        """Whether a step solves no system of equations."""

    @property
    @abstractmethod
    def symmetric(self) -> bool:
        """Whether a step back undoes a step."""

    @abstractmethod
    def properties(self, system: System) -> Properties:
        """Return what the scheme keeps on a system; refuses by name one that it cannot serve.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Returns
        -------
        Properties
            The declaration, which the verification tests hold it to.

        Raises
        ------
        ValueError
            If the scheme cannot serve the system.
        """

    @property
    def innermost(self) -> Method:
        """The scheme of one substep: itself, unless it is a composition of another."""
        return self

    @property
    def fractions(self) -> tuple[float, ...]:
        """Substeps of one step as fractions of it; one unless the scheme is a composition."""
        return (1.0,)


class FlowMethod(Method):
    """A scheme made of exact flows of parts; it becomes a table of rows."""

    @property
    @abstractmethod
    def parts(self) -> Any:
        """How the Hamiltonian is taken apart: "auto", "coordinates", or sets of coordinates."""

    @property
    @abstractmethod
    def compensated(self) -> bool | None:
        """Whether the momentum is summed with compensation; None is no."""

    @property
    @abstractmethod
    def rotation(self) -> str:
        """Rotations by the angle itself ("exact"), or by tan(angle/2) := half the angle ("rational")."""

    @abstractmethod
    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of one step, first to last, with coefficients in the given number type."""

    def processor(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the processor P of a step P K P^-1, whose `sweeps` are the kernel K; none by default."""
        return ()


def has_quadratic_energy(system: System) -> bool:
    """Return whether the Hamiltonian is a polynomial of degree at most two that does not depend on time."""
    from coadjoint.systems.terms import QuadraticTerm

    return all(isinstance(term, QuadraticTerm) for term in system.hamiltonian.terms())
