"""Bodies with attitudes and positions: closed forms, DOP853 in quaternions, invariants, states and refusals."""

import inspect

import numpy as np
import pytest
from pairs_of_bodies import (
    MASSES,
    PLACES,
    SHAPES,
    SPEEDS,
    SPINS,
    TURNED,
    S,
    pair_of_bodies,
    splitting,
    spring,
    spring_slopes,
)
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

import coadjoint as co
from long import long_beyond
from refusals import refused


def tensor_of(shape):
    return np.diag(shape) if np.ndim(shape) == 1 else np.array(shape)


def force_and_torque(r, A, I, m, G):
    """MacCullagh's force on a body, and the torque on it in space, of another one at -r (positions from that one)."""
    (I1, I2), (m1, m2) = (A[k] @ I[k] @ A[k].T for k in (0, 1)), m
    s, u = np.linalg.norm(r), r / np.linalg.norm(r)
    force = -G * m1 * m2 * u / s**2
    for inertia, other in ((I1, m2), (I2, m1)):
        along = u @ inertia @ u
        force -= 1.5 * G * other / s**4 * ((np.trace(inertia) - 5 * along) * u + 2 * inertia @ u)
    return force, [3 * G * other / s**3 * np.cross(u, inertia @ u) for inertia, other in ((I1, m2), (I2, m1))]


def newton_and_euler(pair, x0, t_end):
    """Return the state at the end, by DOP853 in quaternions and angular velocities, without this library."""
    I, m, G = [tensor_of(shape) for shape in SHAPES], np.array(MASSES), 1.0

    def slope(t, y):
        r, v, q, omega = (part.reshape(2, -1) for part in np.split(y, [6, 12, 20]))
        A = Rotation.from_quat(q).as_matrix()
        force, torques = force_and_torque(r[1] - r[0], A, I, m, G)
        turning = [np.linalg.solve(I[k], A[k].T @ torques[k] - np.cross(omega[k], I[k] @ omega[k])) for k in (0, 1)]
        dq = [0.5 * np.r_[q[k, 3] * omega[k] + np.cross(q[k, :3], omega[k]), -q[k, :3] @ omega[k]] for k in (0, 1)]
        return np.concatenate([v.ravel(), -force / m[0], force / m[1], *dq, *turning])

    start = [pair.positions(x0), pair.velocities(x0), Rotation.from_matrix(pair.attitudes(x0)).as_quat()]
    y0 = np.concatenate([*(part.ravel() for part in start), pair.angular_velocity(x0).ravel()])
    y = solve_ivp(slope, (0.0, t_end), y0, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    r, v, q, omega = (part.reshape(2, -1) for part in np.split(y, [6, 12, 20]))
    return pair.state(r, v, Rotation.from_quat(q / np.linalg.norm(q, axis=1)[:, None]), omega)


def test_two_bodies_by_dop853_in_quaternions():
    """Orders 2 and 4, and the trajectory over several orbits to 1e-11."""
    pair, x0 = pair_of_bodies()
    t_end = 30.0  # two orbits and a half, three turns of the bodies
    wanted = newton_and_euler(pair, x0, t_end)
    for order, steps in ((2, (960, 1920)), (4, (480, 960))):
        coarse, fine = (
            np.abs(co.integrate(pair, x0, (0, t_end), t_end / n, splitting(order)).x[-1] - wanted).max() for n in steps
        )
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.2), (order, coarse, fine)
    sol = co.integrate(pair, x0, (0, t_end), 0.02, splitting(8))
    assert np.abs(sol.x[-1] - wanted).max() < 3e-11
    assert np.abs(sol.rotation[-2:].as_matrix() - pair.attitudes(wanted)).max() < 3e-11
    np.testing.assert_array_equal(sol.positions[0], PLACES)


