"""States at given times (`t_eval`, `Solution.at`), between the unchanged steps of a run."""

import copy
import pickle
import re

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs import output_times
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.results import state_at
from failing_parts import failing_parts
from group_elements import random_element

U = 2.0**-53
BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.3, -0.2, 0.5])
STEP = 0.125


def kind_of(method):
    """Return the kind of group element that a scheme computes."""
    kind = (method or co.Splitting()).properties(BODY).attitude
    return {"none": False, "coadjoint": "coadjoint"}.get(kind, True)


def agree(one, other):
    return one is None and other is None if one is None or other is None else np.array_equal(one, other)


def random_times(start, end, count=40, seed=7):
    inside = start + (end - start) * np.random.default_rng(seed).uniform(size=count)
    found = np.sort(np.concatenate([inside, [start, end, 0.5 * (start + end)]]))
    return found if end > start else found[::-1]


@pytest.mark.thinned(1)
@pytest.mark.parametrize("span", [(0.0, 4.0), (1.0, -3.0), (1e3, 1e3 + 4.0)])
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(8), None], ids=str)
@pytest.mark.parametrize("watch", [True, False])
def test_states_at_steps_are_those_of_the_run(span, method, watch):
    kind = kind_of(method)
    every = co.integrate(BODY, X, span, STEP, method, watch=watch, attitude=kind)
    # Times as one writes them, a rounding away from those of the steps.
    times = np.linspace(*span, 33)[::3]
    found = co.integrate(BODY, X, span, STEP, method, watch=watch, attitude=kind, t_eval=times)
    assert np.array_equal(found.t, times)
    assert np.array_equal(found.x, every.x[::3]) and np.array_equal(found.energy, every.energy[::3])
    assert agree(found.attitude, every.attitude if every.attitude is None else every.attitude[::3])
    both = random_times(*span)
    mixed = co.integrate(BODY, X, span, STEP, method, watch=watch, attitude=kind, t_eval=np.append(both, both[-1]))
    assert np.array_equal(mixed.x[[0, -2, -1]], every.x[[0, -1, -1]])
    if watch:
        assert mixed.drift() == every.drift()
    assert mixed.stats.steps == every.stats.steps


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


@pytest.mark.parametrize("method", [co.Splitting(order=4), co.Splitting(order=6), co.GaussLegendre(2)], ids=str)
def test_invariants_are_preserved_between_steps(method):
    algebra = co.algebras.so(4)
    M = np.diag(np.linspace(0.5, 1.5, 6))
    M[0, 3] = M[3, 0] = 0.1
    system, x0 = co.LiePoissonSystem(algebra, co.Quadratic(M)), np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
    times = random_times(0.0, 20.0, 500)
    found = co.integrate(system, x0, (0, 20), STEP, method, attitude=kind_of(method), t_eval=times)
    size = np.abs(x0).sum()
    for values in found.casimirs.values():
        # 160 steps and a part of one: each of some 30 flows, or of 30 iterations, is rounded at random.
        assert np.abs(values - values[0]).max() < 30 * 161 * U * size**2
    if kind_of(method) == "coadjoint":
        space = np.einsum("kij,kj->ki", found.attitude, found.x)
        assert np.abs(space - x0).max() < 30 * 161 * U * size * 6
        return
    unit = found.attitude @ np.swapaxes(found.attitude, 1, 2)
    assert np.abs(unit - np.eye(4)).max() < 30 * 161 * U * 4


