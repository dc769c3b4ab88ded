"""Limits on BLAS threads for matrix states, so that BLAS and the threads of a run do not compete for cores."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

SINGLE_THREAD_ROWS = 128
"""Up to this number of rows, one BLAS thread is faster than two on a loaded machine, because of synchronization."""


def matrix_rows(system: Any) -> int:
    """Return the number of rows of the matrices of a system; 0 if its states are vectors."""
    shape = system.shape
    return 0 if len(shape) == 1 else int(shape[-1])


def concurrent_members(rows: int) -> int:
    """Return the number of members to advance concurrently: 1 for large matrices, which BLAS distributes."""
    return 1 if rows > SINGLE_THREAD_ROWS else os.cpu_count() or 1


@contextmanager
def limited_blas_threads(rows: int, workers: int) -> Iterator[None]:
    """Limit BLAS to one thread in the context, for small matrices or several `workers`; not for vectors (`rows` 0)."""
    if not rows or (rows > SINGLE_THREAD_ROWS and workers == 1):
        yield
    else:
        with _pools().limit(limits=1):
            yield


@cache
def _pools() -> Any:
    import scipy.linalg.blas  # noqa: F401, loads SciPy's BLAS so that threadpoolctl finds it
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController().select(user_api="blas")
