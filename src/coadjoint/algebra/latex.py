"""Polynomials as mathematics, for LaTeX."""

from __future__ import annotations

from fractions import Fraction

from coadjoint.algebra.polynomial import Polynomial

SHORT = 10**6  # denominators up to this are shown as fractions


def latex_of(polynomial: Polynomial) -> str:
    r"""Return a polynomial in LaTeX: short fractions as they are, other coefficients to twelve digits.

    Examples
    --------
    >>> print(latex_of(Polynomial({(2, 0): Fraction(1, 2), (0, 11): -1})))
    \frac{1}{2} x_{1}^{2} - x_{2}^{11}
    """
    text = ""
    for exponents, value in polynomial.monomials.items():
        factors = [f"x_{{{i}}}" + (f"^{{{e}}}" if e > 1 else "") for i, e in enumerate(exponents, 1) if e]
        size = abs(Fraction(value))
        if size != 1 or not factors:
            factors.insert(0, _number(size))
        sign = ("-" if value < 0 else "") if not text else (" - " if value < 0 else " + ")
        text += sign + " ".join(factors)
    return text or "0"


def _number(size: Fraction) -> str:
    if size.denominator == 1 and size.numerator < SHORT:
        return str(size.numerator)
    if size.denominator <= SHORT:
        return rf"\frac{{{size.numerator}}}{{{size.denominator}}}"
    mantissa, _, exponent = f"{float(size):.12g}".partition("e")
    return mantissa + (rf" \cdot 10^{{{int(exponent)}}}" if exponent else "")
