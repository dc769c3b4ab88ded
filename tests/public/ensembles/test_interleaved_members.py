"""Batches whose members, in turn, have tables of different structures."""

import numpy as np
import pytest

import coadjoint as co

STEP, T0 = 0.125, 1.5
FULL = np.array([[1.0, 0.2, 0.1], [0.2, 0.6, 0.0], [0.1, 0.0, 0.3]])
# Members of one kind run together: 0 3 6, 1 5, 2 4.
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


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_members_at_any_time_and_in_subsets(method):
    times = T0 + np.array([0.0, 0.1, 0.375, 0.6, 0.61, 1.0])
    ready = prepared(BATCH, method, threads=2)
    whole, every = ready.run(X, (T0, T0 + 1), t_eval=times), ready.run(X, (T0, T0 + 1))
    at = every.at(times[::-1])
    for m, system in enumerate(SYSTEMS):
        alone = prepared(system, method)
        assert_member(whole, m, alone.run(X[m], (T0, T0 + 1), t_eval=times))
        own = alone.run(X[m], (T0, T0 + 1))
        assert_member(every, m, own)
        one = own.at(times[::-1])
        assert np.array_equal(at.x[:, m], one.x) and np.array_equal(at.attitude[:, m], one.attitude)
        assert np.array_equal(at.energy[:, m], one.energy)
