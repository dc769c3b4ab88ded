"""Damping, heat baths and Hamiltonian noise on matrices: orbits, laws in closed form, Gibbs states, orders."""

from math import factorial, pi, sqrt

import numpy as np
import pytest
from fluids_by_modes import random_matrix
from scipy.integrate import quad, solve_ivp

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

F = co.forces
GAUSS = co.IsospectralGauss()
SYSTEMS = {
    "sphere": co.systems.sphere_euler(N=5),
    "rotating sphere": co.systems.sphere_euler(N=4, rotation=1.5),
    "torus": co.systems.torus_euler(N=5),
    "conducting": co.systems.reduced_mhd(N=4),
    "dye": co.systems.passive_scalar(N=5, surface="torus"),
    "body": co.systems.matrix_body((1.0, 2.0, 3.0, 4.0)),
}
ON_SYSTEMS = pytest.mark.parametrize("name", SYSTEMS)


def free(N):
    """Return su(N) without a Hamiltonian: only noise moves its states."""
    return co.MatrixSystem(co.MatrixAlgebra("su", N), co.systems.Weights(np.zeros((N, N))), name="free matrices")


def forces_on(system, alpha=0.05):
    found = [F.DoubleBracketDamping(alpha), F.HeatBath(alpha, temperature=0.3, seed=3)]
    elements = [0.5 * random_matrix(system, k) for k in range(3)]
    if len(system.matrix_shape) == 3 and system.second_stream is None:
        elements = [one[1] for one in elements]
    found.append(F.HamiltonianNoise(elements, (0.3, 0.2, 0.1), seed=4))
    return [*found, F.TransportNoise((1, 2), 0.5, seed=5)] if system.fluid is not None else found


def real_modes(s, degree):
    """Return the orthonormal real modes of a degree of a sphere, as matrices of norm one."""
    modes = [{(degree, 0): 1.0}]
    for m in range(1, degree + 1):
        modes += [{(degree, m): sqrt(0.5)}, {(degree, m): 1j * sqrt(0.5)}]
    return [s.from_modes(one) / s.scale for one in modes]


def six_j(N, L, l):
    """Return Wigner's {j j L; j j l}, j = (N - 1)/2, by the sum of Racah."""

    def triangle(a, b, c):
        return factorial(a + b - c) * factorial(a - b + c) * factorial(b + c - a) / factorial(a + b + c + 1)

    # Twice j is N - 1; all other sums are whole.
    def of_pair(degree):
        return factorial(N - 1 - degree) * factorial(degree) ** 2 / factorial(N + degree)

    total = 0.0
    for t in range(max(N - 1 + L, N - 1 + l), min(2 * (N - 1), N - 1 + L + l) + 1):
        parts = [t - (N - 1) - L, t - (N - 1) - l] * 2
        below = np.prod([float(factorial(one)) for one in parts])
        below *= float(factorial(2 * (N - 1) - t)) * float(factorial(N - 1 + L + l - t)) ** 2
        total += (-1) ** t * factorial(t + 1) / below
    return of_pair(L) * of_pair(l) * total


def decay(N, L, l):
    """Return lambda of ``sum_m [T_Lm, [T_Lm^+, W_l]] = lambda W_l``."""
    return 2 * (2 * L + 1) * (1 / N - (-1) ** (L + l + N - 1) * six_j(N, L, l))


def test_rates_of_decay_are_those_of_six_j_symbols():
    found = [decay(12, 2, l) for l in (1, 2, 3)]
    assert found == pytest.approx([0.0699300699, 0.2037962038, 0.3896103896], rel=1e-9)
    s = co.systems.sphere_euler(N=12)
    single = F.TransportNoise(2, 0.3, seed=1)
    # Stream functions sigma Y with the mean square velocity 0.3^2 = sigma^2 L(L + 1)(2 L + 1)/(4 pi)
    sigma2 = 0.3**2 * 4 * pi / (6 * 5)
    for l, rate in zip((1, 2, 3), found, strict=True):
        W = s.from_modes({(l, l): 0.3 - 0.2j, (l, 0): 0.5})
        drift = single.ito_drift(s, W)
        np.testing.assert_allclose(drift, -0.5 * sigma2 * s.scale**2 * rate * W, rtol=0, atol=1e-12 * np.abs(W).max())
    elements = F.HamiltonianNoise(real_modes(s, 2), 0.7, seed=1)
    np.testing.assert_allclose(elements.ito_drift(s, W), -0.5 * 0.49 * found[2] * W, rtol=0, atol=1e-12)


