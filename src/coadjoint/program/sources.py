"""How the constants of a flow table depend on H: sparse linear maps, plus rules for completed squares.

Sources are numbered: coefficients of all terms of H and its constant, as in a `SystemStack`, then the coordinates of
each force's constant torque, then the numbers in tables of other forces. Negative ones count the coefficients after
Casimirs were subtracted: -1 is the first.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import prod
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.parts.part import COMPUTED, Parts
from coadjoint.program.parts.squares import ExactSums, ReductionSteps, offsets_of_squares
from coadjoint.program.term_table import LINEAR, POLYNOMIAL, Terms
from coadjoint.systems.coefficients import Key, coordinates_of
from coadjoint.systems.energy_derivatives import EnergyDerivative
from coadjoint.systems.hamiltonians.terms import Term
from coadjoint.systems.system_stacks import counts_of

Floats = NDArray[np.float64]


class Multiples(NamedTuple):
    """Constants at `position` that contain `factor` (None: 1; (members, count) in a batch) times `number`."""

    position: Integers
    number: Integers
    factor: Any

    @classmethod
    def of_triplets(cls, triplets: Sequence[tuple[int, int, float]]) -> Multiples:
        table = np.array(triplets, dtype=object).reshape(-1, 3)
        return cls(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2].astype(np.float64))

    def of(self, values: Floats) -> Floats:
        """Return these constants for the values (m,) of the numbers, or (members, constants) for (members, m)."""
        chosen = values.take(self.number, -1)
        return chosen if self.factor is None else np.asarray(chosen * self.factor)

    def at(self, constants: NDArray[Any], values: Floats) -> NDArray[Any]:
        """Return the array for other values of all numbers: (count,) for (m,), (count, members) for (m, members)."""
        filled = np.repeat(constants, values[0].size).reshape(len(constants), *values.shape[1:])
        filled[self.position] = self.of(values.T).T
        return filled

    def take(self, chosen: NDArray[Any]) -> Multiples:
        return Multiples(*(column[chosen] for column in self))

    def among(self, numbers: Integers, renumbered: Integers) -> Multiples:
        """Return the multiples of some numbers, ascending, with other ones."""
        chosen = self.take(np.isin(self.number, numbers))
        return chosen._replace(number=renumbered[np.searchsorted(numbers, chosen.number)])

    def split(self, sizes: Mapping[str, int]) -> dict[str, Multiples]:
        """Return the multiples of the entries of parameters of these sizes, which are numbered one after the other."""
        found, start = {}, 0
        for name, size in sizes.items():
            chosen = self.take((self.number >= start) & (self.number < start + size))
            found[name] = chosen._replace(number=chosen.number - start)
            start += size
        return found

    def of_energies(self, energies: Sequence[EnergyDerivative]) -> Multiples:
        """Return the multiples of the entries of members, from those of monomials that are `apart`."""
        factors = np.stack([one.coefficients for one in energies])
        return Multiples(self.position, energies[0].entries[self.number], self.factor * factors[:, self.number])

    def of_energy(self, energy: EnergyDerivative) -> Multiples:
        """Return the multiples of the entries of one system, from those of monomials that are `apart`."""
        of_one = self.of_energies([energy])
        return of_one._replace(factor=of_one.factor[0])

    def of_entries(self, by_constant: Floats, entries: int) -> Floats:
        """Return derivatives by the numbers, (..., entries), of derivatives by constants (..., count)."""
        return _sums(self.factor * by_constant[..., self.position], self.number, entries)

    def of_directions(self, directions: Floats, count: int) -> Floats:
        """Return directions of the constants (..., k, count) for directions of the numbers (..., k, entries)."""
        return _sums(self.factor[..., None, :] * directions[..., self.number], self.position, count)


def concatenated(found: Sequence[Multiples]) -> Multiples:
    """Return the multiples of an array together."""
    return Multiples(*map(np.concatenate, zip(NO_MULTIPLES, *found, strict=True)))


NO_MULTIPLES = Multiples(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))


def _sums(numbers: Floats, index: Integers, count: int) -> Floats:
    """Return the sums (..., count) of the numbers (..., k) of each index, in their order."""
    rows = prod(numbers.shape[:-1])
    positions = index + count * np.arange(rows)[:, None]
    sums = np.bincount(positions.ravel(), numbers.ravel(), minlength=count * rows)
    return sums.astype(np.float64).reshape(*numbers.shape[:-1], count)


INDEPENDENT = -2
"""Source of terms of a table that do not belong to the energy."""


class Sums(NamedTuple):
    """Constants that are exact sums of the linear coefficients of H, at the positions of each rule.

    `linear`: their values (n,); the nonzero ones, of `coordinate`, are the sources `number`.
    """

    linear: Floats
    coordinate: Integers
    number: Integers
    rules: Sequence[tuple[Integers, ExactSums | ReductionSteps]]

    def of(self, values: Floats) -> list[list[float]]:
        linear = self.linear.copy()
        linear[self.coordinate] = values[self.number]
        return [rule.at(linear) for _, rule in self.rules]

    def among(self, sources: Integers, numbers: Integers) -> Sums:
        """Return the sums with some of the sources, ascending, with other numbers; the rest are constant."""
        chosen = np.isin(self.number, sources)
        number, coordinate = numbers[np.searchsorted(sources, self.number[chosen])], self.coordinate[chosen]
        rules = [one for one in self.rules if np.any(np.isin(coordinate, one[1].used))]
        return Sums(self.linear, coordinate, number, rules)


class Rules(Protocol):
    """Constants that follow from several sources `number` by the rule of each position."""

    @property
    def number(self) -> Integers:
        """The sources of all rules."""

    @property
    def rules(self) -> Sequence[tuple[Integers, Any]]:
        """The positions of the constants that each rule returns."""

    def of(self, values: Floats) -> Sequence[Any]:
        """Return the constants of each rule for values (m,) of the numbers."""

    def among(self, sources: Integers, numbers: Integers) -> Rules:
        """Return the rules with some of the sources, ascending, with other numbers; the rest are constant."""

    def _replace(self, *, number: Integers) -> Rules: ...


class Sources(NamedTuple):
    """Constants of tables by the paths of their fields; `computed` are the sources of other functions of them."""

    multiples: Mapping[str, Multiples] = {}
    sums: Mapping[str, Rules] = {}
    computed: Mapping[str, Integers] = {}

    def within(self, path: str) -> Sources:
        """Return the sources of a nested table as those of the table that contains it."""
        fields: tuple[Any, ...] = self
        return Sources(*({path + name: value for name, value in of_kind.items()} for of_kind in fields))

    def and_of(self, other: Sources) -> Sources:
        """Return these sources and those of fields with other paths."""
        pairs: Any = zip(self, other, strict=True)
        return Sources(*({**own, **more} for own, more in pairs))

    def renumbered(self, numbers: Integers) -> Sources:
        multiples = {name: one._replace(number=numbers[one.number]) for name, one in self.multiples.items()}
        sums = {name: one._replace(number=numbers[one.number]) for name, one in self.sums.items()}
        return Sources(multiples, sums, {name: numbers[one] for name, one in self.computed.items()})


class CoefficientNumbers(NamedTuple):
    """Numbers of the coefficients of H: the first of each term, and those of degree one, by coordinate."""

    starts: Sequence[int]
    coordinate: Integers
    number: Integers
    value: Floats
    constants: Mapping[int, Integers] = {}  # of the functions among the terms

    @classmethod
    def of(cls, terms: Sequence[Term]) -> CoefficientNumbers:
        starts = np.cumsum([0, *counts_of(terms)]).tolist()
        coordinates, numbers, values = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
        constants = dict[int, Integers]()
        for t, (start, term) in enumerate(zip(starts, terms, strict=False)):
            if (form := term.form) is not None:
                coordinates.append(np.arange(len(form.linear)))
                numbers.append(start + coordinates[-1])
                values.append(form.linear)
            elif (polynomial := getattr(term, "polynomial", None)) is not None:
                linear = [
                    (exponents.index(1), start + position, float(value))
                    for position, (exponents, value) in enumerate(polynomial.monomials.items())
                    if sum(exponents) == 1
                ]
                coordinates.append(np.array([k for k, *_ in linear], dtype=np.int64))
                numbers.append(np.array([number for _, number, _ in linear], dtype=np.int64))
                values.append(np.array([value for *_, value in linear], dtype=np.float64))
            elif starts[t + 1] > start:
                constants[t] = np.arange(start, starts[t + 1])
        return cls(starts, np.concatenate(coordinates), np.concatenate(numbers), np.concatenate(values), constants)

    @property
    def size(self) -> int:
        return self.starts[-1] + 1

    @property
    def others(self) -> Integers:
        return np.setdiff1d(np.arange(self.starts[-1]), np.concatenate([self.number, *self.constants.values()]))

    def of_coordinates(self, chosen: Integers) -> Integers:
        return self.number[np.isin(self.coordinate, chosen)]

    def present(self) -> CoefficientNumbers:
        """Return the numbers without coefficients of degree one that are zero."""
        kept = self.value != 0.0
        return self._replace(coordinate=self.coordinate[kept], number=self.number[kept], value=self.value[kept])


def sources_of(table: Terms, source: Integers, coordinate: NDArray[Any], terms: Sequence[Term]) -> Sources:
    """Return the sources of a table whose term k copies `terms[source[k]]`, if not negative.

    `coordinate` has that of each row; of several rows of one in a term, one has the linear coefficient.
    """
    energy = CoefficientNumbers.of(terms)
    sizes: Any = np.diff(table.row.astype(np.int64))
    owner = np.repeat(np.where(table.kind == LINEAR, source, INDEPENDENT), sizes)
    offset, weight, coefficient = (list[Multiples]() for _ in range(3))
    for t, term in enumerate(terms):
        rows, start = np.flatnonzero(owner == t), energy.starts[t]
        own = coordinate[rows].astype(np.int64)
        entries, row, column = products_of(table, rows, own)
        alone = (np.bincount(own, minlength=1)[own] == 1) | (table.offset[rows] != 0.0)
        rows, own = rows[alone], own[alone]
        if (form := term.form) is not None:
            n = len(form.linear)
            found = np.searchsorted(form.rows * n + form.indices, row * n + column)
            offset.append(Multiples(rows, start + own, np.ones(len(rows))))
            weight.append(Multiples(entries, start + n + found, np.ones(len(entries))))
        elif (polynomial := getattr(term, "polynomial", None)) is not None:
            number = {coordinates_of(exponents): k for k, exponents in enumerate(polynomial.monomials, start)}
            own_rows = zip(rows.tolist(), own.tolist(), strict=True)
            pairs = zip(entries.tolist(), row.tolist(), column.tolist(), strict=True)
            offset.append(_of_monomials(number, ((r, (k,), 1.0) for r, k in own_rows)))
            weight.append(_of_monomials(number, ((e, (min(i, j), max(i, j)), 1.0 + (i == j)) for e, i, j in pairs)))
            coefficient.append(_of_monomials(number, ((m, key, 1.0) for m, key in monomials_in(table, source == t))))
    fields = {"offset": offset, "weight": weight, "coefficient": coefficient}
    functions = energy.constants.values()  # which tables that have rules for them drop
    computed = {"kind": np.concatenate(list(functions))} if functions else {}
    return Sources({name: concatenated(found) for name, found in fields.items()}, computed=computed)


def sources_of_parts(table: Terms, parts: Parts, terms: Sequence[Term]) -> Sources:
    """Return the sources of the table of parts of `terms`."""
    forms = parts.forms
    first = forms.coordinate[forms.start[:-1]].astype(np.int64)
    # The parts beside bodies are those of other terms.
    source = np.full(len(parts.source), COMPUTED) if parts.bodies else parts.source
    found = sources_of(table, source, first, terms)
    computed = source == COMPUTED
    if not np.any(computed):
        return found
    energy = CoefficientNumbers.of(terms).present()
    linear = np.zeros(1 + int(max(forms.coordinate.max(initial=0), energy.coordinate.max(initial=0))))
    np.add.at(linear, energy.coordinate, energy.value)
    plain = ~computed
    plain[parts.nonlinear] = True
    rest = np.repeat(~plain, np.diff(parts.row))
    rules = []
    for angles, rule in offsets_of_squares(parts):
        if table.offset[angles].tolist() == _value(rule, linear):
            rules.append((np.array(angles), rule))
            rest[angles] = False
    # All other angles of completed squares are those of one coordinate.
    number = np.full(len(linear), COMPUTED)
    number[energy.coordinate] = energy.number
    rest &= table.offset != 0.0
    own = rest & (np.diff(forms.start) == 1) & (table.offset == linear[first])
    alone = [Multiples(np.flatnonzero(own), number[first[own]], np.ones(np.count_nonzero(own)))]
    keys: list[Key] = [(k,) for k in energy.coordinate.tolist()]
    linear_terms = dict(zip(keys, energy.number.tolist(), strict=True))
    single = _of_monomials(linear_terms, ((m, key, 1.0) for m, key in monomials_in(table, computed)))
    multiples = {
        **found.multiples,
        "offset": concatenated([found.multiples["offset"], *alone]),
        "coefficient": concatenated([found.multiples["coefficient"], single]),
    }
    of_rest = forms.take(np.flatnonzero(rest & ~own)).coordinate
    bodies = [i for body in parts.bodies.values() for i in (*body.coordinates, *(body.other or ()))]
    others = {
        "offset": energy.of_coordinates(of_rest.astype(np.int64)),
        "weight": np.concatenate([energy.others, energy.of_coordinates(np.array(bodies, dtype=np.int64))]),
        "coefficient": energy.others,
    }
    sums = {"offset": Sums(linear, energy.coordinate, energy.number, rules)}
    return Sources(multiples, sums, {**found.computed, **others})


def _value(rule: ExactSums | ReductionSteps, linear: Floats) -> list[float] | None:
    try:
        return rule.at(linear)
    except OverflowError:
        return None


def _of_monomials(number: Mapping[Key, int], found: Iterable[tuple[int, Key, float]]) -> Multiples:
    """Return the constants at some positions that are factors times the coefficients of monomials, if they have one."""
    return Multiples.of_triplets([(k, number[key], factor) for k, key, factor in found if key in number])


def monomials_in(table: Terms, chosen: NDArray[np.bool_]) -> list[tuple[int, Key]]:
    """Return the monomials of the polynomials among some terms of a table."""
    found = []
    for k in np.flatnonzero(chosen & (table.kind == POLYNOMIAL)).tolist():
        for monomial in range(int(table.monomial[k]), int(table.monomial[k + 1])):
            factors = slice(int(table.factor[monomial]), int(table.factor[monomial + 1]))
            targets = np.repeat(table.target[table.factor_row[factors]], table.exponent[factors])
            found.append((monomial, tuple(sorted(targets.tolist()))))
    return found


def products_of(table: Terms, rows: Integers, coordinate: Integers) -> tuple[Integers, Integers, Integers]:
    """Return the weights of rows, with the coordinates of the product in the energy that each is a derivative of."""
    owner, entries = expand(table.entry[rows].astype(np.int64), table.entry[rows + 1].astype(np.int64))
    return entries, coordinate[owner], table.column[entries].astype(np.int64)
