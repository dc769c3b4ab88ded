"""Time grids of runs: whole numbers of steps in the direction of the span."""

import math
import re
from fractions import Fraction

import numpy as np
import pytest

from coadjoint.runs.times import times_of


@pytest.mark.parametrize(
    ("span", "step", "every", "saved"),
    [
        ((0.0, 1.0), 0.25, 1, [0, 1, 2, 3, 4]),
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
    assert times.saved.tolist() == saved
    assert times.steps == saved[-1]
    h = math.copysign(step, span[1] - span[0])
    assert times.at(times.saved).tolist() == [span[0] + j * h for j in saved]


@pytest.mark.parametrize("step", [0.1, 0.01, 1 / 3, 0.7, 1e-3, math.pi / 100])
@pytest.mark.parametrize("count", [1, 3, 7, 1000, 123457])
@pytest.mark.parametrize("start", [0.0, -17.3, 1e3])
def test_spans_that_are_multiples_up_to_rounding_are_accepted(step, count, start):
    for end in (start + count * step, start - count * step):
        assert times_of((start, end), step, 1).steps == count


def test_two_nearest_steps_are_suggested():
    for span, step in (((0.0, 1.0), 0.3), ((5.0, 1.0), 0.7), ((0.0, 100.0), 0.0301), ((0.0, 1.0), 3.0)):
        with pytest.raises(ValueError, match="does not divide the time") as refusal:
            times_of(span, step, 1)
        names = [float(text) for text in re.findall(r"\d+\.\d+(?:e-?\d+)?", str(refusal.value).split("nearest")[1])]
        assert len(names) == 2
        exact = Fraction(abs(span[1] - span[0])) / Fraction(step)
        counts = [times_of(span, name, 1).steps for name in names]
        below = max(1, math.floor(exact))
        assert counts == [below + 1, below]
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("span", "step", "every", "error", "message"),
    [
        ((0, 1), 0.0, 1, ValueError, "step is 0.0; it must be positive"),
        ((0, 1), math.nan, 1, ValueError, "step is nan"),
        ((0, 1), "0.1", 1, TypeError, "step is '0.1'; it must be a number"),
        ((0, math.inf), 0.1, 1, ValueError, "the end of t_span is inf"),
        ((math.nan, 1), 0.1, 1, ValueError, "the start of t_span is nan"),
        (1.0, 0.1, 1, ValueError, "t_span is 1.0; it must be two numbers"),
        ((0, "1"), 0.1, 1, TypeError, "the end of t_span is '1'"),
        ((0, 1e300), 1e-300, 1, ValueError, "too small"),
        ((0, 1), 0.1, 0, ValueError, "save_every .* not 0"),
        ((0, 1), 0.1, 2.5, ValueError, "save_every .* not 2.5"),
        ((0, 1), 0.1, math.nan, ValueError, "save_every .* not nan"),
        ((0, 1), 0.1, True, ValueError, "save_every .* not True"),
    ],
)
def test_wrong_times_are_refused(span, step, every, error, message):
    with pytest.raises(error, match=message) as refusal:
        times_of(span, step, every)
    assert "\n" not in str(refusal.value)


def span_off_by(start, step, count, relative, direction=1.0):
    """Return a span longer than `count` steps by a relative amount, rounded once."""
    exact = Fraction(step) * count * (1 + Fraction(relative)) * int(direction)
    return start, float(Fraction(start) + exact)


U = 2.0**-53


def allowance(count, largest, step):
    """Eight units in the last place of the largest time for each step, at most a hundredth of a step but for one."""
    return max(16 * U * largest, min(count * 16 * U * largest, step / 100))


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("count", [1, 10, 12345, 10**6, 10**9, 10**12])
@pytest.mark.parametrize("step", [0.1, 1 / 3, 0.0625, math.pi / 100, 1e-7, 1e-15, 1e8])
@pytest.mark.parametrize("start", [0.0, 1e6, -1e6, 123456.789, 2.0**40, 1e-15])
def test_small_deviations_from_whole_steps(start, step, count, direction):
    """Rounding is accepted, for each step once, and a quarter more than that is refused."""
    exact_end = span_off_by(start, step, count, 0.0, direction)[1]
    largest = max(abs(start), abs(exact_end), count * step)
    if math.ulp(largest) > step / 512:
        return
    allowed = allowance(count, largest, step)
    for share in (0.0, 0.25, -0.25, 0.75, -0.75):
        ends = span_off_by(start, step, count, share * allowed / (step * count), direction)
        times = times_of(ends, step, 1)
        assert times.steps == count
        # The end is that of the steps.
        assert times.end == start + count * math.copysign(step, direction)
    for share in (1.25, -1.25, 3.0, -3.0):
        if abs(share) * allowed < step / 4:
            with pytest.raises(ValueError, match="does not divide"):
                times_of(span_off_by(start, step, count, share * allowed / (step * count), direction), step, 1)


@pytest.mark.parametrize("step", [0.1, 0.0625, 1 / 3])
def test_end_near_zero_from_a_distant_start(step):
    for count in (10, 12345, 10**9):
        start = float(Fraction(step) * count)
        assert times_of((start, 0.0), step, 1).steps == times_of((0.0, start), step, 1).steps == count
        for share, accepted in ((0.75, True), (1.25, False)):
            off = start + share * allowance(count, start, step)
            for ends in ((off, 0.0), (0.0, off)):
                if accepted:
                    assert times_of(ends, step, 1).steps == count
                    continue
                with pytest.raises(ValueError, match="does not divide"):
                    times_of(ends, step, 1)


@pytest.mark.parametrize("scale", [1e-15, 1e-3, 1.0, 1e10])
@pytest.mark.parametrize("start", [0.0, -2.5, 7.0])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_sums_of_steps_are_whole_numbers_of_steps(scale, start, direction):
    for step in (0.1, 1 / 3, 0.7):
        for count in (1, 30, 300, 30_000, 10**6):
            total = direction * scale * np.cumsum(np.full(count, step))[-1]
            times = times_of((scale * start, scale * start + total), scale * step, 1)
            assert times.steps == count and math.copysign(1.0, times.h) == direction


def test_indistinguishable_times_are_refused():
    for start in (2.0**52, -(2.0**52)):
        for end in (start + 64.0, start - 64.0):
            assert len(set(times_of((start, end), 4.0, 1).at(np.arange(17)).tolist())) == 17
            with pytest.raises(ValueError, match="same number"):
                times_of((start, end), 2.0 if abs(end) > abs(start) else 1.0, 1)


def test_larger_end_limits_the_step():
    """2^54 has neighbours 4 away."""
    for ends in ((0.0, 2.0**54), (2.0**54, 0.0), (0.0, -(2.0**54)), (-(2.0**54), 0.0)):
        assert times_of(ends, 16.0, 1).steps == 2**50
        with pytest.raises(ValueError, match="same number"):
            times_of(ends, 8.0, 1)


def test_one_rounding_of_a_distant_time_is_always_permitted():
    """Of Unix times the last place is a fifth of this step, more than the part that sums may have."""
    first = 1.7e9
    last = first + 0.3
    assert abs((last - first) / 1e-6 - 300_000) > 0.01
    assert times_of((first, last), 1e-6, 300_000).steps == 300_000
    assert times_of((last, first), 1e-6, 300_000).steps == 300_000
    with pytest.raises(ValueError, match="divide"):
        times_of((first, first + 0.30001), 3e-5, 1)
