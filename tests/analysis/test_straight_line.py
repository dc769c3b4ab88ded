"""Slopes of series whose truth is known: how often does the uncertainty hold it, and how do deviations grow?"""

from collections.abc import Callable

import numpy as np
import pytest

from coadjoint.analysis.straight_line import straight_line

pytestmark = pytest.mark.thinned(3)

SAMPLES, SERIES = 1000, 200
T = np.arange(SAMPLES) * 0.1


def remembering(rng: np.random.Generator, memory: float) -> np.ndarray:
    """Return a stationary series that forgets over so many samples."""
    from scipy.signal import lfilter

    keep = np.exp(-1.0 / memory)
    start = rng.normal() / np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], rng.normal(size=SAMPLES), zi=[keep * start])[0]


NOISE: dict[str, tuple[Callable[[np.random.Generator], np.ndarray], tuple[float, float]]] = {
    "white": (lambda rng: rng.normal(size=SAMPLES), (-0.2, 0.2)),
    "a short memory": (lambda rng: remembering(rng, 10), (-0.1, 0.3)),
    "a memory of a twentieth": (lambda rng: remembering(rng, 50), (0.0, 0.6)),
    "a memory of a quarter": (lambda rng: remembering(rng, 250), (0.1, 0.9)),
    "a random walk": (lambda rng: np.cumsum(rng.normal(size=SAMPLES)), (0.2, 0.95)),
    "an accumulated walk": (lambda rng: np.cumsum(np.cumsum(rng.normal(size=SAMPLES))), (0.7, 1.9)),
    "an oscillation": (lambda rng: np.cos(rng.uniform(0.6, 5) * T + rng.uniform(0, 7)), (-0.3, 0.4)),
    "oscillations": (
        lambda rng: sum(rng.normal() * np.cos(rng.uniform(0.6, 5) * T + rng.uniform(0, 7)) for _ in range(4)),
        (-0.3, 0.4),
    ),
}


@pytest.mark.parametrize("kind", NOISE)
@pytest.mark.parametrize("slope", [0.0, -2.5])
def test_two_uncertainties_hold_the_slope(kind: str, slope: float) -> None:
    series, (low, high) = NOISE[kind]
    lines = [straight_line(T, series(np.random.default_rng(seed)) + slope * T + 3.0) for seed in range(SERIES)]
    z = np.array([(line.slope - slope) / line.uncertainty for line in lines])
    # Nine of ten; three standard deviations of a count of 200 is 6.4 of 100.
    assert np.mean(np.abs(z) < 2.0) > 0.9 - 0.064
    if kind in ("white", "a short memory"):
        assert np.sqrt(np.mean(z**2)) > 0.7, "not to the safe side by much, either"
    exponents = np.array([line.exponent for line in lines])
    assert np.mean((low < exponents) & (exponents < high)) > 0.97


def test_a_line_is_found_to_rounding() -> None:
    line = straight_line(T, 0.3 * T - 7.0)
    assert line.slope == pytest.approx(0.3, abs=1e-14) and line.intercept == pytest.approx(-7.0, abs=1e-12)
    assert 0.0 < line.uncertainty < 1e-14


def test_powers_have_their_exponents() -> None:
    for power in (2.0, 3.0):
        assert straight_line(T, T**power).exponent > 1.7
    assert straight_line(T, T**2 + 50 * np.cos(3 * T)).exponent > 1.2, "an oscillation does not hide a parabola"


@pytest.mark.parametrize("samples", [16, 17, 23, 40, 65])
def test_short_series(samples: int) -> None:
    t = np.arange(samples) * 0.5
    line = straight_line(t, 0.1 * t + np.random.default_rng(samples).normal(0.0, 0.01, samples))
    assert abs(line.slope - 0.1) < 6 * line.uncertainty and np.isfinite(line.exponent)


def test_backward_times() -> None:
    values = 0.1 * T + np.cos(T)
    forward, backward = straight_line(T, values), straight_line(-T, values)
    assert backward.slope == pytest.approx(-forward.slope, rel=1e-12)
    assert backward.uncertainty == pytest.approx(forward.uncertainty, rel=1e-12)


def test_few_blocks_have_a_wider_spread() -> None:
    """Of 16 samples there are four blocks and no more: two degrees of freedom are lost to the line."""
    t = np.arange(16.0)
    values = np.random.default_rng(4).normal(size=16)
    line = straight_line(t, values)
    d = t - t.mean()
    rest = values - np.polyval(np.polyfit(t, values, 1), t)
    sums = (d * rest).reshape(4, 4).sum(axis=1)
    assert line.uncertainty >= np.sqrt(2.0 * sums @ sums) / (d @ d) * (1 - 1e-12)
    assert line.exponent > 0.2 or line.uncertainty == pytest.approx(np.sqrt(2.0 * sums @ sums) / (d @ d))
