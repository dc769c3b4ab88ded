"""Kinds of blocks: which closed form gives exp(theta D) on a connected set of coordinates."""

from __future__ import annotations

from decimal import Context, Decimal
from enum import IntEnum
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF


class Kind(IntEnum):
    """How exp(theta D) - 1 acts on a block.

    SCALE: one coordinate, expm1(theta d). ROTATE: (0, -w; w, 0). PLANE: any other 2 x 2, by the entire functions
    sinh(sqrt z)/sqrt z and cosh(sqrt z) - 1, without a discriminant to decide. SHEAR: D^2 = 0 with no coordinate both
    source and target. CUBIC: D^3 = lam D, two terms (Rodrigues' formula in any basis). SERIES: a finite sum where D is
    nilpotent, else the truncated Taylor series in substeps with abs(theta) norm1(D) <= 1.
    """

    SCALE = 0
    ROTATE = 1
    PLANE = 2
    SHEAR = 3
    CUBIC = 4
    SERIES = 5


# Degree of the Taylor series in a substep of norm at most 1: the rest, 1/21! = 2e-20, has one sign and must not add up
# over the steps.
TAYLOR_DEGREE = 20
# Constants of a CUBIC block before the values of its entries.
CUBIC_HEADER = 6
# Larger matrices are not multiplied to tell their kind where one of their columns tells it.
MOST_MULTIPLIED = 64
MOST_SUBSTEPS = 4096
"""Substeps of norm one that a SERIES block takes at most: no step of use needs more."""


class Block(NamedTuple):
    """One block: its kind, coordinates (in the order of its formula), constants, and entries for CUBIC and SERIES.

    An entry is (row, column, value of D), of a CUBIC block followed by the value of D^2 and what its rounding left. The
    constants of a CUBIC block are lam, sqrt(abs(lam)), 1/sqrt(abs(lam)) and 1/lam, the last two each followed by what
    its rounding left; of a SERIES block its norm (zero where it is nilpotent). `degree` is the last power of a series.
    """

    kind: Kind
    coordinates: tuple[int, ...]
    constants: tuple[Any, ...]
    entries: tuple[tuple[Any, ...], ...] = ()
    degree: int = 0


def larger_block(size: int, local: tuple[tuple[int, int, Any], ...], u: Any) -> Block:
    """Return the block of a connected matrix of three or more coordinates, numbered from 0, with a cycle in its
    pattern.

    Parameters
    ----------
    size : int
        Number of coordinates.
    local : tuple of (row, column, value)
        Its entries, sorted.
    u : number
        Unit round-off of the number type.

    Returns
    -------
    Block
        CUBIC, or SERIES.
    """
    coordinates = tuple(range(size))
    rows, columns, values = (np.array(column) for column in zip(*local, strict=True))
    if size > MOST_MULTIPLIED and values.dtype == np.float64 and _surely_series(size, rows, columns, values):
        norm = float(np.max(np.bincount(columns, weights=np.abs(values), minlength=size)))
        return Block(Kind.SERIES, coordinates, (norm,), local, TAYLOR_DEGREE)
    matrix = np.zeros((size, size), dtype=values.dtype)
    matrix[rows, columns] = values
    power, bound = matrix, abs(matrix)
    for depth in range(2, 4):
        power, bound = power @ matrix, bound @ abs(matrix)
        if _vanishes(power, 8 * size * depth * u * bound):
            return Block(Kind.SERIES, coordinates, (0 * local[0][2],), local, depth - 1)
    lam = _cubic_factor(matrix, power)
    if lam != 0 and _vanishes(power - lam * matrix, 8 * size * 3 * u * (bound + abs(lam) * abs(matrix))):
        return _cubic(coordinates, matrix)
    norm = max(np.cumsum(abs(matrix), axis=0)[-1].tolist())
    return Block(Kind.SERIES, coordinates, (norm,), local, TAYLOR_DEGREE)


