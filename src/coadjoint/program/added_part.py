"""Derivatives of a splitting by H: that of H + epsilon G has the added part epsilon G.

Its derivative by epsilon sums the part's coefficients times J(x) grad G(x) at its rows, carried by later tangents.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.polynomials.monomials import exponents_of, factors_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.actions import Action, build_action
from coadjoint.program.generators import BasisMatrices, given_matrices
from coadjoint.program.parts.part import COMPUTED, Parts
from coadjoint.program.sources import Multiples, concatenated, monomials_in, products_of
from coadjoint.program.sparse_rows import SparseRows, joined_starts, starts_of
from coadjoint.program.sweeps import FlowStages, JoinRules, Swept, stages_of
from coadjoint.program.table import FlowTable
from coadjoint.program.term_table import FUNCTION, LINEAR, Terms, TermTable
from coadjoint.systems.coefficients import Key, Monomials, encoded
from coadjoint.systems.energy_derivatives import EnergyDerivative, FunctionDerivative
from coadjoint.systems.lie_poisson import LiePoissonSystem


class AddedPart(NamedTuple):
    """A flow table with a last part that moves nothing: `stages` and `terms` of all parts, its numbers of `shares` and
    `angles`, generators in `state` and `group`, its `coefficients`, and `counts` of constants of both.
    """

    stages: FlowStages
    terms: Terms
    functions: tuple[FunctionDerivative, ...]
    shares: int
    angles: int
    state: Action
    group: Action | None
    coefficients: Multiples
    counts: NDArray[np.int64]

    def split(self, sizes: Mapping[str, int]) -> dict[str, Multiples]:
        """Assign to the coefficients of the part the numbers of those of all terms, by parameters of these sizes."""
        to = starts_of(self.counts.sum(axis=0))[:-1] + self.counts[0]
        return _moved(self.coefficients, starts_of(self.counts[1]), to).split(sizes)

    def renumbered(self, coefficients: Multiples) -> Multiples:
        """Assign to coefficients of the flow table the numbers of those of all terms."""
        own, joined = starts_of(self.counts[0]), starts_of(self.counts.sum(axis=0))
        return _moved(coefficients, own, joined[:-1])


def with_added_part(
    flow_table: FlowTable,
    method: Swept,
    system: LiePoissonSystem,
    group: NDArray[Any] | str | None,
    G: EnergyDerivative,
) -> AddedPart:
    """Return a flow table with the part G of the energy, by parameters."""
    added, coefficients = terms_of(G, system.dim)
    terms = _joined_terms(flow_table.terms, added)
    target = added.target.astype(np.int64)
    parts = Parts(
        SparseRows.units(target),
        np.zeros(len(target)),
        SparseRows.empty(len(target)),
        added.row.astype(np.int64),
        {},
        np.array([0, added.size]),
        np.zeros(1, dtype=bool),
    )

    def extended(action: Action, matrices: BasisMatrices) -> Action:
        return _joined_actions(action, build_action(matrices, parts))

    counts = np.array([[len(one.offset), len(one.weight), len(one.coefficient)] for one in (flow_table.terms, added)])
    of_group = None
    if flow_table.group is not None:
        of_group = extended(flow_table.group, BasisMatrices.on_group(system.algebra, given_matrices(group)))
    return AddedPart(
        stages=_stages(flow_table, method, _position(flow_table, G)),
        terms=terms,
        functions=G.functions,
        shares=added.size,
        angles=len(target),
        state=extended(flow_table.state, BasisMatrices.coadjoint(system.algebra)),
        group=of_group,
        coefficients=coefficients,
        counts=counts,
    )


def _position(flow_table: FlowTable, G: EnergyDerivative) -> int:
    """Return the position of the added part: inside of sweeps, next to the function that G has derivatives of."""
    last = len(flow_table.parts) - 1
    if not G.functions:
        return max(0, min(1, last))
    called = {int(k) for k in np.flatnonzero(flow_table.terms.kind == FUNCTION)}
    of_part = [part for part in range(last + 1) if called & {*range(*flow_table.parts.share[part : part + 2].tolist())}]
    return max(0, min(of_part[0] + 1, last))


def _stages(flow_table: FlowTable, method: Swept, position: int) -> FlowStages:
    count = len(flow_table.parts)
    rules = JoinRules.from_parts(flow_table.parts, flow_table.frequency)
    rules = JoinRules(*(np.insert(column, position, False) for column in rules))
    rows = stages_of(method, rules, flow_table.sign, float)
    part = rows.part.astype(np.int64)
    renumbered = np.where(part == position, count, part - (part > position))
    return rows._replace(part=renumbered.astype(np.uint32))


def terms_of(G: EnergyDerivative, n: int) -> tuple[Terms, Multiples]:
    """Return the terms of all monomials of G, with coefficients of zero, and how these depend on the parameters."""
    table = TermTable()
    # x_i x_j has the derivatives x_j by x_i and x_i by x_j; the rows are those of both.
    i, j = G.quadratic.T
    row, column = np.concatenate([i, j]), np.concatenate([j, i])
    used = np.unique(np.concatenate([G.linear, row]))
    cells, cell = np.unique(row * n + column, return_inverse=True)
    if len(used):
        indptr = np.searchsorted(np.searchsorted(used, cells // n), np.arange(len(used) + 1))
        table.add_linear(used, np.zeros(len(used)), indptr, cells % n, np.zeros(len(cells)))
    others = [one for one in G.others if one.coordinates]
    exponents = [exponents_of(one.coordinates, n) for one in others]
    place: dict[tuple[int, ...], int] = {}
    if others:
        polynomial = Polynomial(dict.fromkeys(exponents, 1.0))
        table.add_polynomial(sorted({k for one in others for k in one.coordinates}), polynomial)
        place = {powers: k for k, powers in enumerate(polynomial.monomials)}
    by_functions = [function.entries for function in G.functions]
    for function in G.functions:
        table.add_by_coefficients(function.coordinates.tolist(), len(function.entries))
    terms = table.table(float)
    weights = len(terms.offset)
    monomials = weights + len(terms.weight)
    of_functions = np.concatenate([np.zeros(0, dtype=np.int64), *by_functions])
    of_others = [
        (monomials + place[powers], one.entry, one.factor) for powers, one in zip(exponents, others, strict=True)
    ]
    pieces = [
        Multiples(np.searchsorted(used, G.linear), G.linear_entry, G.linear_factor),
        Multiples(weights + cell, np.tile(G.quadratic_entry, 2), np.tile(G.quadratic_factor, 2)),
        Multiples.of_triplets(of_others),
        Multiples(monomials + len(place) + np.arange(len(of_functions)), of_functions, np.ones(len(of_functions))),
    ]
    return terms._replace(coefficient=0.0 * terms.coefficient), concatenated(pieces)


def _moved(coefficients: Multiples, starts: NDArray[np.int64], to: NDArray[np.int64]) -> Multiples:
    """Move coefficients of each kind, from `starts` on, to other numbers."""
    kind = np.searchsorted(starts[1:-1], coefficients.position, side="right")
    return coefficients._replace(position=coefficients.position + (to - starts[:-1])[kind])


def _joined_terms(first: Terms, second: Terms) -> Terms:
    joined = _joined_columns(first, second, starts=("row", "entry", "monomial", "factor"))
    joined["factor_row"] = np.concatenate([first.factor_row, second.factor_row + first.row[-1]])
    return Terms(**joined | {"size": first.size + second.size})


def _joined_actions(first: Action, second: Action) -> Action:
    """Append the part of a second action on the same vectors."""
    joined = _joined_columns(first, second, starts=("run",))
    joined["position"] = np.concatenate([first.position, second.position + np.uint32(len(first.indices))])
    joined["constant"] = np.concatenate([first.constant, second.constant + np.uint32(len(first.constants))])
    return Action(**joined | {"size": first.size})


def _joined_columns(first: Any, second: Any, starts: Sequence[str]) -> dict[str, Any]:
    """Return the columns of two tables, one after the other; `starts` are those of lists."""
    columns = {name: pair for name, *pair in zip(first._fields, first, second, strict=True) if np.ndim(pair[0])}
    return {
        name: joined_starts(pair).astype(np.uint32) if name in starts else np.concatenate(pair)
        for name, pair in columns.items()
    }


_AFTER_ALL = np.iinfo(np.int64).max
"""Greater than all codes of monomials."""


class Places:
    """Constants of a flow table to which coefficients of monomials of H are added: offsets, weights, then monomials.

    `copied`: those of shares that are copies of terms of H; others, as of completed squares, contain more.
    """

    def __init__(self, flow_table: FlowTable) -> None:
        terms, forms, copied = flow_table.terms, flow_table.parts.forms, flow_table.parts.source != COMPUTED
        weights, monomials = len(terms.offset), len(terms.offset) + len(terms.weight)
        # Rows of one coordinate: their offset has the coefficient of x_i, and their weights those of x_i x_j. Products
        # are omitted only for the coefficients as they are.
        linear, omitted = terms.kind == LINEAR, flow_table.omitted[:, 0]
        linear[list(flow_table.parts.bodies)] = False
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
        for monomial, key in monomials_in(terms, copied):
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
        of_rows = np.repeat(copied, np.diff(terms.row).astype(np.int64))
        of_weights = np.repeat(of_rows, np.diff(terms.entry).astype(np.int64))
        of_monomials = np.repeat(copied, np.diff(terms.monomial).astype(np.int64))
        self.copied = np.concatenate([of_rows, of_weights, of_monomials])
        self._casimirs = [
            {tuple(factors_of(exponents)): float(c) for exponents, c in casimir.monomials.items() if c}
            for casimir, _ in flow_table.shift
        ]

    def of(self, G: EnergyDerivative) -> tuple[Multiples, Multiples, Integers]:
        """Return how constants, and factors of subtracted Casimirs, depend on G, and its monomials in no part."""
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
