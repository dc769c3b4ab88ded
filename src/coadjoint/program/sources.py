"""Sources of the constants of a table: the coefficients of the energy that they are multiples of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.parts.part import COMPUTED, Parts
from coadjoint.program.term_table import LINEAR, POLYNOMIAL, Terms
from coadjoint.systems.hamiltonians.terms import Term
from coadjoint.systems.system_stacks import counts_of

Floats = NDArray[np.float64]

INDEPENDENT = -2
"""Source of terms of a table that do not belong to the energy."""


class Multiples(NamedTuple):
    """The constants at `position` of an array, which are `factor` times the coefficients `number` of the energy."""

    position: Integers
    number: Integers
    factor: Floats

    def at(self, constants: NDArray[Any], coefficients: Floats) -> NDArray[Any]:
        """Return the array for other coefficients: (count,) for (k,), and (count, columns) for (k, columns)."""
        filled = np.repeat(constants, coefficients[0].size).reshape(len(constants), *coefficients.shape[1:])
        values = coefficients[self.number]
        filled[self.position] = values if np.all(self.factor == 1.0) else (values.T * self.factor).T
        return filled


Sources = Mapping[str, Multiples]
"""The constants of a table by the path of their field; all others do not depend on coefficients of the energy."""


def sources_of(table: Terms, source: Integers, coordinate: NDArray[Any], terms: Sequence[Term]) -> Sources | None:
    """Return the sources of a table whose term k is a copy of source[k] among `terms`.

    `coordinate` has that of each row. None if a term is COMPUTED, or the products of a quadratic term are divided among
    several rows of a coordinate.
    """
    if np.any(source == COMPUTED):
        return None
    starts = np.cumsum([0, *counts_of(terms)]).tolist()
    sizes: Any = np.diff(table.row.astype(np.int64))
    owner = np.repeat(source, sizes)
    offset, weight, coefficient = ([_NONE] for _ in range(3))
    for t, term in enumerate(terms):
        rows = np.flatnonzero((owner == t) & np.repeat(table.kind == LINEAR, sizes))
        own = coordinate[rows].astype(np.int64)
        if np.any(np.bincount(own) > 1):
            return None
        entries, row, column = products_of(table, rows, own)
        if (form := term.form) is not None:
            n = len(form.linear)
            codes, wanted = form.rows * n + form.indices, row * n + column
            found = np.minimum(np.searchsorted(codes, wanted), max(len(codes) - 1, 0))
            if len(wanted) and not np.array_equal(codes[found], wanted):
                return None
            offset.append(Multiples(rows, starts[t] + own, np.ones(len(rows))))
            weight.append(Multiples(entries, starts[t] + n + found, np.ones(len(entries))))
        elif (polynomial := getattr(term, "polynomial", None)) is not None:
            number = {
                tuple((k, e) for k, e in enumerate(exponents) if e): starts[t] + position
                for position, exponents in enumerate(polynomial.monomials)
            }
            offset.append(
                _listed([(r, number.get(((k, 1),)), 1.0) for r, k in zip(rows.tolist(), own.tolist(), strict=True)])
            )
            pairs = zip(entries.tolist(), row.tolist(), column.tolist(), strict=True)
            weight.append(_listed([(e, number.get(_pair(i, j)), 2.0 if i == j else 1.0) for e, i, j in pairs]))
            coefficient.append(_listed([(m, number.get(key), 1.0) for m, key in powers_of(table, source == t)]))
    fields = {"offset": offset, "weight": weight, "coefficient": coefficient}
    return {name: Multiples(*map(np.concatenate, zip(*found, strict=True))) for name, found in fields.items()}


def sources_of_parts(table: Terms, parts: Parts, terms: Sequence[Term]) -> Sources | None:
    """Return the sources of the table of parts of `terms`."""
    if np.any(parts.source == COMPUTED):
        return None
    return sources_of(table, parts.source, parts.forms.coordinate, terms)


def within(path: str, sources: Sources | None) -> Sources | None:
    """Return the sources of a nested table as those of the table that contains it."""
    return None if sources is None else {path + name: found for name, found in sources.items()}


_NONE = Multiples(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))


def _listed(found: Sequence[tuple[int, int | None, float]]) -> Multiples:
    """Return the multiples in a list, without constants that are zero for any coefficients."""
    rows = np.array([one for one in found if one[1] is not None], dtype=np.float64).reshape(-1, 3)
    return Multiples(rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64), rows[:, 2])


def _pair(i: int, j: int) -> tuple[tuple[int, int], ...]:
    return ((i, 2),) if i == j else ((min(i, j), 1), (max(i, j), 1))


def powers_of(table: Terms, chosen: NDArray[np.bool_]) -> list[tuple[int, tuple[tuple[int, int], ...]]]:
    """Return the monomials of some terms of a table, with their exponents by coordinate."""
    found = []
    for k in np.flatnonzero(chosen & (table.kind == POLYNOMIAL)).tolist():
        for monomial in range(int(table.monomial[k]), int(table.monomial[k + 1])):
            factors = slice(int(table.factor[monomial]), int(table.factor[monomial + 1]))
            targets = table.target[table.factor_row[factors]].tolist()
            found.append((monomial, tuple(sorted(zip(targets, table.exponent[factors].tolist(), strict=True)))))
    return found


def products_of(table: Terms, rows: Integers, coordinate: Integers) -> tuple[Integers, Integers, Integers]:
    """Return the weights of rows, with the coordinates of the product in the energy that each is a derivative of."""
    owner, entries = expand(table.entry[rows].astype(np.int64), table.entry[rows + 1].astype(np.int64))
    return entries, coordinate[owner], table.column[entries].astype(np.int64)