def _surely_series(size: int, rows: NDArray[Any], columns: NDArray[Any], values: NDArray[np.float64]) -> bool:
    """Return whether one column of D^2 and of D^3 - lam D, that of the largest entry, is nonzero by far more than
    rounding can do. Whole products of large matrices, which would say so too, take size^3 multiplications.
    """

    def times(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(rows, weights=matrix * vector[columns], minlength=size).astype(np.float64)

    largest = int(np.argmax(np.abs(values)))
    first = np.zeros(size)
    own = columns == columns[largest]
    first[rows[own]] = values[own]
    second, bound = times(values, first), times(np.abs(values), np.abs(first))
    third, high = times(values, second), times(np.abs(values), bound)
    lam = third[rows[largest]] / values[largest]
    margin = 32 * size * 3 * UNIT_ROUNDOFF
    cubic = high + high[rows[largest]] + abs(lam) * np.abs(first)
    return (
        bool(np.any(np.abs(second) > margin * bound))
        and bool(np.any(np.abs(third) > margin * high))
        and bool(np.any(np.abs(third - lam * first) > margin * cubic))
    )


def _cubic(coordinates: tuple[int, ...], matrix: NDArray[Any]) -> Block:
    """Return the block with D^2, 1/sqrt(abs(lam)) and 1/lam to twice the precision: their rounding would turn a
    rotation into one that always stretches, or always shrinks, by a little.
    """
    if matrix.dtype == np.float64:
        square, lam = _exact_square(matrix)
    else:
        square = matrix @ matrix
        lam = _cubic_factor(matrix, square @ matrix)
    root = Fraction(_decimal(abs(lam)).sqrt(PRECISE)) if isinstance(lam, Fraction) else abs(lam) ** (type(lam)(1) / 2)
    numbers = (lam, root, 1 / root, 1 / lam)
    constants = (*(_rounded(number) for number in numbers[:2]), *_twice(numbers[2]), *_twice(numbers[3]))
    places = np.argwhere((matrix != 0) | (square != 0)).tolist()
    entries = tuple((i, j, matrix[i, j], *_twice(square[i, j])) for i, j in places)
    return Block(Kind.CUBIC, coordinates, constants, entries)


def _exact_square(matrix: NDArray[np.float64]) -> tuple[NDArray[Any], Fraction]:
    """Return D^2 in fractions, of the nonzero entries of D alone, and lam with D^3 = lam D at the largest entry."""
    rows = [{j: Fraction(matrix[i, j]) for j in np.flatnonzero(matrix[i]).tolist()} for i in range(len(matrix))]
    square = np.full(matrix.shape, Fraction(0), dtype=object)
    for i, row in enumerate(rows):
        for k, value in row.items():
            for j, other in rows[k].items():
                square[i, j] = square[i, j] + value * other
    i, j = divmod(int(np.argmax(abs(matrix))), len(matrix))
    cube = sum((square[i, k] * row[j] for k, row in enumerate(rows) if j in row), Fraction(0))
    return square, cube / rows[i][j]


PRECISE = Context(prec=50)


def _decimal(value: Fraction) -> Decimal:
    return PRECISE.divide(Decimal(value.numerator), Decimal(value.denominator))


def _rounded(value: Any) -> Any:
    return float(value) if isinstance(value, Fraction) else value


def _twice(value: Any) -> tuple[Any, Any]:
    """Return a rational as two floats that add up to it; a number of any other type, and zero."""
    if not isinstance(value, Fraction):
        return value, 0 * value
    high = float(value)
    return high, float(value - Fraction(high))


def _vanishes(matrix: NDArray[Any], bound: NDArray[Any]) -> bool:
    return bool(np.all(abs(matrix) <= bound))


def _cubic_factor(matrix: NDArray[Any], cube: NDArray[Any]) -> Any:
    """Return the only lam that D^3 = lam D can hold with: the ratio at the largest entry of D."""
    largest = int(np.argmax(abs(matrix)))
    return cube.flat[largest] / matrix.flat[largest]
