"""Arithmetic of runs: time grids of whole numbers of steps, and roots and minima of many functions at once."""

import math
from fractions import Fraction

import numpy as np
import pytest

from coadjoint.runs.crossings import minimize_each, roots
from coadjoint.runs.times import times_of
from refusals import refused
from rounding import UNIT_ROUNDOFF as U


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("span", "step", "every", "saved"),
    [
        ((0.0, 1.0), 0.25, 3, [0, 3, 4]),
        ((0.0, 1.0), 0.25, 4, [0, 4]),
        ((0.0, 1.0), 0.25, 100, [0, 4]),
        ((2.0, -1.0), 0.5, 2, [0, 2, 4, 6]),
        ((3.0, 3.0), 0.5, 2, [0]),
        ((0, 1), 1, 1, [0, 1]),
        (np.array([0.0, 0.3]), np.float64(0.1), np.int64(1), [0, 1, 2, 3]),
        ((0.0, 1.0), 0.25, 2.0, [0, 2, 4]),
    ],
)
def test_saved_steps_of_a_span(span, step, every, saved):
    times = times_of(span, step, every)
    assert times.saved.tolist() == saved and times.steps == saved[-1]
    h = math.copysign(step, span[1] - span[0])
    assert times.at(times.saved).tolist() == [span[0] + j * h for j in saved]


def span_off_by(start, step, count, relative, direction=1.0):
    """Return a span longer than `count` steps by a relative amount, rounded once."""
    exact = Fraction(step) * count * (1 + Fraction(relative)) * int(direction)
    return start, float(Fraction(start) + exact)


def allowance(count, largest, step):
    """Eight units in the last place of the largest time for each step, at most a hundredth of a step but for one."""
    return max(16 * U * largest, min(count * 16 * U * largest, step / 100))


@pytest.mark.thinned(4)
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("count", [1, 10, 12345, 10**6, 10**9, 10**12])
@pytest.mark.parametrize("step", [0.1, 1 / 3, 0.0625, math.pi / 100, 1e-7, 1e-15, 1e8])
@pytest.mark.parametrize("start", [0.0, 1e6, -1e6, 123456.789, 2.0**40, 1e-15])
def test_small_deviations_from_whole_steps(start, step, count, direction):
    """Rounding is accepted, for each step once, and a quarter more than that is refused."""
    largest = max(abs(start), abs(span_off_by(start, step, count, 0.0, direction)[1]), count * step)
    if math.ulp(largest) > step / 512:
        return
    allowed = allowance(count, largest, step)
    for share in (0.0, 0.75, -0.75):
        times = times_of(span_off_by(start, step, count, share * allowed / (step * count), direction), step, 1)
        assert times.steps == count and times.end == start + count * math.copysign(step, direction)
    for share in (1.25, -1.25, 3.0, -3.0):
        if abs(share) * allowed < step / 4:
            with refused(ValueError, step):
                times_of(span_off_by(start, step, count, share * allowed / (step * count), direction), step, 1)


@pytest.mark.parametrize("step", [0.1, 0.0625, 1 / 3])
def test_end_near_zero_from_a_distant_start(step):
    for count in (10, 12345, 10**9):
        start = float(Fraction(step) * count)
        assert times_of((start, 0.0), step, 1).steps == times_of((0.0, start), step, 1).steps == count
        for share in (0.75, 1.25):
            off = start + share * allowance(count, start, step)
            for ends in ((off, 0.0), (0.0, off)):
                if share < 1.0:
                    assert times_of(ends, step, 1).steps == count
                    continue
                with refused(ValueError, step):
                    times_of(ends, step, 1)


