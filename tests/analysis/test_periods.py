"""Periods of motions whose frequencies are known: many crossings of the plane, long and short, of any size."""

import numpy as np
import pytest

from coadjoint.analysis.periods import period


def oscillators(frequencies: np.ndarray, power: float = 1.0):
    """Return the field of plane rotations by commensurate frequencies, in 2 k coordinates."""

    def field(x):
        pairs = x[: 2 * len(frequencies)].reshape(-1, 2)
        return power * (frequencies[:, None] * np.stack([-pairs[:, 1], pairs[:, 0]], axis=1)).ravel()

    return field


def drawn(seed, k):
    phases = np.random.default_rng(seed).uniform(0.0, 2 * np.pi, k)
    return np.stack([np.cos(phases), np.sin(phases)], axis=1).ravel()


@pytest.mark.parametrize(("frequencies", "scale", "rate"), [((1, 3), 1e6, 1e-3), ((2, 3), 1e-7, -40.0)])
def test_commensurate_oscillators(frequencies, scale, rate):
    """The plane is crossed several times before the return, and the fast ones take many stretches of integration."""
    x0 = scale * drawn(len(frequencies), len(frequencies))
    found = period(oscillators(np.array(frequencies, float), rate), x0)
    # The integration has 2.5e-14 of error in each step, some 60 of which make one turn of the fastest oscillator.
    tolerance = 2.5e-14 * 60 * sum(frequencies)
    assert found.time == pytest.approx(2 * np.pi / abs(rate), rel=tolerance)
    assert 0.0 <= found.misfit < 1e-8 and found.carried.shape == (0,)


def test_the_time_and_an_area_are_carried_over_all_stretches():
    frequencies, x0, begin = np.array([1.0, 6.0]), drawn(1, 2), [5.0, -3.0]
    turning = oscillators(frequencies)
    found = period(lambda y: np.concatenate([turning(y), [1.0, y[2] ** 2]]), x0, begin)
    assert found.carried == pytest.approx(np.array(begin) + [found.time, np.pi], abs=1e-10)


def test_what_is_no_state_is_refused():
    with pytest.raises(ValueError, match=r"must be one state, \(n,\)"):
        period(lambda x: x, [[1.0, 0.0]])
    with pytest.raises(ValueError, match=r"must be one state, \(n,\)"):
        period(lambda x: x, [])
    with pytest.raises(ValueError, match="it must be finite"):
        period(lambda x: x / 0.0, [1.0, 2.0])
