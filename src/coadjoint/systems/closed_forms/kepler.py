"""Closed-form solution of Kepler's problem, by universal variables."""

from __future__ import annotations

from math import cos, cosh, factorial, inf, pi, sin, sinh, sqrt

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF

Floats = npt.NDArray[np.float64]

MAX_ITERATIONS = 200  # of doublings, and of Newton's method within a bracket, which 64 halvings close to round-off
SERIES = 12  # number of terms; the next is below round-off for |z| <= 1


def kepler(r: Floats, v: Floats, gravity: float, times: Floats) -> tuple[Floats, Floats]:
    """Return positions and velocities, (k, 3) each, of ``r'' = -gravity r/|r|^3`` at times (k,), on any conic."""
    # By universal variables: R. Battin, "An Introduction to the Mathematics and Methods of Astrodynamics" (1999), 4.5.
    if not np.any(np.cross(r, v)):
        raise ValueError("the orbit is radial and has no closed form; integrate it")
    distance, r_dot_v = sqrt(float(r @ r)), float(r @ v) / sqrt(gravity)
    alpha = 2.0 / distance - float(v @ v) / gravity  # inverse semi-major axis; negative on a hyperbola
    states = [_propagate(r, v, gravity, distance, r_dot_v, alpha, float(t)) for t in times]
    return np.array([x for x, _ in states]).reshape(-1, 3), np.array([y for _, y in states]).reshape(-1, 3)


def _propagate(
    r: Floats, v: Floats, gravity: float, distance: float, r_dot_v: float, alpha: float, t: float
) -> tuple[Floats, Floats]:
    root = sqrt(gravity)
    if alpha > 0.0:
        t = float(np.remainder(t, 2.0 * pi / (root * alpha * sqrt(alpha))))
    if t < 0.0:
        position, velocity = _propagate(r, -v, gravity, distance, -r_dot_v, alpha, -t)
        return position, -velocity
    s = _universal_anomaly(distance, r_dot_v, alpha, root * t)
    c2, c3 = _stumpff(alpha * s * s)
    u2, u3 = s * s * c2, s * s * s * c3
    radius = distance + r_dot_v * (s - alpha * u3) + (1.0 - alpha * distance) * u2
    f, g = 1.0 - u2 / distance, t - u3 / root
    slope_f, slope_g = root / (distance * radius) * s * (alpha * s * s * c3 - 1.0), 1.0 - u2 / radius
    return f * r + g * v, slope_f * r + slope_g * v


def _universal_anomaly(distance: float, r_dot_v: float, alpha: float, target: float) -> float:
    """Solve ``distance s + r_dot_v s^2 c2 + (1 - alpha distance) s^3 c3 = target``, increasing in s, for s."""

    def residual(s: float) -> tuple[float, float]:
        c2, c3 = _stumpff(alpha * s * s)
        u2, u3 = s * s * c2, s * s * s * c3
        slope = distance + r_dot_v * (s - alpha * u3) + (1.0 - alpha * distance) * u2
        return distance * s + r_dot_v * u2 + (1.0 - alpha * distance) * u3 - target, slope

    low, high = 0.0, target / distance
    for _ in range(MAX_ITERATIONS):
        if residual(high)[0] >= 0.0:
            break
        low, high = high, 2.0 * high
    s = high
    for _ in range(MAX_ITERATIONS):
        value, slope = residual(s)
        low, high = (low, s) if value >= 0.0 else (s, high)
        newton = s - value / slope if 0.0 < slope < inf else inf
        middle = 0.5 * (low + high)
        new = newton if low < newton < high else middle
        if abs(new - s) <= 2.0 * UNIT_ROUNDOFF * abs(s):
            return new
        s = new
    return s


def _stumpff(z: float) -> tuple[float, float]:
    """Return the Stumpff functions (1 - cos w)/z and (w - sin w)/w^3 with w^2 = z, entire in z."""
    if abs(z) < 1.0:
        powers = [(-z) ** k for k in range(SERIES)]
        return sum(p / factorial(2 * k + 2) for k, p in enumerate(powers)), sum(
            p / factorial(2 * k + 3) for k, p in enumerate(powers)
        )
    if z > 0.0:
        w = sqrt(z)
        return (1.0 - cos(w)) / z, (w - sin(w)) / (z * w)
    w = sqrt(-z)
    if w > 700.0:
        return inf, inf
    return (cosh(w) - 1.0) / -z, (sinh(w) - w) / (-z * w)
