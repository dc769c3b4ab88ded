"""Times at which a coordinate changes its sign."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.kinds import shape_of

Floats = npt.NDArray[np.float64]

HALVINGS = 52


def flips(system: Any, t: Floats, x: Floats, i: int, most: int | None = None) -> Floats:
    """Return the times, in the order of t, at which coordinate i of a motion crosses zero; the first `most` of them.

    Between two points the motion is the cubic through both with the slopes of the field, with an error of fourth order.
    """
    values = x[:, i]
    places = np.flatnonzero((values[:-1] != 0.0) & (np.sign(values[:-1]) * np.sign(values[1:]) <= 0.0))
    shape = shape_of(system)
    found = []

    def slope(q: int) -> float:
        # Complex matrices are given as interleaved real and imaginary parts.
        state = x[q] if x.shape[1] == np.prod(shape) else np.ascontiguousarray(x[q]).view(np.complex128)
        rate = np.ascontiguousarray(system.vector_field(state.reshape(shape), float(t[q])), dtype=state.dtype)
        return float(rate.view(np.float64).ravel()[i])

    for p in places[:most]:
        dt = float(t[p + 1] - t[p])
        before, after = (dt * slope(q) for q in (p, p + 1))
        found.append(float(t[p]) + dt * _root(float(values[p]), float(values[p + 1]), before, after))
    return np.array(found)


def _root(a: float, b: float, slope: float, end_slope: float) -> float:
    """Return the zero in [0, 1] of a cubic Hermite polynomial with a change of sign, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        s = 0.5 * (low + high)
        r = 1.0 - s
        value = a * r * r * (1 + 2 * s) + b * s * s * (3 - 2 * s) + s * r * (slope * r - end_slope * s)
        low, high = (s, high) if (value > 0.0) == (a > 0.0) else (low, s)
    return 0.5 * (low + high)
