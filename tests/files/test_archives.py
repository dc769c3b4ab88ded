"""Archives of runs: resuming, refusals, failures and memory."""

import json
import os
import pickle
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint.files.archives.reading import ArchiveError
from coadjoint.files.archives.resume import archive_run
from coadjoint.files.datasets.content_checksum import CHECKSUM
from coadjoint.files.output.output_files import write_dataset
from coadjoint.methods import registry
from coadjoint.runs.piecewise_run import PiecewiseRun
from coadjoint.runs.prepared_run import PreparedRun
from verification.test_archived_runs import assert_same

BODY, X = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, -1.0, 0.7)
SPAN, STEP = (0.0, 2.0), 0.125
pytestmark = pytest.mark.usefixtures("no_fsync")


def cut(path, system=BODY, x0=X, until=5, method=None, every=2, **options):
    """Interrupt a run after some of its steps."""
    ready = PreparedRun(system, method or co.GaussLegendre(2), STEP, **options)
    return archive_run(ready, x0, SPAN, every, path, until=until)


@pytest.mark.filterwarnings("error")
def test_xarray_reads_the_dataset_of_the_run(tmp_path):
    """Variables, dimensions, coordinates, attributes and bits are those of `to_xarray`."""
    x0 = np.multiply.outer([1.0, 0.9], X)
    method, options = co.GaussLegendre(2), {"attitude": "coadjoint", "observe": {"q": co.Polynomial({(1, 1, 0): 2.0})}}
    expected = co.integrate(BODY, x0, SPAN, STEP, method, save_every=3, **options).to_xarray()
    found = co.integrate(BODY, x0, SPAN, STEP, method, save_every=3, archive=tmp_path / "run.zarr", **options)
    for dataset in (xarray.open_zarr(tmp_path / "run.zarr"), found.to_xarray()):
        assert set(dataset.variables) == set(expected.variables) and dict(dataset.sizes) == dict(expected.sizes)
        for name, variable in expected.variables.items():
            assert dataset[name].dims == variable.dims and dataset[name].attrs == variable.attrs
            assert np.array_equal(dataset[name].values, variable.values), name
        assert all(
            dataset.attrs[name] == value
            for name, value in expected.attrs.items()
            if name not in ("seconds", "elapsed", CHECKSUM)
        )
    assert found.observed["q"].shape == (7, 2) and "platform" in dataset.attrs


def described_runs():
    """Yield runs whose datasets have every kind of variable."""
    gauss = co.GaussLegendre(2)
    fluid = co.systems.sphere_euler(4)
    forced = BODY.with_forces(co.forces.LinearDamping(0.1))
    yield "vectors", (BODY, X, SPAN, STEP, gauss), {"attitude": True, "observe": {"q": co.Polynomial({(2, 0, 0): 1.0})}}
    yield "matrices", (fluid, fluid.random(seed=1, degrees=(1, 3)), SPAN, STEP, co.IsospectralGauss(1)), {}
    yield "forces", (forced, X, SPAN, STEP, gauss), {}


@pytest.mark.thinned(4)
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("run", "options"), [pytest.param(*run, id=name) for name, *run in described_runs()])
@pytest.mark.parametrize("how", ["archive", "ensemble", "file"])
def test_variables_follow_cf_conventions(tmp_path, run, options, how):
    """All numbers have units and long names, and dimensions with names have coordinates."""
    path = tmp_path / "run.zarr"
    if how == "ensemble":
        system, x0, *rest = run
        co.ensemble(system, np.multiply.outer([1.0, 0.5], x0), *rest, archive=path, **options)
    elif how == "archive":
        co.integrate(*run, archive=path, **options)
    else:
        write_dataset(co.integrate(*run, **options).to_xarray(), path)
    with xarray.open_zarr(path) as found:
        assert found.attrs["Conventions"] == "CF-1.11"
        for name, variable in found.variables.items():
            assert variable.attrs["long_name"], name
            assert (variable.attrs.get("units") == "1") == (variable.dtype.kind == "f"), name
        assert found["time"].dims == ("time",) and found["time"].dtype == "float64"
        assert set(found.dims) - set(found.coords) <= {"member", "row", "column"}
        assert found["x"].dims[0] == "time" and found["energy"].dims == found["x"].dims[: found["energy"].ndim]


