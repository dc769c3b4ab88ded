"""Casimirs computed from the structure constants: polynomials, and functions of semi-invariants where these fail."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples, summands
from coadjoint.algebra.exact.elimination import coprime_integers, generic_rank, rational_constants
from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.invariants.casimir_equations import (
    Vector,
    equations,
    exact_kernel,
    exact_pivots,
    monomial_count,
    monomials,
    numerical_kernel,
    numerical_pivots,
)
from coadjoint.algebra.invariants.invariant import LogarithmicSum
from coadjoint.algebra.invariants.semi_invariants import Gradients, semi_invariant_casimirs
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.long_operations import long_operation, note_progress
from coadjoint.validation import read_integer

MAX_MONOMIALS = 40_000  # monomials of one degree in one summand; at most a minute
MAX_DERIVATIVE_TERMS = 10_000_000  # terms of their derivatives before like terms are collected; 1 GB
MAX_EXPONENTS = 50_000_000  # over all Casimirs; a Polynomial stores one per coordinate and monomial; 400 MB


def check_size(dim: int, degree: int, constants: int) -> None:
    """Raise ValueError for a degree with too many monomials, or too many terms in their derivatives.

    >>> check_size(24, 6, 100)
    Traceback (most recent call last):
    ValueError: degree 6 on dimension 24 has 475020 monomials, above the limit of 40000; lower max_degree
    """
    count = monomial_count(dim, degree)
    if count > MAX_MONOMIALS:
        raise ValueError(
            f"degree {degree} on dimension {dim} has {count} monomials, above the limit of {MAX_MONOMIALS}; "
            f"lower max_degree"
        )
    terms = 2 * constants * count * degree // dim
    if terms > MAX_DERIVATIVE_TERMS:
        raise ValueError(
            f"degree {degree} on dimension {dim} with {constants} structure constants has equations of {terms} terms, "
            f"above the limit of {MAX_DERIVATIVE_TERMS}; lower max_degree, or choose a basis with fewer constants"
        )


def _polynomial(vector: Vector, basis: Integers, dim: int) -> Polynomial:
    """Convert coefficients to a polynomial; rational ones are scaled to primitive integers."""
    values = list(vector.values())
    if not any(isinstance(value, float) for value in values):
        values = coprime_integers(values)
    exponents = (np.bincount(basis[column], minlength=dim).tolist() for column in vector)
    return Polynomial({tuple(e): value for e, value in zip(exponents, values, strict=True)})


def products(generators: Sequence[Polynomial], degree: int) -> Iterator[Polynomial]:
    """Yield all products of a given degree of homogeneous polynomials of lower degree, with repetition."""
    for count in range(2, degree + 1):
        for factors in itertools.combinations_with_replacement(generators, count):
            if sum(factor.degree for factor in factors) == degree:
                yield math.prod(factors[1:], start=factors[0])


def _of_degree(
    triples: Triples, integers: NDArray[Any] | None, dim: int, degree: int, lower: Sequence[Polynomial]
) -> list[Polynomial]:
    """Return a basis of the Casimirs of a degree modulo sums of products of lower ones."""
    note_progress(f"degree {degree} of dimension {dim}")
    basis = monomials(dim, degree)
    if integers is None:
        space, pivots = numerical_kernel(equations(triples, triples.c, basis, dim)), numerical_pivots
    else:
        space, pivots = exact_kernel(equations(triples, integers, basis, dim)), exact_pivots
    # In a reduced row echelon basis the coordinates of an element are its coefficients at the leading monomials.
    leading = [tuple(np.bincount(basis[next(iter(vector))], minlength=dim).tolist()) for vector in space]
    coordinates = [[product.monomials.get(e, 0) for e in leading] for product in products(lower, degree)]
    generated = set(pivots(coordinates, len(space)))
    return [_polynomial(vector, basis, dim) for index, vector in enumerate(space) if index not in generated]


class SummandCasimirs(NamedTuple):
    """Casimirs of a direct summand, the numbers of the polynomials that are independent, and of all that exist."""

    polynomials: list[Polynomial]
    independent: list[int]
    others: list[LogarithmicSum]
    corank: int


def summand_casimirs(triples: Triples, dim: int, max_degree: int) -> SummandCasimirs:
    """Return the Casimirs of one summand up to a degree: generators of the polynomials, and others if these are few."""
    corank = dim - generic_rank(triples, dim)
    if corank == 0:
        return SummandCasimirs([], [], [], 0)
    if corank > 1:
        check_size(dim, max_degree, triples.c.size)
    integers = rational_constants(triples, dim)
    generators: list[Polynomial] = []
    for degree in range(1, max_degree + 1):
        check_size(dim, degree, triples.c.size)
        generators += _of_degree(triples, integers, dim, degree, generators)
        # Roots and factors of Casimirs are Casimirs, so with one independent Casimir all are powers of the lowest.
        if generators and corank == 1:
            break
    gradients = Gradients(dim, integers is not None)
    independent = [number for number, casimir in enumerate(generators) if gradients.add(casimir)]
    missing = corank - len(independent)
    others: list[LogarithmicSum] = []
    exact = rational_constants(triples, dim, Fraction) if integers is None else integers
    if missing and exact is not None:
        others = semi_invariant_casimirs(triples, exact, dim, max_degree, missing, gradients)
    return SummandCasimirs(generators, independent, others, corank)


class Casimirs(dict[str, Any]):
    """Casimirs by name, with those that are missing, as `LieAlgebra.casimirs` describes.

    >>> Casimirs({}, 1, (), 4, ["log C"])
    {} (found 0 of 1 independent Casimirs up to degree 4; casimirs_known has: log C)
    """

    def __init__(
        self, found: Mapping[str, Any], corank: int, independent: Sequence[str], degree: int, known: Sequence[str]
    ) -> None:
        super().__init__(found)
        self.corank, self.independent, self.degree, self.known = corank, tuple(independent), degree, tuple(known)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self), self.corank, self.independent, self.degree, self.known)

    @property
    def missing(self) -> int:
        """Number of independent Casimirs that were not found."""
        return self.corank - len(self.independent)

    @property
    def sentence(self) -> str:
        """What is missing and how to give it."""
        if not self.corank:
            return "there is no Casimir of any kind: the rank of J is the dimension"
        if not self.missing:
            return ""
        found = f"found {len(self.independent)} of {self.corank} independent Casimirs up to degree {self.degree}"
        if self.known:
            return f"{found}; casimirs_known has: {', '.join(self.known)}"
        return (
            f"{found}; give the {self.missing} missing as functions of x, "
            "LiePoissonSystem(..., casimirs={'C': lambda x: ...}), or raise max_degree"
        )

    def __repr__(self) -> str:
        sentence = self.sentence
        return dict.__repr__(self) + (f" ({sentence})" if sentence else "")


@long_operation("casimirs")
def casimirs(triples: Triples, dim: int, max_degree: int = 4) -> tuple[dict[str, Any], int, list[str]]:
    """Return Casimirs up to a degree, the corank, and names of independent ones; see `LieAlgebra.casimirs`."""
    max_degree = read_integer(max_degree, "max_degree")
    solved: dict[tuple[int, tuple[bytes, ...]], SummandCasimirs] = {}
    placed: list[tuple[Polynomial, bool]] = []
    others: list[LogarithmicSum] = []
    exponents = corank = 0
    for coordinates, constants in summands(triples, dim):
        key = coordinates.size, tuple(column.tobytes() for column in constants)
        if key not in solved:  # equal summands are solved once
            solved[key] = summand_casimirs(constants, coordinates.size, max_degree)
        found, where = solved[key], coordinates.tolist()
        corank += found.corank
        exponents += sum(len(polynomial.monomials) for polynomial in found.polynomials) * dim
        if exponents > MAX_EXPONENTS:
            raise ValueError(
                f"the Casimirs of this direct sum of dimension {dim} need more than {MAX_EXPONENTS} exponents as "
                f"polynomials in all coordinates; compute the Casimirs of one summand instead"
            )
        placed += [(embedded(p, where, dim), number in found.independent) for number, p in enumerate(found.polynomials)]
        others += [one.transformed(partial(embedded, coordinates=where, dim=dim)) for one in found.others]
    result: dict[str, Any] = {}
    independent: list[str] = []
    placed.sort(key=lambda one: (one[0].degree, [-e for e in next(iter(one[0].monomials))]))
    for degree, same_degree in itertools.groupby(placed, key=lambda one: one[0].degree):
        group = list(same_degree)
        names = [f"C{degree}"] if len(group) == 1 else [f"C{degree}_{number + 1}" for number in range(len(group))]
        result.update(zip(names, (polynomial for polynomial, _ in group), strict=True))
        independent += [name for name, (_, counts) in zip(names, group, strict=True) if counts]
    names = ["I"] if len(others) == 1 else [f"I{number + 1}" for number in range(len(others))]
    return result | dict(zip(names, others, strict=True)), corank, independent + names


def embedded(polynomial: Polynomial, coordinates: Sequence[int], dim: int) -> Polynomial:
    """Rewrite a polynomial in some coordinates as one in all `dim` coordinates."""
    if len(coordinates) == dim:
        return polynomial
    terms = {}
    for exponents, value in polynomial.monomials.items():
        wide = [0] * dim
        for coordinate, exponent in zip(coordinates, exponents, strict=True):
            wide[coordinate] = exponent
        terms[tuple(wide)] = value
    return Polynomial._from_valid(terms, dim)
