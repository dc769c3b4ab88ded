"""Archives of runs: what is asked again, what is refused, and what there is of a run that has failed."""

import json
import os
import pickle

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint.files.archives.archived_solution import ArchivedSolution
from coadjoint.files.archives.resume import archive_run
from coadjoint.files.archives.store import ArchiveError
from coadjoint.files.datasets.content_checksum import CHECKSUM
from coadjoint.files.output.output_files import write_dataset
from coadjoint.files.records.fingerprints import fingerprint_of, same_fingerprint
from coadjoint.runs.piecewise_run import PiecewiseRun
from coadjoint.runs.prepared_run import PreparedRun
from verification.test_archived_runs import assert_same

BODY, X = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, -1.0, 0.7)
SPAN, STEP = (0.0, 2.0), 0.125


@pytest.fixture(autouse=True)
def without_waiting_for_the_disk(monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)


def cut(path, system=BODY, x0=X, until=5, method=None, every=2, **options):
    """Leave a run after some of its steps."""
    ready = PreparedRun(system, method or co.GaussLegendre(2), STEP, **options)
    return archive_run(ready, x0, SPAN, every, path, until=until)


@pytest.mark.filterwarnings("error")
def test_a_peer_reads_what_a_dataset_of_the_run_has(tmp_path):
    """Plain xarray: the same variables, dimensions, coordinates, attributes and bits as `to_xarray` gives."""
    x0 = np.multiply.outer([1.0, 0.9], X)
    method, options = co.GaussLegendre(2), {"attitude": "coadjoint", "observe": {"q": co.Polynomial({(1, 1, 0): 2.0})}}
    whole = co.integrate(BODY, x0, SPAN, STEP, method, save_every=3, **options).to_xarray()
    found = co.integrate(BODY, x0, SPAN, STEP, method, save_every=3, archive=tmp_path / "run.zarr", **options)
    for dataset in (xarray.open_zarr(tmp_path / "run.zarr"), found.to_xarray()):
        assert set(dataset.variables) == set(whole.variables) and dict(dataset.sizes) == dict(whole.sizes)
        for name, variable in whole.variables.items():
            assert dataset[name].dims == variable.dims and dataset[name].attrs == variable.attrs
            assert np.array_equal(dataset[name].values, variable.values), name
        assert all(
            dataset.attrs[name] == value for name, value in whole.attrs.items() if name not in ("seconds", CHECKSUM)
        )
    assert found.observed["q"].shape == (7, 2) and "platform" in dataset.attrs


def described_runs():
    """Runs whose datasets have every kind of variable."""
    gauss = co.GaussLegendre(2)
    fluid = co.systems.sphere_euler(4)
    forced = BODY.with_forces(co.forces.LinearDamping(0.1))
    yield "vectors", (BODY, X, SPAN, STEP, gauss), {"attitude": True, "observe": {"q": co.Polynomial({(2, 0, 0): 1.0})}}
    yield "matrices", (fluid, fluid.random(seed=1, degrees=(1, 3)), SPAN, STEP, co.IsospectralGauss(1)), {}
    yield "forces", (forced, X, SPAN, STEP, gauss), {}


@pytest.mark.thinned(2)
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("run", "options"), [pytest.param(*given, id=name) for name, *given in described_runs()])
@pytest.mark.parametrize("how", ["archive", "ensemble", "file"])
def test_a_peer_is_told_names_and_units_by_the_conventions(tmp_path, run, options, how):
    """CF: a unit and a long name of every number, a name of what stands along every dimension that has names."""
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


