"""The attitude of a rigid satellite on a prescribed circular or elliptic orbit, with the gravity-gradient torque."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import pi
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.systems.bodies.body import ATTITUDE, attitude_algebra, axis_products
from coadjoint.systems.bodies.body_systems import BodySystem
from coadjoint.systems.bodies.inertia import (
    anisotropic_part,
    axis_of_symmetry,
    check_products,
    inverse_of_moving,
    momentum_along,
    read_body_inertia,
    read_in_range,
)
from coadjoint.systems.bodies.mass_properties import InertiaLike
from coadjoint.systems.forces.angular_velocity import PER_BODY
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.orbits.kepler_equation import eccentric_anomaly
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples, read_finite, read_number, set_fields

Floats = npt.NDArray[np.float64]

RADIAL, NORMAL = slice(3, 6), slice(9, 12)  # the axes X and Z of the orbital frame, seen from the body


class KeplerOrbit(NamedTuple):
    """Where a satellite on a Kepler orbit is.

    Attributes
    ----------
    radius : ndarray
        Distance from the centre of gravity, in units of the semi-major axis.
    anomaly : ndarray
        True anomaly, the angle from the pericentre, in radians; it grows by 2 pi in each revolution.
    rate : ndarray
        Its derivative, the angular velocity of the orbital frame.
    """

    radius: Floats
    anomaly: Floats
    rate: Floats


class OrbitingSatellite(BodySystem):
    """The attitude of a satellite relative to the frame of its orbit; `satellite_on_orbit` makes it."""

    mean_motion: float
    eccentricity: float

    @property
    def frame_rate(self) -> Callable[..., Any]:  # type: ignore[override]
        """Rate f'(t) at which the orbital frame turns about its third axis."""
        return _frame_rate(self.mean_motion, self.eccentricity)

    def momentum_at_rest(self, rate: Any) -> Floats:
        """Return the matrix whose product with a state from the left is the state at rest in a frame of this rate."""
        M = np.zeros((self.dim, self.dim))
        M[NORMAL, :3] = rate * self.inertias[0].tensor
        return M

    def orbit(self, t: npt.ArrayLike) -> KeplerOrbit:
        """Return where the satellite is at times t; at t = 0 it is at the pericentre.

        Parameters
        ----------
        t : array_like
            Times.

        Returns
        -------
        Orbit
            The `radius` in units of the semi-major axis, the true `anomaly`, and its `rate`. The attitude in space,
            relative to the axes of the orbital frame at the pericentre, is that of the state turned by the anomaly
            about the third axis.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.systems.satellite_on_orbit(eccentricity=0.5).orbit([0.0, np.pi]).anomaly.round(12)
        array([0.        , 3.14159265])
        """
        times, e = read_finite(t, "t"), self.eccentricity
        mean = self.mean_motion * times
        E = np.array([eccentric_anomaly(value, e) for value in mean.ravel().tolist()]).reshape(times.shape)
        turns = 2.0 * pi * np.round((mean - E) / (2.0 * pi))
        anomaly = 2.0 * np.arctan2(np.sqrt(1.0 + e) * np.sin(0.5 * E), np.sqrt(1.0 - e) * np.cos(0.5 * E))
        radius = 1.0 - e * np.cos(E)
        return KeplerOrbit(radius, anomaly + turns, self.mean_motion * np.sqrt((1.0 - e) * (1.0 + e)) / radius**2)


def _librating() -> Floats:
    """Return a satellite turned from the orbital frame by angles about all axes, at rest in it."""
    c, s = np.cos(0.5), np.sin(0.5)
    A = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return satellite_on_orbit().state(A, (0.0, 0.0, 1.0), frame="space")


def _pitch(x: Any) -> Any:
    """Return the angle of the radius from the first axis, in the plane of the first two."""
    return np.degrees(np.arctan2(x[..., 4], x[..., 3]))


def _roll(x: Any) -> Any:
    """Return the angle of the normal of the orbit from the third axis."""
    return np.degrees(np.arccos(x[..., 11]))


def _energy(inertia: npt.NDArray[Any], mean_motion: Any, *, eccentricity: float) -> tuple[npt.NDArray[Any]]:
    """Return the matrix of the energy on a circular orbit, in the rotating frame."""
    if eccentricity:
        raise ValueError("on an ellipse the energy depends on time")
    tensor = inertia if inertia.ndim == 2 else np.diag(inertia)
    inverse = inverse_of_moving(inertia)
    M = np.zeros((PER_BODY, PER_BODY), dtype=np.result_type(tensor, mean_motion, float))
    M[:3, :3] = inverse if inverse.ndim == 2 else np.diag(inverse)
    M[:3, NORMAL] = M[NORMAL, :3] = -mean_motion * np.eye(3)
    M[RADIAL, RADIAL] = 3.0 * mean_motion**2 * anisotropic_part(tensor)
    return (M,)


