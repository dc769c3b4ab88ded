"""Modified Bessel functions K0 and K1 of arguments whose squares are given, for functions that are compiled."""

from __future__ import annotations

from collections.abc import Sequence
from math import factorial, pi
from typing import Any

import numpy as np

# Sums, products, quotients and roots alone, which every machine rounds in the same way; the last bits of log and exp of
# the C library differ.

EULER = 0.5772156649015329
LN2, LN2_HIGH, LN2_LOW = 0.6931471805599453, 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""The logarithm of 2, and as a sum whose first part has zeros at its end: multiples of it up to 2^20 are exact."""
UNDERFLOW = 750.0
"""Arguments from which on exp(-u) is zero."""
TERMS = 11  # of each series for arguments up to 1: (1/4)^11/(11!)^2 is 1.5e-22
DOUBLINGS = tuple((2.0 ** (2**k), float(2**k)) for k in reversed(range(10)))
OF_LOGARITHM = tuple(2.0 / (2 * k + 1) for k in reversed(range(12)))  # atanh z at |z| < 0.172, to 1e-19
OF_EXPONENTIAL = tuple(1.0 / factorial(k) for k in reversed(range(15)))  # at |r| < 0.347, to 1e-19


def _digamma(n: int) -> float:
    """Return the logarithmic derivative of the factorial of n - 1."""
    return sum(1.0 / k for k in range(1, n)) - EULER


OF_I0 = tuple(1.0 / factorial(k) ** 2 for k in reversed(range(TERMS)))
OF_I1 = tuple(1.0 / (factorial(k) * factorial(k + 1)) for k in reversed(range(TERMS)))  # 2 I1(u)/u
OF_K0 = tuple(_digamma(k + 1) / factorial(k) ** 2 for k in reversed(range(TERMS)))
OF_K1 = tuple(
    (_digamma(k + 1) + _digamma(k + 2)) / (4.0 * factorial(k) * factorial(k + 1)) for k in reversed(range(TERMS))
)
# exp(u) sqrt(2 u/pi) K(u) as quotients of polynomials of 1/u, which interpolate them at 21 Chebyshev points of [0, 1];
# the errors are 2e-17 and 3e-17. All coefficients are positive, so that nothing cancels. The highest power is first.
ABOVE_0 = (
    *(0.013793538599729505, 1.7198543621859275, 34.33340019032607, 237.9070877392144, 745.4586812874437),
    *(1198.628325938974, 1053.496640632629, 517.2713312807276, 139.24153668850226, 18.915923035761097, 1.0),
)
BELOW_0 = (
    *(0.05025538179708416, 3.2090040961494894, 49.39505091221372, 297.66206988794073, 857.8325251580183),
    *(1308.504065262776, 1111.5387183353878, 533.6996760130614, 141.5513395679753, 19.04092303576108, 1.0),
)
ABOVE_1 = (
    *(0.09793442392714755, 4.757053274649975, 61.15918217133457, 326.9006017716677, 874.1981854918773),
    *(1279.7731155014396, 1068.6137301189256, 512.4618587026013, 137.11085718963727, 18.71246384146279, 1.0),
)
BELOW_1 = (
    *(0.006869176587715078, 1.0569534037009252, 23.255519422801616, 173.45094933963543, 578.5597326251832),
    *(983.0104696475412, 907.5432738657274, 465.6264302784156, 130.35149574908456, 18.337463841462814, 1.0),
)


def _polynomial(coefficients: Sequence[float], x: Any) -> Any:
    """Return a polynomial, the highest power first."""
    total = 0.0 * x
    for coefficient in coefficients:
        total = total * x + coefficient
    return total


def _logarithm(s: Any) -> Any:
    """Return the logarithm of numbers up to 1."""
    if s <= 0.0:
        return np.log(s)
    rest, halvings = s, 0.0
    for factor, doublings in DOUBLINGS:
        if rest * factor <= 1.4142135623730951:
            rest, halvings = rest * factor, halvings + doublings
    z = (rest - 1.0) / (rest + 1.0)
    return (z * _polynomial(OF_LOGARITHM, z * z) - halvings * LN2_LOW) - halvings * LN2_HIGH


def _falling_exponential(u: Any) -> Any:
    """Return exp(-u) of numbers from 1 to `UNDERFLOW`."""
    halvings = int(u / LN2 + 0.5)
    rest = (u - halvings * LN2_HIGH) - halvings * LN2_LOW
    value, factor = _polynomial(OF_EXPONENTIAL, -rest), 0.5
    while halvings > 0:
        if halvings % 2 == 1:
            value = value * factor
        factor, halvings = factor * factor, halvings // 2
    return value


def _beyond_one(u: Any, above: Sequence[float], below: Sequence[float]) -> Any:
    """Return K of numbers above 1, or NaN."""
    if not u < UNDERFLOW:
        return 0.0 / u
    w = 1.0 / u
    return np.sqrt(0.5 * pi * w) * _falling_exponential(u) * (_polynomial(above, w) / _polynomial(below, w))


def k0(s: Any) -> Any:
    """Return ``K0(sqrt(s))``."""
    if s <= 1.0:
        q = 0.25 * s
        return _polynomial(OF_K0, q) - 0.5 * _logarithm(q) * _polynomial(OF_I0, q)
    return _beyond_one(np.sqrt(s), ABOVE_0, BELOW_0)


def k1_over_argument(s: Any) -> Any:
    """Return ``K1(u)/u`` of ``u = sqrt(s)``."""
    if s <= 1.0:
        q = 0.25 * s
        return 1.0 / s + (0.25 * _logarithm(q) * _polynomial(OF_I1, q) - _polynomial(OF_K1, q))
    u = np.sqrt(s)
    return _beyond_one(u, ABOVE_1, BELOW_1) / u