def test_members_and_threads_do_not_change_bits():
    rng = np.random.default_rng(4)
    x, times = rng.standard_normal((37, 3)), random_times(0.0, 2.0)
    for method in (co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(8)):
        kind = kind_of(method)
        ensemble = co.integrate(BODY, x, (0, 2), STEP, method, t_eval=times, attitude=kind, threads=1)
        assert ensemble.x.shape == (len(times), 37, 3)
        assert not kind or ensemble.attitude.shape == (len(times), 37, 3, 3)
        several = co.integrate(BODY, x, (0, 2), STEP, method, t_eval=times, attitude=kind, threads=3)
        assert np.array_equal(ensemble.x, several.x) and agree(ensemble.attitude, several.attitude)
        for m in (0, 31, 36):
            alone = co.integrate(BODY, x[m], (0, 2), STEP, method, t_eval=times, attitude=kind)
            for name in ("x", "energy", "attitude") if kind else ("x", "energy"):
                assert np.array_equal(getattr(alone, name), getattr(ensemble, name)[:, m])
            assert np.array_equal(alone.casimirs["|x|^2"], ensemble.casimirs["|x|^2"][:, m])
        bodies = [co.systems.rigid_body((1, 2, 2 + 0.125 * m)) for m in range(5)]
        batch = co.integrate(co.batch(bodies), x[:5], (0, 2), STEP, method, t_eval=times, attitude=kind)
        for m, body in enumerate(bodies):
            alone = co.integrate(body, x[m], (0, 2), STEP, method, t_eval=times, attitude=kind)
            for name in ("x", "energy", "attitude") if kind else ("x", "energy"):
                assert np.array_equal(getattr(alone, name), getattr(batch, name)[:, m])
        # A state does not depend on the other times.
        some = co.integrate(BODY, x, (0, 2), STEP, method, t_eval=times[5:9], attitude=kind)
        assert np.array_equal(some.x, ensemble.x[5:9])
        assert agree(some.attitude, ensemble.attitude[5:9] if kind else None)


def test_inputs_observables_and_time_dependent_energies():
    times = random_times(0.0, 2.0)
    ready = co.prepare(BODY, co.Splitting(order=4), STEP, inputs=True, observe={"first": lambda x, t: x[0] + t})
    field = (0.1, 0.0, -0.2)
    found = ready.run(X, (0, 2), t_eval=times, linear=field)
    assert np.array_equal(found.observed["first"], found.x[:, 0] + times)
    plain = co.LiePoissonSystem(BODY.algebra, co.Quadratic(np.diag(1 / np.array([1, 2, 3])), field), sign=-1)
    same = co.integrate(found.system, X, (0, 2), STEP, ready.method, t_eval=times)
    assert np.array_equal(same.x, found.x) and np.array_equal(same.energy, found.energy)
    assert np.abs(found.energy - [plain.energy(x) for x in found.x]).max() < 1e-14
    pushed = co.Separable({0: (lambda y, t: t * y, lambda y, t: t), 1: (lambda y: 0.5 * y * y, lambda y: y)})
    driven = co.LiePoissonSystem(co.algebras.so(3), pushed)
    moved = co.integrate(driven, X, (0, 2), STEP, co.GaussLegendre(3), t_eval=times)
    by_hand = [driven.energy(x, t) for x, t in zip(moved.x, times, strict=True)]
    assert np.abs(moved.energy - by_hand).max() < 8 * U
    ensemble = co.integrate(driven, np.tile(X, (40, 1)), (0, 2), STEP, co.Splitting(order=4), t_eval=times)
    by_hand = [driven.energy(x, t) for x, t in zip(ensemble.x[:, 7], times, strict=True)]
    assert np.abs(ensemble.energy[:, 7] - by_hand).max() < 8 * U


def test_output_times_do_not_change_events():
    times = random_times(0.0, 40.0)
    seen = co.integrate(BODY, X, (0, 40), STEP, t_eval=times, events=co.Event(1))
    alone = co.integrate(BODY, X, (0, 40), STEP, events=co.Event(1))
    assert np.array_equal(seen.events.t, alone.events.t) and len(seen.events.t)
    assert np.array_equal(seen.x, co.integrate(BODY, X, (0, 40), STEP, t_eval=times).x)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.Taylor(12), co.Taylor(tolerance=1e-9)], ids=str)
