"""Quasi-geostrophic flows on the sphere and the torus: waves, steady states, invariants, topography, three fields."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize
from scipy.special import elliprd, eval_legendre, pro_cv, sph_harm_y

import coadjoint as co
from command import command
from refusals import refused

S = co.systems
MIDPOINT = co.IsospectralGauss()
ISLAND = {(3, 2): 0.05 - 0.02j, (2, 0): 0.1, (1, 0): -0.05}
PLANET = S.sphere_qg(12, 10.0, 2.0, ISLAND)
BASIN = S.torus_qg(13, 3.0, {(1, 2): 0.3, (2, 0): -0.2})
FLOWS = {
    "planet": PLANET,
    "constant radius": S.sphere_qg(12, 0.0, 2.0, gamma=7.0),
    "both": S.sphere_qg(11, 30.0, -1.0, ISLAND, 4.0),
    "basin": BASIN,
    "surface of a sphere": S.surface_qg(12),
    "surface of a torus": S.surface_qg(13, "torus"),
}
# of characteristic values of spheroidal harmonics, by scipy.special.pro_cv(m, n, sqrt(lamb))
WAVES = [(10.0, 1, 1), (10.0, 4, 5), (1000.0, 2, 2), (1000.0, 1, 2), (100.0, 3, 7)]
ROUNDED = 1e-12


@pytest.mark.parametrize("lamb, m, n", WAVES)
def test_speeds_of_waves_are_those_of_spheroidal_harmonics(lamb, m, n):
    """They are the eigenvalues of the continuous equation to order 4 in 1/N."""
    wanted = -2.0 * 1.5 / pro_cv(m, n, np.sqrt(lamb))
    errors = [abs(S.sphere_qg(N, lamb, 1.5).rossby_speed(n, m) / wanted - 1) for N in (36, 72, 144)]
    for coarse, fine in itertools.pairwise(errors):
        assert 12.0 < coarse / fine < 20.0
    assert errors[1] < 1e-4  # 2e-3 to 4e-3 where mu^2 P is {Z, {Z, P}}/4


def test_a_wave_of_any_amplitude_is_an_exact_solution():
    """The pattern turns by the speed, and returns; in one unit of time for both fields."""
    s = S.sphere_qg(16, 10.0, 5.0)
    W, c = s.rossby_wave(3, 2, wave=4.0, longitude=0.3), s.rossby_speed(3, 2)
    assert abs(np.sqrt((s.enstrophy_spectrum(W)[1].sum()) / (2 * np.pi)) - 4.0) < ROUNDED
    field = s.to_grid(W, (33, 360))
    assert np.argmax(field[8, :180]) == pytest.approx(np.degrees(0.3), abs=1)
    sol = co.integrate(s, W, (1.0, 2.0), 1 / 64, co.IsospectralGauss(3), save_every=64)
    turned = s.rossby_wave(3, 2, wave=4.0, longitude=0.3 + c)
    moved = np.abs(turned - W).max()
    assert np.abs(sol.x[-1] - turned).max() < 1e-6 * moved < 1.0 * moved  # of order 6: (h |P|)^6, |P| of some 3


def test_a_constant_radius_shifts_the_eigenvalue():
    """-2 Omega/(l(l + 1) + gamma), for each degree and order, and the run of a harmonic."""
    s = S.sphere_qg(10, 0.0, 3.0, gamma=7.0)
    for l, m in ((1, 1), (4, 2), (9, 9)):
        assert s.rossby_speed(l, m) == pytest.approx(-6.0 / (l * (l + 1) + 7.0), rel=1e-12)
    W = s.from_modes({(4, 2): 1.0})
    sol = co.integrate(s, W, (0, 1), 1 / 32, co.IsospectralGauss(3), save_every=32)
    wanted = np.exp(2j * 6.0 / 27.0)  # c_lm exp(-i m c t)
    assert abs(s.modes(sol.x[-1])[4, 2] - wanted) < 1e-9


def steady_state(s, ratio):
    """Return the state W = ratio P, from the linear equations of its numbers."""
    units = np.eye(s.dim)
    basis = np.linalg.svd(s.to_vector(s.algebra.projected(s.from_vector(units))))[2][: s.algebra.N**2 - 1]
    rest = s.to_vector(s.stream_of(np.zeros(s.shape)))
    streams = s.to_vector(s.stream_of(s.from_vector(basis))) - rest
    matrix = np.eye(len(basis)) - ratio * streams @ basis.T
    return s.from_vector(np.linalg.solve(matrix.T, ratio * basis @ rest) @ basis)


@pytest.mark.parametrize("name", ["planet", "both", "basin"])
def test_states_proportional_to_their_stream_are_steady(name):
    """Q = lambda P, with topography, over ten thousand steps."""
    s = FLOWS[name]
    W = steady_state(s, 3.0)
    size = np.abs(W).max() * np.abs(s.stream_of(W)).max()
    assert np.abs(W - 3.0 * s.stream_of(W)).max() < ROUNDED * np.abs(W).max()
    assert np.abs(s.vector_field(W)).max() < ROUNDED * size
    sol = co.integrate(s, W, (0, 100), 0.01, co.IsospectralGauss(3), save_every=10**4)
    assert np.abs(sol.x[-1] - W).max() < 1e-10 * np.abs(W).max()  # a product of 1e4 steps, of 1e-15 each


@pytest.mark.parametrize("name", FLOWS)
def test_casimirs_and_energy(name):
    """Every Casimir of q to round-off, with topography; the energy error is of order 2, the energy that of psi q."""
    s = FLOWS[name]
    W = s.random(4, enstrophy=2 * np.pi)
    runs = [co.integrate(s, W, (0, 4), h, MIDPOINT) for h in (0.04, 0.02)]
    for casimir, drift in runs[1].drift().items():
        if casimir != "energy":
            assert drift < 1e-13, casimir
    errors = [np.abs(sol.energy - s.energy(W)).max() for sol in runs]
    assert 3.4 < errors[0] / errors[1] < 4.6
    psi, q = (s.to_grid(X, absolute=True) for X in (s.stream_of(W), W - getattr(s, "planetary", 0.0)))
    if s.surface == "torus":
        assert s.energy(W) == pytest.approx(-0.5 * s.area * np.mean(psi * q), rel=1e-12)
    assert s.energy(W) > 0.0 and runs[0].energy[0] == pytest.approx(s.energy(W), rel=1e-13)


def field_of(s):
    return lambda t, x: s.in_numbers.vector_field(x)


@pytest.mark.parametrize("name", FLOWS)
def test_against_a_solver_that_shares_no_code(name):
    """Motions from t0, forward and backward, of members, against DOP853."""
    s = FLOWS[name]
    members = np.stack([s.random(seed, enstrophy=6.0) for seed in (1, 2)])
    for span in ((3.0, 3.5), (0.5, 0.0)):
        sol = co.integrate(s, members, span, 1 / 256, co.IsospectralGauss(3), save_every=10**4)
        for k in range(2):
            start = s.to_vector(members[k])
            wanted = solve_ivp(field_of(s), span, start, "DOP853", rtol=1e-11, atol=1e-11)
            np.testing.assert_allclose(s.to_vector(sol.x[-1, k]), wanted.y[:, -1], rtol=0, atol=1e-8)


def test_the_stream_of_the_sphere_solves_the_continuous_equation():
    """q of a smooth psi by derivatives of Legendre polynomials, from modes alone; the error falls as 1/N^4."""
    lamb, omega, gamma = 50.0, 2.0, 3.0
    c = 0.7 * np.sqrt(4 * np.pi / 7)  # psi = 0.7 P_3(mu), q relative to rest -(12 + gamma + lamb mu^2) psi
    errors = []
    for N in (16, 32, 64):
        s = S.sphere_qg(N, lamb, omega, gamma=gamma)
        W = s.from_stream(s.from_modes({(3, 0): c}, absolute=True))
        mu = np.sin(s.grid((9, 4))[0])
        wanted = -(12 + gamma + lamb * mu**2) * 0.7 * eval_legendre(3, mu) + 2 * omega * mu
        errors.append(np.abs(s.to_grid(W, (9, 4), absolute=True)[:, 0] - wanted).max())
        assert np.abs(s.to_grid(W, (9, 4))[:, 0] + 12 * 0.7 * eval_legendre(3, mu)).max() < ROUNDED * 30
    assert errors[0] / errors[1] > 13.0 and errors[1] / errors[2] > 13.0


@pytest.mark.parametrize("name", ["planet", "constant radius", "both", "basin"])
def test_three_fields_of_a_state(name):
    """Potential vorticity, relative vorticity and stream function, there and back, and what each conversion means."""
    s = FLOWS[name]
    W = s.random(3)
    size = np.abs(W).max()
    zeta = s.to_grid(W)
    assert np.sqrt(s.enstrophy_spectrum(W)[1].sum() * 2 / s.area) == pytest.approx(1.0, rel=1e-12)
    euler = (S.sphere_euler if s.surface == "sphere" else S.torus_euler)(s.algebra.N)
    relative = s.from_grid(zeta)
    for again in (relative, s.absolute(s.relative(W)), s.from_stream(s.stream_of(W)), s.from_modes(s.modes(W))):
        assert np.abs(again - W).max() < ROUNDED * size
    assert np.abs(s.from_grid(s.to_grid(W, absolute=True), absolute=True) - W).max() < ROUNDED * size
    assert np.abs(euler.stream_of(euler.from_grid(zeta)) - s.stream_of(W)).max() < ROUNDED * size
    assert np.abs(np.asarray(s.relative(W)) - euler.random(3)).max() < ROUNDED * size
    assert s.energy(s.relative(W)) == pytest.approx(s.energy(W), rel=1e-12)
    with refused(ValueError, "x0", "relative"):
        co.integrate(s, s.relative(W), (0, 0.01), 0.01)
    dataset = co.integrate(s, W, (0, 0.01), 0.01, MIDPOINT).to_xarray()
    for name in ("vorticity", "potential_vorticity", "stream_function"):
        assert np.abs(s.from_grid(dataset[name].isel(time=0)) - W).max() < ROUNDED * size


@pytest.mark.parametrize("name", FLOWS)
def test_velocities_have_the_kinetic_energy(name):
    """The integral of |u|^2/2 by quadrature is that of the modes of psi; over topography rest is rest."""
    s = FLOWS[name]
    W = s.random(3)
    if s.surface == "sphere":
        weights = np.polynomial.legendre.leggauss(16)[1]
        u, v = s.velocity(W, (16, 32), "gauss-legendre")
        mean = (u**2 + v**2).mean(axis=1) @ weights / 2
    else:
        u, v = s.velocity(W, (32, 32))
        mean = np.mean(u**2 + v**2)
    psi = s.mode_array(s.stream_of(W), absolute=True)
    wanted = (s.squares * s.eigenvalues * np.abs(psi) ** 2).sum() / 2
    assert s.area * mean / 2 == pytest.approx(wanted, rel=1e-12)
    if s.has_frame:
        assert wanted == pytest.approx(s.energy_spectrum(W)[1].sum(), rel=1e-12)
        again, rest = s.velocity(s.relative(W)), s.absolute(np.zeros(s.shape))
        assert np.abs(np.array(again) - s.velocity(W)).max() < ROUNDED * np.abs(u).max()
        assert np.abs(s.velocity(rest)).max() < ROUNDED * np.abs(u).max()


def topographic_waves(m, lamb, omega, height, count=60):
    """Return the angular velocities of waves over h(mu), by Galerkin's method with spherical harmonics, ascending."""
    mu, weights = np.polynomial.legendre.leggauss(200)
    Y = np.array([sph_harm_y(l, m, np.arccos(mu), 0.0).real for l in range(m, m + count)]) * np.sqrt(2 * np.pi)
    l = np.arange(m, m + count)
    h = np.polynomial.Polynomial(height)
    slope = 2 * omega * (np.polynomial.Polynomial([0.0, 1.0]) * (1 + h)).deriv()(mu)
    inertia = np.diag(l * (l + 1.0)) + lamb * (Y * weights * mu**2) @ Y.T
    return np.sort(np.linalg.eigvals(np.linalg.solve(inertia, -(Y * weights * slope) @ Y.T)).real)