def test_a_system_with_functions_is_asked_for_again_and_another_one_refused(tmp_path):
    path, observe = tmp_path / "run.zarr", {"far": far, "q": co.Polynomial({(2, 0, 0): 1.0})}
    whole = co.integrate(wells(), X, SPAN, STEP, co.GaussLegendre(2), save_every=2, observe=observe)
    cut(path, wells(), observe=observe)
    assert co.open_archive(path).x.shape == (3, 3)
    with pytest.raises(ArchiveError, match=r"not stored \(hamiltonian: well, .*co.resume\(path, system=...\)"):
        co.resume(path)
    with pytest.raises(
        ArchiveError, match="not what the run was begun with: its numbers, or the code of its functions"
    ):
        co.resume(path, system=wells(2.0), observe=observe)
    with pytest.raises(ArchiveError, match=r"not stored \(far\); give them again: co.resume\(path, observe=...\)"):
        co.resume(path, system=wells())
    with pytest.raises(ArchiveError, match=r"not what the run was begun with: .* functions \(far\)"):
        co.resume(path, system=wells(), observe={**observe, "far": farther})
    with pytest.raises(ArchiveError, match=r"the run observes \['far', 'q'\], and observe has \['far'\]"):
        co.resume(path, system=wells(), observe={"far": far})
    found = co.resume(path, system=wells(), observe=observe)
    assert found.finished
    assert_same(found, whole)
    assert co.open_archive(path, wells()).system.hamiltonian is not None


def test_functions_that_differ_in_a_number_of_their_code_are_told_apart():
    twice, thrice = (lambda x: 2.0 * x), (lambda x: 3.0 * x)
    assert twice.__code__.co_code == thrice.__code__.co_code
    assert not same_fingerprint(fingerprint_of(twice), fingerprint_of(thrice))
    assert same_fingerprint(fingerprint_of(twice), fingerprint_of(lambda x: 2.0 * x))


def test_what_is_stored_of_what_is_observed_need_not_be_given(tmp_path):
    observe = {"b": co.Polynomial({(2, 0, 0): 1.0}), "a": co.Quadratic([1.0, 2.0, 3.0], linear=[0.5, 0.0, 0.0])}
    whole = co.integrate(BODY, X, SPAN, STEP, co.GaussLegendre(2), save_every=2, observe=observe)
    cut(tmp_path / "run.zarr", observe=observe)
    assert_same(co.resume(tmp_path / "run.zarr"), whole)


@pytest.mark.thinned(2)
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
def test_another_quantity_of_the_same_name_is_refused(tmp_path, other, several):
    """Its series would begin with one quantity and end with another."""
    observe = {"b": co.Polynomial({(2, 0, 0): 1.0}), "a": co.Quadratic([1.0, 2.0, 3.0], linear=[0.5, 0.0, 0.0])}
    if several:
        co.ensemble(BODY, [X, X], SPAN, STEP, co.GaussLegendre(2), archive=tmp_path / "run.zarr", observe=observe)
    else:
        cut(tmp_path / "run.zarr", observe=observe)
    (name,) = other
    with pytest.raises(ArchiveError, match=rf"observe\['{name}'\] is .*, which is not the quantity that the run"):
        co.resume(tmp_path / "run.zarr", observe={**observe, **other})
    same = {name: 1 * given for name, given in observe.items()}
    assert co.resume(tmp_path / "run.zarr", observe=same).finished


def test_a_quantity_beside_a_function_is_compared(tmp_path):
    observe = {"far": far, "q": co.Polynomial({(2, 0, 0): 1.0})}
    cut(tmp_path / "run.zarr", observe=observe)
    with pytest.raises(ArchiveError, match=r"observe is .*, which is not what the run was begun with"):
        co.resume(tmp_path / "run.zarr", observe={**observe, "q": co.Polynomial({(0, 2, 0): 1.0})})


@pytest.mark.parametrize("events", [co.Event("x1"), [co.Event(co.Polynomial({(2, 0, 0): 1.0}))]])
def test_events_are_refused_because_an_archive_has_none(tmp_path, events):
    cut(tmp_path / "run.zarr")
    with pytest.raises(ArchiveError, match="the run has no events; omit events"):
        co.resume(tmp_path / "run.zarr", events=events)
    assert co.resume(tmp_path / "run.zarr", events=[]).finished


