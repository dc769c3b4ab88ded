"""Constants of the actions of many systems at once, whose forms have other numbers than those of a first system."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import expand
from coadjoint.program.actions import arranged_blocks, arranged_runs
from coadjoint.program.block_table import BlockTable, block_table
from coadjoint.program.blocks import CUBIC_HEADER, Kind
from coadjoint.program.bounded import SLACK, Bounded, distilled, sum_of, two_product
from coadjoint.program.generators import BasisMatrices, Components, Generators, components_of
from coadjoint.program.parts.agreement import Agreement, Undecided
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import order_by, run_starts
from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]

SHARED = (Kind.SCALE, Kind.ROTATE, Kind.PLANE)
"""Kinds of blocks that share constants if these are equal."""
MAX_STACKED = 1024  # members at once
KEPT = 4  # floats of an exact sum, of which the rest is bounded
SHORT = 2.0**-20  # of multiples of this, the squares have fewer than fifty digits
DECIMAL_ROUNDING = 2.0**-160  # of roots in decimals


class JointAction(NamedTuple):
    """The constants of an action by the numbers of forms: of `parts` of a first system, by matrices of the algebra."""

    matrices: BasisMatrices
    parts: Parts

    def of(self, forms: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return constants (count, members) for forms (entries, members), and which members have these blocks.

        The first member has the forms of the parts.
        """
        found, alike = list[Floats](), [np.ones(1, dtype=bool)]
        for first in range(1, max(forms.shape[1], 2), MAX_STACKED):
            # The first member is always there, to compare with.
            own = np.concatenate([forms[:, :1], forms[:, first : first + MAX_STACKED]], axis=1)
            constants, same = self._of(own)
            found.append(constants[:, int(first > 1) :])
            alike.append(same[1:])
        return np.concatenate(found, axis=1), np.concatenate(alike)

    def _of(self, forms: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        agreement = Agreement(forms.shape[1])
        with np.errstate(all="ignore"):  # overflow, after which nothing is certain
            generators, values = self._generators(forms, agreement)
            table = block_table(generators, UNIT_ROUNDOFF)
            constants = _constants(generators, values, table, agreement)
        if constants[:, 0].tobytes() != table.constants.tobytes():
            raise Undecided
        _require_shared(table, constants, agreement)
        groups, selection = arranged_blocks(table, self.parts)
        numbered = table._replace(constants=np.arange(len(table.constants))).take(selection)
        return constants[arranged_runs(self.matrices.size, numbered, groups, self.parts).constants], agreement.alike

    def _generators(self, forms: Floats, agreement: Agreement) -> tuple[Generators, Floats]:
        """Return the generators of the first member, and the values (entries, members) of all, as `combinations`."""
        start, rows, columns, values = self.matrices.entries
        coordinate, owner = self.parts.forms.coordinate, self.parts.forms.owner
        entry, index = expand(start[coordinate], start[coordinate + 1])
        angle, row, column = owner[entry], rows[index], columns[index]
        term = forms[entry] * values[index][:, None]
        order = order_by(angle, row, column)
        angle, row, column, term = angle[order], row[order], column[order], term[order]
        begins = run_starts(angle, row, column)
        first = np.flatnonzero(begins)
        total, bound = term, np.abs(term)
        if len(first) < len(term):
            total, bound = np.zeros((2, len(first), forms.shape[1]))
            np.add.at(total, np.cumsum(begins) - 1, term)
            np.add.at(bound, np.cumsum(begins) - 1, np.abs(term))
        nonzero = agreement.decide(np.abs(total) > 4 * UNIT_ROUNDOFF * bound)
        first, total = first[nonzero], total[nonzero]
        return Generators(angle[first], row[first], column[first], total[:, 0]), total


def _constants(generators: Generators, values: Floats, table: BlockTable, agreement: Agreement) -> Floats:
    """Return the constants of a table of blocks for all members."""
    numbered = generators._replace(value=np.arange(len(generators.value)))
    sets, sheared, depth = components_of(numbered)
    found, block = [values[:0]], 0
    for s in range(len(sets.angle)):
        entries = slice(int(sets.first[s]), int(sets.first[s + 1]))
        own = values[sets.value[entries]]
        if sheared[s]:
            found.append(own)
            block += len(own)
            continue
        kind, width = Kind(int(table.kind[block])), int(sets.width[s])
        if width == 1:
            found.append(own)
        elif width == 2:
            found.append(_plane(kind, sets, entries, own, agreement))
        elif depth[s] >= 0:
            found += [0 * own[:1], own]
        else:
            found.append(_cyclic(kind, width, sets, entries, own, agreement))
        block += 1
    return np.concatenate(found)


def _matrix(width: int, sets: Components, entries: slice, own: Floats) -> Floats:
    matrix = np.zeros((width, width, own.shape[1]))
    matrix[sets.row[entries], sets.column[entries]] = own
    return matrix


def _plane(kind: Kind, sets: Components, entries: slice, own: Floats, agreement: Agreement) -> Floats:
    (a, b), (c, d) = _matrix(2, sets, entries, own)
    turns = agreement.decide((a == 0) & (d == 0) & (b == -c))
    if bool(turns) != (kind == Kind.ROTATE):
        raise Undecided
    if turns:
        agreement.decide(c < 0)
        return np.abs(c)[None]
    return np.stack([(a + d) / 2, (a - d) / 2, b, c])


def _cyclic(kind: Kind, width: int, sets: Components, entries: slice, own: Floats, agreement: Agreement) -> Floats:
    """Return the constants of a matrix with cycles, which `larger_block` classifies."""
    matrix = _matrix(width, sets, entries, own)
    power, bound = matrix, np.abs(matrix)
    for depth in range(2, 4):
        power, bound = _product(power, matrix), _product(bound, np.abs(matrix))
        if _vanishes(power, 8 * width * depth * UNIT_ROUNDOFF * bound, agreement):
            return _series(matrix, own)
    flat = np.abs(matrix).reshape(width**2, -1)
    largest = int(agreement.decide(np.argmax(flat, axis=0)))
    entry, cube = matrix.reshape(width**2, -1)[largest], power.reshape(width**2, -1)[largest]
    lam = cube / entry
    rest, size = power - lam * matrix, bound + np.abs(lam) * np.abs(matrix)
    absolute = bound.reshape(width**2, -1)[largest]
    clear = (np.abs(cube) > 8 * width * 3 * UNIT_ROUNDOFF * absolute) | (absolute == 0.0)
    cubic = bool(agreement.decide(lam != 0.0, clear))
    cubic = cubic and _vanishes(rest, 8 * width * 3 * UNIT_ROUNDOFF * size, agreement)
    if cubic != (kind == Kind.CUBIC):
        raise Undecided
    return _cubic(matrix, largest, agreement) if cubic else _series(matrix, own)


def _product(first: Floats, second: Floats) -> Floats:
    """Return the products of matrices (n, n, members), summed in order."""
    total = first[:, :1] * second[:1]
    for k in range(1, len(second)):
        total = total + first[:, k : k + 1] * second[k : k + 1]
    return total


def _vanishes(matrix: Floats, bound: Floats, agreement: Agreement) -> bool:
    """Return whether matrices are below a bound, whatever the order of their sums."""
    below = np.all(np.abs(matrix) <= 0.5 * bound, axis=(0, 1))
    above = np.any(np.abs(matrix) > 2.0 * bound, axis=(0, 1))
    return bool(agreement.decide(below, below | above))


def _series(matrix: Floats, own: Floats) -> Floats:
    norm = np.max(np.cumsum(np.abs(matrix), axis=0)[-1], axis=0)
    return np.concatenate([norm[None], own])


def _cubic(matrix: Floats, largest: int, agreement: Agreement) -> Floats:
    """Return the constants of a CUBIC block, as `_cubic` in `blocks.py`, from exact sums."""
    size, members = len(matrix), matrix.shape[-1]
    used = np.any(matrix != 0.0, axis=-1)
    products: dict[tuple[int, int], list[Floats]] = {}
    for i, k, j in np.ndindex(size, size, size):
        if used[i, k] and used[k, j]:
            products.setdefault((i, j), []).extend(two_product(matrix[i, k], matrix[k, j]))
    zero = np.zeros(members)
    squares = {at: _with_error(products.get(at, [zero]), agreement) for at in np.ndindex(size, size)}
    positions = [at for at, (high, _) in squares.items() if used[at] or agreement.decide(high != 0.0)]
    highs, lows = zip(*(squares[at] for at in positions), strict=True)
    # lam is the quotient of an entry of D^3 and one of D.
    row, column = divmod(largest, size)
    terms = [
        part
        for k in range(size)
        if used[k, column]
        for factor in products.get((row, k), [])
        for part in two_product(factor, matrix[k, column])
    ]
    entry, cube = matrix[row, column], distilled(terms)
    lam, one = sum_of(terms) / Bounded.of(entry), Bounded.of(np.ones(members))
    root = _root(abs(lam))
    inverse, inverse_root = agreement.rounded(one / lam), agreement.rounded(one / root)
    # The error of the rounded inverses, from the residual that they leave.
    left = _residual(entry, cube, [inverse])
    rest = left + left * left + left * left * left
    error = np.abs(left.high) ** 4 * 2.0
    low = Bounded.of(inverse) * Bounded(rest.high, rest.low, rest.error + error)
    sign = np.where(lam.high < 0, -1.0, 1.0)
    left = _residual(entry, [sign * part for part in cube], [*two_product(inverse_root, inverse_root)])
    rest = left.scaled(0.5) + left * left * Bounded.of(0.375) + left * left * left * Bounded.of(0.3125)
    # Roots of short squares are exact in decimals too.
    short = (left.high == 0.0) & (left.error == 0.0) & (np.rint(root.high / SHORT) * SHORT == root.high)
    error = np.where(short & (root.high < 1.0 / SHORT), 0.0, np.abs(left.high) ** 4 + DECIMAL_ROUNDING)
    low_of_root = Bounded.of(inverse_root) * Bounded(rest.high, rest.low, rest.error + error)
    header = [
        agreement.rounded(lam),
        agreement.rounded(root),
        inverse_root,
        agreement.rounded(low_of_root),
        inverse,
        agreement.rounded(low),
    ]
    assert len(header) == CUBIC_HEADER
    return np.stack([*header, *(matrix[at] for at in positions), *highs, *lows])


def _with_error(terms: list[Floats], agreement: Agreement) -> tuple[Floats, Floats]:
    """Return an exact sum rounded to a float, and the rest rounded to another."""
    *parts, high = distilled(terms)
    zero = np.zeros_like(high)
    *parts, rest, low = distilled([zero, zero, *parts])
    bound = SLACK * sum((np.abs(part) for part in parts), zero)
    for end in (-bound, bound):
        agreement.require((low + (rest + end) == low) & (high + (low + (rest + end)) == high))
    return high + 0.0, low + 0.0


def _root(number: Bounded) -> Bounded:
    """Return the square root, by one step of Newton's method, as if it had been rounded in decimals."""
    first = Bounded.of(np.sqrt(number.high))
    change = (number - first * first) / first.scaled(2.0)
    root = first + change
    return Bounded(root.high, root.low, root.error + change.high**2 / first.high + DECIMAL_ROUNDING * first.high)


def _residual(entry: Floats, cube: list[Floats], factors: list[Floats]) -> Bounded:
    """Return 1 - factor * cube / entry, for sums of floats, `cube` as by `distilled`."""
    products = [-part for factor in factors for one in cube[-KEPT:] for part in two_product(factor, one)]
    total = sum_of([entry, *products])
    dropped = sum((np.abs(part) for part in cube[:-KEPT]), np.zeros_like(entry)) * np.abs(factors[0]) * 2.0
    return Bounded(total.high, total.low, total.error + dropped) / Bounded.of(entry)


def _require_shared(table: BlockTable, constants: Floats, agreement: Agreement) -> None:
    """Keep the members for which the same blocks of an angle have equal constants."""
    chosen = np.flatnonzero(np.isin(table.kind, SHARED))
    for a, b in combinations(chosen.tolist(), 2):
        if table.angle[a] == table.angle[b] and table.kind[a] == table.kind[b]:
            own, other = (constants[table.constant_begin[k] : table.constant_begin[k + 1]] for k in (a, b))
            agreement.decide(np.all(own == other, axis=0))
