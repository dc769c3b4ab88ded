"""How is a polynomial given in a configuration file? As text, or as a list of terms."""

from __future__ import annotations

from typing import Any

from coadjoint.algebra import formulas
from coadjoint.algebra.exact import TOO_LARGE, fits
from coadjoint.algebra.formula_reader import Monomials, too_high
from coadjoint.algebra.polynomial import MOST_DEGREE, Polynomial
from coadjoint.wording import short


def read_polynomial(given: Any, dim: int) -> Polynomial:
    """Return the polynomial that a file gives, as text or as a list of terms.

    Parameters
    ----------
    given : str or list
        Text as `coadjoint.algebra.formulas.read_polynomial` takes it, such as ``"0.5*x1^2 - x2*x3 + 1/3"``, or a list
        of terms ``[coefficient, [exponent of x1, exponent of x2, ...]]``.
    dim : int
        Number of coordinates.

    Returns
    -------
    Polynomial

    Raises
    ------
    ValueError, TypeError
        Naming the place in the text, or the term, that is wrong; a degree above 1024, or a coefficient that float64
        does not hold.

    Examples
    --------
    >>> read_polynomial("0.5*x1^2 - x2*x3", 3)
    0.5*x1^2 - x2*x3
    >>> read_polynomial([[0.5, [2, 0, 0]], [-1, [0, 1, 1]]], 3)
    0.5*x1^2 - x2*x3
    """
    if isinstance(given, str):
        return formulas.read_polynomial(given, dim)
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
        if degree > MOST_DEGREE:
            raise too_high(f"the term {short(term)}", degree)
        if type(coefficient) is int and not fits(coefficient):
            raise ValueError(f"a coefficient {TOO_LARGE}")
        for key, value in Polynomial({tuple(exponents): coefficient}).monomials.items():
            total.add(key, value)
    return total.polynomial()
