"""A rigid satellite on an orbit about a centre of gravity, with the gravity-gradient torque."""

from __future__ import annotations

from functools import cache, lru_cache, partial
from math import cos, cosh, factorial, inf, pi, sin, sinh, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.classical import so
from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.algebra.families.products import semidirect
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.bodies.body import IN_SPACE
from coadjoint.systems.bodies.inertia import check_own_mass, check_products, principal, read_body_inertia, read_in_range
from coadjoint.systems.bodies.mass_properties import InertiaLike
from coadjoint.systems.bodies.rigid_body import ClassicalBody
from coadjoint.systems.closed_forms.closed_form import move_state, rotate_about
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.hamiltonians.hamiltonian import Hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.split_hamiltonian import SplitHamiltonian
from coadjoint.systems.registry import ready_made
from coadjoint.validation import as_tuples

Floats = npt.NDArray[np.float64]
MAX_ITERATIONS = 200  # of doublings, and of Newton's method within a bracket, which 64 halvings close to round-off
SERIES = 12  # number of terms; the next is below round-off for |z| <= 1


def _librating() -> npt.NDArray[np.float64]:
    """Return a circular orbit of radius 5, the body rotated from the radius by 40 degrees and slightly out of plane."""
    radius, mass, angle = 5.0, 100.0, np.radians(40.0)
    rate = radius**-1.5
    c, s = np.cos(angle), np.sin(angle)
    return np.array(
        [0.005, 0.0, 2.5 * rate, *(mass * radius * rate * np.array([s, c, 0.0])), c * radius, -s * radius, 0.0, 1.0]
    )


def _pitch(x: Any) -> Any:
    """Return the angle of the radius from the first axis, in the plane of the first two."""
    return np.degrees(np.arctan2(x[..., 7], x[..., 6]))