@pytest.mark.parametrize("end", [80.0, -80.0])
def test_terminal_event_between_output_times(method, end):
    """Earlier states are unchanged, and the state of the event comes last."""
    times, kind = random_times(0.0, end), kind_of(method)
    options = {"step": STEP, "method": method, "attitude": kind, "t_eval": times}
    whole = co.integrate(BODY, X, (0, end), **options)
    for count in (1, 2):
        event = co.Event(1, terminal=True, count=count)
        there = co.integrate(BODY, X, (0, end), STEP, method, attitude=kind, events=co.Event(1)).events
        sol = co.integrate(BODY, X, (0, end), events=event, **options)
        k = int(np.count_nonzero(np.abs(times) < abs(there.t[count - 1])))
        assert 0 < k < len(times) and len(sol.t) == k + 1
        for name in ("t", "x", "energy"):
            assert np.array_equal(getattr(sol, name)[:k], getattr(whole, name)[:k])
        assert sol.t[-1] == there.t[count - 1] == sol.t_span[1] and np.array_equal(sol.x[-1], there.x[count - 1])
        assert abs(sol.energy[-1] - BODY.energy(sol.x[-1])) < 4 * U
        if kind:
            assert np.array_equal(sol.attitude[:k], whole.attitude[:k])
            assert np.array_equal(sol.attitude[-1], there.attitude[count - 1])
        # With the times of the solution, which end with that of the event.
        again = co.integrate(BODY, X, (0, end), events=event, **options | {"t_eval": sol.t})
        assert np.array_equal(again.x, sol.x) and np.array_equal(again.t, sol.t)
        # No time before it, or all of them.
        early = co.integrate(BODY, X, (0, end), events=event, **options | {"t_eval": times[k:]})
        assert np.array_equal(early.t, sol.t[-1:]) and np.array_equal(early.x, sol.x[-1:])
        late = co.integrate(BODY, X, (0, end), events=event, **options | {"t_eval": times[:k]})
        assert np.array_equal(late.x, sol.x) and late.stats.steps == sol.stats.steps
    copied = pickle.loads(pickle.dumps(sol))
    assert np.array_equal(copied.x, sol.x) and copied.t_span == sol.t_span


def test_members_end_at_their_own_events():
    x0 = np.random.default_rng(4).standard_normal((17, 3))
    x0[3] = 0.0, 0.0, 1.0  # at rest
    event, times = co.Event(1, terminal=True, count=2), random_times(0.0, 12.0)
    sol = co.integrate(BODY, x0, (0, 12), STEP, t_eval=times, events=[co.Event(0), event])
    whole = co.integrate(BODY, x0, (0, 12), STEP, t_eval=times)
    ends = sol.events.ends(17)
    assert np.isnan(ends[3]) and np.isfinite(ends).sum() > 8 and not sol.failed.any()
    for m in range(17):
        there = ~(times > ends[m])
        assert np.array_equal(sol.x[there, m], whole.x[there, m]) and np.isnan(sol.x[~there, m]).all()
        alone = co.integrate(BODY, x0[m], (0, 12), STEP, t_eval=times, events=[co.Event(0), event])
        assert np.array_equal(alone.x[: there.sum()], sol.x[there, m])
        assert alone.t[-1] == (ends[m] if np.isfinite(ends[m]) else times[-1])
    # Its second crossing is not an end where a third is asked for, nor one of another event.
    later = co.integrate(BODY, x0, (0, 12), STEP, events=[co.Event(0), co.Event(1, terminal=True, count=10**6)])
    assert np.isnan(later.events.ends(17)).all()


def test_forces_and_noise_at_output_times():
    times = random_times(0.0, 2.0)
    damped = BODY.with_forces(co.forces.LinearDamping(0.3))
    found = co.integrate(damped, X, (0, 2), STEP, co.GaussLegendre(2), t_eval=times)
    lost = found.energy - found.energy[0]
    assert np.abs(lost - found.work["LinearDamping"]["energy"]).max() < 17 * 30 * U and lost[-1] < -0.01
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(0, 0, 1): -1.0}))
    bath = spin.with_forces(co.forces.HeatBath(0.1, 0.5, seed=1))
    with pytest.raises(ValueError, match=r"HeatBath .* noise"):
        co.integrate(bath, X, (0, 2), STEP, t_eval=times)
    every = co.integrate(bath, X, (0, 2), STEP)
    assert np.array_equal(co.integrate(bath, X, (0, 2), STEP, t_eval=every.t[3:9]).x, every.x[3:9])