def well(y):
    return 0.5 * y * y + 0.1 * y**4


def slope(y):
    return y + 0.4 * y**3


def wells(factor=1.0):
    def scaled(y):
        return factor * 0.5 * y * y

    def scaled_slope(y):
        return factor * y

    return co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (well, slope), 1: (scaled, scaled_slope)}))


def far(x):
    return x[0] * x[1]


def farther(x):
    return 2.0 * x[0] * x[1]


def test_functions_must_be_given_again(tmp_path):
    path, observe = tmp_path / "run.zarr", {"far": far, "q": co.Polynomial({(2, 0, 0): 1.0})}
    expected = co.integrate(wells(), X, SPAN, STEP, co.GaussLegendre(2), save_every=2, observe=observe)
    cut(path, wells(), observe=observe)
    assert co.open_archive(path).x.shape == (3, 3)
    with pytest.raises(ArchiveError, match=r"not stored \(hamiltonian: well, .*system=..."):
        co.resume(path)
    with pytest.raises(ArchiveError, match="differs from that of the run"):
        co.resume(path, system=wells(2.0), observe=observe)
    with pytest.raises(ArchiveError, match=r"not stored \(far\).*observe=..."):
        co.resume(path, system=wells())
    with pytest.raises(ArchiveError, match=r"differs .*functions \(far\)"):
        co.resume(path, system=wells(), observe={**observe, "far": farther})
    with pytest.raises(ArchiveError, match=r"the run observes \['far', 'q'\], but observe has \['far'\]"):
        co.resume(path, system=wells(), observe={"far": far})
    found = co.resume(path, system=wells(), observe=observe)
    assert found.finished
    assert_same(found, expected)
    assert co.open_archive(path, wells()).system.hamiltonian is not None


def test_stored_observables_need_not_be_given(tmp_path):
    observe = {"b": co.Polynomial({(2, 0, 0): 1.0}), "a": co.Quadratic([1.0, 2.0, 3.0], linear=[0.5, 0.0, 0.0])}
    expected = co.integrate(BODY, X, SPAN, STEP, co.GaussLegendre(2), save_every=2, observe=observe)
    cut(tmp_path / "run.zarr", observe=observe)
    assert_same(co.resume(tmp_path / "run.zarr"), expected)


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
    observe = {"b": co.Polynomial({(2, 0, 0): 1.0}), "a": co.Quadratic([1.0, 2.0, 3.0], linear=[0.5, 0.0, 0.0])}
    if several:
        co.ensemble(BODY, [X, X], SPAN, STEP, co.GaussLegendre(2), archive=tmp_path / "run.zarr", observe=observe)
    else:
        cut(tmp_path / "run.zarr", observe=observe)
    (name,) = other
    with pytest.raises(ArchiveError, match=rf"observe\['{name}'\] is .*, which differs from that of the run"):
        co.resume(tmp_path / "run.zarr", observe={**observe, **other})
    same = {name: 1 * observable for name, observable in observe.items()}
    assert co.resume(tmp_path / "run.zarr", observe=same).finished


def test_observable_beside_a_function_is_compared(tmp_path):
    observe = {"far": far, "q": co.Polynomial({(2, 0, 0): 1.0})}
    cut(tmp_path / "run.zarr", observe=observe)
    with pytest.raises(ArchiveError, match=r"observe is .*, which differs from that of the run"):
        co.resume(tmp_path / "run.zarr", observe={**observe, "q": co.Polynomial({(0, 2, 0): 1.0})})


@pytest.mark.parametrize("events", [co.Event("x1"), [co.Event(co.Polynomial({(2, 0, 0): 1.0}))]])
def test_events_are_refused(tmp_path, events):
    cut(tmp_path / "run.zarr")
    with pytest.raises(ArchiveError, match="the run has no events; omit events"):
        co.resume(tmp_path / "run.zarr", events=events)
    assert co.resume(tmp_path / "run.zarr", events=[]).finished


SQUARE = co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1})
TWICE = 2 * SQUARE


def with_casimir(casimir):
    return co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1, casimirs={"C": casimir})


