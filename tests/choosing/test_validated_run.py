"""Runs prepared for an accuracy: one choice for a sample of states, checked at the first step of each run."""

import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.choosing import validated_run

BODY = co.systems.rigid_body((1, 2, 2.5))
SPAN = (0.0, 40.0)


def on_sphere(count, seed=1994):
    found = np.random.default_rng(seed).standard_normal((count, 3))
    return found / np.linalg.norm(found, axis=1)[:, None]


SAMPLE = on_sphere(12, seed=1993)


def no_choice(*given, **options):
    raise AssertionError("another choice was made")


@pytest.mark.thinned(3)
@pytest.mark.parametrize("span", [SPAN, (40.0, 0.0), (1.0, 3.5)])
@pytest.mark.parametrize("accuracy", [1e-4, 1e-10])
def test_states_like_the_sample_reach_the_accuracy(span, accuracy, monkeypatch):
    ready = co.prepare(BODY, accuracy=accuracy, x0=SAMPLE, t_span=span)
    states = on_sphere(20)
    served = [x0 for x0 in states if ready.serves(x0)]
    # Twelve states of a sphere show nearly how hard any other can be; for the few that are harder it is chosen again.
    assert len(served) >= 15
    assert all(np.linalg.norm(ready.end(x0, span) - BODY.exact(x0, span[1] - span[0])) <= accuracy for x0 in states)
    monkeypatch.setattr(validated_run, "choose", no_choice)
    for x0 in served:
        found = ready.end(x0, span)
        run = ready.run(x0, span)
        assert np.array_equal(run.x[-1], found) and run.choice is ready.choice
        alone = co.integrate(BODY, x0, span, ready.step, ready.method)
        assert np.array_equal(alone.x[-1], found)
    # Slower motions, which are no harder, and shorter ones, are served too.
    shorter = span[0], span[0] + ready.signed_step
    assert ready.serves(0.1 * SAMPLE) and ready.run(0.1 * SAMPLE, shorter).x.shape == (2, 12, 3)


@pytest.mark.parametrize("method", [None, co.GaussLegendre(4), co.Splitting(order=6)], ids=str)
def test_faster_states_get_their_own_choice(method):
    """Nine times as fast: the step of the sample would be wrong by 9^p."""
    ready = co.prepare(BODY, method, accuracy=1e-8, x0=SAMPLE, t_span=SPAN)
    assert ready.serves(SAMPLE) and not ready.serves(1.5 * SAMPLE)
    assert all(map(ready.serves, SAMPLE)) and not all(ready.serves(1.5 * x) for x in SAMPLE)
    for x0 in 9.0 * on_sphere(3):
        assert not ready.serves(x0)
        found = ready.run(x0, SPAN, 10**9)
        assert np.linalg.norm(found.x[-1] - BODY.exact(x0, 40.0)) <= 1e-8 * 9.0
        once = co.integrate(BODY, x0, SPAN, accuracy=1e-8, method=method)
        assert found.choice == once.choice != ready.choice
        assert np.array_equal(found.x[-1], once.x[-1]) and np.array_equal(ready.end(x0, SPAN), once.x[-1])
    mixed = np.array([SAMPLE[0], 9.0 * SAMPLE[1]])
    ends = ready.run(mixed, SPAN, 10**9).x[-1]
    assert np.max(np.abs(ends - [BODY.exact(x, 40.0) for x in mixed])) <= 9e-8
    # What came between has changed nothing.
    again = co.prepare(BODY, method, accuracy=1e-8, x0=SAMPLE, t_span=SPAN)
    assert np.array_equal(ready.end(SAMPLE[0], SPAN), again.end(SAMPLE[0], SPAN))


def test_variable_steps_are_limited_in_number():
    """Nine times as fast takes nine times as many steps, and their errors add up: such a run gets its own choice."""
    series = co.Taylor(tolerance=1e-9)
    ready = co.prepare(BODY, series, accuracy=1e-8, x0=SAMPLE, t_span=SPAN)
    assert ready.choice.method.own_steps
    assert ready.serves(SAMPLE) and ready.serves(SAMPLE[1]) and not ready.serves(9.0 * SAMPLE)
    for x0 in 9.0 * on_sphere(3):
        assert not ready.serves(x0)
        found, once = ready.run(x0, SPAN), co.integrate(BODY, x0, SPAN, accuracy=1e-8, method=series)
        assert found.choice == once.choice != ready.choice
        assert np.array_equal(found.x[-1], once.x[-1]) and np.array_equal(ready.end(x0, SPAN), once.x[-1])
        assert np.linalg.norm(found.x[-1] - BODY.exact(x0, 40.0)) <= 1e-8 * 9.0
    mixed = np.array([SAMPLE[0], 9.0 * SAMPLE[1]])
    assert ready.run(mixed, SPAN).choice != ready.choice
    assert ready.run(SAMPLE, SPAN).choice == ready.choice


