"""Runs that went wrong are warned of, and no others: over the registry of systems, and where steps show nothing."""

import warnings
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co
from coadjoint.systems.registry import gallery_entry_of
from long import long_where

OVER_RUN = 0.05
"""Largest error over a run, or of an invariant, without a warning, as docs/accuracy.md states it."""
NAMES = [name for name in co.systems.names() if not co.systems.get(name).has_matrices]
COMPILED = ["double_spherical_pendulum", "gravitating_bodies", "rigid_molecules", "separable_cosh"]
"""Systems with functions, which take seconds to compile."""
METHODS = [None, co.GaussLegendre(1)]


def told(call):
    """Return the result of a call, and its warnings of large steps."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = call()
    return result, [str(one.message) for one in found if one.category is co.LargeStepWarning]


def scaled(x):
    """Return states (times, n) in units of their vectors of three, or coordinates; of the state if these start at 0."""
    size = np.abs(x)
    if x.shape[1] % 3 == 0:
        size = np.repeat(np.linalg.norm(x.reshape(len(x), -1, 3), axis=2), 3, axis=1)
    return x / np.where(size[0] > 0.0, size.max(axis=0), np.linalg.norm(x, axis=1).max())


def motion_of(x):
    """Return the largest distance from the start."""
    return max(np.linalg.norm(scaled(x) - scaled(x)[0], axis=1).max(), 1e-9)


def error_of(sol, fine):
    """Return the largest error of a run, relative to the motion."""
    if np.abs(sol.x).max() > 1e100:
        return np.inf
    both = scaled(np.concatenate([fine, sol.x]))
    return np.linalg.norm(both[len(fine) :] - both[: len(fine)], axis=1).max() / motion_of(fine)


def example(name):
    """Return a ready-made system with the start of its gallery entry, of one member, and its step."""
    entry = gallery_entry_of(name)
    system = co.systems.get(name, **entry.parameters)
    return system, np.array(entry.start(), dtype=float).reshape(-1, *system.shape)[0], entry.step


@pytest.mark.thinned(48)
@pytest.mark.parametrize("saved", ["every step", "every 50th", "blocks"])
@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("times", [1, 4, 16, 64])
@pytest.mark.parametrize("name", long_where(COMPILED, NAMES))
def test_errors_over_a_turn_are_warned_of_and_no_others(name, times, method, saved):
    """Of 60 steps of so many times the step of the gallery, or as many as move by four times the size of the motion.

    What is saved, and where members are computed, does not matter.
    """
    system, x0, step = example(name)
    h, steps = times * step, 60
    try:
        # An order of eight in small steps.
        fine = told(lambda: co.integrate(system, x0, (0, steps * h), h / 32, co.GaussLegendre(4), save_every=32))[0].x
        path, size = np.cumsum(np.linalg.norm(np.diff(scaled(fine), axis=0), axis=1)), motion_of(fine)
        steps = max(1, int(np.searchsorted(path, 4.0 * size)))
        sol, found = told(lambda: co.integrate(system, x0, (0, steps * h), h, method))
        if saved == "every 50th":
            assert told(lambda: co.integrate(system, x0, (0, steps * h), h, method, save_every=50))[1] == found
        if saved == "blocks":
            members = np.tile(x0, (3, *(1,) * x0.ndim))
            many = lambda: co.integrate_ensemble(system, members, (0, steps * h), h, method, members_per_block=2)  # noqa: E731
            assert len(told(many)[1]) == len(found)
    except co.IntegrationError:  # refused, which is no silence
        return
    error = error_of(sol, fine[: steps + 1])
    # Half steps show the error up to terms of the next order, in groups of coordinates; the loops show all invariants.
    if not OVER_RUN / 2.0 < error < 2.0 * OVER_RUN:
        lost = any(drift > OVER_RUN for drift in sol.drift().values())
        assert bool(found) == (error > OVER_RUN) or (found and lost), (error, found)


@pytest.mark.thinned(5)
@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("name", long_where(COMPILED, NAMES))
def test_slow_motions_are_not_warned_of(name, method):
    """In small steps the motion is slow, and its start may be where some coordinate turns."""
    system, x0, step = example(name)
    for run in (((0, 5e-3 * step), 1e-3 * step), ((3.0, 3.0 - 5e-3 * step), 1e-3 * step)):
        assert told(lambda run=run: co.integrate(system, x0, *run, method))[1] == []


ALIGNED = np.tile([0.0, 0.0, 1.0], 2)
RESTS = {
    "body": (co.systems.rigid_body((1, 2, 3)), (0, 0, 2.0)),
    "body, third axis in another unit": (co.systems.rigid_body((1e-7, 2e-7, 3e-7)), (0, 0, 2e-7)),
    "hanging top": (co.systems.heavy_top((1, 2, 3), (0, 0, 1)), (0, 0, 5.0, 0, 0, -1.0)),
    "spins": (co.systems.spin_lattice("chain", 2, field=(0, 0, 0.5)), ALIGNED),
    "Toda": (co.systems.toda(4), (0, 0, 0, 0, 1e-9, 1e-9, 1e-9)),
    "pendulum": (co.systems.double_spherical_pendulum(), (0, 0, -1, 0, 0, -1, 0, 0, 0, 0, 0, 0, 1)),
}


@pytest.mark.parametrize("name", long_where(["pendulum"], RESTS))
@pytest.mark.parametrize("push", [0.0, 1e-15])
def test_equilibria_are_not_warned_of(name, push):
    """Of steps with which rounding alone moves them."""
    system, x0 = RESTS[name]
    x0 = np.array(x0) + push * np.max(np.abs(x0)) * np.random.default_rng(1).standard_normal(len(x0))
    for method in (None, co.GaussLegendre(2)):
        if system.name == "double_spherical_pendulum":
            x0[-1] = 1.0
        assert told(lambda method=method: co.integrate(system, x0, (0, 10), 0.1, method))[1] == []


@pytest.mark.thinned(3)
@pytest.mark.parametrize("every", [1, 50, 400])
@pytest.mark.parametrize(("far", "steps"), [(0.6, 100), (6.0, 1200)])
def test_collisions_between_saved_points(far, steps, every):
    """Attitudes are wrong by more than 20 degrees after an impact, in long runs too; in small steps they are not."""
    pair, v = co.systems.rigid_molecules(count=2), 5.0
    turned = Rotation.from_euler("xyz", [[10, 20, 30], [-40, 50, 160]], degrees=True)
    x0 = pair.state([[0, 0, 0], [far, 0.02, 0.01]], [[v / 2, 0, 0], [-v / 2, 0, 0]], turned)
    run = (0, 0.4 * far / 0.6)
    h = run[1] / steps
    sol, found = told(lambda: co.integrate(pair, x0, run, h, save_every=every))
    ends = [
        told(lambda k=k: co.integrate(pair, x0, run, h / k, co.Splitting(4), save_every=k * steps))[0] for k in (20, 40)
    ]
    wrong, reference = (
        np.degrees((a.rotation[-1].inv() * ends[1].rotation[-1]).magnitude()).max() for a in (sol, ends[0])
    )
    assert reference < 0.1 and wrong > 10.0 and len(found) == 1
    assert told(lambda: co.integrate(pair, x0, run, h / 20, co.Splitting(4), save_every=20 * every))[1] == []


@cache
def two_bodies(eccentricity, unit=1.0):
    """Two bodies at the apocentre of an orbit with the period 2 pi, masses in a unit."""
    pair = co.systems.gravitating_bodies([np.array([1e-9] * 3) * unit] * 2, (unit, 1e-3 * unit), 1.0 / unit)
    speed = ((1 - eccentricity) / (1 + eccentricity) * 1.001) ** 0.5
    return pair, pair.state([[0, 0, 0], [1 + eccentricity, 0, 0]], velocities=[[0, 0, 0], [0, speed, 0]])


@pytest.mark.thinned(9)
@pytest.mark.parametrize("every", [1, 100])
@pytest.mark.parametrize("unit", [1.0, 1e-7, 1e20])
@pytest.mark.parametrize(("eccentricity", "wrong"), [(0.9, True), (0.93, True), (0.3, False)])
def test_orbits_whose_pericentre_is_lost(eccentricity, wrong, unit, every):
    """In masses of any unit; where points are saved does not matter to what the loops record."""
    pair, x0 = two_bodies(eccentricity, unit)
    sol, found = told(
        lambda: co.integrate(pair, x0, (0, 2 * np.pi), 2 * np.pi / 100, co.Splitting(2), save_every=every)
    )
    assert (sol.drift()["energy"] > 1.0) == wrong == bool(found)
    members = np.array([two_bodies(0.3, unit)[1], x0])
    many = told(
        lambda: co.integrate(pair, members, (0, 2 * np.pi), 2 * np.pi / 100, co.Splitting(2), save_every=every)
    )[1]
    assert bool(many) == wrong == any("member 1" in text for text in many)


def test_damping_and_driving_do_not_look_like_errors():
    """Forces bring in and take out many times the energy that is left; the balance shows errors of steps alone."""
    body = co.systems.rigid_body((1, 2, 3)).with_forces(
        co.forces.LinearDamping(1.0), co.forces.Torque(lambda t: np.array([0.0, 0.3 + 0.1 * np.sin(t), 0.0]))
    )
    sol, found = told(lambda: co.integrate(body, (0.1, 0.2, 0.1), (0, 2000), 0.1))
    assert max(abs(work["energy"]).max() for work in sol.work.values()) > 20 * abs(sol.energy[-1]) and found == []


@pytest.mark.parametrize("turn", [[0, 0, 0, 1], [1e-17, 0, 0, 1], [1e-9, 0, 0, 1]])
def test_products_of_axes_that_vanish_at_the_start_are_not_lost(turn):
    """Their rounding errors have the size of the axes, not of the terms of their products at the start."""
    body = co.systems.body((1.0, 2.0, 2.5))
    x0 = body.state(turn, angular_velocity=(0.3, 0.2, 0.5))
    for end in (20.0, -20.0):
        assert told(lambda end=end: co.integrate(body, x0, (0, end), 0.05))[1] == []


@pytest.mark.parametrize("forced", [False, True])
def test_a_suspected_run_is_checked_by_few_gradients_and_loops(monkeypatch, forced):
    """Six gradients for the size of an energy, and no loops of half a step for the error of a step."""
    from coadjoint.runs import error_estimates
    from coadjoint.runs.measured_steps import MeasuredSteps
    from coadjoint.runs.prepared_run import PreparedRun

    counts, gradients_at, loops = [], error_estimates.gradients_at, PreparedRun.loops
    monkeypatch.setattr(error_estimates, "gradients_at", lambda s, x, t: counts.append(len(x)) or gradients_at(s, x, t))
    body = co.systems.heavy_top()
    body = body.with_forces(co.forces.LinearDamping(1e-3)) if forced else body
    sol, found = told(lambda: co.integrate(body, (1.0, 0.0, 2.0, 0.1, 0.0, 1.0), (0, 64), 0.64, co.Splitting()))
    assert counts == [6] and found
    steps = []
    monkeypatch.setattr(PreparedRun, "loops", lambda self, h: steps.append(abs(h)) or loops(self, h))
    MeasuredSteps(sol, None)
    assert set(steps) == {0.64}