def test_matrices_at_output_times():
    fluid = co.systems.torus_euler(N=5)
    rng = np.random.default_rng(2)
    W = fluid.algebra.projected(rng.standard_normal((5, 5)) + 1j * rng.standard_normal((5, 5)))
    times = random_times(0.0, 0.5, 10)
    found = co.integrate(fluid, W, (0, 0.5), 1 / 64, t_eval=times)
    assert found.x.shape == (len(times), 5, 5)
    assert np.array_equal(found.energy, [fluid.energy(w) for w in found.x])
    fine = co.integrate(fluid, W, (0, 0.5), 1 / 1024, co.IsospectralGauss(4), t_eval=times)
    coarse = co.integrate(fluid, W, (0, 0.5), 1 / 32, t_eval=times)
    error, larger = (np.abs(one.x - fine.x).max() for one in (found, coarse))
    assert 3.0 < larger / error < 5.0  # of order two: 4 + O(h)


def test_shifted_attitude_uses_the_length_of_the_steps():
    # At t = 0.1 + 7 h the time since the start, as a difference, is a rounding off 7 h.
    span, step = (0.1, 0.1 + 70 * 0.03), 0.03
    every = co.integrate(BODY, 3 * X, span, step, co.Splitting(order=4), attitude=True)
    found = co.integrate(BODY, 3 * X, span, step, co.Splitting(order=4), attitude=True, t_eval=every.t)
    assert np.array_equal(found.attitude, every.attitude) and np.array_equal(found.x, every.x)
    assert not np.array_equal(every.t - every.t[0], np.arange(71) * step)


@pytest.mark.parametrize("span", [(0.1, 2.2), (-0.7, -2.8)])
def test_rounded_times_of_steps_are_the_steps(span):
    every = co.integrate(BODY, X, span, 0.03, co.GaussLegendre(2))
    times = np.linspace(*span, 71)
    assert not np.array_equal(times, every.t)
    found = co.integrate(BODY, X, span, 0.03, co.GaussLegendre(2), t_eval=np.clip(times, *sorted(span)))
    assert np.array_equal(found.x, every.x)


def test_failed_partial_step_keeps_earlier_states(monkeypatch):
    failing_parts(monkeypatch, 0, 0.5)
    with pytest.raises(co.IntegrationError, match=r"step 5, at t = 0.5, .* did not conv") as caught:
        co.integrate(BODY, X, (0, 1), STEP, t_eval=[0.0, 0.25, 0.5, 0.55, 1.0])
    assert caught.value.partial.t.tolist() == [0.0, 0.25, 0.5] and np.isfinite(caught.value.partial.x).all()
    assert (caught.value.step, caught.value.residual) == (5, 0.25)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("threads", [1, 2])
def test_failed_partial_step_affects_one_member(monkeypatch, way, threads):
    times = way * np.array([0.0, 0.25, 0.5, 0.55, 0.625, 0.7, 1.0])
    ensemble = np.array([X, [0.5, 1.0, -0.25], [1.5, 0.25, 0.75]])
    given = BODY, ensemble, (0, way), STEP
    whole = co.integrate(*given, t_eval=times)
    failing_parts(monkeypatch, 1, 0.5 * way)
    with pytest.raises(co.IntegrationError, match=r"did not converge .* 1 of 3 members .*member 1") as caught:
        co.integrate(*given, t_eval=times, threads=threads)
    found = caught.value.partial
    assert np.array_equal(found.x[:, [0, 2]], whole.x[:, [0, 2]])
    assert np.array_equal(found.energy[:, [0, 2]], whole.energy[:, [0, 2]])
    assert np.array_equal(found.x[:3, 1], whole.x[:3, 1]) and np.isnan(found.x[3:, 1]).all()
    assert np.isnan(found.energy[3:, 1]).all() and found.failed.tolist() == [False, True, False]


