"""Partial steps equal full steps of that length, for every scheme and any other members."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs.partial_steps import PartialSteps

from .measures import U
from .schemes_under_test import pairs, schemes
from .systems_under_test import all_cases
from .test_same_bits import CHOSEN, attitude_of, ensemble_around

pytestmark = pytest.mark.thinned(6)

SOME = pairs({name: all_cases()[name] for name in (*CHOSEN, "sl(2), driven", "torus", "gl(3), transposed")})
STEP, FROM = 0.0625, 0.75
OWNED = ["Splitting 4", "GaussLegendre 2", "Taylor 6", "Splitting 2 free body", "RadauEnergy 2"]
LENGTHS = STEP * np.array([1.0, 0.5, 0.875, 0.3, 1e-3, 0.0, 1.0, 0.7])


def parts_of(system, method, step, attitude=False):
    ready = co.prepare(system, method, abs(step), attitude=attitude)
    return PartialSteps(system, method, ready.loops(step)), ready


def rows_at(ready, step, ensemble):
    """Return the initial states of an ensemble as rows of the loops."""
    start = ready.start(ensemble)
    return start.momenta, ready.loops(step).initial_groups(start.groups) * np.ones((len(ensemble), 1))


@pytest.mark.thinned(36)
@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("scheme", "case"), SOME)
def test_partial_step_equals_a_step_of_its_length(scheme, case, direction):
    method, (system, x0, _) = schemes()[scheme], all_cases()[case]
    attitude = attitude_of(method, system)
    parts, ready = parts_of(system, method, direction * STEP, attitude)
    momenta, groups = rows_at(ready, direction * STEP, ensemble_around(x0, len(LENGTHS)))
    times, lengths = np.full(len(LENGTHS), FROM), direction * LENGTHS
    moved, turned = parts.take(momenta, groups, times, lengths)
    size = np.abs(momenta).max()
    for i, length in enumerate(lengths.tolist()):
        if length == 0.0:
            assert np.abs(moved[i] - momenta[i]).max() <= 4 * U * size
            continue
        own, _ = parts_of(system, method, length, attitude)
        whole, element = own.take(momenta[i : i + 1], groups[i : i + 1], times[i : i + 1], lengths[i : i + 1])
        # Each angle of a flow, at most four, is rounded three times more; a step has at most some hundred flows.
        bound = 0.0 if abs(length) == STEP else 100 * 3 * 4 * U
        assert np.abs(moved[i] - whole[0]).max() <= bound * size
        if groups.size:
            assert np.abs(turned[i] - element[0]).max() <= bound * (1 + np.abs(element[0]).max())
        alone, there = parts.take(momenta[i : i + 1], groups[i : i + 1], times[i : i + 1], lengths[i : i + 1])
        assert np.array_equal(alone[0], moved[i]) and np.array_equal(there[0], turned[i])
    span = (FROM, FROM + direction * STEP)
    run = ready.run(ensemble_around(x0, len(LENGTHS)), span)
    assert np.array_equal(moved[0], run.x[1, 0]) and np.array_equal(moved[6], run.x[1, 6])


@pytest.mark.thinned(10)
@pytest.mark.parametrize("scheme", OWNED)
def test_owners_select_the_constants(scheme):
    method = schemes()[scheme]
    bodies = [co.systems.rigid_body((1.0, 2.0, 2.0 + m / 64)) for m in range(40)]
    rng = np.random.default_rng(5)
    owners = np.concatenate([rng.integers(0, 40, 90), [39] * 7, [0]])
    x, lengths = rng.standard_normal((len(owners), 3)), rng.uniform(0, 0.1, len(owners))
    times, none = np.zeros(len(owners)), np.empty((len(owners), 0))
    parts, _ = parts_of(co.batch(bodies), method, 0.1)
    moved, _ = parts.take(x, none, times, lengths, owners)
    for i, m in enumerate(owners.tolist()):
        alone, _ = parts_of(bodies[m], method, 0.1)[0].take(x[i : i + 1], none[:1], times[:1], lengths[i : i + 1])
        assert np.array_equal(alone[0], moved[i])


def test_members_of_other_structures_and_inputs():
    other = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.array([[1.0, 0.1, 0], [0.1, 2.0, 0], [0, 0, 3.0]])))
    plain = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.diag([1.0, 2.0, 3.5])))
    parts, _ = parts_of(co.batch([plain, other, plain]), co.Splitting(order=2), 0.1)
    x, owners = np.array([[1.0, 0.2, 0.1]] * 4), np.array([1, 0, 2, 1])
    moved, _ = parts.take(x, np.empty((4, 0)), np.zeros(4), np.array([0.05] * 4), owners)
    assert np.array_equal(moved[0], moved[3]) and np.array_equal(moved[1], moved[2])
    for system, row in ((other, 0), (plain, 1)):
        alone, _ = parts_of(system, co.Splitting(order=2), 0.1)[0].take(
            x[:1], np.empty((1, 0)), np.zeros(1), np.array([0.05])
        )
        assert np.array_equal(alone[0], moved[row])
    ready = co.prepare(co.systems.rigid_body((1, 2, 3)), None, 0.1, inputs=True)
    fields = np.array([[0.0, 0.1, 0.2], [0.3, 0.0, -0.1]])
    both = PartialSteps(ready.system, ready.method, ready.loops(0.1).at(fields))
    moved, _ = both.take(x, np.empty((4, 0)), np.zeros(4), np.full(4, 0.03), np.array([1, 0, 0, 1]))
    for m, row in ((0, 1), (1, 0)):
        one = PartialSteps(ready.system, ready.method, ready.loops(0.1).at(fields[m]))
        alone, _ = one.take(x[:1], np.empty((1, 0)), np.zeros(1), np.full(1, 0.03))
        assert np.array_equal(alone[0], moved[row])


def test_threads_and_chunks_do_not_change_bits(monkeypatch):
    system, method = co.systems.kovalevskaya_top(), co.Splitting(order=4)
    rng = np.random.default_rng(3)
    x, lengths = rng.standard_normal((1000, 6)), rng.uniform(0, 0.1, 1000)
    x[17, 2] = np.nan
    parts, ready = parts_of(system, method, 0.1)
    none, times = np.empty((1000, 0)), np.zeros(1000)
    once, _ = parts.take(x, none, times, lengths)
    assert np.isnan(once[17]).all() and np.isfinite(np.delete(once, 17, 0)).all()
    monkeypatch.setattr("coadjoint.runs.partial_steps.MAX_NUMBERS", 1000)
    again, _ = parts.take(x, none, times, lengths)
    several, _ = PartialSteps(system, method, ready.loops(0.1), workers=3).take(x, none, times, lengths)
    assert np.array_equal(once, again, equal_nan=True) and np.array_equal(once, several, equal_nan=True)


def test_partial_steps_with_forces_and_noise():
    body = co.systems.rigid_body(inertia=(1, 2, 3)).with_forces(co.forces.LinearDamping(0.1))
    parts, ready = parts_of(body, co.GaussLegendre(2), 0.1)
    x = np.array([[1.0, 0.2, 0.1]])
    rows = np.zeros((1, ready.loops(0.1).size))
    rows[:, :3] = x
    moved, _ = parts.take(rows, np.empty((1, 0)), np.zeros(1), np.array([0.03]))
    run = co.integrate(body, x[0], (0, 0.03), 0.03, co.GaussLegendre(2))
    assert np.array_equal(moved[0, :3], run.x[-1]) and moved[0, 3] == run.work["LinearDamping"]["energy"][-1]
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(0, 0, 1): -1.0}))
    bath = spin.with_forces(co.forces.HeatBath(0.1, 0.5, seed=1))
    with pytest.raises(ValueError, match=r"HeatBath .* noise"):
        parts_of(bath, co.Splitting(), 0.1)


def test_failed_partial_step_is_named():
    grows = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(1.0 + np.arange(3.0)))
    parts, _ = parts_of(grows, co.GaussLegendre(2), 0.1)
    x = np.full((2, grows.dim), 1e200)
    with pytest.raises(co.IntegrationError, match=r"length 0.05 from t = 0, .*member 0"):
        parts.take(x, np.empty((2, 0)), np.zeros(2), np.full(2, 0.05))


def test_partial_steps_of_bonds():
    # Full steps turn the bonds of a lattice in lanes, partial steps by blocks.
    lattice = co.systems.spin_lattice("square", (3, 2))
    rng = np.random.default_rng(2)
    x = rng.standard_normal((5, lattice.dim))
    parts, ready = parts_of(lattice, co.Splitting(order=2), 0.1)
    moved, _ = parts.take(x, np.empty((5, 0)), np.zeros(5), np.full(5, 0.1))
    assert np.abs(moved - ready.run(x, (0, 0.1)).x[1]).max() <= 100 * U * np.abs(x).max()
