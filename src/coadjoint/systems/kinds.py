"""What moves: one system, or a batch of them? Anything else is refused before it fails somewhere else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.wording import short

System = LiePoissonSystem | PoissonSystem


@runtime_checkable
class GeneralSystem(Protocol):
    """What runs ask of a system, whatever it is: one of your own may have a matrix for its state, or no table.

    `shape` may say that a state is a matrix; without it, it is a vector of `dim` numbers. An `algebra` need not have
    its structure constants in memory, as `triples`: then schemes whose step is written in Python serve the system, and
    the compiled loops, which read tables, refuse it by name.
    """

    @property
    def dim(self) -> int:
        """Number of coordinates."""

    @property
    def name(self) -> str:
        """For messages."""

    @property
    def sign(self) -> int:
        """Of the right-hand side."""

    @property
    def algebra(self) -> Any:
        """Where the state lives, or None."""

    @property
    def representation(self) -> Any:
        """Matrices for the group element, or None."""

    @property
    def hamiltonian(self) -> Any:
        """The energy, a `HamiltonianLike` of vectors."""

    @property
    def casimirs(self) -> Mapping[str, Any]:
        """Name to what is followed beside the energy."""

    def vector_field(self, x: Any, t: float = 0.0) -> Any:
        """Return x'."""

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return H(x, t)."""


def shape_of(system: Any) -> tuple[int, ...]:
    """Return the shape of a state.

    Examples
    --------
    >>> from coadjoint.systems.rigid_body import rigid_body
    >>> shape_of(rigid_body((1, 2, 3)))
    (3,)
    """
    return tuple(getattr(system, "shape", (system.dim,)))


def unforced(system: Any) -> Any:
    """Return the Hamiltonian part of a system with forces, another system as it is."""
    return system.system if isinstance(system, ForcedSystem) else system


def tabulated(system: Any) -> bool:
    """Return whether the kernels can read the bracket: from structure constants, or from a function J."""
    return system.algebra is None or getattr(system.algebra, "triples", None) is not None


def check_system(system: Any) -> None:
    """Refuse what is no system.

    Parameters
    ----------
    system : object
        What was given as one.

    Raises
    ------
    TypeError
        It is neither a `LiePoissonSystem` nor a `PoissonSystem`, nor a `Batch` of them, and no `GeneralSystem`.
    """
    if not isinstance(system, LiePoissonSystem | PoissonSystem | Batch | ForcedSystem | GeneralSystem):
        raise TypeError(
            f"system is {short(system)}; it must be a LiePoissonSystem or a PoissonSystem, such as "
            "co.systems.rigid_body()"
        )


def check_one_system(system: Any) -> None:
    """Refuse a batch where one system is needed, and what is no system.

    Parameters
    ----------
    system : object
        What was given.

    Raises
    ------
    TypeError
        It is neither a `LiePoissonSystem` nor a `PoissonSystem`, or has forces.
    """
    check_system(system)
    if isinstance(system, ForcedSystem):
        raise TypeError(
            f"{system.name} has forces, for which this is not defined (runs and steppers are); take its "
            "Hamiltonian part, system.system"
        )
    if isinstance(system, Batch):
        raise TypeError(f"system is {short(system)}; it must be one system, such as a member of the batch, batch[0]")


def in_coordinates(system: Any) -> Any:
    """Return a system whose states are vectors: of matrices the same with rows of numbers, of others itself.

    Examples
    --------
    >>> from coadjoint.systems.sphere_euler import sphere_euler
    >>> shape_of(in_coordinates(sphere_euler(N=3)))
    (18,)
    """
    return system.in_numbers if isinstance(system, MatrixSystem) else system


def check_vectors(system: Any, instead: str = "take a scheme for these, IsospectralGauss") -> None:
    """Refuse what is no one system, and a system of matrices where coordinates of a vector are needed.

    Parameters
    ----------
    system : object
        What was given.
    instead : str
        What would be right for matrices.

    Raises
    ------
    TypeError
        As `check_one_system`.
    ValueError
        It moves matrices.
    """
    check_one_system(system)
    if isinstance(system, MatrixSystem):
        raise ValueError(f"{system.name} moves matrices in {system.algebra}; {instead}")
