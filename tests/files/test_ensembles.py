"""Ensembles in blocks: the bits of `integrate`, interruption and resumption, and refusals."""

import gc
import json
import os
import warnings
from dataclasses import replace

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint.files.archives import run_in_blocks as ensembles
from coadjoint.files.archives.block_run import BlockRun
from coadjoint.files.archives.blocks import (
    blocks_of,
    lock_file,
    marker_file,
    read_head,
    read_marker,
    size_of_blocks,
    write_marker,
)
from coadjoint.files.archives.ensemble_archive import unfinished_blocks
from coadjoint.files.archives.folder import ArchiveFolder
from coadjoint.files.archives.metadata_checks import CROSSING_PREFIX, RESERVED_NAMES, SERIES_PREFIXES
from coadjoint.files.archives.reading import ArchiveError, read_root
from coadjoint.files.archives.run_in_blocks import WorkerPool
from coadjoint.files.archives.store import ArchiveStore, ArchiveUnwritten
from coadjoint.files.output.atomic_output import open_locked
from coadjoint.files.output.output_files import write_dataset
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.times import times_of

pytestmark = pytest.mark.thinned(3)

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X = np.random.default_rng(3).standard_normal((11, 3))
BATCH = co.batch([co.systems.rigid_body(inertia=(1, 2, 2 + 0.0625 * k)) for k in range(11)])
NOISE = BODY.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4))
NOISY = co.batch([body.with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=4)) for body in BATCH])
FLUID = co.systems.sphere_euler(N=4)
W = np.stack([FLUID.random(seed) for seed in range(11)])
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
TURNED = np.stack([np.linalg.matrix_power(QUARTER, k) for k in range(11)])
SPIRAL = co.LiePoissonSystem(co.algebras.get("A3,7", a=2.0), co.Quadratic([1.0, 2.0, 0.5]))
# [e1, e2] = e2 with H = x1 gives x2' = x2: it overflows where it begins large.
GROWING = co.LiePoissonSystem(
    co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}}), co.Quadratic(0.0, linear=[1.0, 0.0]), sign=-1
)

CASES = {
    "splitting": (BODY, X, co.Splitting(order=4), {"attitude": True}),
    "one element for each": (BODY, X, co.Splitting(), {"attitude": TURNED}),
    "coadjoint": (SPIRAL, abs(X) + 0.1, co.GaussLegendre(2), {"attitude": "coadjoint"}),
    "series": (BODY, X, co.Taylor(order=8), {"watch": False}),
    "batch": (BATCH, X, co.Splitting(), {"attitude": True, "save_every": 3}),
    "batch of one state": (BATCH, X[0], None, {}),
    "noise": (NOISE, X, None, {"observe": {"first": co.Polynomial({(1, 0, 0): 1})}}),
    "batch with noise": (NOISY, X, None, {}),
    "matrices": (FLUID, W, None, {"save_every": 4}),
}


def assert_same(found, expected):
    """Compare two solutions bit for bit."""
    actual = found.to_xarray().load()
    for name, values in expected.to_xarray().variables.items():
        np.testing.assert_array_equal(actual[name].values, values.values, err_msg=name)
    for name, drift in expected.change().items():
        np.testing.assert_array_equal(found.change()[name].tenths, drift.tenths)
        np.testing.assert_array_equal(found.initial[name], expected.initial[name])
    assert (found.stats.steps, found.stats.evaluations) == (expected.stats.steps, expected.stats.evaluations)


@pytest.mark.thinned(9)
@pytest.mark.parametrize("size", [1, 4, None])
@pytest.mark.parametrize("name", CASES)
def test_ensembles_have_the_bits_of_one_run(tmp_path, name, size):
    system, x0, method, options = CASES[name]
    archive = tmp_path / "many.zarr"
    found = co.ensemble(system, x0, (0, 2), 0.125, method, archive=archive, members_per_block=size, **options)
    assert found.finished and (found.status == 1).all()
    assert_same(found, co.integrate(system, x0, (0, 2), 0.125, method, **options))
    assert_same(co.open_archive(archive), found)
    with xarray.open_zarr(archive, chunks=None) as plain:
        np.testing.assert_array_equal(plain["energy"], found.energy)


