"""Number literals: whole, decimal, and their quotients."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from coadjoint.algebra.exact.numbers import TOO_LARGE, fits

Constant = int | float | Fraction

PLAIN_NUMBER = r"(?:\d+\.?\d*|\.\d+)"
NUMBER = rf"{PLAIN_NUMBER}(?:[eE][+-]?\d+)?"
MAX_DIGITS = 400


def parse_number(written: str) -> Constant:
    """Parse a number: int if it consists of digits, else float."""
    if not written.isdigit():
        return checked(float(written))
    if len(written) > MAX_DIGITS:
        raise ValueError(f"a number of {len(written)} digits {TOO_LARGE}")
    return checked(int(written))


def quotient(above: Constant, below: Constant) -> Constant:
    """Return above/below: exact if both are, else a float.

    Examples
    --------
    >>> quotient(1, 3), quotient(1.0, 4)
    (Fraction(1, 3), 0.25)
    """
    exact = not isinstance(above, float) and not isinstance(below, float)
    return Fraction(above) / Fraction(below) if exact else checked(float(above) / float(below))


def checked(value: Constant) -> Any:
    """Return a number, or raise a ValueError if it is beyond float64."""
    if not fits(value):
        raise too_large()
    return value


def too_large() -> ValueError:
    """Return the error for a number beyond float64."""
    return ValueError(f"a number {TOO_LARGE}")
