"""Structure factors of spin models on crystals, against sums by hand, linear spin waves, and lattices by name."""

import itertools

import numpy as np
import pytest
from scipy.constants import physical_constants

import coadjoint as co

HBAR = physical_constants["reduced Planck constant in eV s"][0] * 1e15  # meV ps
OBLIQUE = co.spins.crystal(
    lattice=(3, 4, 5, 80, 95, 105), sites={"Fe": (0.1, 0.2, 0.3), "Ni": (0.45, 0.7, 0.85)}, space_group="P 1"
)
PATH = [(0, 0, 0), (1 / 2, -1 / 3, 1), (1, 2 / 3, 0)]


def directions(model, members=2, seed=1):
    x = np.random.default_rng(seed).standard_normal((members, model.dim // 3, 3))
    return (x / np.linalg.norm(x, axis=2, keepdims=True)).reshape(members, -1)


def by_hand(S, model, times, x):
    """Return the spectrum (3, k, m) without a window and the static sum (k,) of one run, from Cartesian positions."""
    q = 2 * np.pi * np.linalg.solve(model.crystal.lattice, S.q.T)  # a . q = 2 pi h
    spins = model.spin[:, None] * x.reshape(len(times), -1, 3)
    sums = np.einsum("tia,ik->akt", spins, np.exp(-1j * model.positions @ q))
    waves = np.exp(1j * np.outer(times, S.omega))
    step, count = abs(times[1] - times[0]), len(times)
    spectrum = step / (2 * np.pi * spins.shape[1] * count) * np.abs(sums @ waves) ** 2
    return spectrum, np.sum(np.abs(sums) ** 2, axis=(0, 2)) / (spins.shape[1] * count)


def coupled(size=(2, 3, 2), spin=None, J=0.3):
    model = co.systems.spins(OBLIQUE, size, spin={"Fe": 2, "Ni": 0.5} if spin is None else spin)
    return model.exchange(OBLIQUE.bonds(4)["1"], J).field((0.1, 0.2, 0.5))


DISORDERED = [
    coupled(J=J).substitute("Fe", 0.3, seed=seed, spin=3).vacancies(0.25, seed=seed)
    for J, seed in ((0.3, 1), (-0.2, 2))
]


@pytest.mark.parametrize("span", [(0.0, 4.0), (3.0, -1.0)])
@pytest.mark.parametrize("models", [[coupled()], [coupled(), coupled(J=-0.4)], DISORDERED])
def test_spectra_by_hand(models, span):
    """Sites of an oblique cell, spins of several lengths, vacancies that differ between members, and backward runs."""
    x0 = directions(models[0])
    system = models[0] if len(models) == 1 else co.batch(models)
    sol = co.integrate(system, x0, span, 0.05, save_every=5)
    S = co.spectra.structure_factor(sol, PATH, None)
    assert S.q.shape == (3, 3) and S.corners.tolist() == [0, 1, 2]
    steps = 2 * np.pi * np.linalg.solve(OBLIQUE.lattice, np.diff(S.q, axis=0).T)
    np.testing.assert_allclose(np.diff(S.distance), np.linalg.norm(steps, axis=0), rtol=1e-13)
    sums = [by_hand(S, models[m % len(models)], sol.t, sol.x[:, m]) for m in range(2)]
    expected, static = (np.mean(part, axis=0) for part in zip(*sums, strict=True))
    np.testing.assert_allclose(S.components, expected, rtol=1e-10, atol=1e-11 * expected.max())
    np.testing.assert_allclose(S.static, static, rtol=1e-11)
    np.testing.assert_allclose(S.intensity.sum(axis=1) * (S.omega[1] - S.omega[0]), static, rtol=1e-11)


@pytest.mark.parametrize("layout", [{"lattice": "square"}, {"lattice": "square", "shape": (4,)}])
def test_layouts_without_a_fitting_shape_are_refused(layout):
    ring = co.systems.spin_lattice("ring", 4)
    system = co.LiePoissonSystem(ring.algebra, ring.hamiltonian, layout=layout)
    sol = co.integrate(system, directions(ring), (0, 2), 0.05, save_every=4)
    with pytest.raises(ValueError, match=r"shape in layout of .* square has cells along 2 axes"):
        co.spectra.structure_factor(sol, [(0, 0), (1, 0)])


def body_centred(a=1.0):
    return co.spins.crystal(lattice=(a, a, 0.7 * a, 90, 90, 90), sites={"Mn": [(0, 0, 0), (1 / 2, 1 / 2, 1 / 2)]})


def test_spin_waves_of_an_antiferromagnet():
    """hbar omega = S sqrt((8 J + 2 D)^2 - (8 J cos(pi h) cos(pi k) cos(pi l))^2), of two sublattices and an easy axis.

    The Bragg peaks of the staggered order are those of odd h + k + l, with the height N S^2.
    """
    mn, J, D, spin = body_centred(4.87), 0.304, 0.05, 5 / 2
    model = co.systems.spins(mn, (4, 4, 4), spin=spin, units="meV")
    bond = next(bond for bond in mn.bonds(4) if bond.first != bond.second)
    model = model.exchange(bond, J).single_ion("Mn", np.diag([0, 0, -D]))
    neel = np.where(model.sites == 0, 1.0, -1.0)[:, None] * np.array([0.0, 0.0, 1.0])
    states = co.thermal_states(model, temperature=0.05, members=2, sweeps=200, seed=1, x0=neel.ravel())
    sol = co.integrate(model, states.x, (1, 21), 0.02, method=co.SphericalMidpoint(), save_every=5)
    S = co.spectra.structure_factor(sol, [(1, 0, 0), (2, 0, 0), (2, 1 / 2, 1 / 2), (2, 1, 1), (1, 0, 0)])
    energies = spin * np.sqrt((8 * J + 2 * D) ** 2 - (8 * J * np.cos(np.pi * S.q).prod(axis=1)) ** 2)
    found = S.omega[np.argmax(S.components[:2].sum(axis=0), axis=1)]
    assert np.all(np.abs(np.abs(found) - energies / HBAR) < 0.6 * (S.omega[1] - S.omega[0]))
    odd = np.all(np.isclose(S.q, np.rint(S.q)), axis=1) & np.isclose(S.q.sum(axis=1) % 2, 1)
    assert odd.tolist() == [k in (0, len(odd) - 1) for k in range(len(odd))]
    assert np.allclose(S.static[odd], 128 * spin**2, rtol=0.01) and S.static[~odd].max() < spin**2
    edges = 2 * np.pi / (4.87 * np.array([1, 1, 0.7]))
    steps = np.array([(1, 0, 0), (0, 1 / 2, 1 / 2), (0, 1 / 2, 1 / 2), (1, 1, 1)]) * edges
    assert np.allclose(np.diff(S.distance[S.corners]), np.linalg.norm(steps, axis=1), rtol=1e-13)


@pytest.mark.parametrize("scale", [1.0, 1e-7, 1e30])
def test_a_chain_of_a_crystal_is_the_chain_by_name(scale):
    crystal = co.spins.crystal(lattice=(scale, 2 * scale, 2 * scale, 90, 90, 90), sites={"Cu": (0, 0, 0)})
    model = co.systems.spins(crystal, (12, 1, 1)).exchange(crystal.bonds(scale)["1"], -0.7)
    chain = co.systems.spin_lattice("chain", 12, periodic=True, exchange=0.7)
    x0 = directions(model)
    a, b = (co.integrate(one, x0, (0, 8), 0.05, save_every=4) for one in (model, chain))
    one, other = co.spectra.structure_factor(a, [(0, 0, 0), (1, 0, 0)]), co.spectra.structure_factor(b)
    for name in ("omega", "intensity", "error", "components", "static"):
        reference = getattr(other, name)
        np.testing.assert_allclose(getattr(one, name), reference, rtol=1e-11, atol=1e-12 * np.abs(reference).max())
    np.testing.assert_allclose(scale * one.distance, other.distance, rtol=1e-14)


def test_archives_are_read_with_their_models(tmp_path):
    model = coupled()
    sol = co.integrate(model, directions(model), (0, 2), 0.05, save_every=4, archive=tmp_path / "run")
    S = co.spectra.structure_factor(sol, PATH)
    again = co.spectra.structure_factor(co.load(tmp_path / "run", system=model), PATH)
    assert np.array_equal(again.intensity, S.intensity)
    with pytest.raises(ValueError, match=r"no lattice in space; .* a model of co.systems.spins .*system="):
        co.spectra.structure_factor(co.load(tmp_path / "run"), PATH)


def test_forces_and_pictures():
    model = coupled().with_forces(co.forces.Gilbert(0.1))
    sol = co.integrate(model, directions(model), (0, 2), 0.05, save_every=4)
    S = co.spectra.structure_factor(sol, PATH)
    assert np.allclose(S.intensity.sum(axis=1) * (S.omega[1] - S.omega[0]), S.static, rtol=1e-11)
    axes = S.plot().axes[0]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["(0, 0, 0)", "(1/2, -1/3, 1)", "(1, 2/3, 0)"]
    # Labels side by side, or slanted where they would overlap.
    for path, slanted in ((PATH, False), ([(0, 0, 0), (5, 0, 0), (5, 1 / 3, 0), (5, 1 / 3, 1 / 2)], True)):
        axes = co.spectra.structure_factor(sol, path).plot().axes[0]
        axes.figure.canvas.draw()
        labels = axes.get_xticklabels()
        assert all((label.get_rotation() > 0) == slanted for label in labels)
        boxes = [label.get_window_extent() for label in labels]
        assert slanted or all(one.x1 < other.x0 for one, other in itertools.pairwise(boxes))


@pytest.mark.parametrize(
    ("words", "system", "path"),
    [
        (r"path is None, and <crystal of 2 sites .*, 2 x 3 x 2 cells, have no usual path", coupled(), None),
        (r"the corner \(0.25, 0.0, 0.0\), which does not fit <crystal.*, 2 x 3 x 2 cells", coupled(), [(0.25, 0, 0)]),
        (r"path has shape \(3,\); give corners \(corners, 3\)", coupled(), PATH[1]),
        (
            r"different lattices \(<crystal.*, 2 x 3 x 2 cells, and .*, 2 x 2 x 3 cells\)",
            co.batch([coupled(), coupled((2, 2, 3))]),
            PATH,
        ),
    ],
)
def test_what_is_refused(words, system, path):
    sol = co.integrate(system, directions(coupled()), (0, 2), 0.05, save_every=4)
    with pytest.raises(ValueError, match=words):
        co.spectra.structure_factor(sol, path)