@pytest.mark.parametrize("parts", ["auto", "free_body"])
def test_invariants_of_two_bodies(parts):
    """Axes, momentum and angular momentum in space to rounding; the energy to the order of the scheme."""
    pair, x0 = pair_of_bodies()
    sol = co.integrate(pair, x0, (0, 200), 0.02, co.Splitting(order=4, parts=parts), observe=pair.integrals)
    drift = sol.drift()
    assert drift.pop("energy") < 1e-8 and max(map(float, drift.values())) < 1e-12
    assert len(drift) == 13 and len(sol.observed) == 6
    for name, values in sol.observed.items():
        assert np.abs(values - values[0]).max() < 1e-12, name
    x, m = sol.x, np.array(MASSES)[:, None]
    r, p = sol.positions, m * sol.velocities
    total = np.cross(r, p).sum(axis=1) + pair.angular_momentum(x, frame="space").sum(axis=1)
    np.testing.assert_allclose(total, np.stack([sol.observed[f"total L{k}"] for k in (1, 2, 3)], axis=1), atol=1e-13)
    np.testing.assert_allclose(p.sum(axis=1), np.stack([sol.observed[f"total p{k}"] for k in (1, 2, 3)], axis=1))


def kepler_position(a, e, n, t):
    """The position on an ellipse from its pericentre, by Kepler's equation."""
    E = brentq(lambda E: E - e * np.sin(E) - n * t, n * t - 1, n * t + 1, xtol=1e-15)
    return a * np.array([np.cos(E) - e, np.sqrt(1 - e * e) * np.sin(E), 0.0])


@pytest.mark.parametrize("order", [0, 2])
def test_two_spheres_are_keplers_problem(order):
    """Also of any shape to order 0; the spin of a ball is constant."""
    shapes = ((0.3, 0.3, 0.3), (0.7, 0.7, 0.7)) if order else SHAPES
    pair, (m1, m2), G = S.gravitating_bodies(shapes, (2.0, 0.5), G=0.8, order=order), (2.0, 0.5), 0.8
    mu, a, e = G * (m1 + m2), 2.0, 0.4
    n, r, v = np.sqrt(mu / a**3), a * (1 - e), np.sqrt(mu / a * (1 + e) / (1 - e))
    shares = np.array([-m2, m1])[:, None] / (m1 + m2)
    drifting = np.array([0.1, -0.2, 0.3])
    x0 = pair.state(shares * [r, 0, 0], shares * [0, v, 0] + drifting, angular_velocities=SPINS)
    sol = co.integrate(pair, x0, (0, 20), 0.01, splitting(8), save_every=200)
    for t, (first, second) in zip(sol.t, sol.positions, strict=True):
        np.testing.assert_allclose(second - first, kepler_position(a, e, n, t), rtol=0, atol=1e-12)
        np.testing.assert_allclose(
            (m1 * first + m2 * second) / (m1 + m2), t * drifting, rtol=0, atol=4e-12
        )  # 30000 flows
    if order:
        np.testing.assert_allclose(sol.angular_velocity, np.broadcast_to(SPINS, sol.angular_velocity.shape), rtol=1e-13)


def ellipsoid(mass, semiaxes):
    """Return points and masses with the moments of a homogeneous ellipsoid up to the fifth, and its inertia."""
    golden = (1 + 5**0.5) / 2
    corners = np.array([[0.0, a, b * golden] for a in (1, -1) for b in (1, -1)]) / np.sqrt(1 + golden**2)
    sphere = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    r, w = np.polynomial.legendre.leggauss(6)
    r, w = (r + 1) / 2, 1.5 * w * ((r + 1) / 2) ** 2
    points = (r[:, None, None] * sphere).reshape(-1, 3) * semiaxes
    squares = np.square(semiaxes)
    return points, mass * np.repeat(w / 12, 12), mass / 5 * (squares.sum() - squares)


@pytest.mark.parametrize("order, power", [(0, 2), (2, 4), (4, 6)])
def test_the_potential_is_the_limit_of_sums_over_masses(order, power):
    """MacCullagh's limit: what is left out is smaller by that power of the distance."""
    (b1, w1, I1), (b2, w2, I2) = ellipsoid(2.0, (0.5, 0.4, 0.3)), ellipsoid(1.0, (0.3, 0.25, 0.2))
    pair, A, u = S.gravitating_bodies([I1, I2], [2.0, 1.0], order=order), TURNED.as_matrix(), np.array([2, -1, 2]) / 3

    def missing(s):
        ends = (b1 @ A[0].T)[:, None] - (s * u + b2 @ A[1].T)[None]
        whole = -(w1[:, None] * w2 / np.linalg.norm(ends, axis=-1)).sum()
        return abs(pair.energy(pair.state([[0, 0, 0], s * u], attitudes=A)) / whole - 1)

    assert np.log2(missing(4.0) / missing(8.0)) == pytest.approx(power, abs=0.4)


