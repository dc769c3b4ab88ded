"""Events of runs in archives and of ensembles in blocks: on disk, resumed, with functions, and from damaged files."""

import hashlib
import io
import itertools
import json
import os
import shutil
import time

import numpy as np
import pytest
from storing import BODY, STARTS, STEP, T0, X, at_write, raising

import coadjoint as co
from hostile_archives import edit_attributes, write_marker
from refusals import refused
from same_runs import check_same

pytestmark = pytest.mark.usefixtures("no_fsync")

SPAN = (0.0, 40.0)
ENDING = co.Event("x1", terminal=True, count=2)
MANY = np.random.default_rng(6).standard_normal((11, 3))


@pytest.mark.parametrize("sense", [1, -1])
def test_times_on_disk_are_those_of_the_closed_form(tmp_path, sense):
    """x1 + i x2 of a symmetric body turns at the rate (1 / I - 1 / I3) x3, so that x1 vanishes twice in each period."""
    spins, path = np.array([0.75, 1.0, 1.5, 2.25]), tmp_path / "many.zarr"
    x0 = np.stack([np.full(4, 0.5), np.zeros(4), spins], axis=1)
    plate, event = co.systems.rigid_body(inertia=(1, 1, 2)), co.Event("x1", terminal=True, count=3)
    span = (T0, T0 + 32 * sense)
    co.integrate_ensemble(plate, x0, span, STEP, events=event, archive=path, members_per_block=3)
    found, quarters = co.load(path).events, np.array([1, 3, 5]) * np.pi / 2.0
    # The flow is exact; each of up to 256 steps rounds, and the time itself.
    within = {"rtol": 0.0, "atol": 256 * 2.0**-53 * (T0 + 32)}
    np.testing.assert_allclose(found.t.reshape(4, 3), T0 + sense * quarters / (0.5 * spins[:, None]), **within)
    np.testing.assert_array_equal(found.ends(4), found.t.reshape(4, 3)[:, 2])
    data = co.open_archive(path).to_xarray()
    np.testing.assert_array_equal(data["event_time"], found.t)
    np.testing.assert_array_equal(data["event_member"], np.repeat(np.arange(4), 3))


def long_run():
    """Return a run of several chunks whose members end at different times, or never."""
    states = np.multiply.outer(np.linspace(0.5, 1.0, 171), X)
    events = [co.Event("x2", terminal=True, count=24), co.Event("x2", direction=1, name="up")]
    return {"system": BODY, "x0": states, "t_span": (0.0, 400.0), "step": STEP, "events": events}


@pytest.mark.parametrize("file", ["c.1.0.0", "c.2.0.0", "c.3.0"])
def test_interrupted_runs_resume_with_their_events(tmp_path, file):
    """Twice; the crossings in between are those of the steps that are committed."""
    path, expected = tmp_path / "run.zarr", co.integrate(**long_run())
    assert 0 < np.isfinite(expected.events.ends(171)).sum() < 171
    for run in (lambda: co.integrate(**long_run(), archive=path), lambda: co.resume(path)):
        with at_write(lambda name: name == file, 1, raising(KeyboardInterrupt)), pytest.raises(KeyboardInterrupt):
            run()
        partial = co.open_archive(path)
        assert 0 < partial.reached < 3200 and len(partial.events)
        committed = expected.events.chosen(expected.events.t <= partial.reached * STEP)
        np.testing.assert_array_equal(partial.events.t, committed.t)
        np.testing.assert_array_equal(partial.events.x, committed.x)
    check_same(co.resume(path), expected, work=False)


def test_interrupted_blocks_resume_with_their_events(tmp_path):
    path, expected = tmp_path / "many.zarr", co.integrate(BODY, MANY, SPAN, STEP, events=ENDING)
    run = {"system": BODY, "x0": MANY, "t_span": SPAN, "step": STEP, "events": ENDING, "archive": path}
    with at_write(lambda name: name == "block-000001", 1, raising(KeyboardInterrupt)):
        with pytest.raises(KeyboardInterrupt) as stopped:
            co.integrate_ensemble(**run, members_per_block=4)
    partial = stopped.value.partial
    np.testing.assert_array_equal(partial.events.t, expected.events.t[expected.events.member < 4])
    for other in ({"events": co.Event("x1", terminal=True)}, {"events": None}):
        with refused(ValueError, "another ensemble", "events"):
            co.integrate_ensemble(**{**run, **other})
    check_same(co.integrate_ensemble(**run), expected)
    check_same(co.resume(path), expected)