@ready_made(
    unit="z",
    coordinates={name: IN_SPACE[name] for name in ("L", "p", "r", "z")},
    gallery_entry=GalleryEntry(
        x0=_librating,
        t_span=(0.0, 300.0),
        step=0.1,
        caption="A satellite on a circle: the gradient of gravity turns the axis of the smallest moment toward the "
        "centre, and the axis oscillates about this direction. Right, the directions of the radius and of the "
        "orbital momentum, seen from the body.",
        pictures=(
            Picture(
                "directions",
                vectors={"radius": (6, 7, 8), "momentum": (3, 4, 5)},
                title="in the body frame",
                view=(55.0, 25.0),
            ),
        ),
        components=Picture("components", functions={"pitch": _pitch}, quantity="angle of the radius [degrees]"),
        quantity="state",
    ),
)
def satellite(inertia: InertiaLike = (1.0, 2.0, 2.5), mass: float = 100.0, gravity: float = 1.0) -> ClassicalBody:
    """Return a rigid satellite in a central gravity field: orbit, rotation, and the gravity gradient that couples them.

    All vectors are in the body frame, which rotates by ``Omega = I^-1 L``: ``L' = L cross Omega + r cross dV/dr``,
    ``r' = r cross Omega + p / mass``, ``p' = p cross Omega - dV/dr``. Sign -1, ``H = L . I^-1 L / 2 +
    |p|^2 / (2 mass) + V(r)``, ``V = -gravity (mass/|r| + (tr I - 3 u . I u) / (2 |r|^3))``, ``u = r/|r|``: the
    expansion of the potential to the second moments of the body.

    Parameters
    ----------
    inertia : (3,), (3, 3) or co.bodies.MassProperties
        Principal moments of inertia, or the inertia tensor in the body frame (mass length^2), positive.
    mass : float
        Mass of the satellite, positive.
    gravity : float
        Gravitational constant times the mass of the centre, positive (length^3/time^2).

    Returns
    -------
    LiePoissonSystem
        With ``angular_velocity(x)``, ``angular_momentum(x)`` and ``momentum(angular_velocity)``.
        State: ``(L, p, r, 1)``, ten numbers: angular momentum about the centre of mass, momentum, and position relative
        to the centre of gravity, all in components along the body axes. The 1 is the central coordinate of a Heisenberg
        algebra. Casimirs: ``"z"``, which is 1, and ``"|total L|^2"``, where total L = L + r cross p. Integrals: the
        spin about an axis of symmetry. ``exact(x0, t)`` for equal moments: a Kepler orbit. The block ``[1:4, 1:4]`` of
        the group element, 5 x 5, is the attitude A, from the body to space: A r is the position in space, and
        A (L + r cross p) is constant. Its other entries are not a position.

    Raises
    ------
    TypeError, ValueError
        `inertia` has another shape, or is not symmetric and positive, or `mass` or `gravity` is not positive.

    Warns
    -----
    UserWarning
        A moment exceeds the sum of the other two, which is impossible for a body.

    Notes
    -----
    Wang, Krishnaprasad and Maddocks, Celest. Mech. Dyn. Astron. 50, 349 (1991). The algebra is so(3) acting on
    heisenberg(3). A splitting has at most five parts: three rotations, a drift, and a kick.

    Examples
    --------
    >>> system = satellite(inertia=(1.0, 1.0, 1.0), mass=2.0)
    >>> system.vector_field([0, 0, 0, 0, 2.0, 0, 1.0, 0, 0, 1]) + 0.0  # a circular Kepler orbit
    array([ 0.,  0.,  0., -2.,  0.,  0.,  0.,  1.,  0.,  0.])
    """
    found = read_body_inertia(inertia)
    for i, moment in enumerate(np.diag(found.tensor).tolist()):
        read_in_range(moment, f"inertia[{i}]" if np.ndim(found.given) == 1 else f"inertia[{i}, {i}]")
    if found.rotating is not None:
        raise ValueError("inertia is that of a rod; give a body with three positive principal moments")
    mass, gravity = read_in_range(mass, "mass"), read_in_range(gravity, "gravity")
    check_own_mass(found, mass, "mass")
    check_products("mass, inertia and gravity", lambda: gravity * np.array([mass, *np.diag(found.tensor)]))
    moments, along = principal(found.tensor), principal(found.inverse)
    free_flight = ((3, 4, 5), Quadratic(1 / mass))
    if moments is None or along is None:
        potential = _potential_of_tensor(as_tuples(found.tensor), mass, gravity)
        rotation = np.zeros((10, 10))
        rotation[:3, :3] = found.inverse
        H: Any = Quadratic(rotation) + SplitHamiltonian([free_flight, ((6, 7, 8), potential)])
        moments = np.arange(3.0)
    else:
        first, second, third = moments.tolist()
        potential = _potential((first, second, third), mass, gravity)
        rotations = [((i,), Quadratic(value)) for i, value in enumerate(along.tolist())]
        H = SplitHamiltonian([*rotations, free_flight, ((6, 7, 8), potential)])
    return ClassicalBody(
        _algebra(),
        H,
        sign=-1,
        casimirs={"z": Polynomial.variable(9, 10), "|total L|^2": _total_momentum_squared()},
        name="satellite",
        parameters={"inertia": found.given, "mass": mass, "gravity": gravity},
        exact=partial(move_state, "satellite", 10, partial(_spherical_motion, float(moments[0]), mass, gravity))
        if np.ptp(moments) == 0.0
        else None,
        integrals={f"L{k + 1}": Polynomial.variable(k, 10) for k in range(3) if moments[k - 1] == moments[(k + 1) % 3]},
    )


@cache
def _algebra() -> LieAlgebra:
    """Return so(3) acting on (p, r, z); with the body sign, z = [p, r] makes r' = dH/dp."""
    rotation_matrices = so(3).representation
    heisenberg_matrices = heisenberg(3).representation
    assert rotation_matrices is not None and heisenberg_matrices is not None
    action = np.zeros((3, 7, 7))
    action[:, :3, :3] = action[:, 3:6, 3:6] = rotation_matrices
    g = semidirect(so(3), action, heisenberg(3))
    matrices = np.zeros((10, 5, 5))
    matrices[:3, 1:4, 1:4], matrices[3:] = rotation_matrices, heisenberg_matrices
    basis = ("L1", "L2", "L3", "p1", "p2", "p3", "r1", "r2", "r3", "z")
    return LieAlgebra(
        np.column_stack([*g.triples]), dim=10, basis=basis, name="so(3) ⋉ heisenberg(3)", representation=matrices
    )


