"""Cost check of splittings with many long generators, before these are built."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.long_operations import warn_if_long
from coadjoint.memory import check_available_memory, format_bytes

# Generators with fewer products are not counted: lattices may have millions of them.
WIDE = 1 << 12
MAX_PRODUCTS = 1 << 24
BYTES_PER_PRODUCT = 150
SECONDS_PER_PRODUCT = 2e-6
# Per product, for one step of order two: two sweeps, with a series of twenty products per entry.
SECONDS_PER_STEP = 4e-8


class SplittingTooExpensive(ValueError):
    """A splitting would take minutes to prepare, and seconds per step."""


def check_products(products: NDArray[np.int64] | Integers, what: str) -> None:
    """Raise TooWide, with estimates of time and memory, if generators are sums of too many products.

    `products` has the number for each angle; `what` is the subject of the message. Raises ValueError if they exceed
    memory.
    """
    wide = products[products > WIDE]
    total = int(wide.sum())
    if total > MAX_PRODUCTS:
        raise SplittingTooExpensive(
            f"{what} has {len(wide)} flows of {total // len(wide)} products each: a splitting would need about "
            f"{SECONDS_PER_PRODUCT * total:.0f} s and {format_bytes(BYTES_PER_PRODUCT * total)} for its preparation, "
            f"and {SECONDS_PER_STEP * total:.0f} s per step; use GaussLegendre, which needs no preparation"
        )
    check_available_memory(BYTES_PER_PRODUCT * total, f"a splitting of {what}", "take GaussLegendre")
    warn_if_long(
        f"making a splitting of {what} ready", SECONDS_PER_PRODUCT * total, "GaussLegendre is made ready at once"
    )
