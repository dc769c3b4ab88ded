"""Small dense linear systems: LU factors with partial pivoting, in an order that no library or machine decides."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.kernels.arithmetic import fma
from coadjoint.kernels.compiling import inlined


@inlined
def factorize(matrix: Any, size: int, pivots: Any) -> bool:
    """Overwrite a (size * size) matrix by its LU factors, rows exchanged as noted in `pivots`.

    Returns False if it is singular or not finite.
    """
    for k in range(size):
        pivot = k
        largest = abs(matrix[k * size + k])
        for i in range(k + 1, size):
            if abs(matrix[i * size + k]) > largest:
                largest = abs(matrix[i * size + k])
                pivot = i
        pivots[k] = pivot
        if not (largest > 0.0 and largest - largest == 0.0):
            return False
        if pivot != k:
            for j in range(size):
                matrix[k * size + j], matrix[pivot * size + j] = matrix[pivot * size + j], matrix[k * size + j]
        for i in range(k + 1, size):
            factor = matrix[i * size + k] / matrix[k * size + k]
            matrix[i * size + k] = factor
            for j in range(k + 1, size):
                matrix[i * size + j] = fma(-factor, matrix[k * size + j], matrix[i * size + j])
    return True


@inlined
def substitute(matrix: Any, size: int, pivots: Any, right: Any, lanes: int) -> None:
    """Overwrite `lanes` right-hand sides, side by side in rows, by the solutions."""
    for k in range(size):
        pivot = np.int64(pivots[k])
        if pivot != k:
            for lane in range(lanes):
                right[k * lanes + lane], right[pivot * lanes + lane] = (
                    right[pivot * lanes + lane],
                    right[k * lanes + lane],
                )
    for i in range(size):
        for k in range(i):
            factor = -matrix[i * size + k]
            for lane in range(lanes):
                right[i * lanes + lane] = fma(factor, right[k * lanes + lane], right[i * lanes + lane])
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            factor = -matrix[i * size + k]
            for lane in range(lanes):
                right[i * lanes + lane] = fma(factor, right[k * lanes + lane], right[i * lanes + lane])
        for lane in range(lanes):
            right[i * lanes + lane] /= matrix[i * size + i]
