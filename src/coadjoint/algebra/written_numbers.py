"""Numbers that are written out: whole, decimal, and their quotients."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from coadjoint.algebra.exact import TOO_LARGE, fits

Constant = int | float | Fraction

PLAIN_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
NUMBER = rf"{PLAIN_NUMBER}(?:[eE][+-]?\d+)?"
MOST_DIGITS = 400


def read_constant(written: str) -> Constant:
    """Return a number that is written out: an int where it has digits alone, else a float.

    Examples
    --------
    >>> read_constant("12"), read_constant("1e3")
    (12, 1000.0)
    """
    if not written.isdigit():
        return checked(float(written))
    if len(written) > MOST_DIGITS:
        raise ValueError(f"a number of {len(written)} digits {TOO_LARGE}")
    return checked(int(written))


def quotient(above: Constant, below: Constant) -> Constant:
    """Return above/below: exact where both are, else a float.

    Examples
    --------
    >>> quotient(1, 3), quotient(1.0, 4)
    (Fraction(1, 3), 0.25)
    """
    exact = not isinstance(above, float) and not isinstance(below, float)
    return Fraction(above) / Fraction(below) if exact else checked(float(above) / float(below))


def checked(value: Constant) -> Any:
    """Return a number, or refuse it where float64 does not hold it."""
    if not fits(value):
        raise too_large()
    return value


def too_large() -> ValueError:
    """Return the error for a number that float64 does not hold."""
    return ValueError(f"a number {TOO_LARGE}")