@pytest.mark.parametrize("surface", ["sphere", "torus"])
def test_transport_noise_is_the_eddy_diffusivity_of_its_strength(surface):
    """``strength^2/4`` times the Laplacian, with an error of second order in 1/N."""
    errors = []
    for N in (33, 65):
        s = co.systems.get(f"{surface}_euler", N=N)
        W = s.from_modes({(1, 1): 0.5, (2, 1): 0.3})
        noise = F.TransportNoise((1, 2), 0.4, (1.0, 3.0), seed=1)
        found, wanted = s.mode_array(noise.ito_drift(s, W)), -0.04 * s.eigenvalues * s.mode_array(W)
        errors.append(np.abs(found - wanted).max() / np.abs(wanted).max())
    # The square of (2 pi/N) |n| |m|, which on the sphere is 2 l m/N, with degrees up to 2.5 and sqrt(5).
    assert errors[1] < (2 * pi * 2.5 * sqrt(5) / 65) ** 2
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize(("surface", "N"), [("sphere", 16), ("sphere", 32), ("torus", 33), ("torus", 65)])
def test_transport_noise_lacks_a_share_of_its_eddy_diffusivity(surface, N):
    """(d(d + 1) - 2)(l(l + 1) - 2)/4N^2 on the sphere, (pi d |n|/N)^2 on the torus, and paths have the exact rate."""
    s, sphere = co.systems.get(f"{surface}_euler", N=N), surface == "sphere"
    for d, l in ((1, 5), (3, 1), (3, 2), (4, 3)):
        noise, W = F.TransportNoise(d, 0.4, seed=1), s.from_modes({(l, 0): 1.0})
        rate = -np.vdot(W, noise.ito_drift(s, W)).real / np.vdot(W, W).real
        lacking = 1.0 - rate / (0.04 * (l * (l + 1) if sphere else l * l))
        if sphere:
            share = (d * (d + 1) - 2) * (l * (l + 1) - 2) / (2.0 * N) ** 2
            assert abs(lacking - share) < share**2 + 1e-12
        else:  # wave numbers of a degree are from d - 1/2 to d + 1/2
            share = (pi * l / N) ** 2 * (d + np.array([-0.5, 0.5])) ** 2
            assert share[0] - share[1] ** 2 < lacking < share[1]
    if N > 33:
        return
    d, l, t = 7, 5, 0.5
    noise = F.TransportNoise(d, 0.5, seed=1)
    W = 1e-3 * (s.random(seed=2, degrees=(l, l)) if sphere else s.from_modes({(4, 3): 1.0}))
    rate = -np.vdot(W, noise.ito_drift(s, W)).real / np.vdot(W, W).real
    starts = np.array([W] * 100)
    sol = co.integrate(s.with_forces(noise), starts, (0, t), t / 8, GAUSS, save_every=8)
    mean, error = estimates(starts, sol.x[-1])
    assert abs(mean - np.exp(-rate * t)) < 4 * error
    assert mean - np.exp(-(0.5**2) / 4 * (l * (l + 1) if sphere else l * l) * t) > 5 * error


def estimates(W0, X):
    """Return the mean projection of states onto their starts, and its standard error."""
    shares = np.einsum("kij,kij->k", W0.conj(), X).real / np.einsum("kij,kij->k", W0.conj(), W0).real
    return shares.mean(), shares.std() / sqrt(len(shares))


def starts(s, degree, members, rng):
    modes = np.zeros((members, s.algebra.N, s.algebra.N), complex)
    modes[:, degree, 0] = rng.normal(size=members)
    modes[:, degree, 1 : degree + 1] = rng.normal(size=(members, degree)) + 1j * rng.normal(size=(members, degree))
    W = s.from_modes(modes)
    return W / np.linalg.norm(W, axis=(1, 2))[:, None, None]


