"""Which order has a composition? The order conditions, in the free associative algebra."""

from __future__ import annotations

from collections.abc import Sequence

from coadjoint.rounding import UNIT_ROUNDOFF

HIGHEST_ORDER = 12


def composition_order(coefficients: Sequence[float], base_order: int) -> int:
    """Return the order of a composition of a symmetric map of even order.

    The base is exp(h Y_1 + h^(p+1) Y_(p+1) + h^(p+3) Y_(p+3) + ...) with free Y's; the product is compared with exp(h
    Y_1) word by word.

    Parameters
    ----------
    coefficients : sequence of float
        The fractions of the step.
    base_order : int
        Order p of the symmetric base.

    Returns
    -------
    int
        The order, at most 12 or that of the base.

    Examples
    --------
    >>> composition_order((0.5, 0.5), 2)
    2
    """
    highest = max(HIGHEST_ORDER, base_order)
    letters = [1, *range(base_order + 1, highest + 1, 2)]
    product: dict[tuple[int, ...], float] = {(): 1.0}
    for c in coefficients:
        product = _multiply(product, _exponential({(d,): c**d for d in letters}, highest), highest)
    exact = _exponential({(1,): 1.0}, highest)
    scale = max(1.0, max(map(abs, coefficients)))
    for order in range(base_order + 1, highest + 1):
        words = {word for word in product.keys() | exact.keys() if sum(word) == order}
        # Rounding of the coefficients themselves moves a condition by u times the sum of the terms in it.
        tolerance = UNIT_ROUNDOFF * 8 * len(coefficients) * scale**order
        if any(abs(product.get(word, 0.0) - exact.get(word, 0.0)) > tolerance for word in words):
            return order - 1
    return highest


Series = dict[tuple[int, ...], float]


def _multiply(left: Series, right: Series, highest: int) -> Series:
    result: Series = {}
    for a, x in left.items():
        for b, y in right.items():
            if sum(a) + sum(b) <= highest:
                result[a + b] = result.get(a + b, 0.0) + x * y
    return result


def _exponential(exponent: Series, highest: int) -> Series:
    result: Series = {(): 1.0}
    power: Series = {(): 1.0}
    for k in range(1, highest + 1):
        power = {word: value / k for word, value in _multiply(power, exponent, highest).items()}
        for word, value in power.items():
            result[word] = result.get(word, 0.0) + value
    return result
