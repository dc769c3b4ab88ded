"""A million steps: invariants drift like sqrt(t) with compensated sums (Brouwer's law), else at most linearly."""

import numpy as np
import pytest

import coadjoint as co

from .measures import U, drift_bounds, group_bound
from .systems_under_test import cases
from .test_attitude import in_space_axes

STEPS = 1_000_000
LONG = {
    "so(3), diagonal": 0.1,
    "so(3), full, axes turned": 0.1,
    "so(4), diagonal": 0.1,
    "e(3), heavy top": 0.1,
    "sl(2), diagonal": 0.05,
}


def walk(run, size, per_step):
    """Return six standard deviations of a random walk with `per_step` roundings of u times size in each step."""
    return 6 * U * size * np.sqrt(per_step * run.stats.steps)


def sizes_of(run):
    """Return |gradient| |x| for each invariant."""
    found = {}
    for name, what in {"energy": run.system.hamiltonian, **run.system.casimirs}.items():
        found[name] = max(float(np.linalg.norm(what.gradient(x)) * np.linalg.norm(x)) for x in run.x)
    return found


def turn_of_a_step(run):
    """Return |h D_u|, u = grad H: a compensated update rounds only increments, smaller than x by this factor."""
    system = run.system
    return max(run.step * np.linalg.norm(system.algebra.coadjoint(system.hamiltonian.gradient(x)), 2) for x in run.x)


def compensated_run(case, steps=STEPS):
    system, x0, _ = cases()[case]
    h, method = LONG[case], co.Splitting(order=2, compensated=True)
    run = co.integrate(system, x0, (0.0, steps * h), h, method, save_every=steps // 50)
    flows = run.stats.evaluations / run.stats.steps
    # In each flow the sine and the cosine are rounded, and their products with the components.
    allowed = {name: turn_of_a_step(run) * walk(run, size, 4 * flows) for name, size in sizes_of(run).items()}
    return run, allowed


@pytest.mark.thinned(2)
@pytest.mark.parametrize("case", LONG)
def test_casimirs_of_compensated_splitting_follow_brouwer(case):
    run, allowed = compensated_run(case)
    for name in run.system.casimirs:
        assert run.drift()[name] <= allowed[name], (name, float(run.drift()[name]), allowed[name])


@pytest.mark.thinned(2)
@pytest.mark.parametrize("case", LONG)
def test_plain_splitting_stays_within_the_linear_bound(case):
    system, x0, _ = cases()[case]
    h = LONG[case]
    run = co.integrate(system, x0, (0.0, STEPS * h), h, co.Splitting(order=2), save_every=STEPS // 50)
    bounds = drift_bounds(run)
    assert all(run.drift()[name] <= bounds[name] for name in system.casimirs)
    # The energy error does not grow from the first tenth to the last, up to a factor of two.
    assert run.drift()["energy"].growth < 2


@pytest.mark.parametrize("stages", [2, 4])
@pytest.mark.parametrize("case", ["so(3), full, axes turned", "so(4), diagonal"])
def test_quadratic_invariants_of_gauss_follow_brouwer(case, stages):
    system, x0, _ = cases()[case]
    count = STEPS // 4
    run = co.integrate(system, x0, (0.0, count * 0.1), 0.1, co.GaussLegendre(stages), save_every=count // 50)
    for name, size in sizes_of(run).items():
        # Each stage is settled to a few roundings of each component.
        assert run.drift()[name] <= walk(run, size, 16 * system.dim * stages), name


@pytest.mark.thinned(4)
@pytest.mark.parametrize("method", [co.Splitting(order=2), co.Splitting(order=2, compensated=True)])
@pytest.mark.parametrize("case", ["so(3), diagonal", "so(3), full, axes turned"])
def test_rotations_follow_brouwer(case, method):
    """Group elements are always compensated; the rounding of the momentum is added to that of A x."""
    system, x0, _ = cases()[case]
    run = co.integrate(
        system, x0, (0.0, STEPS * 0.05), 0.05, method, attitude=True, save_every=STEPS // 10, watch=False
    )
    flows = run.stats.evaluations / run.stats.steps
    per_step = 4 * 3 * flows
    orthogonality = max(np.max(np.abs(A.T @ A - np.eye(3))) for A in run.attitude)
    assert orthogonality <= walk(run, 3.0, per_step)
    moved = np.einsum("tij,tj->ti", run.attitude, in_space_axes(case, run.x))
    spatial = np.max(np.abs(moved - moved[0]))
    size = np.linalg.norm(x0)
    assert spatial <= (walk(run, 3.0 * size, per_step) if method.compensated else group_bound(run, size))


@pytest.mark.parametrize("case", ["so(4), diagonal", "e(3), heavy top"])
def test_coadjoint_matrix_follows_brouwer(case):
    system, x0, _ = cases()[case]
    method = co.Splitting(order=2, compensated=True)
    run = co.integrate(
        system, x0, (0.0, STEPS * 0.02), 0.02, method, attitude="coadjoint", save_every=STEPS // 10, watch=False
    )
    back = np.einsum("tij,tj->ti", run.attitude, run.x)
    size = max(np.linalg.norm(K) * np.linalg.norm(x) for K, x in zip(run.attitude, run.x, strict=True))
    flows = run.stats.evaluations / run.stats.steps
    assert np.max(np.abs(back - x0)) <= walk(run, size, 4 * system.dim * flows)
