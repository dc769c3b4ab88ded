"""States at given times (`t_eval`, `Solution.at`), between the unchanged steps of a run."""

import numpy as np
import pytest

import coadjoint as co
from group_elements import random_element
from refusals import refused

U = 2.0**-53
BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.3, -0.2, 0.5])
STEP = 0.125


def kind_of(method):
    """Return the kind of group element that a scheme computes."""
    kind = (method or co.Splitting()).properties(BODY).attitude
    return {"none": False, "coadjoint": "coadjoint"}.get(kind, True)


def random_times(start, end, count=40, seed=7):
    inside = start + (end - start) * np.random.default_rng(seed).uniform(size=count)
    found = np.sort(np.concatenate([inside, [start, end, 0.5 * (start + end)]]))
    return found if end > start else found[::-1]


@pytest.mark.parametrize("end", [3.0, -3.0])
def test_free_body_matches_its_closed_form(end):
    times = random_times(0.0, end)
    method = co.Splitting(order=2, parts="free_body")
    exact, g = BODY.exact(X, times, attitude=True)
    found = co.integrate(BODY, X, (0.0, end), 0.25, method, attitude=True, t_eval=times)
    # The flow is exact: what is left is the rounding of twelve steps, each of some hundred operations.
    assert np.abs(found.x - exact).max() < 12 * 100 * U and np.abs(found.attitude - g).max() < 12 * 100 * U
    start = random_element(BODY.representation, 1)
    turned = co.integrate(BODY, X, (0.0, end), 0.25, method, attitude=start, t_eval=times)
    assert np.abs(turned.attitude - start @ g).max() < 12 * 100 * U


@pytest.mark.thinned(1)
@pytest.mark.parametrize("points", ["steps", "third step", "output times"])
@pytest.mark.parametrize("span", [(0.0, 12.0), (7.0, 19.0), (-5.0, -17.0)])
def test_events_end_runs_from_any_time_with_their_attitude(span, points):
    """Of a Hamiltonian that is shifted by a Casimir, whose turn is that of the time since the start; and of members."""
    method, step, event = co.Splitting(order=8), 1 / 32, co.Event(1, terminal=True)
    options = {"save_every": 3} if points == "third step" else {}
    options |= {"t_eval": random_times(*span, 12)} if points == "output times" else {}
    x0 = np.array([X, [0.1, 0.4, -0.3]]) * [1.0, np.sign(span[1] - span[0]), 1.0]  # the same motions backward
    single = co.integrate(BODY, x0[0], span, step, method, attitude=True, events=event, **options)
    together = co.integrate(BODY, x0, span, step, method, attitude=True, events=event, **options)
    for sol, member in ((single, ()), (together, (0,)), (together, (1,))):
        start, events = x0[member or 0], (sol.events.of(*member) if member else sol.events)
        end = events.t[-1]
        assert abs(end - span[0]) > 1.0 and abs(end - span[1]) > 1.0
        t = sol.t[np.isfinite(sol.x[(slice(None), *member, 0)])]
        exact, g = BODY.exact(start, t - span[0], attitude=True)
        x, attitude = (np.asarray(one)[(slice(len(t)), *member)] for one in (sol.x, sol.attitude))
        # Order eight: 1e-12 over the span, beside the rounding of 400 steps.
        np.testing.assert_allclose(x, exact, rtol=0, atol=1e-11)
        np.testing.assert_allclose(attitude, g, rtol=0, atol=1e-11)
        _, there = BODY.exact(start, np.array([end - span[0]]), attitude=True)
        np.testing.assert_allclose(events.attitude[-1], there[0], rtol=0, atol=1e-11)
    assert single.t[-1] == single.events.t[-1] and single.t_span[1] == single.t[-1]


@pytest.mark.parametrize("end", [80.0, -80.0])
def test_multivalued_casimirs_are_unwrapped(end):
    # The Casimir of A3,7 has an angle, which winds up along the run.
    M = np.array([[1.0, 0.2, 0.1], [0.2, 1.5, 0.0], [0.1, 0.0, 0.7]])
    system = co.LiePoissonSystem(co.algebras.get("A3,7", a=2.0), co.Quadratic(M))
    x0, times = np.array([0.5, -0.25, 1.5]), random_times(0.0, end, 200)
    found = co.integrate(system, x0, (0, end), 1 / 16, co.Splitting(order=2), t_eval=times)
    every = co.integrate(system, x0, (0, end), 1 / 16, co.Splitting(order=2))
    name = next(iter(found.casimirs))
    principal = np.array([system.casimirs[name](x) for x in found.x])
    assert np.ptp(principal) > 1.0, "the angle does not wind up"
    values, back = found.casimirs[name], every.at(times[::-1]).casimirs[name]
    # A step and a part of one, of some ten flows each, beside what is rounded on the way.
    assert np.abs(values - values[0]).max() <= every.drift()[name] + 20 * 8 * U * np.abs(principal).max()
    assert np.abs(back[::-1] - values).max() <= every.drift()[name] + 20 * 8 * U * np.abs(principal).max()