def turning(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def without_algebra(casimir, weight=0.5):
    energy = co.Quadratic([1.0, weight, 0.25])
    return co.PoissonSystem(turning, energy, dim=3, casimirs={"C": casimir})


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    ("first", "other"),
    [
        (lambda: with_casimir(SQUARE), lambda: with_casimir(TWICE)),
        (lambda: with_casimir(lambda x: x @ x), lambda: with_casimir(lambda x: 2.0 * (x @ x))),
        (lambda: without_algebra(SQUARE), lambda: without_algebra(TWICE)),
        (lambda: without_algebra(SQUARE), lambda: without_algebra(SQUARE, 0.75)),
        (
            lambda: BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x * (1.0 - 0.1 * tau))),
            lambda: BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x * (1.0 - 0.2 * tau))),
        ),
    ],
)
def test_another_invariant_or_force_is_refused(tmp_path, first, other):
    cut(tmp_path / "run.zarr", first())
    with pytest.raises(ArchiveError, match=r"system is .*, (but the run has|which differs from that of the run)"):
        co.resume(tmp_path / "run.zarr", system=other())


def test_first_step_with_other_bits_is_refused(tmp_path, monkeypatch):
    """As on a machine or with a library that rounds differently."""
    cut(tmp_path / "run.zarr")
    monkeypatch.setattr("coadjoint.files.archives.resume.first_step", lambda *_: "other")
    with pytest.raises(ArchiveError, match="first step differs in bits"):
        co.resume(tmp_path / "run.zarr")


def test_finished_run_is_not_computed_again(tmp_path, monkeypatch):
    found = co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    monkeypatch.setattr("coadjoint.files.archives.resume.ArchiveStore", None)
    again = co.resume(tmp_path / "run.zarr")
    assert again.finished and np.array_equal(again.x, found.x)


def test_failed_run_raises_the_same_error_again(tmp_path):
    # The step is so long that the numbers overflow.
    run, options = (BODY, (3.0, -20.0, 7.0), (0, 100), STEP, co.ExplicitRungeKutta("runge2")), {"save_every": 3}
    with pytest.raises(co.IntegrationError) as plain:
        co.integrate(*run, **options)
    assert plain.value.step > 3
    path = tmp_path / "run.zarr"
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(*run, archive=path, **options)
    with pytest.raises(co.IntegrationError) as again:
        co.resume(path)
    for error in (failure.value, again.value):
        np.testing.assert_equal(error.residual, plain.value.residual)
        assert (str(error), error.step, error.time) == (str(plain.value), plain.value.step, plain.value.time)
        assert error.partial.finished and error.partial.attributes["run_failed"] == 1
        assert np.array_equal(error.partial.x, plain.value.partial.x)
        assert np.array_equal(error.partial.t, plain.value.partial.t)


def test_failed_members_leave_the_others(tmp_path):
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, -1.0, 2.0]))
    x0, path = np.array([[1.0, 1.0, 0.0], [1.0, 0.5, 0.25]]), tmp_path / "run.zarr"
    with pytest.raises(co.IntegrationError) as plain:
        co.integrate(system, x0, SPAN, 0.05, co.RadauEnergy(2))
    ready = PreparedRun(system, co.RadauEnergy(2), 0.05)
    archive_run(ready, x0, SPAN, 1, path, until=7)
    with pytest.raises(co.IntegrationError) as failure:
        co.resume(path)
    assert str(failure.value) == str(plain.value)
    assert failure.value.partial.failed.tolist() == [True, False]
    assert_same(failure.value.partial, plain.value.partial)


def test_opened_archive_is_a_solution(tmp_path):
    found = cut(tmp_path / "run.zarr", attitude=True)
    assert isinstance(found, co.Solution) and found.path == tmp_path / "run.zarr"
    assert repr(found) == f"<archive {tmp_path}/run.zarr, at step 5 of 16: 3 points>"
    copy = pickle.loads(pickle.dumps(found))
    assert np.array_equal(copy.attitude, found.attitude) and copy.reached == 5
    assert repr(co.resume(tmp_path / "run.zarr")) == f"<archive {tmp_path}/run.zarr, finished: 9 points>"
    # The opened archive is a snapshot.
    assert found.x.shape == (3, 3) and found.to_xarray().sizes["time"] == 3
    assert np.array_equal(found.at(0.3).x, co.integrate(BODY, X, SPAN, STEP, co.GaussLegendre(2)).at(0.3).x)


