"""Vectorized search for roots and minima of many functions of one variable on [0, 1]."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Values = Callable[[NDArray[np.int64], Floats], Floats]

MAX_ROUNDS = 200
"""Limit on the rounds of a search; a root takes about seven (bisection down to the smallest float: 1074)."""
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)
"""Part of the bracket that a round of the golden-section search keeps."""
MIN_BRACKET = 2.0**-26
"""Bracket width at a minimum below which function values are indistinguishable, sqrt(2^-52)."""


def roots(values: Values, before: Floats, after: Floats, resolution: Floats) -> Floats:
    """Find a root of each of m functions by inverse quadratic interpolation and bisection, independently of the others.

    ``values(indices, theta)`` evaluates some of the functions; `before` and `after` (m,) are the values at 0 and 1, of
    different signs (`after` may be zero); `resolution` (m,) is that of theta. T. R. Chandrupatla, Adv. Eng. Softw. 28
    (1997) 145-149; the first point is that of the secant.

    Examples
    --------
    >>> one = np.array([1.0])
    >>> float(roots(lambda indices, theta: theta**3 - 0.125, -0.125 * one, 0.875 * one, 2.0**-50 * one)[0])
    0.5
    """
    found = np.ones(len(before))
    indices = np.flatnonzero(after != 0.0)
    a, b, fa, fb = np.ones(len(indices)), np.zeros(len(indices)), after[indices], before[indices]
    with np.errstate(invalid="ignore", over="ignore"):
        secant = fa / (fa - fb)
    t = np.clip(np.where(np.isfinite(secant), secant, 0.5), 0.01, 0.99)
    for _ in range(MAX_ROUNDS):
        if not len(indices):
            break
        middle = a + t * (b - a)
        fm = values(indices, middle)
        same = np.sign(fm) == np.sign(fa)
        c, fc = np.where(same, a, b), np.where(same, fa, fb)
        b, fb = np.where(same, b, a), np.where(same, fb, fa)
        a, fa = middle, fm
        best = np.where(np.abs(fa) < np.abs(fb), a, b)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            least_t = resolution[indices] / np.abs(b - a)
            done = (least_t > 0.5) | (fa == 0.0) | np.isnan(fm)
            xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
            quadratic = fa / (fb - fa) * (fc / (fb - fc)) + (c - a) / (b - a) * (fa / (fc - fa)) * (fb / (fc - fb))
            accepted = (phi * phi < xi) & ((1.0 - phi) ** 2 < 1.0 - xi)
            t = np.clip(np.where(accepted, quadratic, 0.5), least_t, 1.0 - least_t)
        found[indices] = np.where(fa == 0.0, a, best)
        if done.any():
            active = ~done
            indices, a, b, fa, fb, t = indices[active], a[active], b[active], fa[active], fb[active], t[active]
    return found


def minimize_each(values: Values, count: int) -> tuple[Floats, Floats]:
    """Minimize functions that are positive at 0 and at 1 by golden sections; stop at a value that is not positive.

    `values` as for `roots`; exact for unimodal functions. Return theta and value, (count,).

    Examples
    --------
    >>> theta, value = minimize_each(lambda indices, theta: (theta - 0.25) ** 2 + 1.0, 1)
    >>> abs(float(theta[0]) - 0.25) < 1e-6, float(value[0])
    (True, 1.0)
    """
    position, smallest = np.ones(count), np.full(count, np.inf)
    indices = np.arange(count)
    low, high = np.zeros(count), np.ones(count)
    left, right = high - GOLDEN, low + GOLDEN
    at_left, at_right = values(indices, left), values(indices, right)
    while len(indices):
        lower = at_left < at_right
        position[indices], smallest[indices] = np.where(lower, left, right), np.where(lower, at_left, at_right)
        active = (smallest[indices] > 0.0) & (high - low > MIN_BRACKET)
        indices, low, high, lower = indices[active], low[active], high[active], lower[active]
        left, right, at_left, at_right = left[active], right[active], at_left[active], at_right[active]
        if not len(indices):
            break
        low, high = np.where(lower, low, left), np.where(lower, right, high)
        probe = np.where(lower, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        value = values(indices, probe)
        left, right = np.where(lower, probe, right), np.where(lower, left, probe)
        at_left, at_right = np.where(lower, value, at_right), np.where(lower, at_left, value)
    return position, smallest
