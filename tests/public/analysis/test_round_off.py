"""Statistics of round-off: the numbers of an ensemble against their definitions."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

STARTS = np.array([[1.0, 0.2, 0.5], [-0.1, 1.0, 0.2], [30.0, -10.0, 20.0], [0.01, -0.02, 0.03], [0.3, 0.3, -0.9]])


@pytest.mark.parametrize("shape", [(6, 1), (6, 5), (6, 5, 3), (6, 5, 2, 2), (1, 4)])
def test_a_walk_has_the_numbers_of_its_definition(shape):
    rng = np.random.default_rng(len(shape))
    deviations = rng.normal(-0.3, 1.0, shape)
    deviations[-1].ravel()[-1] = -9.0  # the largest one is negative, and not the first
    for early in (0, shape[0] // 2, shape[0] - 1):
        walk = co.analysis.random_walk(deviations, early)
        means = np.array([member.mean() for member in deviations[-1]])
        assert walk.early == pytest.approx(np.sqrt((deviations[early] ** 2).mean()), rel=1e-14)
        assert walk.late == pytest.approx(np.sqrt((deviations[-1] ** 2).mean()), rel=1e-14)
        assert walk.worst == 9.0
        assert walk.growth == pytest.approx(walk.late / walk.early, rel=1e-15)
        wanted = means.mean() / (means.std() / np.sqrt(len(means))) if len(means) > 1 else 0.0
        assert walk.bias == pytest.approx(wanted, rel=1e-12)


def test_a_walk_from_nothing_grows_without_bound():
    assert co.analysis.random_walk(np.array([[0.0, 0.0], [1.0, 2.0]]), 0).growth == np.inf
    for early in (-1, 2):
        with refused(ValueError, "early"):
            co.analysis.random_walk(np.ones((2, 3)), early)
    for wrong in (np.ones(3), np.ones((3, 0))):
        with refused(ValueError, "shape"):
            co.analysis.random_walk(wrong, 0)


@pytest.mark.parametrize("batch", [False, True])
@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_round_off_of_members_of_all_sizes(batch, order):
    """By the definition, with the gradient and the system of each member, in whichever order they are."""
    bodies = [co.systems.rigid_body((1.0, 2.0, third)) for third in (2.5, 3.0, 2.2, 1.5, 2.9)][order]
    systems = bodies if batch else bodies[:1] * 5
    starts = STARTS[order]
    sol = co.integrate(co.batch(systems) if batch else systems[0], starts, (0, 4.0), 0.1, save_every=10)
    for early in (1, 3):
        found = co.analysis.round_off(sol, early)
        assert list(found) == ["energy", *sol.casimirs]
        for name, values in {"energy": sol.energy, **sol.casimirs}.items():
            relative = []
            for m, own in enumerate(systems):
                invariant = own.hamiltonian if name == "energy" else own.casimirs[name]
                size = np.linalg.norm(invariant.gradient(starts[m])) * np.linalg.norm(starts[m])
                relative.append((values[:, m] - values[0, m]) / size)
            wanted = co.analysis.random_walk(np.array(relative).T, early)
            for field in ("early", "late", "worst", "bias"):
                assert getattr(found[name], field) == pytest.approx(getattr(wanted, field), rel=1e-12), field


def test_orthogonality_and_spatial_momentum_by_their_definitions():
    top = co.systems.heavy_top()
    starts = np.random.default_rng(3).normal(size=(4, 6)) * [[1.0], [30.0], [0.1], [2.0]]
    sol = co.integrate(top, starts, (0, 3.0), 0.1, save_every=5, attitude=True)
    for size in (None, 3):
        g = sol.attitude[..., :size, :size]
        wanted = np.array([[one @ one.T - np.eye(len(one)) for one in members] for members in g])
        assert co.analysis.orthogonality(sol, size) == co.analysis.random_walk(wanted, 1)
    moved = co.integrate(top, starts, (0, 3.0), 0.1, save_every=5, attitude="coadjoint")
    assert co.analysis.spatial_momentum(moved).worst < 1e-12
    # Deviations of a thousandth, beside which the rounding of the products is nothing.
    moved.attitude[1:] *= 1.0 + 1e-3 * np.arange(1.0, len(moved.t))[:, None, None, None]
    relative = np.zeros((len(moved.t), 4, 6))
    for k, m in np.ndindex(len(moved.t), 4):
        K, x = moved.attitude[k, m], moved.x[k, m]
        off = K @ x - moved.attitude[0, m] @ moved.x[0, m]
        relative[k, m] = off / (np.linalg.norm(K, 2) * np.linalg.norm(x))
    found, wanted = co.analysis.spatial_momentum(moved), co.analysis.random_walk(relative, 1)
    for field in ("early", "late", "worst", "bias"):
        assert getattr(found, field) == pytest.approx(getattr(wanted, field), rel=1e-9)


def test_what_is_no_ensemble_is_refused():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    alone = co.integrate(body, STARTS[0], (0, 1.0), 0.1, attitude=True)
    ensemble = co.integrate(body, STARTS, (0, 1.0), 0.1, attitude=True)
    with refused(ValueError, "one trajectory"):
        co.analysis.round_off(alone)
    with refused(ValueError, "not of an ensemble"):
        co.analysis.orthogonality(alone)
    with refused(ValueError, "coadjoint"):
        co.analysis.spatial_momentum(ensemble)
    with refused(ValueError, "coadjoint"):
        co.analysis.spatial_momentum(co.integrate(body, STARTS[0], (0, 1.0), 0.1, attitude="coadjoint"))
    for size in (0, 4):
        with refused(ValueError, "size"):
            co.analysis.orthogonality(ensemble, size)


def test_invariants_that_are_functions_are_relative_to_their_largest_value_of_each_member():
    """The largest one of a member may be negative, and at any time."""
    system = co.LiePoissonSystem(co.algebras.A3_7(0.3), co.Quadratic([1.0, 0.5, 0.25]))
    sol = co.integrate(system, STARTS, (0, 0.4), 0.1)
    rng = np.random.default_rng(2)
    changed = rng.normal(size=sol.casimirs["log C"].shape)
    changed[2, 1] = -7.0
    sol.casimirs["log C"][:] = changed
    wanted = co.analysis.random_walk((changed - changed[0]) / np.abs(changed).max(axis=0), 2)
    found = co.analysis.round_off(sol, 2)["log C"]
    for field in ("early", "late", "worst", "bias"):
        assert getattr(found, field) == pytest.approx(getattr(wanted, field), rel=1e-12), field
