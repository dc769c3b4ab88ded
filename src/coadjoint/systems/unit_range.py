"""Validation of physical parameters whose products must stay within float64."""

from __future__ import annotations

from typing import Any

from coadjoint.validation import read_number, read_positive

MAX_MAGNITUDE = 1e30


def read_in_range(value: Any, what: str, zero: bool = False) -> float:
    """Return a positive number between 1e-30 and 1e30, or zero if that is allowed; `what` is its name in messages."""
    if zero and read_number(value, what) == 0.0:
        return 0.0
    number = read_positive(value, what)
    if not 1 / MAX_MAGNITUDE <= number <= MAX_MAGNITUDE:
        raise ValueError(
            f"{what} is {number:g}; take units in which it is between {1 / MAX_MAGNITUDE:g} and {MAX_MAGNITUDE:g}"
        )
    return number