@pytest.mark.parametrize("x", [X, np.array([X, [0.5, 1.0, -0.25], [1.5, 0.25, 0.75]])], ids=["one", "three"])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_output_does_not_depend_on_chunk_size(monkeypatch, x, way):
    times = way * np.array([0.0, 0.01, 0.02, 0.25, 0.26, 0.3, 0.31, 0.5, 0.8, 0.99, 1.0])
    given = {"attitude": True, "t_eval": times}
    whole = co.integrate(BODY, x, (0, way), STEP, co.Splitting(order=4), **given)
    for rows in (1, 4, 7):
        monkeypatch.setattr(output_times, "ROWS_PER_CALL", rows)
        found = co.integrate(BODY, x, (0, way), STEP, co.Splitting(order=4), **given)
        for name in ("t", "x", "energy", "attitude"):
            assert np.array_equal(getattr(found, name), getattr(whole, name)), name
        assert np.array_equal(found.casimirs["|x|^2"], whole.casimirs["|x|^2"])


def test_noise_has_no_states_between_steps():
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Polynomial({(0, 0, 1): -1.0}))
    baths = [spin.with_forces(co.forces.HeatBath(0.1, 0.5, seed=m)) for m in range(2)]
    batch, x = co.batch(baths), np.array([X, 2 * X])
    every = co.integrate(batch, x, (0, 1), STEP)
    refused = pytest.raises(ValueError, match=r"HeatBath .* noise")
    with refused:
        co.integrate(batch, x, (0, 1), STEP, t_eval=[0.5, 0.55])
    with refused:
        co.integrate(batch, x, (0, 1), STEP, events=co.Event("x1"))
    with refused:
        every.at([0.55])
    found = co.integrate(batch, x, (0, 1), STEP, t_eval=every.t[2:5])
    assert np.array_equal(found.x, every.x[2:5])


def test_arguments_are_copied():
    times, x, g = np.array([0.0, 0.3, 0.7]), X.copy(), random_element(BODY.representation, 2)
    sol = co.integrate(BODY, x, (0, 1), STEP, co.Splitting(order=4), attitude=g, t_eval=times)
    same = co.integrate(BODY, X, (0, 1), STEP, co.Splitting(order=4), attitude=g.copy(), t_eval=times.copy())
    times[:], x[:], g[:] = 0.5, 7.0, 2.0 * np.eye(3)
    for name in ("t", "t_eval", "x", "x0", "attitude", "attitude0", "energy"):
        assert np.array_equal(getattr(sol, name), getattr(same, name)), name
    assert np.array_equal(sol.at(0.6).x, same.at(0.6).x)


