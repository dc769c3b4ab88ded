"""What an archive refuses: another system, observable or scheme, other bits, failed runs, names that are taken."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from storing import BODY, STEP, X, at_write, contents, cut, raising, whole

import coadjoint as co
from hostile_archives import edit_attributes
from refusals import refused
from same_runs import check_same

SPAN = (0.0, 16 * STEP)
pytestmark = pytest.mark.usefixtures("no_fsync")


def with_wells(factor=1.0):
    def scaled(y):
        return factor * 0.5 * y * y

    def slope(y):
        return factor * y

    def well(y):
        return 0.5 * y * y + 0.1 * y**4

    def slope_of_well(y):
        return y + 0.4 * y**3

    return co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (well, slope_of_well), 1: (scaled, slope)}))


def far(x):
    return x[0] * x[1]


def farther(x):
    return 2.0 * x[0] * x[1]


Q, A = co.Polynomial({(2, 0, 0): 1.0}), co.Quadratic([1.0, 2.0, 3.0], linear=[0.5, 0.0, 0.0])


def test_functions_must_be_given_again(tmp_path):
    path, observe = tmp_path / "run.zarr", {"far": far, "q": Q}
    cut(path, with_wells(), observe=observe)
    assert co.open_archive(path).x.shape == (3, 3)
    for named, given in (
        (("not stored", "well", "system="), {}),
        (("differs", "system"), {"system": with_wells(2.0), "observe": observe}),
        (("not stored", "far", "observe="), {"system": with_wells()}),
        (("differs", "far"), {"system": with_wells(), "observe": {**observe, "far": farther}}),
        (("['far', 'q']", "['far']"), {"system": with_wells(), "observe": {"far": far}}),
        (("observe", "differs"), {"system": with_wells(), "observe": {**observe, "q": co.Polynomial("x2^2", dim=3)}}),
    ):
        before = contents(path)
        with refused(ValueError, *named):
            co.resume(path, **given)
        assert contents(path) == before
    found = co.resume(path, system=with_wells(), observe=observe)
    check_same(found, whole(with_wells(), observe=observe))
    assert co.open_archive(path, with_wells()).system.hamiltonian is not None


def test_stored_observables_need_not_be_given(tmp_path):
    cut(tmp_path / "run.zarr", observe={"b": Q, "a": A})
    check_same(co.resume(tmp_path / "run.zarr"), whole(observe={"b": Q, "a": A}))


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    "other",
    [
        {"b": co.Polynomial({(0, 2, 0): 1.0})},
        {"b": co.Polynomial({(2, 0, 0): 1.0 + 2.0**-50})},
        {"b": far},
        {"a": co.Quadratic([1.0, 2.0, 3.0])},
        {"a": co.Polynomial({(2, 0, 0): 0.5})},
    ],
)
@pytest.mark.parametrize("several", [False, True])
def test_another_observable_of_the_same_name_is_refused(tmp_path, other, several):
    observe, path = {"b": Q, "a": A}, tmp_path / "run.zarr"
    if several:
        co.integrate_ensemble(BODY, [X, X], SPAN, STEP, co.GaussLegendre(2), archive=path, observe=observe)
    else:
        cut(path, observe=observe)
    (name,) = other
    with refused(ValueError, f"observe['{name}']", "differs"):
        co.resume(path, observe={**observe, **other})
    assert co.resume(path, observe={name: 1 * observable for name, observable in observe.items()}).finished


@pytest.mark.parametrize("events", [co.Event("x1"), [co.Event(Q)]])
def test_events_of_a_run_without_any_and_output_times_are_refused(tmp_path, events):
    cut(tmp_path / "run.zarr")
    with refused(ValueError, "events"):
        co.resume(tmp_path / "run.zarr", events=events)
    assert co.resume(tmp_path / "run.zarr", events=[]).finished
    with refused(ValueError, "archive", "t_eval"):
        co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "new.zarr", t_eval=[0.5])
    assert os.listdir(tmp_path) == ["run.zarr"]


SQUARE = co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})


def with_casimir(casimir):
    return co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1, casimirs={"C": casimir})


def without_algebra(casimir, weight=0.5):
    def turning(x):
        return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])

    return co.PoissonSystem(turning, co.Quadratic([1.0, weight, 0.25]), dim=3, casimirs={"C": casimir})


def damped(rate):
    return BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x * (1.0 - rate * tau)))


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("first", "other"),
    [
        (lambda: with_casimir(SQUARE), lambda: with_casimir(2 * SQUARE)),
        (lambda: with_casimir(lambda x: x @ x), lambda: with_casimir(lambda x: 2.0 * (x @ x))),
        (lambda: without_algebra(SQUARE), lambda: without_algebra(2 * SQUARE)),
        (lambda: without_algebra(SQUARE), lambda: without_algebra(SQUARE, 0.75)),
        (lambda: damped(0.1), lambda: damped(0.2)),
        (lambda: BODY, lambda: co.systems.rigid_body((1, 2, 2.75))),
    ],
)
def test_another_system_is_refused(tmp_path, first, other):
    cut(tmp_path / "run.zarr", first())
    with refused(ValueError, "system is"):
        co.resume(tmp_path / "run.zarr", system=other())
    assert co.open_archive(tmp_path / "run.zarr").reached == 5


def test_another_energy_of_matrices_is_refused(tmp_path):
    def system(bound):
        # The energies agree along the run, so that the steps have the same bits.
        stream, algebra = (lambda W: W.T @ W @ W.T), co.MatrixAlgebra("gl", 3)
        return co.MatrixSystem(algebra, stream, energy=lambda W: min(np.sum((W @ W.T) ** 2) / 4, bound))

    path, W = tmp_path / "run.zarr", np.random.default_rng(3).uniform(-0.5, 0.5, (3, 3))
    cut(path, system(1e3), W, method=co.IsospectralGauss(2))
    with refused(ValueError, "system", "differs"):
        co.resume(path, system=system(1e4))
    assert co.resume(path, system=system(1e3)).finished


def test_another_helper_of_a_compiled_function_is_refused(tmp_path):
    numba = pytest.importorskip("numba")

    def system(factor):
        # Both agree near the start, so that the first step has the same bits.
        helper = numba.njit(lambda y: y if y < 100.0 else factor * y)
        return co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (lambda y: 0.5 * y * helper(y), helper)}))

    cut(tmp_path / "run.zarr", system(1.0))
    with refused(ValueError, "system", "differs"):
        co.resume(tmp_path / "run.zarr", system=system(2.0))
    assert co.resume(tmp_path / "run.zarr", system=system(1.0)).finished


def test_uncomparable_functions_warn(tmp_path):
    """A function may read values that no fingerprint contains."""
    fluid, path = co.systems.sphere_euler(4), tmp_path / "run.zarr"
    observe = {"odd": lambda W: eval("W")[0, 1].real, "even": lambda W: W[0, 1].imag}
    co.integrate(fluid, fluid.random(seed=1), SPAN, STEP, observe=observe, archive=path)
    with refused(ValueError, "['odd', 'even']", "['even', 'odd']"):
        co.resume(path, 4.0, observe=dict(reversed(observe.items())))
    with pytest.warns(UserWarning, match="observe is compared without"):
        found = co.resume(path, 4.0, observe=observe)
    np.testing.assert_array_equal(found.observed["odd"], found.x[:, 0, 1].real)


def test_first_step_with_other_bits_is_refused(tmp_path):
    """As on a machine or with a library that rounds differently."""
    cut(tmp_path / "run.zarr")
    edit_attributes(tmp_path / "run.zarr", archive_first_step="0" * 64)
    with refused(ValueError, "first step", "bits"):
        co.resume(tmp_path / "run.zarr")


def test_a_scheme_that_is_not_registered_is_named(tmp_path):
    path = tmp_path / "run.zarr"
    found = cut(path)
    method = json.loads(found.attributes["method"])
    edit_attributes(path, method=json.dumps({**method, "name": "Unlisted"}))
    for read in (lambda: co.resume(path), lambda: co.load(path).method):
        with refused(ValueError, "Unlisted", "not registered") as error:
            read()
        assert "damaged" not in str(error.value)


FAILING = (BODY, (3.0, -20.0, 7.0), (7.0, 107.0), STEP, co.ExplicitRungeKutta("runge2"))
"""The step is so long that the numbers overflow."""


def test_failed_run_raises_the_same_error_again(tmp_path):
    path = tmp_path / "run.zarr"
    with pytest.raises(co.IntegrationError) as plain:
        co.integrate(*FAILING, save_every=3)
    assert plain.value.step > 3 and plain.value.time == 7.0 + (plain.value.step - 1) * STEP
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(*FAILING, save_every=3, archive=path)
    with pytest.raises(co.IntegrationError) as again:
        co.resume(path)
    for error in (failure.value, again.value):
        np.testing.assert_equal(error.residual, plain.value.residual)
        assert (str(error), error.step, error.time) == (str(plain.value), plain.value.step, plain.value.time)
        assert error.partial.finished and error.partial.attributes["run_failed"] == 1
        assert co.open_archive(path).status.tolist() == [2]
        assert np.array_equal(error.partial.x, plain.value.partial.x)
        assert np.array_equal(error.partial.t, plain.value.partial.t)
    edit_attributes(path, failed_step=3, failed_time=7.25, failed_residual=0.5)
    with pytest.raises(co.IntegrationError) as stored:
        co.resume(path)
    assert (stored.value.step, stored.value.time, stored.value.residual) == (3, 7.25, 0.5)


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("stops", [(7,), (4, 5, 6, 11)])
def test_an_energy_is_undefined_from_its_first_point_on(tmp_path, sense, stops):
    """Also if a run is stored in pieces, and it is undefined in several of them."""

    def square(y, t):
        return np.where(sense * (t - 0.5) > 0.6, np.nan, 0.5 * y * y)

    system = co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (square, lambda y, t: y)}))
    path, run = tmp_path / "run.zarr", (0.125, co.Splitting())
    with pytest.raises(co.IntegrationError) as plain:
        co.integrate(system, X, (0.5, 0.5 + 2.5 * sense), *run)
    assert plain.value.step == 5 and "energy" in str(plain.value)
    co.integrate(system, X, (0.5, 0.5 + 0.25 * sense), *run, archive=path)
    for stop in stops:
        co.resume(path, 0.5 + 2.5 * sense, system=system, until=stop)
    with pytest.raises(co.IntegrationError) as failure:
        co.resume(path, system=system)
    assert (str(failure.value), failure.value.step) == (str(plain.value), 5)
    assert failure.value.time == plain.value.time == 0.5 + 0.625 * sense


def test_a_failed_run_is_not_extended(tmp_path):
    algebra, path = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}}), tmp_path / "run.zarr"
    growing = co.LiePoissonSystem(algebra, co.Quadratic([[0.0, 1.0], [1.0, 0.0]]))
    with refused(co.IntegrationError) as failure:
        co.integrate(growing, (3.0, -3.0), (0, 4), 0.01, co.ExplicitRungeKutta("rk4"), archive=path)
    for _ in range(2):
        with refused(co.IntegrationError, failure.value) as again:
            co.resume(path, t_end=8.0)
        assert again.value.step == failure.value.step and co.open_archive(path).t_span == (0.0, 4.0)


def test_failed_members_leave_the_others(tmp_path):
    """[e1, e2] = e2 with H = x1 gives x2' = x2, which overflows where it begins large."""
    algebra, path = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}}), tmp_path / "run.zarr"
    system = co.LiePoissonSystem(algebra, co.Quadratic(0.0, linear=[1.0, 0.0]), sign=-1)
    x0, run = np.array([[1.0, 1e304], [1.0, 1.0], [1.0, 1e303]]), (0.5, co.Splitting())
    with pytest.raises(co.IntegrationError) as plain:
        co.integrate(system, x0, (0.0, 20.0), *run)
    co.integrate(system, x0, (0.0, 0.5), *run, archive=path)
    assert co.resume(path, 20.0, until=7).failed.tolist() == [False] * 3
    with pytest.raises(co.IntegrationError) as failure:
        co.resume(path)
    assert str(failure.value) == str(plain.value)
    assert failure.value.partial.failed.tolist() == [True, False, True]
    check_same(failure.value.partial, plain.value.partial)