def test_blocks_have_the_systems_of_their_members():
    """Systems recur in another order in each block, whose tables are built for its own noise."""
    owners = (0, 1, 2, 3, 1, 3, 0, 2, 3, 2, 0)
    bodies, noise = [BATCH[k] for k in (0, 4, 8, 2)], co.forces.HeatBath(0.3, temperature=0.5, seed=4)
    distinct = [body.with_forces(noise) for body in bodies]
    found = co.ensemble(co.batch([distinct[k] for k in owners]), X, (0, 2), 0.125, members_per_block=4)
    for m, k in enumerate(owners):
        alone = bodies[k].with_forces(replace(noise, stream=m))
        np.testing.assert_array_equal(found.x[:, m], co.integrate(alone, X[m], (0, 2), 0.125).x)


def test_backward_and_empty_spans():
    for span in ((2.0, -1.0), (1.0, 1.0)):
        found = co.ensemble(BODY, X, span, 0.25, members_per_block=4)
        assert_same(found, co.integrate(BODY, X, span, 0.25))


def prepared(archive):
    """Return the store of an archive, without a lock, and its blocks."""
    store = ArchiveStore(archive, *read_root(archive), None)
    return store, blocks_of(11, store.attributes["archive_block"])


def cut(archive, monkeypatch, steps, size=4, **options):
    """Begin an ensemble whose process is lost after some steps of each block."""
    with monkeypatch.context() as lost:
        lost.setattr(ensembles, "_run_serially", lambda *args: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            co.ensemble(BODY, X, (0, 4), 0.125, archive=archive, members_per_block=size, **options)
    store, blocks = prepared(archive)
    ready, times = PreparedRun(BODY, None, 0.125, **options), times_of((0, 4), 0.125, 1)
    for block, until in zip(blocks, steps, strict=False):
        BlockRun(store, ready.among(block.first, block.last), times, block).advance(until)
    return store, blocks


@pytest.mark.thinned(4)
@pytest.mark.parametrize("steps", [(), (0,), (1, 7), (32, 5, 32), (32, 32, 31)])
def test_second_call_computes_the_missing_blocks(tmp_path, monkeypatch, steps):
    archive = tmp_path / "many.zarr"
    cut(archive, monkeypatch, steps)
    done = [k for k, until in enumerate(steps) if until == 32]
    ran, run_block = [], ensembles.run_block
    monkeypatch.setattr(ensembles, "run_block", lambda *args: ran.append(args[1].number) or run_block(*args))
    found = co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    assert ran == [k for k in range(3) if k not in done]
    assert_same(found, co.integrate(BODY, X, (0, 4), 0.125))
    co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    assert len(ran) == 3 - len(done)


def test_archive_is_resumed_without_arguments(tmp_path, monkeypatch):
    archive = tmp_path / "many.zarr"
    cut(archive, monkeypatch, (1, 7), attitude=True, observe={"first": co.Polynomial({(1, 0, 0): 1})})
    found = co.resume(archive)
    expected = co.integrate(BODY, X, (0, 4), 0.125, attitude=True, observe={"first": co.Polynomial({(1, 0, 0): 1})})
    assert_same(found, expected)
    with pytest.raises(ValueError, match="archive of one run; client and workers"):
        co.integrate(BODY, X, (0, 1), 0.125, archive=tmp_path / "one.zarr")
        co.resume(tmp_path / "one.zarr", workers=2)
    with pytest.raises(ValueError, match="no t_end, events or until"):
        co.resume(archive, t_end=8.0)


def test_block_resumes_from_its_marker(tmp_path, monkeypatch):
    archive = tmp_path / "many.zarr"
    store, blocks = cut(archive, monkeypatch, (1, 7))
    ready, times = PreparedRun(BODY, None, 0.125), times_of((0, 4), 0.125, 1)
    runs = [BlockRun(store, ready.among(block.first, block.last), times, block) for block in blocks]
    assert [own.run.number for own in runs] == [1, 7, 0]
    assert [own.about["archive_finished"] for own in runs] == [0, 0, 0]


def test_chunks_without_a_marker_are_overwritten(tmp_path, monkeypatch):
    """A worker was killed between writing its chunks and its marker."""
    archive = tmp_path / "many.zarr"
    _, blocks = cut(archive, monkeypatch, (8,))
    held = (archive / ".coadjoint" / marker_file(0)).read_bytes()
    store, _ = prepared(archive)
    BlockRun(store, PreparedRun(BODY, None, 0.125).among(0, 4), times_of((0, 4), 0.125, 1), blocks[0]).advance(20)
    (archive / ".coadjoint" / marker_file(0)).write_bytes(held)
    assert_same(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive), co.integrate(BODY, X, (0, 4), 0.125))