def test_members_that_have_ended_cost_nothing(tmp_path):
    """All end in the first of a million steps; the bits are those of the run in memory."""
    x0 = np.tile((0.01, 1.0, 0.5), (64, 1))
    event = co.Event(co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -0.02}), terminal=True)
    run = {"system": BODY, "x0": x0, "t_span": (0.0, 1e5), "step": 0.1, "save_every": 10**5, "events": event}
    expected, began = co.integrate(**run), time.process_time()
    check_same(co.integrate_ensemble(**run, members_per_block=16), expected)
    assert np.isfinite(expected.events.ends(64)).all() and time.process_time() - began < 10.0


def level(height):
    def above(x, t):
        return x[1] - height * np.cos(t)

    return above


def corner(matrix):
    return float(matrix[0, 0].imag)


FLUID = co.systems.sphere_euler(4)
FUNCTIONS = {
    "one": ((BODY, STARTS[1]), co.Event(level(0.5), terminal=True, count=3, name="level")),
    "members": ((BODY, STARTS), [co.Event("x1"), co.Event(level(0.5), name="level")]),
    "matrix": ((FLUID, 3.0 * FLUID.random(seed=1)), co.Event(corner, name="corner")),
}


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_given_again(tmp_path, name):
    """They are not stored; other ones, with other numbers, and none are refused by name."""
    (system, x0), events = FUNCTIONS[name]
    path, what = tmp_path / "run.zarr", "corner" if name == "matrix" else "level"
    expected = co.integrate(system, x0, (0.0, 10.0), STEP, events=events)
    assert len(expected.events)
    co.integrate(system, x0, (0.0, 2 * STEP), STEP, events=events, archive=path)
    for other in (None, co.Event("x1") if name != "matrix" else [], co.Event(lambda x: 1.0 + 0.0 * x[0], name="other")):
        with refused(ValueError, what, "events"):
            co.resume(path, 10.0, events=other)
    if name == "one":
        with refused(ValueError, what, "differs"):
            co.resume(path, 10.0, events=co.Event(level(0.25), terminal=True, count=3, name="level"))
    co.resume(path, 10.0, events=events, until=30)
    check_same(co.resume(path, events=events), expected, work=False)
    assert co.open_archive(path).events.asked[-1].terminal == (name == "one")


@pytest.mark.parametrize("g", ["sin(2 * x2) - 0.25", "x1^2 - 0.01", "x1 / (2 + x3)"])
def test_formulas_are_stored(tmp_path, g):
    event, path = co.Event(co.formula(g, dim=3), name="g"), tmp_path / "run.zarr"
    expected = co.integrate(BODY, X, SPAN, STEP, events=event)
    assert len(expected.events)
    co.integrate(BODY, X, (0.0, 2 * STEP), STEP, events=event, archive=path)
    check_same(co.resume(path, SPAN[1]), expected, work=False)


def test_functions_of_events_on_processes(tmp_path):
    events, path = [co.Event(level(0.5), name="level"), ENDING], tmp_path / "many.zarr"
    run = {"system": BODY, "x0": MANY, "t_span": SPAN, "step": STEP, "events": events}
    with at_write(lambda name: name == "block-000001", 1, raising(KeyboardInterrupt)):
        with pytest.raises(KeyboardInterrupt):
            co.integrate_ensemble(**run, archive=path, members_per_block=4)
    with refused(ValueError, "level", "events"):
        co.resume(path, workers=2)
    check_same(co.resume(path, events=events, workers=2), co.integrate(**run))


def test_an_event_that_is_undefined_is_named_after_a_resumption(tmp_path):
    """A member fails; the failure is told when its block is resumed and finished."""

    def root(x, t):
        return np.sqrt(4.0 - t - x[0] * x[0]) - 5.0

    path, run = tmp_path / "many.zarr", (BODY, 0.1 * STARTS, (0.0, 8.0), STEP)
    events = [co.Event(root, name="root"), co.Event("x1")]
    with pytest.raises(co.IntegrationError) as whole:
        co.integrate(*run, events=events)
    co.integrate(*run[:2], (0.0, 2 * STEP), STEP, events=events, archive=path)
    co.resume(path, 8.0, events=events, until=48)
    with pytest.raises(co.IntegrationError) as resumed:
        co.resume(path, events=events)
    assert str(resumed.value) == str(whole.value) and "event root" in str(whole.value)
    check_same(resumed.value.partial, whole.value.partial, work=False)


def test_a_run_that_an_event_has_ended_has_no_later_end(tmp_path):
    path, expected = tmp_path / "run.zarr", co.integrate(BODY, X, SPAN, STEP, events=ENDING)
    assert expected.t[-1] == expected.events.t[-1] < 40.0
    found = co.integrate(BODY, X, SPAN, STEP, events=ENDING, archive=path)
    check_same(found, expected)
    assert found.finished and found.t_span == expected.t_span and found.reached == expected.stats.steps
    np.testing.assert_array_equal(found.at(found.t[-1]).x, expected.x[-1])
    check_same(co.resume(path), expected)
    with refused(ValueError, "t_end", "event"):
        co.resume(path, t_end=80.0)


