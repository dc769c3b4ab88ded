"""What moves: one system, or a batch of them? Anything else is refused before it fails somewhere else."""

from __future__ import annotations

from typing import Any

from coadjoint.systems.batch import Batch
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.poisson import PoissonSystem
from coadjoint.wording import short

System = LiePoissonSystem | PoissonSystem


def check_system(system: Any) -> None:
    """Refuse what is no system.

    Parameters
    ----------
    system : object
        What was given as one.

    Raises
    ------
    TypeError
        It is neither a `LiePoissonSystem` nor a `PoissonSystem`, nor a `Batch` of them.
    """
    if not isinstance(system, LiePoissonSystem | PoissonSystem | Batch):
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
        It is neither a `LiePoissonSystem` nor a `PoissonSystem`.
    """
    check_system(system)
    if isinstance(system, Batch):
        raise TypeError(f"system is {short(system)}; it must be one system, such as a member of the batch, batch[0]")
