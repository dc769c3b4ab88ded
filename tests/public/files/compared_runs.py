"""Comparison of two solutions, bit for bit."""

import numpy as np


def same_bits(one, other):
    """Return whether two arrays are equal in every bit; the zeros of complex numbers may differ in their signs."""
    if one is None or other is None:
        return one is other
    one, other = np.asarray(one), np.asarray(other)
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    return np.array_equal(one, other, equal_nan=True) if np.iscomplexobj(one) else one.tobytes() == other.tobytes()


def assert_same_run(found, sol, invariants=True):
    """Compare every public part of two solutions; without functions that are not stored."""
    for name in ("t", "x", "energy", "attitude", "x0", "attitude0", "failed", "t_eval"):
        assert same_bits(getattr(found, name), getattr(sol, name)), name
    for name in ("casimirs", "observed", "initial") if invariants else ():
        one, other = getattr(found, name), getattr(sol, name)
        assert list(one) == list(other) and all(same_bits(one[key], other[key]) for key in other), name
    for name in ("change", "balance") if invariants else ():
        one, other = getattr(found, name)(), getattr(sol, name)()
        assert list(one) == list(other), name
        for key in other:
            assert same_bits(one[key].tenths, other[key].tenths) and same_bits(one[key].initial, other[key].initial)
    assert {name: list(done) for name, done in (found.work or {}).items()} == {
        name: list(done) for name, done in (sol.work or {}).items()
    }
    for name, done in (sol.work or {}).items():
        assert all(same_bits(found.work[name][key], values) for key, values in done.items())
    assert (found.t_span, found.step, found.save_every) == (sol.t_span, sol.step, sol.save_every)
    assert (found.method, found.watched, found.carried) == (sol.method, sol.watched, sol.carried)
    assert (found.stats.steps, found.stats.evaluations) == (sol.stats.steps, sol.stats.evaluations)
    assert (found.events is None) == (sol.events is None)
    if sol.events is not None:
        assert (found.events.names, found.events.coordinates) == (sol.events.names, sol.events.coordinates)
        for name in ("t", "x", "which", "member", "direction", "attitude"):
            assert same_bits(getattr(found.events, name), getattr(sol.events, name)), name