@pytest.mark.parametrize("N", [6, pytest.param(16, marks=pytest.mark.long)])
def test_the_mean_of_a_degree_decays_and_the_error_of_a_step_is_of_second_order(N):
    """In one step, with a decay of exp(-3), an error is seen; in two it is less than a third of that, and of noise."""
    sigma, members = np.sqrt(6.0 / decay(N, 2, 2)), 8000
    s, rng = co.systems.sphere_euler(N), np.random.default_rng(1)
    parts = {l: starts(s, l, members, rng) for l in (1, 2, 3)}
    errors = {}
    for steps in (1, 2, 4):
        noisy = free(N).with_forces(F.HamiltonianNoise(real_modes(s, 2), sigma, seed=7))
        sol = co.integrate(noisy, sum(parts.values()), (0.25, 1.25), 1 / steps, GAUSS, save_every=steps)
        assert max(sol.balance()[name] for name in ("tr W^2", "tr W^3")) < 64 * UNIT_ROUNDOFF * N
        for l, W0 in parts.items():
            mean, error = estimates(W0, sol.x[-1])
            errors[steps, l] = mean - np.exp(-(sigma**2) * decay(N, 2, l) / 2), error
    assert errors[1, 2][0] > 5 * errors[1, 2][1]
    for l in parts:
        (one, _), (two, noise), (four, last) = (errors[steps, l] for steps in (1, 2, 4))
        assert abs(two) < abs(one) / 3 + 4 * noise, l
        assert abs(four) < abs(one) / 9 + 4 * last, l


def test_the_energy_of_the_mean_falls_and_paths_keep_their_enstrophy():
    s = co.systems.sphere_euler(N=8)
    noisy = s.with_forces(F.TransportNoise((3, 4), 0.8, seed=2))
    W = s.random(seed=3)
    sol = co.integrate(noisy, [W] * 400, (0.0, 1.0), 0.0625, GAUSS, save_every=4)
    mean = sol.x.mean(axis=1)
    energies, enstrophies = [s.energy(one) for one in mean], [np.linalg.norm(one) ** 2 for one in mean]
    assert np.all(np.diff(energies) < 0.0) and np.all(np.diff(enstrophies) < 0.0)
    square = np.linalg.norm(sol.x, axis=(-2, -1)) ** 2
    assert np.abs(square / square[0] - 1.0).max() < 1e-13
    # The spectrum of each path is that of the start.
    assert np.abs(s.spectrum(sol.x[-1]) - s.spectrum(W)).max() < 1e-13 * np.abs(s.spectrum(W)).max()


def test_su_2_as_matrices_has_the_law_of_so_3_as_vectors():
    """E P_l = exp(-sigma^2 l(l + 1) t/2) for l = 1, 2, and one step of isotropic noise is a rotation of that law."""
    # S_a = -i sigma_a/2 have [S_1, S_2] = S_3, as the axes of so(3).
    axes = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]]) * -0.5j
    members, sigma = 20000, 0.7
    matrices = free(2).with_forces(F.HamiltonianNoise(axes, sigma, seed=1))
    x = co.integrate(matrices, [axes[2]] * members, (0, 1), 0.25, GAUSS, save_every=4).x[-1]
    z = 2 * np.einsum("ij,kij->k", axes[2].conj(), x).real
    still = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0.0))
    vectors = still.with_forces(F.HamiltonianNoise(np.eye(3), sigma, seed=2))
    y = co.integrate(vectors, [(0.0, 0.0, 1.0)] * members, (0, 1), 0.25, save_every=4).x[-1, :, 2]
    for values in (z, y):
        for l, wanted in ((values, 0.612626), (1.5 * values**2 - 0.5, 0.229925)):
            # The error of second order of four steps is below 1e-3, that of sixteen in the table of the scheme.
            assert abs(l.mean() - wanted) < 4 * l.std() / sqrt(members) + 1e-3


