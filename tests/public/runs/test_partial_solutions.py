"""Runs that were interrupted or failed: their partial solutions, and what these state in texts, pictures and files."""

import numpy as np
import pytest
from interrupting import Interruptible, interrupt_after, interrupted

import coadjoint as co

BODY, X0 = co.systems.rigid_body(inertia=(1.0, 2.0, 3.0)), (1.0, 0.2, 0.1)
IN_MEMORY = ["The solution so far is the attribute partial of the error; archive= stores it on disk"]
pytestmark = pytest.mark.filterwarnings("ignore:the steps of .* are Python calls:RuntimeWarning")


@pytest.fixture(scope="module")
def cut():
    """Return a run that was interrupted after some of its 2^25 steps, and what is stated of it."""
    run = co.prepare(BODY, co.Splitting(order=4), 1 / 1024).run
    run(X0, (0, 4), 2**12)
    with pytest.raises(KeyboardInterrupt) as raised, interrupt_after(0.2):
        run(X0, (0, 2**15), 2**12)
    partial = raised.value.partial
    return partial, f"{len(partial.t)} points from t = 0 to {partial.t[-1]:g} of {2**15}, interrupted"


@pytest.mark.parametrize("suffix", ["nc", "zarr"])
def test_interrupted_runs_are_read_back_as_such(cut, suffix, tmp_path):
    partial, stated = cut
    path, dataset = tmp_path / f"run.{suffix}", partial.to_xarray()
    assert dataset.attrs["run_incomplete"] == 1 and dataset.attrs["incomplete_time"] == partial.t[-1]
    dataset.to_netcdf(path, engine="h5netcdf") if suffix == "nc" else dataset.to_zarr(path, zarr_format=2)
    loaded = co.load(path)
    assert loaded.incomplete == "interrupted" and stated in repr(loaded) and stated in loaded._repr_html_()
    np.testing.assert_array_equal(loaded.x, partial.x)
    assert stated in repr(co.load(path)), "again"
    assert loaded.stats.steps == partial.stats.steps < 2**25


@pytest.mark.parametrize("seconds", [0.001, 0.01, 0.03, 0.1])
@pytest.mark.parametrize("t_eval", [None, np.linspace(2.0, 2**12, 2**22 - 2**11 + 1)])
def test_points_of_a_run_interrupted_at_any_moment_were_computed(seconds, t_eval):
    """Also while the memory of the points is filled, before the first step."""
    run = co.prepare(BODY, co.Splitting(), 1 / 1024).run
    run(X0, (0, 1))
    with pytest.raises(KeyboardInterrupt) as raised, interrupt_after(seconds):
        run(X0, (0, 2**12), t_eval=t_eval)
    if (found := getattr(raised.value, "partial", None)) is not None and len(found.t):
        assert found.stats.steps == round(found.t[-1] * 1024)
        np.testing.assert_array_equal(found.x[-1], run(X0, (0, found.t[-1]), 2**22).x[-1])


@pytest.mark.parametrize("still", [0, 1])
@pytest.mark.parametrize("members", [0, 2])
def test_failed_runs_count_the_steps_before_the_failure(members, still):
    """Members take all steps, of which those after a failure are empty."""
    system = co.LiePoissonSystem(co.systems.riccati().algebra, co.Polynomial({(2, 1, 0): 1.0}))
    x0 = np.array([[1.0, 1.0, 0.0]] * members + [[0.0, 0.0, 0.0]] * still) if members else (1.0, 1.0, 0.0)
    with pytest.raises(co.IntegrationError) as failed:
        co.integrate(system, x0, (0, 5), 0.125, co.GaussLegendre(2), save_every=3)
    error, planned = failed.value, 40
    assert 1 < error.step < planned
    assert error.partial.stats.steps == (planned if members else error.step - 1)


