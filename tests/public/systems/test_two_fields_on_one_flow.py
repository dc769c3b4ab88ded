"""Two fields on one flow: reduced magnetohydrodynamics, passive scalars, and two layers of any algebra."""

import numpy as np
import pytest
from fluids_by_modes import generators, last

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

Weights, TwoLayerSystem = co.systems.Weights, co.TwoLayerSystem

MHD = [co.systems.reduced_mhd(N=6), co.systems.reduced_mhd(N=5, surface="torus")]
DYED = [co.systems.passive_scalar(N=5), co.systems.passive_scalar(N=5, surface="torus")]
WEIGHTS = np.random.default_rng(8).uniform(0.5, 2.0, (2, 4, 4))
BODY = TwoLayerSystem(co.MatrixAlgebra("so", 4), *(Weights(w + w.T) for w in WEIGHTS), name="two layers of so(4)")
ALL = pytest.mark.parametrize("s", [*MHD, *DYED, BODY], ids=lambda s: f"{s.name} {s.parameters}")


def random_state(s, seed=1, size=0.5):
    drawn = np.random.default_rng(seed).standard_normal((2, *s.shape))
    X = s.algebra.projected(drawn[0] + 1j * drawn[1] if s.complex else drawn[0])
    X[0] /= np.abs(s.vector_field(np.stack([X[0], 0 * X[0]]))).max() ** 0.5 or 1.0
    return size * X / np.abs(X).max()


@pytest.mark.parametrize("layer", [0, 1])
def test_a_weak_field_beside_a_strong_one_has_its_rounding(layer):
    """The end of a run begins the next one; other matrices are refused by the layer."""
    s = co.systems.reduced_mhd(9, "torus")
    X = np.stack([s.fluid.from_modes({(0, 1): 9.0}), 1e-4 * s.fluid.random(2)])
    end = co.integrate(s, X, (0, 0.5), 0.004, co.IsospectralGauss()).x[-1]
    np.testing.assert_allclose(co.integrate(s, end, (0, 0.004), 0.004, co.IsospectralGauss()).x[0], end, atol=1e-13)
    end[layer, 0, 1] += 1e-9
    with refused(ValueError, f"layer {layer}", "skew-Hermitian"):
        co.integrate(s, end, (0, 1), 0.5, co.IsospectralGauss())


@pytest.mark.thinned(2)
@ALL
def test_invariants(s):
    X = random_state(s)
    sol = co.integrate(s, X, (0, 10), 0.125, co.IsospectralGauss(2))
    assert np.abs(sol.x[-1] - X).max() > 0.1
    drift = sol.drift()
    assert drift.pop("energy") < 1e-4 * abs(sol.energy[0])
    assert list(drift) == list(s.casimirs)
    for name, off in drift.items():
        k = 2 if name == "tr W Theta" else int(name[-1]) + ("W T" in name)
        size = np.linalg.norm(-1j * X, axis=(-2, -1)).max() ** k
        assert off < 80 * 16 * UNIT_ROUNDOFF * size, name
        assert s.casimirs[name](sol.x[-1]) == pytest.approx(sol.casimirs[name][-1], abs=1e-14 * size)
    assert np.abs(s.spectrum(sol.x[-1]) - s.spectrum(X)).max() < 1e-13
    base = -1j * X if s.complex else X
    assert sol.casimirs["tr W Theta"][0] == pytest.approx(np.trace(base[1] @ base[0]).real, rel=1e-13)
    third = next(name for name in s.casimirs if name.startswith("tr W Theta^"))
    power = np.linalg.matrix_power(base[0], int(third[-1]))
    assert sol.casimirs[third][0] == pytest.approx(np.trace(base[1] @ power).real, rel=1e-12)


def test_the_casimirs_that_there_are():
    assert list(MHD[0].casimirs)[:4] == ["tr Theta^2", "tr W Theta", "tr Theta^3", "tr W Theta^2"]
    assert not any(name.startswith("tr W^") for name in MHD[0].casimirs)
    assert "tr W^3" in DYED[0].casimirs
    X = random_state(MHD[0])
    sol = co.integrate(MHD[0], X, (0, 5), 0.125, co.IsospectralGauss(2))
    square = np.sum(np.abs(sol.x[:, 1]) ** 2, axis=(-2, -1))
    assert np.ptp(square) > 0.1 * square[0]  # the field acts back


