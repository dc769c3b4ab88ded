"""Kepler's equation, as a function for Numba."""

from __future__ import annotations

from typing import Any

import numpy as np

NEWTON_STEPS = 100  # far above the 9 that any eccentricity up to 1 - 1e-9 takes


def eccentric_anomaly(mean: Any, e: Any) -> Any:
    """Solve Kepler's equation E - e sin E = mean, reduced to (-pi, pi), from above by Newton's method."""
    # The left side is convex from 0 to pi, and each of the starting values is an upper bound of the solution.
    reduced = mean - 2.0 * np.pi * np.floor(mean / (2.0 * np.pi) + 0.5)  # in every direction of rounding
    positive = abs(reduced)
    E = min(positive + e, positive / (1.0 - e), np.pi)
    for _ in range(NEWTON_STEPS):
        new = E - (E - e * np.sin(E) - positive) / (1.0 - e * np.cos(E))
        if not new < E:
            break
        E = new
    return E if reduced >= 0.0 else -E
