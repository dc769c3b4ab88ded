"""Point vortices in the plane and on the sphere: closed forms, stability, collapse, and vortices of a fluid."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import k0, k1

import coadjoint as co
from refusals import refused

S = co.systems
CIRCULATIONS = np.array([1.0, -0.7, 2.0, 0.3])
GAUSS = co.GaussLegendre(3)


def places_of(surface, count=4, seed=1):
    """Return random places, (count, 2) or unit vectors (count, 3)."""
    r = np.random.default_rng(seed).standard_normal((count, 2 + (surface == "sphere")))
    return r / np.linalg.norm(r, axis=1, keepdims=True) if surface == "sphere" else r


def velocities(circulations, r, radius=None):
    """Return the velocities (count, 2) or (count, 3), vortex by vortex; with a radius those of screened ones."""
    found = np.zeros_like(r)
    for i in range(len(r)):
        for j in set(range(len(r))) - {i}:
            d = r[i] - r[j]
            across = np.cross(r[j], r[i]) if r.shape[1] == 3 else np.array([-d[1], d[0]])
            u = 1.0 if radius is None else np.sqrt(d @ d) / radius
            found[i] += circulations[j] * across / (2 * np.pi * (d @ d)) * (1.0 if radius is None else u * k1(u))
    return found


def reference(circulations, r, span, radius=None):
    def field(t, y):
        return velocities(circulations, y.reshape(r.shape), radius).ravel()

    return solve_ivp(field, span, r.ravel(), method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1].reshape(r.shape)


@pytest.mark.parametrize("span", [(0.0, 1.5), (2.0, 0.5)])
@pytest.mark.parametrize("surface, radius", [("plane", None), ("sphere", None), ("plane", 0.6)])
def test_members_follow_the_equations_of_kirchhoff_and_helmholtz(surface, radius, span):
    s, starts = S.point_vortices(CIRCULATIONS, surface, radius), [places_of(surface, seed=k) for k in (1, 2)]
    x0 = np.stack([s.state(r) for r in starts])
    sol = co.integrate(s, x0, span, 2.0**-8, GAUSS, save_every=64)
    for k, r in enumerate(starts):
        wanted = reference(CIRCULATIONS, r, span, radius)
        np.testing.assert_allclose(s.places(sol.x[-1, k]), wanted, rtol=0, atol=1e-10)
    for name, values in s.integrals.items():
        of_run = values(sol.x)
        assert np.ptp(of_run, axis=0).max() < 1e-10, name
    assert all(value < 1e-10 for value in sol.drift().values())


def test_members_may_have_circulations_of_their_own():
    r = places_of("sphere")
    batch = co.batch([S.point_vortices(c * CIRCULATIONS, "sphere") for c in (0.5, -2.0)])
    sol = co.integrate(batch, batch.of_member(0).state(r), (0, 1), 2.0**-7, GAUSS)
    for k, c in enumerate((0.5, -2.0)):
        wanted = reference(c * CIRCULATIONS, r, (0, 1))
        np.testing.assert_allclose(sol.x[-1, k].reshape(r.shape), wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("scale", [1e-7, 1e30])
def test_lengths_and_circulations_have_any_unit(scale):
    """The distance d of two vortices has the period 4 pi^2 d^2/(c_1 + c_2)."""
    s = S.point_vortices((scale, 2.0 * scale))
    x0 = s.state(scale * np.array([[0.4, 0.1], [-0.6, 0.1]]))
    period = 4 * np.pi**2 * scale**2 / (3.0 * scale)
    sol = co.integrate(s, x0, (0, period), period / 256, GAUSS)
    assert np.abs(sol.x[-1] - x0)[:4].max() < 1e-11 * scale
    assert np.abs(s.exact(x0, period / 3) - sol.at(period / 3).x)[:4].max() < 1e-6 * scale


@pytest.mark.parametrize("scheme, order", [(co.SphericalMidpoint(), 2), (co.GaussLegendre(2), 4)])
def test_orders_on_the_sphere(scheme, order):
    s, r = S.point_vortices(CIRCULATIONS, "sphere"), places_of("sphere")
    wanted = reference(CIRCULATIONS, r, (0, 1)).ravel()
    errors = [np.abs(co.integrate(s, s.state(r), (0, 1), h, scheme).x[-1] - wanted).max() for h in (0.01, 0.005)]
    assert order - 0.3 < np.log2(errors[0] / errors[1]) < order + 0.3


def test_members_may_have_radii_of_their_own():
    r, radii = places_of("plane"), (0.3, 5.0)
    batch = co.batch([S.point_vortices(CIRCULATIONS, radius=radius) for radius in radii])
    sol = co.integrate(batch, batch.of_member(0).state(r), (0, 1), 2.0**-7, GAUSS)
    for k, radius in enumerate(radii):
        wanted = reference(CIRCULATIONS, r, (0, 1), radius)
        np.testing.assert_allclose(sol.x[-1, k, :-1].reshape(r.shape), wanted, rtol=0, atol=1e-9)


@pytest.mark.parametrize("scale", [1e-7, 1.0, 1e30])
def test_energy_and_velocity_of_screened_vortices_are_bessel_functions(scale):
    """An argument that is rounded to one part of 2^53 changes them by u parts; SciPy's errors are a few units."""
    s = S.point_vortices((2.0, 3.0), radius=scale)
    for u in (*np.geomspace(1e-8, 700.0, 60), *np.linspace(0.9, 1.1, 40)):
        x = s.state([[0.0, 0.0], [0.6 * u * scale, 0.8 * u * scale]])
        exact = 8e-16 * (2 + u)
        assert s.energy(x) == pytest.approx(6.0 * k0(u) / (2 * np.pi), rel=exact)
        across = k1(u) / (2 * np.pi * scale) * np.array([0.8, -0.6])
        np.testing.assert_allclose(s.vector_field(x)[:4], [*(3.0 * across), *(-2.0 * across)], rtol=exact)
    far = s.state([[0.0, 0.0], [1e4 * scale, 0.0]])
    assert s.energy(far) == 0.0
    assert not s.vector_field(far).any()