@pytest.mark.parametrize("order", long_beyond(1, [2, 4]))
def test_derivatives_by_masses_inertias_and_G_are_those_of_units(order):
    """With units of mass, momenta and 1/G change and motions do not; G in units of time is that of velocities."""
    pair = S.gravitating_bodies(((0.2, 0.4, 0.5), (0.4, 0.6, 0.8)), MASSES, 0.8, order)
    x0 = pair.state(PLACES, SPEEDS, TURNED, SPINS)
    ready, moving = co.prepare(pair, co.Splitting(order=8), step=1 / 32), np.ones(pair.dim)
    moving[[*range(3, 12), *range(15, 24), *range(30, 37)]] = 0.0  # axes, positions and z
    shapes, masses, G = (np.array(ready.parameters[name]) for name in ("inertias", "masses", "G"))
    sol, tangents = ready.jvp(x0, (0, 2), {"x0": moving * x0, "inertias": shapes, "masses": masses, "G": -G}, 16)
    assert tangents.rule == dict.fromkeys(("inertias", "masses", "G"), "exact")
    np.testing.assert_allclose(tangents.x, moving * sol.x, rtol=0, atol=1e-12)
    _, tangents = ready.jvp(x0, (0, 2), {"x0": moving * x0, "G": 2 * G}, 16)
    expected = sol.t[:, None] * pair.vector_field(sol.x) + moving * sol.x
    np.testing.assert_allclose(tangents.x, expected, rtol=0, atol=1e-10)
    weights = np.cos(np.arange(sol.x.size)).reshape(sol.x.shape)
    gradient = ready.vjp(x0, (0, 2), 16)[1](weights)
    along = gradient["x0"] @ (moving * x0) + 2 * G * gradient["G"]
    np.testing.assert_allclose(along, (weights * tangents.x).sum(), rtol=1e-11)


def pendulum(amplitude, rate, t):
    """The angle of a pendulum, phi'' = -rate^2 sin(phi), that starts at rest at an angle."""
    k = np.sin(amplitude / 2) ** 2
    sn, *_ = ellipj(ellipk(k) + rate * t, k)
    return 2 * np.arcsin(np.sin(amplitude / 2) * sn)


def orbiting(inertia, mass, distance, angle):
    """Return a satellite on a circle around the Earth, in SI units, its first axis turned from the radius."""
    earth, G = 5.9722e24, 6.6743e-11
    pair = S.gravitating_bodies([(0, 0, 0), inertia], [earth, mass], G=G)
    # The gradient of gravity adds 1e-16 to the rate of the orbit.
    n = np.sqrt(G * earth / distance**3)
    turned = Rotation.from_rotvec([[0, 0, 0], [0, 0, angle]])
    omega = [[0, 0, 0], [0, 0, n]]
    return pair, pair.state([[0, 0, 0], [distance, 0, 0]], [[0, 0, 0], [0, n * distance, 0]], turned, omega), n


def pitch_of(sol):
    r, A = sol.positions[:, 1] - sol.positions[:, 0], sol.rotation.as_matrix()[1::2]
    return np.arctan2(A[:, 1, 0] * r[:, 0] - A[:, 0, 0] * r[:, 1], A[:, 0, 0] * r[:, 0] + A[:, 1, 0] * r[:, 1])