def test_large_array_is_refused_before_allocation(tmp_path, monkeypatch):
    found = co.integrate(BODY, X, (0, 4000), 0.125, archive=tmp_path / "run.zarr")
    monkeypatch.setattr("coadjoint.memory.UNCHECKED_BYTES", 0)
    monkeypatch.setattr("coadjoint.memory.available", lambda: 10**6)
    with pytest.raises(ValueError, match=r"x of the archive .* needs about 2 MB; .*to_xarray"):
        _ = found.x
    assert found.to_xarray()["x"][-1].shape == (3,)


@pytest.mark.parametrize(
    ("archive", "message"),
    [
        (3, "archive is 3"),
        ("a\0b", "path of a folder"),
        ("x" * 300, "its name is too long"),
        ("none/run.zarr", "the folder none does not exist; create it first"),
    ],
)
def test_invalid_archive_path_is_refused_before_the_run(tmp_path, monkeypatch, archive, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("coadjoint.runs.run.Run.advance", None)
    with pytest.raises((ValueError, TypeError), match=message):
        co.integrate(BODY, X, SPAN, STEP, archive=archive)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("rows", [2, 8])
def test_extra_last_point_after_full_chunks(tmp_path, monkeypatch, rows):
    """It follows sooner than save_every steps after a point that may have filled a chunk."""
    for name in ("MIN_CHUNK_ROWS", "MAX_CHUNK_ROWS"):
        monkeypatch.setattr(f"coadjoint.files.archives.stored_arrays.{name}", rows)
    for steps in range(4 * rows - 5, 4 * rows + 5):
        run, path = (BODY, X, (0, steps * STEP), STEP, co.GaussLegendre(2)), tmp_path / f"{steps}.zarr"
        expected, found = co.integrate(*run, save_every=4), co.integrate(*run, save_every=4, archive=path)
        assert np.array_equal(found.t, expected.t) and np.array_equal(found.x, expected.x)
        assert np.array_equal(found.energy, expected.energy)


def test_existing_archive_is_not_replaced(tmp_path):
    co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    with pytest.raises(ArchiveError, match=r"exists; co\.resume"):
        co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    assert os.listdir(tmp_path) == ["run.zarr"]


def test_damaged_attributes_are_refused_in_one_line(tmp_path):
    path = tmp_path / "run.zarr"
    cut(path)
    root = json.loads((path / "zarr.json").read_text())
    for name in ("system", "method", "t_span", "archive_states", "archive_given", "archive_observed", "step", "steps"):
        for value in (None, "{", 3):
            attributes = {**root["attributes"], name: value}
            (path / "zarr.json").write_text(json.dumps({**root, "attributes": attributes}))
            with pytest.raises((ValueError, TypeError)) as refusal:
                co.resume(path)
            assert "\n" not in str(refusal.value), name


def test_another_helper_of_a_compiled_function_is_refused(tmp_path):
    numba = pytest.importorskip("numba")

    def system(factor):
        # Both agree near the start, so that the first step has the same bits.
        helper = numba.njit(lambda y: y if y < 100.0 else factor * y)
        return co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (lambda y: 0.5 * y * helper(y), helper)}))

    path = tmp_path / "run.zarr"
    cut(path, system(1.0))
    with pytest.raises(ArchiveError, match="differs from that of the run"):
        co.resume(path, system=system(2.0))
    assert co.resume(path, system=system(1.0)).finished


def test_stored_failure_has_step_time_and_residual(tmp_path):
    """In the archive of a run, and in the marker of a block."""
    from coadjoint.files.archives.blocks import read_marker, write_marker
    from coadjoint.files.archives.folder import ArchiveFolder

    run = (BODY, (3.0, -20.0, 7.0), (7.0, 107.0), STEP, co.ExplicitRungeKutta("runge2"))
    failure = {"failed_step": 3, "failed_time": 7.25, "failed_residual": 0.5}
    for name in ("run", "many"):
        with pytest.raises(co.IntegrationError) as first:
            if name == "run":
                co.integrate(*run, archive=tmp_path / name)
            else:
                co.ensemble(run[0], [X, run[1]], *run[2:], archive=tmp_path / name, members_per_block=1)
        assert first.value.time == 7.0 + (first.value.step - 1) * STEP
        root = json.loads((tmp_path / name / "zarr.json").read_text())
        root["attributes"] |= failure
        (tmp_path / name / "zarr.json").write_text(json.dumps(root))
        if name == "many":
            with ArchiveFolder(tmp_path / name) as folder:
                marker = read_marker(folder, 1)
                write_marker(folder, 1, marker.about | failure, marker.stored)
        with pytest.raises(co.IntegrationError) as again:
            co.resume(tmp_path / name)
        assert (again.value.step, again.value.time, again.value.residual) == (3, 7.25, 0.5)
        assert again.value.partial.attributes["failed_residual"] == 0.5