def test_one_exponential_in_all_directions_has_its_corrected_variance():
    """Without damping all of su(3) decays as exp(-sigma^2 c t/2), c = 2 N; without the correction the error is 2 %."""
    N, members, rng = 3, 40000, np.random.default_rng(4)
    # 2 alpha kT = 1/3, so that the exponent is one
    bath = F.HeatBath(2.0**-60, temperature=2.0**59 / 3, seed=9)
    W = rng.normal(size=(members, N, N)) + 1j * rng.normal(size=(members, N, N))
    W = co.MatrixAlgebra("su", N).projected(W)
    # Both halves of a step have two halves of the noise: four exponentials of the variance v = 1/12.
    X = co.integrate(free(N).with_forces(bath), W, (0, 1), 1.0, GAUSS).x[-1]
    mean, error = estimates(W, X)
    uncorrected, third = 4 * (2 * N) ** 2 / 12**2 / 48, 4 * (2 * N) ** 3 / 12**3 / 48
    assert 4 * error + third < uncorrected
    assert abs(mean - np.exp(-1.0)) < 4 * error + third * np.exp(-1.0)


@ON_SYSTEMS
def test_damping_converges_with_order_two_to_its_field(name):
    s = SYSTEMS[name]
    W, force = 0.6 * random_matrix(s, 2), F.DoubleBracketDamping(0.2)
    damped = s.with_forces(force)
    span = (0.5, 1.0)
    view = damped.in_numbers
    exact = solve_ivp(lambda t, x: view.vector_field(x, t), span, s.to_vector(W), "DOP853", rtol=1e-11, atol=1e-12)
    errors = []
    for h in (1 / 16, 1 / 32, 1 / 64):
        sol = co.integrate(damped, W, span, h, GAUSS)
        errors.append(np.abs(s.to_vector(sol.x[-1]) - exact.y[:, -1]).max())
        assert max(sol.balance()[one] for one in s.casimirs if one in sol.balance()) < 64 * s.algebra.N * UNIT_ROUNDOFF
        # The damping alone lowers the energy in every half of a step.
        assert np.all(np.diff(sol.work["DoubleBracketDamping"]["energy"]) < 0.0)
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(slopes - 2.0) < 0.25), slopes
    f = s.hamiltonian_field(W)
    layers = f[1] if name == "dye" else f
    wanted = -0.2 * s.energy_unit * np.linalg.norm(layers) ** 2
    assert damped.power(s.to_vector(W))["DoubleBracketDamping"] == pytest.approx(wanted, rel=1e-12)


@ON_SYSTEMS
def test_every_invariant_is_kept_whatever_acts(name):
    """Also tr W^k of a vorticity that carries a dye; in both orders of forces that keep orbits, from a late time."""
    s = SYSTEMS[name]
    W, acting = 0.6 * random_matrix(s, 2), forces_on(s)
    before = s.casimirs_at(W)
    sizes = {one: float(np.max(s.casimirs[one].sum_of_absolute_terms(s.to_vector(W)))) for one in before}
    for forces in [*([one] for one in acting), acting, acting[::-1]]:
        sol = co.integrate(s.with_forces(*forces), W, (100.0, 102.0), 1 / 32, GAUSS)
        for one, value in s.casimirs_at(sol.x[-1]).items():
            # Round-off of 64 steps with two to eight conjugations each.
            assert abs(value - before[one]) < 512 * s.algebra.N * UNIT_ROUNDOFF * sizes[one], (forces, one)
        assert np.abs(sol.x[-1] - co.integrate(s, W, (100.0, 102.0), 1 / 32, GAUSS).x[-1]).max() > 1e-4


@ON_SYSTEMS
def test_each_path_is_a_poisson_map(name):
    """P J(x) P^T = J at the end, for steps with Hamiltonian noise before or after them."""
    s = SYSTEMS[name]
    W = s.to_vector(0.6 * random_matrix(s, 2))
    sides = set()
    for force in forces_on(s)[2:]:
        forced = co.methods.Forced(GAUSS)
        system = s.with_forces(force)
        assert forced.properties(system).poisson
        for t in (0.0, 0.25, 0.5, 0.75, 1.0, 1.25):
            y, P = forced.tangent(system, W, t, 0.125)
            J, K = s.structure_matrix(W), s.structure_matrix(y)
            assert np.abs(P @ J @ P.T - K).max() < 1e-13 * s.algebra.N * np.abs(K).max()
            sides.add(bool(np.any(force.on_side(0).flow_of_order(s, W, t, 0.125, 2) != W)))
    assert sides == {True, False}