@pytest.mark.parametrize("what", ["marker", "numbers", "chunk", "folder"])
def test_damaged_blocks_are_computed_again(tmp_path, what):
    archive = tmp_path / "many.zarr"
    co.ensemble(BODY, X, (0, 4), 0.125, archive=archive, members_per_block=4)
    marker = archive / ".coadjoint" / marker_file(1)
    if what == "marker":
        marker.write_bytes(marker.read_bytes().replace(b'"failed": 0', b'"failed": 4'))
    elif what == "numbers":
        marker.write_bytes(marker.read_bytes()[:-1] + b"x")
    elif what == "chunk":
        (archive / "energy" / "c.0.1").unlink()
    else:
        for file in (archive / "x").glob("c.*"):
            file.unlink()
    if what == "numbers":
        # Its first line is intact and marks the block as finished; its numbers are not needed.
        with ArchiveFolder(archive) as folder:
            assert read_marker(folder, 1) is None and read_head(folder, 1) is not None
    else:
        store, _ = prepared(archive)
        assert [block.number for block in unfinished_blocks(store)] == {"folder": [0, 1, 2]}.get(what, [1])
    assert_same(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive), co.integrate(BODY, X, (0, 4), 0.125))


@pytest.mark.thinned(9)
@pytest.mark.parametrize("failing", [{2, 3}, {1}, {0, 4}, {1, 2, 4}, {0, 1, 2, 3, 4}], ids=str)
@pytest.mark.parametrize("members_per_block", [1, 2, 3, 5])
def test_failed_members_leave_the_others(tmp_path, failing, members_per_block):
    x0 = np.array([[1.0, 1e290 * (1 + m) if m in failing else 1.0 + m] for m in range(5)])
    archive = tmp_path / "many.zarr"

    def run():
        co.ensemble(GROWING, x0, (0, 100), 0.5, archive=archive, members_per_block=members_per_block)

    first = min(failing)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        with pytest.raises(co.IntegrationError) as expected:
            co.integrate(GROWING, x0, (0, 100), 0.5)
        count = rf"^{len(failing)} of 5 members failed, the first of them is member {first}: "
        with pytest.raises(co.IntegrationError, match=count):
            run()
        with pytest.raises(co.IntegrationError, match=count) as again:
            run()
    found, reference = again.value.partial, expected.value.partial
    for name in ("step", "time", "residual"):
        np.testing.assert_equal(getattr(again.value, name), getattr(expected.value, name))
    assert found.stats.steps == reference.stats.steps
    assert "member 0" not in str(again.value) or first == 0
    np.testing.assert_array_equal(found.failed, [m in failing for m in range(5)])
    np.testing.assert_array_equal(found.status, [1 + (m in failing) for m in range(5)])
    np.testing.assert_array_equal(found.x, reference.x)
    assert found.finished


