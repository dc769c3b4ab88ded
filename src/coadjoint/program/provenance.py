"""Provenance of the numbers of a table: the coefficients of the energy, and parameters, on which they depend."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.program.added_part import CoefficientMap
from coadjoint.program.parts.part import COMPUTED
from coadjoint.program.sources import powers_of, products_of
from coadjoint.program.term_table import LINEAR
from coadjoint.systems.coefficients import Key, encoded
from coadjoint.systems.energy_derivatives import EnergyDerivative, Monomial

if TYPE_CHECKING:
    from coadjoint.program.table import Program


class Changes(NamedTuple):
    """Numbers of a table that change with the coefficient of a monomial, by (number, factor).

    `coefficients` are numbered as in `CoefficientMap`, `shifts` as the Casimirs that were subtracted.
    """

    coefficients: list[tuple[int, float]]
    shifts: list[tuple[int, float]]


def with_factors(numbers: Sequence[int]) -> list[tuple[int, float]]:
    """Return the coefficients that a monomial changes, of those that `of_pairs` returns, with their factors."""
    return [(number, 2.0 if -2 in numbers else 1.0) for number in numbers if number >= 0]


class Provenance:
    """The coefficients of the parts of a program by the monomials of the energy, after Casimirs were subtracted.

    The angle of a coordinate is a row of one share: its offset is the coefficient of x_i, and its weights are those of
    x_i x_j. `rows` has the row of each coordinate, -1 if there is none or several; `entries` are those of `codes`,
    row * n + column, which are sorted. `numbers` has those of monomials, -1 if there are several. Rows whose products
    are omitted are not listed: they cancel only for the coefficients as they are. `copied` are the coefficients of
    shares that are copies of terms of the energy; others, as of completed squares, contain more.
    """

    def __init__(self, program: Program) -> None:
        self._program = program
        self._n, terms, forms = program.state.size, program.terms, program.parts.forms
        self._weights, self._monomials = len(terms.offset), len(terms.offset) + len(terms.weight)
        linear = terms.kind == LINEAR
        linear[list(program.parts.bodies)] = False
        rows = np.flatnonzero(np.repeat(linear, np.diff(terms.row).astype(np.int64)))
        rows = rows[np.diff(forms.start)[rows] == 1]
        omitted = program.omitted[:, 0]
        rows = rows[(forms.value[forms.start[rows]] == 1.0) & ~np.isin(rows, omitted)]
        coordinate = forms.coordinate[forms.start[rows]].astype(np.int64)
        self._rows = np.full(self._n, -1, dtype=np.int64)
        self._rows[coordinate] = rows
        self._rows[np.bincount(coordinate, minlength=self._n) > 1] = -1
        entries, row, column = products_of(terms, rows, rows)
        codes = row * self._n + column
        order = np.argsort(codes)
        self._codes, self._entries = codes[order], entries[order]
        self._numbers: dict[Key, int] = {}
        factors = np.flatnonzero(np.isin(terms.factor_row, omitted))
        without = {*(np.searchsorted(terms.factor, factors, side="right") - 1).tolist()}
        for monomial, powers in powers_of(terms, np.ones(terms.size, dtype=bool)):
            key = tuple(i for i, e in powers for _ in range(e))
            self._numbers[key] = -1 if key in self._numbers or monomial in without else monomial
        low = [(-1, *key)[-2:] for key in self._numbers if len(key) in (1, 2)]
        self._low = encoded(*np.array(low, dtype=np.int64).reshape(-1, 2).T)
        copied = program.parts.source != COMPUTED
        of_rows = np.repeat(copied, np.diff(terms.row).astype(np.int64))
        of_weights = np.repeat(of_rows, np.diff(terms.entry).astype(np.int64))
        of_monomials = np.repeat(copied, np.diff(terms.monomial).astype(np.int64))
        self._copied = np.concatenate([of_rows, of_weights, of_monomials])
        self._found: dict[Key, Changes | None] = {}
        # Casimirs that were subtracted, by their monomials.
        self._casimirs: dict[Key, list[tuple[int, dict[Key, float]]]] = {}
        for number, (casimir, _) in enumerate(program.shift):
            by_key = {tuple(factors_of(exponents)): float(c) for exponents, c in casimir.monomials.items()}
            for key in by_key:
                if by_key[key]:
                    self._casimirs.setdefault(key, []).append((number, by_key))

    def of_coordinates(self, i: Integers) -> Integers:
        """Return the coefficients that monomials x_i change; -1 where this takes a search by `find`."""
        return np.where(np.isin(encoded(np.full(len(i), -1), i), self._low), -1, self._rows[i])

    def of_pairs(self, i: Integers, j: Integers) -> Integers:
        """Return the coefficients (k, 2) that monomials x_i x_j, i <= j, change; -1 where this takes a search.

        The second one is -2 for squares.
        """
        found = np.stack([self._of_entries(i, j), self._of_entries(j, i)], axis=1)
        found[np.any(found < 0, axis=1) | np.isin(encoded(i, j), self._low)] = -1
        found[(i == j) & (found[:, 1] >= 0), 1] = -2
        return found

    def _of_entries(self, i: Integers, j: Integers) -> Integers:
        row = self._rows[i]
        codes = row * self._n + j
        if not len(self._codes):
            return np.full(len(codes), -1)
        at = np.minimum(np.searchsorted(self._codes, codes), len(self._codes) - 1)
        return np.where((row >= 0) & (self._codes[at] == codes), self._weights + self._entries[at], -1)

    def find(self, key: Key) -> list[tuple[int, float]] | None:
        """Return the coefficients, with factors, that a monomial with the factor one changes; None if it has none."""
        if (monomial := self._numbers.get(key)) is not None:
            return None if monomial < 0 else [(self._monomials + monomial, 1.0)]
        if len(key) == 1:
            found = self.of_coordinates(np.array(key)).tolist()
        elif len(key) == 2:
            found = self.of_pairs(*np.array([key]).T)[0].tolist()
        else:
            return None
        return None if found[0] < 0 else with_factors(found)

    def changes(self, key: Key) -> Changes | None:
        """Return what changes with the coefficient of a monomial; None if it belongs to no part.

        A square that a shift has removed is replaced by the rest of its Casimir, whose factor then depends on the
        coefficient.
        """
        if key not in self._found:
            self._found[key] = self._changes(key)
        return self._found[key]

    def changes_of(self, keys: Sequence[Key]) -> list[Changes | None]:
        """Return what changes with the coefficients of many monomials."""
        pairs = [(-1, -1, *key)[-2:] if len(key) <= 2 else (-1, -1) for key in keys]
        i, j = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
        linear, quadratic = (i < 0) & (j >= 0), i >= 0
        numbers = np.full((len(keys), 2), -1, dtype=np.int64)
        numbers[linear, 0] = self.of_coordinates(j[linear])
        numbers[quadratic] = self.of_pairs(i[quadratic], j[quadratic])
        return [
            self.changes(key) if found[0] < 0 else Changes(with_factors(found), [])
            for key, found in zip(keys, numbers.tolist(), strict=True)
        ]

    def multiples_of(self, keys: Sequence[Key]) -> list[Changes | None]:
        """Return the coefficients that are multiples of those of monomials, after Casimirs were subtracted.

        Of a monomial that a shift has removed, the factor of the shift. None for monomials on which other coefficients
        depend, as those of completed squares.
        """
        of_bodies = _weights_of_bodies(self._program)
        found = []
        for key, change in zip(keys, self.changes_of(keys), strict=True):
            if change is None and key in of_bodies:
                change = Changes(of_bodies[key], [])
            elif change is not None and not all(self._copied[number] for number, _ in change.coefficients):
                change = None
            found.append(change)
        return found

    def _changes(self, key: Key) -> Changes | None:
        if not key:
            return Changes([], [])
        if (found := self.find(key)) is not None:
            return Changes(found, [])
        for number, by_key in self._casimirs.get(key, ()):
            changes: list[tuple[int, float]] = []
            for other, c in by_key.items():
                if other != key:
                    rest = self.find(other)
                    if rest is None:
                        break
                    changes += [(index, -c / by_key[key] * by) for index, by in rest]
            else:
                return Changes(changes, [(number, 1.0 / by_key[key])])
        return None


def _weights_of_bodies(program: Program) -> dict[Key, list[tuple[int, float]]]:
    """Return the weights of free bodies, which are entries of M, by their monomials, with their factors."""
    found: dict[Key, list[tuple[int, float]]] = {}
    terms, forms = program.terms, program.parts.forms
    for share, body in program.parts.bodies.items():
        if body.other is None:
            rows = np.arange(*terms.row[share : share + 2].tolist())
            entries, i, j = products_of(terms, rows, forms.coordinate[forms.start[rows]].astype(np.int64))
            for entry, pair in zip(entries.tolist(), np.sort([i, j], axis=0).T.tolist(), strict=True):
                number = len(terms.offset) + entry
                found.setdefault(tuple(pair), []).append((number, 2.0 if pair[0] == pair[1] else 1.0))
    return found


def in_parts(program: Program, G: EnergyDerivative) -> tuple[CoefficientMap, CoefficientMap] | None:
    """Return how the coefficients of the parts, and the factors of the shifts, depend on parameters.

    None if a monomial of G belongs to no part: parts with other forms than coordinates depend on the parameters in
    another way.
    """
    provenance = Provenance(program)
    i, j = np.sort(G.quadratic, axis=1).T
    linear, quadratic = provenance.of_coordinates(G.linear), provenance.of_pairs(i, j)
    searched = np.concatenate([linear, quadratic[:, 0]]) < 0
    changed: list[tuple[int, int, float]] = []
    shifts: list[tuple[int, int, float]] = []
    after: list[int] = []
    at = [*np.flatnonzero(searched).tolist(), *range(len(searched), len(searched) + len(G.others))]
    for position, (key, column, size) in zip(at, monomials_of(G, searched), strict=True):
        if (found := provenance.changes(key)) is None:
            return None
        changed += [(index, column, by * size) for index, by in found.coefficients]
        shifts += [(index, column, by * size) for index, by in found.shifts]
        after += [position] * len(found.coefficients)
    numbers = np.concatenate([np.stack([linear, np.full(len(linear), -1)], axis=1), quadratic])
    entries = np.concatenate([G.linear_entry, G.quadratic_entry])
    factors = np.concatenate([G.linear_factor, np.where(i == j, 2.0, 1.0) * G.quadratic_factor])
    monomial, _ = np.nonzero(numbers >= 0)
    # Sums keep the order of the monomials.
    order = np.argsort(np.concatenate([monomial, np.array(after, dtype=np.int64)]), kind="stable")
    columns = zip(
        (numbers[numbers >= 0], entries[monomial], factors[monomial]), CoefficientMap.of_triplets(changed), strict=True
    )
    return CoefficientMap(*(np.concatenate(pair)[order] for pair in columns)), CoefficientMap.of_triplets(shifts)


def monomials_of(G: EnergyDerivative, chosen: NDArray[np.bool_] | None = None) -> Iterator[Monomial]:
    """Yield the monomials of a derivative of the energy, with sorted coordinates.

    `chosen`: those of the first and then of the second degree that are yielded, by default all.
    """
    every = np.ones(len(G.linear) + len(G.quadratic), dtype=bool) if chosen is None else chosen
    linear, quadratic = every[: len(G.linear)], every[len(G.linear) :]
    of_linear = (column[linear].tolist() for column in (G.linear, G.linear_entry, G.linear_factor))
    for i, column, size in zip(*of_linear, strict=True):
        yield Monomial((i,), column, size)
    pairs = (column[quadratic].tolist() for column in (G.quadratic, G.quadratic_entry, G.quadratic_factor))
    for pair, column, size in zip(*pairs, strict=True):
        yield Monomial((min(pair), max(pair)), column, size)
    yield from G.others
