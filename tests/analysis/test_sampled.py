"""Signals of runs: each kind against the array it stands for, with times, members and channels."""

from functools import cache

import numpy as np
import pytest

import coadjoint as co
from coadjoint.analysis.signals import sampled

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
STARTS = np.array([[1.0, 0.2, 0.5], [0.1, 1.0, 0.2]])
OPTIONS = {"save_every": 3, "attitude": True, "observe": {"x3": lambda x: x[..., 2]}}


@cache
def run(several, on_grid, sense=1.0):
    """Return a run of 30 or 31 steps, of which every third is saved."""
    span = (2.0, 2.0 + sense * (3.0 if on_grid else 3.1))
    return co.integrate(BODY, STARTS if several else STARTS[1], span, 0.1, **OPTIONS)


# Signal, its array, whether it has channels.
KINDS = {
    "momentum": (None, lambda sol: sol.x, True),
    "attitude": ("attitude", lambda sol: sol.attitude.reshape(*sol.x.shape[:-1], 9), True),
    "energy": ("energy", lambda sol: sol.energy, False),
    "observed": ("x3", lambda sol: sol.x[..., 2], False),
    "component": (1, lambda sol: sol.x[..., 1], False),
    "function": (lambda x: x[..., 0] ** 2, lambda sol: sol.x[..., 0] ** 2, False),
    "complex function": (lambda x: x[..., :2] * (1 - 2j), lambda sol: sol.x[..., :2] * (1 - 2j), True),
}


@pytest.mark.parametrize(("on_grid", "sense"), [(True, -1.0), (False, 1.0)])
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_its_array(kind, several, on_grid, sense):
    signal, array, channels = KINDS[kind]
    sol = run(several, on_grid, sense)
    wanted = np.asarray(array(sol))[:11]
    for given in (signal, array(sol)):
        found = sampled(sol, given)
        np.testing.assert_array_equal(found.t, sol.t[:11])  # 31 steps: the last saved one is off the grid
        assert (found.members, found.channels) == (several, channels)
        wide = wanted if channels else wanted[..., None]
        np.testing.assert_array_equal(found.values, np.swapaxes(wide if several else wide[:, None], 0, 1))


def test_samples_are_taken_by_their_axes():
    t = np.arange(5) * 0.25
    samples = np.arange(30.0).reshape(5, 2, 3)
    assert sampled(t, samples).values.shape == (2, 5, 3)
    np.testing.assert_array_equal(sampled(t, samples).values, samples.swapaxes(0, 1))
    for given, channels in ((samples[:, :, 0], True), (samples[:, 0, 0], False)):
        found = sampled(t, given)
        assert (found.members, found.channels) == (False, channels)
        np.testing.assert_array_equal(found.values[0], given.reshape(5, -1))


@pytest.mark.parametrize("start", [0.0, 5.0, -3.0])
@pytest.mark.parametrize("step", [0.1, -0.1])
def test_only_the_last_time_may_be_off_the_grid(start, step):
    t = start + step * np.arange(40)
    for place in (0, 1, 20, 38):
        moved = t.copy()
        moved[place] += 1e-9
        with pytest.raises(ValueError, match="equidistant"):
            sampled(moved, t)
    for last in (t[-1] + 0.04, t[-1] - 0.04):
        assert len(sampled(np.append(t[:-1], last), t, min_count=39).t) == 39
        with pytest.raises(ValueError, match="at least 40"):
            sampled(np.append(t[:-1], last), t, min_count=40)
    assert len(sampled(t, t, min_count=40).t) == 40
    with pytest.raises(ValueError, match="at least 41"):
        sampled(t, t, min_count=41)


def test_what_is_no_signal_is_refused():
    t = np.arange(4.0)
    for bad in (np.inf, np.nan):
        with pytest.raises(ValueError, match=r"signal\[2, 1\]"):
            sampled(t, [[0.0, 1.0], [0.0, 1.0], [0.0, bad], [0.0, 1.0]])
    with pytest.raises(ValueError, match="equidistant"):
        sampled(np.ones(4), t)
    with pytest.raises(ValueError, match="at least one member and one channel"):
        sampled(t, np.zeros((4, 0)))
    with pytest.raises(ValueError, match=r"must be \(12, members\) or"):
        sampled(run(True, False), np.zeros(11))
    with pytest.raises(ValueError, match=r"must be \(12,\) or"):
        sampled(run(False, False), np.zeros((11, 2, 3)))
    for component in (3, -1):
        with pytest.raises(ValueError, match="from 0 to 2"):
            sampled(run(True, False), component)
    with pytest.raises(ValueError, match="'attitude', 'energy', 'x3'"):
        sampled(run(True, False), "x4")
    failed = co.integrate(BODY, STARTS, (0.0, 1.0), 0.1)
    failed.failed[1] = True
    with pytest.raises(ValueError, match="member 1 of the run failed"):
        sampled(failed)