SQUARE, TWICE = (
    co.Polynomial({(2, 0, 0): 1, (0, 2, 0): 1, (0, 0, 2): 1}),
    co.Polynomial({(2, 0, 0): 2, (0, 2, 0): 2, (0, 0, 2): 2}),
)


def with_casimir(casimir):
    return co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]), sign=-1, casimirs={"C": casimir})


def turning(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def without_algebra(casimir, weight=0.5):
    energy = co.Quadratic([1.0, weight, 0.25])
    return co.PoissonSystem(turning, energy, dim=3, casimirs={"C": casimir})


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    ("begun", "other"),
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
def test_a_system_with_another_invariant_or_force_of_the_same_name_is_refused(tmp_path, begun, other):
    cut(tmp_path / "run.zarr", begun())
    with pytest.raises(
        ArchiveError, match=r"system is .*, (and the run is one of|which is not what the run was begun)"
    ):
        co.resume(tmp_path / "run.zarr", system=other())


def test_another_system_is_refused_also_without_functions(tmp_path):
    cut(tmp_path / "run.zarr")
    with pytest.raises(ArchiveError, match=r"system is .*, and the run is one of <rigid_body"):
        co.resume(tmp_path / "run.zarr", system=co.systems.rigid_body(inertia=(1, 2, 2.75)))
    assert co.resume(tmp_path / "run.zarr", system=BODY).finished


def test_a_first_step_with_other_bits_is_noticed(tmp_path, monkeypatch):
    """As on a machine, or by a library, that rounds in another way; or by a function that reads something else."""
    cut(tmp_path / "run.zarr")
    monkeypatch.setattr("coadjoint.files.archives.resume.first_step", lambda *_: "other")
    with pytest.raises(
        ArchiveError, match="the first step, recomputed, has other bits than when the archive was begun"
    ):
        co.resume(tmp_path / "run.zarr")


def test_a_finished_run_is_resumed_at_once(tmp_path, monkeypatch):
    found = co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    monkeypatch.setattr("coadjoint.files.archives.resume.ArchiveStore", None)
    again = co.resume(tmp_path / "run.zarr")
    assert again.finished and np.array_equal(again.x, found.x)


def test_a_run_that_fails_says_so_whenever_it_is_asked(tmp_path):
    # Far too long a step, so that the numbers grow until they overflow.
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


def test_members_that_fail_leave_the_others(tmp_path):
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


def test_it_is_opened_like_any_solution(tmp_path):
    found = cut(tmp_path / "run.zarr", attitude=True)
    assert isinstance(found, co.Solution) and isinstance(found, ArchivedSolution)
    assert repr(found) == f"<archive {tmp_path}/run.zarr, at step 5 of 16: 3 points>"
    copy = pickle.loads(pickle.dumps(found))
    assert np.array_equal(copy.attitude, found.attitude) and copy.reached == 5
    assert repr(co.resume(tmp_path / "run.zarr")) == f"<archive {tmp_path}/run.zarr, finished: 9 points>"
    # As it was when it was opened.
    assert found.x.shape == (3, 3) and found.to_xarray().sizes["time"] == 3
    assert np.array_equal(found.at(0.3).x, co.integrate(BODY, X, SPAN, STEP, co.GaussLegendre(2)).at(0.3).x)


def test_a_large_array_is_refused_before_memory_is_taken(tmp_path, monkeypatch):
    found = co.integrate(BODY, X, (0, 4000), 0.125, archive=tmp_path / "run.zarr")
    monkeypatch.setattr("coadjoint.memory.UNCHECKED_BYTES", 0)
    monkeypatch.setattr("coadjoint.memory.available", lambda: 10**6)
    with pytest.raises(
        ValueError, match=r"x of the archive .* needs about 2 MB; .* read a part of to_xarray\(\)\['x'\]"
    ):
        _ = found.x
    assert found.to_xarray()["x"][-1].shape == (3,)


@pytest.mark.parametrize(
    ("archive", "message"),
    [
        (3, "archive is 3; it must be the path of a folder"),
        ("a\0b", "it must be the path of a folder"),
        ("x" * 300, "its name is too long"),
        ("none/run.zarr", "the folder none does not exist; make it first"),
    ],
)
def test_an_archive_that_cannot_be_made_is_refused_before_the_run(tmp_path, monkeypatch, archive, message):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("coadjoint.runs.run.Run.advance", None)
    with pytest.raises((ValueError, TypeError), match=message):
        co.integrate(BODY, X, SPAN, STEP, archive=archive)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("rows", [2, 8])
def test_a_last_point_of_its_own_behind_whole_chunks(tmp_path, monkeypatch, rows):
    """It comes sooner than save_every steps after the one before, and that one may have filled the memory."""
    for name in ("MIN_CHUNK_ROWS", "MAX_CHUNK_ROWS"):
        monkeypatch.setattr(f"coadjoint.files.archives.stored_arrays.{name}", rows)
    for steps in range(4 * rows - 5, 4 * rows + 5):
        run, path = (BODY, X, (0, steps * STEP), STEP, co.GaussLegendre(2)), tmp_path / f"{steps}.zarr"
        whole, found = co.integrate(*run, save_every=4), co.integrate(*run, save_every=4, archive=path)
        assert np.array_equal(found.t, whole.t) and np.array_equal(found.x, whole.x)
        assert np.array_equal(found.energy, whole.energy)


def test_an_archive_is_never_replaced(tmp_path):
    co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    with pytest.raises(
        ArchiveError, match=r"exists; co\.resume continues an archive, and a new one needs another name"
    ):
        co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    assert os.listdir(tmp_path) == ["run.zarr"]


def test_damaged_attributes_are_one_sentence(tmp_path):
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


def test_another_helper_under_a_compiled_function_is_refused(tmp_path):
    numba = pytest.importorskip("numba")

    def system(factor):
        # Both agree near the start, so that the first step has the same bits.
        helper = numba.njit(lambda y: y if y < 100.0 else factor * y)
        return co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (lambda y: 0.5 * y * helper(y), helper)}))

    path = tmp_path / "run.zarr"
    cut(path, system(1.0))
    with pytest.raises(ArchiveError, match="not what the run was begun with"):
        co.resume(path, system=system(2.0))
    assert co.resume(path, system=system(1.0)).finished