def test_states_at_rest_and_invalid_input():
    ready = co.prepare(BODY, co.Taylor(16), accuracy=1e-8, x0=[SAMPLE[0], [0.0, 0.0, 0.0]], t_span=SPAN)
    for x0 in ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        assert np.allclose(ready.end(x0, SPAN), x0, rtol=0.0, atol=1e-15)
    # Squares underflow or overflow, so that nothing can be checked.
    for size in (0.0, 1e-200, 1e200):
        assert ready.serves(size * SAMPLE[0]) == ready.serves(size * SAMPLE[:1]) == (size == 0.0)
    for call in (ready.run, ready.end):
        with pytest.raises(ValueError, match="NaN or infinity"):
            call((0.0, np.nan, 1.0), SPAN)
        with pytest.raises(ValueError, match=r"x0 has the shape \(2,\)"):
            call((0.0, 1.0), SPAN)
        for span in ((0.0, 41.0), (40.0, 0.0)):
            with pytest.raises(ValueError, match="at most the time 40, in its direction"):
                call(SAMPLE[0], span)
        # The end may be a sum of steps.
        rounding = 16 * 2.0**-53 * 40.0 * round(40.0 / ready.step)
        whole, found = call(SAMPLE[0], SPAN), call(SAMPLE[0], (0.0, 40.0 + 0.8 * rounding))
        assert np.array_equal(*(np.atleast_2d(getattr(run, "x", run))[-1] for run in (whole, found)))
        with pytest.raises(ValueError, match=r"^t_span is \[0.0, 40.0\d+\]; .* at most the time 40(\.0)?, in"):
            call(SAMPLE[0], (0.0, 40.0 + 1.3 * rounding))


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.Splitting(order=2, compensated=True)], ids=str)
@pytest.mark.parametrize("span", [(0.0, 10.0), (2.0, -8.0)])
def test_exact_steps_serve_every_state(method, span):
    """A rotation about one axis is exact in one flow: two half steps differ by rounding, for some states by none."""
    spinning = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0.0, linear=[0.0, 0.0, 1.0]))
    for sample in ([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0], [0.0, 0.0, 2.0]]):
        ready = co.prepare(spinning, method, accuracy=1e-8, x0=sample, t_span=span)
        assert all(map(ready.serves, on_sphere(40))) and ready.serves(3.0 * on_sphere(40))
        assert ready.signed_step == math.copysign(ready.choice.step, span[1] - span[0])


@pytest.mark.parametrize("x0", [SAMPLE[0], 9.0 * SAMPLE[1]], ids=["served", "another"])
def test_run_prepared_for_accuracy_takes_no_inputs(x0):
    ready = co.prepare(BODY, co.GaussLegendre(4), accuracy=1e-6, x0=SAMPLE[:3], t_span=SPAN)
    with pytest.raises(TypeError, match=r"'wind'.*without inputs"):
        ready.run(x0, SPAN, wind=1.0)
    assert "prepared for the accuracy 1e-06: GaussLegendre" in repr(ready) and "rigid_body" in repr(ready)


def test_time_dependent_system_is_checked_at_its_time():
    """The same body by a clock that runs ever faster: later steps are larger ones."""
    quick = co.Hamiltonian(
        lambda x, t: (1.0 + t) * (0.5 * x[0] ** 2 + 0.25 * x[1] ** 2 + 0.2 * x[2] ** 2),
        lambda x, t: (1.0 + t) * x * np.array([1.0, 0.5, 0.4]),
    )
    system = co.LiePoissonSystem(co.algebras.so(3), quick, sign=-1)
    ready = co.prepare(system, accuracy=1e-8, x0=SAMPLE[:3], t_span=(0, 4))
    assert ready.serves(SAMPLE[4], 0.0) and ready.serves(SAMPLE[4], 3.0) and not ready.serves(SAMPLE[4], 30.0)
    found = ready.end(SAMPLE[4], (0.0, 4.0))
    assert np.linalg.norm(found - BODY.exact(SAMPLE[4], 4.0 + 8.0)) <= 1e-8


def test_attitude_of_a_run_prepared_for_accuracy():
    ready = co.prepare(BODY, accuracy=1e-8, x0=SAMPLE[:2], t_span=SPAN, attitude=True, threads=1)
    run = ready.run(SAMPLE[0], SPAN, attitude=np.diag([1.0, -1.0, -1.0]))
    once = co.integrate(BODY, SAMPLE[0], SPAN, ready.step, ready.method, attitude=np.diag([1.0, -1.0, -1.0]))
    assert np.array_equal(run.attitude, once.attitude)


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_group_elements_do_not_depend_on_sample_size(count):
    elements = np.stack([np.diag([1.0, -1.0, -1.0]), np.eye(3), np.diag([-1.0, -1.0, 1.0])])
    ready = co.prepare(BODY, accuracy=1e-6, x0=SAMPLE[:count], t_span=SPAN, attitude=elements)
    members = np.array([SAMPLE[0], 0.5 * SAMPLE[0], 0.1 * SAMPLE[0]])
    assert ready.serves(members) and not ready.serves(9.0 * members)
    for x0 in (members, 9.0 * members):
        run = ready.run(x0, SPAN)
        momenta = np.einsum("kmij,kmj->kmi", run.attitude, run.x)
        assert np.array_equal(run.attitude[0], elements)
        assert np.abs(momenta - np.einsum("mij,mj->mi", elements, x0)).max() < 1e-6 * np.abs(x0).max()
    # A single state, with an element of its own.
    for x0 in (SAMPLE[0], 9.0 * SAMPLE[0]):
        assert np.array_equal(ready.run(x0, SPAN, attitude=elements[2]).attitude[0], elements[2])


