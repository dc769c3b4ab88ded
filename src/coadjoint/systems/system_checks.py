"""Validation of systems and batches: checks by kind."""

from __future__ import annotations

from typing import Any

from coadjoint.short_repr import short
from coadjoint.systems.batch import Batch
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.systems.protocol import GeneralSystem, is_matrix_system

System = LiePoissonSystem | PoissonSystem


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


def check_vector_states(system: Any, advice: str = "use IsospectralGauss") -> None:
    """Raise an error unless given a single system with vector states; `advice` ends the message for matrix systems."""
    check_one_system(system)
    if is_matrix_system(system):
        raise ValueError(f"{system.name} has matrix states, in {system.algebra}; {advice}")
