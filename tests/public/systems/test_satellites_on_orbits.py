"""Attitudes of satellites on prescribed orbits: DOP853 in inertial space, closed forms, frequencies."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipk

import coadjoint as co
from refusals import refused

S = co.systems
MU, RADIUS = 3.986004418e14, 6.771e6  # of the Earth and of a low orbit, m^3/s^2 and m
RATE = np.sqrt(MU / RADIUS**3)
PERIOD = 2 * np.pi / RATE
CUBESAT = np.array([0.0065, 0.035, 0.037])  # kg m^2
TILTED = Rotation.from_euler("zyx", [10, 5, -4], degrees=True).as_matrix()
TURNED = Rotation.from_euler("zyx", [30, 20, -50], degrees=True).as_matrix()
TENSOR = TURNED @ np.diag(CUBESAT) @ TURNED.T


def in_space(inertia, A, omega, position, velocity, t):
    """Attitudes and angular velocities by DOP853: Newton's equation of a point and Euler's, in inertial space."""

    def slope(_, y):
        r, A, w = y[:3], y[6:15].reshape(3, 3), y[15:]
        u, s = A.T @ r / np.linalg.norm(r), np.linalg.norm(r)
        torque = 3 / s**3 * np.cross(u, inertia @ u)
        hat = np.cross(w, np.eye(3)).T
        turning = np.linalg.solve(inertia, torque - np.cross(w, inertia @ w))
        return np.concatenate([y[3:6], -r / s**3, (A @ hat).ravel(), turning])

    y0 = np.concatenate([position, velocity, A.ravel(), omega])
    y = solve_ivp(slope, (0.0, t[-1]), y0, method="DOP853", t_eval=t, rtol=1e-13, atol=1e-14).y.T
    return y[:, 6:15].reshape(-1, 3, 3), y[:, 15:]


def apart(A, B):
    """The largest angle between rotations, in degrees."""
    return np.degrees(Rotation.from_matrix(A @ np.swapaxes(B, -1, -2)).magnitude().max())


def normal(angle):
    """Rotations about the normal of the orbit."""
    return Rotation.from_euler("z", np.asarray(angle)[:, None]).as_matrix()


@pytest.mark.thinned(2)
@pytest.mark.parametrize("shape", [CUBESAT, TENSOR], ids=["moments", "tensor"])
@pytest.mark.parametrize(
    ("eccentricity", "bound"),
    # The error of order 6 on a circle is below round-off; motions on an ellipse separate by 1e3 in five orbits.
    [(0.0, 1e-9), (0.1, 1e-6)],
)
def test_a_cubesat_over_five_orbits(shape, eccentricity, bound):
    """Tilted by 10, 5 and 4 degrees and at rest in the orbital frame at the pericentre; unit time and length here."""
    satellite = S.satellite_on_orbit(shape, RATE, eccentricity)
    inertia = shape if shape.ndim == 2 else np.diag(shape)
    rate = satellite.orbit(0.0).rate / RATE
    A = TILTED @ (TURNED.T if shape.ndim == 2 else np.eye(3))
    x0 = satellite.state(A, (0.0, 0.0, rate * RATE), frame="space")
    sol = co.integrate(satellite, x0, (0, 5 * PERIOD), PERIOD / 360, co.GaussLegendre(4), save_every=10)
    nearest, fast = 1 - eccentricity, np.sqrt((1 + eccentricity) / (1 - eccentricity))
    start = (nearest, 0, 0), (0, fast, 0)
    reference, omega = in_space(inertia, A, A.T @ [0, 0, rate], *start, RATE * sol.t)
    found = normal(satellite.orbit(sol.t).anomaly) @ sol.rotation.as_matrix()
    assert apart(found, reference) < bound
    assert abs(sol.angular_velocity - RATE * omega).max() < np.radians(bound) * 30 * RATE


def test_orbits_are_those_of_a_ball():
    """Radius and anomaly against the closed form of Kepler's problem, for many turns and both directions of time."""
    times, ball = np.array([0.0, 0.3, 2.9, 3.3, 40.0, -5.0, -1e3]), S.satellite((1.0, 1.0, 1.0), mass=1.0)
    for e in (0.0, 1e-9, 0.3, 0.9, 0.999):
        fast = np.sqrt((1 + e) / (1 - e))
        x = ball.exact([0, 0, 0, 0, fast, 0, 1 - e, 0, 0, 1], times)
        found = S.satellite_on_orbit(eccentricity=e).orbit(times)
        place = found.radius[:, None] * np.stack([np.cos(found.anomaly), np.sin(found.anomaly)], axis=-1)
        # Errors of the time, u t, are multiplied by the largest speed.
        np.testing.assert_allclose(place, x[:, 6:8], rtol=0, atol=64 * 2.0**-53 * (8 + 1e3 * fast))
        np.testing.assert_allclose(found.rate * found.radius**2, np.sqrt(1 - e**2), rtol=1e-14)
        assert abs(found.anomaly - times).max() <= np.pi * (e > 0) + 1e-12


