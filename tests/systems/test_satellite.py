"""The satellite: the field of point masses, Kepler's ellipse, steady orbits, and motion in space."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from two_steps import assert_bounded_by_order, assert_order, power

import coadjoint as co
from coadjoint.algebra.polynomials.exact_polynomials import ExactPolynomials

satellite = co.systems.satellite
MOMENTS, MASS, GRAVITY = (1.0, 2.0, 2.5), 1.5, 0.8
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
    h = 2.0**-17
    columns = [(system.vector_field(x + h * e) - system.vector_field(x - h * e)) / (2 * h) for e in np.eye(10)]
    np.testing.assert_allclose(system.jacobian(x), np.array(columns).T, rtol=0, atol=1e-8)


def test_field_is_that_of_point_masses():
    """Six masses on the axes, nearer and nearer together: what is left out falls as their distance to the fourth."""
    arms, r = np.array([1.0, 0.7, 0.4]), np.array([2.0, 1.0, -1.5])
    errors = []
    for size in (0.1, 0.05):
        places = size * np.concatenate([np.diag(arms), -np.diag(arms)])
        points = np.full(6, 1 / 6)
        squares = points @ places**2
        system = satellite(squares.sum() - squares, 1.0, 2.0)
        exact = -2.0 * np.sum(points / np.linalg.norm(r + places, axis=1))
        errors.append(abs(system.energy([0, 0, 0, 0, 0, 0, *r, 1]) - exact))
    assert abs(np.log2(errors[0] / errors[1]) - 4) < 0.1


def test_casimirs_and_symmetry():
    system = satellite((2.0, 2.0, 1.0), MASS, GRAVITY)
    ring = ExactPolynomials(system.algebra)
    for casimir in system.casimirs.values():
        assert all(ring.bracket(ring.from_polynomial(casimir), x) == ring.zero for x in ring.coordinates)
    assert list(system.integrals) == ["L3"] and list(satellite((1, 1, 1)).integrals) == ["L1", "L2", "L3"]
    assert list(satellite((1, 2, 1)).integrals) == ["L2"]
    L, p, r = X0[:3], X0[3:6], X0[6:9]
    total = L + np.cross(r, p)
    assert system.casimirs["|total L|^2"](X0) == pytest.approx(total @ total, rel=1e-14)
    run = co.integrate(system, X0, (0, 20), 0.05, co.Splitting(order=4), attitude=True)
    drift = run.drift()
    assert max(drift["|total L|^2"], drift["z"]) < 1e-12
    assert_bounded_by_order(system.integrals["L3"], system, X0, 10.0, 0.1, co.Splitting())
    A = run.attitude[:, 1:4, 1:4]
    totals = run.x[:, :3] + np.cross(run.x[:, 6:9], run.x[:, 3:6])
    np.testing.assert_allclose(np.einsum("tij,tj->ti", A, totals), [total] * len(A), rtol=0, atol=1e-12)


def test_steady_orbit():
    """An axis points down, another along the orbit: everything stands still in the frame of the body."""
    system, d = satellite(MOMENTS, MASS, GRAVITY), 3.0
    rate = np.sqrt(GRAVITY / d**3 * (1 + 1.5 * (sum(MOMENTS) - 3 * MOMENTS[0]) / (MASS * d**2)))
    steady = np.array([0, 0, MOMENTS[2] * rate, 0, MASS * d * rate, 0, d, 0, 0, 1])
    np.testing.assert_allclose(system.vector_field(steady), np.zeros(10), rtol=0, atol=1e-15)


def test_the_limits_of_parameters_are_accepted():
    for limit in (1e-30, 1e30):
        assert satellite(mass=limit, gravity=limit).parameters["mass"] == limit
        with pytest.raises(ValueError, match=rf"^gravity is {limit * limit:g}".replace("+", r"\+")):
            satellite(gravity=limit * limit)


def test_a_ball_follows_kepler():
    """The inertia of a ball has no gradient: an ellipse in space, seen from a body that turns evenly."""
    system = satellite((0.7, 0.7, 0.7), MASS, GRAVITY)
    eccentricity, axis, t = 0.4, 2.0, 5.0
    n = np.sqrt(GRAVITY / axis**3)
    E = brentq(lambda E: E - eccentricity * np.sin(E) - n * t, 0, 20, xtol=1e-15)
    flat = np.sqrt(1 - eccentricity**2)
    place = axis * np.array([np.cos(E) - eccentricity, flat * np.sin(E), 0])
    speed = n * axis / (1 - eccentricity * np.cos(E)) * np.array([-np.sin(E), flat * np.cos(E), 0])
    L = np.array([0.2, -0.1, 0.3])
    omega = L / 0.7
    turn = np.linalg.norm(omega) * t
    u = omega / np.linalg.norm(omega)

    def seen(v):  # turned back about omega
        return np.cos(turn) * v - np.sin(turn) * np.cross(u, v) + (1 - np.cos(turn)) * (u @ v) * u

    fast = n * axis / (1 - eccentricity) * flat
    x0 = np.r_[L, 0, MASS * fast, 0, axis * (1 - eccentricity), 0, 0, 1]
    wanted = np.r_[L, seen(MASS * speed), seen(place), 1]
    np.testing.assert_allclose(system.exact(x0, t), wanted, rtol=0, atol=1e-14 * (1 + n * t))
    np.testing.assert_allclose(system.exact(x0, [0.0, t - 40 * np.pi / n])[0], x0, rtol=0, atol=1e-15)
    for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(stages=2)):
        assert_order(system, x0, t, 0.05, method, wanted)


@pytest.mark.parametrize(("speed", "along"), [(0.9, 0.3), (1.8, -1.2), (np.sqrt(2), 0.0), (2.5, 0.4), (0.6, -0.5)])
@pytest.mark.parametrize("t", [0.01, 3.0, -7.0, 60.0])
def test_every_orbit_of_kepler(speed, along, t):
    """What every orbit keeps, its slope, and the way back: ellipses, a parabola and hyperbolas, inward and outward."""
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
    back = system.exact(end, -t)
    np.testing.assert_allclose(back, x0, rtol=0, atol=1e-11)
    h = 2.0**-17
    slope = (system.exact(x0, t + h) - system.exact(x0, t - h)) / (2 * h)
    np.testing.assert_allclose(slope, system.vector_field(end), rtol=0, atol=1e-7)


def test_radial_orbits_and_bodies_that_are_no_balls_are_refused():
    system = satellite((0.7, 0.7, 0.7), MASS, GRAVITY)
    with pytest.raises(ValueError, match="the orbit is radial"):
        system.exact([0, 0, 0, -1.0, 0, 0, 2.0, 0, 0, 1], 1.0)
    with pytest.raises(TypeError, match="no closed form is known"):
        satellite().exact(X0, 1.0)


def test_against_motion_in_space():
    """Newton's and Euler's equations in space, with the attitude as a matrix, by a Runge-Kutta method of SciPy."""
    inertia = np.array(MOMENTS)

    def rates(t, y):
        place, momentum, L, A = y[:3], y[3:6], y[6:9], y[9:].reshape(3, 3)
        omega = L / inertia
        x = np.r_[L, A.T @ momentum, A.T @ place, 1]
        body = by_hand(x, inertia, MASS, GRAVITY)
        force = A @ (body[3:6] - np.cross(x[3:6], omega))
        hat = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
        return np.r_[momentum / MASS, force, body[:3], (A @ hat).ravel()]

    start = np.r_[X0[6:9], X0[3:6], X0[:3], np.eye(3).ravel()]
    end = solve_ivp(rates, (0, 4), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    A = end[9:].reshape(3, 3)
    wanted = np.r_[end[6:9], A.T @ end[3:6], A.T @ end[:3], 1]
    system = satellite(MOMENTS, MASS, GRAVITY)
    for method in (co.Splitting(order=2), co.GaussLegendre(stages=2)):
        assert_order(system, X0, 4.0, 0.1, method, wanted)
    runs = [co.integrate(system, X0, (0, 4), h, co.Splitting(order=4), attitude=True) for h in (0.1, 0.05)]
    assert abs(power([np.abs(run.attitude[-1, 1:4, 1:4] - A).max() for run in runs]) - 4) < 0.15
    assert "H in 5 parts" in str(co.Splitting().describe(system))
