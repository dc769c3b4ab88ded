"""Base class of ready-made torques on one body, in its frame, and the prescribed vectors that they use."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.short_repr import short
from coadjoint.systems.forces.rates import read_matrix
from coadjoint.systems.forces.state_torque import StateTorque, check_attitude, constant_in_time, torque_on_state
from coadjoint.systems.user_functions import SAMPLE_TIME, callable_from_compiled, check_arguments
from coadjoint.validation import read_finite


class BodyTorque(StateTorque):
    """Base class of torques on one body, functions of its angular velocity, its attitude and the time."""

    @property
    def sees_attitude(self) -> bool:
        """Whether the torque depends on the attitude."""
        return True

    @abstractmethod
    def torque_on(self, system: Any) -> Callable[..., Any]:
        """Return the torque in the body frame, (3,), as a function of (x, A, t), or of (x, t) without the attitude."""

    def check(self, system: Any) -> None:
        check_one_body(system, self.label)
        if self.sees_attitude:
            check_attitude(system, self.label)

    def on_state(self, system: Any) -> tuple[Callable[..., Any], str]:
        return _on_state(self, system)


# Systems are immutable, and forces too. Derivatives by differences return to some hundred systems in each step.
@lru_cache(maxsize=1024)
def _on_state(force: BodyTorque, system: Any) -> tuple[Callable[..., Any], str]:
    torque = force.torque_on(system)
    if force.sees_attitude:
        return torque_on_state(torque, "x, A, t", system)
    function = callable_from_compiled(torque)

    def of_momentum(x: Any, t: Any) -> Any:
        result = 0.0 * x
        result[:3] = function(x, t)
        return result

    return of_momentum, "x, t"


def check_one_body(system: Any, label: str) -> None:
    """Raise TypeError for a system other than one body with its angular momentum as the first three coordinates."""
    if getattr(system, "bodies", None) != ():
        raise TypeError(
            f"{label} acts on one body, and {system.name} is none; take co.systems.body or rigid_body, or write a "
            "co.forces.Torque"
        )


@lru_cache(maxsize=1024)
def velocity_map(system: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return W (3, dim) and w (3,) with the angular velocity W x + w, the derivative of the energy by the momentum."""
    with np.errstate(all="ignore"):
        points = np.eye(system.dim)
        constant = np.asarray(system.hamiltonian.gradient(np.zeros(system.dim), 0.0))[:3]
        columns = [np.asarray(system.hamiltonian.gradient(point, 0.0))[:3] - constant for point in points]
    return np.stack(columns, axis=1), constant


def velocity_of(system: Any) -> Callable[..., Any]:
    """Return the angular velocity as a function of the state, which compiled functions can call."""
    W, w = velocity_map(system)

    def velocity(x: Any) -> Any:
        omega = 0.0 * x[:3] + w
        for i in range(W.shape[1]):
            omega = omega + W[:, i] * x[i]
        return omega

    return callable_from_compiled(velocity)


def to_body(A: Any, v: Any) -> Any:
    """Return a vector of space in the body frame, without the products of BLAS; Numba compiles it."""
    return A[0] * v[0] + A[1] * v[1] + A[2] * v[2]


def cross(a: Any, b: Any) -> Any:
    """Return the cross product, which compiles in less time than that of NumPy."""
    result = a * b
    result[0] = a[1] * b[2] - a[2] * b[1]
    result[1] = a[2] * b[0] - a[0] * b[2]
    result[2] = a[0] * b[1] - a[1] * b[0]
    return result


@cache
def body_products() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return `to_body` and `cross` for functions that Numba compiles; it is imported when a torque is used."""
    return callable_from_compiled(to_body), callable_from_compiled(cross)


def read_prescribed(value: Any, what: str, arguments: str = "t", shape: tuple[int, ...] = (3,)) -> Any:
    """Validate a constant vector of space, or a function of the time (and of the position) that returns one."""
    if callable(value):
        check_arguments(value, what, arguments)
        if arguments == "t":
            _check_value(value(SAMPLE_TIME), what, shape)
        return value
    array = read_finite(value, what)
    _check_value(array, what, shape)
    return _tuples(array.tolist())


def prescribed(value: Any) -> Callable[..., Any]:
    """Return a prescribed vector as a function of the time, which compiled functions can call."""
    return callable_from_compiled(value if callable(value) else constant_in_time(np.array(value)))


def read_tensor(value: Any, what: str) -> Any:
    """Validate a number, a diagonal (3,) or a matrix (3, 3), and return it as numbers in tuples."""
    plain = read_matrix(value, what)
    if np.ndim(plain) and len(plain) != 3:  # type: ignore[arg-type]
        raise ValueError(f"{what} has the shape {np.shape(plain)}; it must be a number, (3,) or (3, 3)")
    return plain


def tensor(plain: Any) -> NDArray[np.float64]:
    """Return a number, a diagonal or a matrix as a matrix (3, 3)."""
    array = np.asarray(plain, dtype=np.float64)
    return array if array.ndim == 2 else np.diag(np.broadcast_to(array, 3))


def read_limits(value: Any, what: str, shape: tuple[int, ...] = (3,), *, zero: bool = False) -> Any:
    """Validate positive limits, a number or one for each component, `shape` or () for any count; None is no limit."""
    if value is None:
        return None
    array = read_finite(value, what)
    fits = array.shape in ((), shape) if shape else array.ndim < 2
    if not fits or (array < 0.0).any() or not (zero or array.all()):
        kind = "numbers that are not negative" if zero else "positive numbers"
        raise ValueError(f"{what} is {short(array.tolist())}; give {kind}: one, or {shape or 'one for each'}")
    return _tuples(array.tolist())


def _check_value(value: Any, what: str, shape: tuple[int, ...]) -> None:
    found = np.shape(value)
    if found != shape or not np.isfinite(np.asarray(value, dtype=np.float64)).all():
        raise ValueError(f"{what} is {short(np.asarray(value).tolist())}; give finite numbers of the shape {shape}")


def _tuples(entry: Any) -> Any:
    return tuple(map(_tuples, entry)) if isinstance(entry, list) else entry
