"""Terms of the modified Hamiltonian of a scheme on a system, its leading error term, and symbols for coefficients."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials, SymbolicPolynomial
from coadjoint.algebra.polynomials.monomials import Exponents, factors_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.errors import unknown_name
from coadjoint.program.logarithms import Coordinates
from coadjoint.program.modified_series import coordinates_of, modified_terms
from coadjoint.program.sweeps import Sweep
from coadjoint.program.table import Program
from coadjoint.systems.coordinates import in_coordinates_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import read_list

MAX_POWER = 12
"""Largest power of h: above it, the words in the free algebra alone take minutes."""

Term = Polynomial | SymbolicPolynomial


class ErrorTerm(NamedTuple):
    """The leading error term h^power * term of a scheme; no power if H has a single part, whose flow is a step."""

    power: int | None
    term: Term


@dataclass(frozen=True, eq=False)
class SchemeTerms:
    """Terms of the sweeps of a kernel and its processor `after`; `names`: exponents -> symbol (twice a square's)."""

    system: LiePoissonSystem
    program: Program
    sweeps: list[Sweep]
    after: list[Sweep]
    order: int
    polynomial: Polynomial
    names: Mapping[Exponents, str]

    def kernel(self) -> SchemeTerms:
        return replace(self, after=[])

    def below(self, order: int) -> tuple[dict[int, Term], float, float]:
        """Return the terms below h^order by power, their radius, and the bound on neglected coefficients."""
        terms, radius, neglected = self._terms(self._coordinates(order), range(2, order + 1))
        return {0: in_coordinates_of(self.system, self._hamiltonian()), **terms}, radius, neglected

    def error_term(self) -> ErrorTerm:
        """Return the term at the first power above h^0 that is non-zero for general systems."""
        zero = self._with_symbols(Polynomial({}, dim=self.polynomial.dim + len(self.names)))
        if len(self.program.parts) > 1 or np.any(self.program.frequency != 0):
            for highest in range(min(self.order + 1, MAX_POWER + 1), MAX_POWER + 2):
                coordinates = self._coordinates(highest)
                weight = coordinates.leading
                if weight is not None:
                    terms, _, _ = self._terms(coordinates, [weight])
                    return ErrorTerm(weight - 1, terms.get(weight - 1, zero))
        return ErrorTerm(None, zero)

    def _coordinates(self, highest: int) -> Coordinates:
        return coordinates_of(self.program, self.sweeps, self.after, highest, self.order)

    def _terms(self, coordinates: Coordinates, weights: Iterable[int]) -> tuple[dict[int, Term], float, float]:
        ring = ExactPolynomials(self.system.algebra, tuple(self.values))
        # The polynomials in symbols that represent the coefficients.
        factors = {e: ring.symbol_elements[name] / _divisor(e) for e, name in self.names.items()}
        of_power, radius, neglected = modified_terms(
            ring, self.system, self.program, coordinates, weights, self.polynomial, factors
        )
        terms = {power: in_coordinates_of(self.system, self._with_symbols(term)) for power, term in of_power.items()}
        return terms, radius, neglected

    @property
    def values(self) -> dict[str, Any]:
        return {name: self.polynomial.monomials[e] * _divisor(e) for e, name in self.names.items()}

    def _hamiltonian(self) -> Term:
        positions = {e: k for k, e in enumerate(self.names)}
        monomials: dict[Exponents, Any] = {}
        for e, value in self.polynomial.monomials.items():
            symbol_exponents = [0] * len(positions)
            if e in positions:
                symbol_exponents[positions[e]] = 1
                value = Fraction(1, _divisor(e)) if _divisor(e) > 1 else 1
            monomials[(*e, *symbol_exponents)] = value
        return self._with_symbols(Polynomial(monomials, dim=self.polynomial.dim + len(positions)))

    def _with_symbols(self, polynomial: Polynomial) -> Term:
        return SymbolicPolynomial(polynomial, tuple(self.names.values())) if self.names else polynomial


def symbols_of(H: Polynomial, requested: Any, program: Program) -> dict[Exponents, str]:
    """Return the names of all coefficients of a Hamiltonian (True), or the given ones, by exponents."""
    if program.shift:
        raise ValueError(
            f"a multiple of the Casimir {program.shift[0][0]!r} was subtracted from H, with a factor that depends "
            'on its coefficients; for symbols use parts="coordinates"'
        )
    names = names_of(H)
    if requested is not True:
        chosen = read_list(requested, "symbols", "give True, or names such as 'm1'")
        for name in chosen:
            if name not in names.values():
                raise unknown_name("symbol", name, list(names.values()))
        names = {e: name for e, name in names.items() if name in chosen}
    return names


def names_of(H: Polynomial) -> dict[Exponents, str]:
    """Return the names of the coefficients of a Hamiltonian, by the exponents of their monomials."""
    between = "_" if H.dim >= 10 else ""
    names = {}
    for exponents in H.monomials:
        if not any(exponents):
            continue
        factors = [str(i + 1) for i in factors_of(exponents)]
        kind = {1: "b", 2: "m"}.get(len(factors), "c")
        if len(factors) == 2 and factors[0] == factors[1]:
            factors = factors[:1]
        names[exponents] = kind + between.join(factors)
    return names


def _divisor(exponents: Exponents) -> int:
    """Return 2 for squares: m1 x1^2 / 2."""
    return 2 if sum(exponents) == 2 and 2 in exponents else 1