@pytest.mark.parametrize("amplitude, orbits, order", [(1e-3, 3, 4), (0.5, 3, 8), (0.5, 100, 8)])
def test_pitch_of_a_cubesat(amplitude, orbits, order):
    """0.03 kg m^2 at 7e6 m: the libration of a pendulum, to 1e-6 degrees after 100 orbits."""
    inertia = np.array([0.0065, 0.0325, 0.034])
    sat, x0, n = orbiting(inertia, 4.0, 7e6, amplitude)
    rate = n * np.sqrt(3 * (inertia[1] - inertia[0]) / inertia[2])
    period = 2 * np.pi / n
    sol = co.integrate(sat, x0, (0, orbits * period), period / 256, splitting(order), save_every=128)
    wanted = pendulum(2 * amplitude, rate, sol.t) / 2
    assert np.degrees(np.abs(pitch_of(sol) - wanted).max()) < (1e-6 if order == 8 else 2e-5)
    if amplitude < 0.01:  # the closed form of small angles
        np.testing.assert_allclose(pitch_of(sol), amplitude * np.cos(rate * sol.t), rtol=0, atol=1e-5 * amplitude)


def test_torques_of_gravity_do_not_see_the_isotropic_part():
    """With 1e16 times the anisotropic part: no digit is lost."""
    small = np.array([1.0, 2.0, 3.0])
    torques = []
    for isotropic in (0.0, 2.0**53):
        pair = S.gravitating_bodies([small + isotropic, (0, 0, 0)], [1.0, 1e3])
        x = pair.state([[0, 0, 0], [9.0, 2.0, 4.0]], attitudes=TURNED)
        torques.append(pair.vector_field(x)[:3])
    if (small + 2.0**53 - 2.0**53 == small).all():
        np.testing.assert_allclose(torques[1], torques[0], rtol=1e-14)
    ball = S.gravitating_bodies([(0.7, 0.7, 0.7), (0, 0, 0)], [1.0, 1e3])
    assert not ball.vector_field(ball.state([[0, 0, 0], [9.0, 2.0, 4.0]], attitudes=TURNED))[:3].any()


def aim(x, A, t):
    """A spring and a damper toward an attitude that turns, and a disturbance."""
    error = np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]])
    return -0.5 * error - x[:3] + 0.1 * np.array([np.sin(t), 0.0, np.cos(2 * t)])


def test_a_controller_by_dop853():
    inertia, first = np.array([1.0, 2.0, 2.5]), Rotation.from_rotvec([1.0, 0.5, -0.3])
    free = S.body(inertia)
    sat = free.with_forces(co.forces.Torque(aim))
    x0 = sat.state(first, angular_velocity=(0.3, 0.1, 0.0))

    def slope(t, y):
        q, L = y[:4], y[4:]
        omega, A = L / inertia, Rotation.from_quat(q).as_matrix()
        dq = 0.5 * np.r_[q[3] * omega + np.cross(q[:3], omega), -q[:3] @ omega]
        return np.r_[dq, np.cross(L, omega) + aim(np.r_[L, A.ravel()], A, t)]

    y = solve_ivp(slope, (0, 20), np.r_[first.as_quat(), x0[:3]], method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    wanted = np.r_[y[4:], Rotation.from_quat(y[:4]).as_matrix().ravel()]
    errors = [np.abs(co.integrate(sat, x0, (0, 20), h, splitting(2)).x[-1] - wanted).max() for h in (0.05, 0.025)]
    assert errors[1] < 2e-6 and errors[0] / errors[1] == pytest.approx(4, abs=0.1)
    field = sat.vector_field(x0, 0.5) - free.vector_field(x0)
    np.testing.assert_allclose(field, np.r_[aim(x0, free.attitudes(x0), 0.5), np.zeros(9)], rtol=0, atol=1e-15)
    members = np.stack([x0, sat.state(angular_velocity=(0.0, 0.2, 0.1))])
    many = co.integrate(sat, members, (0, 2), 0.05, splitting(2))
    for k, one in enumerate(members):
        np.testing.assert_array_equal(many.x[:, k], co.integrate(sat, one, (0, 2), 0.05, splitting(2)).x)
    assert many.angular_velocity.shape == (41, 2, 3) and len(many.rotation) == 82


def test_torques_of_several_bodies_and_of_the_attitude_alone():
    def damping(x, A):
        return -0.2 * x[:24].reshape(2, 12)[:, :3] + 0.01 * A[:, 2, :]

    free, x0 = pair_of_bodies()
    pair = free.with_forces(co.forces.Torque(damping))
    change = pair.vector_field(x0) - free.vector_field(x0)
    L, A = free.angular_momentum(x0), free.attitudes(x0)
    np.testing.assert_allclose(change[:24].reshape(2, 4, 3)[:, 0], -0.2 * L + 0.01 * A[:, 2], rtol=0, atol=1e-15)
    assert np.abs(change).sum() == pytest.approx(np.abs(change[:24].reshape(2, 4, 3)[:, 0]).sum(), abs=1e-14)
    sol = co.integrate(pair, x0, (0, 5), 0.05, splitting(2))
    finer = co.integrate(pair, x0, (0, 5), 0.0125, splitting(2))
    assert np.abs(sol.x[-1] - finer.x[-1]).max() < 1e-3
    assert np.linalg.norm(sol.angular_momentum[-1]) < 0.8 * np.linalg.norm(sol.angular_momentum[0])


def test_torques_of_the_attitude_are_refused_without_one():
    torque = co.forces.Torque(aim)
    for system in (S.rigid_body(), S.heavy_top(), S.body(attitude=False)):
        with refused(TypeError, "attitude", system.name, "co.systems.body"):
            system.with_forces(torque)
    with refused(ValueError, "(2, 3)", "gravitating_bodies"):
        pair_of_bodies()[0].with_forces(co.forces.Torque(lambda x, A: x[:3]))
    for function in (lambda x, A, t, gain: x[:3], lambda omega, A, other: omega, lambda x, A, y: x[:3]):
        with refused(TypeError, "A, ", "x, A, omega and t"):
            co.forces.Torque(function)
    with refused(TypeError, "omega", "no body"):
        co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1, 2, 3])).with_forces(
            co.forces.Torque(lambda omega: omega)
        )
    given = co.forces.Torque(lambda x, A, gain=2.0: gain * A[2])
    np.testing.assert_allclose(given.field(S.body(), S.body().state(), 0.0)[:3], [0.0, 0.0, 2.0])