@ON_SYSTEMS
def test_compiled_steps_are_those_in_numpy(name):
    s = SYSTEMS[name]
    W = 0.6 * random_matrix(s, 2)
    for force in forces_on(s):
        system, y = s.with_forces(force), W
        for t in (0.5, 0.625):
            y = co.methods.Forced(GAUSS).step(system, y, t, 0.125)
        x = co.integrate(system, W, (0.5, 0.75), 0.125, GAUSS).x[-1]
        assert np.abs(x - y).max() < 256 * s.algebra.N * UNIT_ROUNDOFF * np.abs(W).max(), force


def test_sums_of_algebras_have_noise_in_their_blocks():
    algebra = co.MatrixAlgebra.sum(co.MatrixAlgebra("so", 3), co.MatrixAlgebra("u", 2), co.MatrixAlgebra("su", 3))
    weights = np.full((8, 8), 1.5)
    weights[5:, 5:] = 2.0
    s = co.MatrixSystem(algebra, co.systems.Weights(weights), name="blocks")
    rng = np.random.default_rng(1)
    W = algebra.projected(rng.normal(size=(8, 8)) + 1j * rng.normal(size=(8, 8)))
    bath = s.with_forces(F.HeatBath(0.2, temperature=0.5, seed=3))
    x = co.integrate(bath, W, (0, 1), 0.125, GAUSS).x[-1]
    assert np.abs(algebra.projected(x) - x).max() < 64 * UNIT_ROUNDOFF * np.abs(x).max() < np.abs(x - W).max()
    y = W
    for k in range(8):
        y = co.methods.Forced(GAUSS).step(bath, y, 0.125 * k, 0.125)
    assert np.abs(x - y).max() < 1e-12


def spins_in_anisotropy(D):
    """Return H = D (S^z)^2 of an SU(3) spin, as i (Z Z^+ - 1/3), without the constant 2 D/3, and a start."""
    A = 1j * D * (np.diag([1.0, 0.0, 1.0]) - 2 * np.eye(3) / 3)
    system = co.MatrixSystem(co.MatrixAlgebra("su", 3), co.systems.Weights(np.zeros((3, 3))), A, name="spin one")

    def start(members):
        rng = np.random.default_rng(2)
        Z = rng.normal(size=(members, 3)) + 1j * rng.normal(size=(members, 3))
        Z /= np.linalg.norm(Z, axis=1)[:, None]
        return 1j * (Z[:, :, None] * Z.conj()[:, None, :] - np.eye(3) / 3)

    return system, start


@pytest.mark.parametrize(("temperature", "wanted"), [(0.125, 0.2473082), (0.5, 0.5443212)])
@pytest.mark.parametrize(("members", "span"), [(400, 12), pytest.param(4000, 36, marks=pytest.mark.long)])
def test_su_3_spins_in_a_bath_have_their_mean_energy(temperature, wanted, members, span):
    system, start = spins_in_anisotropy(1.0)
    bath = system.with_forces(F.HeatBath(1.0, temperature=temperature, seed=3))
    sol = co.integrate(bath, start(members), (0, span), 0.2, GAUSS, save_every=5)
    means = sol.energy[6:].mean(axis=0) + 2 / 3
    # The error of second order of the step is below that of the sample.
    assert abs(means.mean() - wanted) < 4 * means.std() / sqrt(members) + 1e-3 * wanted
    assert max(sol.balance()[one] for one in ("tr W^2", "tr W^3")) < 1e-13


def test_a_spin_in_a_field_has_the_mean_of_langevin():
    """su(2): H = -B S_3, <S_3> = coth(B/kT) - kT/B, and with an anisotropy the mean by quadrature."""
    third = np.diag([-0.5j, 0.5j])
    members = 300
    for anisotropy in (0.0, 1.5):
        # <S_3, S_3> = 1/2: H = -B z + a z^2/2 of z, W = z S_3 + ...
        weights = 2.0 * anisotropy * np.eye(2)
        s = co.MatrixSystem(co.MatrixAlgebra("su", 2), co.systems.Weights(weights), -2.0 * third, name="spin")
        W = third * 1.0
        assert s.energy(W) == pytest.approx(-1.0 + anisotropy / 2)
        bath = s.with_forces(F.HeatBath(0.5, temperature=0.7, seed=4))
        sol = co.integrate(bath, [W] * members, (0, 16), 0.25, GAUSS, save_every=4)
        z = 2 * np.einsum("ij,tkij->tk", third.conj(), sol.x[4:]).real.mean(axis=0)

        def density(u, a=anisotropy):
            return np.exp((u - 0.5 * a * u * u) / 0.7)

        wanted = quad(lambda u: u * density(u), -1, 1)[0] / quad(density, -1, 1)[0]
        if not anisotropy:
            assert wanted == pytest.approx(1 / np.tanh(1 / 0.7) - 0.7, rel=1e-9)
        assert abs(z.mean() - wanted) < 4 * z.std() / sqrt(members) + 2e-3