def test_noise_has_no_events(tmp_path):
    stirred = BODY.with_forces(co.forces.HeatBath(0.1, temperature=0.5, seed=1))
    with refused(ValueError, "HeatBath"):
        co.integrate(stirred, X, SPAN, STEP, events=ENDING, archive=tmp_path / "run.zarr")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("damage", ["lost", "shape", "kind", "member", "order", "flipped", "attribute", "ended"])
@pytest.mark.parametrize("blocks", [False, True])
def test_damaged_crossings_are_refused(tmp_path, damage, blocks):
    """Numbers that no run writes, with matching checksums."""
    path = tmp_path / "run.zarr"
    run = {"system": BODY, "x0": MANY, "t_span": SPAN, "step": STEP, "events": ENDING, "archive": path}
    co.integrate_ensemble(**run, members_per_block=11) if blocks else co.integrate(**run)
    hidden = path / ".coadjoint"
    file = hidden / "block-000000" if blocks else max(hidden.glob("state-*"), key=lambda f: f.stat().st_mtime_ns)
    if damage in ("attribute", "ended"):
        edit_attributes(path, **({"events": "[1]"} if damage == "attribute" else {"ended_after": 3}))
    else:
        content = file.read_bytes()
        line, _, raw = content.partition(b"\n") if blocks else (b"", b"", content)
        with np.load(io.BytesIO(raw)) as opened:
            numbers = dict(opened)
        if damage == "lost":
            del numbers["event t"]
        elif damage == "shape":
            numbers["event x"] = numbers["event x"][:, :2]
        elif damage == "kind":
            numbers["event which"] = numbers["event which"].astype(float)
        elif damage == "member":
            numbers["event member"] += 5
        elif damage == "order":
            numbers["event member"] = numbers["event member"][::-1].copy()
        written = io.BytesIO()
        np.savez(written, **numbers)
        raw = written.getvalue()
        if damage == "flipped":
            middle = len(raw) // 2
            file.write_bytes(content[:-middle] + bytes([content[-middle] ^ 1]) + content[1 - middle :])
        elif blocks:
            head = json.loads(line.decode().partition(" ")[2])
            head |= {"bytes": len(raw), "numbers": hashlib.sha256(raw).hexdigest()}
            write_marker(path, 0, json.dumps(head), raw)
        else:
            states = json.loads(json.loads((path / "zarr.json").read_text())["attributes"]["archive_states"])
            states[-1][1] = hashlib.sha256(raw).hexdigest()
            file.write_bytes(raw)
            edit_attributes(path, archive_states=json.dumps(states))
    with refused(ValueError, "damaged"):
        assert co.open_archive(path).events is None


def test_copies_without_the_hidden_folder_say_where_the_events_are(tmp_path):
    path = tmp_path / "run.zarr"
    co.integrate(BODY, X, SPAN, STEP, events=ENDING, archive=path)
    shutil.rmtree(path / ".coadjoint")
    copied = co.load(path)
    assert copied.t[-1] < 40.0
    with refused(ValueError, "events", "archive"):
        _ = copied.events


@pytest.mark.parametrize("span", [(0.0, 8.0), (1.0, -7.0)])
@pytest.mark.thinned(2)
def test_resumption_at_every_step_finds_pairs_of_crossings(tmp_path, span):
    """x1 x1 - c passes zero and back within one step, next to any interruption; it ends the second member."""
    system, sense = co.systems.rigid_body(inertia=(1, 1, 2)), np.sign(span[1] - span[0])
    x0 = np.array([[0.5, 0.1, 2.0], [0.5, 0.3, 2.5], [0.4, 0.0, 1.5]])
    top = np.hypot(x0[:, 0], x0[:, 1])
    close = [co.Polynomial({(1, 0, 0): 1.0, (0, 0, 0): -float(r) * np.cos(0.05)}) for r in top]
    events = [co.Event(close[0]), co.Event(close[1], terminal=True, count=2), co.Event(close[2])]
    expected = co.integrate(system, x0, span, 0.25, events=events)
    assert len(expected.events[0]) >= 3 and np.isfinite(expected.events.ends(3)).any()
    path, first = tmp_path / "run.zarr", (span[0], span[0] + 0.5 * sense)
    co.integrate(system, x0, first, 0.25, events=events, archive=path)
    for until in itertools.chain(range(3, 32), [None]):
        found = co.resume(path, span[1], until=until)
    check_same(found, expected, work=False)
