"""Has a splitting so many long generators that another scheme is the right one? Told before they are made."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.joins import Integers
from coadjoint.memory import check_room, in_words
from coadjoint.waiting import tell

# A generator with fewer products is one of a lattice, which may have millions of them.
WIDE = 1 << 12
MOST_PRODUCTS = 1 << 24
BYTES_PER_PRODUCT = 150
SECONDS_PER_PRODUCT = 2e-6
# Of one step of order two: two sweeps, each with series of twenty products for each entry.
SECONDS_PER_STEP = 4e-8


class TooWide(ValueError):
    """A splitting would be made ready for minutes, and its steps would take seconds."""


def check_products(products: NDArray[np.int64] | Integers, what: str) -> None:
    """Refuse generators that are added up from too many products, with an estimate.

    Parameters
    ----------
    products : integer array
        How many products the generator of each angle has.
    what : str
        What has them, the subject of the message.

    Raises
    ------
    TooWide
        With seconds, bytes, and what to take in place of it.
    ValueError
        They do not fit into memory.

    Examples
    --------
    >>> check_products(np.full(10**6, 20), "a lattice")
    >>> check_products(np.full(1000, 60_000), "H")
    Traceback (most recent call last):
    coadjoint.program.wide_generators.TooWide: H has 1000 flows of 60000 products each: a splitting would need about
    120 s and 9.0 GB to be made ready, and 2 s for a step; take GaussLegendre, which is made ready at once
    """
    wide = products[products > WIDE]
    total = int(wide.sum())
    if total > MOST_PRODUCTS:
        raise TooWide(
            f"{what} has {len(wide)} flows of {total // len(wide)} products each: a splitting would need about "
            f"{SECONDS_PER_PRODUCT * total:.0f} s and {in_words(BYTES_PER_PRODUCT * total)} to be made ready, and "
            f"{SECONDS_PER_STEP * total:.0f} s for a step; take GaussLegendre, which is made ready at once"
        )
    check_room(BYTES_PER_PRODUCT * total, f"a splitting of {what}", "take GaussLegendre")
    tell(f"making a splitting of {what} ready", SECONDS_PER_PRODUCT * total, "GaussLegendre is made ready at once")