def test_a_body_without_a_torque_turns_uniformly_on_an_ellipse():
    """About an axis of symmetry along the normal: the pitch in the orbital frame is the angle less the anomaly."""
    satellite, spin = S.satellite_on_orbit((1.5, 1.5, 2.0), 0.8, 0.4), 0.7
    sol = co.integrate(satellite, satellite.state(angular_velocity=(0, 0, spin)), (0, 30), 0.05, co.Splitting(order=6))
    assert list(satellite.integrals) == ["L3"]
    pitch = normal(spin * sol.t - satellite.orbit(sol.t).anomaly)
    orders = [
        apart(co.integrate(satellite, sol.x0, (0, 30), h, co.Splitting(order=4)).rotation.as_matrix()[:: int(0.5 / h)],
              normal(spin * (t := 0.5 * np.arange(61)) - satellite.orbit(t).anomaly))
        for h in (0.1, 0.05)
    ]  # fmt: skip
    assert apart(sol.rotation.as_matrix(), pitch) < 1e-5 and 13 < orders[0] / orders[1] < 19
    assert abs(sol.angular_velocity - (0, 0, spin)).max() < 1e-12


def test_pitch_on_a_circle_is_a_pendulum():
    """phi'' = -(3/2) n^2 (I2 - I1)/I3 sin(2 phi), by elliptic functions."""
    inertia, n, start = np.array([1.0, 1.6, 2.0]), 1.3, 0.6
    satellite = S.satellite_on_orbit(inertia, n)
    x0 = satellite.state(normal([start])[0], (0, 0, n))
    sol = co.integrate(satellite, x0, (0, 20), 0.01, co.GaussLegendre(3))
    rate, m = n * np.sqrt(3 * (inertia[1] - inertia[0]) / inertia[2]), np.sin(start) ** 2
    pitch = np.arcsin(np.sin(start) * ellipj(rate * sol.t + ellipk(m), m)[0])
    np.testing.assert_allclose(sol.rotation.as_euler("zyx")[:, 0], pitch, rtol=0, atol=1e-12)
    assert sol.drift()["energy"] < 1e-13


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2), (2, 1, 0)])
@pytest.mark.parametrize(("n", "size"), [(0.9, 1.0), (RATE, 0.015), (1e-6, 1e8), (1e5, 1e-9)])
def test_libration_frequencies_and_stability(order, n, size):
    """Pitch: 3 n^2 (I2 - I1)/I3. Roll and yaw: a quartic. Stable if the smallest moment is along the radius.

    Momenta of 1e-14 to 1e6 beside axes of length one.
    """
    inertia = size * np.array([1.0, 1.8, 2.4])[list(order)]
    satellite = S.satellite_on_orbit(inertia, n)
    found = co.equilibrium(satellite, satellite.state(angular_velocity=(0, 0, n)), relax="none")
    a, b, c = inertia
    k1, k2 = (c - b) / a, (c - a) / b
    pitch = 3 * n**2 * (b - a) / c
    squares = np.roots([1.0, (1 + 3 * k2 + k1 * k2) * n**2, 4 * k1 * k2 * n**4])  # of the growth of roll and yaw
    stable = order == (0, 1, 2)
    assert (found.stability == "stable") == stable
    if stable:
        expected = np.sort(np.sqrt([pitch, *(-squares)]))
        np.testing.assert_allclose(found.frequencies, expected, rtol=1e-9)
    else:
        growth = max(0.0, *np.sqrt([*squares.astype(complex), complex(-pitch)]).real)
        assert found.growth == pytest.approx(growth, rel=1e-9)


@pytest.mark.parametrize("shape", [CUBESAT, TENSOR], ids=["moments", "tensor"])
def test_the_satellite_with_its_orbit_has_the_same_attitude(shape):
    """I/(m r^2) is 3.5e-17: the orbit feels nothing of the rotation, and the rotation loses no digit to the orbit."""
    mass, A = 4.0, TILTED @ (TURNED.T if shape.ndim == 2 else np.eye(3))
    alone, whole = S.satellite_on_orbit(shape, RATE), S.satellite(shape, mass, MU)
    x0 = alone.state(A, (0, 0, RATE), frame="space")
    start = np.r_[x0[:3], mass * RADIUS * RATE * A[1], RADIUS * A[0], 1.0]
    step, scheme = PERIOD / 180, co.GaussLegendre(3)
    one, other = (co.integrate(s, x, (0, 5 * PERIOD), step, scheme) for s, x in ((alone, x0), (whole, start)))
    radius = other.x[:, 6:9] / np.linalg.norm(other.x[:, 6:9], axis=1)[:, None]
    assert np.degrees(abs(np.cross(radius, one.x[:, 3:6])).max()) < 1e-7


