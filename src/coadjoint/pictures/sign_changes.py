"""Times at which a coordinate changes its sign."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

BISECTIONS = 52


def flips(field: Callable[[Floats, float], Floats], t: Floats, x: Floats, i: int, most: int | None = None) -> Floats:
    """Return the times, in the order of t, at which coordinate i of a motion crosses zero; the first `most` of them.

    Between two points the motion is the cubic through both with the slopes `field(x, t)`; its error is of order four.
    """
    values = x[:, i]
    places = np.flatnonzero((values[:-1] != 0.0) & (np.sign(values[:-1]) * np.sign(values[1:]) <= 0.0))
    found = []
    for p in places[:most]:
        dt = float(t[p + 1] - t[p])
        before, after = (dt * float(field(x[q], float(t[q]))[i]) for q in (p, p + 1))
        found.append(float(t[p]) + dt * _root(float(values[p]), float(values[p + 1]), before, after))
    return np.array(found)


def _root(a: float, b: float, slope: float, end_slope: float) -> float:
    """Return the zero in [0, 1] of a cubic Hermite polynomial with a change of sign, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        s = 0.5 * (low + high)
        r = 1.0 - s
        value = a * r * r * (1 + 2 * s) + b * s * s * (3 - 2 * s) + s * r * (slope * r - end_slope * s)
        low, high = (s, high) if (value > 0.0) == (a > 0.0) else (low, s)
    return 0.5 * (low + high)
