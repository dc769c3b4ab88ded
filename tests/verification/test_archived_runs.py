"""Archived runs, interrupted and resumed, have the bits of uninterrupted runs, for every scheme."""

from __future__ import annotations

import itertools
import os
from collections import Counter

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives.resume import archive_run
from coadjoint.files.records.records import record_of
from coadjoint.methods.forced import check_supports
from coadjoint.runs.piecewise_run import PiecewiseRun
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.systems.batch import Batch

from .schemes_under_test import schemes
from .systems_under_test import all_cases

pytestmark = pytest.mark.thinned(6)

STEPS, STEP, T0 = 17, 0.05, 0.25
# Before the first step, within and at the points that are saved, and before the last step.
CUTS = ((0,), (1,), (4, 5), (8,), (3, 9, 16), (16,), (12,))
EVERY, THREADS, MEMBERS, DIRECTIONS = (1, 4, 5, 40), (1, 2, 3), (None, 1, 7), (1, -1, 1)
BODY, SPHERE = co.systems.rigid_body(inertia=(1, 2, 3)), co.systems.sphere_euler(4)
FORCED = {
    "body, damped": (BODY.with_forces(co.forces.LinearDamping(0.1)), [0.3, -1.0, 0.7]),
    "body, in a bath": (BODY.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4)), [0.3, -1.0, 0.7]),
    "sphere, stirred": (
        SPHERE.with_forces(co.forces.RandomForcing(0.25, band=(1, 2), seed=3), co.forces.Viscosity(0.05)),
        SPHERE.random(seed=1, degrees=(1, 3)),
    ),
}
OWN = {"Taylor 8 tolerance": co.Taylor(8, tolerance=1e-9)} | {
    f"ReversibleSteps {k}": method for k, method in enumerate(co.methods.registry.scheme("ReversibleSteps").examples())
}
"""Schemes of variable steps."""
# The loops hold those of one kind side by side, 0 2 3 1 4: an order that is not its own inverse.
INERTIAS = ((1, 2, 3), (3, 1, 2), (1, 2, 2.5), (1, 2, 2.75), (3, 1, 2.5))
BATCH = co.batch([co.systems.rigid_body(inertia) for inertia in INERTIAS])
TURNING = co.LiePoissonSystem(co.algebras.get("A4,6", a=1.0, b=0.5), co.Quadratic([1.0, 0.5, 0.25, 2.0]))


@pytest.fixture(autouse=True)
def without_waiting_for_the_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def is_stored(system):
    """Return whether a record contains the complete system, without user functions."""
    return "not_stored" not in record_of(system)


def systems():
    found = {name: (case.system, case.x0) for name, case in all_cases().items()}
    found |= {name: (system, np.array(x)) for name, (system, x) in FORCED.items()}
    return found | {
        "bodies": (BATCH, np.array([0.3, -1.0, 0.7])),
        "turning": (TURNING, np.array([0.5, 0.25, -0.5, 0.7])),
    }


def cases():
    """Yield every scheme with some systems that it supports, with random options."""
    known, turn, rng = systems(), 0, np.random.default_rng(1)
    for name, method in (schemes() | OWN).items():
        serving = [system for system, (moved, _) in known.items() if serves_all(method, moved)]
        # In turn, so that every system is combined with many schemes.
        for k in range(min(7, len(serving))):
            cuts, every, threads, members, direction = (
                choices[rng.integers(len(choices))] for choices in (CUTS, EVERY, THREADS, MEMBERS, DIRECTIONS)
            )
            system = serving[(turn + k) % len(serving)]
            one = known[system][0]
            members = None if isinstance(one, Batch) else members
            # Noise has no way back.
            direction = 1 if system in ("body, in a bath", "sphere, stirred") else direction
            attitude = attitude_of(method, one) if k % 2 == 0 else False
            yield pytest.param(
                method, system, cuts, every, threads, members, direction, attitude, id=f"{name}, {system}, {k}"
            )
        turn += 5


def serves_all(method, system):
    try:
        check_supports(system[0] if isinstance(system, Batch) else system, method)
    except (ValueError, TypeError):
        return False
    return True