@pytest.mark.thinned(7)
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x0": X + 1e-15}, "x0 differs"),
        ({"x0": X[:10]}, "x0 differs"),
        ({"system": co.systems.rigid_body(inertia=(1, 2, 2.5))}, "the system differs"),
        ({"t_span": (0, 8)}, "t_span differs"),
        ({"step": 0.25}, "the step differs"),
        ({"method": co.Splitting(order=4)}, "the scheme differs"),
        ({"save_every": 2}, "save_every differs"),
        ({"watch": False}, "watch differs"),
        ({"attitude": True}, "the initial attitude differs"),
        ({"observe": {"first": co.Polynomial({(1, 0, 0): 1})}}, "observe differs"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_another_ensemble_is_refused(tmp_path, change, message):
    archive = tmp_path / "many.zarr"
    arguments = {"system": BODY, "x0": X, "t_span": (0, 4), "step": 0.125}
    co.ensemble(**arguments, archive=archive)
    before = sorted(path.name for path in archive.rglob("*"))
    with pytest.raises(ArchiveError, match=f"another ensemble: {message}"):
        co.ensemble(**{**arguments, **change}, archive=archive)
    assert sorted(path.name for path in archive.rglob("*")) == before


def test_unstored_functions_are_compared_by_fingerprint(tmp_path):
    def system(factor):
        H = co.Separable({0: (lambda y: factor * np.cos(y), lambda y: -factor * np.sin(y))})
        return co.LiePoissonSystem(co.algebras.so(3), H, name="mine")

    archive = tmp_path / "many.zarr"
    first = co.ensemble(system(1.0), X, (0, 4), 0.125, archive=archive)
    assert_same(co.ensemble(system(1.0), X, (0, 4), 0.125, archive=archive), first)
    with pytest.raises(ArchiveError, match="functions of system differ"):
        co.ensemble(system(1.5), X, (0, 4), 0.125, archive=archive)


def test_concurrent_calls_are_refused(tmp_path, monkeypatch):
    archive = tmp_path / "many.zarr"
    cut(archive, monkeypatch, (8,))
    store = ArchiveStore.open_existing(archive)
    with pytest.raises(ArchiveError, match="another process is writing to this archive"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    store.close()
    lock = open_locked(archive / ".coadjoint" / lock_file(1), os.O_CREAT)
    with pytest.raises(ArchiveUnwritten, match="another process is still running"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    os.close(lock)
    assert_same(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive), co.integrate(BODY, X, (0, 4), 0.125))


def test_archives_of_runs_and_other_versions_are_refused(tmp_path, monkeypatch):
    one = tmp_path / "one.zarr"
    co.integrate(BODY, X, (0, 4), 0.125, archive=one)
    with pytest.raises(ArchiveError, match="archive of one run"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=one)
    monkeypatch.setattr("coadjoint.files.archives.block_run.__version__", "0.0.1")
    with pytest.raises(ArchiveError, match=r"coadjoint .*worker on .* has 0.0.1"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=tmp_path / "many.zarr")


@pytest.mark.long
def test_temporary_archive_is_removed_with_its_solution(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    found = co.ensemble(BODY, X, (0, 1), 0.125)
    assert found.path.is_dir() and found.x.shape == (9, 11, 3)
    del found
    gc.collect()
    with pytest.raises(co.IntegrationError) as failed, warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        co.ensemble(GROWING, [[1.0, 1e300]], (0, 100), 0.5)
    assert failed.value.partial.failed.all()
    del failed
    with pytest.raises(ValueError, match=r"step 0.3 does not divide"):
        co.ensemble(BODY, X, (0, 1), 0.3)
    monkeypatch.setattr(ensembles, "run_block", lambda *args: {"busy": True})
    with pytest.raises(ArchiveUnwritten):
        co.ensemble(BODY, X, (0, 1), 0.125)
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_coordinates_along_the_members(tmp_path):
    archive = tmp_path / "many.zarr"
    inertia = np.array([body.parameters["inertia"][2] for body in BATCH])
    co.ensemble(BATCH, X, (0, 1), 0.125, archive=archive, coordinates={"inertia_2": inertia}, members_per_block=4)
    with xarray.open_zarr(archive) as plain:
        assert "inertia_2" in plain.coords
        np.testing.assert_array_equal(plain["inertia_2"], inertia)
        assert plain["energy"].swap_dims(member="inertia_2").sel(inertia_2=2.25).shape == (9,)


def test_block_sizes():
    sizes = {(1, 3, 1): 1, (7, 3, 4): 1, (10**6, 3, 2): 125024, (10**6, 9, 100): 2528}
    assert {arguments: size_of_blocks(*arguments) for arguments in sizes} == sizes
    assert size_of_blocks(10**6, 100, 1) == 2**22 // 800
    blocks = blocks_of(11, 4)
    assert [member for block in blocks for member in range(block.first, block.last)] == list(range(11))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"x0": X[0]}, ValueError, r"x0 has the shape \(3,\); an ensemble needs \(members, ...\)"),
        ({"members_per_block": 0}, ValueError, "members_per_block must be"),
        ({"workers": 0, "archive": None}, ValueError, "workers must be"),
        ({"client": 3}, TypeError, "client is 3"),
        ({"client": 3, "workers": 2}, TypeError, "client and workers"),
        ({"archive": 3}, TypeError, "archive is 3"),
        ({"archive": "no/such/folder/many.zarr"}, ArchiveError, "the folder .* does not exist"),
        ({"coordinates": {"a b": X[:, 0]}}, ValueError, "the name 'a b'"),
        ({"coordinates": {"energy": X[:, 0]}}, ValueError, "'energy', which is reserved"),
        ({"coordinates": [1.0]}, TypeError, "coordinates is .*mapping"),
        ({"coordinates": {"a": X}}, ValueError, "coordinates has .* for 'a'"),
        ({"progress": 2}, TypeError, "progress is 2"),
        ({"step": -1}, ValueError, "step is -1"),
    ],
)
def test_invalid_arguments_are_refused(change, error, message):
    arguments = {"system": BODY, "x0": X, "t_span": (0, 1), "step": 0.125}
    with pytest.raises(error, match=message):
        co.ensemble(**{**arguments, **change})