def test_seconds_of_earlier_calls_are_added(tmp_path):
    path, seconds = tmp_path / "run.zarr", 1e6
    cut(path)
    root = json.loads((path / "zarr.json").read_text())
    root["attributes"]["seconds"] = seconds
    (path / "zarr.json").write_text(json.dumps(root))
    assert seconds <= co.resume(path, until=9).stats.seconds < 2 * seconds
    assert seconds <= co.resume(path).stats.seconds == co.open_archive(path).stats.seconds < 2 * seconds


def test_link_at_the_archive_path_is_not_replaced(tmp_path):
    """Also a dangling one: nothing is written in its place or behind it."""
    (tmp_path / "run.zarr").symlink_to(tmp_path / "none")
    for run in (
        lambda: co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr"),
        lambda: co.ensemble(BODY, [X], SPAN, STEP, archive=tmp_path / "run.zarr"),
    ):
        with pytest.raises(ArchiveError, match=r"run\.zarr: exists; co\.resume"):
            run()
    assert os.listdir(tmp_path) == ["run.zarr"] and os.readlink(tmp_path / "run.zarr") == str(tmp_path / "none")


def test_new_archive_removes_leftovers_of_a_killed_run(tmp_path):
    from coadjoint.files.output.atomic_output import LOCK_FILE, _prefix

    left = tmp_path / f"{_prefix(tmp_path / 'run.zarr')}01234567"
    left.mkdir()
    (left / LOCK_FILE).touch()
    co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    assert os.listdir(tmp_path) == ["run.zarr"]


@pytest.mark.parametrize("commits", [1, 3, 100])
def test_opening_during_commits(tmp_path, monkeypatch, commits):
    """The state named by the root may be removed before it is read; the root is then read again, a few times."""
    from coadjoint.files.archives import archived_solution
    from coadjoint.files.archives.reading import ArchiveMoved

    cut(tmp_path / "run.zarr")
    read, moved = archived_solution.read_state, []

    def gone(path, stored):
        moved.append(stored)
        if len(moved) <= commits:
            raise ArchiveMoved(f"{path}: the state {stored.file} is missing")
        return read(path, stored)

    monkeypatch.setattr(archived_solution, "read_state", gone)
    if commits < archived_solution.ATTEMPTS:
        assert co.open_archive(tmp_path / "run.zarr").reached == 5 and len(moved) == commits + 1
    else:
        with pytest.raises(ArchiveError, match=r"the state state-\w+\.npz is missing") as refused:
            co.open_archive(tmp_path / "run.zarr")
        assert type(refused.value) is ArchiveError and len(moved) == archived_solution.ATTEMPTS


@pytest.mark.parametrize("name", ["x", "casimir_x_2"])
def test_resuming_checks_all_committed_chunks(tmp_path, monkeypatch, name):
    """Any chunk may be missing; the last ones, to which the run appends, may be damaged as well."""
    for each in ("MIN_CHUNK_ROWS", "MAX_CHUNK_ROWS"):
        monkeypatch.setattr(f"coadjoint.files.archives.stored_arrays.{each}", 2)
    path = tmp_path / "run.zarr"
    cut(path, until=9, every=1)
    chunks = sorted((path / name).glob("c.*"))
    assert len(chunks) == 5
    for chunk in chunks[::2]:
        content = chunk.read_bytes()
        chunk.unlink()
        with pytest.raises(ArchiveError, match=rf"{name}/{chunk.name} is missing"):
            co.resume(path)
        chunk.write_bytes(content)
    cut(tmp_path / "odd.zarr", until=8, every=1)
    chunk = max((tmp_path / "odd.zarr" / name).glob("c.*"))
    content = chunk.read_bytes()
    chunk.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(ArchiveError, match=rf"{name}/{chunk.name} cannot be read \(.*checksum"):
        co.resume(tmp_path / "odd.zarr")
    chunk.write_bytes(content)
    assert co.resume(path).finished and co.resume(tmp_path / "odd.zarr").finished


