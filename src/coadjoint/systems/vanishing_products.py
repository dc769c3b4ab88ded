"""Products of J(x) grad H that cancel identically, such as those of r cross dV/dr for a central force."""
# They are left out of flows and vector fields: their sums are zero, but not their rounding errors.

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import exact_number
from coadjoint.algebra.exact.sparse_sums import connected, expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.separated_function import (
    RecordedFunction,
    recorded_for_constants,
    recorded_function,
)
from coadjoint.systems.hamiltonians.terms import BuiltIn, FunctionTerm, PolynomialTerm, QuadraticTerm, Term, built_in
from coadjoint.systems.hamiltonians.traced_function import TracingError
from coadjoint.systems.user_functions import of_constants

Integers = NDArray[np.int64]

MAX_MONOMIALS = 1 << 14
"""Monomials of the products of a system above which none is left out."""
CERTAIN = 2.0**-40
"""Size of a sum, relative to its absolute terms, above which it is certainly not zero."""
MAX_BRACKETS = 1 << 20
"""Brackets of an algebra above which they are not searched for commuting coordinates."""


class Product(NamedTuple):
    """The product ``constant * x[state] * u[column]`` of J(x) u, added to the component `row`."""

    row: int
    state: int
    column: int
    constant: Any


class Products(NamedTuple):
    """Products of J(x) u by columns."""

    row: Integers
    state: Integers
    column: Integers
    constant: NDArray[Any]

    def at(self, q: int) -> Product:
        """Return a product."""
        return Product(int(self.row[q]), int(self.state[q]), int(self.column[q]), self.constant[q])


# A monomial of a component of a gradient: (factor, coordinates, coefficient), whose product it is. The factor is a
# function that occurs in several components, such as the derivative of a function of a polynomial.
GradientTerm = tuple[Any, tuple[int, ...], Any]


def commuting_products(algebra: LieAlgebra) -> Products:
    """Return the products of J(x) u of coordinates that commute: those that can cancel in the flow of a part."""
    if len(algebra.triples.c if algebra._copied is None else algebra._copied[0].triples.c) > MAX_BRACKETS:
        return _products(algebra, np.zeros(0, dtype=bool))
    if algebra._copied is not None and not len(_of_commuting(algebra._copied[0]).row):
        return _products(algebra, np.zeros(0, dtype=bool))
    return _of_commuting(algebra)


@lru_cache(maxsize=64)
def _of_commuting(algebra: LieAlgebra) -> Products:
    i, j, k, _ = algebra.triples
    n = algebra.dim
    brackets = np.unique(np.concatenate([i * n + j, j * n + i]))
    chosen = np.concatenate([~np.isin(j * n + k, brackets), ~np.isin(i * n + k, brackets)])
    return _products(algebra, chosen)


def _products(algebra: LieAlgebra, chosen: NDArray[np.bool_]) -> Products:
    if not chosen.any():
        empty = np.zeros(0, dtype=np.int64)
        return Products(empty, empty, empty, np.zeros(0))
    i, j, k, c = algebra.triples
    columns = np.concatenate([i, j]), np.concatenate([k, k]), np.concatenate([j, i]), np.concatenate([c, -c])
    return Products(*(column[chosen] for column in columns))


def cancelling(products: Sequence[tuple[int, int, Iterable[GradientTerm], Any]]) -> list[int]:
    """Return for each product the number of the set that cancels identically in x, -1 if it does not cancel."""
    # Each product is (row, state, monomials of its component of the gradient, constant). Products of a row that share a
    # monomial are linked, and cancel together if all of their monomials do.
    first: dict[Any, int] = {}
    links: list[tuple[int, int]] = []
    total: dict[Any, Any] = {}
    for q, (row, state, monomials, constant) in enumerate(products):
        exact = Fraction(exact_number(constant))
        for factor, coordinates, coefficient in monomials:
            key = row, factor, tuple(sorted((*coordinates, state)))
            total[key] = total.get(key, 0) + exact * Fraction(exact_number(coefficient))
            links.append((q, first.setdefault(key, q)))
    label = connected(len(products), *np.array(links, dtype=np.int64).reshape(-1, 2).T).tolist()
    remaining, sizes = {label[first[key]] for key, value in total.items() if value}, Counter(label)
    return [number if sizes[number] > 1 and number not in remaining else -1 for number in label]


def derivatives_of(polynomial: Polynomial, coordinates: Sequence[int]) -> dict[int, list[GradientTerm]]:
    """Return the monomials of the gradient of a polynomial in coordinates of a system."""
    found: dict[int, list[GradientTerm]] = {}
    for exponents, coefficient in polynomial.monomials.items():
        factors, exact = factors_of(exponents) if any(exponents) else [], Fraction(exact_number(coefficient))
        for k in dict.fromkeys(factors):
            rest = list(factors)
            rest.remove(k)
            found.setdefault(k, []).append((None, tuple(coordinates[a] for a in rest), exact * exponents[k]))
    return found