def test_a_fluid_in_a_bath_has_the_gibbs_state_of_its_orbit():
    """The mean energy, and the mean enstrophy of degree one, against weighted unitary matrices of Haar's measure."""
    s = co.systems.sphere_euler(N=3)
    W, members, rng = s.random(seed=5), 100, np.random.default_rng(6)
    Z = rng.normal(size=(100000, 3, 3)) + 1j * rng.normal(size=(100000, 3, 3))
    Q, R = np.linalg.qr(Z)
    d = np.einsum("kii->ki", R)
    U = Q * (d / np.abs(d))[:, None, :]
    X = U @ W @ np.conj(np.swapaxes(U, 1, 2))
    E = s.energy(X)
    temperature = float(E.std()) / 1.5
    weights = np.exp(-(E - E.min()) / temperature)
    _, spectrum = s.energy_spectrum(X)
    wanted = np.average(np.column_stack([E, spectrum[:, 0]]), axis=0, weights=weights)
    effective = weights.sum() ** 2 / (weights**2).sum()
    assert abs(E.mean() - wanted[0]) > 0.3 * E.std()
    alpha = 0.4
    bath = s.with_forces(F.HeatBath(alpha, temperature=temperature, seed=7))
    sol = co.integrate(bath, [W] * members, (0, 40), 0.2, GAUSS, save_every=5)
    late = sol.x[5:]
    values = np.stack([s.energy(late), s.energy_spectrum(late)[1][..., 0]]).mean(axis=1)
    for value, mean, spread in zip(values, wanted, (E.std(), spectrum[:, 0].std()), strict=True):
        error = 4 * (value.std() / sqrt(members) + spread / sqrt(effective))
        assert abs(value.mean() - mean) < error + 2e-3 * abs(mean)
        assert error < 0.1 * spread