def test_waves_over_zonal_topography():
    """The gravest waves of order 2 over h = 0.3 mu^2 - 0.2 mu, against linear theory, to order 2 in 1/N."""
    m, lamb, omega = 2, 20.0, 1.5
    wanted = topographic_waves(m, lamb, omega, [0.0, -0.2, 0.3])
    errors = []
    for N in (24, 48):
        with pytest.warns(UserWarning, match="mean"):
            s = S.sphere_qg(N, lamb, omega, lambda latitude, east: 0.3 * np.sin(latitude) ** 2 - 0.2 * np.sin(latitude))
        i, columns = np.arange(N - m), []
        rest = s.absolute(np.zeros(s.shape))
        assert np.abs(s.stream_of(rest)).max() < ROUNDED * N and "angular momentum z" in s.integrals
        for k in i:
            E = np.zeros(s.shape, dtype=complex)
            E[k, k + m], E[k + m, k] = 1.0, -1.0
            field = (s.vector_field(rest + E) - s.vector_field(rest - E)) / 2  # the linear part
            columns.append(field[i, i + m])
        found = np.sort(-np.linalg.eigvals(np.array(columns).T).imag / m)
        # The mean of h, 0.1, is dropped: depth is relative to the mean depth.
        scaled = topographic_waves(m, lamb, omega, [-0.1, -0.2, 0.3])
        errors.append(np.abs(found[[0, 1]] - scaled[[0, 1]]).max())
    assert 3.0 < errors[0] / errors[1] < 5.0 and errors[1] < 0.01 * np.abs(wanted[0])