@pytest.mark.parametrize("t0, sense", [(0.0, 1), (7.0, -1)])
def test_interrupted_ensembles_work_on_members_as_far_as_they_ran(t0, sense):
    """The first member runs to its end, the second for 20 units of time, and the third has not begun."""
    states = np.array([X0, (0.3, 1.0, 0.1), (0.2, 0.3, 1.0)]) * [[1.0], [4.0], [1.0]]

    method = Interruptible(t0 + sense * 19.95, 2.0)

    def run(x0, end):
        return co.integrate(BODY, x0, (t0, t0 + sense * end), 0.1, method, save_every=20, threads=1)

    cut = interrupted(lambda: run(states, 60.0)).partial
    first, second = run(states[0], 60.0), run(states[1], 20.0)
    energies = cut.drift()["energy"].members
    assert not energies[2] > 0.0 and 0 < cut.drift()["energy"] == max(energies[:2])
    np.testing.assert_array_equal(cut.error_estimate(), [first.error_estimate(), np.nan, np.nan])
    np.testing.assert_array_equal(cut.x[:, 0], first.x)
    np.testing.assert_array_equal(cut.x[:11, 1], second.x)
    assert np.isnan(cut.x[11:, 1]).all() and np.isnan(cut.x[1:, 2]).all()
    # Just before the last saved point of the second member, and after it.
    for after, lost in ((15.05, False), (19.95, False), (20.05, True), (59.95, True)):
        t = t0 + sense * after
        there = cut.at(t).x
        np.testing.assert_array_equal(there[0], first.at(t).x)
        np.testing.assert_array_equal(there[1], [np.nan] * 3 if lost else second.at(t).x)
        assert np.isnan(there[2]).all()
    assert len(cut.plot("components", members=[0, 1]).axes) == 1


def test_interrupted_batches_have_the_members_that_ran_in_their_places():
    """Members are run system by system, here 0, 2, 4, 1, 3: the last one is interrupted."""
    other = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    batch, method = co.batch([(BODY, other)[m % 2] for m in range(5)]), Interruptible(19.95, 2.0)
    states = np.array(X0) * [[0.5], [0.75], [1.0], [4.0], [1.25]]

    def run(system, x0, end):
        return co.integrate(system, x0, (0, end), 0.1, method, save_every=20, threads=1)

    cut = interrupted(lambda: run(batch, states, 60.0)).partial
    for m, system in enumerate(batch):
        alone = run(system, states[m], 20.0 if m == 3 else 60.0)
        np.testing.assert_array_equal(cut.x[: len(alone.x), m], alone.x)
    assert np.isnan(cut.x[11:, 3]).all() and len(cut.t) == 31


@pytest.mark.parametrize("options", [{}, {"watch": False, "save_every": 7}])
@pytest.mark.parametrize("sense", [1, -1])
def test_a_partial_solution_has_the_bits_of_the_whole_run(options, sense):
    span, method = (2.0, 2.0 + 10.0 * sense), Interruptible(2.0 + 4.9 * sense)
    expected = co.integrate(BODY, X0, span, 0.125, method, **options)
    stopped = interrupted(lambda: co.integrate(BODY, X0, span, 0.125, method, **options))
    found, count = stopped.partial, len(stopped.partial.t)
    assert stopped.__notes__ == IN_MEMORY
    assert count == 1 + 40 // options.get("save_every", 1)
    for name in ("t", "x", "energy"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[:count])
    deviation = np.abs(found.energy - expected.energy[0]).max()
    assert found.drift(relative=False)["energy"] == deviation and not found.watched


FLUID = co.systems.sphere_euler(N=4)
COMPILED = {
    "first run": (BODY, X0, co.Splitting(order=4), {"attitude": True}),
    "members": (BODY, np.multiply.outer(1.0 - 0.01 * np.arange(70), X0), co.Splitting(), {"threads": 2}),
    "matrices": (FLUID, FLUID.random(seed=1), co.IsospectralGauss(1), {}),
}


