"""The binary asteroid 1999 KW4, two ellipsoids under their mutual gravity."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.attitudes import body_columns, rotations_of, stacked
from coadjoint.checkcases.check_case import ATTITUDE, RATES, CheckCase, Columns, DerivedQuantity, Quantity
from coadjoint.checkcases.integration import IntegratedMotion
from coadjoint.checkcases.registry import checkcase
from coadjoint.methods.splitting import Splitting
from coadjoint.systems.bodies.gravitating_bodies import gravitating_bodies

Floats = npt.NDArray[np.float64]

G = 6.6743e-11  # m^3/(kg s^2)
MASSES = np.array([2.353e12, 0.135e12])  # kg
EXTENTS = np.array([[1532.0, 1495.0, 1347.0], [571.0, 463.0, 349.0]])  # m, along the axes of each body
DISTANCE, PERIOD, SPIN = 2548.0, 17.4223 * 3600.0, 2.7645 * 3600.0  # m, s
TILT, LIBRATION, END = 0.05, 0.1, 120_000.0  # of the spin axis of Alpha, and of Beta about the normal; s
METHODS = (Splitting(order=8, parts="free_body"), Splitting(order=6, parts="free_body"))
STEP = 100.0  # s


def quantities_of_body(body: int) -> tuple[Quantity, Quantity]:
    """Return the rates and the attitude of one of several bodies, with numbered columns."""
    return (
        RATES._replace(name=f"rates {body}", columns=tuple(f"{name}_{body}" for name in RATES.columns)),
        ATTITUDE._replace(name=f"attitude {body}", columns=tuple(f"{name}_{body}" for name in ATTITUDE.columns)),
    )


POSITION = Quantity("position", ("rx", "ry", "rz"), "m", "vector", "centre of the second body from the first, in space")
VELOCITY = Quantity("velocity", ("vx", "vy", "vz"), "m/s", "vector", "derivative of the position, in space")


def relative_columns(system: object, x: Floats) -> Columns:
    """Return the columns of two bodies from their states (k, n)."""
    apart = system.positions(x)  # type: ignore[attr-defined]
    moving = system.velocities(x)  # type: ignore[attr-defined]
    rates, attitudes = system.angular_velocity(x), system.attitudes(x)  # type: ignore[attr-defined]
    columns = dict(zip(POSITION.columns, (apart[:, 1] - apart[:, 0]).T, strict=True))
    columns |= dict(zip(VELOCITY.columns, (moving[:, 1] - moving[:, 0]).T, strict=True))
    for k in range(2):
        columns |= body_columns(rates[:, k], Rotation.from_matrix(attitudes[:, k]), f"_{k + 1}")
    return columns


def pair_momentum(columns: Mapping[str, Floats], masses: Floats, moments: Floats) -> Floats:
    """Return the angular momentum of two bodies about their centre of mass, in space."""
    r, v = stacked(columns, POSITION.columns), stacked(columns, VELOCITY.columns)
    total = np.cross(r, masses.prod() / masses.sum() * v)
    for k in range(2):
        rates, attitude = quantities_of_body(k + 1)
        total = total + rotations_of(columns, attitude.columns).apply(moments[k] * stacked(columns, rates.columns))
    return total


def pair_kinetic(columns: Mapping[str, Floats], masses: Floats, moments: Floats) -> Floats:
    """Return the kinetic energy of two bodies about their centre of mass."""
    v = stacked(columns, VELOCITY.columns)
    total = 0.5 * masses.prod() / masses.sum() * np.sum(v**2, axis=1)
    for k in range(2):
        total = total + 0.5 * stacked(columns, quantities_of_body(k + 1)[0].columns) ** 2 @ moments[k]
    return np.asarray(total)


def _energy(columns: Mapping[str, Floats], moments: Floats) -> Floats:
    r = stacked(columns, POSITION.columns)
    s = np.linalg.norm(r, axis=1)
    potential = -G * MASSES.prod() / s
    for k in range(2):
        u = rotations_of(columns, quantities_of_body(k + 1)[1].columns).inv().apply(r / s[:, None])
        potential -= G * MASSES[1 - k] * (moments[k].sum() - 3.0 * u**2 @ moments[k]) / (2.0 * s**3)
    return pair_kinetic(columns, MASSES, moments) + potential


@checkcase
def two_asteroids() -> CheckCase:
    """Return the binary asteroid 1999 KW4: two ellipsoids under their mutual gravity to the second moments."""
    squares = (EXTENTS / 2.0) ** 2
    moments = MASSES[:, None] * (squares.sum(axis=1, keepdims=True) - squares) / 5.0
    system = gravitating_bodies(moments, MASSES, G=G, order=2)
    shares = np.array([-MASSES[1], MASSES[0]]) / MASSES.sum()
    turned = Rotation.from_rotvec([[TILT, 0.0, 0.0], [0.0, 0.0, LIBRATION]])
    rate = 2.0 * math.pi / PERIOD
    spins = [[0.0, 0.0, 2.0 * math.pi / SPIN], [0.0, 0.0, rate]]
    x0 = system.state(
        np.outer(shares, [DISTANCE, 0.0, 0.0]), np.outer(shares, [0.0, rate * DISTANCE, 0.0]), turned, spins
    )
    motion = IntegratedMotion(system, x0, STEP, METHODS, lambda x, t: relative_columns(system, x))
    times = np.linspace(0.0, END, 241)
    both = tuple(quantity for k in (1, 2) for quantity in quantities_of_body(k))
    names = tuple(quantity.name for quantity in (POSITION, VELOCITY, *both))
    return CheckCase(
        name="two_asteroids",
        title="the binary asteroid 1999 KW4, two bodies under their mutual gravity",
        statement=(
            "Two homogeneous ellipsoids of the published extents and masses, with V = -G m1 m2/s - sum over (i, j) "
            "= (1, 2), (2, 1) of G m_j (tr I_i - 3 u . I_i u)/(2 s^3), s the distance of the centres and u its "
            "direction in the frame of body i: MacCullagh's expansion to the second moments of both bodies, and no "
            "higher terms. I_i = m_i diag(b^2 + c^2, a^2 + c^2, a^2 + b^2)/5 with the semiaxes a, b, c. At t = 0 "
            "the second body, Beta, is at (distance, 0, 0) from the first, Alpha, with the velocity (0, 2 pi "
            "distance/period, 0); Alpha is turned by the tilt about the first axis, Beta by the libration about "
            "the third; they spin about their third axes with the periods spin and period. Quaternions are from "
            "the body to space, and rates in the frame of each body."
        ),
        parameters={
            "G": (G, "m^3/(kg s^2)"),
            "masses": (MASSES, "kg"),
            "extents": (EXTENTS, "m"),
            "inertia": (moments, "kg m^2"),
            "distance": (DISTANCE, "m"),
            "period": (PERIOD, "s"),
            "spin": (SPIN, "s"),
            "tilt": (TILT, "rad"),
            "libration": (LIBRATION, "rad"),
            "end": (END, "s"),
        },
        quantities=(POSITION, VELOCITY, *both),
        motion=motion,
        times=times,
        accuracy=1e-10,
        basis="this library, splittings of orders 8 and 6 with exact free bodies, and DOP853 agree",
        source=(
            "S. J. Ostro et al., Radar imaging of binary near-Earth asteroid (66391) 1999 KW4, Science 314, 1276 "
            "(2006): extents, masses, distance and periods; tilt and libration are chosen"
        ),
        invariants=(
            DerivedQuantity("energy", "J", lambda columns: _energy(columns, moments), names),
            DerivedQuantity("momentum", "kg m^2/s", lambda columns: pair_momentum(columns, MASSES, moments), names),
        ),
    )