def test_the_jacobian_of_screened_vortices():
    s, r, step = S.point_vortices(CIRCULATIONS, radius=0.6), places_of("plane"), 1e-5
    for k, change in enumerate(step * np.eye(8).reshape(8, 4, 2)):
        slope = (velocities(CIRCULATIONS, r + change, 0.6) - velocities(CIRCULATIONS, r - change, 0.6)) / (2 * step)
        np.testing.assert_allclose(s.jacobian(s.state(r))[:8, k], slope.ravel(), rtol=0, atol=1e-8)


def test_screened_vortices_of_a_large_radius_are_those_without_one():
    """``u K1(u) - 1`` is 3e-19 at u = 2e-10; energies differ by a constant."""
    plain, screened = S.point_vortices(CIRCULATIONS), S.point_vortices(CIRCULATIONS, radius=1e10)
    x = plain.state([places_of("plane", seed=k) for k in (1, 2)])
    for one in x:
        np.testing.assert_allclose(screened.vector_field(one), plain.vector_field(one), rtol=0, atol=1e-14)
    changes = [s.energy(x[1]) - s.energy(x[0]) for s in (plain, screened)]
    assert changes[1] == pytest.approx(changes[0], abs=1e-13)  # of energies of 10


@pytest.mark.parametrize("scale", [1e-7, 1e30])
def test_screened_pairs_turn_or_go_straight_in_any_unit(scale):
    d, R = 1.0, 0.4
    rate = 3.0 * k1(d / R) / (2 * np.pi * d * R * scale)
    s = S.point_vortices((scale, 2.0 * scale), radius=R * scale)
    x0 = s.state(scale * np.array([[0.4, 0.1], [-0.6, 0.1]]))
    period = 2 * np.pi / rate
    sol = co.integrate(s, x0, (period, 2 * period), period / 256, GAUSS)
    assert np.abs(sol.x[-1] - x0)[:4].max() < 1e-11 * scale
    assert np.abs(s.exact(x0, period / 4) - sol.x[64])[:4].max() < 1e-11 * scale
    opposite = S.point_vortices((scale, -scale), radius=R * scale)
    moved = opposite.places(opposite.exact(x0, period / 4)) - opposite.places(x0)
    np.testing.assert_allclose(moved[:, 1], -np.pi / 6 * scale, rtol=1e-14)