def _own_products(term: FunctionTerm, products: Mapping[int, Product]) -> tuple[dict[int, int], dict[int, Product]]:
    """Return the places of the coordinates of a function, and the products of these."""
    index = {int(k): a for a, k in enumerate(term.coordinates)}
    return index, {q: each for q, each in products.items() if each.state in index and each.column in index}


def cancel_as_recorded(term: FunctionTerm, products: Mapping[int, Product], constants: NDArray[Any]) -> Any:
    """Return for which constants (k, members) of a function certainly the same products cancel as for most others."""
    index, own = _own_products(term, products)
    given: Any = of_constants(term.value)
    recorded = recorded_for_constants(given.key, len(index), given.pattern)
    none = np.zeros(constants.shape[1], dtype=bool)
    if recorded is None or recorded.constants is None or _divided(term, recorded, index, own)[1] == (frozenset(),):
        return ~none
    with np.errstate(all="ignore"):
        polynomials = recorded.coefficients_at(np.concatenate([recorded.constants[:, None], constants], axis=1))
        certain = ~none
        for polynomial in polynomials or ():
            totals: dict[tuple[int, ...], tuple[Any, Any]] = {}
            for key, coefficient in polynomial.items():
                for row, state, column, constant in own.values():
                    if power := key.count(index[column]):
                        rest = list(key)
                        rest.remove(index[column])
                        monomial = (row, *sorted((*rest, index[state])))
                        value = power * float(constant) * coefficient
                        total, size = totals.get(monomial, (0.0, 0.0))
                        totals[monomial] = total + value, size + np.abs(value)
            for total, size in totals.values():
                remains = np.broadcast_to(np.abs(total) > CERTAIN * size, len(none) + 1)
                certain = certain & (remains[1:] | ~remains[0])
    return none if polynomials is None else certain


def divided_gradient(
    term: FunctionTerm, products: Mapping[int, Product]
) -> tuple[FunctionTerm, tuple[frozenset[int], ...]]:
    """Separate a function where products of a part of its gradient vanish, as those of a central force do."""
    # It is returned with its gradient as several vectors that add up to it, and the products that each one omits.
    # The parts of the gradient are those by different polynomials of the coordinates, found by recording the function.
    index, own = _own_products(term, products)
    if not own or term.scalar:
        return term, (frozenset(),)
    arguments, given = None, of_constants(term.value)
    if given is None:
        arguments = recorded_function(term.value, len(index), term.timed)
    elif (arguments := recorded_for_constants(given.key, len(index), given.pattern)) is not None:
        divided = _divided(term, arguments, index, own)
        if len(divided[1]) == 1 and not divided[1][0]:
            return divided
        if cancel_as_recorded(term, own, given.constants[:, None]).all():
            return divided
        arguments = recorded_function(term.value, len(index), term.timed)
    return (term, (frozenset(),)) if arguments is None else _divided(term, arguments, index, own)


def _divided(
    term: FunctionTerm, recorded: RecordedFunction, index: Mapping[int, int], own: Mapping[int, Product]
) -> tuple[FunctionTerm, tuple[frozenset[int], ...]]:
    """Return `divided_gradient` of a recorded function with products of its coordinates."""
    key = tuple(own.items()), term.coordinates.tobytes()
    if key not in recorded.omissions:
        by_rows: dict[frozenset[int], list[int]] = {}
        for number, polynomial in enumerate(recorded.polynomials):
            derivatives = derivatives_of(polynomial, term.coordinates.tolist())
            listed = [(row, state, derivatives.get(index[column], []), c) for row, state, column, c in own.values()]
            # A row is omitted as a whole.
            remaining = {
                each[0] for each, number in zip(listed, cancelling(listed), strict=True) if each[2] and number < 0
            }
            omitted = frozenset(q for q, each in own.items() if each[0] not in remaining)
            by_rows.setdefault(omitted, []).append(number)
        recorded.omissions[key] = by_rows
    by_rows = recorded.omissions[key]
    if len(by_rows) > 1:
        try:
            term = recorded.divided(term, list(by_rows.values()))
        except TracingError:
            return term, (frozenset(),)
    return term, tuple(by_rows)