def test_the_second_argument_of_a_torque_is_the_time():
    """Messages say with what a function is called, and names of an attitude in place of A are refused."""
    for system in (S.rigid_body(), S.body()):
        for function in (lambda x, attitude: -x, lambda x, q: -x, lambda x, R: -x):
            with refused(TypeError, "second argument is the time t", "name the attitude A"):
                system.with_forces(co.forces.Torque(function))
        with refused(ValueError, "called with (x, t)", "sample point"):
            system.with_forces(co.forces.Torque(lambda x, B: B[0]))
        with refused(ValueError, "called with (x, t)", "(2,)", system.name):
            system.with_forces(co.forces.Torque(lambda x, t: x[:2]))
    with refused(ValueError, "called with (x)", "(4,)", "(12,)", "(3,)"):
        S.body().with_forces(co.forces.Torque(lambda x: -x[:4]))
    with refused((TypeError, ValueError), "(t, x)", "(x, t)"):
        co.integrate(S.rigid_body(), (1, 0, 0), (0, 1), 0.1, observe={"first": lambda t, x: x[0]})


MATRIX = np.array([[1.2, 0.1, 0.0], [0.1, 2.0, -0.2], [0.0, -0.2, 2.5]])
BODIES = {
    "body": (S.body(MATRIX), MATRIX),
    "body with wheels": (S.body(MATRIX, wheels=[(0.1, 0.02, 0.0), (0.0, 0.1, 0.0)]), None),
    "on an orbit": (S.satellite_on_orbit(MATRIX, 0.7, 0.2), MATRIX),
    "without attitude": (S.body(MATRIX, attitude=False), MATRIX),
    "rigid_body": (S.rigid_body(MATRIX), MATRIX),
    "gyrostat": (S.gyrostat((1.0, 2.0, 2.5), rotors=(0.1, -0.2, 0.3)), None),
}