def test_a_scheme_that_is_not_registered_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(registry, "_registered", {})

    @co.methods.register
    @dataclass(frozen=True)
    class Unlisted(co.methods.StepMethod):
        order, symmetric, explicit = 1, False, True

        def properties(self, system):
            return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

        def step(self, system, x, t, h):
            return x + h * system.vector_field(x, t)

    cut(tmp_path / "run.zarr", method=Unlisted())
    write_dataset(co.integrate(BODY, X, SPAN, STEP, Unlisted()).to_xarray(), tmp_path / "run.nc")
    monkeypatch.setattr(registry, "_registered", {})
    for open_again in (lambda: co.resume(tmp_path / "run.zarr"), lambda: co.load(tmp_path / "run.nc").method):
        with pytest.raises(ValueError, match="'Unlisted', which is not registered; import") as refused:
            open_again()
        assert "damaged" not in str(refused.value)


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="open descriptors are not listed")
def test_archive_descriptors_are_closed(tmp_path):
    """After a run, an interruption, a continuation, a refusal and a read."""
    co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "first.zarr").to_xarray().load()
    before = len(os.listdir("/proc/self/fd"))
    cut(tmp_path / "run.zarr")
    with pytest.raises(ArchiveError, match="but the run has"):
        co.resume(tmp_path / "run.zarr", system=co.systems.rigid_body(inertia=(1, 2, 2.75)))
    for ends in ({"until": 9}, {}, {"t_end": 3.0}, {"t_end": 3.0}):
        found = co.resume(tmp_path / "run.zarr", **ends)
    with pytest.raises(ArchiveError, match="give a later end"):
        co.resume(tmp_path / "run.zarr", 2.0)
    found.to_xarray().load()
    assert found.finished and len(os.listdir("/proc/self/fd")) == before


def test_uncomparable_functions_warn(tmp_path):
    """A function may read values that no fingerprint contains."""
    fluid = co.systems.sphere_euler(4)
    observe = {"odd": lambda W: eval("W")[0, 1].real, "even": lambda W: W[0, 1].imag}
    cut(tmp_path / "run.zarr", fluid, fluid.random(seed=1), method=co.IsospectralGauss(1), observe=observe)
    with pytest.raises(ArchiveError, match=r"the run observes \['odd', 'even'\], but observe has \['even', 'odd'\]"):
        co.resume(tmp_path / "run.zarr", observe=dict(reversed(observe.items())))
    with pytest.warns(UserWarning, match=r"observe is compared without .*, which cannot be fingerprinted"):
        found = co.resume(tmp_path / "run.zarr", observe=observe)
    np.testing.assert_array_equal(found.observed["odd"], found.x[:, 0, 1].real)


@pytest.mark.parametrize(("watch", "over"), [(True, "over every step"), (False, "over the saved points")])
def test_drift_names_state_the_sampling(tmp_path, watch, over):
    damped = BODY.with_forces(co.forces.LinearDamping(0.125))
    for k, (system, names) in enumerate(((BODY, ["drift"]), (damped, ["change", "balance"]))):
        run = system, X, SPAN, STEP, co.GaussLegendre(1)
        for found in (co.integrate(*run, watch=watch), co.integrate(*run, watch=watch, archive=tmp_path / f"{k}.zarr")):
            for name in names:
                assert found.to_xarray()[name].attrs["long_name"].endswith(f"in each tenth of the run, {over}")


