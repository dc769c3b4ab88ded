"""Conversion of Hamiltonians to polynomials."""

from __future__ import annotations

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm


def polynomial_of(hamiltonian: HamiltonianLike) -> Polynomial | None:
    """Return a bound Hamiltonian as a polynomial, with its given coefficients; None if it calls user functions."""
    if isinstance(hamiltonian, Quadratic):
        return hamiltonian.to_polynomial()
    reader = _PolynomialReader()
    for term in hamiltonian.terms():
        term.describe_to(reader)
    return None if reader.has_functions else sum(reader.polynomials[1:], reader.polynomials[0])


class _PolynomialReader:
    """Term reader that collects the terms of a Hamiltonian as polynomials."""

    def __init__(self) -> None:
        self.polynomials: list[Polynomial] = []
        self.has_functions = False

    def quadratic(self, term: QuadraticTerm) -> None:
        n = len(term.linear)
        monomials = {(0,) * n: term.constant}
        for i, c in enumerate(term.linear.tolist()):
            monomials[_exponents(n, i)] = c
        for i, j, c in zip(term.rows.tolist(), term.indices.tolist(), term.values.tolist(), strict=True):
            if i <= j:
                monomials[_exponents(n, i, j)] = c / 2 if i == j else c
        self.polynomials.append(Polynomial(monomials))

    def polynomial(self, term: PolynomialTerm) -> None:
        self.polynomials.append(term.polynomial)

    def function(self, term: FunctionTerm) -> None:
        self.has_functions = True


def _exponents(n: int, *factors: int) -> tuple[int, ...]:
    exponents = [0] * n
    for i in factors:
        exponents[i] += 1
    return tuple(exponents)
