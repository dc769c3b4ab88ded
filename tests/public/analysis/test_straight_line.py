"""Slopes of series whose truth is known: how often does the uncertainty hold it, and how do deviations grow?"""

from collections.abc import Callable

import numpy as np
import pytest

import coadjoint as co

drift_of_series = co.analysis.drift_of_series

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


@pytest.mark.thinned(16)
@pytest.mark.parametrize("kind", NOISE)
@pytest.mark.parametrize("slope", [0.0, -2.5])
def test_two_uncertainties_hold_the_slope(kind: str, slope: float):
    series, (low, high) = NOISE[kind]
    lines = [drift_of_series(T, series(np.random.default_rng(seed)) + slope * T + 3.0) for seed in range(SERIES)]
    z = np.array([(line.slope - slope) / line.uncertainty for line in lines])
    # Nine of ten; three standard deviations of a count of 200 is 6.4 of 100.
    assert np.mean(np.abs(z) < 2.0) > 0.9 - 0.064
    if kind in ("white", "a short memory"):
        assert np.sqrt(np.mean(z**2)) > 0.7, "not to the safe side by much, either"
    exponents = np.array([line.exponent for line in lines])
    assert np.mean((low < exponents) & (exponents < high)) > 0.97


def test_a_line_is_found_to_rounding():
    line = drift_of_series(T, 0.3 * T - 7.0)
    assert line.slope == pytest.approx(0.3, abs=1e-14) and line.intercept == pytest.approx(-7.0, abs=1e-12)
    assert 0.0 < line.uncertainty < 1e-14


def test_few_blocks_have_a_wider_spread():
    """Of 16 samples there are four blocks and no more: two degrees of freedom are lost to the line."""
    t = np.arange(16.0)
    values = np.random.default_rng(4).normal(size=16)
    line = drift_of_series(t, values)
    d = t - t.mean()
    rest = values - np.polyval(np.polyfit(t, values, 1), t)
    sums = (d * rest).reshape(4, 4).sum(axis=1)
    assert line.uncertainty >= np.sqrt(2.0 * sums @ sums) / (d @ d) * (1 - 1e-12)
    assert line.exponent > 0.2 or line.uncertainty == pytest.approx(np.sqrt(2.0 * sums @ sums) / (d @ d))


def uneven(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return drawn times and a series about a line, with noise and an oscillation, far from the origin."""
    rng = np.random.default_rng(samples)
    t = 1000.0 + np.cumsum(rng.uniform(0.05, 1.0, samples))
    return t, 40.0 - 0.3 * t + np.cos(0.2 * t) + rng.normal(0.0, 0.3, samples)


@pytest.mark.parametrize("samples", [16, 61, 768])
def test_the_line_is_that_of_least_squares_on_uneven_times(samples: int):
    t, values = uneven(samples)
    line = drift_of_series(t, values)
    slope, intercept = np.polynomial.Polynomial.fit(t, values, 1).convert().coef[::-1]
    assert line.slope == pytest.approx(slope, rel=1e-10) and line.intercept == pytest.approx(intercept, rel=1e-10)
    assert line.deviation == pytest.approx(np.sqrt(np.mean((values - slope * t - intercept) ** 2)), rel=1e-10)


@pytest.mark.parametrize("kind", ["noise", "walk"])
def test_scales_and_added_lines_change_only_what_they_must(kind: str):
    t, values = uneven(768)
    values = np.cumsum(values - values.mean()) if kind == "walk" else values
    line = drift_of_series(t, values)
    assert (line.exponent > 0.2) == (kind == "walk"), "with and without the spread of the pieces"
    for unit, factor, slope, shift in ((1.0, -3.0, 0.0, 5.0), (-0.01, 1e4, 7.0, 0.0), (50.0, 0.5, -2.0, 1e3)):
        other = drift_of_series(unit * t + shift, factor * values + slope * t - 8.0)
        # Sums of 768 products of values up to 1e3 that lose three digits to the mean: some 1e-9 at the most.
        assert other.slope == pytest.approx((factor * line.slope + slope) / unit, rel=1e-8)
        assert other.uncertainty == pytest.approx(abs(factor / unit) * line.uncertainty, rel=1e-8)
        assert other.deviation == pytest.approx(abs(factor) * line.deviation, rel=1e-8)
        assert other.slow_deviation == pytest.approx(abs(factor) * line.slow_deviation, rel=1e-8)
        assert other.exponent == pytest.approx(line.exponent, abs=1e-8)
    # 768 samples are whole blocks of each number: from the end they are the same ones.
    back = drift_of_series(-t[::-1], values[::-1])
    assert back.slope == pytest.approx(-line.slope, rel=1e-8)
    for name in ("uncertainty", "deviation", "slow_deviation", "exponent"):
        assert getattr(back, name) == pytest.approx(getattr(line, name), rel=1e-8), name


def test_slow_deviations_are_those_of_means_over_a_64th_of_the_span():
    """The last block is as long as the others: a parabola without its line, averaged over 12 samples each."""
    t = np.arange(768.0)
    line = drift_of_series(t, t**2)
    means_t, means = t.reshape(64, 12).mean(axis=1), (t**2).reshape(64, 12).mean(axis=1)
    rest = means - np.polyval(np.polyfit(means_t, means, 1), means_t)
    assert line.slow_deviation == pytest.approx(np.sqrt(np.sum(rest**2) / 62), rel=1e-10)
    jump = drift_of_series(t, np.where(t >= 756, 1.0, 0.0)).slow_deviation
    assert jump == pytest.approx(drift_of_series(t, np.where(t < 12, 1.0, 0.0)).slow_deviation, rel=1e-10)
