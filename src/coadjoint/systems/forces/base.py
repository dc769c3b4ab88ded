"""What every force is: a flow of its own, what that keeps, and how the kernels read it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

from numpy.typing import NDArray

from coadjoint.wording import short

LONGEST = 80


class Noise(NamedTuple):
    """A noise by its amplitude, its seed and the stream of its first member; and sets of directions that commute."""

    amplitude: float
    seed: int
    stream: int
    sets: tuple[tuple[int, ...], ...]


class ForceReader(Protocol):
    """What takes a force apart: the tables of the kernels."""

    def damping(self, rate: NDArray[Any], toward: NDArray[Any]) -> Any:
        """Take x' = -rate (x - toward); rate is a number, (n,) or (n, n)."""

    def constant(self, torque: NDArray[Any]) -> Any:
        """Take x' = torque, (n,)."""

    def function(self, torque: Callable[..., Any], arguments: str) -> Any:
        """Take x' = torque, a function of "t", "x" or "x, t"."""

    def on_orbit(self, metric: NDArray[Any], root: NDArray[Any], noise: Noise | None) -> Any:
        """Take x' = sign J(x) (P sign J(x) grad H + amplitude L noise); P and L are numbers, (n,) or (n, n)."""

    def flow(self, function: Callable[..., Any]) -> Any:
        """Take a flow, a function of (x, t, tau)."""

    def mode_rates(self, modes: Any, numbers: Any, rates: Any, still: NDArray[Any] | None, layer: int) -> Any:
        """Take c' = -rate c of some modes of a matrix, less those of one at rest; lists over diagonals."""

    def mode_noise(self, modes: Any, numbers: Any, amplitudes: Any, seed: int, stream: int, layer: int) -> Any:
        """Take the same with noise of these amplitudes."""


class Force(ABC):
    """A force, which acts in addition to the Hamiltonian: its flow, and which invariants it changes.

    `LinearDamping`, `Torque`, `DoubleBracketDamping` and `HeatBath` are forces, and `OwnForce` makes one of a function.
    A force of your own kind derives from one of them, or from this class.
    """

    casimirs: ClassVar[bool] = False
    """Whether every Casimir is kept, to round-off."""

    reversible: ClassVar[bool] = True
    """Whether it may run backward."""

    random: ClassVar[bool] = False
    """Whether it is a noise, so that it has no field."""

    @property
    def label(self) -> str:
        """Its name in balances and messages."""
        return type(self).__name__

    def __str__(self) -> str:
        if not is_dataclass(self):
            return self.label
        shown = [f"{field.name}={short(getattr(self, field.name), LONGEST)}" for field in fields(self)]
        return f"{type(self).__name__}({', '.join(shown)})"

    @abstractmethod
    def check(self, system: Any) -> None:
        """Raise an error for a system on which the force cannot act.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            The system.

        Raises
        ------
        ValueError, TypeError
            What does not fit.
        """

    @abstractmethod
    def field(self, system: Any, x: NDArray[Any], t: Any) -> NDArray[Any]:
        """Return what the force adds to x'.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            What it acts on.
        x : (n,) array
            The state.
        t : number
            The time.

        Returns
        -------
        (n,) array

        Raises
        ------
        TypeError
            It is a noise.
        """

    @abstractmethod
    def flow(self, system: Any, x: NDArray[Any], t: Any, tau: Any) -> NDArray[Any]:
        """Return the state that the force alone reaches after a time, computed in Python.

        Parameters
        ----------
        system : LiePoissonSystem or PoissonSystem
            What it acts on.
        x : (n,) array
            The state.
        t, tau : number
            The time at the start, and how long; negative for backward.

        Returns
        -------
        (n,) array
        """

    @abstractmethod
    def given_to(self, reader: ForceReader, system: Any) -> Any:
        """Pass the force to the compiled loops, in one of the forms that they have.

        Parameters
        ----------
        reader : ForceReader
            What reads it.
        system : LiePoissonSystem or PoissonSystem
            What it acts on.
        """

    def parameters(self) -> Mapping[str, Any]:
        """Return the parameters by name; a force that is a dataclass is made again from them."""
        if not is_dataclass(self):
            return {}
        return {field.name: getattr(self, field.name) for field in fields(self)}