def test_finished_run_is_not_computed_again(tmp_path):
    found = co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    with at_write(lambda name: True, 1, raising(AssertionError)) as written:
        again = co.resume(tmp_path / "run.zarr")
    assert again.finished and np.array_equal(again.x, found.x) and not written


@pytest.mark.parametrize(
    ("archive", "error", "named"),
    [
        (3, TypeError, ("archive", "3")),
        ("a\0b", ValueError, ("path",)),
        ("x" * 300, ValueError, ("name", "too long")),
        ("none/run.zarr", ValueError, ("folder", "none does not exist")),
    ],
)
def test_invalid_archive_path_is_refused_before_the_run(tmp_path, monkeypatch, archive, error, named):
    monkeypatch.chdir(tmp_path)
    long = (BODY, X, (0.0, 1e9), STEP)
    with refused(error, *named):
        co.integrate(*long, save_every=10**9, archive=archive)
    with refused(error, *named):
        co.integrate_ensemble(BODY, [X], (0.0, 1e9), STEP, save_every=10**9, archive=archive)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("kind", ["archive", "folder", "file", "link to nothing"])
def test_what_has_the_name_is_not_replaced(tmp_path, kind):
    path = tmp_path / "run.zarr"
    if kind == "archive":
        co.integrate(BODY, X, SPAN, STEP, archive=path)
    elif kind == "link to nothing":
        path.symlink_to(tmp_path / "none")
    else:
        path.mkdir() if kind == "folder" else path.write_text("precious")
    before = contents(tmp_path)
    with refused(ValueError, "run.zarr", "exists"):
        co.integrate(BODY, X, SPAN, STEP, archive=path)
    with refused((ValueError, OSError), "run.zarr"):
        co.integrate_ensemble(BODY, [X], SPAN, STEP, archive=path)
    assert contents(tmp_path) == before and os.listdir(tmp_path) == ["run.zarr"]
    assert path.is_symlink() == (kind == "link to nothing")


MEASURED_RUN = """
import resource, sys
import coadjoint as co
steps, path = int(sys.argv[1]), sys.argv[2]
body = co.systems.rigid_body(inertia=(1, 2, 2.5))
co.integrate(body, (1.0, 0.2, 0.1), (0, steps / 64), 1 / 64, co.Splitting(order=2), save_every=8, archive=path)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_memory(steps, path):
    """Return the largest resident memory (bytes) of a run in a separate process."""
    environment = {**os.environ, "PYTHONPATH": str(Path(co.__file__).parents[1])}
    command = [sys.executable, "-c", MEASURED_RUN, str(steps), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    return int(done.stdout) * (1 if sys.platform == "darwin" else 1024)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="the largest memory of a process is read by getrusage")
def test_memory_of_archived_runs_is_bounded(tmp_path):
    """Ten times the steps take less than one chunk more of all arrays: time, three components, energy, Casimir."""
    chunk = 65536 * 8 * 6
    short, long = (peak_memory(steps, tmp_path / f"{steps}.zarr") for steps in (10**6, 10**7))
    assert long - short < chunk < 10**7 // 8 * 8 * 6 / 10
