"""Thermal quasi-geostrophic flow: equations by modes, invariants, waves in closed form, forces, files and pictures."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import coadjoint as co
from refusals import refused

S = co.systems
FLOWS = {
    "sphere": S.thermal_qg(9, 3.0, 1.5, {(2, 1): 0.1}, {(3, 2): 0.4, (1, 0): -0.3}),
    "of latitude": S.thermal_qg(9, 0.0, -0.7, None, {(2, 0): 0.5}, lamb=5.0),
    "torus": S.thermal_qg(9, 2.0, 0.0, {(1, 0): 0.4}, {(1, 1): 0.3, (0, 2): 0.2}, surface="torus"),
}
STARTS = (lambda x, y: 0.5 * np.cos(x) + 0.3 * np.sin(y), lambda x, y: 0.5 * np.sin(x + y) + 0.4 * np.cos(y))
"""Buoyancy and potential vorticity on the torus."""
EACH = pytest.mark.parametrize("name", FLOWS)
SIXTH = co.IsospectralGauss(3)


def start_of(s, seed=1, size=1.0):
    """Return a state of random buoyancy and relative vorticity."""
    plain = S.sphere_euler(9) if s.parameters["surface"] == "sphere" else S.torus_euler(9)
    b, W = (size * plain.random(seed=seed + k, degrees=(1, 4)) for k in range(2))
    return s.absolute(np.stack([b, W]))


def sine_of(s):
    """Return the matrix of mu, and of 1 on the torus."""
    if s.parameters["surface"] == "torus":
        return np.eye(9)
    z = np.arange(9)[::-1] - 4.0
    return np.diag(z) / np.sqrt(80 / 4)


def product(s, b):
    """Return mu times a field, without its mean, by the matrix of mu."""
    Z = sine_of(s)
    found = (Z @ b + b @ Z) / 2
    return found - np.trace(found) / 9 * np.eye(9)


def field_of(s, X, force=lambda b, q: (0.0, 0.0)):
    """Return the motion by the stream function of every mode, and forces (on b, on q)."""
    b, W = X
    fluid, parameters = s.fluid, s.parameters
    q = W - product(s, b)
    modes = fluid.mode_array(q - fluid.planetary, absolute=True)
    inverse = np.where(fluid.degrees > 0, fluid.eigenvalues + parameters["gamma"], 1.0)
    P = fluid.from_modes(np.where(fluid.degrees > 0, -modes / inverse, 0.0), absolute=True)
    rows = {(int(m), int(n)): complex(x, y) for m, n, x, y in parameters["bathymetry"]}
    J = fluid.from_modes(rows, absolute=True) / 2 - product(s, P)
    of_b, of_q = force(b, q)
    b_rate = P @ b - b @ P + of_b
    return np.stack([b_rate, P @ W - W @ P + J @ b - b @ J + of_q + product(s, of_b + 0 * b)]), P


def reference(s, x0, span, force=lambda b, q: (0.0, 0.0)):
    def field(t, y):
        return np.ascontiguousarray(field_of(s, y.view(complex).reshape(s.shape), force)[0]).view(float).ravel()

    y0 = np.ascontiguousarray(x0).view(float).ravel()
    end = solve_ivp(field, span, y0, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    return np.ascontiguousarray(end).view(complex).reshape(s.shape)


@pytest.mark.parametrize("span", [(0.5, 1.0), (1.0, 0.5)])
@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_members_follow_the_equations(name, span):
    s = FLOWS[name]
    x0 = np.stack([start_of(s, 1), start_of(s, 5)])
    sol = co.integrate(s, x0, span, 2.0**-6, SIXTH, save_every=32)
    for k in range(2):
        np.testing.assert_allclose(sol.x[-1, k], reference(s, x0[k], span), rtol=0, atol=1e-7)
        rates, P = field_of(s, x0[k])
        np.testing.assert_allclose(s.vector_field(x0[k]), rates, rtol=0, atol=1e-12)
        np.testing.assert_allclose(s.stream_of(x0[k])[0], P, rtol=0, atol=1e-12)
    assert np.abs(sol.x[-1] - x0).max() > 0.05


@pytest.mark.parametrize("span", [(1.0, 2.5), (2.5, 1.0)])
def test_on_the_torus_matrices_approach_the_continuous_flow(span):
    """Against products on a grid without aliases, whose brackets share nothing with matrices: an error of 1/N^2."""
    gamma, M = 2.0, 32
    n = np.fft.fftfreq(M) * M
    resolved = np.maximum(np.abs(n)[:, None], np.abs(n)) < M / 3
    ahead, across = 1j * n[:, None], 1j * n
    inverse = -1.0 * resolved / (n[:, None] ** 2 + n**2 + gamma)
    grid = 2 * np.pi * np.arange(M) / M
    eta, ridge = 0.4 * np.cos(grid)[:, None] + 0.0 * grid, 0.6 * np.cos(grid[:, None] + grid) + 0.4 * np.sin(2 * grid)

    def bracket(f, g):
        fx, fy, gx, gy = (np.fft.ifft2(k * np.fft.fft2(a)).real for a in (f, g) for k in (ahead, across))
        return np.fft.ifft2(resolved * np.fft.fft2(fx * gy - fy * gx)).real

    def field(t, y):
        b, q = y.reshape(2, M, M)
        psi = np.fft.ifft2(inverse * np.fft.fft2(q - eta)).real
        return -np.stack([bracket(psi, b), bracket(psi, q - b) + bracket(ridge, b) / 2]).ravel()

    def flow(N):
        s = S.thermal_qg(
            N,
            gamma,
            0.0,
            lambda x, y: 0.4 * np.cos(x),
            lambda x, y: 0.6 * np.cos(x + y) + 0.4 * np.sin(2 * y),
            surface="torus",
        )
        of = lambda values: s.fluid.from_grid(values, absolute=True)  # noqa: E731
        x, y = np.meshgrid(*s.fluid.grid(), indexing="ij")
        x0 = s.from_potential(np.stack([of(start(x, y)) for start in STARTS]))
        end = co.integrate(s, x0, span, 1.5 / 32, SIXTH, save_every=32).x[-1]
        return np.stack([s.fluid.to_grid(one, (M, M), absolute=True) for one in s.potential(end)])

    x, y = np.meshgrid(grid, grid, indexing="ij")
    y0 = np.stack([start(x, y) for start in STARTS]).ravel()
    wanted = solve_ivp(field, span, y0, method="DOP853", rtol=1e-9, atol=1e-9).y[:, -1].reshape(2, M, M)
    coarse, fine = flow(25), flow(49)
    assert np.abs(wanted.ravel() - y0).max() > 0.3
    errors = [np.abs(found - wanted).max() for found in (coarse, fine, fine + (fine - coarse) / ((49 / 25) ** 2 - 1))]
    assert errors[0] / errors[1] == pytest.approx((49 / 25) ** 2, rel=0.15) and errors[2] < 0.1 * errors[1] < 1e-3


def test_the_potential_vorticity_obeys_its_equation():
    """On the torus q_t + {psi, q - b} = -{h, b}/2, as in the literature."""
    s = FLOWS["torus"]
    x = start_of(s)
    b, q = s.potential(x)
    P, rates = s.stream_of(x)[0], s.vector_field(x)
    half = s.fluid.from_modes({(1, 1): 0.15, (0, 2): 0.1}, absolute=True)
    wanted = P @ (q - b) - (q - b) @ P + half @ b - b @ half
    np.testing.assert_allclose(rates[1] - rates[0], wanted, rtol=0, atol=1e-12)
    np.testing.assert_allclose(x[1], q + b, rtol=0, atol=1e-13)


@EACH
def test_fields_are_inverses_of_each_other(name):
    s = FLOWS[name]
    x = start_of(s)
    np.testing.assert_allclose(s.absolute(s.relative(x)), x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(s.from_potential(s.potential(x)), x, rtol=0, atol=1e-12)
    b, q = s.potential(x)
    np.testing.assert_allclose(x[1] - q, product(s, b), rtol=0, atol=1e-12)
    np.testing.assert_allclose(s.relative(x)[1], np.asarray(s.fluid.relative(q)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(s.stream_of(x)[0], s.fluid.stream_of(q), rtol=0, atol=1e-12)
    half = s.fluid.from_modes({(int(m), int(n)): c for m, n, c, _ in s.bathymetry}, absolute=True) / 2
    wanted = s.fluid.energy(q) - s.energy_unit * np.sum(np.conj(half) * b).real
    assert s.energy(x) == pytest.approx(wanted, rel=1e-12)


@EACH
def test_the_parameters_make_the_system_again(name):
    s = FLOWS[name]
    again = S.thermal_qg(**s.parameters)
    np.testing.assert_array_equal(again.vector_field(start_of(s)), s.vector_field(start_of(s)))


@EACH
def test_conversions_leave_what_they_are_given(name):
    s = FLOWS[name]
    x = start_of(s)
    for convert in (s.absolute, s.relative, s.potential, s.from_potential):
        given = x.copy()
        convert(given)
        assert given.tobytes() == x.tobytes()


@EACH
def test_casimirs_and_the_energy(name):
    s = FLOWS[name]
    x0, errors = start_of(s), []
    for h in (2.0**-5, 2.0**-6):
        sol = co.integrate(s, x0, (0, 2), h, co.IsospectralGauss(), save_every=4)
        drift = sol.drift()
        assert list(drift)[:4] == ["energy", "tr Theta^2", "tr W Theta", "tr Theta^3"]
        for casimir in s.casimirs:
            assert drift[casimir].absolute < 1e-12 * np.linalg.norm(x0, axis=(-2, -1)).max() ** 4, casimir
        errors.append(drift["energy"].absolute)
        for integral in s.integrals.values():
            assert np.ptp(integral(sol.x)) < 2e-12 * np.abs(s.fluid.scale * x0).max()
        np.testing.assert_allclose(np.diff(sol.energy), np.diff(s.energy(sol.x)), rtol=0, atol=1e-12)
    assert 1.7 < np.log2(errors[0] / errors[1]) < 2.3
    np.testing.assert_allclose(s.spectrum(sol.x[-1]), s.spectrum(x0), rtol=0, atol=1e-12)
    # the integral of q f(b), and not of q^2, is constant
    assert np.ptp(np.sum(np.abs(sol.x[:, 1]) ** 2, axis=(-2, -1))) > 1e-2
    assert bool(s.integrals) == (name == "of latitude")


@pytest.mark.parametrize(("mode", "is_zonal"), [((3, 0), True), ((3, 2), False)])
def test_ridges_across_the_latitudes_break_the_angular_momentum(mode, is_zonal):
    s = S.thermal_qg(9, 3.0, 1.5, {(2, 0): 0.1}, {mode: 0.4})
    assert bool(s.integrals) == is_zonal
    sol = co.integrate(s, start_of(s), (0, 1), 0.0625, co.IsospectralGauss())
    found = S.thermal_qg(9, 3.0, 1.5, {(2, 0): 0.1}).integrals["angular momentum z"](sol.x)
    assert (np.ptp(found) < 1e-11) == is_zonal


@EACH
def test_the_structure_matrix_takes_the_gradient_of_the_energy_to_the_motion(name):
    s = FLOWS[name]
    x = s.to_vector(start_of(s))
    J, gradient = s.structure_matrix(x), s.hamiltonian.gradient(x)
    np.testing.assert_allclose(J, -J.T, rtol=0, atol=1e-12 * np.abs(J).max())
    rates = s.to_vector(s.vector_field(s.from_vector(x)))
    np.testing.assert_allclose(J @ gradient, rates, rtol=0, atol=1e-12 * np.abs(rates).max())
    hessian = s.hamiltonian.hessian(x)
    np.testing.assert_allclose(hessian, hessian.T, rtol=0, atol=1e-12 * np.abs(hessian).max())
    d = s.to_vector(start_of(s, 7) - s.absolute(np.zeros(s.shape)))
    slope = (s.energy(x + 1e-4 * d) - s.energy(x - 1e-4 * d)) / 2e-4
    assert slope == pytest.approx(gradient @ d, rel=1e-8)


@pytest.mark.parametrize("stages", [1, 2])
@EACH
def test_compiled_steps_are_those_of_numpy(name, stages):
    s, method = FLOWS[name], co.IsospectralGauss(stages)
    x0 = start_of(s)
    end = co.integrate(s, x0, (0, 0.05), 0.05, method).x[-1]
    np.testing.assert_allclose(method.step(s, x0, 0.0, 0.05), end, rtol=0, atol=1e-12)


def test_gradients_of_runs():
    s = FLOWS["sphere"]
    x0, d = start_of(s), start_of(s, 9) - s.absolute(np.zeros(s.shape))
    ready = co.prepare(s, co.IsospectralGauss(), 0.02)
    _, pullback = ready.vjp(x0, (0.0, 0.1))
    weights = np.random.default_rng(2).standard_normal((6, *s.shape))
    found = np.sum(np.conj(pullback(x=weights)["x0"]) * d).real

    def value(x):
        return np.sum(weights * ready.run(x, (0.0, 0.1)).x.real)

    assert found == pytest.approx((value(x0 + 1e-4 * d) - value(x0 - 1e-4 * d)) / 2e-4, rel=1e-6)


@pytest.mark.parametrize("depth", [0.8, -8.0])
def test_thermal_rossby_waves(depth):
    """About b = B mu over h = depth mu the degree l, order m: waves, or growth by its sign."""
    B, Omega, gamma, l, m, small = 0.5, 0.4, 3.0, 3, 2, 1e-6
    unit = np.sqrt(4 * np.pi / 3)
    s = S.thermal_qg(9, gamma, Omega, None, {(1, 0): depth * unit})
    fluid = s.fluid
    b0 = fluid.from_modes({(1, 0): B * unit}, absolute=True)
    rest = s.from_potential([b0, fluid.planetary])
    np.testing.assert_allclose(s.vector_field(rest), 0.0, rtol=0, atol=1e-14)
    # b_t = -B psi_phi, q_t = -2 Omega psi_phi + (depth/2) b_phi, with psi = -q/(l (l + 1) + gamma)
    lam = l * (l + 1) + gamma
    M = 1j * m * np.array([[0.0, B / lam], [depth / 2, 2 * Omega / lam]])
    assert (np.linalg.eigvals(M).real.max() > 0.1) == (depth < 0)
    start = small * np.array([1.0, 0.5 - 0.3j])
    change = np.stack([fluid.from_modes({(l, m): c}, absolute=True) for c in start])
    x0 = s.from_potential(np.stack([b0, fluid.planetary]) + change)
    sol = co.integrate(s, x0, (0, 4), 1 / 64, SIXTH, save_every=64)
    fields = s.potential(sol.x) - np.stack([b0, fluid.planetary])
    found = fluid.mode_array(fields, absolute=True)[:, :, l, m]
    wanted = np.stack([expm(t * M) @ start for t in sol.t])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-4 * np.abs(wanted).max())


@EACH
def test_without_buoyancy_it_is_the_quasi_geostrophic_flow(name):
    s = FLOWS[name]
    q = np.asarray(start_of(s)[1])
    still = np.stack([0 * q, q])
    both = co.integrate(s, still, (0, 1), 0.0625, co.IsospectralGauss(2)).x[-1]
    alone = co.integrate(s.fluid, q, (0, 1), 0.0625, co.IsospectralGauss(2)).x[-1]
    np.testing.assert_allclose(both[1], alone, rtol=0, atol=1e-13)
    assert np.array_equal(both[0], 0 * q)


def test_units_of_any_size():
    def scaled(size):
        return S.thermal_qg(9, 3.0, 1.5 * size, None, {(3, 2): 0.4 * size})

    x0 = start_of(scaled(1.0))
    end = co.integrate(scaled(1.0), x0, (0, 1), 1 / 32, SIXTH).x[-1]
    for size in (1e-7, 1e30):
        fast = co.integrate(scaled(size), size * x0, (0, 1 / size), 1 / (32 * size), SIXTH).x[-1]
        np.testing.assert_allclose(fast / size, end, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_forces_act_on_the_potential_vorticity_and_on_the_buoyancy(name):
    s, some = FLOWS[name], co.forces
    x0, fluid = start_of(s), s.fluid
    forces = [some.Friction(0.4), some.Viscosity(0.01, 1, True), some.Viscosity(0.03, layer="carried")]
    forces += [some.BetaPlane(1.3)] * (name == "torus")
    forced = s.with_forces(*forces)

    def force(b, q):
        V = fluid.mode_array(q - fluid.planetary, absolute=True)
        rates = 0.4 + 0.01 * fluid.eigenvalues + 0j
        if name == "torus":
            n = np.fft.fftfreq(9, 1 / 9)[:, None]
            rates -= 1j * 1.3 * n / (fluid.eigenvalues + 2.0)
        carried = fluid.from_modes(-0.03 * fluid.eigenvalues * fluid.mode_array(b, absolute=True), absolute=True)
        return carried, fluid.from_modes(-rates * V, absolute=True)

    sol = co.integrate(forced, x0, (0.5, 1.0), 2.0**-8, SIXTH, save_every=64)
    np.testing.assert_allclose(sol.x[-1], reference(s, x0, (0.5, 1.0), force), rtol=0, atol=2e-5)
    assert max(sol.balance().values()) < 1e-5
    for one in forces:
        x = s.to_vector(x0)
        slope = s.from_vector(one.flow(s, x, 0.0, 1e-6) - x) / 1e-6
        step = co.methods.Forced(SIXTH).step(s.with_forces(one), x0, 0.0, 0.0625)
        np.testing.assert_allclose(
            co.integrate(s.with_forces(one), x0, (0, 0.0625), 0.0625, SIXTH).x[-1], step, rtol=0, atol=1e-13
        )
        np.testing.assert_allclose(slope, s.from_vector(one.field(s, x, 0.0)), rtol=0, atol=1e-4)


def test_other_forces():
    s, some = FLOWS["sphere"], co.forces
    x0 = start_of(s)
    carried = co.integrate(
        s.with_forces(some.TransportNoise((1, 2), 0.3, seed=4)), x0, (0, 1), 0.0625, co.IsospectralGauss()
    )
    assert max(carried.balance()[name] for name in s.casimirs) < 1e-11
    damped = co.integrate(s.with_forces(some.DoubleBracketDamping(0.1)), x0, (0, 1), 0.0625, co.IsospectralGauss())
    assert np.all(np.diff(damped.energy) < 0.0)
    np.testing.assert_allclose(s.spectrum(damped.x[-1]), s.spectrum(x0), rtol=0, atol=1e-12)
    noisy = s.with_forces(some.RandomForcing(0.5, (2, 3), seed=3))
    still = np.broadcast_to(s.absolute(np.zeros(s.shape)), (400, *s.shape))
    grown = co.integrate(noisy, still, (0, 1), 0.5, co.IsospectralGauss())
    assert abs(s.energy(grown.x[-1]).mean() - 0.5) < 4 * 0.5 * np.sqrt(2 / 12 / 400)
    for force, named in (
        (some.LinearDamping(0.1), ("Friction",)),
        (some.SelectiveDecay(0.1), ("passive_scalar",)),
        (some.RandomForcing(0.5, (2, 3), seed=3, layer="carried"), ("carried", "no energy")),
        (some.Friction(0.1, layer=1), ("layer is 1",)),
    ):
        with refused(ValueError, "thermal_qg", *named):
            s.with_forces(force)


@pytest.mark.parametrize("name", ["sphere", "torus"])
def test_files_datasets_and_pictures(name, tmp_path):
    s = FLOWS[name]
    x0 = start_of(s)
    whole = co.integrate(s, x0, (0, 1), 0.0625, co.IsospectralGauss(), archive=tmp_path / "whole.zarr")
    part = co.integrate(s, x0, (0, 0.5), 0.0625, co.IsospectralGauss(), archive=tmp_path / "part.zarr")
    assert np.array_equal(part.x[-1], whole.x[8])
    again = co.load(tmp_path / "whole.zarr")
    assert np.array_equal(again.x, whole.x) and again.system.parameters == s.parameters
    np.testing.assert_array_equal(again.system.vector_field(x0), s.vector_field(x0))
    fields, fluid = whole.to_xarray(grid=True).isel(time=-1), s.fluid
    last = whole.x[-1]
    b, W = (fluid.from_grid(fields[key].values, absolute=True) for key in ("buoyancy", "vorticity"))
    np.testing.assert_allclose(s.absolute(np.stack([b, W])), last, rtol=0, atol=1e-11)
    q = fluid.from_grid(fields.potential_vorticity.values, absolute=True)
    np.testing.assert_allclose(s.from_potential([b, q]), last, rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        fields.isel().stream_function, fluid.to_grid(s.stream_of(last)[0], absolute=True), atol=1e-12
    )
    velocities = [name for name in fields if name.endswith("_velocity")]
    wanted = fluid.velocity(s.fluid_state(last), fields.vorticity.shape)
    for key, component in zip(velocities, wanted, strict=True):
        np.testing.assert_allclose(fields[key], component, rtol=0, atol=1e-12)
    for options in ({}, {"part": "carried"}, {"part": "potential"}, {"part": "stream"}, {"part": "large"}):
        whole.plot([co.plotting.Picture("vorticity", **options)])
    energies = fluid.energy_spectrum(s.fluid_state(last))[1]
    assert energies.sum() < fluid.energy(s.fluid_state(last)) * (1 + 1e-12)
    whole.plot()


def test_what_is_refused():
    cases = [
        (dict(surface="torus", N=9, rotation=1.0), ("torus", "rotation")),
        (dict(surface="torus", N=9, lamb=1.0), ("torus", "lamb")),
        (dict(surface="torus", N=8), ("N", "odd")),
        (dict(gamma=-1.0), ("gamma", "-1")),
        (dict(bathymetry=np.zeros((3, 5))), ("bathymetry", "(3, 5)", "coordinates")),
        (dict(bathymetry={(9, 0): 1.0}), ("9",)),
        (dict(bathymetry=lambda latitude: latitude), ("bathymetry", "two arrays")),
        (dict(surface="plane"), ("surface", "plane")),
    ]  # fmt: skip
    for arguments, named in cases:
        with refused((ValueError, TypeError), *named):
            S.thermal_qg(**{"N": 8, **arguments})
    s = FLOWS["sphere"]
    with refused(ValueError, "(9, 9)", "(2, 9, 9)", "buoyancy"):
        co.integrate(s, s.fluid.random(1), (0, 1), 0.1, co.IsospectralGauss())
    with pytest.warns(UserWarning, match="bathymetry has the mean"):
        S.thermal_qg(8, bathymetry=lambda latitude, longitude: 1.0 + np.sin(latitude))
    with refused(TypeError, "thermal_qg"):
        co.equilibrium(s, start_of(s))


@pytest.mark.parametrize("s", [*FLOWS.values(), S.passive_scalar(9, rotation=0.5)], ids=[*FLOWS, "dye"])
def test_a_state_of_the_fluid_is_no_relative_vorticity(s):
    b, W = s.fluid.random(seed=1), s.fluid.random(seed=2)
    found = s.absolute([b, s.fluid.relative(W)])
    np.testing.assert_allclose(s.fluid_state(found), W, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match=r"give fluid\.relative"):
        s.absolute([b, W])
