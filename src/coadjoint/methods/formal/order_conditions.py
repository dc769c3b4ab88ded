"""Order of compositions, from the order conditions in the free associative algebra."""

from __future__ import annotations

from collections.abc import Sequence

from coadjoint.algebra.exact.free_algebra import Series, exponential, one, product
from coadjoint.rounding import UNIT_ROUNDOFF

HIGHEST_ORDER = 12


def composition_order(coefficients: Sequence[float], base_order: int) -> int:
    """Return the order of a composition of a symmetric map of even order p, at most 12 or p.

    The base is exp(h Y_1 + h^(p+1) Y_(p+1) + h^(p+3) Y_(p+3) + ...) with free Y's; the product is compared with exp(h
    Y_1) word by word.
    """
    highest = max(HIGHEST_ORDER, base_order)
    letters = [1, *range(base_order + 1, highest + 1, 2)]

    def exponential_of(coefficients: dict[int, float]) -> Series:
        return exponential([{(d,): coefficients[d]} if d in coefficients else {} for d in range(highest + 1)])

    found = one(highest)
    for c in coefficients:
        found = product(found, exponential_of({d: c**d for d in letters}))
    exact = exponential_of({1: 1.0})
    scale = max(1.0, max(map(abs, coefficients)))
    for order in range(base_order + 1, highest + 1):
        words = found[order].keys() | exact[order].keys()
        # Rounding of the coefficients changes a condition by u times the sum of its terms.
        tolerance = UNIT_ROUNDOFF * 8 * len(coefficients) * scale**order
        if any(abs(found[order].get(word, 0.0) - exact[order].get(word, 0.0)) > tolerance for word in words):
            return order - 1
    return highest
