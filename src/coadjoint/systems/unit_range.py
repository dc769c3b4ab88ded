"""Is a quantity of a size whose products stay within float64? Else other units are asked for."""

from __future__ import annotations

from typing import Any

from coadjoint.given import read_number, read_positive

LARGEST = 1e30


def read_in_range(value: Any, what: str, zero: bool = False) -> float:
    """Return a positive number between 1e-30 and 1e30; or zero, if that is allowed.

    Parameters
    ----------
    value : object
        What was given.
    what : str
        What it is called in messages.
    zero : bool
        Whether zero is allowed.

    Returns
    -------
    float

    Raises
    ------
    TypeError, ValueError
        Something else.

    Examples
    --------
    >>> read_in_range(2, "mass"), read_in_range(0, "gravity", zero=True)
    (2.0, 0.0)
    """
    if zero and read_number(value, what) == 0.0:
        return 0.0
    number = read_positive(value, what)
    if not 1 / LARGEST <= number <= LARGEST:
        raise ValueError(f"{what} is {number:g}; take units in which it is between {1 / LARGEST:g} and {LARGEST:g}")
    return number
