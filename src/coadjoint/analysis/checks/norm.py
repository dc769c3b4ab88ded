"""Norm of states with groups of coordinates in units of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

# A group below this fraction of the largest is zero but for rounding, and has no size of its own.
ZERO = 64 * UNIT_ROUNDOFF


@dataclass(frozen=True)
class Norm:
    """Euclidean norm in coordinates y = x / units; units are powers of two, so that scaling does not round."""

    units: tuple[float, ...] = (1.0,)

    @classmethod
    def of(cls, system: System, states: Floats) -> Norm:
        """Return the norm for states (k, n): the unit of a group is its largest size, or its motion if it is zero."""
        groups = CoordinateGroups(system)
        if groups.count == 1:
            return cls()
        sizes = groups.norms(states)
        speeds = groups.norms(np.array([system.vector_field(x, 0.0) for x in states], dtype=np.float64))
        known = sizes > ZERO * np.max(sizes, axis=1, keepdims=True)
        rate = float(np.max(np.divide(speeds, sizes, out=np.zeros_like(sizes), where=known)))
        extents = np.max(sizes, axis=0)
        if rate > 0.0 and np.isfinite(rate):
            extents = np.maximum(extents, np.max(speeds, axis=0) / rate)
        units = groups.units(np.where(extents > ZERO * extents.max(), extents, extents.max()))
        return cls(tuple((units / units.max()).tolist()))

    @cached_property
    def _units(self) -> Floats:
        return np.array(self.units)

    @property
    def plain(self) -> bool:
        """Whether all units are one."""
        return bool(np.all(self._units == 1.0))

    def __call__(self, x: Any, axis: int | None = None) -> Any:
        """Return the norm of states (..., n): of all numbers together, or along the last axis."""
        return np.linalg.norm(self.scaled(x), axis=axis)

    def scaled(self, x: Any) -> Floats:
        """Return y = x / units."""
        return np.asarray(x / self._units)

    def unscaled(self, y: Any) -> Floats:
        """Return x = units y."""
        return np.asarray(y * self._units)

    def matrix(self, P: Any) -> Floats:
        """Return linear maps (..., n, n) of x as maps of y."""
        return np.asarray(P * self._units / self._units[:, None])

    def unscaled_matrix(self, P: Any) -> Floats:
        """Return linear maps of y as maps of x, the inverse of `matrix`."""
        return np.asarray(P * self._units[:, None] / self._units)

    def gradient(self, slope: Any) -> Floats:
        """Return derivatives by x as derivatives by y."""
        return np.asarray(slope * self._units)

    def function(self, step: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Return a map of x as a map of y."""
        return lambda y: np.asarray(step(y * self._units)) / self._units

    def with_matrix(self, n: int) -> Norm:
        """Return the norm of a state and a matrix (n, n) that maps states to states."""
        units = np.broadcast_to(self._units, n)
        return Norm((*units.tolist(), *(units[:, None] / units).ravel().tolist()))


def worst_group(defects: Floats, bounds: Floats) -> tuple[float, float]:
    """Return the defect that is largest relative to its bound, over groups or blocks, in units of the largest bound."""
    if defects.size == 1:
        return float(defects.item()), float(bounds.item())
    ratios = np.divide(defects, bounds, out=np.where(defects > 0.0, np.inf, 0.0), where=bounds > 0.0)
    return float(np.max(ratios) * np.max(bounds)), float(np.max(bounds))