class FieldProducts(NamedTuple):
    """The products of J(x) grad H(x) without those that cancel."""

    # Rows (row, state, column, new column) of `changed`: -1 omits the product, from n on it takes a partial component
    # of the gradient: the sum of the entries of gradients (term, entry) in `partial`.

    terms: tuple[BuiltIn, ...]
    changed: Integers
    partial: tuple[tuple[tuple[int, int], ...], ...]

    def columns(self, products: Products, n: int) -> Integers:
        """Return the components of the gradient that products take; -1 for omitted ones."""
        codes = (self.changed[:, 0] * n + self.changed[:, 1]) * n + self.changed[:, 2]
        order = np.argsort(codes)
        wanted = (products.row * n + products.state) * n + products.column
        at = order[np.minimum(np.searchsorted(codes, wanted, sorter=order), len(codes) - 1)]
        return np.where(codes[at] == wanted, self.changed[at, 3], products.column)

    def partial_components(self, x: NDArray[Any], t: Any) -> NDArray[Any]:
        """Return the partial components of the gradient at x (n,)."""
        return np.array([sum(self.terms[k].gradient_entry(entry, x, t) for k, entry in one) for one in self.partial])


def field_products(system: Any) -> FieldProducts | None:
    """Find the products of J(x) grad H(x) that cancel, on a Lie algebra; None if there are none."""
    if system not in _FIELD_PRODUCTS:
        _FIELD_PRODUCTS[system] = products_without_cancelling(system.algebra, system.hamiltonian.terms())
    return _FIELD_PRODUCTS[system]


_FIELD_PRODUCTS: WeakKeyDictionary[Any, FieldProducts | None] = WeakKeyDictionary()


def without_cancelling(algebra: LieAlgebra, terms: Sequence[Term], coefficients: NDArray[np.float64]) -> Any:
    """Return for which coefficients (count, k) of terms, as in a `SystemStack`, certainly no products cancel, (k,).

    Of a function of constants the same ones cancel as for most others.
    """
    collected, products, chosen = _candidates(algebra, terms)
    if not len(chosen):
        return np.ones(coefficients.shape[1], dtype=bool)
    plain, listed = np.ones(coefficients.shape[1], dtype=bool), {q: products.at(q) for q in chosen.tolist()}
    n, start = algebra.dim + 1, 0
    row, state, column, constant = (values[chosen] for values in products)
    empty = np.zeros(0, dtype=np.int64)
    codes, numbers, factors = [empty], [empty], [np.zeros(0)]
    higher: dict[tuple[int, ...], int] = {}  # monomials of more than two coordinates, behind all others of a row
    for term in collected:
        if isinstance(term, FunctionTerm):
            count = 0 if term.constants is None else len(term.constants)
            if _own_products(term, listed)[1]:
                plain &= count > 0 and cancel_as_recorded(term, listed, coefficients[start : start + count])
            start += count
            continue
        if (form := term.form) is not None:
            owner, entry = expand(form.indptr[column], form.indptr[column + 1])
            pair = np.sort([state[owner], form.indices[entry].astype(np.int64)], axis=0) + 1
            linear = np.flatnonzero(form.linear[column] != 0)
            codes += [(row[owner] * n + pair[0]) * n + pair[1], row[linear] * n**2 + state[linear] + 1]
            numbers += [start + len(form.linear) + entry, start + column[linear]]
            factors += [np.asarray(constant[where], dtype=np.float64) for where in (owner, linear)]
            start += len(form.linear) + len(form.values)
            continue
        exponents = np.array(list(term.to_polynomial().monomials), dtype=np.int64).reshape(-1, algebra.dim)
        product, monomial = np.nonzero(exponents[:, column].T)
        keys = []
        for q, k in zip(product.tolist(), monomial.tolist(), strict=True):
            powers = exponents[k].copy()
            powers[column[q]] -= 1
            powers[state[q]] += 1
            key = (0, *(np.repeat(np.arange(algebra.dim), powers) + 1).tolist())
            if len(key) <= 3:
                keys.append((int(row[q]) * n + key[-2]) * n + key[-1])
            else:
                keys.append(n**3 + higher.setdefault((int(row[q]), *key), len(higher)))
        codes.append(np.array(keys, dtype=np.int64))
        numbers.append(start + monomial)
        factors.append(np.asarray(constant[product], dtype=np.float64) * exponents[monomial, column[product]])
        start += len(exponents)
    _, monomial = np.unique(np.concatenate(codes), return_inverse=True)
    values = np.concatenate(factors)[:, None] * coefficients[np.concatenate(numbers)]
    total, size = (np.zeros((int(monomial.max(initial=-1)) + 1, coefficients.shape[1])) for _ in range(2))
    np.add.at(total, monomial, values)
    np.add.at(size, monomial, np.abs(values))
    return plain & np.all(np.abs(total) > CERTAIN * size, axis=0)