def test_a_failure_is_told_with_its_numbers(tmp_path):
    """Step, time and residual, by the archive of one run and by the marker of a block."""
    from coadjoint.files.archives.blocks import read_marker, write_marker
    from coadjoint.files.archives.folder import ArchiveFolder

    run = (BODY, (3.0, -20.0, 7.0), (7.0, 107.0), STEP, co.ExplicitRungeKutta("runge2"))
    said = {"failed_step": 3, "failed_time": 7.25, "failed_residual": 0.5}
    for name in ("run", "many"):
        with pytest.raises(co.IntegrationError) as first:
            if name == "run":
                co.integrate(*run, archive=tmp_path / name)
            else:
                co.ensemble(run[0], [X, run[1]], *run[2:], archive=tmp_path / name, members_per_block=1)
        assert first.value.time == 7.0 + (first.value.step - 1) * STEP
        root = json.loads((tmp_path / name / "zarr.json").read_text())
        root["attributes"] |= said
        (tmp_path / name / "zarr.json").write_text(json.dumps(root))
        if name == "many":
            with ArchiveFolder(tmp_path / name) as folder:
                marker = read_marker(folder, 1)
                write_marker(folder, 1, marker.about | said, marker.stored)
        with pytest.raises(co.IntegrationError) as again:
            co.resume(tmp_path / name)
        assert (again.value.step, again.value.time, again.value.residual) == (3, 7.25, 0.5)
        assert again.value.partial.attributes["failed_residual"] == 0.5