def attitude_of(method, system):
    try:
        PreparedRun(system, method, STEP, attitude="coadjoint")
    except (ValueError, TypeError):
        return False
    return "coadjoint"


def assert_same(found, whole, same_work=True):
    """Compare all arrays of two solutions; the work is at least that of the whole run."""
    assert np.array_equal(found.t, whole.t)
    for name in ("x", "energy", "attitude", "x0", "attitude0", "failed"):
        one, other = getattr(found, name), getattr(whole, name)
        assert (one is None) == (other is None), name
        assert one is None or (one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)), name
    for one, other in ((found.casimirs, whole.casimirs), (found.observed, whole.observed)):
        assert list(one) == list(other)
        assert all(np.array_equal(one[name], other[name], equal_nan=True) for name in other)
    assert list(found.work) == list(whole.work)
    for force, done in whole.work.items():
        assert all(np.array_equal(found.work[force][name], values) for name, values in done.items())
    for one, other in ((found.change(), whole.change()), (found.balance(), whole.balance())):
        assert list(one) == list(other)
        for name, drift in other.items():
            assert np.array_equal(one[name].tenths, drift.tenths, equal_nan=True), name
            assert np.array_equal(one[name].initial, drift.initial), name
    assert found.t_span == whole.t_span and found.asked_span == whole.asked_span
    assert (found.step, found.save_every, found.watched, found.carried) == (
        whole.step,
        whole.save_every,
        whole.watched,
        whole.carried,
    )
    one, other = found.stats, whole.stats
    assert one.steps == other.steps and one.evaluations >= other.evaluations and one.iterations >= other.iterations
    assert not same_work or (one.evaluations, one.iterations) == (other.evaluations, other.iterations)


@pytest.mark.thinned(134)
@pytest.mark.parametrize(
    ("method", "name", "cuts", "every", "threads", "members", "direction", "attitude"), list(cases())
)
def test_resumed_run_equals_uninterrupted_run(
    tmp_path, method, name, cuts, every, threads, members, direction, attitude
):
    system, x = systems()[name]
    x0 = x if members is None else np.multiply.outer(1.0 - 0.03 * np.arange(members), x)
    span = (T0, T0 + direction * STEPS * STEP)
    watch = len(cuts) != 2
    whole = co.integrate(system, x0, span, STEP, method, save_every=every, attitude=attitude, watch=watch, threads=1)
    ready = PreparedRun(system, method, STEP, attitude=attitude, watch=watch, threads=threads)
    path, given = tmp_path / "run.zarr", None if is_stored(system) else system
    found = archive_run(ready, x0, span, every, path, until=cuts[0])
    for cut in cuts[1:]:
        assert not found.finished and found.reached < cut
        found = co.resume(path, system=given, threads=1 + cut % 3, until=cut)
        assert found.reached == cut
    assert not found.finished and len(found.t) == np.count_nonzero(whole.record.times.saved <= cuts[-1])
    assert np.array_equal(found.x, whole.x[: len(found.t)], equal_nan=True)
    found = co.resume(path, system=given, threads=threads)
    assert found.finished
    # Variable steps end at a step of the run only where it is watched or interrupted.
    assert_same(found, whole, same_work=watch or not method.own_steps)