@pytest.mark.parametrize("size", [1e160, 5e20])
def test_states_of_failed_steps_are_erased(size):
    """Also where parts of the failed step could be computed, as from 5e20."""
    x = np.array([X, [size, size, -size]])
    times = np.linspace(0.0, 1.0, 21)
    with pytest.raises(co.IntegrationError) as caught:
        co.integrate(BODY, x, (0, 1), 0.25, co.ExplicitRungeKutta("rk4"), t_eval=times)
    partial = caught.value.partial
    assert partial.failed.tolist() == [False, True] and np.isfinite(partial.x[:, 0]).all()
    assert np.isnan(partial.x[times > 0.0, 1]).all() and np.isfinite(partial.x[0, 1]).all()
    with pytest.raises(co.IntegrationError) as caught:
        co.integrate(BODY, x[1], (0, 1), 0.25, co.ExplicitRungeKutta("rk4"), t_eval=times)
    assert caught.value.partial.t.tolist() == [0.0]


@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.Taylor(order=6)], ids=str)
def test_failures_backward_are_those_forward(method):
    """Of x1^2 x2 and of its negative, with output times within the step that fails and after it."""
    times = np.concatenate([np.arange(0.05, 0.625, 0.1), [0.6251, 0.63, 0.64, 0.7, 0.9, 1.01, 4.1]])
    found = {}
    for sense in (1, -1):
        system = co.LiePoissonSystem(co.systems.riccati().algebra, co.Polynomial({(2, 1, 0): sense}))
        with pytest.raises(co.IntegrationError) as caught:
            co.integrate(system, (1.0, 1.0, 0.0), (0, sense * 5.0), 0.125, method, t_eval=sense * times)
        found[sense] = caught.value
    forward, backward = found.values()
    assert forward.step == backward.step and forward.time == -backward.time
    np.testing.assert_array_equal(forward.partial.t, -backward.partial.t)
    np.testing.assert_array_equal(forward.partial.x, backward.partial.x)
    assert np.isfinite(forward.partial.x).all()


@pytest.mark.parametrize("span", [(0.0, 20.0), (3.0, -17.0)])
def test_variable_steps_reach_output_times(span):
    times, method = random_times(*span, 300), co.Taylor(tolerance=1e-10)
    exact, g = BODY.exact(X, times - span[0], attitude=True)
    for step in (0.1, 10.0):
        coarse = co.integrate(BODY, X, span, step, method, attitude=True)
        found = co.integrate(BODY, X, span, step, method, attitude=True, t_eval=times)
        # The error of a run grows with time: some 1e-10 in each unit of it.
        assert np.abs(found.x - exact).max() < 20 * 1e-10 and np.abs(found.attitude - g).max() < 20 * 1e-10
        assert np.array_equal(found.x[-1], coarse.x[-1]) and np.array_equal(found.attitude[-1], coarse.attitude[-1])
        assert np.abs(coarse.at(times).x - exact).max() < 20 * 1e-10
    # Not from the start each time: there is a saved point before each.
    assert len(times) <= found.stats.steps < 2 * len(times)


def test_accuracy_holds_between_steps():
    times = random_times(0.0, 20.0, 1000)
    ready = co.prepare(BODY, accuracy=1e-9, x0=X[None], t_span=(0, 20))
    pairs = (
        (co.integrate(BODY, X, (0, 20), accuracy=1e-9, t_eval=times), co.integrate(BODY, X, (0, 20), accuracy=1e-9)),
        (ready.run(X, (0, 20), t_eval=times), ready.run(X, (0, 20))),
    )
    for between, steps in pairs:
        errors, at_steps = (np.abs(found.x - BODY.exact(X, found.t)).max(axis=1) for found in (between, steps))
        assert max(errors[-1], at_steps[-1]) < 1e-9 * np.abs(X).max()
        assert errors.max() < 1.1 * at_steps.max()  # which may be larger in the middle than at the end