def test_seconds_of_earlier_pieces_count(tmp_path):
    path, seconds = tmp_path / "run.zarr", 1e6
    cut(path)
    root = json.loads((path / "zarr.json").read_text())
    root["attributes"]["seconds"] = seconds
    (path / "zarr.json").write_text(json.dumps(root))
    assert seconds <= co.resume(path, until=9).stats.seconds < 2 * seconds
    assert seconds <= co.resume(path).stats.seconds == co.open_archive(path).stats.seconds < 2 * seconds


def test_a_link_at_the_place_of_an_archive_stays(tmp_path):
    """Also one that leads nowhere: nothing is written in its place or behind it."""
    (tmp_path / "run.zarr").symlink_to(tmp_path / "none")
    for run in (
        lambda: co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr"),
        lambda: co.ensemble(BODY, [X], SPAN, STEP, archive=tmp_path / "run.zarr"),
    ):
        with pytest.raises(ArchiveError, match=r"run\.zarr: exists; co\.resume continues an archive"):
            run()
    assert os.listdir(tmp_path) == ["run.zarr"] and os.readlink(tmp_path / "run.zarr") == str(tmp_path / "none")


def test_a_new_archive_removes_what_a_killed_run_has_left(tmp_path):
    from coadjoint.files.output.atomic_output import LOCK_FILE, _prefix

    left = tmp_path / f"{_prefix(tmp_path / 'run.zarr')}01234567"
    left.mkdir()
    (left / LOCK_FILE).touch()
    co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    assert os.listdir(tmp_path) == ["run.zarr"]


@pytest.mark.parametrize("commits", [1, 3, 100])
def test_a_run_that_commits_while_it_is_opened(tmp_path, monkeypatch, commits):
    """The state that the root named may be removed before it is read: the root is read again, but not forever."""
    from coadjoint.files.archives import archived_solution
    from coadjoint.files.archives.store import ArchiveMoved

    cut(tmp_path / "run.zarr")
    read, moved = archived_solution.read_state, []

    def gone(path, kept):
        moved.append(kept)
        if len(moved) <= commits:
            raise ArchiveMoved(f"{path}: the state {kept.file} is missing")
        return read(path, kept)

    monkeypatch.setattr(archived_solution, "read_state", gone)
    if commits < archived_solution.ATTEMPTS:
        assert co.open_archive(tmp_path / "run.zarr").reached == 5 and len(moved) == commits + 1
    else:
        with pytest.raises(ArchiveError, match=r"the state state-\w+\.npz is missing") as refused:
            co.open_archive(tmp_path / "run.zarr")
        assert type(refused.value) is ArchiveError and len(moved) == archived_solution.ATTEMPTS


@pytest.mark.parametrize("name", ["x", "casimir_x_2"])
def test_committed_chunks_are_all_looked_for_before_a_run_goes_on(tmp_path, monkeypatch, name):
    """Any of them may be missing; the last ones, to which the run adds, may be damaged as well."""
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
    with pytest.raises(ArchiveError, match=rf"{name}/{chunk.name} cannot be read \(.*check sum"):
        co.resume(tmp_path / "odd.zarr")
    chunk.write_bytes(content)
    assert co.resume(path).finished and co.resume(tmp_path / "odd.zarr").finished


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="open descriptors are not listed")
def test_nothing_stays_open(tmp_path):
    """After a run, one that is cut, continued to its end and to a later one, refused, or read."""
    co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "first.zarr").to_xarray().load()
    before = len(os.listdir("/proc/self/fd"))
    cut(tmp_path / "run.zarr")
    with pytest.raises(ArchiveError, match="the run is one of"):
        co.resume(tmp_path / "run.zarr", system=co.systems.rigid_body(inertia=(1, 2, 2.75)))
    for ends in ({"until": 9}, {}, {"t_end": 3.0}, {"t_end": 3.0}):
        found = co.resume(tmp_path / "run.zarr", **ends)
    with pytest.raises(ArchiveError, match="give a later end"):
        co.resume(tmp_path / "run.zarr", 2.0)
    found.to_xarray().load()
    assert found.finished and len(os.listdir("/proc/self/fd")) == before