@pytest.mark.parametrize("step", [STEP, 2.0**-13])
def test_memory_of_output_times_is_estimated(monkeypatch, step):
    monkeypatch.setattr("coadjoint.runs.memory_estimate.UNCHECKED_BYTES", 0)
    monkeypatch.setattr("coadjoint.memory.available", lambda: 2 * 10**5)
    monkeypatch.setattr("coadjoint.runs.output_times.PartialSteps", None)  # nothing is computed
    with pytest.raises(ValueError, match=r"^\d+ saved points .* fewer times in t_eval$"):
        co.integrate(BODY, X, (0, 1), step, t_eval=np.linspace(0.0, 1.0, 2**13 + 1))


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


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ([], "t_eval has the shape (0,)"),
        (0.5, "t_eval has the shape ()"),
        ([[0.5]], "t_eval has the shape (1, 1)"),
        ([0.5, np.nan], "t_eval contains NaN or infinity"),
        ([0.5, 0.25], "t_eval[1] is 0.25 and comes after 0.5"),
        ([-0.1, 0.25], "t_eval[0] is -0.1"),
        ([0.25, 1.001], "t_eval[1] is 1.001"),
    ],
)
def test_wrong_output_times_are_refused(times, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        co.integrate(BODY, X, (0, 1), STEP, t_eval=times)


def test_conflicting_arguments_and_empty_spans():
    with pytest.raises(ValueError, match="save_every and t_eval; give only one"):
        co.integrate(BODY, X, (0, 1), STEP, save_every=2, t_eval=[0.5])
    with pytest.raises(TypeError, match="t_eval"):
        co.integrate(BODY, X, (0, 1), STEP, t_eval="now")
    assert np.array_equal(co.integrate(BODY, X, (1, 1), STEP, t_eval=[1.0, 1.0]).x, [X, X])
    with pytest.raises(ValueError, match=r"t_eval\[0\] is 0.6.* from 0.5 to 0"):
        co.integrate(BODY, X, (0.5, 0), 0.25, t_eval=[0.6])


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
    for found in (co.integrate(BODY, X, (0, 20), accuracy=1e-9, t_eval=times), ready.run(X, (0, 20), t_eval=times)):
        assert np.abs(found.x - BODY.exact(X, times)).max() < 1e-9 * np.abs(X).max()


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
                assert agree(at_saved.attitude, sol.attitude[2] if kind else None)
                assert np.array_equal(at_saved.energy, sol.energy[2]) and isinstance(at_saved.t, float)
            again = direct.at([times[4], span[1], span[0]])
            assert np.array_equal(again.x[0], direct.x[4]) and np.array_equal(again.x[2], x)
            assert np.abs(again.x[1] - direct.x[-1]).max() == 0.0

    def test_start_and_end_outside_t_eval(self):
        sol = co.integrate(BODY, X, (0, 4), STEP, attitude=True, t_eval=[1.03, 2.07])
        whole = co.integrate(BODY, X, (0, 4), STEP, attitude=True)
        assert np.array_equal(sol.x0, X) and np.array_equal(sol.attitude0, np.eye(3))
        assert sol.drift() == whole.drift() and sol.drift()["energy"].initial == whole.energy[0]
        found = sol.at([0.5, 4.0])
        assert np.array_equal(found.x[0], whole.x[4])
        # A part of a step to 2.07, and on from there: of order two, like the run.
        assert np.abs(found.x[1] - whole.x[-1]).max() < STEP**3
        assert np.array_equal(sol.t_eval, [1.03, 2.07]) and whole.t_eval is None
        copied = copy.deepcopy(sol)
        assert np.array_equal(copied.at(0.5).x, found.x[0])

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
        with pytest.raises(ValueError, match=f"after events ended .* {last:g}"):
            sol.at([0.0, end])

    def test_members_that_would_fail_after_their_end(self):
        """x' = x^2 ends at x = 10, a step before it would be infinite."""
        line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
        system = co.LiePoissonSystem(line, co.Polynomial({(1, 1): -1.0}))
        assert system.vector_field(np.array([0.0, 2.0]))[1] == 4.0
        event = co.Event(co.Polynomial({(0, 1): 1.0, (0, 0): -10.0}), terminal=True)
        x0 = np.array([[0.0, 1.0], [0.0, 0.25]])
        sol = co.integrate(system, x0, (0, 2), 1 / 64, co.Taylor(16), save_every=128, events=event)
        found = sol.at([0.5, 1.75])
        exact = 1.0 / (1.0 / x0[:, 1] - found.t[:, None])
        assert np.abs(found.x[..., 1] - exact)[[0, 0, 1], [0, 1, 1]].max() < 1e-12 and np.isnan(found.x[1, 0]).all()
        bounded = co.systems.rigid_body(inertia=(1, 2, 3))
        other = co.integrate(bounded, np.eye(3) + 0.1, (0, 2), STEP, events=co.Event(0))
        assert np.array_equal(other.at(1.0).x, other.x[8])

    def test_wrong_times_of_at_are_refused(self, monkeypatch):
        sol = co.integrate(BODY, X, (0, 4), STEP)
        for wrong, words in (
            (4.5, "t is 4.5; it must lie within the run"),
            (-1e-9, "t is -1e-09; it must lie within the run"),
            ([[1.0]], "t has the shape (1, 1)"),
            ([], "t has the shape (0,)"),
            (np.nan, "every time must be finite"),
        ):
            with pytest.raises(ValueError, match=re.escape(words)):
                sol.at(wrong)
        monkeypatch.setattr(state_at, "MAX_STEPS", 10)
        coarse = co.integrate(BODY, X, (0, 4), STEP, save_every=12)
        assert coarse.at(1.1).x.shape == (3,)
        with pytest.raises(ValueError, match=r"12 steps after saved points.* 10"):
            coarse.at(1.45)

    def test_error_estimate_without_the_end_in_t_eval(self):
        sol = co.integrate(BODY, X, (0, 20), accuracy=1e-6, t_eval=[3.3, 7.7])
        error = np.linalg.norm(sol.x[-1] - BODY.exact(X, 7.7)) / np.linalg.norm(X)
        assert error / 10 < sol.error_estimate() < 10 * error


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_part_of_a_step_that_fails_is_named(sense):
    """The other rows do not matter; without owners, rows are members."""
    method = co.GaussLegendre(1)
    parts = PartialSteps(BODY, method, co.prepare(BODY, method, STEP).loops(STEP))
    states, none = np.array([X, X, 1e200 * X]), np.zeros((3, 0))
    times, lengths = 3.0 + np.arange(3.0), sense * np.full(3, 0.05)
    fine = parts.take(states[:2], none[:2], times[:2], lengths[:2])[0]
    np.testing.assert_allclose(fine[0], co.integrate(BODY, X, (0, lengths[0]), 0.05, method).x[-1], rtol=0, atol=1e-14)
    for owners, member in ((None, 2), (np.array([4, 7, 9]), 9)):
        message = rf"in a part of a step, of length {lengths[2]:g} from t = 5, .* for member {member}; take a smaller"
        with pytest.raises(co.IntegrationError, match=message) as raised:
            parts.take(states, none, times, lengths, owners)
        assert raised.value.time == 5.0


SIZES = [1e-15, 1.0, 1e10 / 3]


def sums(span, count):
    """Return times of equal steps, each added to the one before; and the step, and the end beyond the span."""
    step = abs(span[1] - span[0]) / count
    return span[0] + np.sign(span[1] - span[0]) * np.append(0.0, np.cumsum(np.full(count, step))), step


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("span", [(0.0, 30.0), (0.0, -30.0), (-7.0, 23.0), (40.0, 10.0)])
@pytest.mark.parametrize("members", [1, 3])
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


@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("span", [(0.0, 30.0), (0.0, -30.0), (-7.0, 23.0)])
@pytest.mark.parametrize(("times", "steps"), [(301, 300), (7, 3000), (2000, 30), (1, 1)])
def test_how_far_beyond_the_end_times_may_be(size, span, times, steps):
    """Eight units in the last place of the largest time for each time or step."""
    t0, end = size * span[0], size * span[1]
    body = co.systems.rigid_body(tuple(size * moment for moment in (1, 2, 3)))
    step, largest = abs(end - t0) / steps, size * max(*map(abs, span), abs(span[1] - span[0]))
    allowed = max(16 * U * largest, min(16 * U * largest * max(times, steps + 1), step / 100))
    ready = co.prepare(body, co.Splitting(), step)
    sol = ready.run(X, (t0, end))
    way = np.sign(end - t0)
    inside = np.linspace(t0, end, times + 1)[1:-1]
    for beyond in (end + way * 0.9 * allowed, t0 - way * 0.9 * allowed):
        at_end = abs(beyond - end) < step / 2
        row = np.append(inside, beyond) if at_end else np.append(beyond, inside)
        expected = sol.x[-1] if at_end else sol.x[0]
        assert np.array_equal(ready.run(X, (t0, end), t_eval=row).x[-1 if at_end else 0], expected)
        assert np.array_equal(sol.at(row).x[-1 if at_end else 0], expected)
    for beyond in (end + way * 1.2 * allowed, t0 - way * 1.2 * allowed):
        row = np.append(inside, beyond) if abs(beyond - end) < step / 2 else np.append(beyond, inside)
        for call in (lambda row=row: ready.run(X, (t0, end), t_eval=row), lambda row=row: sol.at(row)):
            with pytest.raises(ValueError, match="must lie within") as refused:
                call()
            # The numbers in the message differ as those that were given.
            shown = [float(text) for text in re.findall(r"-?\d+(?:\.\d+)?(?:e[+-]\d+)?", str(refused.value))[-3:]]
            assert len(set(shown)) == 3 and (shown[0] - shown[1]) * (shown[0] - shown[2]) > 0.0


def test_single_precision_times_beyond_the_end_are_refused_with_their_digits():
    times = np.cumsum(np.full(300, 0.1, dtype=np.float32))
    assert times[-1] > 30.0
    with pytest.raises(ValueError, match=r"^t_eval\[299\] is 30\.00\d+; it must lie within t_span, from 0 to 30$"):
        co.integrate(BODY, X, (0, 30), 0.1, t_eval=times)


@pytest.mark.parametrize("digits", range(6, 18))
def test_times_from_a_file_of_few_digits(digits):
    """Those that are written as the end are the end; those that are rounded up beyond it are refused."""
    for end, steps in ((30.0, 300), (10 / 3, 90), (1e-12 / 7, 70)):
        body = co.systems.rigid_body(tuple(end * moment for moment in (1, 2, 3)))
        text = [f"{t:.{digits}g}" for t in np.linspace(0.0, end, 91)]
        times = np.array(text, dtype=float)
        allowed = 16 * U * end * max(len(times), steps + 1)
        if times[-1] <= end + allowed:
            assert len(co.integrate(body, X, (0, end), end / steps, t_eval=times).t) == 91
            continue
        with pytest.raises(ValueError, match="must lie within t_span"):
            co.integrate(body, X, (0, end), end / steps, t_eval=times)


def test_noise_at_times_that_were_summed():
    """They are those of the steps; states between saved points are those of the run, with its noise."""
    for algebra, x0 in ((co.algebras.so(3), X), (co.algebras.so(4), np.linspace(0.5, 1.0, 6))):
        energy = co.Polynomial({tuple(np.eye(len(x0), dtype=int)[2]): -1.0})
        noisy = co.LiePoissonSystem(algebra, energy).with_forces(co.forces.HeatBath(0.1, 0.5, seed=3))
        times = np.append(0.0, np.cumsum(np.full(3000, 0.01)))[::10]
        every = co.integrate(noisy, x0, (0, 30), 0.1)
        assert np.abs(times - every.t).max() > 0.0
        assert np.array_equal(co.integrate(noisy, x0, (0, 30), 0.1, t_eval=times).x, every.x)
        some = co.integrate(noisy, x0, (0, 30), 0.1, save_every=7)
        assert np.array_equal(some.at(times[::11]).x, every.x[::11])
        assert np.array_equal(some.at(every.t[16]).x, every.x[16])


@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(2), co.Taylor(tolerance=1e-12)], ids=str)
def test_derivatives_at_times_that_were_summed(method):
    times = np.append(0.0, np.cumsum(np.full(3000, 0.01)))[::10]
    assert times[-1] > 30.0
    ready = co.prepare(BODY, method, 0.1)
    plain = ready.run(X, (0, 30), t_eval=times)
    sol, tangents = ready.jvp(X, (0, 30), {"x0": X}, t_eval=times)
    assert np.array_equal(sol.x, plain.x)
    # Twice as fast a start moves twice as fast: x(t; s x0) = s x(s t; x0), so the derivative by s is x + t x'.
    expected = plain.x + times[:, None] * BODY.vector_field(plain.x)
    assert np.abs(tangents.x - expected).max() < (1e-9 if method.own_steps else 5e-3)
