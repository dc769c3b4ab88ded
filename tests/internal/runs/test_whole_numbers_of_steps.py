"""Time grids of whole numbers of steps: what rounding may leave, on both sides of the allowance."""

import math
from fractions import Fraction

import numpy as np
import pytest

from coadjoint.runs.times import times_of
from refusals import refused
from rounding import UNIT_ROUNDOFF as U


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