def test_reserved_coordinate_names_are_refused(tmp_path):
    """Variables and dimensions of any run are reserved, also if this run has none of them."""
    fluid = co.systems.sphere_euler(3)
    damped = BODY.with_forces(co.forces.LinearDamping(0.1))
    options = {"attitude": True, "observe": {"q": co.Polynomial({(1, 1, 0): 1.0})}, "events": [co.Event("x2")]}
    runs = [
        co.integrate(damped, X[:2], (0, 1), 0.125, co.GaussLegendre(2), **options),
        co.integrate(fluid, [fluid.random(seed=1)], (0, 1), 0.125),
        co.ensemble(BODY, X[:2], (0, 1), 0.125),
    ]
    datasets = [sol.to_xarray() for sol in runs]
    names = {str(name) for data in datasets for name in (*data.variables, *data.dims)} - {"member"}
    assert {"drift", "change", "work", "attitude0", "observed_q", "event_x", "part", "crossing", "status"} < names
    prefixes = (*SERIES_PREFIXES, CROSSING_PREFIX)
    assert {name for name in names if not name.startswith(prefixes)} <= RESERVED_NAMES
    for name in ("attitude", "layer", "casimir_", "observed_rate", "event_rate"):
        with pytest.raises(ValueError, match=f"'{name}', which is reserved"):
            co.ensemble(
                BODY, X, (0, 1), 0.125, archive=tmp_path / "many.zarr", coordinates={"a": X[:, 0], name: X[:, 1]}
            )
    assert not list(tmp_path.iterdir())
    others = {name: X[:, k % 3] for k, name in enumerate(("rate", "casimirs", "event", "observed", "member", "rows"))}
    found = co.ensemble(BODY, X, (0, 1), 0.125, archive=tmp_path / "many.zarr", coordinates=others)
    write_dataset(found.to_xarray(), tmp_path / "many.nc")
    for again in (co.open_archive(tmp_path / "many.zarr"), co.load(tmp_path / "many.nc")):
        data = again.to_xarray()
        for name, numbers in others.items():
            assert name in data.coords and np.array_equal(data[name], numbers), name
        assert again.drift() == found.drift()


def test_attributes_describe_the_run(tmp_path):
    archive = tmp_path / "many.zarr"
    co.ensemble(BODY, X, (0, 1), 0.125, archive=archive, members_per_block=4)
    attributes = read_root(archive)[1]
    assert attributes["archive_finished"] == 1 and attributes["archive_block"] == 4
    assert json.loads(attributes["system"])["name"] == "rigid_body"
    assert not list((archive / ".coadjoint").glob("*.lock")), "block locks are removed at the end"
    again = co.open_archive(archive)
    assert_same(again, co.integrate(again.system, again.x0, again.t_span, again.step, again.method))


@pytest.fixture
def small_chunks(monkeypatch, no_fsync):
    """Chunks of eight points: a block of 33 points has five."""
    for name in ("MIN_CHUNK_ROWS", "MAX_CHUNK_ROWS"):
        monkeypatch.setattr(f"coadjoint.files.archives.stored_arrays.{name}", 8)


