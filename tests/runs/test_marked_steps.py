"""Saved points at arbitrary steps: the bits of a run that saves every step."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.times import Times
from started_runs import started

STEPS, STEP = 70, 0.05
MARKS = {
    "some": [0, 1, 2, 7, 31, 32, 33, 64, 69],
    "not the start": [3, 70],
    "one": [40],
    "none": [],
    "all": list(range(STEPS + 1)),
}
BODY = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(np.linspace(0.5, 1.5, 6)))
X = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
METHODS = [
    co.Splitting(order=4),
    co.Splitting(order=2, compensated=True),
    co.GaussLegendre(2),
    co.ExplicitRungeKutta("rk4"),
    co.RadauEnergy(2),
    co.Taylor(6),
]


def run(method, members, times, watching, state=None, attitude=True):
    carried = method.properties(BODY).attitude != "none" and attitude
    ready = PreparedRun(BODY, method, STEP, attitude="coadjoint" if carried else False, watch=watching)
    x0 = X if members == 1 else np.multiply.outer(1.0 - 0.01 * np.arange(members), X)
    found = started(BODY, method, ready.loops(STEP), times, ready.start(x0), watching, state=state)
    found.advance()
    return found


@pytest.mark.thinned(5)
@pytest.mark.parametrize("watching", [True, False])
@pytest.mark.parametrize("members", [1, 35])
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_marked_steps_have_the_bits_of_all_steps(method, members, watching):
    times = Times(0.5, STEP, STEPS, 1)
    every = run(method, members, times, watching)
    whole = every.solution(None)
    for marks in MARKS.values():
        some = run(method, members, times.with_saved_steps(marks), watching)
        found = some.solution(None)
        assert found.t.tolist() == whole.t[marks].tolist() if marks else not len(found.t)
        assert len(found.x) == len(marks)
        if marks:
            assert np.array_equal(found.x, whole.x[marks]) and np.array_equal(found.energy, whole.energy[marks])
            assert whole.attitude is None or np.array_equal(found.attitude, whole.attitude[marks])
        # Watched invariants do not depend on the saved points.
        if watching:
            assert some.state == every.state
        for name in ("momenta", "errors", "groups", "group_errors", "memory", "evaluations", "iterations"):
            assert some.state[name].tobytes() == every.state[name].tobytes(), name


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_run_resumes_between_marked_steps(method):
    times = Times(0.5, STEP, STEPS, 1).with_saved_steps(MARKS["some"])
    whole = run(method, 1, times, True)
    first = run(method, 1, Times(0.5, STEP, STEPS, 1), True)
    for number, held in ((0, 1), (1, 2), (20, 4), (32, 6), (69, 9), (70, 9)):
        ready = PreparedRun(BODY, method, STEP, attitude=whole.start.representation or False)
        piece = started(BODY, method, ready.loops(STEP), times, ready.start(X), True)
        piece.advance(until=number)
        rest = run(method, 1, times, True, state=piece.state)
        assert rest.state == whole.state == first.state
        assert rest.times.saved.tolist() == MARKS["some"][held:]
        assert rest.saved["x"].tobytes() == whole.saved["x"][held:].tobytes()
        assert rest.saved["group"].tobytes() == whole.saved["group"][held:].tobytes()
        assert rest.saved["values"].tobytes() == whole.saved["values"][held:].tobytes()


@pytest.mark.parametrize("members", [1, 35])
def test_points_saved_after_a_failure_are_erased(members):
    """Also the group element of the step whose momentum overflows."""
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic(np.zeros((3, 3)), linear=[0.0, 8.0, 0.0]))
    ready = PreparedRun(system, co.Splitting(order=2), 1.0, attitude="coadjoint")
    x0 = np.array([0.5, 1.0, 0.25])
    marks = [1, 2, 3, *range(30, 101)]
    times = Times(0.0, 1.0, 100, 1).with_saved_steps(marks)
    found = started(
        system, co.Splitting(order=2), ready.loops(1.0), times, ready.start(np.tile(x0, (members, 1))), True
    )
    found.advance()
    assert found.failed_count == members
    failed = int(found.state["step"][0])
    assert marks[3] < failed < 100
    for step, x, group in zip(marks, found.saved["x"], found.saved["group"], strict=True):
        assert np.isfinite(x).all() == np.isfinite(group).all() == (step < failed), step


@pytest.mark.parametrize("wrong", [[3, 3], [4, 2], [-1, 2], [5, 71], [0.5, 1.0], [[1, 2]], 3, ["a"]])
def test_invalid_marked_steps_are_refused(wrong):
    with pytest.raises(ValueError, match=r"steps to be saved .* whole numbers from 0 to 70"):
        Times(0.0, STEP, STEPS, 1).with_saved_steps(wrong)
