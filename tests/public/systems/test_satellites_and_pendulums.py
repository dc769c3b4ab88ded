"""The satellite and the double spherical pendulum: point masses, Newton's equations, Kepler and steady motions."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

satellite, pendulum = co.systems.satellite, co.systems.double_spherical_pendulum

MASS, GRAVITY = 1.5, 0.8

X0 = np.array([0.3, -0.4, 0.5, 0.2, 0.9, -0.1, 3.0, 0.4, -0.5, 1.0])


def by_hand(x, inertia, mass, gravity):
    L, p, r = x[:3], x[3:6], x[6:9]
    omega, d, u = L / inertia, np.linalg.norm(r), r / np.linalg.norm(r)
    inertia = np.asarray(inertia)
    gradient = inertia.sum() * u + 2 * inertia * u - 5 * (u @ (inertia * u)) * u
    down = gravity * (mass / d**2 * u + 1.5 / d**4 * gradient)
    turning = np.cross(L, omega) + np.cross(r, down)
    return np.concatenate([turning, np.cross(p, omega) - down, np.cross(r, omega) + p / mass, [0]])


@pytest.mark.parametrize("seed", range(3))
def test_field_by_hand(seed):
    rng = np.random.default_rng(seed)
    inertia, mass, gravity = rng.uniform(1.5, 3, 3), *rng.uniform(0.5, 3, 2)
    system = satellite(inertia, mass, gravity)
    x = np.r_[rng.standard_normal(6), 2 + rng.uniform(size=3), 1.0]
    np.testing.assert_allclose(system.vector_field(x), by_hand(x, inertia, mass, gravity), rtol=0, atol=1e-14)
    assert system.sign == -1 and system.integrals == {}


def test_casimir_and_parts_of_a_satellite():
    system = satellite((2.0, 2.0, 1.0), MASS, GRAVITY)
    total = X0[:3] + np.cross(X0[6:9], X0[3:6])
    assert system.casimirs["|total L|^2"](X0) == pytest.approx(total @ total, rel=1e-14)
    assert "H in 5 parts" in str(co.Splitting().describe(system))


@pytest.mark.parametrize(("speed", "along"), [(0.9, 0.3), (1.8, -1.2), (np.sqrt(2), 0.0), (2.5, 0.4), (0.6, -0.5)])
@pytest.mark.parametrize("t", [0.01, 3.0, -7.0, 60.0])
def test_every_orbit_of_kepler(speed, along, t):
    """What every orbit keeps, and the way back: ellipses, a parabola and hyperbolas, inward and outward."""
    system, mass, d = satellite((0.7, 0.7, 0.7), MASS, GRAVITY), MASS, 1.25
    circle = np.sqrt(GRAVITY / d)
    x0 = np.r_[0, 0, 0, mass * circle * np.array([along, np.sqrt(speed**2 - along**2), 0.1]), d, 0, 0, 1]
    end = system.exact(x0, t)
    r, v = end[6:9], end[3:6] / mass
    r0, v0 = x0[6:9], x0[3:6] / mass

    def kept(r, v):  # energy, angular momentum, and the vector of Laplace along the axis of the orbit
        h = np.cross(r, v)
        return np.r_[v @ v / 2 - GRAVITY / np.linalg.norm(r), h, np.cross(v, h) - GRAVITY * r / np.linalg.norm(r)]

    np.testing.assert_allclose(kept(r, v), kept(r0, v0), rtol=0, atol=1e-13)
    np.testing.assert_allclose(system.exact(end, -t), x0, rtol=0, atol=1e-11)


ROD_MASSES, LENGTHS, PULL = (1.25, 0.5), (0.75, 1.5), 0.9

UP = np.array([0.0, 0.0, 1.0])


def inertia_of(masses, lengths):
    (m1, m2), (l1, l2) = masses, lengths
    return (m1 + m2) * l1**2, m2 * l2**2, m2 * l1 * l2


def newton(masses, lengths, gravity, u1, u2, v1, v2):
    """The second derivatives of the directions, with forces along the rods: eight linear equations."""
    (m1, m2), (l1, l2), (a, b, c) = masses, lengths, inertia_of(masses, lengths)
    E, zero = np.eye(3), np.zeros((1, 3))
    matrix = np.block(
        [
            [a * E, c * E, -u1[:, None], 0 * u1[:, None]],
            [c * E, b * E, 0 * u1[:, None], -u2[:, None]],
            [u1[None], zero, np.zeros((1, 2))],
            [zero, u2[None], np.zeros((1, 2))],
        ]
    )
    weight = -gravity * np.concatenate([(m1 + m2) * l1 * UP, m2 * l2 * UP])
    return np.linalg.solve(matrix, np.r_[weight, -v1 @ v1, -v2 @ v2])[:6]


def state(masses, lengths, u1, u2, v1, v2, along=(0.0, 0.0)):
    """The state in which p has these components along q."""
    a, b, c = inertia_of(masses, lengths)
    p1, p2 = a * v1 + c * v2, b * v2 + c * v1
    p1, p2 = p1 + (along[0] - p1 @ u1) * u1, p2 + (along[1] - p2 @ u2) * u2
    return np.concatenate([u1, u2, p1, p2, [1.0]])


def drawn(seed):
    rng = np.random.default_rng(seed)
    masses, lengths, gravity = rng.uniform(0.3, 3, 2), rng.uniform(0.3, 3, 2), rng.uniform(0.3, 3)
    u = rng.standard_normal((2, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    v = np.cross(u, rng.standard_normal((2, 3)))
    return masses, lengths, gravity, *u, *v, rng.standard_normal(2)


@pytest.mark.parametrize("seed", range(4))
def test_velocities_accelerations_and_energy(seed):
    masses, lengths, gravity, u1, u2, v1, v2, along = drawn(seed)
    system, x = pendulum(masses, lengths, gravity), state(masses, lengths, u1, u2, v1, v2, along)
    field = system.vector_field(x)
    np.testing.assert_allclose(field[:6], np.r_[v1, v2], rtol=0, atol=1e-12)
    late = system.jacobian(x) @ field
    np.testing.assert_allclose(late[:6], newton(masses, lengths, gravity, u1, u2, v1, v2), rtol=0, atol=1e-10)
    places = lengths[0] * u1, lengths[0] * u1 + lengths[1] * u2
    speeds = lengths[0] * v1, lengths[0] * v1 + lengths[1] * v2
    energy = sum(m * (v @ v / 2 + gravity * r[2]) for m, r, v in zip(masses, places, speeds, strict=True))
    assert system.energy(x) == pytest.approx(energy, rel=1e-12)
    # another length of q, and of p the inverse: the same directions and angular momenta
    scaled = x * np.repeat([2.0, 0.25, 0.5, 4.0, 1.0], [3, 3, 3, 3, 1])
    assert system.energy(scaled) == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(system.vector_field(scaled)[:6], np.r_[2 * v1, v2 / 4], rtol=0, atol=1e-12)


def test_integrals_of_the_pendulum():
    names = ["|q1|^2", "q1.p1", "|q2|^2", "q2.p2"]
    assert list(pendulum(gravity=0.0).integrals) == [*names, "total L1", "total L2", "total L3"]
    system = pendulum(ROD_MASSES, LENGTHS, PULL)
    assert list(system.integrals) == [*names, "total L3"]
    *_, u1, u2, v1, v2, along = drawn(5)
    x = state(ROD_MASSES, LENGTHS, u1, u2, v1, v2, along)
    total = np.cross(x[:3], x[6:9]) + np.cross(x[3:6], x[9:12])
    values = {name: F(x) for name, F in system.integrals.items()}
    assert values == pytest.approx(
        {"|q1|^2": 1.0, "q1.p1": along[0], "|q2|^2": 1.0, "q2.p2": along[1], "total L3": total[2]}, rel=1e-12
    )
    with refused(ValueError, "Splitting", "double_spherical_pendulum"):
        co.Splitting().describe(pendulum())
