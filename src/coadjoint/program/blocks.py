"""The blocks of a generator: which closed form gives exp(theta D) on each connected set of coordinates."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Context, Decimal
from enum import IntEnum
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


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

Entries = dict[tuple[int, int], Any]


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


def blocks_of(entries: Entries, u: Any) -> list[Block]:
    """Take a sparse matrix D apart into blocks.

    Parameters
    ----------
    entries : dict
        (row, column) -> nonzero value.
    u : number
        Unit round-off of the number type, for the tests that are up to rounding.

    Returns
    -------
    list of Block
        In the order of their first coordinates; a shear is one block for each of its entries.
    """
    found: list[Block] = []
    for coordinates, own in _components(entries):
        found.extend(_classify(coordinates, own, u))
    return found


def _components(entries: Entries) -> Iterable[tuple[list[int], Entries]]:
    owner: dict[int, int] = {}
    members: dict[int, list[int]] = {}
    for i, j in entries:
        for k in (i, j):
            if k not in owner:
                owner[k] = k
                members[k] = [k]
        a, b = owner[i], owner[j]
        if a != b:
            small, large = sorted((a, b), key=lambda k: (len(members[k]), -k))
            for k in members.pop(small):
                owner[k] = large
                members[large].append(k)
    pieces: dict[int, Entries] = {k: {} for k in members}
    for (i, j), value in entries.items():
        pieces[owner[i]][i, j] = value
    for k in sorted(members, key=lambda k: min(members[k])):
        yield sorted(members[k]), pieces[k]


def _classify(coordinates: list[int], own: Entries, u: Any) -> list[Block]:
    size = len(coordinates)
    sources, targets = {j for _, j in own}, {i for i, _ in own}
    if sources.isdisjoint(targets):
        return [Block(Kind.SHEAR, key, (own[key],)) for key in sorted(own)]
    if size == 1:
        return [Block(Kind.SCALE, (coordinates[0],), tuple(own.values()))]
    place = {k: p for p, k in enumerate(coordinates)}
    local = tuple((place[i], place[j], own[i, j]) for i, j in sorted(own))
    depth = _nilpotency(size, local)
    if depth is not None:
        return [Block(Kind.SERIES, tuple(coordinates), (0 * local[0][2],), local, depth - 1)]
    if size == 2:
        return [_two_by_two(coordinates, own)]
    return [_larger(coordinates, local, u)]


def _nilpotency(size: int, local: Iterable[tuple[int, int, Any]]) -> int | None:
    """Return the power at which the pattern vanishes (the longest path, if there is no cycle), else None."""
    reach = np.eye(size, dtype=bool)
    pattern = np.zeros((size, size), dtype=bool)
    for i, j, _ in local:
        pattern[i, j] = True
    for power in range(1, size + 1):
        reach = reach @ pattern
        if not reach.any():
            return power
    return None


def _two_by_two(coordinates: list[int], own: Entries) -> Block:
    i, j = coordinates
    zero = 0 * next(iter(own.values()))
    a, b, c, d = (own.get(key, zero) for key in ((i, i), (i, j), (j, i), (j, j)))
    if a == 0 and d == 0 and b == -c:
        return Block(Kind.ROTATE, (i, j) if c > 0 else (j, i), (abs(c),))
    mean, half = (a + d) / 2, (a - d) / 2
    return Block(Kind.PLANE, (i, j), (mean, half, b, c))


def _larger(coordinates: list[int], local: tuple[tuple[int, int, Any], ...], u: Any) -> Block:
    size = len(coordinates)
    matrix = np.zeros((size, size), dtype=np.array([local[0][2]]).dtype)
    for i, j, value in local:
        matrix[i, j] = value
    power, bound = matrix, abs(matrix)
    for depth in range(2, 4):
        power, bound = power @ matrix, bound @ abs(matrix)
        if _vanishes(power, 8 * size * depth * u * bound):
            return Block(Kind.SERIES, tuple(coordinates), (0 * local[0][2],), local, depth - 1)
    lam = _cubic_factor(matrix, power)
    if lam != 0 and _vanishes(power - lam * matrix, 8 * size * 3 * u * (bound + abs(lam) * abs(matrix))):
        return _cubic(coordinates, matrix)
    norm = max(sum(abs(matrix[:, column])) for column in range(size))
    return Block(Kind.SERIES, tuple(coordinates), (norm,), local, TAYLOR_DEGREE)


def _cubic(coordinates: list[int], matrix: NDArray[Any]) -> Block:
    """Return the block with D^2, 1/sqrt(abs(lam)) and 1/lam to twice the precision: their rounding would turn a
    rotation into one that always stretches, or always shrinks, by a little.
    """
    exact = _lift(matrix) if matrix.dtype == np.float64 else matrix
    square = exact @ exact
    lam = _cubic_factor(exact, square @ exact)
    root = Fraction(_decimal(abs(lam)).sqrt(PRECISE)) if isinstance(lam, Fraction) else abs(lam) ** (type(lam)(1) / 2)
    numbers = (lam, root, 1 / root, 1 / lam)
    constants = (*(_rounded(number) for number in numbers[:2]), *_twice(numbers[2]), *_twice(numbers[3]))
    places = np.argwhere((matrix != 0) | (square != 0)).tolist()
    entries = tuple((i, j, matrix[i, j], *_twice(square[i, j])) for i, j in places)
    return Block(Kind.CUBIC, tuple(coordinates), constants, entries)


PRECISE = Context(prec=50)
_lift = np.vectorize(Fraction, otypes=[object])


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
    largest = max(range(matrix.size), key=lambda k: (abs(matrix.flat[k]), -k))
    return cube.flat[largest] / matrix.flat[largest]
