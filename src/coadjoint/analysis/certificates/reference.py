"""Norms of states, and reference motions by a closed form or an independent integration (DOP853) of the field."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.long_operations import note_progress
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.system import System

Floats = NDArray[np.float64]

# A group below this fraction of the largest is zero but for rounding, and has no size of its own.
ZERO = 64 * UNIT_ROUNDOFF

# The smallest tolerance that DOP853 accepts, and a larger one; the difference of the two runs estimates the error.
FINE_TOLERANCE, COARSE_TOLERANCE = 2.3e-14, 1e-12
# The error of DOP853 per unit of time is proportional to the tolerance, so that of the finer run is 1/43 of the
# difference; 1/8 is assumed.
ERROR_SHARE = 0.125
MAX_STEPS = 1500  # of each of the two runs; some seconds in Python
# Largest relative difference of a closed form from the integrated field; beyond it, one of them is wrong.
CLOSED_FORM_TOLERANCE = 1e-8


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
        return bool(np.all(self._units == 1.0))

    def __call__(self, x: Any, axis: int | None = None) -> Any:
        """Return the norm of states (..., n): of all numbers together, or along the last axis."""
        return np.linalg.norm(self.scaled(x), axis=axis)

    def scaled(self, x: Any) -> Floats:
        return np.asarray(x / self._units)

    def unscaled(self, y: Any) -> Floats:
        return np.asarray(y * self._units)

    def matrix(self, P: Any) -> Floats:
        """Return linear maps (..., n, n) of x as maps of y."""
        return np.asarray(P * self._units / self._units[:, None])

    def unscaled_matrix(self, P: Any) -> Floats:
        return np.asarray(P * self._units[:, None] / self._units)

    def gradient(self, slope: Any) -> Floats:
        """Return derivatives by x as derivatives by y."""
        return np.asarray(slope * self._units)

    def function(self, step: Callable[[Any], Any]) -> Callable[[Any], Any]:
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


class Motion(NamedTuple):
    """States (k, n) after a time, with their relative error; `contradiction` if a closed form contradicts the field."""

    states: Floats
    error: float
    by: str
    contradiction: str = ""


def motion(system: System, x: Floats, t: float, norm: Norm | None = None, element: bool = False) -> Motion | None:
    """Return the states after time t (negative: backward) from x (k, n) at time 0, to an error in `norm`; cached.

    None on overflow or after `MAX_STEPS` steps. With `element`, coadjoint matrices (n, n) follow the states in x.
    """
    return _motion(system, x.tobytes(), x.shape, t, Norm.of(system, x) if norm is None else norm, element)


@lru_cache(maxsize=64)
def _motion(system: System, start: bytes, shape: tuple[int, int], t: float, norm: Norm, element: bool) -> Motion | None:
    x = np.frombuffer(start).reshape(shape)
    field = partial(_field_with_element, system) if element else system.vector_field
    pairs = [
        (integrated(field, y, t, norm, FINE_TOLERANCE), integrated(field, y, t, norm, COARSE_TOLERANCE)) for y in x
    ]
    if any(fine is None or coarse is None for fine, coarse in pairs):
        return None
    fine, coarse = (np.array([pair[k] for pair in pairs]) for k in (0, 1))
    size = float(norm(fine)) or 1.0
    error = ERROR_SHARE * float(norm(fine - coarse)) / size + 16 * UNIT_ROUNDOFF
    numerical = Motion(fine, error, "DOP853 on the vector field")
    if element:
        return numerical
    closed, half = _closed_form(system, x, t), _closed_form(system, x, t / 2)
    two_halves = None if half is None else _closed_form(system, half, t / 2)
    if closed is None or two_halves is None:
        return numerical
    # Two half steps estimate the rounding of the closed form.
    rounding = 2 * float(norm(two_halves - closed)) / size + 16 * UNIT_ROUNDOFF
    difference = float(norm(closed - fine)) / size
    if difference > CLOSED_FORM_TOLERANCE:
        return numerical._replace(
            contradiction=f"the closed form of {system.name} is off the vector field by {difference:.1g}"
        )
    return Motion(closed, rounding, "the closed form")


def _field_with_element(system: Any, y: Floats, t: float) -> Floats:
    """Return the field of a momentum and its coadjoint matrix, K' = -sign K D_u with u = grad H(x)."""
    x, K = y[: system.dim], y[system.dim :].reshape(system.dim, system.dim)
    product = K @ system.algebra.coadjoint(system.hamiltonian.gradient(x, t))
    return np.concatenate([system.vector_field(x, t), -system.sign * product.ravel()])


def _closed_form(system: System, x: Floats, t: float) -> Floats | None:
    if system.closed_form is None:
        return None
    try:
        return np.array([system.exact(y, t) for y in x], dtype=np.float64)
    except (ValueError, ArithmeticError):
        return None  # outside the domain of the closed form


def integrated(field: Callable[[Any, float], Any], x: Floats, t: float, norm: Norm, tolerance: float) -> Floats | None:
    """Return the state after time t by DOP853 on a field of (x, t); None if that fails or takes too many steps."""
    from scipy.integrate import DOP853

    if t == 0.0:
        return x
    shape = x.shape

    def rate(time: float, y: Floats) -> Floats:
        return np.asarray(field(y.reshape(shape), time), dtype=np.float64).ravel()

    size = float(np.max(np.abs(norm.scaled(x)))) or 1.0
    atol: Any = norm.unscaled(np.full(x.shape, 0.1 * tolerance * size)).ravel()
    try:
        solver = DOP853(rate, 0.0, x.ravel(), t, rtol=tolerance, atol=atol)
        for _ in range(MAX_STEPS):
            note_progress("the motion by an independent code")
            solver.step()
            if solver.status != "running":
                break
    except (ValueError, ArithmeticError):
        return None
    if solver.status != "finished" or not np.isfinite(solver.y).all():
        return None
    return np.asarray(solver.y.reshape(shape))


def natural_time(system: System, x: Floats) -> float:
    """Return the time in which the state, a group, or its velocity changes by its own size; 0 at an equilibrium."""
    velocity = np.asarray(system.vector_field(x, 0.0), dtype=np.float64)
    norm = Norm.of(system, x[None])
    speed, size = float(norm(velocity)), float(norm(x))
    groups = CoordinateGroups(system)
    pairs = zip([speed, *groups.norms(velocity).tolist()], [size, *groups.norms(x).tolist()], strict=True)
    rates = [fast / extent for fast, extent in pairs if extent > 0.0 and fast > 64 * UNIT_ROUNDOFF * extent]
    if not rates:
        return 0.0
    dt = 2.0**-20 * size / speed
    change = np.asarray(system.vector_field(x + dt * velocity, 0.0), dtype=np.float64) - velocity
    rates.append(float(norm(change)) / (dt * speed))
    fastest = max((rate for rate in rates if np.isfinite(rate)), default=0.0)
    return 1.0 / fastest if fastest else 0.0
