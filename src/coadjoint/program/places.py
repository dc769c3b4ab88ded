"""Places of the coefficients of the energy in a table, by their monomials: for parameters, and for other tables."""

from __future__ import annotations

import numpy as np

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.program.multiples import Multiples, concatenated
from coadjoint.program.parts.part import COMPUTED
from coadjoint.program.sources import monomials_in, products_of
from coadjoint.program.table import Program
from coadjoint.program.term_table import LINEAR
from coadjoint.systems.coefficients import Key, Monomials, encoded
from coadjoint.systems.energy_derivatives import EnergyDerivative

_AFTER_ALL = np.iinfo(np.int64).max
"""Greater than all codes of monomials."""


class Places:
    """The constants of the parts of a program to which the coefficients of monomials of the energy are added. Positions
    count all offsets, then all weights, then all coefficients of monomials. `copied` has those of shares that are
    copies of terms of the energy; others, as of completed squares, contain more.
    """

    def __init__(self, program: Program) -> None:
        terms, forms = program.terms, program.parts.forms
        weights, monomials = len(terms.offset), len(terms.offset) + len(terms.weight)
        # Rows of one coordinate: their offset has the coefficient of x_i, and their weights those of x_i x_j. Products
        # are omitted only for the coefficients as they are.
        linear, omitted = terms.kind == LINEAR, program.omitted[:, 0]
        linear[list(program.parts.bodies)] = False
        rows = np.flatnonzero(np.repeat(linear, np.diff(terms.row).astype(np.int64)))
        rows = rows[np.diff(forms.start)[rows] == 1]
        rows = rows[(forms.value[forms.start[rows]] == 1.0) & ~np.isin(rows, omitted)]
        coordinate = forms.coordinate[forms.start[rows]].astype(np.int64)
        alone = np.bincount(coordinate, minlength=1)[coordinate] == 1
        rows, coordinate = rows[alone], coordinate[alone]
        entries, i, j = products_of(terms, rows, coordinate)
        upper, lower = i <= j, i >= j
        pairs, *at = np.intersect1d(
            encoded(i[upper], j[upper]), encoded(j[lower], i[lower]), assume_unique=True, return_indices=True
        )
        first, second = entries[upper][at[0]], entries[lower][at[1]]
        square, ones = first == second, np.ones(len(rows))
        codes = np.concatenate([encoded(-ones, coordinate), pairs])
        first = np.concatenate([rows, weights + first])
        second = np.concatenate([-ones, np.where(square, -1, weights + second)])
        factor = np.concatenate([ones, np.where(square, 2.0, 1.0)])
        # Monomials of polynomials, which come before rows; those that occur several times have no place.
        of_omitted = np.flatnonzero(np.isin(terms.factor_row, omitted))
        without = {*(np.searchsorted(terms.factor, of_omitted, side="right") - 1).tolist()}
        self._others: dict[Key, int] = {}
        for monomial, key in monomials_in(terms, np.ones(terms.size, dtype=bool)):
            self._others[key] = -1 if key in self._others or monomial in without else monomials + monomial
        low = [key for key in self._others if len(key) in (1, 2)]
        kept = ~np.isin(codes, _codes(low))
        codes = np.concatenate([codes[kept], _codes(low), [_AFTER_ALL]])
        first = np.concatenate([first[kept], [self._others[key] for key in low], [-1]])
        rest = np.full(len(low) + 1, -1)
        order = np.argsort(codes)
        self._code = codes[order]
        self._position = np.stack([first, np.concatenate([second[kept], rest])], axis=1).astype(np.int64)[order]
        self._factor = np.concatenate([factor[kept], np.abs(rest)])[order]
        copied = program.parts.source != COMPUTED
        of_rows = np.repeat(copied, np.diff(terms.row).astype(np.int64))
        of_weights = np.repeat(of_rows, np.diff(terms.entry).astype(np.int64))
        of_monomials = np.repeat(copied, np.diff(terms.monomial).astype(np.int64))
        self.copied = np.concatenate([of_rows, of_weights, of_monomials])
        self._casimirs = [
            {tuple(factors_of(exponents)): float(c) for exponents, c in casimir.monomials.items() if c}
            for casimir, _ in program.shift
        ]

    def of(self, G: EnergyDerivative) -> tuple[Multiples, Multiples, Integers]:
        """Return how the constants, and the factors of the subtracted Casimirs, depend on the entries of G.

        The last array has the entries of monomials that are in no part. Functions are left out.
        """
        i, j = np.sort(G.quadratic, axis=1).T
        codes = np.concatenate([encoded(np.full(len(G.linear), -1), G.linear), encoded(i, j)])
        at = self._rows_of(codes)
        monomial, column = np.nonzero(self._position[at] >= 0)
        found = [Multiples(self._position[at[monomial], column], monomial, self._factor[at[monomial]])]
        shifts: list[tuple[int, int, float]] = []
        missing: list[int] = []
        searched = np.flatnonzero(self._position[at, 0] < 0)
        keys = Monomials(codes[searched], tuple(one.coordinates for one in G.others)).keys
        for k, key in zip([*searched.tolist(), *range(len(codes), len(codes) + len(G.others))], keys, strict=True):
            if (places := self._find(key) if k >= len(codes) else None) is None:
                places, shift = self._removed(key)
                missing += [] if shift else [k]
                shifts += [(number, k, factor) for number, factor in shift]
            found.append(Multiples.of_triplets([(position, k, factor) for position, factor in places]))
        # Sums keep the order of the monomials.
        every = concatenated(found)
        every = every.take(np.argsort(every.number, kind="stable"))
        entries, factors = G.entries, G.coefficients

        def of_entries(one: Multiples) -> Multiples:
            return Multiples(one.position, entries[one.number], one.factor * factors[one.number])

        return of_entries(every), of_entries(Multiples.of_triplets(shifts)), entries[missing]

    def _rows_of(self, codes: Integers) -> Integers:
        """Return the rows of monomials in the arrays, the last one of those that are not in them."""
        at = np.searchsorted(self._code, codes)
        return np.where(self._code[at] == codes, at, len(self._code) - 1)

    def _find(self, key: Key) -> list[tuple[int, float]] | None:
        """Return the places of the coefficient of a monomial, with factors; None if there are none."""
        if not key:
            return []
        if len(key) > 2:
            position = self._others.get(key, -1)
            return None if position < 0 else [(position, 1.0)]
        (at,) = self._rows_of(_codes([key])).tolist()
        factor = float(self._factor[at])
        return [(one, factor) for one in self._position[at].tolist() if one >= 0] or None

    def _removed(self, key: Key) -> tuple[list[tuple[int, float]], list[tuple[int, float]]]:
        """Return the places of the rest of a Casimir that has replaced a monomial, and its number, with factors."""
        for number, casimir in enumerate(self._casimirs):
            if key in casimir:
                rest = {other: self._find(other) for other in casimir if other != key}
                if None not in rest.values():
                    c = casimir[key]
                    places = [(at, -casimir[k] / c * by) for k, found in rest.items() for at, by in found or ()]
                    return places, [(number, 1.0 / c)]
        return [], []


def _codes(keys: list[Key]) -> Integers:
    """Return the codes of monomials of the first and second degree."""
    first, second = np.array([(-1, *key)[-2:] for key in keys], dtype=np.int64).reshape(-1, 2).T
    return encoded(first, second)
