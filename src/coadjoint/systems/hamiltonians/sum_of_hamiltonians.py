"""Sums of Hamiltonians of any types, the result of ``H1 + H2``, and polynomials."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import Coefficient, joined_names
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import MAX_SHOWN_LENGTH, short
from coadjoint.systems.hamiltonians.hamiltonian import (
    Hamiltonian,
    HamiltonianLike,
    as_hamiltonian,
    is_plain_function,
)
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import PolynomialHamiltonian, Summable
from coadjoint.systems.hamiltonians.terms import Term, built_in
from coadjoint.systems.hamiltonians.user_hamiltonian import is_user_defined
from coadjoint.validation import is_real


class SumOfHamiltonians(Summable):
    """A Hamiltonian that is the sum of others of several types; ``H1 + H2`` makes it."""

    # At most one summand is a Quadratic or a polynomial, and at most one a SplitHamiltonian; `sum_of` joins others.

    def __init__(self, summands: Sequence[Any]) -> None:
        self.summands: tuple[Any, ...] = tuple(summands)
        dimensions = [summand.dim for summand in self.summands]
        known = set(dimensions) - {None}
        if len(known) > 1:
            raise ValueError(f"Hamiltonians of {' and '.join(map(str, sorted(known)))} coordinates cannot be added")
        self.dim: int | None = None if None in dimensions else dimensions[0]
        self.timed = any(summand.timed for summand in self.summands)
        joined_names(self.summands)

    def bind(self, n: int) -> SumOfHamiltonians:
        """Return the sum of the summands bound to dimension n."""
        return SumOfHamiltonians([as_hamiltonian(summand, n) for summand in self.summands])

    def times(self, factor: Coefficient) -> Self:
        return type(self)([factor * summand for summand in self.summands])

    def linear_part(self) -> npt.NDArray[np.float64]:
        assert self.dim is not None
        parts = [summand.linear_part() for summand in self.summands if getattr(summand, "has_linear", False)]
        return np.asarray(sum(parts) + np.zeros(self.dim))

    def with_linear(self, linear: npt.NDArray[np.float64]) -> SumOfHamiltonians:
        """Replace the linear term of the `Quadratic` or polynomial, the first summand; add one if missing."""
        first, *rest = self.summands
        if getattr(first, "place_in_sum", None) != Quadratic.place_in_sum:
            first, rest = Quadratic(np.zeros(len(linear))), [first, *rest]
        elsewhere = SumOfHamiltonians([first, *rest]).linear_part() - first.linear_part()
        return SumOfHamiltonians([first.with_linear(linear - elsewhere), *rest])

    def check_commuting(self, algebra: LieAlgebra) -> None:
        for summand in self.summands:
            if isinstance(summand, Summable):
                summand.check_commuting(algebra)

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        return sum(summand.value(x, t) for summand in self.summands)

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        return np.asarray(sum(summand.gradient(x, t) for summand in self.summands))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        return np.asarray(sum(summand.hessian(x, t) for summand in self.summands))

    def terms(self) -> tuple[Term, ...]:
        """Return the terms of all summands; the sum must be bound."""
        return tuple(term for summand in self.summands for term in summand.terms())

    def __repr__(self) -> str:
        text = " + ".join(map(repr, self.summands))
        return text if len(text) <= MAX_SHOWN_LENGTH else f"a sum of {len(self.summands)} Hamiltonians"


def sum_of(first: Any, second: Any) -> Any:
    """Return the sum of two Hamiltonians, or of one and a number, which is a constant."""
    if any(is_real(summand) and summand == 0 for summand in (first, second)):
        return second if is_real(first) else first  # the start value of `sum`
    joined: dict[int, Any] = {}
    rest: list[Any] = []
    for summand in (*_summands(first), *_summands(second)):
        place = getattr(summand, "place_in_sum", None)
        if place is None:
            rest.append(summand)
        else:
            joined[place] = joined[place].joined(summand) if place in joined else summand
    polynomial = joined.get(Quadratic.place_in_sum)
    if isinstance(polynomial, PolynomialHamiltonian):
        if len(joined) == 1 and not rest:
            return polynomial.polynomial
        joined[Quadratic.place_in_sum] = as_hamiltonian(polynomial.polynomial, polynomial.polynomial.dim)
    summands = [*(joined[place] for place in sorted(joined)), *rest]
    return summands[0] if len(summands) == 1 else SumOfHamiltonians(summands)


def _summands(argument: Any) -> tuple[Any, ...]:
    """Return the summands of an argument: of a sum its own, a number, polynomial or function as a Hamiltonian."""
    if is_real(argument):
        return (Quadratic(0.0, constant=argument),)
    if isinstance(argument, Polynomial):
        return (PolynomialHamiltonian(argument),)
    if isinstance(argument, SumOfHamiltonians):
        return argument.summands
    is_own = is_user_defined(argument) and isinstance(argument, HamiltonianLike) and not isinstance(argument, type)
    if isinstance(argument, Summable) or is_own:
        return (argument,)
    if is_plain_function(argument):
        return (Hamiltonian(argument),)
    raise TypeError(f"{short(argument)} is not a Hamiltonian and cannot be added to one; give one, or a number")


def polynomial_of(hamiltonian: HamiltonianLike) -> Polynomial | None:
    """Return a bound Hamiltonian as a polynomial, with its given coefficients; None if it calls user functions."""
    if isinstance(hamiltonian, Quadratic):
        return hamiltonian.to_polynomial()
    polynomials = [term.to_polynomial() for term in built_in(hamiltonian.terms())]
    known = [polynomial for polynomial in polynomials if polynomial is not None]
    return sum(known[1:], known[0]) if len(known) == len(polynomials) else None