def test_what_cannot_be_compared_is_named(tmp_path):
    """A function may read what no fingerprint has; the run goes on with a warning."""
    fluid = co.systems.sphere_euler(4)
    observe = {"odd": lambda W: eval("W")[0, 1].real, "even": lambda W: W[0, 1].imag}
    cut(tmp_path / "run.zarr", fluid, fluid.random(seed=1), method=co.IsospectralGauss(1), observe=observe)
    with pytest.raises(ArchiveError, match=r"the run observes \['odd', 'even'\], and observe has \['even', 'odd'\]"):
        co.resume(tmp_path / "run.zarr", observe=dict(reversed(observe.items())))
    with pytest.warns(UserWarning, match=r"observe is compared without .*, which cannot be fingerprinted"):
        found = co.resume(tmp_path / "run.zarr", observe=observe)
    np.testing.assert_array_equal(found.observed["odd"], found.x[:, 0, 1].real)


@pytest.mark.parametrize(("watch", "over"), [(True, "over every step"), (False, "over the saved points")])
def test_deviations_are_named_for_where_they_were_looked_for(tmp_path, watch, over):
    damped = BODY.with_forces(co.forces.LinearDamping(0.125))
    for k, (system, names) in enumerate(((BODY, ["drift"]), (damped, ["change", "balance"]))):
        run = system, X, SPAN, STEP, co.GaussLegendre(1)
        for found in (co.integrate(*run, watch=watch), co.integrate(*run, watch=watch, archive=tmp_path / f"{k}.zarr")):
            for name in names:
                assert found.to_xarray()[name].attrs["long_name"].endswith(f"in each tenth of the run, {over}")


def runs_to_continue():
    """Runs of every kind, each with members of which the first is not special."""
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


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("direction", "rows"), [(1, None), (-1, 1)])
@pytest.mark.parametrize(
    ("system", "x0", "method", "options"), [pytest.param(*run, id=name) for name, *run in runs_to_continue()]
)
def test_a_later_end_of_every_kind_of_run(tmp_path, monkeypatch, system, x0, method, options, direction, rows):
    """The drifts in each tenth of the longer run are those of each member, and of forces their balances.

    Steps 1 to 4 lie in one tenth of 31, and those of the other pieces in several; or each step is a piece.
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


@pytest.mark.parametrize("every", [1, 2])
def test_states_that_fill_a_chunk(tmp_path, monkeypatch, every):
    """Of many members or large matrices every saved point has chunks of its own; the first one is the start."""
    advance, calls = PiecewiseRun.advance, []

    def bounded(self, until):
        calls.append(until)
        assert len(calls) < 200, "no step is taken"
        advance(self, until)

    monkeypatch.setattr(PiecewiseRun, "advance", bounded)
    monkeypatch.setattr("coadjoint.files.archives.stored_arrays.CHUNK_BYTES", 8)
    x0 = np.multiply.outer([1.0, 0.5, -0.25], X)
    for name, start in (("one", X), ("members", x0)):
        whole = co.integrate(BODY, start, SPAN, STEP, co.GaussLegendre(2), save_every=every)
        run = {"x0": start, "every": every}
        cut(tmp_path / name, until=0, **run)
        for until in (1, 6, None):
            found = co.resume(tmp_path / name, until=until)
        assert_same(found, whole)
    found = co.ensemble(
        BODY, x0, SPAN, STEP, co.GaussLegendre(2), save_every=every, archive=tmp_path / "many", members_per_block=1
    )
    assert_same(found, whole)
