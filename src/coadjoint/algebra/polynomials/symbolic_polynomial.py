"""Polynomials whose coefficients are polynomials in symbols, such as masses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from coadjoint.algebra.exact.numbers import exact_number, exact_numbers, fraction
from coadjoint.algebra.polynomials.monomials import Coefficient, Exponents
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.polynomial_format import coordinate_names, latex, plain, sympy_of
from coadjoint.validation import read_number


class SymbolicPolynomial:
    """A polynomial in x1, ..., xn with coefficients that are polynomials in symbols, last in `polynomial`."""

    def __init__(self, polynomial: Polynomial, symbols: Sequence[str]) -> None:
        self._polynomial, self.symbols = polynomial, tuple(symbols)
        self.dim = polynomial.dim - len(self.symbols)

    @property
    def coefficients(self) -> Mapping[Exponents, Polynomial]:
        """Exponents of x1, ..., xn -> polynomial in the symbols."""
        grouped: dict[Exponents, dict[Exponents, Coefficient]] = {}
        for exponents, value in self._polynomial.monomials.items():
            grouped.setdefault(exponents[: self.dim], {})[exponents[self.dim :]] = value
        ordered = Polynomial(dict.fromkeys(grouped, 1), dim=self.dim).monomials
        return {exponents: Polynomial(grouped[exponents]) for exponents in ordered}

    @property
    def degree(self) -> int:
        """The largest degree in the coordinates."""
        return max((sum(exponents) for exponents in self.coefficients), default=0)

    def with_values(self, values: Mapping[str, Coefficient]) -> Polynomial:
        """Substitute numbers (name -> number) for all symbols; exact if values and coefficients are."""
        numbers = exact_numbers(_exact(values[name], name) for name in self.symbols)
        monomials = {}
        for exponents, coefficient in self.coefficients.items():
            total = coefficient(numbers)
            floats = any(isinstance(value, float) for value in coefficient.monomials.values())
            monomials[exponents] = float(total) if floats else fraction(total)
        return Polynomial(monomials, dim=self.dim)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, SymbolicPolynomial):
            return NotImplemented
        return self.symbols == other.symbols and self._polynomial == other._polynomial

    def __hash__(self) -> int:
        return hash((self.symbols, self._polynomial))

    def __repr__(self) -> str:
        return self._grouped(plain, "*")

    def to_latex(self) -> str:
        """Return the LaTeX form, without dollar signs."""
        return self._grouped(latex, r" \, ")

    def _repr_latex_(self) -> str:
        return f"${self.to_latex()}$"

    def to_sympy(self) -> Any:
        """Return a SymPy expression."""
        return sympy_of(self._polynomial.monomials, [*coordinate_names(self.dim), *self.symbols])

    def _grouped(self, write: Callable[[Mapping[Exponents, Coefficient], Sequence[str]], str], between: str) -> str:
        names = coordinate_names(self.dim)
        text = ""
        for exponents, coefficient in self.coefficients.items():
            if len(coefficient.monomials) == 1 or not any(exponents):
                joined = {(*powers, *exponents): value for powers, value in coefficient.monomials.items()}
                term = write(joined, [*self.symbols, *names])
            else:
                term = f"{write({exponents: 1}, names)}{between}({write(coefficient.monomials, self.symbols)})"
            text += (f" - {term[1:]}" if term.startswith("-") else f" + {term}") if text else term
        return text or "0"


def _exact(value: Any, name: str) -> Any:
    return exact_number(value if type(value) in (int, Fraction) else read_number(value, name))