class TestAt:
    """`Solution.at`."""

    @pytest.mark.thinned(3)
    @pytest.mark.parametrize("span", [(0.0, 4.0), (1.0, -3.0)])
    @pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(8)], ids=str)
    def test_at_equals_t_eval(self, span, method):
        times, kind = random_times(*span), kind_of(method)
        x0 = np.random.default_rng(0).standard_normal((3, 3))
        for x in (x0, x0[1]):
            direct = co.integrate(BODY, x, span, STEP, method, attitude=kind, t_eval=times)
            for every in (1, 5):
                sol = co.integrate(BODY, x, span, STEP, method, attitude=kind, save_every=every)
                mixed = np.random.default_rng(3).permutation(len(times))
                found = sol.at(times[mixed])
                assert np.array_equal(found.t, times[mixed])
                # From a saved point on, five steps of a hundred operations at most: what compensated sums owed is lost.
                assert np.abs(found.x - direct.x[mixed]).max() < 32 * 50 * U * np.abs(x).max()
                if kind:
                    assert np.abs(found.attitude - direct.attitude[mixed]).max() < 32 * 50 * U
                assert np.abs(found.energy - direct.energy[mixed]).max() < 32 * 50 * U * 4
                at_saved = sol.at(float(sol.t[2]))
                assert np.array_equal(at_saved.x, sol.x[2])
                assert not kind or np.array_equal(at_saved.attitude, sol.attitude[2])
                assert np.array_equal(at_saved.energy, sol.energy[2]) and isinstance(at_saved.t, float)
            again = direct.at([times[4], span[1], span[0]])
            assert np.array_equal(again.x[0], direct.x[4]) and np.array_equal(again.x[2], x)
            assert np.abs(again.x[1] - direct.x[-1]).max() == 0.0

    @pytest.mark.parametrize("end", [12.0, -12.0])
    def test_members_ended_by_events(self, end):
        """They have states before their ends, and NaN after."""
        event, kind = co.Event(1, terminal=True), "coadjoint"
        x0, times = np.random.default_rng(5).standard_normal((9, 3)), random_times(0.0, end)
        direct = co.integrate(BODY, x0, (0, end), STEP, attitude=kind, t_eval=times, events=event)
        sol = co.integrate(BODY, x0, (0, end), STEP, attitude=kind, save_every=7, events=event)
        ends = sol.events.ends(9)
        way = np.sign(end)
        assert np.isfinite(ends).all() and len(set(ends)) == 9
        some = times[way * times < np.max(way * ends)]
        found = sol.at(some)
        for name in ("x", "energy", "attitude"):
            one, other = getattr(found, name), getattr(direct, name)[: len(some)]
            assert np.array_equal(np.isnan(one), np.isnan(other))
            assert np.nanmax(np.abs(one - other)) < 32 * 70 * U * np.abs(x0).max() ** 2
        gone = way * some[:, None] > way * ends
        assert gone.any() and np.array_equal(np.isnan(found.casimirs["|x|^2"]), gone)
        # At its end a member is where its event is.
        first = int(np.argmin(way * ends))
        there = sol.at(ends[first])
        assert np.abs(there.x[first] - sol.events.of(first).x[-1]).max() < 32 * 70 * U * np.abs(x0).max()
        last = float(way * np.max(way * ends))
        assert np.isfinite(sol.at(last).x).sum() == 3
        with refused(ValueError, f"{last:g}"):
            sol.at([0.0, end])


SIZES = [1e-15, 1.0, 1e10 / 3]


def sums(span, count):
    """Return times of equal steps, each added to the one before; and the step, and the end beyond the span."""
    step = abs(span[1] - span[0]) / count
    return span[0] + np.sign(span[1] - span[0]) * np.append(0.0, np.cumsum(np.full(count, step))), step


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("span", [(0.0, 30.0), (0.0, -30.0), (-7.0, 23.0), (40.0, 10.0)])
@pytest.mark.parametrize("members", [1, 3])
@pytest.mark.thinned(12)
def test_times_that_were_summed_end_at_the_end(size, span, members):
    """Of 30 000 terms and every hundredth of them; the states of the end are those of the last step."""
    x0 = X if members == 1 else np.array([X, 2 * X, -X])
    body = BODY if size == 1.0 else co.systems.rigid_body(tuple(size * moment for moment in (1, 2, 3)))
    ends = size * span[0], size * span[1]
    times, step = sums(ends, 30_000)
    times, step = times[::100], 100 * step
    assert times[-1] != ends[1]
    if np.sign(ends[1] - ends[0]) * (times[-1] - ends[1]) < 0.0:
        times[-1] = ends[1] + (ends[1] - times[-1])  # as far beyond the end
    whole = co.integrate(body, x0, ends, step)
    sol = co.integrate(body, x0, ends, step, t_eval=times)
    assert np.array_equal(sol.t, times) and sol.t_span == whole.t_span
    assert np.array_equal(sol.x[-1], whole.x[-1]) and np.array_equal(sol.x[0], whole.x[0])
    assert np.array_equal(co.prepare(body, None, step).run(x0, ends, t_eval=times).x, sol.x)
    # So is a span that ends there.
    assert np.array_equal(co.integrate(body, x0, (ends[0], times[-1]), step).x, whole.x)
    assert np.array_equal(co.prepare(body, None, step).end(x0, (ends[0], times[-1])), whole.x[-1])
    for found in (sol, whole):
        assert np.array_equal(found.at(times).x[-1], whole.x[-1]) and np.array_equal(found.at(times).t, times)
        assert np.array_equal(found.at(times[-1]).x, whole.x[-1])


