"""How many threads BLAS takes while matrices move, so that it and the threads of a run do not wait for each other."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from coadjoint.systems.kinds import shape_of

ALONE = 128
"""Up to so many rows one thread takes a product in less time than two need to find each other on a busy machine."""


def rows_of(system: Any) -> int:
    """Return how many rows the matrices of a system have; 0 where its states are vectors.

    Parameters
    ----------
    system : System
        The system.

    Returns
    -------
    int
    """
    shape = shape_of(system)
    return 0 if len(shape) == 1 else int(shape[-1])


def members_at_once(rows: int) -> int:
    """Return how many members of a crowd are best taken at a time, each by a thread of its own.

    Parameters
    ----------
    rows : int
        Of the matrices that move, or 0: for the products of large ones BLAS takes threads itself.

    Returns
    -------
    int
        The number of cores; or 1 for large matrices.
    """
    return 1 if rows > ALONE else os.cpu_count() or 1


@contextmanager
def threads_of_blas(rows: int, workers: int) -> Iterator[None]:
    """Hold BLAS to one thread inside, where matrices are small or several members move at a time.

    Parameters
    ----------
    rows : int
        Of the matrices that move; nothing happens where there are none.
    workers : int
        How many threads take members.
    """
    if not rows or (rows > ALONE and workers == 1):
        yield
    else:
        with _pools().limit(limits=1):
            yield


@cache
def _pools() -> Any:
    import scipy.linalg.blas  # noqa: F401, so that its BLAS is there to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
