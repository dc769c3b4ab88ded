"""Formatting of polynomials: plain text, LaTeX, SymPy expressions."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.optional_packages import require_packages
from coadjoint.validation import MAX_TITLE_LENGTH, read_list, read_title

Monomials = Mapping[tuple[int, ...], Coefficient]
MAX_DIGITS = 6  # of numbers that are shown, as of format "g"
MAX_SHOWN = 30  # monomials printed individually


def coordinate_names(dim: int) -> list[str]:
    """Return the names x1, ..., xn."""
    return [f"x{i}" for i in range(1, dim + 1)]


def names_of_basis(basis: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the coordinates for those of the basis elements; e1, e2, ... become x1, x2, ..."""
    return tuple(re.sub(r"^e(?=\d)", "x", name) for name in basis)


def read_names(names: Any, dim: int) -> tuple[str, ...]:
    """Validate names of the coordinates of a polynomial."""
    given = read_list(names, "names", "give one name for each coordinate")
    if len(given) != dim:
        raise ValueError(f"names has {len(given)} entries; this Polynomial has {dim} coordinates")
    # Each Casimir gets the names of all spins, which are tested together.
    if not (
        set(map(type, given)) <= {str}
        and all(given)
        and "".join(given).isprintable()
        and max(map(len, given)) <= MAX_TITLE_LENGTH
    ):
        for name in given:
            read_title(name, "a name of a coordinate")
    return given


def special_names(names: tuple[str, ...]) -> tuple[str, ...] | None:
    """Return names of coordinates; None if they are x1, ..., xn."""
    return None if all(name == f"x{i}" for i, name in enumerate(names, 1)) else names


def plain(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial in the notation that `Polynomial` parses.

    Examples
    --------
    >>> plain({(2, 0): 0.5, (1, 1): -1}, ["x", "y"])
    '0.5*x^2 - x*y'
    """
    return _format_sum(monomials, names, "{0}^{1}", "*", "({0}/{1})", str)


def latex(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial as LaTeX, without dollar signs."""
    factors = [latex_name(name) for name in names]
    braced = [f"{{{factor}}}" if "^" in factor else factor for factor in factors]
    return _format_sum(monomials, braced, "{0}^{{{1}}}", " ", r"\frac{{{0}}}{{{1}}}", _latex_number)


GREEK = ("alpha", "beta", "gamma", "theta", "phi", "psi", "omega", "mu", "rho", "sigma")


def latex_name(name: str) -> str:
    """Format the name of a coordinate or symbol: x12 as x_{12}, m1_2 as m_{1,2}; other forms of names are unchanged."""
    match = re.fullmatch(r"([A-Za-z]+?)_?(\d[\d_,]*)?(\[\d+\])?", name)
    if match is None:
        return name
    letters = rf"\{match[1]}" if match[1] in GREEK else match[1]
    subscript = f"_{{{match[2].replace('_', ',')}}}" if match[2] else ""
    superscript = f"^{{{match[3]}}}" if match[3] else ""
    return f"{letters}{subscript}{superscript}"


def sympy_of(monomials: Monomials, names: Sequence[str]) -> Any:
    """Return a SymPy expression in symbols of the given names; fractions stay exact."""
    require_packages("an expression of SymPy", "sympy")
    import sympy

    symbols = [sympy.Symbol(name) for name in names]  # sympy.symbols would split names with commas or brackets
    total = sympy.Integer(0)
    for exponents, value in monomials.items():
        exact = Fraction(value)
        number = sympy.Float(value) if isinstance(value, float) else sympy.Rational(exact.numerator, exact.denominator)
        total += sympy.Mul(number, *(symbol**power for symbol, power in zip(symbols, exponents, strict=True) if power))
    return total


def readable(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial on one line with short coefficients; only a count if it has many monomials."""
    if len(monomials) > MAX_SHOWN:
        return f"<{len(monomials)} monomials of degree {max(map(sum, monomials))} and less>"
    return plain(rounded_if_long(monomials), names)


def readable_latex(monomials: Monomials, names: Sequence[str]) -> str:
    """Format a polynomial as LaTeX with short coefficients, without dollar signs."""
    if len(monomials) > MAX_SHOWN:
        return rf"\text{{{len(monomials)} monomials}}"
    return latex(rounded_if_long(monomials), names)


def rounded_if_long(monomials: Monomials) -> dict[tuple[int, ...], Coefficient]:
    """Round coefficients with more than six digits to six; keep short fractions."""
    return {exponents: _readable(value) for exponents, value in monomials.items()}


def _readable(value: Coefficient) -> Coefficient:
    if isinstance(value, float) or max(abs(Fraction(value).numerator), Fraction(value).denominator) >= 10**MAX_DIGITS:
        return float(f"{float(value):.{MAX_DIGITS}g}")
    return value


def _format_sum(
    monomials: Monomials,
    names: Sequence[str],
    power: str,
    separator: str,
    quotient: str,
    number: Callable[[Coefficient], str],
) -> str:
    text = ""
    for exponents, value in monomials.items():
        factors = [name if e == 1 else power.format(name, e) for name, e in zip(names, exponents, strict=True) if e]
        size: Any = abs(value)
        if size != 1 or not factors:
            is_quotient = isinstance(size, Fraction) and size.denominator != 1
            factors.insert(0, quotient.format(size.numerator, size.denominator) if is_quotient else number(size))
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        text += sign + separator.join(factors)
    return text or "0"


def _latex_number(size: Coefficient) -> str:
    digits, _, exponent = f"{size}".partition("e")
    return rf"{digits} \times 10^{{{int(exponent)}}}" if exponent else digits
