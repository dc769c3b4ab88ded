"""Signals of runs: each kind against the array it stands for, with times, members and channels."""

from functools import cache

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

autocorrelation = co.spectra.autocorrelation
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
STARTS = np.array([[1.0, 0.2, 0.5], [0.1, 1.0, 0.2]])
OPTIONS = {"save_every": 3, "attitude": True, "observe": {"x3": lambda x: x[..., 2]}}
SAVED = 21


@cache
def run(several, on_grid, sense=1.0):
    """Return a run of 60 or 61 steps, of which every third is saved."""
    span = (2.0, 2.0 + sense * (6.0 if on_grid else 6.1))
    return co.integrate(BODY, STARTS if several else STARTS[1], span, 0.1, **OPTIONS)


KINDS = {
    "momentum": (None, lambda sol: sol.x),
    "attitude": ("attitude", lambda sol: sol.attitude.reshape(*sol.x.shape[:-1], 9)),
    "energy": ("energy", lambda sol: sol.energy),
    "observed": ("x3", lambda sol: sol.x[..., 2]),
    "component": (1, lambda sol: sol.x[..., 1]),
    "function": (lambda x: x[..., 0] ** 2, lambda sol: sol.x[..., 0] ** 2),
    "complex function": (lambda x: x[..., :2] * (1 - 2j), lambda sol: sol.x[..., :2] * (1 - 2j)),
}


@pytest.mark.parametrize(("on_grid", "sense"), [(True, -1.0), (False, 1.0)])
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_its_array(kind, several, on_grid, sense):
    """With 61 steps the last saved one is off the grid, and left out."""
    signal, array = KINDS[kind]
    sol = run(several, on_grid, sense)
    samples = np.asarray(array(sol))[:SAVED]
    if several and kind in ("energy", "observed", "component", "function"):
        samples = samples[..., None]  # of samples, the last axis is that of channels
    plain = autocorrelation(sol.t[:SAVED], samples)
    for given in (signal, array(sol)):
        found = autocorrelation(sol, given)
        assert np.array_equal(found.t, plain.t)
        np.testing.assert_array_equal(np.ravel(found.mean), np.ravel(plain.mean))
        np.testing.assert_array_equal(np.ravel(found.values), np.ravel(plain.values))


@pytest.mark.parametrize("start", [0.0, 5.0, -3.0])
@pytest.mark.parametrize("step", [0.1, -0.1])
def test_only_the_last_time_may_be_off_the_grid(start, step):
    t = start + step * np.arange(64)
    for place in (0, 1, 20, 62):
        moved = t.copy()
        moved[place] += 1e-9
        with refused(ValueError, "equidistant"):
            co.frequencies(moved, np.cos(t), count=1)
    for last in (t[-1] + 0.04, t[-1] - 0.04):
        longer = np.append(t, last + step)
        assert np.isfinite(co.frequencies(longer, np.cos(longer), count=1).frequency).all()
        with refused(ValueError, "at least 64"):
            co.frequencies(np.append(t[:-1], last), t, count=1)
    assert np.isfinite(co.frequencies(t, np.cos(t), count=1).frequency).all()


def test_what_is_no_signal_is_refused():
    t = np.arange(16.0)
    spoiled = np.zeros((16, 2))
    spoiled[2, 1] = np.nan
    failed = co.integrate(BODY, STARTS, (0.0, 2.0), 0.1)
    failed.failed[1] = True
    for given, named in (
        ((t, spoiled), ["signal[2, 1]"]),
        ((np.ones(16), t), ["equidistant"]),
        ((t, np.zeros((16, 0))), ["at least one"]),
        ((run(True, False), np.zeros(21)), ["(22, members)"]),
        ((run(False, False), np.zeros((21, 2, 3))), ["(22,)"]),
        ((run(True, False), 3), ["0 to 2", "3"]),
        ((run(True, False), -1), ["0 to 2", "-1"]),
        ((run(True, False), "x4"), ["'attitude', 'energy', 'x3'"]),
        ((failed,), ["member 1"]),
    ):
        with refused(ValueError, *named):
            autocorrelation(*given)
