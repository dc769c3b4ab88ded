"""Symbols for the coefficients of a Hamiltonian, and their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.symbolic_polynomial import SymbolicPolynomial
from coadjoint.errors import unknown_name
from coadjoint.program.table import Program
from coadjoint.systems.hamiltonians.quadratic import factors_of
from coadjoint.validation import read_list


@dataclass(frozen=True)
class Symbols:
    """A Hamiltonian with symbols for some of its coefficients.

    `names` maps exponents to the symbol of the coefficient; the symbol of a square represents twice the coefficient.
    """

    given: Polynomial
    names: Mapping[Exponents, str]

    @property
    def values(self) -> dict[str, Any]:
        """Name -> the number that the symbol represents."""
        return {name: self.given.monomials[e] * _divisor(e) for e, name in self.names.items()}

    @property
    def hamiltonian(self) -> Polynomial | SymbolicPolynomial:
        """The Hamiltonian with symbols."""
        places = {e: k for k, e in enumerate(self.names)}
        monomials: dict[Exponents, Any] = {}
        for e, value in self.given.monomials.items():
            own = [0] * len(places)
            if e in places:
                own[places[e]] = 1
                value = Fraction(1, _divisor(e)) if _divisor(e) > 1 else 1
            monomials[(*e, *own)] = value
        return self.written(Polynomial(monomials, dim=self.given.dim + len(places)))

    @property
    def zero(self) -> Polynomial | SymbolicPolynomial:
        """The polynomial 0."""
        return self.written(Polynomial({}, dim=self.given.dim + len(self.names)))

    def written(self, polynomial: Polynomial) -> Polynomial | SymbolicPolynomial:
        """Return a polynomial in coordinates and symbols as a `SymbolicPolynomial`, if there are symbols."""
        return SymbolicPolynomial(polynomial, tuple(self.names.values())) if self.names else polynomial

    def factors(self, ring: ExactPolynomials) -> dict[Exponents, Exact]:
        """Return exponents -> the polynomial in symbols that represents the coefficient."""
        return {e: ring.symbol[name] / _divisor(e) for e, name in self.names.items()}


def no_symbols(H: Polynomial) -> Symbols:
    """Return a Hamiltonian without symbols."""
    return Symbols(H, {})


def symbols_of(H: Polynomial, wanted: Any, program: Program) -> Symbols:
    """Return a Hamiltonian with symbols for all coefficients (True), or for those with the given names.

    Raise ValueError for unknown names, or if a Casimir was subtracted from H in the program of the splitting.

    >>> names_of(Polynomial({(2, 0): 0.5, (1, 1): 1, (0, 3): 2, (0, 1): 1}))
    {(0, 1): 'b2', (2, 0): 'm1', (1, 1): 'm12', (0, 3): 'c222'}
    """
    if program.shift:
        raise ValueError(
            f"a multiple of the Casimir {program.shift[0][0]!r} was subtracted from H, with a factor that depends "
            'on its coefficients; for symbols use parts="coordinates"'
        )
    names = names_of(H)
    if wanted is not True:
        chosen = read_list(wanted, "symbols", "give True, or names such as 'm1'")
        for name in chosen:
            if name not in names.values():
                raise unknown_name("symbol", name, list(names.values()))
        names = {e: name for e, name in names.items() if name in chosen}
    return Symbols(H, names)


def names_of(H: Polynomial) -> dict[Exponents, str]:
    """Return the names of the coefficients of a Hamiltonian, by the exponents of their monomials."""
    between = "_" if H.dim >= 10 else ""
    found = {}
    for exponents in H.monomials:
        if not any(exponents):
            continue
        factors = [str(i + 1) for i in factors_of(exponents)]
        kind = {1: "b", 2: "m"}.get(len(factors), "c")
        if len(factors) == 2 and factors[0] == factors[1]:
            factors = factors[:1]
        found[exponents] = kind + between.join(factors)
    return found


def _divisor(exponents: Exponents) -> int:
    """Return 2 for squares: m1 x1^2 / 2."""
    return 2 if sum(exponents) == 2 and 2 in exponents else 1
