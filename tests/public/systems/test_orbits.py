"""Orbits as functions of the time: closed forms, drift by J2, two-line elements, samples, sun, shadow and field."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import coadjoint as co
from refusals import refused

O, F = co.orbits, co.forces
MU, R_EARTH, J2 = O.EARTH.mu, O.EARTH.radius, O.EARTH.j2
DATED = {"epoch": "2026-03-20T12:00:00", "frame": "J2000"}
ISS = """ISS (ZARYA)
1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927
2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537"""
MOLNIYA = """1 08195U 75081A   06176.33215444  .00000099  00000-0  11873-3 0   813
2 08195  64.1586 279.0717 6877146 264.7651  20.2257  2.00491383225656"""


def elements(k=0, **options):
    return O.kepler(7.6e6 + 1e5 * k, 0.1 + 0.02 * k, 50.0 + k, 30.0, 80.0, 20.0, degrees=True, **options)


def sampled(step=60.0, span=6000.0, **options):
    orbit, t = elements(**DATED), np.arange(0.0, span + 1.0, step)
    return O.from_samples(t, *orbit.at(t), **{**DATED, **options})


KINDS = {
    "circle": lambda k=0: O.circular(7.0e6 + 1e5 * k, 60.0, 10.0, 20.0, degrees=True, **DATED),
    "ellipse": lambda k=0: elements(k, **DATED),
    "drift": lambda k=0: elements(k, drift=True, **DATED),
    "samples": lambda k=0: sampled(60.0 - 0.5 * k),
}


def derivative(f, t, h):
    """Return the derivative by differences of sixth order."""
    pairs = ((1, 45.0), (2, -9.0), (3, 1.0))
    return sum(w * (f(t + k * h) - f(t - k * h)) for k, w in pairs) / (60.0 * h)


@pytest.mark.parametrize("e", [0.0, 0.01, 0.7, 0.95])
def test_ellipses_are_those_of_newton(e):
    a, rate = 3.0e7 if e > 0.5 else 7.5e6, None
    if e == 0.95:
        a = 2.0e8
    orbit = O.kepler(a, e, 1.1, 0.4, 2.0, -0.3)
    rate = np.sqrt(MU / a**3)
    y0 = np.concatenate(orbit.at(0.0))
    times = np.linspace(0.0, 1.3 * 2.0 * np.pi / rate, 5)

    def field(t, y):
        return np.concatenate([y[3:], -MU * y[:3] / np.linalg.norm(y[:3]) ** 3])

    exact = solve_ivp(field, times[[0, -1]], y0, "DOP853", times, rtol=1e-13, atol=1e-6).y.T
    found = orbit.at(times)
    # The integrator's own error, some hundred steps of relative size 1e-13, times the stretching at the pericentre.
    tolerance = 1e-10 / (1.0 - e) ** 2
    assert np.abs(found.position - exact[:, :3]).max() < tolerance * a
    assert np.abs(found.velocity - exact[:, 3:]).max() < tolerance * a * rate / (1.0 - e) ** 2
    speed = np.linalg.norm(found.velocity, axis=1) ** 2
    assert np.allclose(speed, MU * (2.0 / np.linalg.norm(found.position, axis=1) - 1.0 / a), rtol=1e-12)


def test_elements_are_found_again():
    orbit = O.kepler(8e6, 0.1, 50.0, 30.0, 80.0, 20.0, degrees=True)
    r, v = orbit.at(0.0)
    h = np.cross(r, v)
    node = np.cross([0, 0, 1], h)
    toward = np.cross(v, h) / MU - r / np.linalg.norm(r)
    E = np.arctan2(r @ v / np.sqrt(MU * 8e6), 1.0 - np.linalg.norm(r) / 8e6)
    found = [
        np.degrees(np.arccos(h[2] / np.linalg.norm(h))),
        np.degrees(np.arctan2(node[1], node[0])),
        np.degrees(np.arccos(node @ toward / np.linalg.norm(node) / np.linalg.norm(toward))),
        np.degrees(E - np.linalg.norm(toward) * np.sin(E)),
    ]
    assert np.allclose(found, [50.0, 30.0, 80.0, 20.0], atol=1e-10) and np.isclose(np.linalg.norm(toward), 0.1)


def test_j2_drift_is_that_of_the_formulas():
    """At each time the ellipse is that of the elements which have drifted."""
    a, e, i = 7.6e6, 0.02, 0.7
    n = np.sqrt(MU / a**3)
    k = 0.75 * n * J2 * (R_EARTH / (a * (1 - e * e))) ** 2
    rates = -2 * k * np.cos(i), k * (5 * np.cos(i) ** 2 - 1), n + k * np.sqrt(1 - e * e) * (3 * np.cos(i) ** 2 - 1)
    orbit = O.kepler(a, e, i, 0.3, 0.4, 0.5, drift=True)
    for t in (0.0, -3e5, 1e6):
        moved = [start + rate * t for start, rate in zip((0.3, 0.4, 0.5), rates, strict=True)]
        assert np.abs(orbit.position(t) - O.kepler(a, e, i, *moved).position(0.0)).max() < 1e-4
    # Sun-synchronous: one turn of the node a tropical year (Vallado, table 11-1, 800 km).
    synchronous = O.circular(R_EARTH + 8e5, 98.6, degrees=True, drift=True)
    first, last = (synchronous.local_frame()(t)[:, 2] for t in (0.0, 86400.0))
    turned = np.degrees(np.arctan2(last[0], -last[1]) - np.arctan2(first[0], -first[1]))
    assert np.isclose(turned, 360.0 / 365.2422, rtol=2e-3)


def test_j2_drift_is_the_mean_motion_about_an_oblate_planet():
    """Mean rates of an integrated orbit differ from the formulas by the order of J2."""
    a, e, i = 7.6e6, 0.02, np.radians(40.0)
    plain, drifting = (O.kepler(a, e, i, 0.3, 0.4, 0.0, drift=drift) for drift in (False, True))
    n = np.sqrt(MU / a**3)

    def field(t, y):
        r, s = y[:3], np.linalg.norm(y[:3])
        z = (r[2] / s) ** 2
        oblate = 1.5 * J2 * (R_EARTH / s) ** 2 * np.array([5 * z - 1, 5 * z - 1, 5 * z - 3])
        return np.concatenate([y[3:], -MU / s**3 * r * (1.0 - oblate)])

    def angles(y):
        """Return the angles of the node and, from it, of the pericentre."""
        r, v = y[:, :3], y[:, 3:]
        h = np.cross(r, v)
        toward = np.cross(v, h) / MU - r / np.linalg.norm(r, axis=1)[:, None]
        node = np.stack([-h[:, 1], h[:, 0], 0.0 * h[:, 0]], axis=1)
        across = np.cross(h, node) / np.linalg.norm(h, axis=1)[:, None]
        dot = [np.einsum("ti,ti->t", toward, one) for one in (across, node)]
        return [np.unwrap(np.arctan2(h[:, 0], -h[:, 1])), np.unwrap(np.arctan2(*dot))]

    times = np.linspace(0.0, 60 * 2.0 * np.pi / n, 2400)
    y = solve_ivp(field, times[[0, -1]], np.concatenate(plain.at(0.0)), "DOP853", times, rtol=1e-10, atol=1e-4).y.T
    integrated = [np.polyfit(times, one, 1)[0] for one in angles(y)]
    states = drifting.at(times)
    closed = [np.polyfit(times, one, 1)[0] for one in angles(np.concatenate(states, axis=1))]
    assert np.allclose(integrated, closed, rtol=0.03)


@pytest.mark.parametrize("kind", KINDS)
def test_velocities_and_local_axes_are_derivatives(kind):
    orbit = KINDS[kind]()
    for t in (301.0, 2222.0):
        r, v = orbit.at(t)
        assert np.abs(derivative(orbit.position, t, 8.0) - v).max() < 1e-6 * np.linalg.norm(v)
        for down in (False, True):
            frame = orbit.local_frame(down)
            A = frame(t)
            assert np.abs(A.T @ A - np.eye(3)).max() < 1e-14 and np.linalg.det(A) > 0.0
            spin = derivative(frame, t, 8.0) @ A.T
            rate = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            assert np.abs(rate - orbit.local_rate(t)).max() < 1e-6 * np.linalg.norm(rate)
        A = orbit.local_frame()(t)
        assert np.allclose(A[:, 0], r / np.linalg.norm(r), atol=1e-14) and A[:, 1] @ v > 0.0
        assert np.allclose(orbit.local_frame(True)(t), np.stack([A[:, 1], -A[:, 2], -A[:, 0]], axis=1), atol=0)


@pytest.mark.parametrize("scale", [1e-7, 1.0, 1e30])
def test_units_of_any_size(scale):
    """Lengths, or times, in other units."""
    plain, planet = O.kepler(1.5, 0.3, 1.0, planet=O.Planet(1.0)), O.Planet(scale**3)
    other = O.kepler(1.5 * scale, 0.3, 1.0, planet=planet)
    t = np.linspace(0.0, 9.0, 7)
    assert np.allclose(other.at(t).position, scale * plain.at(t).position, rtol=1e-13, atol=1e-13 * scale)
    slow = O.kepler(1.5, 0.3, 1.0, planet=O.Planet(1.0 / scale**2)) if scale < 1e20 else None
    if slow is not None:
        assert np.allclose(slow.at(scale * t).position, plain.at(t).position, rtol=1e-9, atol=1e-9)
    again = O.from_samples(t * 1.0, *other.at(t), planet=planet, degree=3)
    assert np.allclose(again.position(4.5), other.position(4.5), atol=0.2 * scale)


@pytest.mark.parametrize("lines", [ISS, MOLNIYA], ids=["near", "deep"])
def test_two_line_elements_are_those_of_sgp4(lines):
    sgp4 = pytest.importorskip("sgp4.api")
    satellite = sgp4.Satrec.twoline2rv(*lines.splitlines()[-2:])
    t = np.random.default_rng(1).uniform(-4000.0, 50000.0, 500)
    _, r, v = satellite.sgp4_array(np.full(500, satellite.jdsatepoch), satellite.jdsatepochF + t / 86400.0)
    for error in (0.01, 100.0):
        orbit = O.from_tle(lines, (-4000.0, 50000.0), error=error)
        assert 0.0 < orbit.sampling_error <= error
        found = orbit.at(t)
        # The largest error is not always in the middle of a piece.
        assert np.linalg.norm(found.position - 1e3 * r, axis=1).max() < 2.0 * error
    assert np.linalg.norm(found.velocity - 1e3 * v, axis=1).max() < 2.0
    assert orbit.frame == "TEME" and orbit.epoch.system == "UTC"


def test_epochs_shift_two_line_elements():
    pytest.importorskip("sgp4")
    own = O.from_tle(ISS, (0.0, 3000.0))
    later = O.from_tle(ISS.splitlines(), (0.0, 2000.0), epoch="2008-09-20T12:30:40.104192")
    assert np.linalg.norm(own.position(1000.0) - later.position(700.0)) < 0.05
    assert str(later.epoch).startswith("2008-09-20T12:30:40")


@pytest.mark.parametrize("velocities", [True, False])
@pytest.mark.parametrize("degree", [3, 7, 11])
def test_samples_converge_with_the_degree(degree, velocities):
    orbit, errors = elements(), []
    steps = np.array([800.0, 400.0, 200.0]) if degree > 3 else np.array([200.0, 100.0, 50.0])
    for step in steps:
        t = np.arange(0.0, 9601.0, step)
        r, v = orbit.at(t)
        found = O.from_samples(t, r, v if velocities else None, degree=degree)
        middles = t[10:-10] + 0.37 * step if len(t) > 25 else t[3:-4] + 0.37 * step
        errors.append(np.linalg.norm(found.at(middles).position - orbit.at(middles).position, axis=1).max())
        assert np.linalg.norm(found.at(t).position - r, axis=1).max() < 1e-8
        assert found.t_span == (0.0, t[-1])
    order = np.log2(errors[1] / errors[2])
    assert order > degree + 0.3 and errors[2] < found.sampling_error


def test_unequal_steps_and_few_samples():
    orbit = elements()
    t = np.cumsum(np.random.default_rng(2).uniform(20.0, 90.0, 90))
    found = O.from_samples(t, *orbit.at(t))
    middles = 0.5 * (t[:-1] + t[1:])
    assert np.linalg.norm(found.at(middles).position - orbit.at(middles).position, axis=1).max() < 1e-2
    two = O.from_samples(t[:2], *orbit.at(t[:2]))
    assert np.linalg.norm(two.position(middles[0]) - orbit.position(middles[0])) < 1.0 and two.sampling_error == np.inf


def test_the_sun_of_the_almanac():
    """Meeus, Astronomical Algorithms (1998), example 25.a, apparent and of date; the equinox of 2024; frames."""
    orbit = O.circular(7e6, epoch="1992-10-13T00:00:00", time_system="TT", frame="TOD")
    s = orbit.sun(0.0)
    found = np.degrees([np.arctan2(s[1], s[0]) % (2 * np.pi), np.arcsin(s[2])])
    assert np.abs(found - [198.38083, -7.78507]).max() < 0.01
    spring = O.circular(7e6, epoch="2024-03-20T03:06:00", frame="MOD").sun(0.0)
    assert np.degrees(np.arccos(spring[0])) < 0.01
    # The equinox has moved by 50.29 arcseconds a year since 2000.
    fixed = O.circular(7e6, epoch="2024-03-20T03:06:00", frame="EME2000").sun(0.0)
    assert np.isclose(
        np.degrees(np.arctan2(-fixed[1], fixed[0])), 24.2155 * 50.29 / 3600.0 * np.cos(np.radians(23.44)), atol=0.005
    )
    year = np.array([orbit.sun(86400.0 * day) for day in (0.0, 365.2422)])
    assert np.degrees(np.arccos(year[0] @ year[1])) < 0.02 and np.allclose(np.linalg.norm(year, axis=1), 1.0)


def test_the_shadow_of_the_earth():
    """On a circle whose plane has the sun the share of darkness is asin(R/r)/pi."""
    radius = 7.0e6
    orbit = O.circular(radius, 23.436, 0.0, degrees=True, epoch="2024-06-20T20:51:00", frame="MOD")
    period = 2.0 * np.pi * np.sqrt(radius**3 / MU)
    light = np.array([np.linalg.norm(orbit.sunlight(t)) for t in np.linspace(0.0, period, 4001)[:-1]])
    assert np.isclose((1.0 - light).mean(), np.arcsin(R_EARTH / radius) / np.pi, atol=2e-4)
    partly = (light > 0.0) & (light < 1.0)
    assert 4 <= partly.sum() and light.max() <= 1.0
    # From far away the Earth covers a part of the disk: (b/a)^2.
    far = O.circular(5.0e9, 23.436, 0.0, -90.0, degrees=True, epoch="2024-06-20T20:51:00", frame="MOD")
    assert np.isclose(np.linalg.norm(far.sunlight(0.0)), 1.0 - (R_EARTH / 5.0e9 / 0.004652) ** 2, atol=1e-4)


def test_the_dipole_turns_with_the_earth():
    polar = O.circular(6371200.0 * 1.1, 90.0, degrees=True, **DATED)
    g = 3e-5
    straight = O.tilted_dipole(polar, (0.0, 0.0, -g))
    quarter = 0.5 * np.pi * np.sqrt(polar.position(0.0)[0] ** 3 / MU)
    assert np.allclose(
        np.linalg.norm(straight(0.0)), g / 1.1**3, rtol=1e-5
    )  # precession turns the axis by 0.15 degrees
    assert np.allclose(np.linalg.norm(straight(quarter)), 2.0 * g / 1.1**3, rtol=1e-4)
    assert straight(0.0)[2] > 0.0 > straight(quarter)[2]  # northward at the equator, downward at the north pole
    # At rest in space at one place the field repeats after a sidereal day, and has turned before.
    resting = O.Orbit(lambda t: np.array([7e6, 1e6, 2e6]), lambda t: np.zeros(3), planet=O.EARTH, **DATED)
    B = O.tilted_dipole(resting)
    day = 86164.0905
    assert np.abs(B(0.0) - B(day)).max() < 1e-11 and np.abs(B(0.0) - B(0.5 * day)).max() > 1e-6


def test_the_reference_field_is_that_of_ppigrf():
    """Above a place on the Earth, by the function of the package for geodetic coordinates."""
    ppigrf = pytest.importorskip("ppigrf")
    from datetime import datetime

    orbit = O.circular(6.878e6, 97.4, 30.0, degrees=True, epoch="2025-01-01T06:00:00", frame="TEME")
    B, dipole = O.igrf(orbit, (0.0, 3000.0)), O.tilted_dipole(orbit)
    # Sidereal time by the formula of the U.S. Naval Observatory: days to 0h of 2025-01-01, and hours since.
    gmst = np.radians(15.0 * (6.697374558 + 0.06570982441908 * 9131.5 + 1.00273790935 * 6.0))
    for t in (0.0, 1000.0, 2500.0):
        r = orbit.position(t)
        distance, latitude = np.linalg.norm(r), np.degrees(np.arcsin(r[2] / np.linalg.norm(r)))
        longitude = np.degrees(np.arctan2(r[1], r[0]) - gmst - 7.292115e-5 * t)
        up, south, east = (
            float(one.ravel()[0])
            for one in ppigrf.igrf_gc(distance / 1e3, 90.0 - latitude, longitude, datetime(2025, 1, 1, 6))
        )
        across = r / distance
        eastward = np.cross([0, 0, 1], across) / np.linalg.norm(np.cross([0, 0, 1], across))
        expected = 1e-9 * (up * across + south * np.cross(eastward, across) + east * eastward)
        assert np.abs(B(t) - expected).max() < 1e-8
        assert np.abs(B(t) - dipole(t)).max() < 0.3 * np.linalg.norm(B(t))


def torques(orbit):
    plates = {"areas": [1.0], "normals": [(0.0, 0.6, 0.8)], "centres": [(0.1, 0.2, -0.3)]}
    return (
        F.GravityGradient(MU, orbit.position),
        F.Drag(1e-11, orbit.velocity, **plates),
        F.SolarPressure(4.5e-6, orbit.sunlight, **plates),
        F.MagneticDipole((0.1, 0.0, 0.2), O.tilted_dipole(orbit)),
        F.Pointing(1e-4, 1e-3, orbit.local_frame(), rate=orbit.local_rate),
    )


@pytest.mark.thinned(4)
@pytest.mark.parametrize("kind", KINDS)
def test_other_orbits_of_a_kind_compile_nothing(kind, compiled):
    """And the members of a batch have the bits of runs of their own, with t0 other than zero and backward."""
    body, ends, systems, counts = co.systems.body((4.0, 5.0, 6.0)), [], [], []
    start = body.state(angular_velocity=(1e-3, 2e-3, -1e-3))
    for k in range(3):
        systems.append(body.with_forces(*torques(KINDS[kind](k))))
        ends.append(co.integrate(systems[-1], start, (900.0, 300.0), 10.0, co.Splitting()).x[-1])
        counts.append(len(compiled))
    assert counts[0] == counts[-1]
    assert not np.array_equal(ends[0], ends[1])
    together = co.integrate(co.batch(systems), np.tile(start, (3, 1)), (900.0, 300.0), 10.0, co.Splitting())
    assert np.array_equal(together.x[-1], ends) and len(compiled) == counts[0]


def test_orbits_of_forces_are_those_of_the_satellite_on_orbit():
    """The gradient along an ellipse, as a force on a body in space and as the energy in the frame of the orbit."""
    inertia, a, e = (1.0, 2.0, 2.5), 2.0e7, 0.3
    rate, orbit = np.sqrt(MU / a**3), O.kepler(a, e)
    relative = co.systems.satellite_on_orbit(inertia, rate, e)
    turned = Rotation.from_rotvec([0.3, -0.2, 0.4])
    sat = co.systems.body(inertia).with_forces(F.GravityGradient(MU, orbit.position))
    omega = rate * np.array([0.2, 0.1, 1.3])
    span = (0.0, 0.5 * round(12.0 / rate))
    step = span[1] / 4000
    one = co.integrate(sat, sat.state(turned, omega, frame="space"), span, step, co.Splitting(order=4), save_every=400)
    start = relative.state(turned, omega, frame="space")
    other = co.integrate(relative, start, span, step, co.Splitting(order=4), save_every=400)
    in_space = Rotation.from_euler("z", relative.orbit(other.t).anomaly[:, None]) * other.rotation
    assert (one.rotation * in_space.inv()).magnitude().max() < 1e-7


def test_runs_along_samples_are_those_of_another_integrator():
    """Gravity and the damping toward local axes, by DOP853 with quaternions and the closed form."""
    exact, orbit = elements(**DATED), sampled()
    I, K, C = np.array([4.0, 5.0, 6.0]), 2e-3, 0.1
    sat = co.systems.body(I).with_forces(
        F.GravityGradient(MU, orbit.position), F.Pointing(K, C, orbit.local_frame(), rate=orbit.local_rate)
    )
    turned, omega = Rotation.from_rotvec([0.3, 0.5, -0.2]), np.array([1e-3, -2e-3, 1e-3])
    sol = co.integrate(sat, sat.state(turned, omega), (100.0, 600.0), 1.0, co.Splitting(order=4))

    def field(t, y):
        A, w = Rotation.from_quat(y[:4]).as_matrix(), y[4:]
        r = A.T @ exact.position(t)
        v = A.T @ exact.velocity(t)
        h = np.cross(r, v)
        X, Z = r / np.linalg.norm(r), h / np.linalg.norm(h)
        D = np.stack([X, np.cross(Z, X), Z])  # from the local axes to the body, as rows
        sine = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
        torque = 3 * MU / np.linalg.norm(r) ** 5 * np.cross(r, I * r) - K * sine - C * (w - h / (r @ r))
        q, p = y[3], y[:3]
        return np.concatenate([0.5 * (q * w + np.cross(p, w)), [-0.5 * p @ w], (torque - np.cross(w, I * w)) / I])

    y = solve_ivp(field, (100.0, 600.0), np.concatenate([turned.as_quat(), omega]), "DOP853", rtol=1e-12, atol=1e-14).y
    assert (sol.rotation[-1] * Rotation.from_quat(y[:4, -1]).inv()).magnitude() < 1e-7


@pytest.mark.parametrize("span", [(0.0, 6010.0), (-10.0, 100.0), (6010.0, 0.0)], ids=str)
@pytest.mark.parametrize("method", [co.Splitting(), co.Splitting(order=4), co.GaussLegendre(2)], ids=str)
def test_runs_beyond_the_samples_are_refused(span, method):
    """Before the first step: in runs, prepared ones and their ends, of batches, and of laws that call the orbit."""
    orbit = sampled()
    position = orbit.position

    def law(t, omega):
        return 1e-12 * position(t) - omega

    body = co.systems.body((4.0, 5.0, 6.0))
    forces = (F.Torque(law), F.GravityGradient(MU, orbit.position), F.Sampled(F.Torque(law), 10.0))
    # Sampled laws run forward, and so in schemes of order two.
    for force in forces if span[1] > span[0] and method != co.Splitting(order=4) else forces[:2]:
        sat = body.with_forces(force)
        start = sat.state(angular_velocity=(0, 0, 1e-3))
        with refused(ValueError, force.label, "t = 0 to 6000", "t_span"):
            co.integrate(sat, start, span, 10.0, method)
        ready = co.prepare(sat, method, 10.0)
        with refused(ValueError, force.label, "t = 0 to 6000"):
            ready.run(start, span)
        with refused(ValueError, force.label, "t = 0 to 6000"):
            ready.end(start, span)
        with refused(ValueError, force.label, "t = 0 to 6000"):
            co.integrate(co.batch([sat, sat]), np.tile(start, (2, 1)), span, 10.0, method)
        with refused(ValueError, force.label, "t = 0 to 6000"):
            co.stepper(sat, method, 10.0)(start, t=6000.0)


def test_a_span_is_used_to_its_ends():
    orbit, body = sampled(), co.systems.body((4.0, 5.0, 6.0))
    sat = body.with_forces(F.GravityGradient(MU, orbit.position))
    exact = body.with_forces(F.GravityGradient(MU, elements().position))
    start = sat.state(angular_velocity=(0, 0, 1e-3))
    for method in (co.Splitting(), co.Splitting(order=6)):
        for span in ((0.0, 6000.0), (6000.0, 0.0)):
            found, wanted = (co.integrate(one, start, span, 60.0, method).x[-1] for one in (sat, exact))
            assert np.abs(found - wanted).max() < 1e-8


def test_samples_are_never_extrapolated():
    """By a law whose span cannot be known, since it shifts the time; and by calls."""
    orbit = sampled()
    position = orbit.position

    def shifted(t):
        return position(t + 5900.0)

    for t in (-1e-3, 6000.001, np.nan):
        named = "outside", f"t = {t:.10g} ", "t = 0 to 6000"
        with refused(ValueError, *named):
            orbit.position(t)
        with refused(ValueError, *named):
            orbit.at([10.0, t]) if t == t else orbit.velocity(t)
    sat = co.systems.body((4.0, 5.0, 6.0)).with_forces(F.Torque(lambda t: 1e-9 * shifted(t)))
    with pytest.raises(co.IntegrationError, match="outside") as caught:
        co.integrate(sat, sat.state(), (0.0, 600.0), 10.0)
    assert 80.0 <= caught.value.time <= 100.0
    assert orbit.position(6000.0).shape == (3,)
    shorter = orbit.within((1000.0, 2000.0))
    assert shorter.t_span == (1000.0, 2000.0) and np.array_equal(shorter.position(1500.0), position(1500.0))
    with refused(ValueError, "outside", "t = 999 ", "1000 to 2000"):
        shorter.local_frame()(999.0)


REFUSED = {
    "kilometres": (lambda: O.circular(6878.0), ValueError, ("6878", "metres")),
    "a parabola": (lambda: O.kepler(7e6, 1.0), ValueError, ("eccentricity", "1")),
    "through the Earth": (lambda: O.kepler(7e6, 0.2), ValueError, ("5.6e+06",)),
    "no oblateness": (lambda: O.circular(2.0, planet=O.Planet(1.0), drift=True), ValueError, ("drift", "j2")),
    "a mass": (lambda: O.circular(7e6, planet=5.97e24), TypeError, ("planet",)),
    "no epoch": (lambda: O.circular(7e6).sun, ValueError, ("epoch",)),
    "no frame": (lambda: O.tilted_dipole(O.circular(7e6, epoch="2026-01-01")), ValueError, ("frame", "TEME")),
    "another frame": (lambda: O.circular(7e6, epoch="2026-01-01", frame="MARS").sun, ValueError, ("MARS",)),
    "a turning frame": (lambda: O.circular(7e6, frame="ITRF2014"), ValueError, ("ITRF2014", "turns")),
    "another planet": (
        lambda: O.tilted_dipole(O.circular(9e6, planet=O.Planet(4.28e13, 3.39e6), **DATED)),
        ValueError,
        ("Earth",),
    ),
    "no date": (lambda: O.circular(7e6, epoch="yesterday"), ValueError, ("yesterday",)),
    "a number as a date": (lambda: O.circular(7e6, epoch=2026), TypeError, ("2026",)),
    "a time system": (lambda: O.circular(7e6, epoch="2026-01-01", time_system="MET"), ValueError, ("MET",)),
    "descending times": (lambda: O.from_samples([0, 2, 1], np.full((3, 3), 7e6)), ValueError, ("t[2]", "ascend")),
    "a shape": (lambda: O.from_samples([0, 1, 2], np.full((3, 2), 7e6)), ValueError, ("(3, 2)",)),
    "samples in kilometres": (
        lambda: O.from_samples(np.arange(0, 99, 9.0), elements().at(np.arange(0, 99, 9.0)).position / 1e3),
        ValueError,
        ("metres",),
    ),
    "velocities in kilometres": (
        lambda: (lambda t: O.from_samples(t, elements().at(t).position, elements().at(t).velocity / 1e3))(
            np.arange(0, 99, 9.0)
        ),
        ValueError,
        ("velocity", "0.001"),
    ),
    "a degree": (lambda: sampled(degree=5), ValueError, ("degree", "3, 7, 11")),
    "no span": (lambda: O.igrf(O.circular(7e6, **DATED)), ValueError, ("t_span",)),
    "a far date": (
        lambda: O.igrf(O.circular(7e6, epoch="2031-01-01", frame="J2000"), (0, 100)),
        ValueError,
        ("2030",),
    ),
    "a longer span": (lambda: sampled().within((0, 7000)), ValueError, ("6000",)),
    "no function": (lambda: O.Orbit((7e6, 0, 0), (0, 7e3, 0)), TypeError, ("position",)),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_orbits(case):
    make, error, named = REFUSED[case]
    if case in ("no span", "a far date"):
        pytest.importorskip("ppigrf")
    with refused(error, *named):
        make()


def fitting(line):
    """Return a line of elements with the checksum of its digits."""
    return line[:68] + str(sum(int(one) if one.isdigit() else one == "-" for one in line[:68]) % 10)


LINES = ISS.splitlines()[1:]
WRONG_LINES = {
    "one line": (LINES[0], ("1 line",)),
    "a digit": ((LINES[0].replace("98067A", "98068A"), LINES[1]), ("checksum",)),
    "swapped": (LINES[::-1], ("line 1",)),
    "two satellites": ((LINES[0], MOLNIYA.splitlines()[1]), ("25544", "08195")),
    "cut": ((LINES[0][:60], LINES[1]), ("69",)),
    "a date": ((fitting(LINES[0].replace("08264.51782528", "08264x51782528")), LINES[1]), ("date", "08264x")),
    "an inclination": ((LINES[0], fitting(LINES[1].replace(" 51.6416", "-51.6416"))), ("inclination", "-51")),
    "other signs": ((LINES[0].replace("U", "µ"), LINES[1]), ("line 1",)),
}


@pytest.mark.parametrize("case", WRONG_LINES)
def test_refused_elements(case):
    lines, named = WRONG_LINES[case]
    with refused(ValueError, *named):
        O.from_tle(lines, (0, 100))


def test_refused_propagation():
    pytest.importorskip("sgp4")
    with refused(TypeError, "lines"):
        O.from_tle(25544, (0, 100))
    with refused(ValueError, "t_span"):
        O.from_tle(ISS, (100, 0))
    with refused(ValueError, "revolutions"):
        O.from_tle(ISS, (0, 1e12))
    with refused(ValueError, "error is 1e-12"):
        O.from_tle(ISS, (0, 6000), error=1e-12)
    with refused(ValueError, "TAI"):
        O.from_tle(ISS, (0, 100), epoch=O.Epoch.read("2008-09-20", "e", "TAI"))
    decaying = (
        "1 28872U 05037B   05333.02012661  .25992681  00000-0  24476-3 0  1534",
        "2 28872  96.4736 157.9986 0303955 244.0492 110.6523 16.46015938 10708",
    )
    with refused(ValueError, "decayed", "t ="):
        O.from_tle(decaying, (0, 86400))