@pytest.mark.parametrize("options", [{}, {"attitude": True, "save_every": 3}])
@pytest.mark.parametrize("span", [(0, 4), (7.5, 3.5)])
def test_blocks_of_several_chunks(tmp_path, small_chunks, span, options):
    found = co.ensemble(BODY, X, span, 0.125, archive=tmp_path / "many.zarr", members_per_block=4, **options)
    assert len(list((tmp_path / "many.zarr" / "x").glob("c.*.0.0"))) == -(-len(found.t) // 8)
    assert_same(found, co.integrate(BODY, X, span, 0.125, **options))


@pytest.mark.parametrize("steps", [(32, 15, 7), (7, 32, 16), (15, 1, 0)])
def test_interruption_between_chunks(tmp_path, monkeypatch, small_chunks, steps):
    """Committed points are read, the others are NaN: within, at the end of, and after a chunk."""
    archive, expected = tmp_path / "many.zarr", co.integrate(BODY, X, (0, 4), 0.125)
    store, blocks = cut(archive, monkeypatch, steps)
    for found in (co.open_archive(archive), co.load(archive)):
        assert found.reached == min(steps) and not found.finished
        for block, done in zip(blocks, steps, strict=True):
            own = slice(block.first, block.last)
            np.testing.assert_array_equal(found.x[: done + 1, own], expected.x[: done + 1, own])
            np.testing.assert_array_equal(found.to_xarray()["x"][: done + 1, own], expected.x[: done + 1, own])
            assert np.isnan(found.x[done + 1 :, own]).all()
            assert (found.status[own] == (done == 32)).all()
    assert [block.number for block in unfinished_blocks(store)] == [k for k, done in enumerate(steps) if done < 32]
    abouts = [read_head(store.folder, block.number) for block in blocks]
    for name in ("evaluations", "iterations", "seconds"):
        # Seconds are added in another order.
        assert getattr(found.stats, name) == pytest.approx(sum(about[name] for about in abouts), rel=1e-12)
    assert_same(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive), expected)


@pytest.mark.parametrize("row", [0, 2, 4])
def test_missing_chunks_are_computed_again(tmp_path, small_chunks, row):
    archive = tmp_path / "many.zarr"
    first = co.ensemble(BODY, X, (0, 4), 0.125, archive=archive, members_per_block=4)
    x = first.x.copy()
    (archive / "x" / f"c.{row}.1.0").unlink()
    store, _ = prepared(archive)
    assert [block.number for block in unfinished_blocks(store)] == [1]
    np.testing.assert_array_equal(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive).x, x)


def test_work_of_blocks_is_added(tmp_path):
    """In the archive and in the solution, for blocks with different work."""
    x0 = X * np.geomspace(0.1, 2.0, len(X))[:, None]
    found = co.ensemble(
        BODY, x0, (0, 4), 0.125, co.GaussLegendre(2), archive=tmp_path / "many.zarr", members_per_block=4
    )
    expected = co.integrate(BODY, x0, (0, 4), 0.125, co.GaussLegendre(2))
    attributes = read_root(tmp_path / "many.zarr")[1]
    for own in (found.stats, expected.stats):
        assert (attributes["evaluations"], attributes["iterations"]) == (own.evaluations, own.iterations)
    store, blocks = prepared(tmp_path / "many.zarr")
    abouts = [read_head(store.folder, block.number) for block in blocks]
    each = {about["iterations"] / (block.last - block.first) for about, block in zip(abouts, blocks, strict=True)}
    assert len(each) == 3
    assert sum(about["iterations"] for about in abouts) == found.stats.iterations > found.stats.evaluations / 10
    assert attributes["seconds"] == pytest.approx(sum(about["seconds"] for about in abouts), rel=1e-12)


def test_seconds_of_earlier_calls_are_added(tmp_path, monkeypatch):
    archive, seconds = tmp_path / "many.zarr", 1e6
    store, blocks = cut(archive, monkeypatch, (5, 9, 32))
    for block in blocks:
        marker = read_marker(store.folder, block.number)
        write_marker(store.folder, block.number, {**marker.about, "seconds": seconds}, marker.stored)
    found = co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    assert 3 * seconds <= found.stats.seconds < 4 * seconds


def edit_root(archive, **kwargs):
    root = json.loads((archive / "zarr.json").read_text())
    root["attributes"] |= kwargs
    (archive / "zarr.json").write_text(json.dumps(root))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"coadjoint_version": "0.0.1"}, "the version of coadjoint differs"),
        ({"archive_first_step": "0"}, "the first step, .*differs"),
        ({"sign": -BODY.sign}, "the sign of the system differs"),
        ({"archive_observed": '{"names": [], "stored": {"more": 1}}'}, "observe differs"),
    ],
)
def test_hidden_differences_are_refused(tmp_path, changed, message):
    archive = tmp_path / "many.zarr"
    co.ensemble(BODY, X, (0, 1), 0.125, archive=archive, members_per_block=4)
    edit_root(archive, **changed)
    with pytest.raises(ArchiveError, match=f"another ensemble: {message}"):
        co.ensemble(BODY, X, (0, 1), 0.125, archive=archive)