@pytest.mark.parametrize("name", COMPILED)
def test_compiled_loops_are_interrupted_between_their_steps(name):
    system, x0, method, options = COMPILED[name]
    ready, step, every = co.prepare(system, method, 1 / 1024, **options), 1 / 1024, 2**12
    first = ready.run(x0, (0, 2 * every * step), every)  # compiles functions, and checks the step
    with pytest.raises(KeyboardInterrupt) as stopped, interrupt_after(0.2):
        ready.run(x0, (0, 2**14), every)
    found, count = stopped.value.partial, min(len(stopped.value.partial.t), 3)
    assert stopped.value.__notes__ == IN_MEMORY and found.incomplete == "interrupted" and 0 < len(found.t) <= 2**12 + 1
    finite = np.isfinite(found.x[:count])
    assert finite.any()
    np.testing.assert_array_equal(found.x[:count][finite], first.x[:count][finite])
    if options.get("attitude"):
        np.testing.assert_array_equal(found.attitude[:count], first.attitude[:count])
    np.testing.assert_array_equal(ready.run(x0, (0, 2 * every * step), every).x, first.x)


def test_interrupted_archives_state_how_to_continue(tmp_path):
    """The rest has the bits of a run that was not interrupted."""
    path, step, method = tmp_path / "run.zarr", 1 / 1024, co.Splitting(order=4)
    with pytest.raises(KeyboardInterrupt) as stopped, interrupt_after(0.6):
        co.integrate(BODY, X0, (0, 2**15), step, method, save_every=2**14, archive=path)
    partial = stopped.value.partial
    assert stopped.value.__notes__ == [
        f"{path} contains the computed steps; co.resume({str(path)!r}) continues the run"
    ]
    assert len(partial.t) == 1 + partial.reached // 2**14 and 0 <= partial.reached < 2**25
    more = co.resume(path, until=partial.reached + 2**15)
    count = len(more.t)
    assert more.incomplete == "unfinished" and f"of {2**15}, unfinished" in more._repr_html_()
    expected = co.integrate(BODY, X0, (0, (count - 1) * 16), step, method, save_every=2**14)
    np.testing.assert_array_equal(more.x, expected.x)
    np.testing.assert_array_equal(partial.x, expected.x[: len(partial.t)])


def test_failed_runs(tmp_path):
    """The exact flow of a dilation overflows, and the stages of a large step do not converge."""
    H = co.Quadratic(((1.0, 0.3, 0.0), (0.3, -2.0, 0.1), (0.0, 0.1, 0.5)))
    dilation = co.LiePoissonSystem(co.algebras.get("A3,7", a=2.0), H)
    with pytest.raises(co.IntegrationError) as overflow:
        co.integrate(dilation, (1e3, 2e3, 3e3), (0, 20), 0.5)
    assert repr(overflow.value.partial).count(" of 20, failed,") == 1
    with pytest.raises(co.IntegrationError) as series:
        co.integrate(co.systems.heavy_top(), (0.3, 0.2, 3, 0.6, 0, 0.8), (0, 100), 5.0, co.Taylor(order=8))
    marked = co.results.mark_failed(overflow.value.partial.to_xarray(), overflow.value)
    for error, dataset in ((overflow, marked), (series, series.value.partial.to_xarray())):
        path = tmp_path / "failed.nc"
        dataset.to_netcdf(path, engine="h5netcdf")
        found = co.load(path)
        assert found.incomplete == error.value.partial.incomplete == "failed" and "failed" in repr(found)
        assert found.stats.steps == error.value.partial.stats.steps == error.value.step - 1


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.Taylor(order=8), co.ExplicitRungeKutta("rk4")], ids=str)
def test_members_that_fail_keep_the_deviations_of_their_last_steps(method):
    """Members side by side, of which one overflows in the first tenth: all of its energies count."""
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    system = co.LiePoissonSystem(line, co.Polynomial({(0, 2): 0.5, (1, 1): 0.3}))
    x0 = np.column_stack([np.full(8, 0.3), [*np.linspace(0.01, 0.07, 7), 40.0]])
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(system, x0, (0, -20), 0.125, method)
    sol = failure.value.partial
    assert 1 < failure.value.step < 16 and np.isnan(sol.x[-1]).all(axis=-1).tolist() == 7 * [False] + [True]
    tenth = np.maximum(np.rint(-sol.t / 0.125) - 1, 0) * 10 // 160
    deviations = np.abs(sol.energy - sol.energy[0])
    expected = [np.nan_to_num(deviations[tenth == k]).max(axis=0) for k in range(10)]
    tenths = sol.drift(relative=False)["energy"].tenths
    assert np.array_equal(tenths.T, expected) and tenths[7, 0] > 1e9