def test_paths_converge_with_their_orders():
    """On the same path, with levels: order one half in general, one for noise that commutes."""
    s = co.systems.sphere_euler(N=8)
    W, members = s.random(seed=1), 24
    single = F.HamiltonianNoise([0.5 * random_matrix(s, 4)], 0.5, seed=8)
    for force, least, most in ((F.TransportNoise((2, 3), 0.5, seed=8), 0.4, 0.75), (single, 0.8, 1.5)):
        ends = []
        for level in range(6):
            noisy = s.with_forces(co.forces.get(type(force).__name__, **{**force.parameters(), "levels": level}))
            h = 2.0**level / 256
            ends.append(co.integrate(noisy, [W] * members, (0, 0.5), h, GAUSS, save_every=128 // 2**level).x[-1])
        errors = [np.sqrt(np.mean(np.linalg.norm(end - ends[0], axis=(1, 2)) ** 2)) for end in ends[2:]]
        slope = np.polyfit(np.arange(4), np.log2(errors), 1)[0]
        assert least < slope < most, (force, errors)


def published_midpoint(s, A, noise, W, t, h, steps):
    """Return the end of the midpoint rule of Ephrati, Jansson, Lang and Luesink (2024) on the path of a noise."""
    for k in range(steps):
        increments, _ = noise.increments(len(A), t + k * h, h)
        M, pushed = W, np.tensordot(increments, A, axes=1)
        for _ in range(60):
            Z = h * s.stream_of(M) + pushed
            M = W + 0.5 * s.bracket(Z, M) + 0.25 * Z @ M @ Z
        W = W + s.bracket(Z, M)
    return W


@pytest.mark.long
def test_strong_errors_on_the_sphere_are_not_above_those_of_the_published_midpoint():
    """N = 16, five modes of degree two: both have order one half."""
    s, paths = co.systems.sphere_euler(N=16), 16
    W, A = s.random(seed=1), 0.5 * s.scale * np.array(real_modes(s, 2))
    errors = {"exponentials": [], "midpoint": []}

    def ends(level):
        noisy = s.with_forces(F.HamiltonianNoise(list(A), 0.4, seed=8, levels=level))
        return co.integrate(noisy, [W] * paths, (0, 0.5), 2.0**level / 256, GAUSS, save_every=128 >> level).x[-1]

    exact = ends(0)
    for level in (3, 4, 5):
        h, found = 2.0**level / 256, {"exponentials": ends(level), "midpoint": []}
        for m in range(paths):
            noise = F.HamiltonianNoise(list(A), 0.4, seed=8, stream=m, levels=level)
            found["midpoint"].append(published_midpoint(s, A * 0.4, noise, W, 0.0, h, 128 >> level))
        for name, end in found.items():
            errors[name].append(np.sqrt(np.mean(np.linalg.norm(np.array(end) - exact, axis=(1, 2)) ** 2)))
    for name, values in errors.items():
        slope = np.polyfit(np.arange(3), np.log2(values), 1)[0]
        assert 0.3 < slope < 0.8, (name, values)
    # The independent copy adds the variance of areas that the midpoint rule leaves out: a factor of sqrt(2) at most.
    assert np.all(np.array(errors["exponentials"]) < 1.6 * np.array(errors["midpoint"])), errors


def test_members_threads_and_interrupted_runs_have_the_same_bits(tmp_path):
    s = SYSTEMS["sphere"]
    x0 = np.stack([0.6 * random_matrix(s, k) for k in range(5)])
    for force in forces_on(s):
        system = s.with_forces(force)
        whole = co.integrate(system, x0, (0.5, 2.5), 0.125, GAUSS)
        threads = co.integrate(system, x0, (0.5, 2.5), 0.125, GAUSS, threads=2)
        assert np.array_equal(whole.x, threads.x)
        path = tmp_path / f"{force.label}.zarr"
        co.integrate(system, x0, (0.5, 1.5), 0.125, GAUSS, archive=path)
        assert np.array_equal(co.resume(path, t_end=2.5).x, whole.x)
        stream = {"stream": 3} if force.random else {}
        alone = co.forces.get(force.label, **{**force.parameters(), **stream})
        assert np.array_equal(co.integrate(s.with_forces(alone), x0[3], (0.5, 2.5), 0.125, GAUSS).x, whole.x[:, 3])


@pytest.mark.parametrize("unit", [2.0**-23, 2.0**100])
def test_other_units_of_time_give_the_same_motion(unit):
    """W in 1/time: alpha is a time, temperature and energy are 1/time^2, strength^2 is a length^2/time."""
    for name in ("sphere", "conducting"):
        s = SYSTEMS[name]
        W = 0.6 * random_matrix(s, 2)
        A = [0.5 * random_matrix(s, k) for k in range(2)]
        for force, other in (
            (F.DoubleBracketDamping(0.05), F.DoubleBracketDamping(0.05 / unit)),
            (F.TransportNoise((1, 2), 0.5, seed=5), F.TransportNoise((1, 2), 0.5 * sqrt(unit), seed=5)),
            (F.HamiltonianNoise(A, 0.5, seed=5), F.HamiltonianNoise(A, 0.5 * sqrt(unit), seed=5)),
        ):
            if name == "conducting" and force.random and force.label == "HamiltonianNoise":
                continue  # of a magnetic potential, whose unit is another
            one = co.integrate(s.with_forces(force), W, (0.0, 1.0), 0.125, GAUSS).x[-1]
            far = co.integrate(s.with_forces(other), W * unit, (0.0, 1.0 / unit), 0.125 / unit, GAUSS).x[-1]
            assert np.abs(far / unit - one).max() < 1e-12 * np.abs(one).max(), (name, force)


def test_many_steps_leave_the_orbit_by_round_off_only():
    check_long_run(2**12)


@pytest.mark.long
def test_a_million_steps_leave_the_orbit_by_round_off_only():
    check_long_run(2**20)


def check_long_run(steps):
    s = co.systems.sphere_euler(N=4)
    for force in (F.HeatBath(0.05, temperature=0.3, seed=3), F.TransportNoise((1, 2), 0.5, seed=4)):
        span, every = (0.0, 0.125 * steps), int(steps // 16)
        sol = co.integrate(s.with_forces(force), s.random(seed=1), span, 0.125, GAUSS, save_every=every)
        # Unbiased rounding of some ten sums a step, in units of the state: the root of their number, five times.
        bound = 5 * UNIT_ROUNDOFF * sqrt(10 * steps)
        assert max(sol.balance()[one] for one in ("tr W^2", "tr W^3", "tr W^4")) < bound


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: F.TransportNoise(2, 0.1), ("seed",)),
        (lambda: F.TransportNoise((2, 3), 0.1, (1.0,), seed=1), ("spectrum", "1 shares", "2 degrees")),
        (lambda: F.TransportNoise((2, 2), 0.1, seed=1), ("degrees", "once")),
        (lambda: F.TransportNoise(2, -0.1, seed=1), ("strength",)),
        (lambda: SYSTEMS["sphere"].with_forces(F.TransportNoise(9, 0.1, seed=1)), ("9", "no modes")),
        (lambda: co.systems.rigid_body().with_forces(F.TransportNoise(2, 0.1, seed=1)), ("modes of a fluid",)),
        (lambda: free(4).with_forces(F.TransportNoise(2, 0.1, seed=1)), ("modes of a fluid",)),
        (lambda: SYSTEMS["sphere"].with_forces(F.HamiltonianNoise("x1", seed=1)), ("matrix",)),
        (
            lambda: SYSTEMS["sphere"].with_forces(F.HamiltonianNoise(np.eye(3), seed=1)),
            ("hamiltonians[0]", "(3,)", "(5, 5)"),
        ),
        (lambda: SYSTEMS["sphere"].with_forces(F.HamiltonianNoise([np.eye(5)], seed=1)), ("hamiltonians[0]", "su(5)")),
        (
            lambda: SYSTEMS["dye"].with_forces(F.HamiltonianNoise([random_matrix(SYSTEMS["dye"])], seed=1)),
            ("(2, 5, 5)", "(5, 5)"),
        ),
        (
            lambda: co.systems.rigid_body().with_forces(F.HamiltonianNoise([np.zeros((3, 3))], seed=1)),
            ("HamiltonianNoise", "3"),
        ),
        (
            lambda: co.MatrixSystem(co.MatrixAlgebra("so", 4, q=1), co.systems.Weights(np.ones((4, 4)))).with_forces(
                F.DoubleBracketDamping(0.1)
            ),
            ("so(3, 1)", "skew-Hermitian"),
        ),
        (
            lambda: co.integrate(
                SYSTEMS["sphere"].with_forces(F.TransportNoise(2, 0.1, seed=1)), np.zeros((5, 5)), (1, 0), 0.125, GAUSS
            ),
            ("TransportNoise", "backward"),
        ),
    ],
)
def test_refused_noise(call, named):
    with refused((ValueError, TypeError), *named):
        call()