def _total_momentum_squared() -> Polynomial:
    """Return |z L + r cross p|^2."""
    L1, L2, L3, p1, p2, p3, r1, r2, r3, z = (Polynomial.variable(k, 10) for k in range(10))
    total = z * L1 + r2 * p3 - r3 * p2, z * L2 + r3 * p1 - r1 * p3, z * L3 + r1 * p2 - r2 * p1
    return total[0] ** 2 + total[1] ** 2 + total[2] ** 2


@lru_cache(maxsize=64)
def _potential(moments: tuple[float, float, float], mass: float, gravity: float) -> Hamiltonian:
    """Return V as a function of r, cached, so that it is compiled once for equal parameters."""
    a, b, c = moments
    trace = a + b + c

    def value(r: Any) -> Any:
        square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
        along = (a * r[0] ** 2 + b * r[1] ** 2 + c * r[2] ** 2) / square
        return -gravity * (mass + (trace - 3 * along) / (2 * square)) / np.sqrt(square)

    def gradient(r: Any) -> Any:
        square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
        along = (a * r[0] ** 2 + b * r[1] ** 2 + c * r[2] ** 2) / square
        factor = mass + (3 * trace - 15 * along) / (2 * square)
        strength = gravity / (square * np.sqrt(square))
        result = 0 * r
        result[0] = strength * (factor + 3 * a / square) * r[0]
        result[1] = strength * (factor + 3 * b / square) * r[1]
        result[2] = strength * (factor + 3 * c / square) * r[2]
        return result

    def hessian(r: Any) -> Any:
        moment = np.array([a, b, c])
        square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
        along = (a * r[0] ** 2 + b * r[1] ** 2 + c * r[2] ** 2) / square
        factor = mass + (3 * trace - 15 * along) / (2 * square)
        strength = gravity / (square * np.sqrt(square))
        curvature = -3 * mass + (105 * along - 15 * trace) / (2 * square)
        result = np.outer(r, r)
        for i in range(3):
            for j in range(3):
                result[i, j] *= strength / square * (curvature - 15 * (moment[i] + moment[j]) / square)
            result[i, i] += strength * (factor + 3 * moment[i] / square)
        return result

    return Hamiltonian(value, gradient, hessian)


@lru_cache(maxsize=64)
def _potential_of_tensor(inertia: tuple[tuple[float, ...], ...], mass: float, gravity: float) -> Hamiltonian:
    """Return V for an inertia tensor; its derivatives are those of its recorded operations."""
    (a, f, g), (_, b, h), (_, _, c) = inertia
    trace = a + b + c

    def value(r: Any) -> Any:
        square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
        mixed = f * r[0] * r[1] + g * r[0] * r[2] + h * r[1] * r[2]
        along = (a * r[0] ** 2 + b * r[1] ** 2 + c * r[2] ** 2 + 2 * mixed) / square
        return -gravity * (mass + (trace - 3 * along) / (2 * square)) / np.sqrt(square)

    return Hamiltonian(value)


def _spherical_motion(inertia: float, mass: float, gravity: float, start: Floats, times: Floats) -> Floats:
    """Return the torque-free motion for equal moments: a Kepler orbit in a uniformly rotating body frame."""
    # At a value z of the central coordinate the orbit evolves in the time z t.
    L, p, r, z = start[:3], start[3:6], start[6:9], start[9]
    position, velocity = kepler(r, p / mass, gravity, z * times)
    in_body = [rotate_about(v, L / inertia, times) for v in (mass * velocity, position)]
    return np.concatenate([np.tile(L, (len(times), 1)), *in_body, np.full((len(times), 1), z)], axis=-1)


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
