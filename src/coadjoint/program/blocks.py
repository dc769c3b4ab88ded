"""Kinds of blocks: the closed forms of exp(theta D) on a connected set of coordinates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import Context, Decimal
from enum import IntEnum
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF


class BlockKind(IntEnum):
    """Closed form of exp(theta D) - 1 on a block, as in `RULES`: ROTATE (0, -w; w, 0); PLANE any other 2 x 2 matrix;
    SHEAR D^2 = 0, no coordinate both source and target; CUBIC D^3 = lam D; SERIES a sum, in substeps unless D is
    nilpotent.
    """

    SCALE = 0
    ROTATE = 1
    PLANE = 2
    SHEAR = 3
    CUBIC = 4
    SERIES = 5


class Turn(IntEnum):
    """Closed form of exp(t X) - 1 on a component: NILPOTENT a finite sum; PLANE at most 2 x 2; CUBIC X^3 = lam X; PAIR
    a skew 4 x 4; SKEW another one that preserves a definite form; GENERAL scaling and squaring of the Taylor series.
    """

    NILPOTENT = 0
    PLANE = 1
    CUBIC = 2
    PAIR = 3
    SKEW = 4
    GENERAL = 5


class Rule(NamedTuple):
    """What is stored of a block of one kind, and its flow.

    Stored are `header` constants, of each angle or `per_block`, and `values` for each entry of D. Without entries, the
    header makes the rows of D by `matrix`. With N = D - mean and N^3 = square N, exp(theta D) = e^(theta mean) (1 + s
    theta N + c theta^2 N^2), s = sinh(w)/w and c = (cosh(w) - 1)/w^2 for w^2 = square theta^2 of either sign. N has
    powers up to `degree`. A flow takes `calls` of elementary functions for an angle, and for a block `work`
    multiplications (with additions), or as many for each entry: its degree if that is zero.
    """

    mean: Callable[[NDArray[Any], Any], Any]
    square: Callable[[NDArray[Any], Any], Any]
    degree: int | None
    work: int
    matrix: Callable[..., Any] | None = None
    header: int = 1
    values: int = 0
    per_block: bool = False
    calls: int = 1

    def stored(self, angles: int, repeat: int, width: int, entries: int) -> tuple[int, int]:
        """Return the numbers of indices and of constants of a run of blocks."""
        if self.values:
            return 2 * width + 1 + entries, self.header + self.values * entries
        return angles * repeat * width, self.header * angles * (repeat if self.per_block else 1)

    def multiplications(self, entries: int, degree: int) -> int:
        """Return the multiplications (with additions) of the flow of a block."""
        return entries * (self.work or degree) if self.values else self.work


def _zero(D: NDArray[Any], first: Any) -> Any:
    return abs(0 * D[0, 0])


def _half(D: NDArray[Any]) -> Any:
    return (D[0, 0] - D[1, 1]) / 2


# Number of constants of a CUBIC block before the values of its entries.
CUBIC_HEADER = 6

RULES: Mapping[BlockKind, Rule] = {
    BlockKind.SCALE: Rule(lambda D, _: D[0, 0], _zero, 0, 1, lambda d: [[d]]),
    BlockKind.ROTATE: Rule(_zero, lambda D, _: -(D[1, 0] ** 2), 2, 4, lambda w: [[0 * w, -w], [w, 0 * w]]),
    BlockKind.PLANE: Rule(
        lambda D, _: (D[0, 0] + D[1, 1]) / 2,
        lambda D, _: _half(D) * _half(D) + D[0, 1] * D[1, 0],
        2,
        6,
        lambda mean, half, upper, lower: [[mean + half, upper], [lower, mean - half]],
        header=4,
    ),
    BlockKind.SHEAR: Rule(_zero, _zero, 1, 2, lambda d: [[0 * d, d], [0 * d, 0 * d]], per_block=True, calls=0),
    BlockKind.CUBIC: Rule(_zero, lambda _, lam: lam, 2, 2, header=CUBIC_HEADER, values=3),
    BlockKind.SERIES: Rule(_zero, _zero, None, 0, values=1, calls=0),
}
"""The closed forms in Python; C++ has them once more, by kind, in `flows/blocks.hpp` and `flows/sparse_blocks.hpp`."""

# Degree of the Taylor series in a substep of norm <= 1. The remainder, 1/21! = 2e-20, has one sign and must not
# accumulate over the steps.
TAYLOR_DEGREE = 20
# Above this size one column is tested before whole matrix products are formed.
MAX_SQUARED_SIZE = 64
MOST_SUBSTEPS = 4096
"""Largest number of substeps of norm one in a SERIES block.

