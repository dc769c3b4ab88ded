"""Polynomials in configuration files, as text or as lists of terms."""

from __future__ import annotations

from typing import Any

from coadjoint.algebra.exact.numbers import TOO_LARGE, fits
from coadjoint.algebra.polynomials import formulas
from coadjoint.algebra.polynomials.formula_parser import Monomials, too_high
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, Polynomial
from coadjoint.short_repr import short


def parse_polynomial(given: Any, dim: int) -> Polynomial:
    """Parse a polynomial in `dim` coordinates, as text or as a list of terms ``[coefficient, [exponent of x1, ...]]``.

    The degree is at most 1024, and coefficients must fit in float64.

    Examples
    --------
    >>> parse_polynomial("0.5*x1^2 - x2*x3", 3)
    0.5*x1^2 - x2*x3
    >>> parse_polynomial([[0.5, [2, 0, 0]], [-1, [0, 1, 1]]], 3)
    0.5*x1^2 - x2*x3
    """
    if isinstance(given, str):
        return formulas.parse_polynomial(given, dim)
    if not isinstance(given, list):
        raise TypeError(f"a polynomial is text such as '0.5*x1^2 + x2*x3' or a list of terms, not {short(given)}")
    total = Monomials(dim)
    for term in given:
        if not (isinstance(term, list) and len(term) == 2 and isinstance(term[1], list)):
            raise TypeError(f"{short(term)} is not a term; write [coefficient, [exponents]], such as [0.5, [2, 0, 0]]")
        coefficient, exponents = term
        if len(exponents) != dim:
            raise ValueError(f"the term {short(term)} has {len(exponents)} exponents; the system has {dim} coordinates")
        for exponent in exponents:
            if type(exponent) is not int:
                raise TypeError(f"the term {short(term)} has the exponent {short(exponent)}; give whole numbers")
        degree = sum(exponents)
        if degree > MAX_DEGREE:
            raise too_high(f"the term {short(term)}", degree)
        if type(coefficient) is int and not fits(coefficient):
            raise ValueError(f"a coefficient {TOO_LARGE}")
        for key, value in Polynomial({tuple(exponents): coefficient}).monomials.items():
            total.add(key, value)
    return total.polynomial()