def runs_to_continue():
    """Yield runs of every kind, with members that differ."""
    x0 = np.array([(0.3, -1.0, 0.7), (1.0, 0.2, -0.4), (-0.1, 0.7, 0.3)])
    product = {"q": co.Polynomial({(1, 1, 0): 2.0})}
    fluid = co.systems.sphere_euler(4)
    W = np.stack([fluid.random(seed=seed, degrees=(1, 3)) for seed in (1, 2)])
    damped = BODY.with_forces(co.forces.LinearDamping((0.1, 0.2, 0.3)), co.forces.Torque((0.0, 0.05, 0.1)))
    bodies = co.batch([co.systems.rigid_body(inertia=(1, 2, c)) for c in (2.5, 2.75, 2.25)])
    yield "members", BODY, x0, co.GaussLegendre(2), {"attitude": True, "observe": product}
    yield "forces", damped, x0, co.GaussLegendre(2), {"observe": product}
    yield "a batch", bodies, x0, co.Splitting(order=2), {"attitude": "coadjoint"}
    yield "complex matrices", fluid, W, co.IsospectralGauss(1), {}
    yield "one of them", fluid, W[1], co.IsospectralGauss(1), {"watch": False}


@pytest.mark.thinned(30)
@pytest.mark.parametrize(("direction", "rows"), [(1, None), (-1, 1)])
@pytest.mark.parametrize(
    ("system", "x0", "method", "options"), [pytest.param(*run, id=name) for name, *run in runs_to_continue()]
)
def test_run_is_extended_to_a_later_end(tmp_path, monkeypatch, system, x0, method, options, direction, rows):
    """Drifts and balances of the longer run are those of each member.

    Steps 1 to 4 lie in one tenth of 31, those of the other pieces in several; or each step is a piece.
    """
    ready, path, every = PreparedRun(system, method, STEP, **options), tmp_path / "run.zarr", rows or 3
    for name in ("MIN_CHUNK_ROWS", "MAX_CHUNK_ROWS") if rows else ():
        monkeypatch.setattr(f"coadjoint.files.archives.stored_arrays.{name}", rows)
    first, last = (0.7 + direction * STEP * steps for steps in (16, 31))
    archive_run(ready, x0, (0.7, first), every, path, until=None if rows else 4)
    for cut_at in () if rows else (11, None):
        co.resume(path, until=cut_at)
    assert_same(
        co.open_archive(path), co.integrate(system, x0, (0.7, first), STEP, method, save_every=every, **options)
    )
    assert_same(co.resume(path, last), co.integrate(system, x0, (0.7, last), STEP, method, save_every=every, **options))


def test_deviations_that_fall_again_stay_in_their_tenth_of_a_longer_run(tmp_path):
    """The axis turns over at t = 19, in the seventh tenth of 28 and the fifth of 40; steps 177 to 208 are in two."""
    run, path = (BODY, (0.02, 1.0, 0.02)), tmp_path / "run.zarr"
    expected = co.integrate(*run, (0.0, 40.0), STEP, co.Splitting(order=2))
    peak = np.abs(expected.energy - expected.energy[0])
    assert peak.argmax() == 151 and peak[192:].max() < 0.5 * peak.max()
    archive_run(PreparedRun(BODY, co.Splitting(order=2), STEP), run[1], (0.0, 28.0), 1, path, until=176)
    for cut_at in (208, None):
        co.resume(path, until=cut_at)
    assert_same(co.resume(path, 40.0), expected)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("every", [1, 2])
def test_states_as_large_as_a_chunk(tmp_path, monkeypatch, every):
    """Every saved point of many members or large matrices has chunks of its own."""
    advance, calls = PiecewiseRun.advance, []

    def bounded(self, until):
        calls.append(until)
        assert len(calls) < 200, "no step is taken"
        advance(self, until)

    monkeypatch.setattr(PiecewiseRun, "advance", bounded)
    monkeypatch.setattr("coadjoint.files.archives.stored_arrays.CHUNK_BYTES", 8)
    x0 = np.multiply.outer([1.0, 0.5, -0.25], X)
    for name, start in (("one", X), ("members", x0)):
        expected = co.integrate(BODY, start, SPAN, STEP, co.GaussLegendre(2), save_every=every)
        run = {"x0": start, "every": every}
        cut(tmp_path / name, until=0, **run)
        for until in (1, 6, None):
            found = co.resume(tmp_path / name, until=until)
        assert_same(found, expected)
    found = co.ensemble(
        BODY, x0, SPAN, STEP, co.GaussLegendre(2), save_every=every, archive=tmp_path / "many", members_per_block=1
    )
    assert_same(found, expected)


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