def test_a_dye_in_a_rotating_frame(tmp_path):
    """The vorticity moves as that of the rotating sphere, with every force, and the dye as the absolute vorticity."""
    s, fluid = co.systems.passive_scalar(8, rotation=2.0), co.systems.sphere_euler(8, 2.0)
    W = fluid.random(seed=3)
    X = np.stack([W, W])
    np.testing.assert_array_equal(s.absolute(s.relative(X)), X)
    np.testing.assert_array_equal(s.relative(X)[1], np.asarray(fluid.relative(W)))
    assert s.energy(X) == fluid.energy(W)
    scheme, some = co.IsospectralGauss(2), co.forces
    sol = co.integrate(s, X, (0.5, 1.5), 0.0625, scheme, archive=tmp_path / "dye.zarr")
    np.testing.assert_allclose(sol.x[:, 0], sol.x[:, 1], rtol=0, atol=1e-13)
    assert max(sol.drift()[name] for name in s.casimirs) < 1e-13 * np.linalg.norm(W) ** 6
    again = co.load(tmp_path / "dye.zarr")
    assert again.system.parameters == s.parameters
    np.testing.assert_array_equal(again.system.vector_field(X), s.vector_field(X))
    for force in (
        some.Friction(0.3),
        some.SelectiveDecay(0.3),
        some.LinearDamping(0.2),
        some.RandomForcing(0.1, (1, 2), 3),
        some.TransportNoise((1, 2), 0.3, seed=3),
        some.DoubleBracketDamping(0.1),
    ):
        both = co.integrate(s.with_forces(force), X, (0.5, 1.0), 0.0625, scheme)
        alone = co.integrate(fluid.with_forces(force), W, (0.5, 1.0), 0.0625, scheme)
        np.testing.assert_allclose(both.x[:, 1], alone.x, rtol=0, atol=1e-13, err_msg=str(force))
        assert both.balance()["energy"] < 1e-6
    with refused(ValueError, "rotation", "torus", "BetaPlane"):
        co.systems.passive_scalar(5, "torus", rotation=1.0)


@pytest.mark.parametrize("s", DYED)
def test_a_dye_that_is_the_vorticity_stays_it(s):
    W = random_state(s)[1]
    surface = {"sphere": co.systems.sphere_euler, "torus": co.systems.torus_euler}[s.parameters["surface"]]
    alone = co.integrate(surface(N=5), W, (0, 5), 0.125, co.IsospectralGauss(2))
    both = co.integrate(s, np.stack([W, W]), (0, 5), 0.125, co.IsospectralGauss(2))
    assert np.abs(both.x[:, 0] - alone.x).max() < 1e-13
    assert np.abs(both.x[:, 1] - alone.x).max() < 1e-13


@pytest.mark.parametrize("N", [6, 7])
@pytest.mark.parametrize(("degree", "order"), [(2, 1), (3, 2), (4, 4)])
def test_alfven_waves_on_the_sphere(N, degree, order):
    """About Theta = a S_3 the degree l, order m oscillates by a m sqrt((l(l+1) - 2)/(l(l+1))), to first order."""
    s, fluid, a, small = co.systems.reduced_mhd(N=N), co.systems.sphere_euler(N=N), 0.7, 1e-7
    w = fluid.from_modes({(degree, order): 1.0})
    eigenvalue = degree * (degree + 1)
    frequency = a * order * np.sqrt((eigenvalue - 2) / eigenvalue)
    S = generators(N)[2]
    t = 2.0
    found = last(s, np.stack([a * S, small * w]), t, 1 / 16, co.IsospectralGauss(3))
    size = np.abs(w).max()
    assert np.abs(found[1] / small - np.cos(frequency * t) * w).max() < 1e-5 * size
    # Theta' = [P, a S_3] with P = -w cos / eigenvalue
    moved = (w @ S - S @ w) * (-a / eigenvalue) * np.sin(frequency * t) / frequency
    assert np.abs((found[0] - a * S) / small - moved).max() < 1e-5 * np.abs(moved).max()


def test_account_of_forces_on_the_layers():
    s = co.systems.reduced_mhd(N=6)
    X = random_state(s)
    both = s.with_forces(co.forces.Friction(lambda l: 0.1 * l, layer="carried"), co.forces.Viscosity(0.01))
    sol = co.integrate(both, X, (0, 2), 0.0625, co.IsospectralGauss(2))
    assert sorted(sol.balance()) == ["energy", "tr Theta^2", "tr W Theta"]
    assert max(sol.balance()["tr Theta^2"], sol.balance()["tr W Theta"]) < 1e-13
    assert sol.balance()["energy"] < 1e-5 < 1e-2 < sol.change()["energy"]
    assert np.abs(sol.work["Viscosity"]["tr Theta^2"]).max() == 0.0
    step = co.methods.Forced(co.IsospectralGauss(2)).step(both, X, 0.0, 0.0625)
    assert np.abs(sol.x[1] - step).max() < 1e-14


@ALL
def test_vectors_beside_the_algebra_are_taken_as_the_nearest_states(s):
    """Functions that need coordinates move them freely; nothing depends on the part that is no state."""
    rng = np.random.default_rng(6)
    x = rng.standard_normal(s.dim)
    near = s.to_vector(s.algebra.projected(s.from_vector(x)))
    assert np.abs(near - x).max() > 0.1
    # Projections of numbers of order one, and products of N of them.
    for look in (s.hamiltonian.value, s.hamiltonian.gradient, s.vector_field, s.energy, s.structure_matrix):
        np.testing.assert_allclose(look(x), look(near), rtol=1e-13, atol=1e-12)
    hessian = s.hamiltonian.hessian(x)
    np.testing.assert_allclose(hessian @ x, s.hamiltonian.gradient(x), rtol=0, atol=1e-12)
    np.testing.assert_allclose(hessian, hessian.T, rtol=0, atol=1e-13 * np.abs(hessian).max())
    for trace in s.casimirs.values():
        assert trace(x) == pytest.approx(trace(near), rel=1e-12, abs=1e-12)


