"""Systems of bodies in space: states from attitudes and velocities, and attitudes, velocities and momenta of states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.representation import ORTHOGONALITY, is_rotation, matrices_of_quaternions
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.systems.bodies.inertia import (
    NO_GYROS,
    NO_WHEELS,
    BodyInertia,
    momenta_of_rotors,
    moments_of_wheels,
    without_wheels,
)
from coadjoint.systems.coordinates import numberless
from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.registry import ready_made_systems
from coadjoint.validation import read_bool, read_choice, read_finite, read_numbers, set_fields

Floats = npt.NDArray[np.float64]

ROD_VELOCITY = 1e-4
"""Largest angular velocity along a rod, relative to the whole, that is taken for the rounding of its axis."""
FRAMES = ("body", "space")


def read_states(system: Any, x: Any) -> Floats:
    """Validate states (..., dim) of a system of bodies."""
    states = read_numbers(x, "x")
    if states.shape[-1:] != (system.dim,):
        raise ValueError(f"x has shape {states.shape}; {system.name} needs (..., {system.dim})")
    return states


def read_vectors(values: Any, what: str, shape: tuple[int, ...]) -> Floats:
    """Validate vectors of the given shape, or with an axis of members before."""
    array = read_finite(values, what)
    if array.shape[-len(shape) :] != shape or array.ndim > len(shape) + 1:
        raise ValueError(f"{what} has shape {array.shape}; give {shape} or (members, {', '.join(map(str, shape))})")
    return array


def read_attitudes(attitude: Any, what: str, bodies: tuple[int, ...], scalar_first: bool) -> Floats:
    """Return attitudes as matrices (..., 3, 3) or (..., bodies, 3, 3), orthogonal to rounding."""
    scalar_first = read_bool(scalar_first, "scalar_first")
    if isinstance(attitude, list | tuple) and bodies and any(map(is_rotation, attitude)):
        attitude = np.stack([read_attitudes(one, f"{what}[{k}]", (), scalar_first) for k, one in enumerate(attitude)])
    if is_rotation(attitude):
        attitude = attitude.as_matrix()
    array = read_finite(attitude, what)
    tail = bodies
    # Four numbers are a quaternion: no shape of matrices ends with 4.
    if array.shape[-1:] == (4,):
        array = matrices_of_quaternions(array, what, scalar_first)
    if array.shape[-len(tail) - 2 :] != (*tail, 3, 3) or array.ndim > len(tail) + 3:
        count = f"{bodies[0]} of them" if bodies else "one"
        raise ValueError(
            f"{what} has shape {np.shape(attitude)}; give rotation matrices (3, 3), quaternions (4,) or a SciPy "
            f"Rotation, {count}, or with an axis of members before"
        )
    return _orthogonal(array, what)


def read_angular_velocities(
    values: Any, what: str, attitudes: Floats | None, bodies: tuple[int, ...], frame: str, degrees: bool
) -> Floats:
    """Return angular velocities in the body frames, in radians per time."""
    omega = read_vectors(values, what, (*bodies, 3))
    if read_bool(degrees, "degrees"):
        omega = np.deg2rad(omega)
    if read_choice(frame, "frame", FRAMES) == "body":
        return omega
    if attitudes is None:
        raise ValueError('frame is "space", but the state has no attitude; give the angular velocity in the body frame')
    return np.einsum("...ij,...i->...j", attitudes, omega)


def check_rods(omega: Floats, inertias: tuple[BodyInertia, ...], what: str) -> Floats:
    """Return angular velocities (..., bodies, 3) without rounding along rods; raise ValueError for more than that."""
    result = omega.copy()
    for k, inertia in enumerate(inertias):
        if inertia.rotating is None:
            continue
        turning = np.einsum("ij,...j->...i", inertia.rotating, omega[..., k, :])
        if np.abs(omega[..., k, :] - turning).max() > ROD_VELOCITY * np.abs(omega[..., k, :]).max():
            name = "a rod, about its axis" if inertia.tensor.any() else "a point"
            raise ValueError(
                f"{what} of body {k} is {short(omega[..., k, :].tolist())}, where its moment of inertia is zero, like "
                f"that of {name}; give an angular velocity without this component"
            )
        result[..., k, :] = turning
    return result


def _orthogonal(A: Floats, what: str) -> Floats:
    """Return the nearest rotations, by steps of Newton's iteration for the polar factor; refuse what is no rotation."""
    defect = np.abs(np.einsum("...ij,...kj->...ik", A, A) - np.eye(3)).max(initial=0.0)
    if not defect <= ORTHOGONALITY or (np.linalg.det(A) < 0.0).any():
        raise ValueError(f"{what} is no rotation: its rows are orthonormal to {defect:.2g}, or it has a reflection")
    for _ in range(2 if defect > 4 * UNIT_ROUNDOFF else 0):
        A = 1.5 * A - 0.5 * np.einsum("...ij,...kj,...kl->...il", A, A, A)
    return A


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
        inverse = np.stack([inertia.inverse_matrix for inertia in self.inertias])
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
        self,
        inertia: BodyInertia,
        *arguments: Any,
        wheels: Floats = NO_WHEELS,
        gyros: Floats = NO_GYROS,
        held: int = 0,
        **named: Any,
    ) -> None:
        super().__init__(*arguments, **named)
        has_attitude = self.dim - len(wheels) - 2 * len(gyros) - held > 3
        set_fields(self, inertias=(inertia,), wheels=wheels, gyros=gyros, held=held, has_attitude=has_attitude)

    wheels: Floats
    gyros: Floats
    held: int

    @property
    def first_carried(self) -> int:
        """Index of the first number of the rotors in the state; those that forces hold follow."""
        return PER_BODY if self.has_attitude else 3

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the numbers at the end of the state that forces hold."""
        return tuple(self.algebra.basis[self.dim - self.held :])

    def with_held(self, names: tuple[str, ...]) -> BodySystem:
        """Return the body whose state ends with numbers of these names, which forces hold."""
        if names == self.held_names:
            return self
        parameters = self.parameters or {}
        if "held" not in parameters:
            raise TypeError(
                f"{self.name} has no room in its state for numbers that forces hold; take co.systems.body, of another "
                f"Hamiltonian with held={len(names)}"
            )
        return cast(BodySystem, ready_made_systems()[self.name](**{**parameters, "held": names}))

    def _velocities(self, x: Any) -> Floats:
        if not len(self.wheels) + len(self.gyros):
            return super()._velocities(x)
        momenta = np.einsum("...q,qi->...i", self._carried(x), momenta_of_rotors(self.wheels, self.gyros))
        inverse = without_wheels(self.inertias[0].tensor, self.wheels)
        return np.asarray(np.einsum("ij,...j->...i", inverse, read_states(self, x)[..., :3] - momenta))[..., None, :]

    def _carried(self, x: Any) -> Floats:
        first = self.first_carried
        return read_states(self, x)[..., first : first + len(self.wheels) + 2 * len(self.gyros)]

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
        wheels, moments = self.wheels, moments_of_wheels(self.wheels)
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
        gimbals = self._carried(x)[..., len(self.wheels) :]
        return np.asarray(np.arctan2(gimbals[..., 1::2], gimbals[..., ::2]))

    @suggest_keywords
    def state(
        self,
        attitude: Any = None,
        angular_velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
        *,
        wheel_speeds: npt.ArrayLike | None = None,
        gimbal_angles: npt.ArrayLike | None = None,
        memory: Mapping[str, npt.ArrayLike] | None = None,
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
        memory : mapping, optional
            What forces hold, by names without numbers: ``{"integral": (0.1, 0.0, 0.0)}``; zero by default.
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
            Wrong shapes, no rotation, an angular velocity along a rod, an attitude for a system without one, or an
            unknown name of a memory.

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
        speeds = unit * _read_rotors(wheel_speeds, "wheel_speeds", len(self.wheels))
        angles = unit * _read_rotors(gimbal_angles, "gimbal_angles", len(self.gyros))
        moments = moments_of_wheels(self.wheels)
        along = np.einsum("mi,...i->...m", self.wheels / moments[:, None], omega)
        L, speeds, along, angles = over_members((L, 1), (speeds, 1), (along, 1), (angles, 1))
        turns = joined(np.stack([np.cos(angles), np.sin(angles)], axis=-1))
        momenta = np.einsum("...q,qi->...i", turns, self.gyros.reshape(-1, 3))
        L = L + np.einsum("...m,mi->...i", speeds, self.wheels) + momenta
        axes = np.zeros(0) if A is None else joined(A)
        rows = (L, axes, moments * (speeds + along), turns, self._memory(memory or {}))
        return np.concatenate(over_members(*((row, 1) for row in rows)), axis=-1)

    def _memory(self, given: Mapping[str, npt.ArrayLike]) -> Floats:
        """Return what forces hold, (held,) or (members, held), from values by names without numbers."""
        stems = np.array([numberless(name) for name in self.held_names], dtype=str)
        if given and not self.held:
            raise ValueError(f"memory was given, and no force on {self.name} has one; add it by with_forces before")
        row = np.zeros(self.held)
        for name, values in given.items():
            places = np.flatnonzero(stems == read_choice(name, "memory", dict.fromkeys(stems.tolist())))
            vector = read_vectors(np.atleast_1d(values), f"memory[{name!r}]", (len(places),))
            row, vector = over_members((row, 1), (vector, 1))
            row = row.copy()
            row[..., places] = vector
        return row


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
