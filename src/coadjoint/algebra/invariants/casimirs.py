"""Polynomial Casimirs computed from the structure constants."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples, summands
from coadjoint.algebra.exact.elimination import clear_denominators, generic_rank, rational_constants
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
        integers = clear_denominators(
            [Fraction(value) for value in values]
        ).tolist()  # primitive, since the first fraction is 1
        values = [value // math.gcd(*integers) for value in integers]
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


def summand_casimirs(triples: Triples, dim: int, max_degree: int) -> list[Polynomial]:
    """Return generators of the polynomial Casimirs of one summand up to a degree, by degree and leading monomial."""
    independent = dim - generic_rank(triples, dim)
    if independent == 0:
        return []
    if independent > 1:
        check_size(dim, max_degree, triples.c.size)
    integers = rational_constants(triples, dim)
    generators: list[Polynomial] = []
    for degree in range(1, max_degree + 1):
        check_size(dim, degree, triples.c.size)
        generators += _of_degree(triples, integers, dim, degree, generators)
        # Roots and factors of Casimirs are Casimirs, so with one independent Casimir all are powers of the lowest.
        if generators and independent == 1:
            break
    return generators


class EmptyCasimirs(dict[str, Polynomial]):
    """An empty dict of polynomial Casimirs whose repr explains that none were found up to `degree`.

    >>> EmptyCasimirs(1, 4, ["log C"])
    {} (no polynomial up to degree 4; of Casimirs of any kind there is 1; casimirs_known has: log C)
    """

    def __init__(self, count: int, degree: int, known: list[str]) -> None:
        super().__init__()
        self.count, self.degree, self.known = count, degree, known

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.count, self.degree, self.known)

    def __repr__(self) -> str:
        if not self.count:
            return "{} (there is no Casimir of any kind: the rank of J is the dimension)"
        verb = "is" if self.count == 1 else "are"
        named = f"; casimirs_known has: {', '.join(self.known)}" if self.known else ""
        explanation = f"no polynomial up to degree {self.degree}; of Casimirs of any kind there {verb} {self.count}"
        return f"{{}} ({explanation}{named})"


@long_operation("casimirs")
def casimirs(triples: Triples, dim: int, max_degree: int = 4) -> dict[str, Polynomial]:
    """Return generators of the polynomial Casimirs up to a degree: the implementation of `LieAlgebra.casimirs`."""
    max_degree = read_integer(max_degree, "max_degree")
    solved: dict[tuple[int, tuple[bytes, ...]], list[Polynomial]] = {}
    placed: list[tuple[Integers, Polynomial]] = []
    exponents = 0
    for coordinates, constants in summands(triples, dim):
        key = coordinates.size, tuple(column.tobytes() for column in constants)
        if key not in solved:  # equal summands are solved once
            solved[key] = summand_casimirs(constants, coordinates.size, max_degree)
        placed += [(coordinates, polynomial) for polynomial in solved[key]]
        exponents += sum(len(polynomial.monomials) for polynomial in solved[key]) * dim
        if exponents > MAX_EXPONENTS:
            raise ValueError(
                f"the Casimirs of this direct sum of dimension {dim} need more than {MAX_EXPONENTS} exponents as "
                f"polynomials in all coordinates; compute the Casimirs of one summand instead"
            )
    polynomials = [embedded(polynomial, coordinates.tolist(), dim) for coordinates, polynomial in placed]
    result: dict[str, Polynomial] = {}
    polynomials.sort(key=lambda polynomial: (polynomial.degree, [-e for e in next(iter(polynomial.monomials))]))
    for degree, same_degree in itertools.groupby(polynomials, key=lambda polynomial: polynomial.degree):
        group = list(same_degree)
        names = [f"C{degree}"] if len(group) == 1 else [f"C{degree}_{number + 1}" for number in range(len(group))]
        result.update(zip(names, group, strict=True))
    return result


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
