"""Is a Hamiltonian a polynomial, and which?"""

from __future__ import annotations

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.systems.hamiltonian import HamiltonianLike
from coadjoint.systems.quadratic import Quadratic
from coadjoint.systems.terms import FunctionTerm, PolynomialTerm, QuadraticTerm


def polynomial_of(hamiltonian: HamiltonianLike) -> Polynomial | None:
    """Return a bound Hamiltonian as a polynomial; None where it calls functions of the user.

    Parameters
    ----------
    hamiltonian : HamiltonianLike
        A bound Hamiltonian of any kind.

    Returns
    -------
    Polynomial or None
        The coefficients of a `Quadratic` and of a `Polynomial` are those that were given, fractions among them.

    Examples
    --------
    >>> polynomial_of(Quadratic([1.0, 0.5], linear=[0.0, 3.0]))
    3.0*x2 + 0.5*x1^2 + 0.25*x2^2
    """
    if isinstance(hamiltonian, Quadratic):
        return hamiltonian.to_polynomial()
    reader = _Pieces()
    for term in hamiltonian.terms():
        term.given_to(reader)
    return None if reader.other else sum(reader.found[1:], reader.found[0])


class _Pieces:
    """The terms of a Hamiltonian, each as a polynomial."""

    def __init__(self) -> None:
        self.found: list[Polynomial] = []
        self.other = False

    def quadratic(self, term: QuadraticTerm) -> None:
        n = len(term.linear)
        monomials = {(0,) * n: term.constant}
        for i, c in enumerate(term.linear.tolist()):
            monomials[_exponents(n, i)] = c
        for i, j, c in zip(term.rows.tolist(), term.indices.tolist(), term.values.tolist(), strict=True):
            if i <= j:
                monomials[_exponents(n, i, j)] = c / 2 if i == j else c
        self.found.append(Polynomial(monomials))

    def polynomial(self, term: PolynomialTerm) -> None:
        self.found.append(term.polynomial)

    def function(self, term: FunctionTerm) -> None:
        self.other = True


def _exponents(n: int, *factors: int) -> tuple[int, ...]:
    found = [0] * n
    for i in factors:
        found[i] += 1
    return tuple(found)
