"""Exact polynomials in momenta and symbols, such as masses: the ring with its Lie-Poisson bracket, Taylor polynomials
about a point, and polynomials whose coefficients are polynomials in symbols.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from coadjoint.algebra.exact.numbers import exact_numbers, fraction, rational, read_exact
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import Coefficient, Exponents, coordinate_names, latex, plain, sympy_of
from coadjoint.algebra.polynomials.polynomial import Polynomial

Exact = Any
"""An element of the ring: `flint.fmpq_mpoly`, with its own +, -, *, / by numbers and ==."""


class ExactPolynomials:
    """The ring Q[x1, ..., xn, s1, ..., sm] on the dual of a Lie algebra; the symbols s, such as masses, are central."""

    # Elements are polynomials of python-flint, much faster than `Polynomial`. With a `point` and a `degree` they are
    # Taylor polynomials in x - point, truncated above the degree, made by `about_point`.

    def __init__(
        self,
        algebra: LieAlgebra,
        symbols: Sequence[str] = (),
        *,
        point: Sequence[float] | None = None,
        degree: int | None = None,
    ) -> None:
        from flint import Ordering, fmpq_mpoly_ctx

        self.algebra, self.dim, self.symbols = algebra, algebra.dim, tuple(symbols)
        self._point, self._degree = point, degree
        self._context = fmpq_mpoly_ctx.get([*coordinate_names(self.dim), *self.symbols], Ordering.degrevlex)

    @cached_property
    def coordinates(self) -> tuple[Exact, ...]:
        """The momenta x1, ..., xn."""
        return self._context.gens()[: self.dim]

    @cached_property
    def symbol_elements(self) -> dict[str, Exact]:
        return dict(zip(self.symbols, self._context.gens()[self.dim :], strict=True))

    @property
    def zero(self) -> Exact:
        return self._context.from_dict({})

    def monomial(self, exponents: Sequence[int]) -> Exact:
        """Return x1^e1 ... xn^en."""
        return self._context.from_dict({(*exponents, *(0,) * len(self.symbols)): 1})

    def from_polynomial(self, argument: Polynomial) -> Exact:
        """Convert a polynomial in n coordinates to an element of the ring; floats are converted exactly."""
        rest = (0,) * len(self.symbols)
        return self._context.from_dict({(*e, *rest): rational(c) for e, c in argument.monomials.items()})

    def polynomial(self, exact: Exact) -> Polynomial:
        """Convert an element without symbols to a `Polynomial` with integer and rational coefficients."""
        monomials = {}
        for exponents, value in exact.to_dict().items():
            if any(exponents[self.dim :]):
                raise ValueError(f"the polynomial contains symbols, {', '.join(self.symbols)}; give them values first")
            monomials[tuple(map(int, exponents[: self.dim]))] = fraction(value)
        return Polynomial(monomials, dim=self.dim)

    def with_symbols(self, exact: Exact) -> Polynomial:
        """Convert an element to a `Polynomial` in the coordinates followed by the symbols."""
        monomials = {tuple(map(int, exponents)): fraction(value) for exponents, value in exact.to_dict().items()}
        return Polynomial(monomials, dim=self.dim + len(self.symbols))

    def about_point(self, F: Exact) -> Exact:
        """Return the Taylor polynomial of a polynomial in the coordinates; F itself without a point."""
        if self._point is None:
            return F
        shifted = [x + rational(float(value)) for x, value in zip(self.coordinates, self._point, strict=True)]
        return self.truncated(F.compose(*shifted, *self.symbol_elements.values()))

    def truncated(self, F: Exact) -> Exact:
        """Return an element without the monomials above the degree, if there is one."""
        if self._degree is None or F.total_degree() <= self._degree:
            return F
        return self._context.from_dict({e: c for e, c in F.to_dict().items() if sum(e[: self.dim]) <= self._degree})

    def gradient(self, F: Exact) -> list[Exact]:
        """Return the derivatives with respect to x1, ..., xn."""
        return [F.derivative(i) for i in range(self.dim)]

    def field(self, H: Exact) -> list[Exact]:
        """Return J(x) grad H, whose i-th entry is {x_i, H}."""
        gradient = self.gradient(H)
        components = [self.zero] * self.dim
        for (i, j), entry in self._entries.items():
            components[i] += entry * gradient[j]
            components[j] -= entry * gradient[i]
        return components

    def bracket(self, F: Exact, G: Exact) -> Exact:
        """Return {F, G} = (grad F)^T J(x) grad G."""
        left, right = self.gradient(F), self.gradient(G)
        total = self.zero
        for (i, j), entry in self._entries.items():
            minor = left[i] * right[j] - left[j] * right[i]
            if minor != 0:
                total += entry * minor
        return total

    def along(self, field: Sequence[Exact], F: Exact) -> Exact:
        """Return the derivative of F along a field."""
        total = self.zero
        for component, derivative in zip(field, self.gradient(F), strict=True):
            if derivative != 0 and component != 0:
                total += component * derivative
        return total

    @cached_property
    def _entries(self) -> dict[tuple[int, int], Exact]:
        """The nonzero entries J_ij, i < j."""
        entries: dict[tuple[int, int], Exact] = {}
        for i, j, k, c in zip(*(np.asarray(column).tolist() for column in self.algebra.triples), strict=True):
            entries[i, j] = entries.get((i, j), self.zero) + rational(c) * self.coordinates[k]
        return {index: self.about_point(entry) for index, entry in entries.items()}


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
        numbers = exact_numbers(read_exact(values[name], name) for name in self.symbols)
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
