"""Energies of many systems after multiples of Casimirs were subtracted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.program.shifts.shift import ROUNDING, QuadraticCasimir, Rule
from coadjoint.systems.hamiltonians.terms import Term
from coadjoint.systems.system_stacks import SystemStack, counts_of

Masks = NDArray[np.bool_]


class ShiftedEnergies:
    """Coefficients of energies after multiples of Casimirs, `factors` (members,) by name, were subtracted.

    They are those of `shifted_terms`, bit for bit. `present` (cells, members) are the entries of M that remain.
    """

    def __init__(
        self, stack: SystemStack, casimirs: dict[str, QuadraticCasimir], factors: dict[str, NDArray[Any]]
    ) -> None:
        self._stack = stack
        self._factors = np.array(list(factors.values()), dtype=np.float64).reshape(-1, stack.size)
        number = shifted_term(stack.terms) if factors else None
        if number is None:
            self.present: Masks = np.zeros((0, stack.size), dtype=bool)
            self._totals = None
            return
        counts, form = counts_of(stack.terms), stack.terms[number].form
        assert form is not None
        n, begin = len(form.linear), sum(counts[:number])
        self._first, self._last = begin + n, begin + n + len(form.values)
        own = form.rows * n + form.indices
        codes = {name: casimirs[name].rows * n + casimirs[name].columns for name in factors}
        cells = np.unique(np.concatenate([own, *codes.values()]))
        total = np.zeros((len(cells), stack.size))
        total[np.searchsorted(cells, own)] = stack.coefficients[self._first : self._last]
        size = np.abs(total)
        for name, factor in factors.items():
            at, subtracted = np.searchsorted(cells, codes[name]), -factor * casimirs[name].values[:, None]
            total[at] += subtracted
            size[at] += np.abs(subtracted)
        self.present, self._totals = np.abs(total) > ROUNDING * size, total

    def chosen(self, members: Integers) -> SystemStack:
        """Return members with equal `present`."""
        chosen = self._stack.take(members)._replace(factors=self._factors[:, members])
        if self._totals is None:
            return chosen
        entries = self._totals[np.ix_(np.flatnonzero(self.present[:, members[0]]), members)]
        before, after = chosen.coefficients[: self._first], chosen.coefficients[self._last :]
        return chosen._replace(split=np.concatenate([before, entries, after]))


def shifted_term(terms: Sequence[Term]) -> int | None:
    """Return the number of the term from which Casimirs are subtracted."""
    return next((k for k, term in enumerate(terms) if term.form is not None and term.piece is None), None)


def factors_of(stack: SystemStack, rule: Rule, number: int | None) -> dict[str, NDArray[Any]]:
    """Return the factor of each Casimir of a rule, (members,); `number` is that of the term with the squares."""
    assert number is not None
    form = stack.terms[number].form
    assert form is not None
    begin = sum(counts_of(stack.terms)[:number]) + len(form.linear)
    diagonal = {int(i): begin + k for k, i in enumerate(form.indices) if form.rows[k] == i}
    zeros = np.zeros(stack.size)
    return {name: (stack.coefficients[diagonal[i]] if i in diagonal else zeros) / entry for name, i, entry in rule}