@pytest.mark.long
def test_cases_cover_schemes_systems_and_options():
    """Every registered scheme, every system, and every pair of options."""
    found = [case.values for case in cases()]
    assert len(found) >= 300
    assert {type(method) for method, *_ in found} == set(map(co.methods.registry.scheme, co.methods.names()))
    met = Counter(system for _, system, *_ in found)
    assert met.keys() == systems().keys() and min(met.values()) >= 3, met
    for one, other in itertools.combinations(range(2, 8), 2):
        pairs = Counter((case[one], case[other]) for case in found)
        wanted = itertools.product({case[one] for case in found}, {case[other] for case in found})
        assert all(pairs[pair] for pair in wanted)
    assert any(cut % every for _, _, cuts, every, *_ in found for cut in cuts)


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(2)], ids=str)
@pytest.mark.parametrize("members", [None, 5])
def test_memory_holds_one_chunk_of_points(tmp_path, monkeypatch, method, members):
    """A commit between chunks makes no difference."""
    monkeypatch.setattr("coadjoint.files.archives.stored_arrays.MIN_CHUNK_ROWS", 8)
    monkeypatch.setattr("coadjoint.files.archives.stored_arrays.MAX_CHUNK_ROWS", 8)
    monkeypatch.setattr("coadjoint.files.archives.archived_run.FIRST_ADVANCE", 5)
    held, original = [], PiecewiseRun.piece
    monkeypatch.setattr(PiecewiseRun, "piece", lambda self: (held.append(len(self.run.saved["x"])), original(self))[1])
    system, x = systems()["e(3), heavy top"]
    x0 = x if members is None else np.multiply.outer(1.0 - 0.03 * np.arange(members), x)
    path, span = tmp_path / "run.zarr", (0.0, 300 * STEP)
    archive_run(PreparedRun(system, method, STEP), x0, span, 3, path, until=100)
    co.resume(path, until=107)
    assert_same(co.resume(path), co.integrate(system, x0, span, STEP, method, save_every=3))
    assert max(held) <= 8 and len(held) > 12 and len(list((path / "x").glob("c.*"))) == 13


LATER = [(17, 29), (17, 18), (40, 400), (170, 1000), (1000, 1001), (999, 2000)]


@pytest.mark.thinned(72)
@pytest.mark.parametrize(("steps", "later"), LATER)
@pytest.mark.parametrize("every", [1, 7, 50])
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(8, tolerance=1e-9)], ids=str)
@pytest.mark.parametrize(("direction", "watch", "pieces"), [(1, True, 1), (-1, True, 5), (1, False, 3)])
def test_later_end_equals_a_longer_run(tmp_path, monkeypatch, steps, later, every, method, direction, watch, pieces):
    """Points, and drifts in each of their tenths."""
    system, x0 = systems()["e(3), heavy top"]
    spans = [(T0, T0 + direction * count * STEP) for count in (steps, later)]
    options = {"save_every": every, "watch": watch}
    path = tmp_path / "run.zarr"
    ready = PreparedRun(system, method, STEP, watch=watch)
    cuts = [steps * piece // pieces for piece in range(1, pieces)] + [None]
    archive_run(ready, x0, spans[0], every, path, until=cuts[0])
    for cut in cuts[1:]:
        co.resume(path, until=cut)
    assert_same(co.open_archive(path), co.integrate(system, x0, spans[0], STEP, method, **options))
    middle = co.resume(path, spans[1][1], until=(steps + later) // 2)
    assert not middle.finished or later - steps == 1
    assert_same(co.resume(path), co.integrate(system, x0, spans[1], STEP, method, **options))


def test_run_without_steps_is_resumed(tmp_path):
    system, x0 = systems()["e(3), heavy top"]
    path, method = tmp_path / "run.zarr", co.GaussLegendre(2)
    found = co.integrate(system, x0, (1.0, 1.0), STEP, method, archive=path)
    assert found.finished
    assert_same(found, co.integrate(system, x0, (1.0, 1.0), STEP, method))
    assert_same(co.resume(path, 1.0 + 3 * STEP), co.integrate(system, x0, (1.0, 1.0 + 3 * STEP), STEP, method))


def test_unfinished_run_gets_another_end(tmp_path):
    system, x0 = systems()["e(3), heavy top"]
    path, method = tmp_path / "run.zarr", co.GaussLegendre(2)
    archive_run(PreparedRun(system, method, STEP), x0, (0.0, 100 * STEP), 3, path, until=41)
    found = co.resume(path, 60 * STEP)
    assert_same(found, co.integrate(system, x0, (0.0, 60 * STEP), STEP, method, save_every=3))
    assert co.resume(path, 60 * STEP).finished
    for end in (0.0, 41 * STEP, 59 * STEP, -100 * STEP):
        with pytest.raises(ValueError, match=r"t = 3 .*later end"):
            co.resume(path, end)
    with pytest.raises(ValueError, match="between two steps"):
        co.resume(path, 61.5 * STEP)