def growth(count):
    """Return the growth rates of small changes of a ring, in the frame that turns with it, of unit circulations."""
    s, angles = S.point_vortices(np.ones(count)), 2 * np.pi * np.arange(count) / count
    x0 = s.state(np.stack([np.cos(angles), np.sin(angles)], axis=-1))
    rate, quarter = (count - 1) / (4 * np.pi), np.kron(np.eye(count), [[0.0, -1.0], [1.0, 0.0]])
    np.testing.assert_allclose(s.vector_field(x0)[:-1], rate * quarter @ x0[:-1], rtol=0, atol=1e-14)
    return np.linalg.eigvals(s.jacobian(x0)[:-1, :-1] - rate * quarter).real.max()


def test_rings_of_up_to_seven_vortices_are_stable():
    """Rates of J. J. Thomson; those of seven are zero, double eigenvalues that rounding splits by its root."""
    for count in range(2, 8):
        assert growth(count) < 1e-6
    for count in (8, 9, 11):
        k = count // 2
        square = k * (count - k) * (k * (count - k) - 2 * (count - 1))
        assert growth(count) == pytest.approx(np.sqrt(square) / (4 * np.pi), rel=1e-9)


def test_three_vortices_collapse_to_a_point():
    """Squared distances fall linearly where c_1 c_2 + c_2 c_3 + c_3 c_1 and the sum of c_i c_j d_ij^2 vanish."""
    s = S.point_vortices((2.0, 2.0, -1.0))
    x0 = s.state([[-1.0, 0.0], [1.0, 0.0], [1.0, np.sqrt(2.0)]])

    def squares(x):
        r = s.places(x)
        return np.array([np.sum((r[..., i, :] - r[..., j, :]) ** 2, axis=-1) for i, j in ((0, 1), (1, 2), (2, 0))])

    end = 3 * np.sqrt(2) * np.pi  # of collapse, or before which they spread, as they turn one way or the other
    for sign in (1.0, -1.0):
        sol = co.integrate(s, x0, (0, sign * 0.9 * end), 0.9 * end / 4096, co.GaussLegendre(4), save_every=256)
        factor = squares(sol.x) / squares(x0)[:, None]
        slope = (factor[0, 1] - 1) / sol.t[1]
        np.testing.assert_allclose(factor, 1 + np.broadcast_to(slope * sol.t, factor.shape), rtol=0, atol=1e-8)
        assert abs(slope) == pytest.approx(1 / end, rel=1e-8)


def test_an_equilateral_triangle_on_the_sphere_turns_about_its_impulse():
    """Kidambi and Newton: with the rate |sum of c_i r_i|/(2 pi d^2), for any circulations."""
    s = S.point_vortices((1.0, -2.5, 0.75), "sphere")
    longitudes = 2 * np.pi * np.arange(3) / 3
    x0 = s.state(np.stack([np.full(3, 0.4), longitudes], axis=-1))
    r = s.places(x0)
    impulse = s.circulations @ r
    rate = np.linalg.norm(impulse) / (2 * np.pi * np.sum((r[0] - r[1]) ** 2))
    sol = co.integrate(s, x0, (0, 2 * np.pi / rate), 2 * np.pi / rate / 256, GAUSS)
    assert np.abs(sol.x[-1] - x0).max() < 1e-10
    assert np.abs(sol.x[128] - x0).max() > 0.3


def test_vortices_of_a_fluid_go_along_with_point_vortices():
    """Gaussian vortices whose tracks differ by less than their width, on a path of more than twelve."""
    places, circulations, width = np.array([[0.5, 0.0], [0.1, 0.9], [-0.5, -0.6]]), (2.0, 1.5, -2.0), 0.12
    fluid, points = S.sphere_euler(48), S.point_vortices(circulations, "sphere")
    W = fluid.blobs(places, circulations, np.full(3, width))
    sol = co.integrate(fluid, W, (0, 5), 0.0125, co.IsospectralGauss(), save_every=100)
    tracks = co.integrate(points, points.state(places), (0, 5), 0.01, GAUSS, save_every=125)
    latitude, longitude = fluid.grid((97, 192))
    grid = points_on_sphere(latitude[:, None], longitude[None, :])
    for W, x in zip(sol.x, tracks.x, strict=True):
        field = fluid.to_grid(W, (97, 192)) * np.cos(latitude)[:, None]
        for r, c in zip(points.places(x), circulations, strict=True):
            own = np.where((grid @ r > np.cos(3 * width)) & (field * c > 0), np.abs(field), 0.0)
            centre = np.einsum("ij,ijk->k", own, grid)
            assert np.linalg.norm(centre / np.linalg.norm(centre) - r) < width
    moved = np.linalg.norm(points.places(tracks.x[-1]) - points.places(tracks.x[0]), axis=1)
    assert moved.max() > 12 * width