Angles depend on the state, so a flow multiplies rounding errors by its length: after five of 2^12 no digit is left.
"""
FEW_SUBSTEPS = 64
"""Number of substeps above which the exponential of a SERIES block is computed as a matrix, by repeated squares."""


class Block(NamedTuple):
    """One block: kind, coordinates in the order of its formula, constants, and entries (row, column, value of D; of
    CUBIC also of D^2 and its rounding error). CUBIC: lam, sqrt(abs(lam)), its inverse and 1/lam with their errors;
    SERIES: the 1-norm.
    """

    kind: BlockKind
    coordinates: tuple[int, ...]
    constants: tuple[Any, ...]
    entries: tuple[tuple[Any, ...], ...] = ()
    degree: int = 0


def larger_block(size: int, local: tuple[tuple[int, int, Any], ...], u: Any) -> Block:
    """Classify a connected matrix of size >= 3 whose pattern has a cycle as CUBIC or SERIES."""
    coordinates = tuple(range(size))
    rows, columns, values = (np.array(column) for column in zip(*local, strict=True))
    wide = wide_series(size, rows, columns, values)
    if wide is not None:
        return wide._replace(entries=local)
    matrix = np.zeros((size, size), dtype=values.dtype)
    matrix[rows, columns] = values
    power, bound = matrix, abs(matrix)
    for depth in range(2, 4):
        power, bound = power @ matrix, bound @ abs(matrix)
        # A product of k matrices has an error of k n roundings of what is added up.
        if _vanishes(power, 8 * size * depth * u * bound):
            return Block(BlockKind.SERIES, coordinates, (0 * local[0][2],), local, depth - 1)
    lam = _cubic_factor(matrix, power)
    if lam != 0 and _vanishes(power - lam * matrix, 8 * size * 3 * u * (bound + abs(lam) * abs(matrix))):
        return _cubic(coordinates, matrix)
    norm = max(np.cumsum(abs(matrix), axis=0)[-1].tolist())
    return Block(BlockKind.SERIES, coordinates, (norm,), local, TAYLOR_DEGREE)


def wide_series(size: int, rows: NDArray[Any], columns: NDArray[Any], values: NDArray[Any]) -> Block | None:
    """Return the SERIES block of a wide matrix, without its entries; None if `larger_block` must classify it."""
    if size <= MAX_SQUARED_SIZE or values.dtype != np.float64 or not _surely_series(size, rows, columns, values):
        return None
    norm = float(np.max(np.bincount(columns, weights=np.abs(values), minlength=size)))
    return Block(BlockKind.SERIES, tuple(range(size)), (norm,), degree=TAYLOR_DEGREE)


def _surely_series(size: int, rows: NDArray[Any], columns: NDArray[Any], values: NDArray[np.float64]) -> bool:
    """Test whether D^2 and D^3 - lam D are nonzero, far beyond rounding, in the column of the largest entry of D."""

    def multiply(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(rows, weights=matrix * vector[columns], minlength=size).astype(np.float64)

    largest = int(np.argmax(np.abs(values)))
    first = np.zeros(size)
    in_column = columns == columns[largest]
    first[rows[in_column]] = values[in_column]
    second, bound = multiply(values, first), multiply(np.abs(values), np.abs(first))
    third, third_bound = multiply(values, second), multiply(np.abs(values), bound)
    lam = third[rows[largest]] / values[largest]
    margin = 32 * size * 3 * UNIT_ROUNDOFF
    cubic = third_bound + third_bound[rows[largest]] + abs(lam) * np.abs(first)
    return (
        bool(np.any(np.abs(second) > margin * bound))
        and bool(np.any(np.abs(third) > margin * third_bound))
        and bool(np.any(np.abs(third - lam * first) > margin * cubic))
    )


def _cubic(coordinates: tuple[int, ...], matrix: NDArray[Any]) -> Block:
    """Build a CUBIC block in twice the precision, since rounded constants would make a rotation stretch."""
    if matrix.dtype == np.float64:
        square, lam = _exact_square(matrix)
    else:
        square = matrix @ matrix
        lam = _cubic_factor(matrix, square @ matrix)
    root = (
        Fraction(_decimal(abs(lam)).sqrt(DECIMAL_CONTEXT))
        if isinstance(lam, Fraction)
        else abs(lam) ** (type(lam)(1) / 2)
    )
    in_floats = matrix.dtype == np.float64
    constants = (
        *((float(number) if in_floats else number) for number in (lam, root)),
        *_with_error(1 / root, in_floats),
        *_with_error(1 / lam, in_floats),
    )
    positions = np.argwhere((matrix != 0) | (square != 0)).tolist()
    entries = tuple((i, j, matrix[i, j], *_with_error(square[i, j], in_floats)) for i, j in positions)
    return Block(BlockKind.CUBIC, coordinates, constants, entries)


def _exact_square(matrix: NDArray[np.float64]) -> tuple[NDArray[Any], Fraction]:
    """Return D^2 in fractions at its nonzero entries, and lam of D^3 = lam D from the largest entry of D."""
    rows = [{j: Fraction(matrix[i, j]) for j in np.flatnonzero(matrix[i]).tolist()} for i in range(len(matrix))]
    square = np.full(matrix.shape, Fraction(0), dtype=object)
    for i, row in enumerate(rows):
        for k, value in row.items():
            for j, other in rows[k].items():
                square[i, j] = square[i, j] + value * other
    i, j = divmod(int(np.argmax(abs(matrix))), len(matrix))
    cube = sum((square[i, k] * row[j] for k, row in enumerate(rows) if j in row), Fraction(0))
    return square, cube / rows[i][j]


DECIMAL_CONTEXT = Context(prec=50)


def _decimal(value: Fraction) -> Decimal:
    return DECIMAL_CONTEXT.divide(Decimal(value.numerator), Decimal(value.denominator))


def _with_error(value: Any, in_floats: bool) -> tuple[Any, Any]:
    """Split a fraction into two floats with its value as their sum; numbers not `in_floats` are followed by zero."""
    if not in_floats:
        return value, 0 * value
    high = float(value)
    return high, float(value - Fraction(high))


def _vanishes(matrix: NDArray[Any], bound: NDArray[Any]) -> bool:
    return bool(np.all(abs(matrix) <= bound))


def _cubic_factor(matrix: NDArray[Any], cube: NDArray[Any]) -> Any:
    """Return the only possible lam of D^3 = lam D: the ratio at the largest entry of D."""
    largest = int(np.argmax(abs(matrix)))
    return cube.flat[largest] / matrix.flat[largest]