@ready_made(
    energy=_energy,
    symmetric=("inertia",),
    coordinates=ATTITUDE,
    gallery_entry=GalleryEntry(
        x0=_librating,
        t_span=(0.0, 40.0),
        step=0.05,
        caption="A satellite on a circular orbit that is turned from the frame of the orbit and librates about it, by "
        "the gradient of gravity. Right, the directions of the radius and of the normal of the orbit, seen from the "
        "body.",
        pictures=(
            Picture(
                "directions",
                vectors={"radius": (3, 4, 5), "normal": (9, 10, 11)},
                title="in the body frame",
                view=(55.0, 25.0),
            ),
        ),
        components=Picture(
            "components", functions={"pitch": _pitch, "tilt of the normal": _roll}, quantity="angles [degrees]"
        ),
        quantity="state",
    ),
)
def satellite_on_orbit(
    inertia: InertiaLike = (1.0, 2.0, 2.5), mean_motion: float = 1.0, eccentricity: float = 0.0
) -> OrbitingSatellite:
    """Return the attitude of a rigid satellite on a prescribed circular or elliptic orbit.

    Choose it for the attitude of spacecraft and moons that are small against their orbits, so that their rotation does
    not change the orbit: libration, stability, pointing, tumbling on an ellipse. No position is integrated, so that
    sizes and masses have no effect on the accuracy. If the rotation does act on the orbit, take `satellite` or
    `gravitating_bodies`.

    The state is (L, X, Y, Z): the angular momentum in the body frame, and the axes of the orbital frame seen from the
    body: X outward along the radius, Y along the orbit, Z normal to it. With the radius r in units of the semi-major
    axis, the true anomaly f and ``Omega = I^-1 L``, the angular velocity in inertial space: ``L' = L cross Omega +
    3 mean_motion^2/r^3 X cross I X``, ``X' = X cross (Omega - f' Z)``, and so on. Sign -1, ``H = L . I^-1 L / 2 -
    f' L . Z + 3 mean_motion^2/(2 r^3) X . I X``.

    Forces take the orbital frame as space: vectors have components along X, Y, Z, and damping is relative to the frame.
    The gravity gradient is in H, so that `co.forces.GravityGradient` is refused.

    Parameters
    ----------
    inertia : (3,), (3, 3) or co.bodies.MassProperties
        Principal moments of inertia, or the inertia tensor in the body frame (mass times length squared).
    mean_motion : float
        Mean angular velocity of the orbit, positive: ``sqrt(mu/a^3)``, in radians per time, with the semi-major axis a.
    eccentricity : float
        Of the orbit, from 0 to less than 1. At t = 0 the satellite is at the pericentre.

    Returns
    -------
    OrbitingSatellite
        State: 12 numbers, as of `body`, with the orbital frame in place of space: ``state(attitude=,
        angular_velocity=)`` makes it, and ``sol.rotation``, ``sol.angular_velocity`` read it. Angular velocities are
        in inertial space; ``frame="space"`` has their components along the axes of the orbital frame, where a satellite
        at rest has ``(0, 0, rate)``. ``orbit(t)`` is the radius, the true anomaly and its rate. Casimirs: the products
        of the axes, ``"X.X"``, ..., ``"Y.Z"``. The energy is constant on a circular orbit. Integrals: the momentum
        along an axis of symmetry.

    Raises
    ------
    TypeError, ValueError
        `inertia` has another shape, or is not symmetric and positive; `mean_motion` or `eccentricity` out of range.

    Warns
    -----
    UserWarning
        A principal moment exceeds the sum of the other two, which is impossible for a body.

    Notes
    -----
    V. V. Beletskii, Motion of an Artificial Satellite about its Center of Mass (1966). On a circular orbit H is
    quadratic, so that every scheme can be used; on an ellipse it is a sum of functions of commuting coordinates and of
    the time, compiled by Numba.

    Examples
    --------
    Frequencies of libration about the stable attitude, along the orbit and across it:

    >>> import coadjoint as co
    >>> s = satellite_on_orbit(inertia=(1.0, 2.0, 2.5))
    >>> x0 = s.state(angular_velocity=(0.0, 0.0, 1.0))
    >>> found = co.equilibrium(s, x0)
    >>> found.stability, bool(abs(found.frequencies - np.sqrt(3 * (2.0 - 1.0) / 2.5)).min() < 1e-12)
    ('stable', True)
    """
    found = read_body_inertia(inertia)
    if found.rotating is not None:
        raise ValueError("inertia has a moment that is zero; give a body with three positive principal moments")
    rate, e = read_in_range(mean_motion, "mean_motion"), read_number(eccentricity, "eccentricity")
    if not 0.0 <= e < 1.0:
        raise ValueError(f"eccentricity is {e:g}; give a number from 0 to less than 1")
    check_products("mean_motion and inertia", lambda: rate * rate * np.diag(found.tensor))
    parameters = {"inertia": found.given, "mean_motion": rate, "eccentricity": e}
    if e:
        kinetic = np.zeros((PER_BODY, PER_BODY))
        kinetic[:3, :3] = found.inverse if found.inverse.ndim == 2 else np.diag(found.inverse)
        turning, torque = _on_ellipse(rate, e, as_tuples(found.anisotropic))
        frame = [((i, NORMAL.start + i), turning) for i in range(3)]
        H: Any = Quadratic(kinetic) + SplitHamiltonian([*frame, ((3, 4, 5), torque)])
    else:
        H = Quadratic(*_energy(np.asarray(found.given, dtype=np.float64), rate, eccentricity=0.0))
    system = OrbitingSatellite(
        found,
        attitude_algebra(),
        H,
        sign=-1,
        casimirs=axis_products(1, PER_BODY),
        integrals=momentum_along(axis_of_symmetry(found.inverse, np.zeros(3)), "L", PER_BODY),
        name="satellite_on_orbit",
        parameters=parameters,
    )
    set_fields(system, mean_motion=rate, eccentricity=e)
    return system