def _candidates(algebra: LieAlgebra, terms: Sequence[Term]) -> tuple[list[BuiltIn], Products, Integers]:
    """Return the forms of terms, the products of commuting coordinates, and those that may cancel."""
    products = commuting_products(algebra)
    if not len(products.row):
        return [], products, np.zeros(0, dtype=np.int64)
    collected = built_in(terms)
    # A product cancels with another one of its row, and its coordinate is one that a gradient depends on.
    used = np.zeros(algebra.dim, dtype=bool)
    for term in collected:
        used[term.used] = True
    chosen = np.flatnonzero(used[products.state] & used[products.column])
    chosen = chosen[np.bincount(products.row[chosen], minlength=algebra.dim)[products.row[chosen]] > 1]
    if all(term.form is not None for term in collected):
        chosen = chosen[_repeated_monomials(algebra.dim, collected, products, chosen)]
    return collected, products, chosen


def products_without_cancelling(algebra: LieAlgebra, terms: Sequence[Term]) -> FieldProducts | None:
    """Return `field_products` for the terms of an energy."""
    collected, products, chosen = _candidates(algebra, terms)
    if not 0 < len(chosen) <= MAX_MONOMIALS:
        return None
    listed = {q: products.at(q) for q in chosen.tolist()}
    separated: list[BuiltIn] = []
    # Entries of the gradient in each product, and whether their products are omitted.
    sources: dict[int, dict[tuple[int, int], bool]] = {q: {} for q in listed}
    candidates: list[tuple[int, tuple[int, int]]] = []
    found: list[tuple[int, int, list[GradientTerm], Any]] = []
    for number, term in enumerate(collected):
        if isinstance(term, FunctionTerm):
            divided, omissions = divided_gradient(term, listed)
            size = len(term.coordinates)
            index = {int(k): a for a, k in enumerate(term.coordinates)}
            for q, product in listed.items():
                if product.column in index:
                    for copy, omitted in enumerate(omissions):
                        sources[q][number, copy * size + index[product.column]] = q in omitted
            separated.append(divided)
            continue
        separated.append(term)
        monomials = _gradient_monomials(term, {product.column for product in listed.values()})
        if monomials is None:
            return None
        for q, product in listed.items():
            if monomials.get(product.column):
                candidates.append((q, (number, product.column)))
                found.append((product.row, product.state, monomials[product.column], product.constant))
    if sum(len(each[2]) for each in found) > MAX_MONOMIALS:
        return None
    for (q, source), set_of_product in zip(candidates, cancelling(found), strict=True):
        sources[q][source] = set_of_product >= 0
    slots: dict[tuple[tuple[int, int], ...], int] = {}
    changed: list[tuple[int, int, int, int]] = []
    for q, product in listed.items():
        retained = tuple(source for source, omitted in sources[q].items() if not omitted)
        if len(retained) < len(sources[q]):
            column = algebra.dim + slots.setdefault(retained, len(slots)) if retained else -1
            changed.append((product.row, product.state, product.column, column))
    if not changed:
        return None
    return FieldProducts(tuple(separated), np.array(changed, dtype=np.int64), tuple(slots))


def _repeated_monomials(n: int, terms: Sequence[Any], products: Products, chosen: Integers) -> NDArray[np.bool_]:
    """Return which products of quadratic terms have no monomial that is the only one of its row."""
    owners, codes = [], []
    for term in terms:
        column, state = products.column[chosen], products.state[chosen]
        owner, entry = expand(term.indptr[column], term.indptr[column + 1])
        pair = np.sort([state[owner], term.indices[entry].astype(np.int64)], axis=0)
        owners.append(owner)
        codes.append((products.row[chosen][owner] * n + pair[0]) * n + pair[1])
    owner = np.concatenate(owners)
    _, inverse, count = np.unique(np.concatenate(codes), return_inverse=True, return_counts=True)
    alone = np.bincount(owner, weights=count[inverse] == 1, minlength=len(chosen))
    return (alone == 0) & (np.bincount(owner, minlength=len(chosen)) > 0)


def _gradient_monomials(
    term: QuadraticTerm | PolynomialTerm, columns: Collection[int]
) -> dict[int, list[GradientTerm]] | None:
    """Return the monomials of components of the gradient of a polynomial; None if there are too many."""
    form = term.form
    if form is None:
        polynomial = term.to_polynomial()
        few = len(polynomial.monomials) * polynomial.dim <= MAX_MONOMIALS
        return derivatives_of(polynomial, range(polynomial.dim)) if few else None
    found: dict[int, list[GradientTerm]] = {}
    for k in columns:
        row = slice(int(form.indptr[k]), int(form.indptr[k + 1]))
        pairs = zip(form.indices[row].tolist(), form.values[row].tolist(), strict=True)
        found[k] = [(None, (i,), value) for i, value in pairs]
        if form.linear[k]:
            found[k].append((None, (), float(form.linear[k])))
    return found