@pytest.mark.parametrize("member", [0, 5, 10])
def test_difference_in_one_member_is_refused(tmp_path, member):
    """The last bit or the sign of a zero, in any block; and another kind of attitude."""
    archive, x0 = tmp_path / "many.zarr", X.copy()
    x0[:, 2] = 0.0
    arguments = {"attitude": True, "archive": archive, "members_per_block": 4}
    co.ensemble(BODY, x0, (0, 1), 0.125, **arguments)
    nearest, negative = x0.copy(), x0.copy()
    nearest[member, 1] = np.nextafter(nearest[member, 1], 9.0)
    negative[member, 2] = -0.0
    for other in (nearest, negative):
        with pytest.raises(ArchiveError, match="another ensemble: x0 differs"):
            co.ensemble(BODY, other, (0, 1), 0.125, **arguments)
    turned = np.tile(np.eye(3), (11, 1, 1))
    turned[member] = QUARTER
    with pytest.raises(ArchiveError, match="another ensemble: the initial attitude differs"):
        co.ensemble(BODY, x0, (0, 1), 0.125, **{**arguments, "attitude": turned})
    with pytest.raises(ArchiveError, match="another ensemble: the attitude differs"):
        co.ensemble(BODY, x0, (0, 1), 0.125, **{**arguments, "attitude": "coadjoint"})
    assert co.ensemble(BODY, x0, (0, 1), 0.125, **arguments).finished


@pytest.mark.thinned(12)
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, MemoryError, SystemExit])
@pytest.mark.parametrize("blocks", [0, 1, 2])
def test_temporary_archive_remains_for_partial_results(tmp_path, monkeypatch, error, blocks):
    """After an interrupt it lives as long as the partial result; after other errors it is removed."""
    ran, run_block = [], ensembles.run_block

    def stopped_after_some(*args):
        ran.append(args)
        if len(ran) == blocks + 1:
            raise error
        return run_block(*args)

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with monkeypatch.context() as stopping:
        stopping.setattr(ensembles, "run_block", stopped_after_some)
        with pytest.raises(error) as stopped:
            co.ensemble(BODY, X, (0, 1), 0.125, members_per_block=4)
    partial = getattr(stopped.value, "partial", None)
    assert (partial is None) == (error is not KeyboardInterrupt)
    if partial is not None:
        assert partial.status.tolist() == [1] * (4 * blocks) + [0] * (11 - 4 * blocks)
        assert partial.progress_text == f"{4 * blocks} of 11 members" and partial.progress_text in repr(partial)
        assert partial.to_xarray()["status"].attrs["flag_meanings"] == "not_computed done failed"
        np.testing.assert_array_equal(partial.x0, X)
        expected = co.integrate(BODY, X, (0, 1), 0.125)
        np.testing.assert_array_equal(partial.x[:, : 4 * blocks], expected.x[:, : 4 * blocks])
        assert_same(co.resume(partial.path), expected)
    del stopped, partial
    ran.clear()
    gc.collect()
    assert not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="open descriptors are not listed")
def test_ensemble_descriptors_are_closed(tmp_path, monkeypatch):
    """After a run, a lost, a continued, a refused and a locked one."""
    archive = tmp_path / "many.zarr"
    co.ensemble(BODY, X, (0, 4), 0.125, archive=tmp_path / "first.zarr", members_per_block=4)
    before = len(os.listdir("/proc/self/fd"))
    store, _ = cut(archive, monkeypatch, (3, 5))
    store.close()
    gc.collect()
    lock = open_locked(archive / ".coadjoint" / lock_file(1), os.O_CREAT)
    with pytest.raises(ArchiveUnwritten):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    os.close(lock)
    with pytest.raises(ArchiveError, match="x0 differs"):
        co.ensemble(BODY, X + 1.0, (0, 4), 0.125, archive=archive)
    co.resume(archive)
    assert co.open_archive(archive).finished
    assert len(os.listdir("/proc/self/fd")) == before


def test_worker_count():
    class Cluster:
        def __init__(self, count):
            self.scheduler_info = lambda n_workers: {"workers": dict.fromkeys(range(count))}

    assert [
        WorkerPool().worker_count,
        WorkerPool(None, 3).worker_count,
        WorkerPool(Cluster(4)).worker_count,
        WorkerPool(Cluster(0)).worker_count,
    ] == [1, 3, 4, 1]
