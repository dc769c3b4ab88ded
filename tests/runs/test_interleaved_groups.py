"""Batches whose members, in turn, have tables of different structures."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.loop import MemberBatch
from coadjoint.runs.piecewise_run import PiecewiseRun
from failing_parts import failing_parts

STEP, T0 = 0.125, 1.5
FULL = np.array([[1.0, 0.2, 0.1], [0.2, 0.6, 0.0], [0.1, 0.0, 0.3]])
# The order of the loops, 0 3 6 1 5 2 4, is not its own inverse.
KINDS = "ABCACBA"
X = np.random.default_rng(8).standard_normal((len(KINDS), 3))


def member(m, kind):
    scale = 1.0 + 0.1 * m
    if kind == "A":
        H = co.Quadratic(scale * np.array([1.0, 0.5, 0.25]))
    elif kind == "B":
        H = co.Quadratic(scale * FULL)
    else:
        H = co.Polynomial({(2, 0, 0): 0.5 * scale, (0, 3, 0): 0.1, (0, 0, 2): 0.2})
    return co.LiePoissonSystem(co.algebras.so(3), H, name=f"member {m}")


SYSTEMS = [member(m, kind) for m, kind in enumerate(KINDS)]
BATCH = co.batch(SYSTEMS)
METHODS = [co.Splitting(order=4), co.GaussLegendre(2)]


def prepared(system, method, **options):
    return co.prepare(system, method, STEP, attitude=True, observe={"x1": co.Polynomial({(1, 0, 0): 1.0})}, **options)


def assert_member(whole, m, alone):
    """Compare the member m of a run with the run of this member alone."""
    count = len(alone.t)
    for name in ("x", "energy", "attitude"):
        assert np.array_equal(getattr(whole, name)[:count, m], getattr(alone, name)), (name, m)
    assert np.array_equal(whole.casimirs["|x|^2"][:count, m], alone.casimirs["|x|^2"])
    assert np.array_equal(whole.observed["x1"][:count, m], alone.observed["x1"])
    for name, drift in alone.drift(relative=False).items():
        own = whole.drift(relative=False)[name]
        assert own.members[m] == drift and own.tenths[m].tolist() == drift.tenths.tolist()
        assert own.initial[m] == drift.initial


def test_members_are_in_several_groups():
    order = prepared(BATCH, METHODS[0]).loops(STEP).order
    assert order.tolist() == [0, 3, 6, 1, 5, 2, 4] and not np.array_equal(order, np.argsort(order))


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_events_end_members_at_their_own_times(way):
    events = [co.Event("x1", count=3), co.Event("x2", terminal=True, count=1)]
    ready = [prepared(BATCH, METHODS[0], threads=threads) for threads in (1, 2)]
    single = [prepared(system, METHODS[0]) for system in SYSTEMS]
    for end in (1.0, 60.0):
        span = (T0, T0 + way * end)
        again, whole = (each.run(X, span, save_every=3, events=events) for each in ready)
        assert np.array_equal(whole.x, again.x, equal_nan=True) and np.array_equal(whole.events.x, again.events.x)
        ends = whole.events.ends(len(X))
        assert 0 < np.isfinite(ends).sum() < len(X) if end == 1.0 else np.isfinite(ends).all()
        for m, own in enumerate(single):
            alone, found = own.run(X[m], span, save_every=3, events=events), whole.events.of(m)
            for name in ("t", "x", "which", "direction", "attitude"):
                assert np.array_equal(getattr(found, name), getattr(alone.events, name)), (name, m)
            going = ~(way * whole.t >= way * ends[m])
            assert np.array_equal(whole.x[going, m], alone.x[: going.sum()]) and np.isnan(whole.x[~going, m]).all()
            assert np.array_equal(whole.energy[going, m], alone.energy[: going.sum()])
            assert whole.drift(relative=False)["energy"].members[m] == alone.drift(relative=False)["energy"]


@pytest.mark.thinned(3)
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("m", [1, 4, 6])
def test_failed_crossing_does_not_affect_other_members(monkeypatch, m, way):
    ready, span, event = prepared(BATCH, METHODS[0]), (T0, T0 + 10 * way), co.Event("x2")
    whole = ready.run(X, span, events=event)
    step = int(abs(whole.events.of(m).t[1] - T0) / STEP)  # in which it crosses for the second time
    failing_parts(monkeypatch, m, T0 + way * STEP * step)
    with pytest.raises(co.IntegrationError, match=rf"for 1 of 7 members \(first: member {m}\)") as caught:
        ready.run(X, span, events=event)
    found, others = caught.value.partial, np.arange(len(X)) != m
    assert caught.value.step == step + 1 and np.array_equal(found.failed, ~others)
    assert np.array_equal(found.x[:, others], whole.x[:, others])
    assert np.array_equal(found.x[: step + 1, m], whole.x[: step + 1, m]) and np.isnan(found.x[step + 1 :, m]).all()
    for k in range(len(X)):
        assert np.array_equal(found.events.of(k).t, whole.events.of(k).t[: None if k != m else 1])
    assert np.array_equal(found.drift()["energy"].tenths[others], whole.drift()["energy"].tenths[others])


@pytest.mark.parametrize("done", [1, 2])
def test_interrupt_returns_finished_members(monkeypatch, done):
    ready, real, left = prepared(BATCH, METHODS[0], threads=1), MemberBatch.advance, [done]
    whole = ready.run(X, (T0, T0 + 2), save_every=3)

    def advance(member_batch, *given):
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt
        return real(member_batch, *given)

    monkeypatch.setattr(MemberBatch, "advance", advance)
    with pytest.raises(KeyboardInterrupt) as stopped:
        ready.run(X, (T0, T0 + 2), save_every=3)
    found = stopped.value.partial
    for m, kind in enumerate(KINDS):
        if kind in "ABC"[:done]:
            assert np.array_equal(found.x[:, m], whole.x[:, m]) and np.array_equal(
                found.energy[:, m], whole.energy[:, m]
            )
            drift = found.drift(relative=False)["energy"].members[m]
            assert drift == np.abs(whole.energy[:, m] - whole.energy[0, m]).max()
        else:
            assert np.isnan(found.x[:, m]).all() and np.isnan(found.energy[:, m]).all()


@pytest.mark.thinned(4)
@pytest.mark.parametrize("method", METHODS, ids=str)
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("resumed", [False, True])
def test_piecewise_runs_preserve_the_member_order(method, way, resumed):
    """Also between saved points."""
    ready, span = prepared(BATCH, method), (T0, T0 + 2.5 * way)
    whole, times, start = ready.run(X, span, save_every=3), ready.times_of(span, 3)[0], ready.start(X)
    run = PiecewiseRun(ready, times, start, 3)
    pieces, stops = [], [5, 7, 13, 20]
    while not run.is_over:
        until = min(run.reach, next(stop for stop in stops if stop > run.number))
        run.advance(until)
        pieces.append(run.piece())
        assert np.array_equal(run.run.state["status"], np.zeros(len(X)))
        stored = {name: np.array(value) for name, value in run.stored(begin_block=until == 7).items()}
        if resumed:
            stored |= {name: int(stored[name]) for name in ("state.version", "state.number")}
            run = PiecewiseRun(ready, times, start, 3, stored)
        else:
            run.release_points()
    for name in ("t", "x", "energy", "attitude"):
        found = np.concatenate([getattr(piece, name) for piece in pieces])
        assert np.array_equal(found, getattr(whole, name)), name
    for name, drift in whole.drift(relative=False).items():
        last = pieces[-1].drift(relative=False)[name]
        assert np.array_equal(last.tenths, drift.tenths) and np.array_equal(last.initial, drift.initial)
    assert np.array_equal(np.concatenate([piece.observed["x1"] for piece in pieces]), whole.x[..., 0])


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_members_at_any_time_and_in_subsets(method):
    times = T0 + np.array([0.0, 0.1, 0.375, 0.6, 0.61, 1.0])
    ready = prepared(BATCH, method, threads=2)
    whole, every = ready.run(X, (T0, T0 + 1), t_eval=times), ready.run(X, (T0, T0 + 1))
    some = ready.among(2, 6).run(X[2:6], (T0, T0 + 1), t_eval=times)
    assert np.array_equal(some.x, whole.x[:, 2:6]) and np.array_equal(some.attitude, whole.attitude[:, 2:6])
    at = every.at(times[::-1])
    for m, system in enumerate(SYSTEMS):
        alone = prepared(system, method)
        assert_member(whole, m, alone.run(X[m], (T0, T0 + 1), t_eval=times))
        own = alone.run(X[m], (T0, T0 + 1))
        assert_member(every, m, own)
        one = own.at(times[::-1])
        assert np.array_equal(at.x[:, m], one.x) and np.array_equal(at.attitude[:, m], one.attitude)
        assert np.array_equal(at.energy[:, m], one.energy)
