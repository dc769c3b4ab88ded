"""Step-size selection for Taylor series, and motions in such steps: ``taylor_variable.cpp`` in Python."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.methods.formal.power_series import Dual, expand
from coadjoint.rounding import UNIT_ROUNDOFF

DECIDING_TERMS = 4  # number of last and of middle terms that determine the length
LN2 = 0.6931471805599453
NO_LIMIT = 900.0  # binary logarithm of the largest length
MOST_STEPS = 1_000_000
TOO_MANY_STEPS_MESSAGE = "or more than 2^24 of its own steps would lie in one step of the run: give a smaller step"
"""End of the messages about motions for which no next step exists; the limit is that of the kernels."""
TOO_SHORT_MESSAGE = (
    "the motion becomes so fast that steps no longer change the time: it blows up, or nearly so; "
    + TOO_MANY_STEPS_MESSAGE
)


def near_log2(a: float) -> float:
    """Return the binary logarithm of a positive number, within 2e-5; -1022 for zero."""
    if a < 2.0**-1022:
        return -1022.0
    half, exponent = math.frexp(a)
    z = (2.0 * half - 1.0) / (2.0 * half + 1.0)
    zz = z * z
    series = 2.885390081777927 + zz * (0.9617966939259757 + zz * (0.5770780163555854 + zz * 0.41219858311113244))
    return float(exponent - 1) + z * series


def near_power_of_two(a: float) -> float:
    """Return 2^a for a from -1000 to 1000, with a relative error of 4e-6."""
    whole = math.floor(a + 0.5)
    r = (a - whole) * LN2
    series = 1.0 + r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0))))
    return math.ldexp(1.0 + r * series, whole)


def logarithm_of_step(sizes: Sequence[float], largest: float, tolerance: float) -> float:
    """Return the binary logarithm of the length of a step, relative to the time h of the terms x_1 h, ..., x_p h^p.

    At this length the last terms are `tolerance` times `largest` (the largest state so far) if the terms decay
    geometrically from `largest`; the last four terms are tested, since even or odd ones may vanish. The length is at
    most half the radius of convergence, estimated from the middle and last terms: the truncation error is then less
    than the last term, and decaying motions decay in the series too. Source: A. Jorba, M. Zou, Experimental Mathematics
    14 (2005), section 3.2.
    """
    order = len(sizes)
    last = range(max(1, order + 1 - DECIDING_TERMS), order + 1)
    whole, biggest = near_log2(largest), max(sizes[k - 1] for k in last)
    radius = min(((whole - near_log2(sizes[k - 1])) / k for k in last if sizes[k - 1] > 0.0), default=2.0 * NO_LIMIT)
    length = min(radius, 2.0 * NO_LIMIT) + near_log2(tolerance) / order
    if order >= 2 * DECIDING_TERMS and biggest > 0.0:
        middle = max(sizes[order // 2 - DECIDING_TERMS : order // 2])
        if middle > 0.0:
            converging = (near_log2(middle) - near_log2(biggest)) / (order - order // 2)
            length = min(length, converging - 1.0)
    return max(min(length, NO_LIMIT), -NO_LIMIT)


def advance_by_own_steps(
    field: Callable[[NDArray[Any]], NDArray[Any]],
    x: NDArray[Any],
    h: Any,
    order: int,
    tolerance: float,
    to_level_set: Callable[[NDArray[Any]], NDArray[Any]],
) -> NDArray[Any]:
    """Return the state after a time h of either sign, in steps whose length is chosen from the series.

    The field consists of sums and products; the entries of x are numbers of one type, or `Dual`. `tolerance` is the
    error of a step relative to the largest state so far; `to_level_set`, a projection, is applied to the end of each
    step. Raise IntegrationError if steps no longer change the time.

    Examples
    --------
    The motion x' = x^2 from 1, at t = 1/2:

    >>> end = advance_by_own_steps(lambda x: x * x, np.array([1.0], dtype=object), 0.5, 12, 1e-12, lambda z: z)
    >>> bool(abs(end[0] - 2) < 1e-10)
    True
    """
    since, largest, scale = h * 0, 0.0, _time_of_change(field, x, h)
    for _ in range(MOST_STEPS):
        largest = max(largest, _size(x))
        terms = expand(field, x, scale, order)
        length = scale * near_power_of_two(logarithm_of_step([_size(term) for term in terms], largest, tolerance))
        ahead = h - since
        if abs(ahead) <= abs(length):
            return to_level_set(x + _sum(terms, ahead / scale))
        x = to_level_set(x + _sum(terms, length / scale))
        since = since + length
        if not abs(length) > UNIT_ROUNDOFF * abs(since):
            break
        scale = math.copysign(2.0 ** math.floor(near_log2(abs(length))), float(h))
    raise IntegrationError(TOO_SHORT_MESSAGE, step=1, time=float(since), residual=float(length))


def _time_of_change(field: Callable[[NDArray[Any]], NDArray[Any]], x: NDArray[Any], h: Any) -> float:
    """Return the approximate time in which the state changes by its own size, a power of two with the sign of h."""
    fast, size = _size(expand(field, x, 1.0, 1)[0]), _size(x)
    return math.copysign(2.0 ** math.floor(near_log2(size) - near_log2(fast)) if fast > 0.0 else 1.0, float(h))


def _sum(terms: Sequence[NDArray[Any]], s: Any) -> NDArray[Any]:
    """Return the sum of terms[k - 1] s^k, by Horner's scheme."""
    total = terms[-1] * s
    for term in reversed(terms[:-1]):
        total = (total + term) * s
    return total


def _size(x: NDArray[Any]) -> float:
    return float(np.sum([abs(float(v.value if isinstance(v, Dual) else v)) for v in x]))