def test_tensors_of_satellites():
    """A diagonal one has the bits of its moments; a full one is refused if it is not positive definite."""
    x0 = [0.005, 0, 0.22, 7.2, 35.8, 0.1, 3.8, -3.2, 0.1, 1.0]
    moments, diagonal = S.satellite((1, 2, 2.5)), S.satellite(np.diag((1, 2, 2.5)))
    runs = [co.integrate(s, x0, (0, 5), 0.1, co.Splitting(order=4)).x for s in (moments, diagonal)]
    assert np.array_equal(*runs)
    with refused(ValueError, "inertia", "positive definite"):
        S.satellite([[1, 2, 0], [2, 1, 0], [0, 0, 1]])


def test_states_of_canonical_pairs_have_one_as_central_coordinate():
    """Wherever a state enters; one that is right within rounding is taken."""
    satellite, right = S.satellite(), np.array([0, 0, 0.2, 0, 40.0, 0, 5.0, 0, 0, 1.0])
    wrong, span, scheme = right - np.eye(10)[9], (0, 1), co.Splitting()
    ready, forced = co.prepare(satellite, scheme, 0.1), satellite.with_forces(co.forces.Torque(np.zeros(10)))
    pair, batch = S.gravitating_bodies(), co.batch([satellite, satellite, S.satellite(mass=2.0)])
    entries = {
        "integrate": lambda x: co.integrate(satellite, x, span, 0.1),
        "with forces": lambda x: co.integrate(forced, x, span, 0.1),
        "members": lambda x: co.integrate(satellite, [right, x], span, 0.1),
        "a batch": lambda x: co.integrate(batch, [right, right, x], span, 0.1),
        "an ensemble": lambda x: co.integrate_ensemble(satellite, [right, x], span, 0.1, scheme, archive=None),
        "a run": lambda x: ready.run(x, span),
        "its end": lambda x: (ready.end(right, span), ready.end(x, span)),
        "jvp": lambda x: ready.jvp(x, span, {"x0": right}),
        "a step": lambda x: co.stepper(satellite, scheme, 0.1)(x),
        "a tangent": lambda x: co.stepper(satellite, scheme, 0.1).tangent(x),
        "choose": lambda x: co.choose(satellite, x, span, 1e-3),
        "certify": lambda x: co.certify(satellite, scheme, x, 0.1, steps=10),
        "lyapunov": lambda x: co.lyapunov(satellite, x, span, 0.1),
        "equilibrium": lambda x: co.equilibrium(satellite, x),
    }
    for name, entry in entries.items():
        with refused(ValueError, "z of satellite must be 1", "x0[..., 9] is 0"):
            entry(wrong)
        if name != "equilibrium":
            entry(right + 1e-15)
    for off in (1e-7, -1e-10, 2.0**-39):
        with refused(ValueError, "z of satellite must be 1"):
            co.integrate(satellite, right + off * (np.arange(10) == 9), span, 0.1)
    state = pair.state([[-1, 0, 0], [3, 0, 0]])
    state[-1] = 2.0
    with refused(ValueError, "gravitating_bodies", "must be 1"):
        co.integrate(pair, state, span, 0.1)


def test_certificates_see_the_rotation_beside_the_orbit():
    """In the body frame position and momentum move by the libration alone."""
    mass, A = 4.0, TILTED
    start = np.r_[CUBESAT * (RATE * A[2]), mass * RADIUS * RATE * A[1], RADIUS * A[0], 1.0]
    found = co.certify(S.satellite(CUBESAT, mass, MU), co.Splitting(order=2), start, PERIOD / 60)
    assert "rests" not in str(found) and "rests" not in repr(found)


def test_derivatives_by_inertia_and_mean_motion():
    """On a circle the parameters enter the energy alone; on an ellipse they enter a function, and are none."""
    satellite = S.satellite_on_orbit(((1.0, 0.1, 0), (0.1, 1.8, 0.2), (0, 0.2, 2.4)), 0.9)
    ready = co.prepare(satellite, co.GaussLegendre(3), 0.05)
    x0 = satellite.state(TILTED, (0.1, -0.2, 0.9))
    _, tangents = ready.jvp(x0, (0, 5), {"mean_motion": 1.0}, 100)
    ends = [
        co.integrate(S.satellite_on_orbit(satellite.parameters["inertia"], 0.9 + d), x0, (0, 5), 0.05, ready.method).x
        for d in (1e-5, -1e-5)
    ]
    np.testing.assert_allclose(tangents.x[-1], (ends[0][-1] - ends[1][-1]) / 2e-5, rtol=0, atol=1e-7)
    assert {*ready.parameters} == {"inertia", "mean_motion"}
    assert not co.prepare(S.satellite_on_orbit(eccentricity=0.1), None, 0.05).parameters