@lru_cache(maxsize=64)
def _inverse_radius(rate: float, e: float) -> Callable[..., Any]:
    """Return the semi-major axis over the radius, a function of the time for compiled functions."""

    def inverse_radius(t: Any) -> Any:
        return 1.0 / (1.0 - e * np.cos(eccentric_anomaly(rate * t, e)))

    return inverse_radius


@lru_cache(maxsize=64)
def _frame_rate(rate: float, e: float) -> Callable[..., Any]:
    """Return the derivative of the true anomaly, a function of the time for compiled functions."""
    if not e:
        return lambda t: rate + 0.0 * t
    over, fast = _inverse_radius(rate, e), rate * np.sqrt((1.0 - e) * (1.0 + e))
    return lambda t: fast * over(t) ** 2


@lru_cache(maxsize=64)
def _on_ellipse(rate: float, e: float, tensor: tuple[tuple[float, ...], ...]) -> tuple[Hamiltonian, Hamiltonian]:
    """Return -f'(t) L_i Z_i and the potential of X, cached, so that they are compiled once for equal parameters."""
    over, fast = _inverse_radius(rate, e), rate * np.sqrt((1.0 - e) * (1.0 + e))
    (a, f, g), (_, b, h), (_, _, c) = tensor

    def turning(y: Any, t: Any) -> Any:
        return -fast * over(t) ** 2 * y[0] * y[1]

    def turning_gradient(y: Any, t: Any) -> Any:
        return -fast * over(t) ** 2 * y[::-1]

    def turning_hessian(y: Any, t: Any) -> Any:
        return -fast * over(t) ** 2 * np.array([[0.0, 1.0], [1.0, 0.0]])

    def slope(y: Any) -> Any:
        result = 0 * y
        result[0] = a * y[0] + f * y[1] + g * y[2]
        result[1] = f * y[0] + b * y[1] + h * y[2]
        result[2] = g * y[0] + h * y[1] + c * y[2]
        return result

    def torque(y: Any, t: Any) -> Any:
        u = slope(y)
        return 1.5 * rate**2 * over(t) ** 3 * (u[0] * y[0] + u[1] * y[1] + u[2] * y[2])

    def torque_gradient(y: Any, t: Any) -> Any:
        return 3.0 * rate**2 * over(t) ** 3 * slope(y)

    def torque_hessian(y: Any, t: Any) -> Any:
        return 3.0 * rate**2 * over(t) ** 3 * np.array([[a, f, g], [f, b, h], [g, h, c]])

    return (
        Hamiltonian(turning, turning_gradient, turning_hessian),
        Hamiltonian(torque, torque_gradient, torque_hessian),
    )
