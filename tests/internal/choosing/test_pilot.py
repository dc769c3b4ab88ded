"""Pilot runs, samples of ensembles, growth and rounding of errors, and the work of steps, against known motions."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import pilot as pilots
from coadjoint.choosing.candidates import supported_candidates
from coadjoint.choosing.fitting import roundoff
from coadjoint.choosing.pilot import Pilot, PilotErrors

X0 = np.array([1.0, 1.5, -0.5])
BODY = co.systems.rigid_body(1.0 / np.array([1.0, 0.5, 0.4]))


def test_rounding_far_below_the_accuracy_is_measured_once_unless_the_span_is_long(monkeypatch):
    """Over ten million windows the rounding of one is not negligible."""
    seen, short_run = [], pilots.short_run
    monkeypatch.setattr(pilots, "short_run", lambda *given: seen.append(given) or short_run(*given))

    def pilot_and_runs(span, **more):
        seen.clear()
        return Pilot(BODY, X0[None], 0.0, span, **more), len(seen)

    for span in (60.0, -60.0):
        (repeated, twice), (found, once) = pilot_and_runs(span), pilot_and_runs(span, accuracy=1e-6)
        assert twice == once + pilots.REPETITIONS
        assert np.array_equal(found.reference, repeated.reference) and found.sensitivity == repeated.sensitivity
        assert max(repeated.noise, found.noise) <= 2.0**-14 * 1e-6
    assert pilot_and_runs(1e9, accuracy=1e-6)[1] > pilot_and_runs(1e3, accuracy=1e-6)[1]


@pytest.mark.parametrize("windows", [1.0, 10.0])
def test_rounded_coefficients_accumulate_like_a_random_walk(windows):
    """As many flows in all, in longer compositions: three roundings along the path, times the root of their number."""
    pilot = SimpleNamespace(noise=0.0, speed=2.0, window=5.0, sensitivity=PilotErrors(1.0, 1.0, 1.0))

    def units(flows, compensated, steps=36_000):
        return roundoff(pilot, steps // max(flows, 1), flows, compensated, windows) * 2.0**53

    path, walk = 2.0 * 5.0 * windows, math.sqrt(36_000) * windows
    for compensated in (False, True):
        one, four, nine = (units(flows, compensated) for flows in (1, 4, 9))
        assert (four - one, nine - one) == pytest.approx((3.0 * path, 6.0 * path))
        assert units(0, compensated) == pytest.approx(1.0 + path + 0.1 * walk)
    # Each flow rounds by half a unit of its increment, and the sum, if plain, with a bias.
    share = 4.0 * path / 36_000
    assert units(1, True) == pytest.approx(1.0 + 3.0 * path + 0.5 * walk * share)
    assert units(1, False) == pytest.approx(1.0 + 3.0 * path + 0.5 * walk + 7e-4 * 36_000 * windows)


def test_growth_is_extrapolated():
    """A constant error grows linearly, quadratic growth is continued, and a burst grows by its last power."""
    for growth, given, factor in (
        ((0.0, 0.0, 0.0), (100.0,), 1.0),
        ((1.0, 1.0, 1.0), (1.0,), 1.0),
        ((1.0, 1.0, 1.0), (9.0,), 9.0),
        ((1.0, 1.0, 1.0), (9.0, 2.0), 81.0),
        ((1.0, 4.0, 16.0), (3.0,), 9.0),
        ((1.0, 2.0, 200.0), (2.0,), 200.0 ** (4 / 3)),
        ((1.0, 1e3, 1e6), (1e6,), math.inf),
        # An error that appears only now is no growth, unless it grows much in the last half.
        ((1.0, 0.0, 35.0), (3.0,), 3.0),
        ((0.0, 5.0, 80.0), (3.0,), 3.0),
    ):
        assert PilotErrors(*growth).factor(*given) == pytest.approx(factor)
        assert PilotErrors(*(2.0**-60 * value for value in growth)).factor(*given) == pytest.approx(factor)
    assert PilotErrors(1.0, 6.0, 36.0).factor(3.0, 2.0) == PilotErrors(1.0, 6.0, 36.0).factor(3.0)
    assert PilotErrors(0.0, 1.0, 40.0).factor(3.0) > 9.0


@dataclasses.dataclass(frozen=True)
class InPython(co.methods.StepMethod):
    """The midpoint rule."""

    order, explicit, symmetric, compiles = 2, False, True, False

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system, x, t, h):
        y = x
        for _ in range(12):
            y = x + h * system.vector_field((x + y) / 2, t + h / 2)
        return y


class Declared(InPython):
    def work(self, system, group=None):
        return co.methods.Work(lambda iterations, evaluations: 1234.0)


def test_steps_in_python_are_counted_as_calls():
    """Without a clock, so that the choice is the same under any load; `work` overrides the estimate."""

    def cost(method):
        (found,) = supported_candidates(BODY, [method], X0, False, strict=True)
        return found.work.cost(1.0, 2.0)

    assert cost(Declared()) == 1234.0 and cost(InPython()) > 50 * cost(co.Kahan())
    assert cost(co.Composition(InPython(), (0.75, -0.5, 0.75))) == 3 * cost(InPython())
    choice = co.choose(BODY, X0, (0.0, 10.0), 1e-3, methods=[InPython(), co.GaussLegendre(1)])
    assert choice.method == co.GaussLegendre(1) and all(other.cost > 5 * choice.cost for other in choice.others)
