"""Base class of ready-made torques on one body, their prescribed vectors, and a spring toward an attitude."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.bodies.body_systems import read_attitudes
from coadjoint.systems.forces.angular_velocity import velocity_of
from coadjoint.systems.forces.base import read_matrix
from coadjoint.systems.forces.torque import StateTorque, check_attitude, constant_in_time, torque_on_state
from coadjoint.systems.time_spans import sample_time_of
from coadjoint.systems.user_functions import check_arguments
from coadjoint.validation import as_tuples, read_choice, read_finite


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

    def _check_kinds(self, system: Any) -> None:
        """Pass: a torque in the body frame changes the momentum of the body alone."""

    def on_state(self, system: Any) -> tuple[Callable[..., Any], str]:
        return _on_state(self, system)


# Systems are immutable, and forces too. Derivatives by differences return to some hundred systems in each step.
@lru_cache(maxsize=1024)
def _on_state(force: BodyTorque, system: Any) -> tuple[Callable[..., Any], str]:
    return torque_on_state(force.torque_on(system), "x, A, t" if force.sees_attitude else "x, t", system)


def check_one_body(system: Any, label: str) -> None:
    """Raise TypeError for a system other than one body with its angular momentum as the first three coordinates."""
    if getattr(system, "bodies", None) != ():
        raise TypeError(
            f"{label} acts on one body, and {system.name} is none; take co.systems.body or rigid_body, or write a "
            "co.forces.Torque"
        )


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


def read_prescribed(value: Any, what: str, shape: tuple[int, ...] = (3,)) -> Any:
    """Validate a constant vector of space, or a function of the time that returns one."""
    if callable(value):
        check_arguments(value, what, "t")
        check_value(value, what, shape, sample_time_of(value))
        return value
    array = read_finite(value, what)
    _check_shape(array, what, shape)
    return as_tuples(array)


def prescribed(value: Any) -> Callable[..., Any]:
    """Return a prescribed vector as a function of the time."""
    return value if callable(value) else constant_in_time(np.array(value))


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
    return as_tuples(array)


def check_value(function: Callable[..., Any], what: str, shape: tuple[int, ...], *arguments: Any) -> Any:
    """Return the value of a function at a sample; raise ValueError if it fails, or for other than finite numbers."""
    try:
        value = function(*arguments)
    except Exception as reason:
        failure = f"{type(reason).__name__}: {in_one_line(str(reason), 200)}"
        raise ValueError(f"{what} fails at t = {arguments[0]:g} ({failure}); correct the function") from None
    _check_shape(value, what, shape)
    return value


def _check_shape(value: Any, what: str, shape: tuple[int, ...]) -> None:
    found = np.shape(value)
    if found != shape or not np.isfinite(np.asarray(value, dtype=np.float64)).all():
        raise ValueError(f"{what} is {short(np.asarray(value).tolist())}; give finite numbers of the shape {shape}")


ERRORS = ("sine", "quaternion")


@suggest_keywords
@dataclass(frozen=True)
class Pointing(BodyTorque):
    """A spring and a damper toward an attitude: libration dampers, PD control, and quaternion feedback.

    The torque in the body frame is ``-stiffness e - damping (Omega - w)``, with the angular velocity Omega, a wanted
    one w, and the error e of the attitude. If the body is turned from the wanted attitude by the angle a about the
    unit vector n, e is ``sin(a) n``, or ``2 sin(a/2) n`` by the shorter way, which is quaternion feedback. For small
    angles both are the rotation vector. In a computer on board it is sampled: ``Sampled(Pointing(...), period)``, or
    the law of `ReactionWheels`, `ControlMomentGyros` and `Thrusters`.

    Parameters
    ----------
    stiffness : float, (3,) or (3, 3)
        Torque per radian, in the body frame; zero for a damper alone, which also acts on bodies without an attitude.
    damping : float, (3,) or (3, 3)
        Torque per angular velocity, in the body frame.
    attitude : (3, 3), (4,), scipy.spatial.transform.Rotation or callable, optional
        The wanted attitude, from the body to space; by default that of space. A function of the time returns a matrix.
    rate : (3,) or callable, optional
        The wanted angular velocity w, constant or a function of the time: relative to inertial space, with components
        along the axes of space, or of the orbit for ``satellite_on_orbit``. By default that of these axes: zero, or
        the rate of the orbit at each time.
    error : {"sine", "quaternion"}
        The error of the attitude. That of the sine vanishes at half a turn as well, where it is unstable.
    max_torque : float or (3,), optional
        Limit of each component.

    Raises
    ------
    TypeError, ValueError
        Wrong shapes, no rotation, or a system that is not one body, for a spring with its attitude in the state.

    Examples
    --------
    >>> import coadjoint as co
    >>> law = co.forces.Pointing(stiffness=0.5, damping=1.5, error="quaternion", max_torque=0.2)
    >>> sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(law)
    >>> x0 = sat.state([0.6, 0.0, 0.0, 0.8], angular_velocity=(0.1, 0.2, 0.3))
    >>> sol = co.integrate(sat, x0, (0, 80), 0.05)
    >>> bool(sol.rotation[-1].magnitude() < 1e-6)
    True
    """

    stiffness: Any
    damping: Any
    attitude: Any = None
    rate: Any = None
    error: str = "sine"
    max_torque: Any = None

    example: ClassVar = {"stiffness": 0.1, "damping": 0.2}
    selectors: ClassVar[tuple[str, ...]] = ("attitude",)

    def __post_init__(self) -> None:
        self._read(
            stiffness=read_tensor,
            damping=read_tensor,
            attitude=_read_wanted,
            rate=_read_rate,
            error=partial(read_choice, known=ERRORS),
            max_torque=read_limits,
        )

    @property
    def sees_attitude(self) -> bool:
        """Whether there is a spring, or a wanted angular velocity."""
        return bool(np.any(self.stiffness)) or callable(self.rate) or any(self.rate or ())

    def torque_on(self, system: Any) -> Callable[..., Any]:
        K, C = tensor(self.stiffness), tensor(self.damping)
        wanted = prescribed(np.eye(3) if self.attitude is None else self.attitude)
        in_frame, limited = self.rate is None, limited_by(self.max_torque)
        velocity, rate = velocity_of(system, in_frame=in_frame), prescribed(np.zeros(3) if in_frame else self.rate)
        error = sine_error if self.error == "sine" else quaternion_error

        def damper(x: Any, t: Any) -> Any:
            omega = velocity(x, t)
            return limited(-(C[:, 0] * omega[0] + C[:, 1] * omega[1] + C[:, 2] * omega[2]))

        def spring(x: Any, A: Any, t: Any) -> Any:
            D = wanted(t)
            # The rows of the relative attitude, from the body to the wanted one.
            e = error(to_body(A, D[:, 0]), to_body(A, D[:, 1]), to_body(A, D[:, 2]))
            d = velocity(x, t) - to_body(A, rate(t))
            pull = K[:, 0] * e[0] + K[:, 1] * e[1] + K[:, 2] * e[2]
            return limited(-(pull + C[:, 0] * d[0] + C[:, 1] * d[1] + C[:, 2] * d[2]))

        return spring if self.sees_attitude else damper


def _read_rate(value: Any, what: str) -> Any:
    """Validate a wanted angular velocity; None is that of the frame."""
    return None if value is None else read_prescribed(value, what)


def _read_wanted(value: Any, what: str) -> Any:
    """Validate a wanted attitude, or a function of the time that returns a matrix; None is that of space."""
    if value is None:
        return None
    if not callable(value) or hasattr(value, "as_matrix"):
        value = read_attitudes(value, what, (), False)
    read = read_prescribed(value, what, shape=(3, 3))
    if callable(read):
        t = sample_time_of(read)
        read_attitudes(read(t), f"the value of {what} at t = {t:g}", (), False)
    return read


def limited_by(limits: Any) -> Callable[..., Any]:
    """Return the function that limits each component of a vector; None is no limit."""
    if limits is None:
        return lambda v: v
    most = np.array(np.broadcast_to(limits, 3))

    def limited(v: Any) -> Any:
        return np.minimum(np.maximum(v, -most), most)

    return limited


def sine_error(X: Any, Y: Any, Z: Any) -> Any:
    """Return sin(a) n of the rotation with these rows, by the angle a about n; Numba compiles it."""
    result = 0.0 * X
    result[0], result[1], result[2] = 0.5 * (Z[1] - Y[2]), 0.5 * (X[2] - Z[0]), 0.5 * (Y[0] - X[1])
    return result


def quaternion_error(X: Any, Y: Any, Z: Any) -> Any:
    """Return 2 sin(a/2) n of the rotation with these rows, a at most half a turn, by Shepperd's formula."""
    result = 0.0 * X
    result[0], result[1], result[2] = Z[1] - Y[2], X[2] - Z[0], Y[0] - X[1]
    trace = X[0] + Y[1] + Z[2]
    if trace >= 0.0:
        return result / np.sqrt(1.0 + trace)
    if X[0] >= Y[1] and X[0] >= Z[2]:
        k, size, other, third = 0, 1.0 + X[0] - Y[1] - Z[2], X[1] + Y[0], X[2] + Z[0]
    elif Y[1] >= Z[2]:
        k, size, other, third = 1, 1.0 + Y[1] - Z[2] - X[0], Y[2] + Z[1], Y[0] + X[1]
    else:
        k, size, other, third = 2, 1.0 + Z[2] - X[0] - Y[1], Z[0] + X[2], Z[1] + Y[2]
    # The scalar part has the sign of the k-th component of the antisymmetric part, by a factor: a choice is a branch.
    root = np.sqrt(size) * (1.0 - 2.0 * (result[k] < 0.0))
    result[k], result[(k + 1) % 3], result[(k + 2) % 3] = root, other / root, third / root
    return result
