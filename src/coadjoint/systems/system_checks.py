"""Validation of systems and batches: protocol, checks by kind, conversion to vector states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.poisson import PoissonSystem

System = LiePoissonSystem | PoissonSystem


@runtime_checkable
class GeneralSystem(Protocol):
    """The minimal interface that runs require of a system, also a user-defined one.

    `shape` is the shape of a matrix state; without it the state is a vector of `dim` numbers. Compiled loops need an
    `algebra` with its structure constants as `triples`; without them only schemes stepped in Python are available.
    """

    @property
    def dim(self) -> int:
        """Number of coordinates."""

    @property
    def name(self) -> str:
        """Name in messages."""

    @property
    def sign(self) -> int:
        """Sign of the right-hand side."""

    @property
    def algebra(self) -> Any:
        """Lie algebra on whose dual the state lies, or None."""

    @property
    def representation(self) -> Any:
        """Matrices for the group element, or None."""

    @property
    def hamiltonian(self) -> Any:
        """The energy, a `HamiltonianLike` of vectors."""

    @property
    def casimirs(self) -> Mapping[str, Any]:
        """Invariants recorded besides the energy, by name."""

    def vector_field(self, x: Any, t: float = 0.0) -> Any:
        """Return the vector field x'."""

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return H(x, t)."""


def shape_of(system: Any) -> tuple[int, ...]:
    """Return the shape of a state."""
    return tuple(getattr(system, "shape", (system.dim,)))


def unforced(system: Any) -> Any:
    """Return the Hamiltonian part of a system with forces; any other system unchanged."""
    return system.system if isinstance(system, ForcedSystem) else system


def has_compiled_bracket(system: Any) -> bool:
    """Return whether the kernels can evaluate the bracket, from structure constants or a function J."""
    return system.algebra is None or getattr(system.algebra, "triples", None) is not None


def check_system(system: Any) -> None:
    """Raise TypeError unless given a `LiePoissonSystem`, a `PoissonSystem`, a `Batch` of them or a `GeneralSystem`."""
    if not isinstance(system, LiePoissonSystem | PoissonSystem | Batch | ForcedSystem | GeneralSystem):
        raise TypeError(
            f"system is {short(system)}; it must be a LiePoissonSystem or a PoissonSystem, such as "
            "co.systems.rigid_body()"
        )


def check_one_system(system: Any) -> None:
    """Raise TypeError for a batch, a system with forces, or an object that is not a system."""
    check_system(system)
    if isinstance(system, ForcedSystem):
        raise TypeError(
            f"{system.name} has forces, which only runs and steppers support; take its Hamiltonian part, system.system"
        )
    if isinstance(system, Batch):
        raise TypeError(f"system is {short(system)}; it must be one system, such as a member of the batch, batch[0]")


def as_vector_system(system: Any) -> Any:
    """Return a system whose states are vectors: for matrices the one on rows of numbers, otherwise the system itself.

    Examples
    --------
    >>> from coadjoint.systems.fluids.sphere_euler import sphere_euler
    >>> shape_of(as_vector_system(sphere_euler(N=3)))
    (18,)
    """
    return system.in_numbers if isinstance(system, MatrixSystem) else system


def check_vector_states(system: Any, advice: str = "use IsospectralGauss") -> None:
    """Raise an error unless given a single system with vector states; `advice` ends the message for matrix systems."""
    check_one_system(system)
    if isinstance(system, MatrixSystem):
        raise ValueError(f"{system.name} has matrix states, in {system.algebra}; {advice}")