def test_an_ellipse_of_buoyancy_rotates_as_in_the_plane():
    """b = sqrt(1 - x^2/a^2 - y^2/b^2) on a small part of the torus: psi is quadratic inside (Dritschel 2011)."""
    a, b, middle = 0.9, 0.45, np.pi
    s = S.surface_qg(201, "torus")
    x, y = (one - middle for one in s.grid())
    inside = 1 - (x[:, None] / a) ** 2 - (y / b) ** 2
    W = s.from_grid(np.sqrt(np.maximum(inside, 0.0)))
    rate = s.to_grid(s.vector_field(W))
    z = x[:, None] + 1j * y
    moment, change = (z**2 * field for field in (np.sqrt(np.maximum(inside, 0.0)), rate))
    found = (change.sum() / moment.sum()).imag / 2
    # 2/3 R_D are the integrals over s of the potential of a flat ellipsoid
    along, across = a * b / 3 * elliprd(b * b, 0.0, a * a), a * b / 3 * elliprd(a * a, 0.0, b * b)
    wanted = (a**2 * along - b**2 * across) / (a**2 - b**2)
    # Images of the other periods have the relative size (a/2 pi)^3 = 0.3 %, of some; the edge N^(-3/2).
    assert found == pytest.approx(wanted, rel=0.03)