def test_shares_of_a_spectrum_are_those_of_the_degrees_in_their_order():
    s = co.systems.sphere_euler(N=5)
    W = s.random(seed=3)
    runs = [
        co.integrate(s.with_forces(F.TransportNoise(degrees, 0.4, shares, seed=1)), W, (0, 1), 0.25, GAUSS).x[-1]
        for degrees, shares in (((1, 3), (5.0, 1.0)), ((3, 1), (1.0, 5.0)))
    ]
    assert np.array_equal(*runs)


@pytest.mark.parametrize("name", ["sphere", "conducting"])
@pytest.mark.parametrize("S", [[[0.3, 0.1, -0.2], [0.0, 0.4, 0.1]], [[0.3, 0.2], [0.0, 0.1]]], ids=["wide", "square"])
def test_correlated_noise_is_that_of_the_sums(name, S):
    s, S = SYSTEMS[name], np.array(S)
    elements = np.stack([0.5 * random_matrix(s, k) for k in range(2)])
    sums = list(np.tensordot(S.T, elements, axes=1))
    found, wanted = (
        co.integrate(
            s.with_forces(F.HamiltonianNoise(*noise, seed=4)), 0.3 * random_matrix(s, 5), (0, 0.25), 0.0625, GAUSS
        ).x[-1]
        for noise in ((list(elements), S), (sums, 1.0))
    )
    assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()
