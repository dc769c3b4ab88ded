"""The double spherical pendulum: Newton's equations with the forces in the rods, cones, and what is kept."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from two_steps import assert_bounded_by_order, assert_order

import coadjoint as co
from coadjoint.analysis.poisson_defect import poisson_defect

pendulum = co.systems.double_spherical_pendulum
MASSES, LENGTHS, GRAVITY = (1.25, 0.5), (0.75, 1.5), 0.9
UP = np.array([0.0, 0.0, 1.0])


def inertia_of(masses, lengths):
    (m1, m2), (l1, l2) = masses, lengths
    return (m1 + m2) * l1**2, m2 * l2**2, m2 * l1 * l2


def with_rods(masses, lengths, right, u1, u2, along):
    """Solve M (w1, w2) = right + forces along the rods, with u_a.w_a given: eight linear equations."""
    a, b, c = inertia_of(masses, lengths)
    E, zero = np.eye(3), np.zeros((1, 3))
    matrix = np.block(
        [
            [a * E, c * E, -u1[:, None], 0 * u1[:, None]],
            [c * E, b * E, 0 * u1[:, None], -u2[:, None]],
            [u1[None], zero, np.zeros((1, 2))],
            [zero, u2[None], np.zeros((1, 2))],
        ]
    )
    found = np.linalg.solve(matrix, np.concatenate([right, along]))
    return found[:3], found[3:6]


def newton(masses, lengths, gravity, u1, u2, v1, v2):
    """The second derivatives of the directions."""
    (m1, m2), (l1, l2) = masses, lengths
    weight = -gravity * np.concatenate([(m1 + m2) * l1 * UP, m2 * l2 * UP])
    return with_rods(masses, lengths, weight, u1, u2, [-v1 @ v1, -v2 @ v2])


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
    np.testing.assert_allclose(late[:6], np.r_[newton(masses, lengths, gravity, u1, u2, v1, v2)], rtol=0, atol=1e-10)
    places = lengths[0] * u1, lengths[0] * u1 + lengths[1] * u2
    speeds = lengths[0] * v1, lengths[0] * v1 + lengths[1] * v2
    energy = sum(m * (v @ v / 2 + gravity * r[2]) for m, r, v in zip(masses, places, speeds, strict=True))
    assert system.energy(x) == pytest.approx(energy, rel=1e-12)
    # another length of q, and of p the inverse: the same directions and angular momenta
    scaled = x * np.repeat([2.0, 0.25, 0.5, 4.0, 1.0], [3, 3, 3, 3, 1])
    assert system.energy(scaled) == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(system.vector_field(scaled)[:6], np.r_[2 * v1, v2 / 4], rtol=0, atol=1e-12)
    h = 2.0**-17
    columns = [
        (system.vector_field(scaled + h * e) - system.vector_field(scaled - h * e)) / (2 * h) for e in np.eye(13)
    ]
    difference = np.abs(system.jacobian(scaled) - np.array(columns).T).max()
    assert difference < 1e-7 * np.abs(system.jacobian(scaled)).max()


@pytest.mark.long
def test_against_newtons_equations():
    u1, u2 = np.array([0.6, 0.0, -0.8]), np.array([0.0, -1.0, 0.0])
    v1, v2 = np.cross([0.1, 0.5, 0.3], u1), np.cross([-0.4, 0.2, 0.3], u2)

    def rates(t, y):
        return np.r_[y[6:], np.r_[newton(MASSES, LENGTHS, GRAVITY, *y.reshape(4, 3))]]

    start = np.r_[u1, u2, v1, v2]
    end = solve_ivp(rates, (0, 3), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1].reshape(4, 3)
    system, along = pendulum(MASSES, LENGTHS, GRAVITY), (0.3, -0.2)
    x0, wanted = state(MASSES, LENGTHS, u1, u2, v1, v2, along), state(MASSES, LENGTHS, *end, along)
    for method, step in ((co.GaussLegendre(stages=1), 0.02), (co.GaussLegendre(stages=2), 0.1)):
        assert_order(system, x0, 3.0, step, method, wanted)


# angles of the second rod, and where the first one is; on different sides the masses are on different sides as well
BRACKETS = {0.9: (0.01, 0.9), -0.5: (0.6, 0.95)}


@pytest.mark.parametrize("second", BRACKETS)
def test_cones(second):
    """Both rods turn about the vertical at one rate, on the same side or on different ones."""
    (m1, m2), (l1, l2) = MASSES, LENGTHS

    def radii(first):
        return l1 * np.sin(first), l1 * np.sin(first) + l2 * np.sin(second)

    def square(first):  # of the rate, from the second mass: its weight and its rod
        return GRAVITY * np.tan(second) / radii(first)[1]

    def torque(first):  # on the first rod: both weights, and both masses that turn
        inward = square(first) * (m1 * radii(first)[0] + m2 * radii(first)[1])
        return (m1 + m2) * GRAVITY * np.sin(first) - inward * np.cos(first)

    first = brentq(torque, *BRACKETS[second], xtol=1e-15)
    rate = np.sqrt(square(first))

    def at(t):
        c, s = np.cos(rate * t), np.sin(rate * t)
        u = [np.array([np.sin(a) * c, np.sin(a) * s, -np.cos(a)]) for a in (first, second)]
        return state(MASSES, LENGTHS, *u, *(np.cross(rate * UP, v) for v in u))

    system = pendulum(MASSES, LENGTHS, GRAVITY)
    late = at(1.0)
    turning = np.concatenate([np.cross(rate * UP, v) for v in late[:12].reshape(4, 3)])
    np.testing.assert_allclose(system.vector_field(late)[:12], turning, rtol=0, atol=1e-13)
    assert_order(system, at(0.0), 2.0, 0.05, co.GaussLegendre(stages=2), at(2.0))


def test_gauss_keeps_bracket_and_integrals():
    system = pendulum(MASSES, LENGTHS, GRAVITY)
    names = ["|q1|^2", "q1.p1", "|q2|^2", "q2.p2"]
    assert list(system.integrals) == [*names, "total L3"]
    assert list(pendulum(gravity=0.0).integrals) == [*names, "total L1", "total L2", "total L3"]
    *_, u1, u2, v1, v2, along = drawn(5)
    x0 = state(MASSES, LENGTHS, u1, u2, v1, v2, along)
    run = co.integrate(system, x0, (0, 10), 0.05, co.GaussLegendre(stages=2), observe=system.integrals)
    total = sum(np.cross(run.x[:, 3 * k : 3 * k + 3], run.x[:, 6 + 3 * k : 9 + 3 * k]) for k in (0, 1))
    sizes = 1 + np.abs(run.x).max() ** 2
    np.testing.assert_allclose(run.observed["total L3"], total[:, 2], rtol=0, atol=1e-13 * sizes)
    # u for each of 200 steps, times what is added up
    assert max(np.ptp(values) for values in run.observed.values()) < 200 * 12 * 2.0**-53 * sizes
    assert run.observed["q1.p1"][0] == pytest.approx(along[0], abs=1e-13)
    assert_bounded_by_order(system.energy, system, x0, 4.0, 0.1, co.GaussLegendre(stages=1))
    assert co.GaussLegendre().properties(system).poisson
    step = co.stepper(system, co.GaussLegendre(stages=2), 0.1)
    assert poisson_defect(step, x0).poisson


def test_what_cannot_be_done_is_said():
    with pytest.raises(ValueError, match="Splitting cannot be used for double_spherical_pendulum"):
        co.Splitting().describe(pendulum())