@pytest.mark.thinned(6)
@pytest.mark.parametrize("method", [None, co.Splitting(order=6), co.Taylor(tolerance=1e-9)], ids=str)
@pytest.mark.parametrize("span", [(3.0, 43.0), (40.0, 0.0)])
def test_own_choice_keeps_settings_and_arguments(method, span):
    settings = {"attitude": True, "watch": False, "observe": {"height": lambda x: x[2]}, "threads": 1}
    ready = co.prepare(BODY, method, accuracy=1e-7, x0=SAMPLE[:4], t_span=span, **settings)
    x0, attitude = 9.0 * SAMPLE[5], np.diag([1.0, -1.0, -1.0])
    times = span[0] + math.copysign(1.0, span[1] - span[0]) * np.array([2.0, 17.5])
    for options in ({"save_every": 3}, {"t_eval": times}):
        found = ready.run(x0, span, attitude=attitude, **options)
        step, own = found.choice.step, found.choice.method
        once = co.integrate(BODY, x0, span, step, own, **{**settings, "attitude": attitude}, **options)
        assert found.choice != ready.choice and own == found.method
        for name in ("t", "x", "attitude"):
            assert np.array_equal(getattr(found, name), getattr(once, name)), name
        assert np.array_equal(found.observed["height"], once.observed["height"])
        direct = co.choose(BODY, x0, span, 1e-7, attitude=True, methods=method)
        assert (found.choice.method, found.choice.step, found.choice.cost) == (own, step, direct.cost)
    ending = co.Event(lambda x: x[1], terminal=True)
    stopped = ready.run(x0, span, attitude=attitude, events=ending)
    same = co.integrate(BODY, x0, span, step, own, **{**settings, "attitude": attitude}, events=ending)
    assert np.array_equal(stopped.t, same.t) and len(stopped.t) < round(40.0 / step)


@pytest.mark.parametrize("span", [(0.0, 40.0), (7.0, -33.0)])
def test_worst_state_of_the_sample_sets_the_limit(span):
    """In any position, beside states at rest or slow ones; and along its motion, not only at its start."""
    # Near the middle axis the motion is slow at first, and then it flips over.
    flipping = np.array([1e-4, 1.0, 1e-4])
    slow, rest = 0.05 * SAMPLE[0], np.array([0.0, 0.0, 0.0])
    method = co.Splitting(order=4)
    for sample in ([flipping, slow, rest], [rest, slow, flipping], [slow, flipping], [flipping]):
        ready = co.prepare(BODY, method, accuracy=1e-6, x0=np.array(sample), t_span=span)
        along = co.integrate(BODY, flipping, span, ready.step, method).x
        assert all(ready.serves(x) for x in along[:: len(along) // 50])
        assert ready.serves(along) and ready.serves(rest)
        # The errors of a step of order four are 1.5^5 times as large at 1.5 times the speed.
        assert not ready.serves(1.5 * along)
        assert not ready.serves(1.5 * along[np.argmin(np.abs(along[:, 1]))])


@pytest.mark.parametrize(
    ("given", "kind", "message"),
    [
        ({}, TypeError, "neither of step and accuracy"),
        ({"step": 0.1, "accuracy": 1e-6}, TypeError, "both of step and accuracy"),
        ({"accuracy": 1e-6}, TypeError, "needs x0=.* t_span="),
        ({"accuracy": 1e-6, "x0": SAMPLE, "t_span": SPAN, "inputs": True}, TypeError, "takes no inputs"),
        ({"step": 0.1, "x0": SAMPLE}, TypeError, "a given step needs neither"),
        ({"accuracy": 1e-6, "x0": SAMPLE, "t_span": (1, 1)}, ValueError, "a time longer than 0"),
        ({"accuracy": 2.0, "x0": SAMPLE, "t_span": SPAN}, ValueError, "must lie between 0 and 1"),
        ({"accuracy": 1e-17, "x0": SAMPLE, "t_span": SPAN}, ValueError, "is below what float64 reaches"),
    ],
)
def test_refusals(given, kind, message):
    with pytest.raises(kind, match=message):
        co.prepare(BODY, **given)
