"""Quasi-geostrophic flow in layers: waves and instability in closed form, invariants, forces, files and pictures."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.special import pro_cv

import coadjoint as co
from refusals import refused

S = co.systems
GAMMA, THICK = np.array([[6.0, -6.0, 0.0], [-3.0, 5.0, -2.0], [0.0, -1.0, 2.0]]), (1.0, 2.0, 4.0)
FLOWS = {
    "three layers": S.layered_qg(9, GAMMA, THICK, rotation=1.5),
    "two layers": S.layered_qg(9, [[3.0, -3.0], [-1.0, 1.0]], (1.0, 3.0), rotation=-0.5),
    "of latitude": S.layered_qg(9, np.zeros((2, 2)), (2.0, 1.0), [[3.0, -2.0], [-4.0, 4.5]], 2.0),
    "torus": S.layered_qg(9, [[3.0, -3.0], [-1.0, 1.0]], (1.0, 3.0), surface="torus"),
}
EACH = pytest.mark.parametrize("name", FLOWS)
SIXTH = co.IsospectralGauss(3)


def start_of(s, seed=1):
    """Return a random state, of other flows in each layer."""
    return s.absolute([s.fluid.random(seed=seed + k, degrees=(1, 4)) for k in range(s.shape[0])])


def solved(s, q):
    """Return the stream functions of potential vorticities, mode by mode."""
    fluid = s.fluid
    modes = fluid.mode_array(q - s.planetary, absolute=True)
    eigenvalues = np.where(fluid.eigenvalues > 0.0, fluid.eigenvalues, 1.0)
    matrices = eigenvalues[..., None, None] * np.eye(s.shape[0]) + s.gamma
    psi = -np.linalg.solve(matrices, np.moveaxis(modes, 0, -1)[..., None])
    psi = np.where((fluid.degrees > 0)[..., None], psi[..., 0], 0.0)
    return fluid.from_modes(np.moveaxis(psi, -1, 0), absolute=True)


def reference(s, x0, span, force=lambda q, P: 0.0):
    """Return the end of the motion by the commutators of `solved`, by DOP853."""

    def field(t, y):
        q = y.view(complex).reshape(s.shape)
        P = solved(s, q)
        return np.ascontiguousarray(P @ q - q @ P + force(q, P)).view(float).ravel()

    end = solve_ivp(field, span, x0.view(float).ravel(), method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    return np.ascontiguousarray(end).view(complex).reshape(s.shape)


@pytest.mark.parametrize("span", [(1.0, 4.0), (4.0, 1.0)])
@pytest.mark.parametrize("n", [(1, 2), (3, 0), (-2, 1), (0, 2)])
@pytest.mark.parametrize("mode", [0, 1])
def test_on_a_beta_plane_each_vertical_mode_has_its_waves(mode, n, span):
    """Barotropic and baroclinic waves of two layers, with the coupling 4: sigma = -beta k/(K^2 + F)."""
    s, beta = FLOWS["torus"], 1.7
    q = np.array([[1.0, 1.0], [1.0, -1.0 / 3.0]])[mode]  # shapes of psi, and so of q: F1 = 3, F2 = 1
    x0 = q[:, None, None] * s.fluid.from_modes({n: 0.4 + 0.3j})
    sol = co.integrate(s.with_forces(co.forces.BetaPlane(beta)), x0, span, 0.25, co.IsospectralGauss())
    for x, t in zip(sol.x, sol.t, strict=True):
        turned = np.exp(1j * beta * n[0] / (n[0] ** 2 + n[1] ** 2 + 4.0 * mode) * (t - span[0]))
        modes = np.array([s.fluid.modes(layer, absolute=True)[n] for layer in x])
        np.testing.assert_allclose(modes, q * (0.4 + 0.3j) * turned, rtol=0, atol=1e-13)
    assert np.abs(sol.work["BetaPlane"]["energy"]).max() < 1e-13 * abs(sol.energy[0])


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("span", [(1.0, 1.5), (1.5, 1.0)])
def test_on_a_beta_plane_layers_follow_the_equations(span, first):
    """Beside the drag of the lower layer, in both orders; and member by member, with one thread and two."""
    s, beta, rate = FLOWS["torus"], 1.7, 0.3
    fluid, some = s.fluid, co.forces
    forces = [some.Friction(rate, layer=1), some.BetaPlane(beta)]
    forced = s.with_forces(*forces[:: -1 if first else 1])
    n1 = (np.fft.fftfreq(9) * 9)[:, None]

    def force(q, P):
        psi = fluid.mode_array(P, absolute=True)
        drag = np.array([0.0, rate])[:, None, None] * fluid.eigenvalues * psi
        return fluid.from_modes(drag - 1j * beta * n1 * psi, absolute=True)

    x0 = np.stack([start_of(s, 1), start_of(s, 5)])
    sols = [
        co.prepare(forced, SIXTH, 2.0**-7, threads=threads).run(x0, span, save_every=64).x[-1] for threads in (1, 2)
    ]
    # The splitting of forces has order two.
    half = co.prepare(forced, SIXTH, 2.0**-8).run(x0, span, save_every=128).x[-1]
    np.testing.assert_array_equal(*sols)
    for k in range(2):
        np.testing.assert_allclose((4 * half - sols[0])[k] / 3, reference(s, x0[k], span, force), rtol=0, atol=1e-7)


@pytest.mark.parametrize("span", [(0.5, 1.0), (1.0, 0.5)])
@pytest.mark.parametrize("name", [name for name in FLOWS if name != "of latitude"])
def test_members_follow_the_equations(name, span):
    s = FLOWS[name]
    x0 = np.stack([start_of(s, 1), start_of(s, 5)])
    sol = co.integrate(s, x0, span, 2.0**-6, SIXTH, save_every=32)
    for k in range(2):
        np.testing.assert_allclose(sol.x[-1, k], reference(s, x0[k], span), rtol=0, atol=1e-7)
        np.testing.assert_allclose(s.stream_of(x0[k]), solved(s, x0[k]), rtol=0, atol=1e-12)


@EACH
def test_fields_are_inverses_of_each_other(name):
    """q is the Laplacian of psi without the coupling, where this is constant."""
    s = FLOWS[name]
    x = start_of(s)
    P, W = s.stream_of(x), s.relative(x)
    for again in (s.absolute(W), s.from_stream(P)):
        np.testing.assert_allclose(again, x, rtol=0, atol=1e-12)
    laplacian = s.fluid.from_modes(-s.fluid.eigenvalues * s.fluid.mode_array(P, absolute=True), absolute=True)
    np.testing.assert_allclose(W, laplacian, rtol=0, atol=1e-11)
    if name != "of latitude":
        q = laplacian - np.einsum("kj,jab->kab", s.gamma, P) + s.planetary
        np.testing.assert_allclose(q, x, rtol=0, atol=1e-11)
    kinetic = s.thicknesses @ s.fluid.energy_spectrum(W)[1].sum(axis=-1)
    coupled = 0.5 * s.energy_unit * np.einsum("k,kab,kj,jab->", s.thicknesses, P.conj(), s.gamma, P).real
    if name != "of latitude":
        assert s.energy(x) == pytest.approx(kinetic + coupled, rel=1e-12)


@EACH
def test_casimirs_of_every_layer_and_the_energy(name):
    s = FLOWS[name]
    x0, errors = start_of(s), []
    for h in (2.0**-5, 2.0**-6):
        sol = co.integrate(s, x0, (0, 2), h, co.IsospectralGauss(), save_every=4)
        drift = sol.drift()
        for casimir in s.casimirs:
            size = np.linalg.norm(x0, axis=(-2, -1)).max() ** int(casimir[5])
            assert drift[casimir].absolute < 1e-13 * size, casimir
        errors.append(drift["energy"].absolute)
        for integral in s.integrals.values():
            assert np.ptp(integral(sol.x)) < 2e-13 * np.abs(s.fluid.scale * x0).max()
    assert 1.7 < np.log2(errors[0] / errors[1]) < 2.3
    assert np.abs(sol.x[-1] - x0).max() > 0.1 * np.abs(x0).max()
    np.testing.assert_allclose(s.spectrum(sol.x[-1]), s.spectrum(x0), rtol=0, atol=1e-12)


@EACH
def test_the_structure_matrix_takes_the_gradient_of_the_energy_to_the_motion(name):
    """Also where the thicknesses of the layers weigh the energy."""
    s = FLOWS[name]
    x = s.to_vector(start_of(s))
    J, gradient = s.structure_matrix(x), s.hamiltonian.gradient(x)
    np.testing.assert_allclose(J, -J.T, rtol=0, atol=1e-12 * np.abs(J).max())
    rates = s.to_vector(s.vector_field(start_of(s)))
    np.testing.assert_allclose(J @ gradient, rates, rtol=0, atol=1e-12 * np.abs(rates).max())
    for casimir in s.casimirs.values():
        slope = casimir.gradient(x)
        assert np.abs(J @ slope).max() < 1e-12 * np.abs(J).max() * max(1.0, np.abs(slope).max())


@pytest.mark.parametrize("name", ["three layers", "two layers", "of latitude"])
def test_angular_momentum_of_the_frame_and_the_flow(name):
    """The integral of mu times the potential vorticity q, which at rest is 2 rotation mu in every layer."""
    s = FLOWS[name]
    momentum, thickness = s.integrals["angular momentum z"], s.thicknesses.sum()
    at_rest = 2 * s.rotation * 4 * np.pi / 3 * thickness
    np.testing.assert_allclose(momentum(s.planetary), at_rest, rtol=1e-12)
    wave = s.fluid.from_modes(s.fluid.mode_array(s.planetary[0], absolute=True) / (2 * s.rotation), absolute=True)
    for k, H in enumerate(s.thicknesses):
        x = s.planetary.copy()
        x[k] += 0.3 * wave  # of vorticity 0.3 mu
        np.testing.assert_allclose(momentum(x), at_rest + 0.3 * 4 * np.pi / 3 * H, rtol=1e-12)


@pytest.mark.parametrize("stages", [1, 2])
@EACH
def test_compiled_steps_are_those_of_numpy(name, stages):
    s, method = FLOWS[name], co.IsospectralGauss(stages)
    x0 = start_of(s)
    end = co.integrate(s, x0, (0, 0.05), 0.05, method).x[-1]
    np.testing.assert_allclose(method.step(s, x0, 0.0, 0.05), end, rtol=0, atol=1e-12)
    free = co.integrate(s, x0, (0, 0.05), 0.0125, co.CommutatorFree(4)).x[-1]
    np.testing.assert_allclose(free, co.integrate(s, x0, (0, 0.05), 0.0125, SIXTH).x[-1], rtol=0, atol=1e-5)


def test_gradients_of_runs():
    s = FLOWS["three layers"]
    x0, d = start_of(s), start_of(s, 9) - s.planetary
    ready = co.prepare(s, co.IsospectralGauss(), 0.02)
    _, pullback = ready.vjp(x0, (0.0, 0.1))
    weights = np.random.default_rng(2).standard_normal((6, *s.shape))
    found = np.sum(np.conj(pullback(x=weights)["x0"]) * d).real

    def value(x):
        return np.sum(weights * ready.run(x, (0.0, 0.1)).x.real)

    h = 1e-4
    assert found == pytest.approx((value(x0 + h * d) - value(x0 - h * d)) / (2 * h), rel=1e-6)


def test_rossby_waves_of_each_vertical_mode():
    """Barotropic and baroclinic ones are exact solutions, which turn by -2 Omega/(l(l + 1) + gamma)."""
    F = (3.0, 1.0)
    s = S.layered_qg(12, [[F[0], -F[0]], [-F[1], F[1]]], (F[1], F[0]), rotation=2.0)
    for mode, gamma in enumerate((0.0, sum(F))):
        c = s.rossby_speed(4, 3, mode)
        assert c == pytest.approx(-4.0 / (20.0 + gamma), rel=1e-12)
        x0 = s.rossby_wave(4, 3, mode, wave=2.0, longitude=0.3)
        sol = co.integrate(s, x0, (0, 1), 1 / 32, SIXTH, save_every=32)
        turned = s.rossby_wave(4, 3, mode, wave=2.0, longitude=0.3 + c)
        np.testing.assert_allclose(sol.x[-1], turned, rtol=0, atol=1e-7)
        top = np.sqrt(2 * s.fluid.enstrophy_spectrum(s.relative(x0))[1].sum(axis=-1) / s.fluid.area)
        assert top.max() == pytest.approx(2.0, rel=1e-12)
    np.testing.assert_allclose(s.modes[2], [[1.0, 1.0], [1.0, -1 / 3]], rtol=0, atol=1e-12)


def test_waves_where_the_coupling_depends_on_the_latitude():
    s = S.layered_qg(64, np.zeros((2, 2)), None, [[40.0, -40.0], [-40.0, 40.0]], 1.0)
    assert s.rossby_speed(5, 4, 1) == pytest.approx(-2 / pro_cv(4, 5, np.sqrt(80.0)), rel=1e-4)
    assert s.rossby_speed(5, 4, 0) == pytest.approx(-2 / 30.0, rel=1e-12)


def test_baroclinic_instability_grows_by_the_rate_of_phillips():
    """Two layers in solid rotations of their own: of each harmonic the linear equations of two numbers."""
    omega, Omega, F, l, m = np.array([0.6, -0.4]), 0.25, np.array([12.0, 6.0]), 3, 2
    gamma = np.array([[F[0], -F[0]], [-F[1], F[1]]])
    s = S.layered_qg(8, gamma, 1 / F, rotation=Omega)
    solid = [s.fluid.from_modes({(1, 0): 2 * w * np.sqrt(4 * np.pi / 3)}) for w in omega]
    # q = B mu of the currents, and q_t + omega q_phi + B psi_phi = 0
    B = 2 * omega + gamma @ omega + 2 * Omega
    M = -1j * m * (np.diag(omega) - np.diag(B) @ np.linalg.inv(l * (l + 1) * np.eye(2) + gamma))
    rate = np.linalg.eigvals(M).real.max()
    assert rate > 0.2
    small = 1e-6 * np.array([1.0, 0.5 - 0.3j])
    current = s.absolute(solid)
    x0 = current + np.stack([s.fluid.from_modes({(l, m): c}) for c in small])
    sol = co.integrate(s, x0, (0, 16), 1 / 32, SIXTH, save_every=64)
    found = s.fluid.mode_array(sol.x - s.planetary)[:, :, l, m]
    wanted = np.stack([expm(t * M) @ small for t in sol.t])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-3 * np.abs(wanted).max())
    grown = np.abs(found[-1, 0] / found[-2, 0])
    assert np.log(grown) / (sol.t[-1] - sol.t[-2]) == pytest.approx(rate, rel=1e-2)
    steady = co.integrate(s, current, (0, 1), 1 / 32, SIXTH).x[-1]
    np.testing.assert_allclose(steady, current, rtol=0, atol=1e-12)


def test_layers_without_coupling_and_layers_that_move_alike():
    apart, tied = S.layered_qg(10, np.zeros((2, 2)), rotation=1.0), S.layered_qg(10, rotation=1.0)
    sphere = S.sphere_euler(10, 1.0)
    W = [sphere.random(seed=k) for k in (1, 2)]
    alone = [co.integrate(sphere, one, (0, 1), 1 / 64, co.IsospectralGauss(2)).x[-1] for one in W]
    both = co.integrate(apart, np.stack(W), (0, 1), 1 / 64, co.IsospectralGauss(2)).x[-1]
    np.testing.assert_allclose(both, alone, rtol=0, atol=1e-12)
    same = co.integrate(tied, np.stack([W[0], W[0]]), (0, 1), 1 / 64, co.IsospectralGauss(2)).x[-1]
    np.testing.assert_allclose(same, [alone[0]] * 2, rtol=0, atol=1e-12)


def test_units_of_any_size():
    """Thicknesses multiply the energy alone, and vorticities the rate of time."""
    s, scaled = (S.layered_qg(8, [[2.0, -2.0], [-1.0, 1.0]], size * np.array([1.0, 2.0])) for size in (1.0, 1e30))
    x0 = start_of(s)
    assert scaled.energy(x0) == pytest.approx(1e30 * s.energy(x0), rel=1e-14)
    end = co.integrate(s, x0, (0, 1), 1 / 32, SIXTH).x[-1]
    np.testing.assert_allclose(co.integrate(scaled, x0, (0, 1), 1 / 32, SIXTH).x[-1], end, rtol=0, atol=1e-12)
    for size in (1e-7, 1e30):
        fast = co.integrate(s, size * x0, (0, 1 / size), 1 / (32 * size), SIXTH).x[-1]
        np.testing.assert_allclose(fast / size, end, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", ["three layers", "torus"])
def test_friction_and_viscosity_of_all_layers(name):
    s = FLOWS[name]
    x0, rest = start_of(s), s.absolute(np.zeros(s.shape))
    forced = s.with_forces(co.forces.Friction(0.4), co.forces.Viscosity(0.01, rotation=True))

    def force(q, P):
        V = q - rest
        decay = [s.fluid.from_modes(0.01 * s.fluid.eigenvalues * s.fluid.mode_array(W), absolute=True) for W in V]
        return -0.4 * V - np.array(decay)

    sol = co.integrate(forced, x0, (0, 0.5), 2.0**-8, SIXTH, save_every=64)
    np.testing.assert_allclose(sol.x[-1], reference(s, x0, (0, 0.5), force), rtol=0, atol=1e-5)
    assert sol.balance()["energy"] < 1e-5
    assert all(sol.balance()[f"tr W^2 [{layer + 1}]"] < 1e-5 for layer in range(s.shape[0]))


def test_drag_lowers_the_energy_of_layers_that_rest_beside_a_moving_one():
    s = co.systems.layered_qg(9, [[12.0, -12.0], [-4.0, 4.0]], thicknesses=(1.0, 3.0))
    moving = np.stack([s.fluid.random(seed=1), np.zeros((9, 9))])
    x0 = s.absolute(moving)
    for force in (co.forces.Friction(0.3), co.forces.Viscosity(0.05)):
        sol = co.integrate(s.with_forces(force), x0, (0, 10), 0.05, co.IsospectralGauss(), save_every=10)
        assert np.all(np.diff(sol.energy) < 0.0)
    # With the same rate for all scales and layers the energy falls by exp(-2 rate t), whatever flows.
    sol = co.integrate(s.with_forces(co.forces.Friction(0.3)), x0, (0, 2), 0.02, co.IsospectralGauss())
    assert sol.energy[-1] / sol.energy[0] == pytest.approx(np.exp(-1.2), rel=1e-3)


def relative_vorticities(s, q):
    """Return the relative vorticities of `solved`, mode by mode."""
    return s.fluid.from_modes(-s.fluid.eigenvalues * s.fluid.mode_array(solved(s, q), absolute=True), absolute=True)


@pytest.mark.parametrize("span", [(0.5, 1.0), (1.0, 0.75)])
@pytest.mark.parametrize("name", ["three layers", "torus"])
def test_drag_of_one_layer_acts_on_its_relative_vorticity(name, span):
    s = FLOWS[name]
    k, x0 = s.shape[0] - 1, np.stack([start_of(s, 1), start_of(s, 5)])
    drag, viscosity = co.forces.Friction(lambda l: 0.1 + 0.2 * l, layer=k), co.forces.Viscosity(0.01, 1, True, layer=0)
    forced, rest = s.with_forces(drag, viscosity), s.absolute(np.zeros(s.shape))

    def force(q, P):
        fluid, zeta, change = s.fluid, relative_vorticities(s, q), np.zeros_like(q)
        scales = np.sqrt(fluid.eigenvalues) if name == "torus" else fluid.degrees
        for layer, rates in ((k, 0.1 + 0.2 * scales), (0, 0.01 * fluid.eigenvalues)):
            change[layer] -= fluid.from_modes(rates * fluid.mode_array(zeta[layer], absolute=True), absolute=True)
        return change

    sol = co.integrate(forced, x0, span, 2.0**-8, SIXTH, save_every=64)
    for m in range(2):
        np.testing.assert_allclose(sol.x[-1, m], reference(s, x0[m], span, force), rtol=0, atol=3e-5)
    for one in (drag, viscosity):  # the flow alone, exact, and its derivative
        flow = one.flow(s, s.to_vector(x0[0]), 0.0, 0.7)
        np.testing.assert_allclose(
            one.flow(s, one.flow(s, s.to_vector(x0[0]), 0.0, 0.3), 0.0, 0.4), flow, rtol=0, atol=1e-12
        )
        untouched = np.delete(s.from_vector(flow) - x0[0], one.layer, axis=0)
        assert np.array_equal(untouched, np.zeros_like(untouched))
        slope = s.from_vector(one.field(s, s.to_vector(x0[0]), 0.0))
        alone = force(x0[0], None)[one.layer]
        np.testing.assert_allclose(slope[one.layer], alone, rtol=0, atol=1e-11)
    assert sol.balance()["energy"] < 1e-5
    np.testing.assert_allclose(
        co.integrate(forced, rest, (0, 1), 0.25, SIXTH).x[-1], rest, rtol=0, atol=1e-14 + 1e-14 * np.abs(rest).max()
    )


def test_viscosity_of_one_layer_keeps_solid_rotations_unless_told_otherwise():
    """Layers that rotate about the axis of the sphere at their own rates are steady, also in compiled steps."""
    s = FLOWS["three layers"]
    x0 = s.absolute([s.fluid.from_modes({(1, 0): c}) for c in (0.5, -0.2, 0.3)])
    for rotation in (False, True):
        forced = s.with_forces(co.forces.Viscosity(0.1, rotation=rotation, layer=2))
        change = co.integrate(forced, x0, (0, 1), 0.25, co.IsospectralGauss()).x[-1] - x0
        slope = s.from_vector(forced.forces[0].field(s, s.to_vector(x0), 0.0))
        for found in (change, slope):
            assert np.abs(found[:2]).max() < 1e-13
            assert (np.abs(found[2]).max() > 1e-2) if rotation else (np.abs(found[2]).max() < 1e-13)


def test_drag_of_the_lowest_layer_always_lowers_the_energy(tmp_path):
    """By H_k r times the integral of its |u_k|^2; steps of the flow of the force alone are exact."""
    s = FLOWS["two layers"]
    x0 = start_of(s)
    drag = s.with_forces(co.forces.Friction(0.7, layer=1))
    sol = co.integrate(drag, x0, (0, 20), 0.05, co.IsospectralGauss(), save_every=4, archive=tmp_path / "run.zarr")
    assert np.all(np.diff(sol.energy) < 0.0)
    kinetic = s.fluid.energy_spectrum(s.relative(sol.x))[1].sum(axis=-1)
    lost = -2 * 0.7 * s.thicknesses[1] * kinetic[:, 1]
    middle = (sol.energy[2:] - sol.energy[:-2]) / (sol.t[2:] - sol.t[:-2])
    np.testing.assert_allclose(middle, lost[1:-1], rtol=0, atol=2e-2 * np.abs(lost).max())
    np.testing.assert_allclose(np.linalg.eigvalsh(1j * sol.x[-1, 0]), np.linalg.eigvalsh(1j * x0[0]), atol=1e-12)
    again = co.load(tmp_path / "run.zarr")
    assert np.array_equal(again.x, sol.x)
    assert again.system.forces[0].layer == 1
    for size in (1e-7, 1e30):
        forced = s.with_forces(co.forces.Friction(0.7 * size, layer=1))
        moving = s.planetary + (x0 - s.planetary)
        fast = co.integrate(
            S.layered_qg(9, s.gamma, s.thicknesses, rotation=size * s.rotation).with_forces(*forced.forces),
            size * moving, (0, 1 / size), 0.05 / size, co.IsospectralGauss(),
        )  # fmt: skip
        np.testing.assert_allclose(fast.x[-1] / size, sol.x[5], rtol=0, atol=1e-10)


def test_bottom_drag_in_the_instability_of_phillips():
    """Two layers in solid rotations of their own, kept against the drag of the lower one by a torque."""
    omega, Omega, F, l, m, r = np.array([0.6, 0.0]), 0.25, np.array([12.0, 6.0]), 3, 2, 0.3
    gamma = np.array([[F[0], -F[0]], [-F[1], F[1]]])
    s = S.layered_qg(8, gamma, 1 / F, rotation=Omega)
    current = s.absolute([s.fluid.from_modes({(1, 0): 2 * w * np.sqrt(4 * np.pi / 3)}) for w in omega])
    B = 2 * omega + gamma @ omega + 2 * Omega
    inverse = np.linalg.inv(l * (l + 1) * np.eye(2) + gamma)  # psi = -inverse q
    drag = np.diag([0.0, r]) * l * (l + 1) @ inverse
    M = -1j * m * (np.diag(omega) - np.diag(B) @ inverse) - drag
    assert np.abs(np.linalg.eigvals(M).real).max() > 0.1
    small = 1e-6 * np.array([1.0, 0.5 - 0.3j])
    x0 = current + np.stack([s.fluid.from_modes({(l, m): c}) for c in small])
    forced = s.with_forces(co.forces.Friction(r, layer=1))
    sol = co.integrate(forced, x0, (0, 8), 1 / 128, SIXTH, save_every=128)
    found = s.fluid.mode_array(sol.x - s.planetary)[:, :, l, m]
    wanted = np.stack([expm(t * M) @ small for t in sol.t])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-3 * np.abs(wanted).max())


@pytest.mark.filterwarnings("ignore:the step")  # of the smallest eddies
def test_a_heated_current_over_a_rough_bottom_becomes_statistically_steady():
    """Relaxed to an unstable current, with bottom drag: the energies of later halves agree, and eddies remain."""
    F = 20.0
    s = S.layered_qg(12, [[F, -F], [-F, F]], rotation=1.0)
    current = s.absolute([s.fluid.from_modes({(1, 0): 2.5}), np.zeros((12, 12))])
    x0 = current + 0.05 * (start_of(s, 3) - s.planetary)
    damped = s.with_forces(
        co.forces.LinearDamping(0.1, toward=current),
        co.forces.Friction(0.5, layer=1),
        co.forces.Viscosity(1e-7, power=4),
    )
    sol = co.integrate(damped, x0, (0, 300), 0.05, co.IsospectralGauss(), save_every=20)
    V = s.fluid.mode_array(s.relative(sol.x), absolute=True)
    eddies = np.sum(np.abs(V[..., 1:]) ** 2, axis=(1, 2, 3))
    early, late = eddies[100:200], eddies[200:300]
    assert eddies[-1] > 0.05 * np.sum(np.abs(V[0, ..., 0]) ** 2)
    assert early.mean() == pytest.approx(late.mean(), rel=0.3)
    assert sol.energy[100:].max() < 2.0 * sol.energy[100:].mean()


def test_random_forcing_of_a_layer_has_its_rate_of_energy():
    s = FLOWS["three layers"]
    forced = s.with_forces(co.forces.RandomForcing(0.5, (2, 3), seed=3, layer=1))
    still = np.broadcast_to(s.planetary, (400, *s.shape))
    sol = co.integrate(forced, still, (0, 1), 0.5, co.IsospectralGauss())
    assert abs(sol.energy[-1].mean() - 0.5) < 4 * 0.5 * np.sqrt(2 / 12 / 400)
    assert np.abs(sol.x[-1, :, 0] - s.planetary[0]).max() < 0.1 * np.abs(sol.x[-1, :, 1] - s.planetary[0]).max()


def test_transport_noise_carries_all_layers():
    s = FLOWS["two layers"]
    noise = co.forces.TransportNoise((1, 2), 0.3, seed=4)
    sol = co.integrate(s.with_forces(noise), start_of(s), (0, 1), 0.0625, co.IsospectralGauss())
    assert max(sol.balance()[name] for name in s.casimirs) < 1e-12
    alone = FLOWS["two layers"].fluid
    W = alone.random(seed=1)
    still = S.layered_qg(9, np.zeros((2, 2)))
    one = co.integrate(alone.with_forces(noise), W, (0, 1), 0.0625, co.IsospectralGauss(2)).x[-1]
    both = co.integrate(still.with_forces(noise), np.stack([W, W]), (0, 1), 0.0625, co.IsospectralGauss(2)).x[-1]
    np.testing.assert_allclose(both, [one, one], rtol=0, atol=1e-11)


def test_files_datasets_and_pictures(tmp_path):
    s = FLOWS["three layers"]
    x0 = start_of(s)
    whole = co.integrate(s, x0, (0, 1), 0.0625, co.IsospectralGauss(), archive=tmp_path / "whole.zarr")
    part = co.integrate(s, x0, (0, 0.5), 0.0625, co.IsospectralGauss(), archive=tmp_path / "part.zarr")
    assert np.array_equal(part.x[-1], whole.x[8])
    again = co.load(tmp_path / "whole.zarr")
    assert np.array_equal(again.x, whole.x)
    assert again.system.parameters == s.parameters
    fields = whole.to_xarray(grid=True).isel(time=-1)
    assert fields.vorticity.dims == ("layer", "latitude", "longitude")
    fluid = s.fluid
    read = [fluid.from_grid(fields.vorticity.isel(layer=k)) for k in range(3)]
    np.testing.assert_allclose(s.absolute(read), whole.x[-1], rtol=0, atol=1e-11)
    speeds = fluid.velocity(s.relative(whole.x[-1]))
    np.testing.assert_allclose(fields.eastward_velocity, speeds[0], rtol=0, atol=1e-12)
    for options in ({"layer": 2}, {"layer": 1, "part": "potential"}, {"part": "stream"}, {"part": "large"}):
        axes = whole.plot([co.plotting.Picture("vorticity", **options)]).axes[0]
        texts = [one.get_title() + one.get_ylabel() for one in axes.figure.axes]
        assert f"layer {options.get('layer', 0)}" in "".join(texts)
    whole.plot()
    with refused(ValueError, "layer is 3", "3 from 0"):
        whole.plot([co.plotting.Picture("vorticity", layer=3)])


def test_fields_in_si_units():
    earth = S.RotatingPlanet(radius=6.371e6, day=86164.1, gravity=0.02, depth=500.0)
    s = S.layered_qg(12, [[4.0, -4.0], [-4.0, 4.0]], rotation=earth.rotation)
    sol = co.integrate(s, start_of(s), (0, 0.1), 0.05, co.IsospectralGauss())
    si = earth.with_units(sol.to_xarray())
    psi = si.stream_function.isel(layer=0)
    f = 4 * np.pi / earth.day * np.sin(np.radians(si.latitude))
    np.testing.assert_allclose(si.height, psi * f / 0.02, rtol=1e-12)
    assert si.height.attrs["units"] == "m"
    one = S.sphere_qg(12, 5.0, earth.rotation)
    alone = earth.with_units(co.integrate(one, one.random(1), (0, 0.1), 0.05, co.IsospectralGauss()).to_xarray())
    np.testing.assert_allclose(alone.height, alone.stream_function * f / 0.02, rtol=1e-12)


def test_what_is_refused():
    square = [[1.0, -1.0], [-1.0, 1.0]]
    cases = [
        (dict(gamma=[[1.0]]), ("gamma", "(1, 1)")),
        (dict(gamma=[[1.0, -1.0], [-2.0, 2.0]]), ("thickness", "gamma", "-1", "-2", "symmetric")),
        (dict(gamma=[[-1.0, 1.0], [1.0, -1.0]]), ("gamma", "negative eigenvalue", "-2")),
        (dict(gamma=square, thicknesses=[1.0, -1.0]), ("thicknesses", "positive")),
        (dict(gamma=square, lamb=np.eye(3)), ("lamb", "3 layers", "2")),
        (dict(gamma=square, lamb=[[1.0, 0.0], [0.0, 2.0]]), ("gamma", "lamb", "commute")),
        (dict(gamma=square, surface="torus", rotation=1.0, N=9), ("torus", "rotation")),
        (dict(gamma=[[np.nan, 0.0], [0.0, 1.0]]), ("gamma",)),
    ]  # fmt: skip
    for arguments, named in cases:
        with refused((ValueError, TypeError), *named):
            S.layered_qg(**{"N": 8, **arguments})
    s = FLOWS["two layers"]
    with pytest.warns(UserWarning, match="N = "):
        S.layered_qg(8, 100 * np.array(square))
    some = co.forces
    for force, named in (
        (some.RandomForcing(0.5, (2, 3), seed=3), ("layer", "0 to 1")),
        (some.RandomForcing(0.5, (2, 3), seed=3, layer=2), ("layer is 2", "0 to 1")),
        (some.Viscosity(0.1, layer="carried"), ("carried", "layer")),
        (some.SelectiveDecay(0.1), ("layers", "Viscosity")),
        (some.DoubleBracketDamping(0.1), ("layers", "Friction")),
        (some.HeatBath(0.1, 0.1, seed=1), ("layers",)),
    ):
        with refused(ValueError, "layered_qg", *named):
            s.with_forces(force)
    with refused(ValueError, "BetaPlane", "layered_qg", "rotation"):
        s.with_forces(some.BetaPlane(1.0))
    with refused(ValueError, "layer is 1", "sphere_euler"):
        s.fluid.with_forces(some.RandomForcing(0.5, (2, 3), seed=3, layer=1))
    for force in (some.Friction, some.Viscosity):
        with refused(ValueError, "layer is 1", "lamb", "gamma"):
            FLOWS["of latitude"].with_forces(force(0.1, layer=1))
        with refused(ValueError, "layer is 2", "0 to 1"):
            s.with_forces(force(0.1, layer=2))
        with refused(ValueError, "layer is 1", "sphere_euler"):
            s.fluid.with_forces(force(0.1, layer=1))
    with refused(ValueError, "(9, 9)", "(2, 9, 9)"):
        co.integrate(s, s.fluid.random(1), (0, 1), 0.1, co.IsospectralGauss())
    with refused(ValueError, "torus", "Rossby"):
        FLOWS["torus"].rossby_wave(2, 1)
    with refused((ValueError, TypeError), "layered_qg"):
        co.integrate(s, start_of(s), (0, 1), 0.1, co.LineSplitting())
