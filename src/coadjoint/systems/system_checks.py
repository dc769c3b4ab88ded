"""Validation of systems and batches: checks by kind."""

from __future__ import annotations

from typing import Any

from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System


def check_system(system: Any) -> None:
    """Raise TypeError unless given a complete `System`, or a `Batch`."""
    if not isinstance(system, System | Batch):
        raise TypeError(
            f"system is {short(system)}; it must be a LiePoissonSystem or another System, such as "
            "co.systems.rigid_body()"
        )
    if not system.is_batch:
        missing = [field for field in ("name", "sign", "dim", "hamiltonian") if not hasattr(system, field)]
        if missing:
            kind = type(system).__name__
            raise TypeError(f"the system, a {kind}, has no {', no '.join(missing)}; set each in its class")


def check_one_system(system: Any, forces: bool = False) -> None:
    """Raise TypeError for a batch, an object that is not a system, and a system with forces unless they are allowed."""
    check_system(system)
    if system.is_batch:
        raise TypeError(f"system is {short(system)}; it must be one system, such as a member of the batch, batch[0]")
    if system.forces and not forces:
        raise TypeError(
            f"{system.name} has forces, which only runs and steppers support; take its Hamiltonian part, .unforced"
        )


def check_vector_states(system: Any, advice: str = "use IsospectralGauss") -> None:
    """Raise an error unless given a single system with vector states; `advice` ends the message for matrix systems."""
    check_one_system(system)
    if system.has_matrices:
        raise ValueError(f"{system.name} has matrix states, in {system.algebra}; {advice}")