@pytest.mark.thinned(8)
@pytest.mark.parametrize("name", BODIES)
def test_torques_ask_for_the_angular_velocity_and_the_attitude_by_name(name):
    """In any order, against the same field by velocities and attitudes of states, followed by a Runge-Kutta scheme."""
    body, inertia = BODIES[name]
    x0 = (
        np.cos(np.arange(1.0, body.dim + 1.0)) if body.dim == 3 else body.state([0.5, 0.5, -0.5, 0.5], (0.3, -0.2, 0.5))
    )
    with_attitude = body.dim > 6
    laws = {
        lambda omega: np.array([0.1, 0.2, 0.3]) * omega: lambda x, A, w, t: np.array([0.1, 0.2, 0.3]) * w,
        lambda time, x: -time * x[:3]: lambda x, A, w, t: -t * x[:3],
        lambda omega, x, t: x[:3] * omega[0] - t * omega: lambda x, A, w, t: x[:3] * w[0] - t * w,
    }
    if with_attitude:
        laws |= {
            lambda t, A, omega, x: t * A[1] - omega * x[0]: lambda x, A, w, t: t * A[1] - w * x[0],
            lambda A: 0.3 * A[2]: lambda x, A, w, t: 0.3 * A[2],
        }

    def velocity(x):
        return body.angular_velocity(x) if inertia is None else np.linalg.solve(inertia, x[:3])

    for law, by_hand in laws.items():
        system = body.with_forces(co.forces.Torque(law))

        def slope(t, x, by_hand=by_hand):
            A = body.attitudes(x) if with_attitude else None
            expected = body.vector_field(x, t)
            expected[:3] += by_hand(x, A, velocity(x), t)
            return expected

        assert np.abs(system.vector_field(x0, 0.75) - slope(0.75, x0)).max() < 1e-14
        expected = solve_ivp(slope, (0.5, 1.0), x0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
        end = co.integrate(system, x0, (0.5, 1.0), 2.0**-7, co.Splitting(order=4)).x[-1]
        assert np.abs(end - expected).max() < 1e-8
        if "held" in (body.parameters or {}) and {"omega", "t"} < {*inspect.signature(law).parameters}:
            held = body.with_forces(co.forces.Sampled(co.forces.Torque(law), 0.5))
            start = np.concatenate([x0, np.zeros(3)])
            first = co.integrate(held, start, (0.0, 2.0**-7), 2.0**-7, co.Splitting()).x[-1, -3:]
            expected = by_hand(x0, body.attitudes(x0) if with_attitude else None, velocity(x0), 0.0)
            assert np.abs(first - expected).max() < 1e-14


def test_velocities_of_several_bodies():
    inertias = [(1.0, 2.0, 2.5), MATRIX, (1.0, 1.0, 0.0)]
    system = S.bodies(inertias, [1.0, 2.0, 0.5], potential=lambda r, A: 0.1 * np.sum((r[0] - r[1]) ** 2))
    rng = np.random.default_rng(5)
    x0 = system.state(rng.normal(size=(3, 3)), angular_velocities=[(0.1, 0.2, 0.3), (0.3, -0.2, 0.1), (0.2, 0.1, 0.0)])
    found = system.with_forces(co.forces.Torque(lambda t, omega, A: t * omega + A[:, 2])).vector_field(x0, 2.0)
    change = (found - system.vector_field(x0, 2.0))[:36].reshape(3, 4, 3)
    assert np.abs(change[:, 0] - 2.0 * system.angular_velocity(x0) - system.attitudes(x0)[:, 2]).max() < 1e-14
    assert not change[:, 1:].any()


def test_the_attitude_of_a_body_in_space_is_given_to_its_state():
    with refused(ValueError, "attitude", "part of its state", "body.state"):
        co.integrate(S.body(), S.body().state(), (0, 1), 0.1, attitude=TURNED[0])


@pytest.mark.parametrize("inertia", [(1.0, 2.0, 2.5), SHAPES[1], (1.0, 1.0, 0.5), (2.0, 2.0, 0.0), (0.7, 0.7, 0.7)])
def test_a_free_body_turns_its_axes_exactly(inertia):
    """In one part, for any step; by any splitting to its order."""
    system = S.body(inertia)
    x0 = system.state(TURNED[0], (0.3, -0.2, 0.0 if inertia[-1] == 0.0 else 0.4))
    wanted = system.exact(x0, 10.0)
    sol = co.integrate(system, x0, (0, 10), 0.5, splitting(2))
    np.testing.assert_allclose(sol.x[-1], wanted, rtol=0, atol=2e-14)
    np.testing.assert_allclose(co.integrate(system, x0, (0, 10), 0.02, co.Splitting(order=4)).x[-1], wanted, atol=1e-6)
    np.testing.assert_allclose(system.exact(system.exact(x0, 3.0), 7.0), wanted, rtol=0, atol=1e-13)
    for name, F in system.integrals.items():
        assert F(wanted) == pytest.approx(F(x0), abs=1e-14), name
    with refused(TypeError, "attitude"):
        system.exact(x0, 1.0, attitude=True)


def test_a_rod_in_a_field_is_a_spherical_pendulum():
    """The axis of a rod in a uniform field, against its own equation; its momentum has no component along it."""
    rod = S.bodies([(2.0, 2.0, 0.0)], [1.0], potential=lambda r, A: -1.5 * A[0, 2, 2] + 0.5 * (r * r).sum())
    x0 = rod.state([[0.3, 0.0, 0.0]], None, [Rotation.from_rotvec([1.0, 0.2, 0.3])], [[0.4, -0.3, 0.0]])
    sol = co.integrate(rod, x0, (0, 10), 0.01, splitting(6))
    assert np.abs(sol.angular_momentum[..., 2]).max() < 1e-14

    def slope(t, y):  # I (n'' + |n'|^2 n) = the part of the field across n
        n, v = y[:3], y[3:]
        field = np.array([0.0, 0.0, 1.5]) / 2.0
        return np.r_[v, field - (field @ n) * n - (v @ v) * n]

    axis = rod.attitudes(x0)[0, :, 2]
    start = np.r_[axis, np.cross(rod.angular_velocity(x0, frame="space")[0], axis)]
    y = solve_ivp(slope, (0, 10), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(rod.attitudes(sol.x[-1])[0, :, 2], y[:3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(sol.positions[-1], [[0.3 * np.cos(10), 0, 0]], rtol=0, atol=1e-9)


def test_potentials_with_and_without_gradients():
    """The same motion; one kick; and the potential does not move the states of points."""
    pairs = [S.bodies(SHAPES, MASSES, spring), S.bodies(SHAPES, MASSES, spring, gradient=spring_slopes)]
    x0 = pairs[0].state(PLACES, SPEEDS, TURNED, SPINS)
    runs = [co.integrate(pair, x0, (0, 2), 0.005, splitting(4)) for pair in pairs]
    np.testing.assert_allclose(runs[1].x[-1], runs[0].x[-1], rtol=0, atol=1e-11)
    assert runs[0].drift()["energy"] < 1e-6 and pairs[0].parameters is None and not pairs[0].integrals
    assert "H in 3 parts" in str(splitting(2).describe(pairs[0]))
    A = np.array(TURNED.as_matrix())
    kinetic = S.bodies(SHAPES, MASSES).energy(x0)
    assert pairs[1].energy(x0) == pytest.approx(kinetic + spring(np.array(PLACES), A), rel=1e-14)


def test_wrong_potentials_are_refused():
    with refused(TypeError, "gradient", "potential"):
        S.bodies(gradient=spring_slopes)
    with refused(TypeError, "hessian", "gradient"):
        S.bodies(potential=spring, hessian=spring_slopes)
    with refused(TypeError, "potential", "(r, A)"):
        S.bodies(potential=lambda r: 1.0)
    with refused(ValueError, "potential", "contradicts"):
        S.bodies(SHAPES, MASSES, spring, gradient=lambda r, A: (r, A))
    with refused(ValueError, "potential", "body 0", "rod"):
        S.bodies([(2, 2, 0), (1, 1, 1)], MASSES, lambda r, A: A[0, 2, 0] * r[0, 0])
    with refused(TypeError, "potential", "gradient="):
        S.bodies(potential=lambda r, A: abs(r[0, 0]))


PUSH = np.array([0.1, 0.2, -0.3])
PUSHED = {
    "body": (S.body((1.0, 2.0, 2.5)), PUSH),
    "body with wheels": (S.body((1.0, 2.0, 2.5), wheels=0.1 * np.eye(3)), PUSH),
    "top": (co.systems.heavy_top(), PUSH),
    "two bodies": (S.bodies([(1.0, 2.0, 2.5)] * 2, (1.0, 2.0)), np.array([PUSH, -2 * PUSH])),
    "three bodies": (S.bodies([(1.0, 2.0, 2.5)] * 3, (1.0, 2.0, 3.0)), np.outer([1.0, -2.0, 0.5], PUSH)),
}


@pytest.mark.parametrize("name", PUSHED)
def test_torques_in_the_frames_of_bodies(name):
    """A constant, and functions of the time and of the state, against numbers at their places among the coordinates."""
    system, torque = PUSHED[name]
    places = np.zeros(system.dim)
    for k, row in enumerate(np.atleast_2d(torque)):
        places[12 * k : 12 * k + 3] = row
    x, method = np.cos(1.0 + np.arange(system.dim)), co.methods.Forced(co.Splitting())
    wanted = system.with_forces(co.forces.Torque(places))
    for force in (torque, lambda t: torque, lambda time: torque, lambda x: torque, lambda x, t: torque):
        found = system.with_forces(co.forces.Torque(force))
        np.testing.assert_array_equal(found.vector_field(x, 0.5), wanted.vector_field(x, 0.5))
        # One rounding of each sum of weights.
        np.testing.assert_allclose(
            method.step(found, x, 0.5, 0.25), method.step(wanted, x, 0.5, 0.25), rtol=0, atol=64 * 2.0**-53
        )
    with refused(ValueError, "torque", f"({system.dim},)"):
        system.with_forces(co.forces.Torque(np.zeros(system.dim + 1)))
    with refused(ValueError, "(2,)", f"({system.dim},)", str(np.shape(torque)), "body frames"):
        system.with_forces(co.forces.Torque(lambda t: np.zeros(2)))


def test_a_torque_in_the_frame_of_a_body_is_an_input_and_a_parameter():
    """About a principal axis the momentum is its integral; beside a sampled force, which lengthens the state."""
    law = co.forces.Sampled(co.forces.Torque((0.0, 0.0, 0.5)), 0.25)
    sat = S.body((1.0, 2.0, 2.5)).with_forces(co.forces.Torque((0.0, 0.0, 1.0))).with_forces(law)
    ready = co.prepare(sat, co.Splitting(), 0.125, inputs={"push": "Torque"})
    assert sat.dim == 15
    for push in (0.0, 2.0):
        x = ready.run(sat.state(), (0.0, 1.0), push=(0.0, 0.0, push)).x[-1]
        np.testing.assert_allclose(x[:3], (0.0, 0.0, 0.5 + push), rtol=0, atol=1e-14)
    _, tangents = ready.jvp(sat.state(), (0.0, 1.0), {"inputs.push": np.eye(3)}, push=PUSH)
    difference = [
        ready.run(sat.state(), (0, 1), push=PUSH + e).x[-1] - ready.run(sat.state(), (0, 1), push=PUSH - e).x[-1]
        for e in 1e-5 * np.eye(3)
    ]
    np.testing.assert_allclose(np.asarray(tangents.x)[-1], np.array(difference).T / 2e-5, rtol=0, atol=1e-9)
    members = co.batch([S.body((1.0, 2.0, third)).with_forces(co.forces.Torque((0, 0, third))) for third in (2.5, 2.6)])
    ends = co.integrate(members, members[0].state(), (0, 1), 0.125).x[-1]
    np.testing.assert_allclose(ends[:, 2], (2.5, 2.6), rtol=0, atol=1e-14)


@pytest.mark.parametrize("torque", [lambda t: (0.1, 0.2, -0.3), lambda x, A: [0.1, 0.2, -0.3]])
def test_a_torque_in_the_frame_of_a_body_may_be_a_tuple_or_a_list(torque):
    system, constant = PUSHED["body"]
    x0 = system.state(angular_velocity=(0.3, -0.2, 0.4))
    found, wanted = (
        co.integrate(system.with_forces(co.forces.Torque(one)), x0, (0, 1), 0.25).x[-1] for one in (torque, constant)
    )
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2.0**-48)
