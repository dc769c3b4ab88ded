"""Systems of bodies in space: states from attitudes and velocities, and attitudes, velocities and momenta of states."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.systems.bodies.attitude_algebra import PER_BODY
from coadjoint.systems.bodies.body_inertia import NO_ROTORS, BodyInertia, Rotors, without_wheels
from coadjoint.systems.bodies.body_states import (
    FRAMES,
    check_rods,
    read_angular_velocities,
    read_attitudes,
    read_states,
    read_vectors,
)
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made_systems
from coadjoint.validation import read_choice, read_numbers, set_fields

Floats = npt.NDArray[np.float64]


class Bodies(LiePoissonSystem):
    """Base class of systems of bodies: `inertias` of each body, and `bodies`, the axis of bodies in arrays, if any."""

    inertias: tuple[BodyInertia, ...]
    bodies: tuple[int, ...] = ()

    has_attitude: bool = True
    """Whether the attitudes are part of the state."""

    def _rows(self, x: Any) -> Floats:
        """Return (L, X, Y, Z) of each body, (..., bodies, 4, 3)."""
        states = read_states(self, x)
        if not self.has_attitude:
            return states[..., None, None, :3]
        count = len(self.inertias)
        return states[..., : PER_BODY * count].reshape(*states.shape[:-1], count, 4, 3)

    def _of_bodies(self, array: Floats, axes: int) -> Floats:
        """Return an array with an axis of bodies before the last `axes`, without it for a single body."""
        return array if self.bodies else array.reshape(*array.shape[: -axes - 1], *array.shape[array.ndim - axes :])

    def attitudes(self, x: npt.ArrayLike) -> Floats:
        """Return the attitudes of states (..., dim), from the body to space.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., 3, 3) or (..., k, 3, 3)

        Raises
        ------
        TypeError
            The system has no attitude in its state.
        """
        if not self.has_attitude:
            raise TypeError(f"the state of {self.name} has no attitude; make it with attitude=True")
        return self._of_bodies(self._rows(x)[..., 1:, :], 2)

    def angular_momentum(self, x: npt.ArrayLike, frame: str = "body") -> Floats:
        """Return the angular momentum of each body about its centre of mass.

        Parameters
        ----------
        x : (..., dim)
            States.
        frame : {"body", "space"}
            Frame of the components.

        Returns
        -------
        ndarray, shape (..., 3) or (..., k, 3)
        """
        return self._in_frame(self._rows(x)[..., 0, :], x, frame)

    def angular_velocity(self, x: npt.ArrayLike, frame: str = "body") -> Floats:
        """Return the angular velocity of each body, in radians per time; zero along a rod.

        Parameters
        ----------
        x : (..., dim)
            States.
        frame : {"body", "space"}
            Frame of the components.

        Returns
        -------
        ndarray, shape (..., 3) or (..., k, 3)
        """
        return self._in_frame(self._velocities(x), x, frame)

    def _velocities(self, x: Any) -> Floats:
        """Return the angular velocities in the body frames, (..., bodies, 3)."""
        inverse = np.stack([_matrix(inertia.inverse) for inertia in self.inertias])
        return np.asarray(np.einsum("kij,...kj->...ki", inverse, self._rows(x)[..., 0, :]))

    def momentum(self, angular_velocity: npt.ArrayLike) -> Floats:
        """Return the angular momentum in the body frame for an angular velocity in the body frame.

        Parameters
        ----------
        angular_velocity : (..., 3) or (..., k, 3)
            In radians per time.

        Returns
        -------
        ndarray, of the same shape

        Raises
        ------
        ValueError
            The wrong shape, or an angular velocity along a rod, which has no momentum there.
        """
        omega = read_numbers(angular_velocity, "angular_velocity")
        if omega.shape[-len(self.bodies) - 1 :] != (*self.bodies, 3):
            raise ValueError(
                f"angular_velocity has shape {omega.shape}; give (..., {', '.join(map(str, (*self.bodies, 3)))})"
            )
        return self._of_bodies(self._momentum(omega if self.bodies else omega[..., None, :], "angular_velocity"), 1)

    def _momentum(self, omega: Floats, what: str) -> Floats:
        tensors = np.stack([inertia.tensor for inertia in self.inertias])
        return np.einsum("kij,...kj->...ki", tensors, check_rods(omega, self.inertias, what))

    def _in_frame(self, vectors: Floats, x: Any, frame: str) -> Floats:
        if read_choice(frame, "frame", FRAMES) == "space":
            if not self.has_attitude:
                raise TypeError(f"the state of {self.name} has no attitude; only the body frame is known")
            vectors = np.einsum("...kij,...kj->...ki", self._rows(x)[..., 1:, :], vectors)
        return self._of_bodies(vectors, 1)


class BodySystem(Bodies):
    """One body; `body` makes it."""

    def __init__(
        self, inertia: BodyInertia, *arguments: Any, rotors: Rotors = NO_ROTORS, held: int = 0, **named: Any
    ) -> None:
        super().__init__(*arguments, **named)
        has_attitude = self.dim - len(rotors.names) - held > 3
        set_fields(self, inertias=(inertia,), rotors=rotors, held=held, has_attitude=has_attitude)

    rotors: Rotors
    held: int

    @property
    def first_carried(self) -> int:
        """Index of the first number of the rotors in the state; those that forces hold follow."""
        return PER_BODY if self.has_attitude else 3

    def with_held(self, count: int) -> BodySystem:
        """Return the body whose state ends with this count of numbers that forces hold."""
        if count == self.held:
            return self
        parameters = self.parameters or {}
        if "held" not in parameters:
            raise TypeError(
                f"{self.name} has no room in its state for numbers that forces hold; take co.systems.body, of another "
                f"Hamiltonian with held={count}"
            )
        return cast(BodySystem, ready_made_systems()[self.name](**{**parameters, "held": count}))

    def _velocities(self, x: Any) -> Floats:
        if not self.rotors.names:
            return super()._velocities(x)
        momenta = np.einsum("...q,qi->...i", self._carried(x), self.rotors.momenta)
        inverse = without_wheels(self.inertias[0].tensor, self.rotors.wheels)
        return np.asarray(np.einsum("ij,...j->...i", inverse, read_states(self, x)[..., :3] - momenta))[..., None, :]

    def _carried(self, x: Any) -> Floats:
        first = self.first_carried
        return read_states(self, x)[..., first : first + len(self.rotors.names)]

    def wheel_speeds(self, x: npt.ArrayLike) -> Floats:
        """Return the speeds of the reaction wheels relative to the body, in radians per time.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., m)
        """
        wheels, moments = self.rotors.wheels, self.rotors.moments
        along = np.einsum("mi,...i->...m", wheels / moments[:, None], self._velocities(x)[..., 0, :])
        return np.asarray(self._carried(x)[..., : len(wheels)] / moments - along)

    def gimbal_angles(self, x: npt.ArrayLike) -> Floats:
        """Return the gimbal angles of the control-moment gyros, in radians from -pi to pi.

        Parameters
        ----------
        x : (..., dim)
            States.

        Returns
        -------
        ndarray, shape (..., g)
        """
        gimbals = self._carried(x)[..., len(self.rotors.wheels) :]
        return np.asarray(np.arctan2(gimbals[..., 1::2], gimbals[..., ::2]))

    @suggest_keywords
    def state(
        self,
        attitude: Any = None,
        angular_velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
        *,
        wheel_speeds: npt.ArrayLike | None = None,
        gimbal_angles: npt.ArrayLike | None = None,
        scalar_first: bool = False,
        degrees: bool = False,
        frame: str = "body",
    ) -> Floats:
        """Return the state of a body with an attitude and an angular velocity.

        Parameters
        ----------
        attitude : (3, 3), (4,) or scipy.spatial.transform.Rotation, optional
            From the body to space: a matrix, a rotation, or a unit quaternion; by default that of space.
        angular_velocity : (3,)
            In radians per time.
        wheel_speeds : (m,), optional
            Of the reaction wheels relative to the body, in radians per time; zero by default.
        gimbal_angles : (g,), optional
            Of the control-moment gyros, in radians; zero by default.
        scalar_first : bool
            Whether a quaternion is (w, x, y, z) instead of (x, y, z, w).
        degrees : bool
            Whether angular velocities, and gimbal angles, are in degrees.
        frame : {"body", "space"}
            Frame of the angular velocity.

        Returns
        -------
        ndarray, shape (dim,) or (members, dim)
            With an axis of members if an argument has one before the stated shape.

        Raises
        ------
        TypeError, ValueError
            Wrong shapes, no rotation, an angular velocity along a rod, or an attitude for a system without one.

        Examples
        --------
        >>> import coadjoint as co
        >>> body = co.systems.body((1.0, 2.0, 2.5))
        >>> x0 = body.state([0.0, 0.0, 0.0, 1.0], angular_velocity=(180.0, 0.0, 90.0), degrees=True)
        >>> body.angular_momentum(x0).round(4)
        array([3.1416, 0.    , 3.927 ])
        """
        if attitude is not None and not self.has_attitude:
            raise TypeError(f"attitude was given, but the state of {self.name} has none; make it with attitude=True")
        A = None
        if self.has_attitude:
            A = read_attitudes(np.eye(3) if attitude is None else attitude, "attitude", (), scalar_first)
        omega = read_angular_velocities(angular_velocity, "angular_velocity", A, (), frame, degrees)
        if np.shape(angular_velocity) == (3, 3) and (A is None or A.ndim == 2):
            raise ValueError(
                "angular_velocity has shape (3, 3), which may be a matrix or values for 3 members; give one, (3,), or "
                "an attitude for each member, (3, 3, 3)"
            )
        L = self._momentum(omega[..., None, :], "angular_velocity")[..., 0, :]
        unit = np.pi / 180.0 if degrees else 1.0
        count, gimbals = len(self.rotors.wheels), len(self.rotors.gyros)
        speeds = unit * _read_rotors(wheel_speeds, "wheel_speeds", count)
        angles = unit * _read_rotors(gimbal_angles, "gimbal_angles", gimbals)
        along = np.einsum("mi,...i->...m", self.rotors.momenta[:count], omega)
        L, speeds, along, angles = over_members((L, 1), (speeds, 1), (along, 1), (angles, 1))
        turns = joined(np.stack([np.cos(angles), np.sin(angles)], axis=-1))
        momenta = np.einsum("...q,qi->...i", turns, self.rotors.momenta[count:])
        L = L + np.einsum("...m,mi->...i", speeds, self.rotors.wheels) + momenta
        axes = np.zeros(0) if A is None else joined(A)
        rows = (L, axes, self.rotors.moments * (speeds + along), turns, np.zeros(self.held))
        return np.concatenate(over_members(*((row, 1) for row in rows)), axis=-1)


def _read_rotors(values: Any, what: str, count: int) -> Floats:
    return np.zeros(count) if values is None else read_vectors(values, what, (count,))


def joined(array: Floats) -> Floats:
    """Return the last two axes as one."""
    return array.reshape(*array.shape[:-2], -1)


def over_members(*parts: tuple[Floats, int]) -> list[Floats]:
    """Return arrays with the same axis of members before their last axes, where any has one."""
    members = {array.shape[0] for array, axes in parts if array.ndim > axes}
    if len(members) > 1:
        raise ValueError(f"the arguments of state are for {' and '.join(map(str, sorted(members)))} members")
    shape = tuple(members)
    return [np.broadcast_to(array, (*shape, *array.shape[array.ndim - axes :])) for array, axes in parts]


def _matrix(inverse: Floats) -> Floats:
    return np.diag(inverse) if inverse.ndim == 1 else inverse