def test_forces_act_on_the_potential_vorticity_that_moves():
    """Friction ends at rest over topography; viscosity and noise have the rates that they name."""
    s = PLANET
    rest, W = s.absolute(np.zeros(s.shape)), s.random(2)
    still = co.integrate(s.with_forces(co.forces.Friction(2.0)), W, (0, 20), 0.1, MIDPOINT).x[-1]
    assert np.abs(still - rest).max() < 1e-15 * np.abs(W).max() + 1e-14
    force = co.forces.Viscosity(0.01)
    sol = co.integrate(s.with_forces(force), W, (0, 1e-3), 1e-3, MIDPOINT)
    alone = co.integrate(s, W, (0, 1e-3), 1e-3, MIDPOINT).x[-1]
    V = s.mode_array(W - rest, absolute=True)
    wanted = -0.01 * 1e-3 * (s.eigenvalues - 2.0) * V
    found = s.mode_array(sol.x[-1] - alone, absolute=True)
    assert np.abs(found - wanted).max() < 5e-3 * np.abs(wanted).max()  # the flow turns by that much in a step
    noise = co.forces.RandomForcing(0.5, band=(2, 5), seed=3)
    members = np.broadcast_to(rest, (400, *s.shape))
    fed = co.integrate(s.with_forces(noise), members, (0, 0.1), 0.1, MIDPOINT)
    count = sum(2 * l + 1 for l in range(2, 6))
    # Components of unequal energy: at most three times the variance of equal ones.
    assert abs(fed.energy[-1].mean() - 0.05) < 4 * 0.05 * np.sqrt(3 * 2 / count / 400)


