"""Provenance of the numbers of a table: the coefficients of the energy, and parameters, on which they depend."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.program.added_part import CoefficientMap
from coadjoint.program.term_table import LINEAR, POLYNOMIAL, Terms
from coadjoint.systems.energy_derivatives import EnergyDerivative, Monomial

if TYPE_CHECKING:
    from coadjoint.program.table import Program

Key = tuple[int, ...]
"""A monomial: its coordinates, sorted, each as often as its exponent."""


class Changes(NamedTuple):
    """Numbers of a table that change with the coefficient of a monomial, by (number, factor).

    `coefficients` are numbered as in `CoefficientMap`, `shifts` as the Casimirs that were subtracted.
    """

    coefficients: list[tuple[int, float]]
    shifts: list[tuple[int, float]]


class _Places(NamedTuple):
    """Coefficients of the parts of a program that are functions of coordinates, by the coordinates of monomials.

    `rows` has the row of the angle of a coordinate, `entries` the entry of a row and a column, `monomials` the number
    of a monomial; -1 if there are several.
    """

    rows: dict[int, int]
    entries: dict[tuple[int, int], int]
    monomials: dict[tuple[int, ...], int]

    @classmethod
    def of_program(cls, program: Program) -> _Places:
        parts, terms = program.parts, program.terms
        rows: dict[int, int] = {}
        entries: dict[tuple[int, int], int] = {}
        monomials: dict[tuple[int, ...], int] = {}
        forms, called = parts.forms, set(parts.bodies)
        for k in range(terms.size):
            first, last = int(terms.row[k]), int(terms.row[k + 1])
            if terms.kind[k] == LINEAR and k not in called:
                for row in range(first, last):
                    low, high = forms.start[row], forms.start[row + 1]
                    if high != low + 1 or forms.value[low] != 1.0:
                        continue
                    coordinate = int(forms.coordinate[low])
                    rows[coordinate] = -1 if coordinate in rows else row
                    for entry in range(int(terms.entry[row]), int(terms.entry[row + 1])):
                        entries[row, int(terms.column[entry])] = entry
            elif terms.kind[k] == POLYNOMIAL:
                for monomial in range(int(terms.monomial[k]), int(terms.monomial[k + 1])):
                    factors = slice(int(terms.factor[monomial]), int(terms.factor[monomial + 1]))
                    targets = terms.target[terms.factor_row[factors]].tolist()
                    powers = zip(targets, terms.exponent[factors].tolist(), strict=True)
                    key = tuple(sorted(i for i, e in powers for _ in range(e)))
                    monomials[key] = -1 if key in monomials else monomial
        return cls(rows, entries, monomials)

    def find(self, key: tuple[int, ...], terms: Terms) -> list[tuple[int, float]] | None:
        """Return the coefficients, with factors, that a monomial with the factor one changes; None if it has none."""
        weights = len(terms.offset)
        if (monomial := self.monomials.get(key)) is not None:
            return None if monomial < 0 else [(weights + len(terms.weight) + monomial, 1.0)]
        found: list[tuple[int, float]] = []
        if len(key) == 1:
            row = self.rows.get(key[0], -1)
            return None if row < 0 else [(row, 1.0)]
        if len(key) != 2:
            return None
        for i, j in {key, key[::-1]}:
            entry = self.entries.get((self.rows.get(i, -1), j))
            if entry is None:
                return None
            found.append((weights + entry, 2.0 if i == j else 1.0))
        return found


class Provenance:
    """The numbers of a program that depend on the coefficient of a monomial of the energy."""

    def __init__(self, program: Program) -> None:
        self._program, self._places = program, _Places.of_program(program)
        self._found: dict[Key, Changes | None] = {}

    def changes(self, key: Key) -> Changes | None:
        """Return what changes with the coefficient of a monomial; None if it belongs to no part.

        A square that a shift has removed is replaced by the rest of its Casimir, whose factor then depends on the
        coefficient.
        """
        if key not in self._found:
            self._found[key] = self._changes(key)
        return self._found[key]

    def _changes(self, key: Key) -> Changes | None:
        places, terms = self._places, self._program.terms
        if not key:
            return Changes([], [])
        if (found := places.find(key, terms)) is not None:
            return Changes(found, [])
        for number, (casimir, _) in enumerate(self._program.shift):
            by_key = {tuple(factors_of(exponents)): float(c) for exponents, c in casimir.monomials.items()}
            if not by_key.get(key):
                continue
            changes: list[tuple[int, float]] = []
            for other, c in by_key.items():
                if other != key:
                    rest = places.find(other, terms)
                    if rest is None:
                        break
                    changes += [(index, -c / by_key[key] * by) for index, by in rest]
            else:
                return Changes(changes, [(number, 1.0 / by_key[key])])
        return None


def in_parts(program: Program, G: EnergyDerivative) -> tuple[CoefficientMap, CoefficientMap] | None:
    """Return how the coefficients of the parts, and the factors of the shifts, depend on parameters.

    None if a monomial of G belongs to no part: parts with other forms than coordinates depend on the parameters in
    another way.
    """
    provenance = Provenance(program)
    changed: list[tuple[int, int, float]] = []
    shifts: list[tuple[int, int, float]] = []
    for key, column, size in monomials_of(G):
        if (found := provenance.changes(key)) is None:
            return None
        changed += [(index, column, by * size) for index, by in found.coefficients]
        shifts += [(index, column, by * size) for index, by in found.shifts]
    return CoefficientMap.of_triplets(changed), CoefficientMap.of_triplets(shifts)


def monomials_of(G: EnergyDerivative) -> Iterator[Monomial]:
    """Yield the monomials of a derivative of the energy, with sorted coordinates."""
    for i, column, size in zip(G.linear.tolist(), G.linear_entry.tolist(), G.linear_factor.tolist(), strict=True):
        yield Monomial((i,), column, size)
    pairs = zip(G.quadratic.tolist(), G.quadratic_entry.tolist(), G.quadratic_factor.tolist(), strict=True)
    for pair, column, size in pairs:
        yield Monomial((min(pair), max(pair)), column, size)
    yield from G.others