@ALL
def test_the_rank_is_that_of_the_structure_matrix(s):
    singular = np.linalg.svd(s.structure_matrix(random_state(s, seed=4)), compute_uv=False)
    assert s.generic_rank() == np.count_nonzero(singular > 1e-9 * singular[0])


@ALL
def test_members_are_stacks_of_states_and_no_more(s):
    X = np.stack([random_state(s, seed) for seed in (1, 2)])
    np.testing.assert_array_equal(s.read(X), [s.read(one) for one in X])
    for wrong in (X[None], X[:, :1], X[..., :-1], X[0, 0]):
        with refused(ValueError, "x0", wrong.shape):
            s.read(wrong)


@ALL
def test_the_equation(s):
    X = random_state(s)
    theta, W = X
    P = s.stream(W)
    J = 0 * P if s.second_stream is None else s.second_stream(theta)
    field = s.vector_field(X)
    assert np.abs(field[0] - (P @ theta - theta @ P)).max() < 1e-14
    assert np.abs(field[1] - (P @ W - W @ P + J @ theta - theta @ J)).max() < 1e-13
    assert np.array_equal(s.from_vector(s.vector_field(s.to_vector(X))), field)
    method = co.IsospectralGauss(2)
    found, step = last(s, X, 0.125, 0.125, method), method.step(s, X, 0.0, 0.125)
    assert np.abs(found - step).max() < 64 * s.algebra.N * UNIT_ROUNDOFF * np.abs(X).max()


def test_the_inverse_of_a_multiple_of_a_stream():
    """The steps take the same field as Python."""
    stream = co.systems.sphere_euler(N=5).stream
    doubled = co.systems.DiagonalSolve(stream.main, stream.beside, 2.0 * stream.factor)
    s = TwoLayerSystem(co.MatrixAlgebra("su", 5), doubled, doubled.inverted(), energy_sign=-1)
    X = random_state(s)
    moved = co.stepper(s, co.IsospectralGauss(2), 2.0**-10)(X) - X
    middle = 2.0**-10 * s.vector_field(X + moved / 2)
    np.testing.assert_allclose(moved, middle, rtol=0, atol=1e-6 * np.abs(moved).max())


LAYERS = ((3.0, -2.0, 0.0), (-2.0, 3.0, -1.0), (0.0, -1.0, 1.0))
SEVERAL_MATRICES = {
    "mhd": lambda unit: co.systems.reduced_mhd(N=12),
    "mhd on the torus": lambda unit: co.systems.reduced_mhd(N=9, surface="torus"),
    "dye": lambda unit: co.systems.passive_scalar(N=12, rotation=2.0 * unit),
    "thermal": lambda unit: co.systems.thermal_qg(N=12, gamma=3.0, rotation=unit),
    "layers": lambda unit: co.systems.layered_qg(N=12, gamma=LAYERS, rotation=0.5 * unit),
    "layers on the torus": lambda unit: co.systems.layered_qg(N=9, gamma=LAYERS, surface="torus"),
}


@pytest.mark.parametrize("name", SEVERAL_MATRICES)
@pytest.mark.parametrize("unit, t0, h", [(1.0, 0.0, 0.02), (1e-3, 5.0, -0.02), (1e3, -1.0, 0.02)])
def test_compiled_midpoint_steps_of_several_matrices_solve_the_equations_of_numpy(name, unit, t0, h, tmp_path):
    """Twenty steps, of which each is predicted from those before it; resumed with the same bits."""
    system, gauss, h = SEVERAL_MATRICES[name](unit), co.IsospectralGauss(), h / unit
    fluid = getattr(co.systems, "torus_euler" if "torus" in name else "sphere_euler")(N=system.algebra.N)
    x0 = unit * np.stack([fluid.random(seed=k, degrees=(1, 4)) for k in range(system.matrix_shape[0])])
    sol = co.integrate(system, x0, (t0, t0 + 20 * h), abs(h), gauss)
    x = x0
    for k in range(20):
        x = gauss.step(system, x, t0 + k * h, h)
    assert np.abs((sol.x[-1] - x) / np.abs(x).max(axis=(1, 2), keepdims=True)).max() < 1e-12
    assert max(sol.drift()[invariant] for invariant in system.quadratic_casimirs) < 1e-13
    co.integrate(system, x0, (t0, t0 + 9 * h), abs(h), gauss, archive=tmp_path / "run.zarr")
    co.resume(tmp_path / "run.zarr", t0 + 20 * h)
    np.testing.assert_array_equal(np.asarray(co.load(tmp_path / "run.zarr").x)[-1], sol.x[-1])