def wheel(period):
    law = co.forces.Sampled(co.forces.Pointing(0.5, 1.5), period=period)
    return co.systems.body((1.0, 2.0, 2.5)).with_forces(law)


# Calls with a step, its span or another time far below it.
SHORT = {
    "a run": lambda ends, step, folder: co.integrate(BODY, X, ends, step),
    "members": lambda ends, step, folder: co.integrate(BODY, [X, -X], ends, step),
    "times": lambda ends, step, folder: co.prepare(BODY, None, step).run(X, ends, t_eval=[*ends]),
    "the end": lambda ends, step, folder: co.prepare(BODY, None, step).end(X, ends),
    "an archive": lambda ends, step, folder: co.integrate(BODY, X, ends, step, archive=folder / "short.zarr"),
    "resumed": lambda ends, step, folder: (
        co.integrate(BODY, X, (ends[0], ends[0]), step, archive=folder / "none.zarr"),
        co.resume(folder / "none.zarr", t_end=ends[1]),
    ),
    "no steps": lambda ends, step, folder: co.integrate(BODY, X, (ends[0], ends[0]), step).at(ends[1]),
    "a period": lambda ends, step, folder: co.integrate(wheel(1.0), wheel(1.0).state(), (0, 3 * step), step),
}


@pytest.mark.parametrize("step", [1e10, 1e15, 1e300])
@pytest.mark.parametrize("ends", [(0.0, 1.0), (5.0, 4.0)])
@pytest.mark.parametrize("call", SHORT)
def test_times_far_below_a_step_are_not_rounding_of_none(call, ends, step, tmp_path):
    """Beside the step such a span is rounding, beside its own ends it is not; a run would end where it starts."""
    with refused(ValueError, "step" if call != "no steps" else "run"):
        SHORT[call](ends, step, tmp_path)


@pytest.mark.parametrize("end", [0.0, 0.1 + 0.2, -7.0])
def test_spans_within_rounding_of_none_have_no_steps(end):
    """A time that was summed misses the start of the next run by an ulp or two."""
    sol = co.integrate(BODY, X, (end, end + 2 * np.spacing(end) if end else 0.0), 0.1)
    assert sol.stats.steps == 0 and np.array_equal(sol.x, [X])


def test_members_that_fail_beside_others_are_left_out():
    """Damped members at times between the steps, of which some have ended: rows of no length stand in their place."""
    form = {
        (2, 0, 0, 0, 0): 0.6,
        (0, 2, 0, 0, 0): 1.0,
        (0, 0, 2, 0, 0): 0.9,
        (0, 0, 0, 2, 0): 0.4,
        (3, 0, 0, 0, 0): 0.3,
    }
    algebra, damping = co.algebras.get("A5,25", p=2, b=-0.5), co.forces.LinearDamping(0.2)
    systems = [
        co.LiePoissonSystem(algebra, co.Polynomial({**form, (1, 0, 0, 0, 1): c}), sign=-1).with_forces(damping)
        for c in (-0.4, -0.3, -0.2)
    ]
    x0 = np.outer([1.0, 0.5, 30.0, 1.1, 1000.0, 1e-8, 0.7, 0.9, 1e60], [0.6, 0.9, -0.7, -0.4, -0.5])
    run = {"t_span": (0.0, 0.1875), "step": 0.015625, "method": co.CommutatorFree(2), "t_eval": [0.0, 0.04, 0.1]}
    with pytest.raises(co.IntegrationError) as caught:
        co.integrate(co.batch([systems[m % 3] for m in range(9)]), x0, **run)
    found = caught.value.partial.x
    for m in (0, 1, 3, 5, 6, 7):
        np.testing.assert_array_equal(found[:, m], co.integrate(systems[m % 3], x0[m], **run).x)
    assert np.isnan(found[1:, 8]).all()
