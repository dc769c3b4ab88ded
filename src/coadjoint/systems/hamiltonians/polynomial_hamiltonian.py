"""Polynomials of any degree as Hamiltonians."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import MAX_SHOWN_LENGTH
from coadjoint.systems.evaluation import read_point
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import PolynomialTerm, Term


class PolynomialHamiltonian(Summable):
    """A `Polynomial` as a Hamiltonian; `as_hamiltonian` makes it for degree three and higher."""

    timed = False

    def __init__(self, polynomial: Polynomial) -> None:
        self.polynomial = polynomial
        self.dim: int | None = polynomial.dim

    def bind(self, n: int) -> PolynomialHamiltonian:
        """Return itself; raise ValueError if n is not the number of variables."""
        check_variables(self.polynomial, n)
        return self

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor."""
        return type(self)(factor * self.polynomial)

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return the value of the polynomial at x."""
        return self.polynomial(read_point(x, self.dim))

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        return self.polynomial.gradient(read_point(x, self.dim))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""
        return self.polynomial.hessian(read_point(x, self.dim))

    def gradient_and_size(self, x: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any], int]:
        """Return that of the polynomial."""
        return self.polynomial.gradient_and_size(x)

    has_linear = True

    def linear_part(self) -> npt.NDArray[np.float64]:
        """Return the coefficients of the linear term, (n,)."""
        linear = np.zeros(self.polynomial.dim)
        for exponents, coefficient in self.polynomial.monomials.items():
            if sum(exponents) == 1:
                linear[exponents.index(1)] = float(coefficient)
        return linear

    def with_linear(self, linear: npt.NDArray[np.float64]) -> PolynomialHamiltonian:
        """Return the polynomial with another linear part."""
        monomials = {e: c for e, c in self.polynomial.monomials.items() if sum(e) != 1}
        n = self.polynomial.dim
        for k in np.flatnonzero(linear).tolist():
            monomials[tuple(int(i == k) for i in range(n))] = float(linear[k])
        return PolynomialHamiltonian(Polynomial(monomials, dim=n))

    def terms(self) -> tuple[Term, ...]:
        """Return the single `PolynomialTerm`."""
        return (PolynomialTerm(self.polynomial),)

    def __repr__(self) -> str:
        text = repr(self.polynomial)
        if len(text) > MAX_SHOWN_LENGTH:
            text = f"{len(self.polynomial.monomials)} monomials in {self.dim} coordinates"
        return f"PolynomialHamiltonian({text})"


def check_variables(polynomial: Polynomial, n: int, owner: str = "the system") -> None:
    """Raise ValueError if the number of variables of a polynomial is not n, the dimension of its owner."""
    if polynomial.dim != n:
        raise ValueError(f"the polynomial has {polynomial.dim} variables but {owner} has dimension {n}; give {n}")