def points_on_sphere(latitude, longitude):
    return np.stack(np.broadcast_arrays(
        np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude) + 0 * longitude
    ), axis=-1)  # fmt: skip


@pytest.mark.parametrize("circulations", [(1.0, 2.5), (1.0, -1.0)])
def test_the_closed_form_of_a_pair_at_any_value_of_the_central_coordinate(circulations):
    """Brackets are proportional to z, and a pair moves z times as fast."""
    s = S.point_vortices(circulations)
    x0 = s.state([[0.5, 0.2], [-0.3, 0.1]])
    faster = np.append(x0[:-1], -1.7)
    np.testing.assert_allclose(s.vector_field(faster)[:-1], -1.7 * s.vector_field(x0)[:-1], rtol=1e-14)
    found = s.exact(faster, np.array([0.4, 3.0]))
    np.testing.assert_allclose(found[:, :-1], s.exact(x0, -1.7 * np.array([0.4, 3.0]))[:, :-1], rtol=0, atol=1e-13)
    assert found[:, -1].tolist() == [-1.7, -1.7]


def test_archives_and_places(tmp_path):
    s = S.point_vortices(CIRCULATIONS, "sphere")
    x0 = s.state(places_of("sphere"))
    run = co.integrate(s, x0, (0, 1), 0.01, co.SphericalMidpoint(), archive=tmp_path / "vortices.zarr")
    again = co.load(tmp_path / "vortices.zarr")
    assert np.array_equal(again.x, run.x)
    assert np.array_equal(again.system.circulations, CIRCULATIONS)
    assert again.system.surface == "sphere"
    assert again.system.places(again.x).shape == (101, 4, 3)


def test_archives_keep_the_radius_and_are_resumed(tmp_path):
    s, path = S.point_vortices(CIRCULATIONS, radius=0.6), tmp_path / "screened.zarr"
    x0 = s.state(places_of("plane"))
    whole = co.integrate(s, x0, (0, 1), 2.0**-6, GAUSS)
    co.integrate(s, x0, (0, 0.5), 2.0**-6, GAUSS, archive=path)
    assert co.load(path).system.radius == 0.6
    co.resume(path, 1.0)
    assert np.array_equal(co.load(path).x, whole.x)
    assert S.point_vortices().radius is None


def test_what_is_refused():
    plane, sphere = S.point_vortices(), S.point_vortices((1.0, 2.0), "sphere")
    with refused(ValueError, "|x|^2 [2]", 4, "unit"):
        co.integrate(sphere, [1.0, 0, 0, 0, 2.0, 0], (0, 1), 0.1, GAUSS)
    with refused(ValueError, "|x|^2 [1]", "unit"):
        co.integrate(co.batch([sphere, S.point_vortices((1.0, 3.0), "sphere")]), np.ones((2, 6)), (0, 1), 0.1, GAUSS)
    with refused(ValueError, "x0[..., 4]", "point_vortices"):
        co.integrate(plane, [1.0, 0, 0, 0, 2.0], (0, 1), 0.1, GAUSS)
    with refused(ValueError, "circulations[1]", "tracer"):
        S.point_vortices((1.0, 0.0))
    with refused(ValueError, "latitude", "radians"):
        sphere.state([[45.0, 0.0], [0.0, 0.0]])
    with refused(ValueError, "latitude 2", "pi/2"):  # such as a longitude in its place
        sphere.state([[2.0, 0.1], [0.0, 0.0]])
    with refused(ValueError, "length 2", "unit"):
        sphere.state([[0.0, 0.0, 2.0], [1.0, 0.0, 0.0]])
    with refused(ValueError, "(3, 2)", "2 vortices"):
        plane.state(np.zeros((3, 2)))
    with refused(ValueError, "radius", "sphere", "plane"):
        S.point_vortices((1.0, 2.0), "sphere", radius=0.5)
    for radius in (0.0, -1.0, np.inf, 1e101, 1e-101):
        with refused(ValueError, "radius"):
            S.point_vortices((1.0, 2.0), radius=radius)
    with refused(ValueError, "momentum", "point_vortices"):
        plane.with_forces(co.forces.LinearDamping(0.1))
