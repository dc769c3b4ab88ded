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


@pytest.mark.thinned(2)
@pytest.mark.parametrize("period", [None, 0.5])
def test_a_controlled_attitude_near_its_target_is_not_warned_of(period):
    """All but the last changes are far below the error of a step at the start, which is far below the motion."""
    law = co.forces.Pointing(0.5, 1.5)
    sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(law if period is None else co.forces.Sampled(law, period=period))

    def run(angle, span, step):
        x0 = sat.state([angle, 0, 0, 1])
        return told(lambda: co.integrate(sat, x0, (0, span), step, save_every=round(0.5 / step)))

    for angle, span in ((0.0, 10), (1e-12, 100), (1e-6, 10), (1e-3, 50)):
        (coarse, found), (fine, _) = (run(angle, span, step) for step in (0.5, 2**-5))
        motion = np.abs(fine.x[:, :12] - fine.x[0, :12]).max()
        assert np.abs(coarse.x - fine.x)[:, :12].max() <= OVER_RUN * motion + 1e-14 and found == []


@pytest.mark.thinned(2)
@pytest.mark.parametrize("rate", [1e-2, 1e-3])
def test_a_spin_that_follows_a_slow_field_is_not_warned_of(rate):
    """The error of a step is twice the change in it, but the next steps undo it."""
    spins = co.systems.spin_lattice("chain", 2, field=lambda t: (np.sin(rate * t), 0.0, np.cos(rate * t)))
    ends, found = zip(
        *(told(lambda h=h: co.integrate(spins, ALIGNED, (0, 1 / rate), h, co.Splitting(2))) for h in (0.1, 0.02)),
        strict=True,
    )
    assert np.abs(ends[0].x[-1] - ends[1].x[-1]).max() < 0.1 * OVER_RUN
    assert not ends[0].step_error() <= 0.02 and found == ([], [])


@pytest.mark.parametrize(("t0", "direction"), [(0.0, 1), (3.0, -1)])
@pytest.mark.parametrize(("step", "wrong"), [(0.01, True), (1e-4, False)])
def test_molecules_that_collide_between_the_measured_points(t0, direction, step, wrong):
    """At 5 nm/ps the closest approach is one step of a hundred; the energy shows what it destroyed."""
    pair, v = co.systems.rigid_molecules(count=2), 5.0 * direction
    x0 = pair.state([[0, 0, 0], [1, 0, 0]], velocities=[[v, 0, 0], [-v, 0, 0]])
    sol, found = told(lambda: co.integrate(pair, x0, (t0, t0 + direction), step, co.Splitting(2)))
    assert (sol.drift()["energy"] > 100) == wrong == any("energy" in text for text in found)
    assert len(found) == wrong


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


def test_blocks_of_an_ensemble_return_what_they_lose(tmp_path):
    """Of long runs only the start is measured before they are computed, at the apocentres."""
    pair, starts = two_bodies(0.3)[0], np.array([two_bodies(e)[1] for e in (0.3, 0.3, 0.3, 0.9, 0.93, 0.3)])
    run, blocks = ((0, 24 * np.pi), 2 * np.pi / 100, co.Splitting(2)), {"members_per_block": 2, "save_every": 100}
    many, found = told(lambda: co.integrate_ensemble(pair, starts, *run, archive=tmp_path / "many.zarr", **blocks))
    lost = np.flatnonzero(many.drift()["energy"].members > 1.0)
    assert lost.tolist() == [3, 4] and len(found) == 1
    assert "member 4 (and of at least 1 others): energy" in found[0]
    assert told(lambda: co.integrate_ensemble(pair, starts, *run, archive=tmp_path / "many.zarr", **blocks))[1] == []
    assert told(lambda: co.integrate_ensemble(pair, starts[:3], *run, **blocks))[1] == []
    assert told(lambda: co.integrate(pair, starts, *run, save_every=100))[1][0][:80] == found[0][:80]


def magnets(x, t):
    """Return the torque of magnets against the change of the field in a body on an orbit."""
    a, b, c = 5e-5 * np.cos(1e-3 * t), 2e-5 * np.sin(1e-3 * t), 4e-5 * np.sin(1e-3 * t + 0.3)
    B0, B1, B2 = x[3] * a + x[6] * b + x[9] * c, x[4] * a + x[7] * b + x[10] * c, x[5] * a + x[8] * b + x[11] * c
    w0, w1, w2 = x[0] / 0.05, x[1] / 0.06, x[2] / 0.07
    m0, m1, m2 = 5e7 * (w1 * B2 - w2 * B1), 5e7 * (w2 * B0 - w0 * B2), 5e7 * (w0 * B1 - w1 * B0)
    out = np.zeros(len(x))
    out[0], out[1], out[2] = m1 * B2 - m2 * B1, m2 * B0 - m0 * B2, m0 * B1 - m1 * B0
    return out


def test_a_tumble_that_magnets_stop_is_warned_of_where_it_is_wrong():
    """Each step loses less than 2 per cent of its change; after 1000 s the attitude is off by 18 degrees."""
    sat = co.systems.body((0.05, 0.06, 0.07)).with_forces(co.forces.Torque(magnets))
    x0 = sat.state(angular_velocity=(0.1, 0.08, -0.12))
    fine = told(lambda: co.integrate(sat, x0, (0, 1000), 1 / 16, co.Splitting(4), save_every=16))[0]
    for h in (1.0, 0.25):
        sol, found = told(lambda h=h: co.integrate(sat, x0, (0, 1000), h, save_every=round(1 / h)))
        assert sol.step_error() < 0.02 and bool(found) == (error_of(sol, fine.x) > OVER_RUN) == (h == 1.0)


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