def test_indistinguishable_times_are_refused():
    """2^52 has neighbours 1 or 1/2 away, and 2^54 has neighbours 4 away; the larger end counts."""
    for start in (2.0**52, -(2.0**52)):
        for end in (start + 64.0, start - 64.0):
            assert len(set(times_of((start, end), 4.0, 1).at(np.arange(17)).tolist())) == 17
            with refused(ValueError, "same number"):
                times_of((start, end), 2.0 if abs(end) > abs(start) else 1.0, 1)
    for ends in ((0.0, 2.0**54), (2.0**54, 0.0), (0.0, -(2.0**54)), (-(2.0**54), 0.0)):
        assert times_of(ends, 16.0, 1).steps == 2**50
        with refused(ValueError, "same number"):
            times_of(ends, 8.0, 1)


def test_one_rounding_of_a_distant_time_is_always_permitted():
    """Of Unix times the last place is a fifth of this step, more than the part that sums may have."""
    first = 1.7e9
    last = first + 0.3
    assert abs((last - first) / 1e-6 - 300_000) > 0.01
    assert times_of((first, last), 1e-6, 300_000).steps == times_of((last, first), 1e-6, 300_000).steps == 300_000
    with refused(ValueError, "divide"):
        times_of((first, first + 0.30001), 3e-5, 1)


ROOTS = np.array([1e-12, 1e-3, 0.1, 1 / 3, 0.5, 0.9, 1 - 1e-9])
EVERY = np.arange(len(ROOTS))
SHAPES = {
    "straight": lambda d: d,
    "cubic": lambda d: d**3 + 1e-3 * d,
    "flat": lambda d: np.sign(d) * np.abs(d) ** 0.2,
    "steep": lambda d: np.tanh(1e6 * d),
    "exponential": lambda d: np.expm1(20 * d),
    "overflowing": lambda d: np.sign(d) * np.where(np.abs(d) > 0.05, np.inf, np.abs(d)),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("shape", SHAPES)
def test_each_root_is_found_to_its_own_resolution_alone_and_together(shape, sign):
    least = np.array([0.05, 2.0**-52, 1e-6])[EVERY % 3]
    for resolution in (np.full(len(ROOTS), 2.0**-52), least):
        seen = []

        def values(which, theta, seen=seen):
            seen.extend(which.tolist())
            return sign * SHAPES[shape](theta - ROOTS[which])

        before, after = values(EVERY, 0 * ROOTS), values(EVERY, 0 * ROOTS + 1)
        seen.clear()
        found = roots(values, before, after, resolution)
        assert (np.abs(found - ROOTS) <= 2.0 * resolution).all()
        counts = np.bincount(seen, minlength=len(ROOTS))
        assert counts.max() < 80
        for k in EVERY:
            alone = [one[k : k + 1] for one in (before, after, resolution)]
            assert roots(lambda which, theta, k=k: values(which + k, theta), *alone)[0] == found[k]
    assert roots(lambda which, theta: theta - 1.0, *np.array([[-1.0], [0.0], [2.0**-52]]))[0] == 1.0


def test_smooth_functions_take_few_iterations():
    calls = []

    def values(which, theta):
        calls.append(len(which))
        return np.sin(theta - ROOTS[which])

    roots(values, np.sin(-ROOTS), np.sin(1 - ROOTS), np.full(len(EVERY), 2.0**-52))
    assert len(calls) <= 9


def test_minimizations_end_independently():
    """Some reach a value that is not positive at once, some late, some never."""
    depths, minima = np.array([0.5, -1e-6, 1e-3, 0.0, -1.0, 1e-9]), np.array([0.3, 0.4, 0.9, 0.618, 0.1, 0.02])

    def values(which, theta):
        return (theta - minima[which]) ** 2 + depths[which]

    theta, value = minimize_each(values, len(depths))
    assert np.array_equal(value, values(np.arange(len(depths)), theta))
    assert (value[depths < 0.0] <= 0.0).all() and (value[depths > 0.0] > 0.0).all()
    assert np.abs(theta - minima)[depths > 0.0].max() < 2.0**-20
    for k in range(len(depths)):
        alone = minimize_each(lambda which, t, k=k: values(which + k, t), 1)
        assert (alone[0][0], alone[1][0]) == (theta[k], value[k])
