"""Binary asteroids, and the Earth and the Moon: closed forms, published criteria of stability, angular momentum."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import coadjoint as co

S, UNIT_ROUNDOFF = co.systems, 2.0**-53


def circle(shapes, shares, spin=0.0, order=2):
    """Return a pair at the distance 1, its state on a circle, the mean motion, and the system in the turning frame.

    The first body, if it is round about its axis, rotates by `spin` faster than the second one.
    """
    pair, r = S.gravitating_bodies(shapes, shares, order=order), np.outer([-shares[1], shares[0]], [1, 0, 0])
    force = pair.hamiltonian.gradient(pair.state(r))[33]
    n, along = np.sqrt(force / np.prod(shares)), np.zeros(pair.dim)
    along[2] = 1.0
    x0 = pair.state(r, np.cross([0, 0, n], r), angular_velocities=[[0, 0, n + spin], [0, 0, n]])
    H = pair.hamiltonian - n * pair.integrals["total L3"] - spin * co.Quadratic(np.zeros(pair.dim), linear=along)
    return pair, x0, n, co.LiePoissonSystem(pair.algebra, H, sign=-1)


@pytest.mark.parametrize("share, spin", [(0.99, 4.0), (0.7, 1.5), (0.5, 0.0)])
def test_libration_of_the_coupled_problem(share, spin):
    """The planar frequencies of libration and distance in closed form, and those of a run with a small angle."""
    m1, m2 = share, 1 - share
    first, (A, B, C) = m1 * np.array([0.02, 0.02, 0.024]), m2 * np.array([0.008, 0.010, 0.011])
    pair, x0, n, turning = circle([first, (A, B, C)], (m1, m2), spin)
    mu, excess = m1 * m2, 1.5 * ((first[2] - first[0]) / m1 + (B + C - 2 * A) / m2)
    assert n**2 == pytest.approx(1 + excess, rel=1e-14)
    torque, kappa2 = 3 * m1 * (B - A), 3 * n**2 - 2 * (1 + 2 * excess)
    k, omega2 = torque / mu, torque / C + torque / mu
    squares = np.roots([1, -(omega2 + kappa2), omega2 * kappa2 - 4 * n**2 * k])
    found = co.equilibrium(turning, x0, relax="none")
    assert found.growth == 0.0
    for wanted in np.sqrt(squares):
        assert np.abs(found.frequencies - wanted).min() < 1e-9 * wanted
    if spin:
        return
    angle = 1e-3
    turned = Rotation.from_euler("z", [[0.0], [angle]])
    x0 = pair.state(pair.positions(x0), pair.velocities(x0), turned, pair.angular_velocity(x0))
    sol = co.integrate(pair, x0, (0, 400), 1 / 32, co.Splitting(order=8), save_every=8)
    axes, apart = sol.rotation[1::2].as_matrix()[:, :, 0], sol.positions[:, 1] - sol.positions[:, 0]
    signal = np.unwrap(np.arctan2(axes[:, 1], axes[:, 0]) - np.arctan2(apart[:, 1], apart[:, 0]))
    lines = co.frequencies(sol.t, signal, count=4).frequency[:2]
    assert np.abs(np.sort(lines) / np.sort(np.sqrt(squares)) - 1).max() < angle**2


@pytest.mark.parametrize("k_Y", [-0.6, -0.9])
@pytest.mark.parametrize("size", [0.04, 0.02])
def test_the_boundary_of_stability_in_a_central_field(k_Y, size):
    """DeBra and Delp's region is the limit of small bodies; its boundary moves by less than a tenth of the square."""

    def growth(k_R):
        A, B = 1.0, (1 - k_Y) / (1 - k_R)
        C = B + k_Y * A
        _, x0, _, turning = circle([[0.1] * 3, size**4 * np.array([A, B, C]) / C], (1 - size**2, size**2))
        return co.equilibrium(turning, x0, relax="none").growth

    limit = brentq(lambda k_R: 1 + 3 * k_R + k_R * k_Y - 4 * np.sqrt(k_R * k_Y), -0.2, -1e-6, xtol=1e-15)
    assert growth(limit - 0.1 * size**2) > 0.0
    assert growth(limit + 0.1 * size**2) == 0.0


@pytest.mark.parametrize("order, power", [(0, 2), (2, 4), (4, 6)])
def test_the_potential_of_a_spheroid(order, power):
    """MacCullagh's and higher terms against the closed form of a homogeneous spheroid, on its axis and its equator."""
    a, c = 1.0, 0.6
    f, inertia = np.sqrt(a * a - c * c), np.array([a * a + c * c, a * a + c * c, 2 * a * a]) / 5
    pair = S.gravitating_bodies([inertia, (0, 0, 0)], (1.0, 2.0), 0.5, order)
    r = np.array([8.0, 16.0])
    on_axis = 1.5 / f**3 * ((r * r + f * f) * np.arctan(f / r) - f * r)
    on_equator = 0.75 / f**3 * ((2 * f * f - r * r) * np.arcsin(f / r) + f * np.sqrt(r * r - f * f))
    for direction, exact in (([0, 0, 1], on_axis), ([0, 1, 0], on_equator)):
        found = [pair.energy(pair.state([[0, 0, 0], distance * np.array(direction)])) for distance in r]
        errors = found / -exact - 1
        assert np.log2(errors[0] / errors[1]) == pytest.approx(power, abs=0.1)


@pytest.mark.parametrize("years", [20, pytest.param(2000, marks=pytest.mark.long)])
def test_angular_momentum_of_the_earth_and_the_moon(years):
    """The total to rounding, and the rotation of the Earth, which is round about its axis, in steps of a day.

    The Earth turns by one angle in all steps, which is rounded alike: a part of the rounding grows linearly.
    """
    masses, radii, day = np.array([5.972e24, 7.346e22]), np.array([6.378e6, 1.7374e6]), 86400.0
    earth, moon = masses * radii**2
    shapes = [(0.3296 * earth, 0.3296 * earth, 0.3307 * earth), (0.39265 * moon, 0.39274 * moon, 0.39290 * moon)]
    pair, r = S.gravitating_bodies(shapes, masses, G=6.6743e-11), np.outer([-masses[1], masses[0]], [1, 0, 0])
    r, n = r / masses.sum(), 2 * np.pi / (27.321661 * day)
    tilted = Rotation.from_euler("x", [[-23.44], [-1.54]], degrees=True)
    v = 1076.0 * np.cos(np.radians(5.145)) * np.roll(r, 1, axis=1) + 1076.0 * np.sin(np.radians(5.145)) * np.roll(
        r, 2, 1
    )
    x0 = pair.state(3.633e8 * r, v, tilted, [[0, 0, 7.2921e-5], [0, 0, n]])
    method, steps = co.Splitting(order=4, parts="free_body", compensated=True), 365 * years
    sol = co.integrate(pair, x0, (0, steps * day), day, method, save_every=73, observe=pair.integrals)
    rounding = (4 * np.sqrt(steps) + 0.1 * steps) * UNIT_ROUNDOFF
    L = np.stack([sol.observed[f"total L{i}"] for i in (1, 2, 3)], axis=1)
    assert np.linalg.norm(L - L[0], axis=1).max() < rounding * np.linalg.norm(L[0])
    spin = np.linalg.norm(pair.angular_momentum(sol.x)[:, 0], axis=1)
    assert np.abs(spin / spin[0] - 1).max() < 1e-10
    assert sol.drift()["energy"] < 1e-5
