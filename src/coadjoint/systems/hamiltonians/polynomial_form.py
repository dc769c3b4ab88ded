"""Conversion of Hamiltonians to polynomials."""

from __future__ import annotations

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.quadratic_forms import linear, quadratic
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
        entries = zip(term.rows.tolist(), term.indices.tolist(), term.values.tolist(), strict=True)
        squares = quadratic(((i, j, c / 2 if i == j else c) for i, j, c in entries if i <= j), n)
        self.polynomials.append(squares + linear(dict(enumerate(term.linear.tolist())), n) + term.constant)

    def polynomial(self, term: PolynomialTerm) -> None:
        self.polynomials.append(term.polynomial)

    def function(self, term: FunctionTerm) -> None:
        self.has_functions = True