def test_beta_and_topography_meet_on_the_torus():
    """The beta term turns psi: against DOP853 of the equation of the modes."""
    s, beta = BASIN, 1.5
    W, n = s.random(5), np.fft.fftfreq(13, 1 / 13)
    n1 = np.broadcast_to(n[:, None], (13, 13))
    moving = s.with_forces(co.forces.BetaPlane(beta))

    def field(t, x):
        state = s.from_vector(x)
        psi = s.mode_array(s.stream_of(state), absolute=True)
        return s.to_vector(s.vector_field(state) + s.from_modes(-1j * beta * n1 * psi, absolute=True))

    wanted = solve_ivp(field, (0, 1), s.to_vector(W), "DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    errors = []
    for h in (1 / 32, 1 / 64):
        sol = co.integrate(moving, W, (0, 1), h, MIDPOINT, save_every=10**4)
        errors.append(np.abs(s.to_vector(sol.x[-1]) - wanted).max())
    assert 3.5 < errors[0] / errors[1] < 4.5


@pytest.mark.parametrize(
    ("given", "size"),
    [
        ({(2, 1): 300.0}, 300.0 * np.sqrt(15 / (8 * np.pi))),
        ([[2, 1, 300.0, 0.0]], 300.0 * np.sqrt(15 / (8 * np.pi))),
        ({(1, 0): 2.1}, 2.1 * np.sqrt(3 / (4 * np.pi))),
    ],
)
def test_a_ground_above_the_fluid_is_warned_of(given, size):
    """In modes as on grids, by the largest height of the harmonics; the potential vorticity of a plane has no limit."""
    with pytest.warns(UserWarning, match="divide heights by the depth") as caught:
        S.sphere_qg(24, rotation=1.0, topography=given)
    (message,) = (str(one.message) for one in caught)
    assert float(message.split()[2].rstrip(";")) == pytest.approx(size, rel=0.02)
    S.torus_qg(9, topography={(2, 1): 300.0})
    S.sphere_qg(24, rotation=1.0, topography={(2, 1): 0.6, (1, 0): 0.1})


def test_topography_from_every_source(tmp_path):
    """A function, modes, rows, arrays with coordinates in any order, and a file are one field."""
    xarray = pytest.importorskip("xarray")
    bare = S.sphere_euler(12)
    latitude, east = bare.grid()
    field = bare.to_grid(bare.from_modes(ISLAND))

    def height(latitude, east):
        mu = np.sin(latitude)
        Y = sph_harm_y(3, 2, np.pi / 2 - latitude, east)
        return (
            2 * ((0.05 - 0.02j) * Y).real
            + 0.1 * np.sqrt(5 / 16 / np.pi) * (3 * mu**2 - 1)
            - 0.05 * np.sqrt(3 / 4 / np.pi) * mu
        )

    labelled = xarray.DataArray(
        field.T[:, ::-1],
        {"longitude": np.degrees(east), "latitude": np.degrees(latitude[::-1])},
        ("longitude", "latitude"),
        "h",
        {"units": "1"},
    )
    labelled.latitude.attrs["units"], labelled.longitude.attrs["units"] = "degrees_north", "degrees_east"
    labelled.to_netcdf(tmp_path / "h.nc", engine="h5netcdf")
    rows = [[l, m, complex(c).real, complex(c).imag] for (l, m), c in ISLAND.items()]
    for given in (height, rows, field, labelled, tmp_path / "h.nc", str(tmp_path / "h.nc")):
        again = S.sphere_qg(12, 10.0, 2.0, given)
        assert np.abs(again.planetary - PLANET.planetary).max() < ROUNDED * np.abs(PLANET.planetary).max()
    values = BASIN.to_grid(BASIN.planetary, absolute=True)
    assert np.abs(S.torus_qg(13, 3.0, values).planetary - BASIN.planetary).max() < ROUNDED
    # f (1 + h), to the degrees that N resolves, beside its mean
    shown = PLANET.to_grid(PLANET.planetary, absolute=True) + PLANET.planetary_mean
    wanted = 4.0 * np.sin(latitude)[:, None] * (1 + field)
    assert np.abs(shown - wanted).max() < ROUNDED * np.abs(wanted).max()


EARTH = S.RotatingPlanet(radius=6.371e6, day=86164.1, gravity=9.81, depth=2000.0)


def test_a_planet_in_si_units():
    """Its numbers by their definitions, in other units of time, and of one that turns to the west."""
    omega = 2 * np.pi / 86164.1
    assert EARTH.rotation == pytest.approx(2 * np.pi, rel=1e-15)
    assert EARTH.lamb == pytest.approx(4 * omega**2 * 6.371e6**2 / (9.81 * 2000.0), rel=1e-14)
    assert EARTH.deformation_radius == pytest.approx(np.sqrt(9.81 * 2000.0) / (2 * omega), rel=1e-14)
    assert EARTH.rossby_number(10.0) == pytest.approx(10.0 / (2 * omega * 6.371e6), rel=1e-14)
    west = S.RotatingPlanet(6.371e6, -86164.1, 9.81, 2000.0, time=3600.0)
    assert west.rotation == pytest.approx(-omega * 3600.0, rel=1e-14) and west.lamb == EARTH.lamb
    for arguments, name in (
        ((0.0, 1.0, 1.0, 1.0), "radius"),
        ((1.0, 0.0, 1.0, 1.0), "day"),
        ((1.0, 1.0, 1.0, -1.0), "depth"),
    ):
        with refused(ValueError, name):
            S.RotatingPlanet(*arguments)


def test_a_restart_from_another_model(tmp_path):
    """Vorticities in s-1 on a Gaussian grid, of float32, and the fields of a run in SI units, each in one call."""
    xarray = pytest.importorskip("xarray")
    s = S.sphere_qg(12, EARTH.lamb, EARTH.rotation, ISLAND)
    W = s.random(1, energy=1e-3)
    latitude, east = s.grid((20, 40), "gauss-legendre")
    shown = {
        "vor": s.to_grid(W, (20, 40), "gauss-legendre"),
        "q": s.to_grid(W, (20, 40), "gauss-legendre", absolute=True) + s.planetary_mean,
    }
    coordinates = {
        "lat": ("lat", np.degrees(latitude), {"units": "degrees_north"}),
        "lon": ("lon", np.degrees(east), {"units": "degrees_east"}),
    }
    for name, values in shown.items():
        field = (values / 86164.1)[None].astype("f4")
        dataset = xarray.Dataset({name: (("time", "lat", "lon"), field, {"units": "s-1"})}, coordinates)
        dataset.to_netcdf(tmp_path / f"{name}.nc", engine="h5netcdf")
        again = s.from_file(tmp_path / f"{name}.nc", planet=EARTH)
        assert np.abs(again - W).max() < 1e-6 * np.abs(W).max()
        with refused(ValueError, name, "s-1", "planet"):
            s.from_file(tmp_path / f"{name}.nc")
        with refused(ValueError, name, "s-1", "planet"):
            s.from_grid(dataset[name])
    humid = dataset.q.isel(time=0).assign_attrs(units="kg kg-1")
    with refused(ValueError, "q", "kg kg-1"):
        EARTH.without_units(humid)
    biased = dataset.assign(q=(dataset.q + 1e-5).assign_attrs(units="s-1"))
    biased.to_netcdf(tmp_path / "biased.nc", engine="h5netcdf")
    with pytest.warns(UserWarning, match=f"mean {s.planetary_mean + 1e-5 * 86164.1:.4f}"):
        s.from_file(tmp_path / "biased.nc", planet=EARTH)
    with refused(ValueError, "vor", "buoyancy"):
        S.surface_qg(12).from_file(tmp_path / "vor.nc", planet=EARTH)
    np.save(tmp_path / "state.npy", W)
    with refused(ValueError, "state.npy", "planet"):
        s.from_file(tmp_path / "state.npy", planet=EARTH)
    run = co.integrate(s, W, (2.0, 2.5), 0.125, MIDPOINT)
    found = EARTH.with_units(run.to_xarray())
    found.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    assert found.time.attrs["units"] == "s" and float(found.time[-1]) == pytest.approx(2.5 * 86164.1)
    for name, units in (("vorticity", "s-1"), ("potential_vorticity", "s-1"), ("stream_function", "m2 s-1")):
        assert found[name].attrs["units"] == units and found[name].attrs["cell_methods"] == "time: point"
        last = s.from_file(tmp_path / "run.nc", variable=name, select={"time": -1}, planet=EARTH)
        assert np.abs(last - run.x[-1]).max() < ROUNDED * np.abs(W).max()
    whole = EARTH.with_units(run.to_xarray(grid=True))
    u, v = s.velocity(run.x)
    for name, values, standard in (("eastward", u, "eastward_wind"), ("northward", v, "northward_wind")):
        field = whole[f"{name}_velocity"]
        np.testing.assert_allclose(field, values * 6.371e6 / 86164.1, rtol=1e-14)
        assert field.attrs["units"] == "m s-1" and field.attrs["standard_name"] == standard
        with refused(ValueError, f"{name}_velocity", "velocity"):
            s.from_grid(run.to_xarray(grid=True)[f"{name}_velocity"].isel(time=0))
    whole[["vorticity", "eastward_velocity"]].to_netcdf(tmp_path / "wind.nc", engine="h5netcdf")
    assert np.abs(s.from_file(tmp_path / "wind.nc", select={"time": -1}, planet=EARTH) - run.x[-1]).max() < 1e-10
    heights = xarray.DataArray(np.full((13, 12), 20.0), {"lat": np.linspace(-90, 90, 13), "lon": np.arange(0, 360, 30)})
    heights = heights * np.sin(np.radians(heights.lat))
    flat = S.sphere_qg(12, 10.0, 1.0, EARTH.without_units(heights.assign_attrs(units="m")))
    wanted = S.sphere_qg(12, 10.0, 1.0, {(1, 0): 0.01 * np.sqrt(4 * np.pi / 3)})
    assert np.abs(flat.planetary - wanted.planetary).max() < ROUNDED * np.abs(wanted.planetary).max()


def test_what_cannot_be_used_is_refused():
    """Topographies without coordinates, in metres, with NaN or a mean; parameters below zero; small matrices."""
    xarray = pytest.importorskip("xarray")
    east, north = np.arange(0.0, 360.0, 30.0), np.linspace(-90.0, 90.0, 13)
    values = 0.1 * np.sin(np.radians(north))[:, None] * np.ones(12)
    field = xarray.DataArray(values, {"lat": north, "lon": east}, ("lat", "lon"), "height")
    for arguments, words in (
        ({"lamb": -1.0}, ("lamb", "-1")),
        ({"gamma": -1.0}, ("gamma", "-1")),
        ({"topography": np.zeros((5, 7))}, ("topography", "(5, 7)", "coordinates")),
        ({"topography": field.assign_attrs(units="m")}, ("topography", "units m", "depth")),
        ({"topography": field.where(field.lat < 60.0)}, ("NaN", "lat", "60", "lon")),
        ({"topography": field.drop_vars("lon")}, ("height", "lon")),
        ({"topography": field.isel(lon=slice(3))}, ("longitudes", "60 degrees", "part")),
        ({"topography": field.isel(lat=slice(3, 9))}, ("latitudes", "-45 to 30 degrees", "part")),
        ({"topography": field.pad(lon=(0, 1), mode="wrap").assign_coords(lon=[*east, 360.0])}, ("isel", "meridian")),
        ({"topography": [[2, 1, 0.1, 0.0], [2, 1, 0.1, 0.0]]}, ("topography", "twice")),
        ({"lamb": 1e9}, ("lamb", "1e+09", "N")),
    ):
        with (
            refused(ValueError, *words),
            pytest.warns() if arguments.get("lamb") == 1e9 else pytest.MonkeyPatch.context(),
        ):
            S.sphere_qg(**{"N": 8, "lamb": 1.0, "rotation": 1.0} | arguments)
    for units in ({}, {"units": ""}):
        with refused(ValueError, "height", "units"):
            EARTH.without_units(field.assign_attrs(units))
    with refused(TypeError, "topography", "coordinates"):
        S.sphere_qg(8, 1.0, 1.0, lambda latitude: latitude)
    with pytest.warns(UserWarning, match=r"mean 0\.25"):
        with_mean = S.sphere_qg(8, 1.0, 1.0, field + 0.25)
    assert np.abs(with_mean.planetary - S.sphere_qg(8, 1.0, 1.0, field).planetary).max() < ROUNDED * 4
    for make, needed in ((lambda N: S.sphere_qg(N, 400.0), 21), (lambda N: S.torus_qg(N, 100.0), 21)):
        with pytest.warns(UserWarning, match=f"N = {needed} resolves"):
            make(needed - 2)
        make(needed)


@pytest.mark.parametrize("energy", [1e-3, 0.5, 5.0])
@pytest.mark.parametrize("lamb, gamma", [(10.0, 0.0), (0.0, 0.0), (8.0, 3.0)])
def test_states_of_minimum_enstrophy(lamb, gamma, energy):
    """They are steady, and other states of the same energy have more enstrophy."""
    s = S.sphere_qg(10, lamb, 2.0, ISLAND, gamma)
    W = s.minimum_enstrophy(energy)
    assert s.energy(W) == pytest.approx(energy, rel=1e-10)
    assert np.abs(s.vector_field(W)).max() < ROUNDED * np.abs(W).max()
    least = s.enstrophy_spectrum(W, absolute=True)[1].sum()
    V, rng = W - s.planetary, np.random.default_rng(1)
    for size in (1e-3, 0.1, 1.0):
        for _ in range(20):
            noise = s.algebra.projected(rng.standard_normal(s.shape) + 1j * rng.standard_normal(s.shape))
            other = V + size * np.abs(V).max() * noise
            other *= np.sqrt(energy / s.energy(other + s.planetary))
            assert s.enstrophy_spectrum(other + s.planetary, absolute=True)[1].sum() > least


def test_energies_without_a_state_of_minimum_enstrophy_are_refused():
    """Beyond the largest one, where waves of order 1 are gravest, and without rotation."""
    s = S.sphere_qg(10, 10.0, 2.0)
    with refused(ValueError, "energy", "100"):
        s.minimum_enstrophy(100.0)
    with refused(ValueError, "energy", "up to 0"):
        S.sphere_qg(10, 10.0).minimum_enstrophy(1.0)
    assert S.sphere_qg(10, 0.0, 2.0).minimum_enstrophy(100.0).shape == (10, 10)


def test_lines_of_a_torus_with_topography():
    """The explicit splitting has its order with a constant added to the stream, and keeps the spectrum."""
    s, W = BASIN, BASIN.random(3)
    wanted = solve_ivp(field_of(s), (0, 1), s.to_vector(W), "DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    errors = []
    for h in (1 / 16, 1 / 32):
        sol = co.integrate(s, W, (0, 1), h, co.LineSplitting(2), save_every=10**4)
        errors.append(np.abs(s.to_vector(sol.x[-1]) - wanted).max())
        assert np.abs(s.spectrum(sol.x[-1]) - s.spectrum(W)).max() < ROUNDED * np.abs(s.spectrum(W)).max()
    assert 3.5 < errors[0] / errors[1] < 4.5


@pytest.mark.parametrize("name", ["planet", "basin", "surface of a sphere"])
def test_archives_of_interrupted_runs(name, tmp_path):
    """A run that is stored, and resumed from its archive, has the bits of a run in memory."""
    s = FLOWS[name].with_forces(co.forces.Friction(0.1), co.forces.RandomForcing(0.1, (2, 4), seed=2))
    W = FLOWS[name].random(1)
    whole = co.integrate(s, W, (0, 2), 0.125, MIDPOINT)
    co.integrate(s, W, (0, 1), 0.125, MIDPOINT, archive=tmp_path / "run.zarr")
    resumed = co.resume(tmp_path / "run.zarr", 2.0)
    np.testing.assert_array_equal(resumed.x[-1], whole.x[-1])
    again = co.load(tmp_path / "run.zarr").system.unforced
    np.testing.assert_array_equal(again.stream_of(W), FLOWS[name].stream_of(W))
    if name != "surface of a sphere":
        assert again.parameters == FLOWS[name].parameters


def test_configuration_files(tmp_path, capsys):
    """Topography as rows of modes, and a restart in SI units, with the planet as a table."""
    xarray = pytest.importorskip("xarray")
    W = PLANET.random(1, energy=1e-3)
    latitude, east = PLANET.grid()
    field = (("lat", "lon"), PLANET.to_grid(W) / 86164.1, {"units": "s-1"})
    coordinates = {"lat": np.degrees(latitude), "lon": np.degrees(east)}
    xarray.Dataset({"vor": field}, coordinates).to_netcdf(tmp_path / "vor.nc", engine="h5netcdf")
    rows = [[l, m, complex(c).real, complex(c).imag] for (l, m), c in ISLAND.items()]
    (tmp_path / "run.toml").write_text(
        f"""
        [system]
        name = "sphere_qg"
        parameters = {{N = 12, lamb = 10.0, rotation = 2.0, topography = {rows}}}
        [initial]
        kind = "from_file"
        path = "vor.nc"
        planet = {{radius = 6.371e6, day = 86164.1, gravity = 9.81, depth = 2000.0}}
        [method]
        name = "IsospectralGauss"
        [run]
        t_span = [0.0, 0.5]
        step = 0.125
        """
    )
    assert command(capsys, "run", tmp_path / "run.toml", "--out", tmp_path / "run.nc", "--quiet").status == 0
    found = co.load(tmp_path / "run.nc")
    wanted = co.integrate(PLANET, W, (0, 0.5), 0.125, MIDPOINT)
    assert np.abs(found.x - wanted.x).max() < ROUNDED * np.abs(W).max()


def test_a_unit_of_time_other_than_the_day():
    pytest.importorskip("xarray")
    hourly = S.RotatingPlanet(6.371e6, 86164.1, 9.81, 2000.0, time=3600.0)
    s = S.sphere_qg(12, 10.0, hourly.rotation)
    plain = co.integrate(s, s.random(seed=1), (2.0, 2.5), 0.25, MIDPOINT).to_xarray()
    found = hourly.with_units(plain)
    np.testing.assert_allclose(found.time, 3600.0 * plain.time, rtol=1e-15)
    for name, factor in (("vorticity", 1.0), ("potential_vorticity", 1.0), ("stream_function", 6.371e6**2)):
        np.testing.assert_allclose(found[name], plain[name] * factor / 3600.0, rtol=1e-14)


def test_heights_in_kilometres_are_those_in_metres():
    xarray = pytest.importorskip("xarray")
    heights = xarray.DataArray(np.array([[0.1, -0.2]]), dims=("latitude", "longitude"))
    for name, factor in (("m", 1.0), ("km", 1e-3)):
        found = EARTH.without_units((factor * heights).assign_attrs(units=name))
        np.testing.assert_allclose(found, heights / 2000.0, rtol=1e-15)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "parameters, axes",
    [((0.0, 0.0, None, 4.0), "xyz"), ((0.0, 2.0, None, 4.0), "z"), ((0.0, 2.0), "z"), ((9.0, 0.0), "z")]
    + [((9.0, 2.0, {(2, 0): 0.1}), "z"), ((9.0, 2.0, ISLAND), "")],
)
def test_the_components_of_angular_momentum_that_are_constant(parameters, axes):
    """They are listed, and their derivatives along the motion vanish; the integrals are linear in the state."""
    s = S.sphere_qg(8, *parameters)
    W = s.random(seed=1)
    field = s.vector_field(W)
    assert list(s.integrals) == [f"angular momentum {axis}" for axis in axes]
    for integral in s.integrals.values():
        assert abs(integral(field)) < ROUNDED * np.abs(field).max()


@pytest.mark.parametrize("topography", [None, {(3, 0): 0.1}])
def test_the_least_enstrophy_of_an_energy_and_an_angular_momentum(topography):
    """The minimum over zonal states by sequential quadratic programming; other momenta need more enstrophy."""
    s = S.sphere_qg(8, 10.0, 2.0, topography)
    momentum = s.integrals["angular momentum z"]
    free = s.minimum_enstrophy(0.01)
    wanted = momentum(free) - 0.1
    W = s.minimum_enstrophy(0.013, wanted)
    assert s.energy(W) == pytest.approx(0.013, rel=1e-12)
    assert momentum(W) == pytest.approx(wanted, rel=1e-13)
    assert np.abs(s.vector_field(W)).max() < 1e-12 * np.abs(W).max()

    def state(c):
        return s.planetary + s.from_modes({(l, 0): one for l, one in enumerate(c, 1)}, absolute=True)

    unit = np.sum(np.abs(W) ** 2)
    constraints = [
        {"type": "eq", "fun": lambda c: 100 * (s.energy(state(c)) - 0.013)},
        {"type": "eq", "fun": lambda c: momentum(state(c)) - wanted},
    ]
    starts = np.random.default_rng(3).standard_normal((4, 7))
    found = [
        minimize(lambda c: np.sum(np.abs(state(c)) ** 2) / unit, 0.1 * c, method="SLSQP", constraints=constraints,
                 options={"ftol": 1e-14, "maxiter": 500})
        for c in starts
    ]  # fmt: skip
    assert min(one.fun for one in found if one.success) == pytest.approx(1.0, abs=1e-8)
    again = s.minimum_enstrophy(0.01, momentum(free))
    assert np.abs(again - free).max() < 1e-9 * np.abs(free).max()
    with refused(ValueError, "energy is 5", "angular momentum"):
        s.minimum_enstrophy(5.0, wanted)
    with refused(ValueError, "angular momentum", "zonal"):
        PLANET.minimum_enstrophy(0.01, 0.1)
