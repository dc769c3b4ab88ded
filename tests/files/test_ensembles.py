"""Ensembles in blocks: the bits of `integrate`, what is left after a cut, and what is refused."""

import gc
import json
import os
import warnings

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint.files import run_in_blocks as ensembles
from coadjoint.files.archive_folder import ArchiveFolder
from coadjoint.files.archive_store import ArchiveError, ArchiveStore, ArchiveUnwritten, read_root
from coadjoint.files.block_run import BlockRun
from coadjoint.files.blocks import blocks_of, lock_file, marker_file, read_about, read_marker, size_of_blocks
from coadjoint.files.ensemble_archive import left_of
from coadjoint.files.unfinished import locked
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
    """Every number that one dataset has is that of the other, to the bit."""
    mine, theirs = found.to_xarray().load(), expected.to_xarray()
    for name in theirs.variables:
        np.testing.assert_array_equal(mine[name].values, theirs[name].values, err_msg=name)
    for name, drift in expected.change().items():
        np.testing.assert_array_equal(found.change()[name].tenths, drift.tenths)
        np.testing.assert_array_equal(found.initial[name], expected.initial[name])
    assert (found.stats.steps, found.stats.evaluations) == (expected.stats.steps, expected.stats.evaluations)


@pytest.mark.parametrize("size", [1, 4, None])
@pytest.mark.parametrize("name", CASES)
def test_the_bits_of_one_run(tmp_path, name, size):
    system, x0, method, options = CASES[name]
    archive = tmp_path / "many.zarr"
    found = co.ensemble(system, x0, (0, 2), 0.125, method, archive=archive, members_per_block=size, **options)
    assert found.finished and (found.status == 1).all()
    assert_same(found, co.integrate(system, x0, (0, 2), 0.125, method, **options))
    assert_same(co.open_archive(archive), found)
    with xarray.open_zarr(archive, chunks=None) as plain:
        np.testing.assert_array_equal(plain["energy"], found.energy)


def test_backward_and_no_step_at_all():
    for span in ((2.0, -1.0), (1.0, 1.0)):
        found = co.ensemble(BODY, X, span, 0.25, members_per_block=4)
        assert_same(found, co.integrate(BODY, X, span, 0.25))


def prepared(archive):
    """Return the store of an archive that is not locked, and its blocks."""
    store = ArchiveStore(archive, *read_root(archive), None)
    return store, blocks_of(11, store.attributes["archive_block"])


def cut(archive, monkeypatch, steps, size=4, **options):
    """Begin an ensemble whose process is lost after so many steps of each block."""
    with monkeypatch.context() as lost:
        lost.setattr(ensembles, "_here", lambda *given: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            co.ensemble(BODY, X, (0, 4), 0.125, archive=archive, members_per_block=size, **options)
    store, blocks = prepared(archive)
    ready, times = PreparedRun(BODY, None, 0.125, **options), times_of((0, 4), 0.125, 1)
    for block, until in zip(blocks, steps, strict=False):
        BlockRun(store, ready.among(block.first, block.last), times, block).advance(until)
    return store, blocks


@pytest.mark.parametrize("steps", [(), (0,), (1, 7), (32, 5, 32), (32, 32, 31)])
def test_a_second_call_computes_what_is_missing(tmp_path, monkeypatch, steps):
    archive = tmp_path / "many.zarr"
    cut(archive, monkeypatch, steps)
    done = [k for k, until in enumerate(steps) if until == 32]
    ran, run_block = [], ensembles.run_block
    monkeypatch.setattr(ensembles, "run_block", lambda *given: ran.append(given[1].number) or run_block(*given))
    found = co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    assert ran == [k for k in range(3) if k not in done]
    assert_same(found, co.integrate(BODY, X, (0, 4), 0.125))
    co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    assert len(ran) == 3 - len(done)


def test_resumed_by_its_archive_alone(tmp_path, monkeypatch):
    archive = tmp_path / "many.zarr"
    cut(archive, monkeypatch, (1, 7), attitude=True, observe={"first": co.Polynomial({(1, 0, 0): 1})})
    found = co.resume(archive)
    whole = co.integrate(BODY, X, (0, 4), 0.125, attitude=True, observe={"first": co.Polynomial({(1, 0, 0): 1})})
    assert_same(found, whole)
    with pytest.raises(ValueError, match="is the archive of one run; client and workers are for ensembles in blocks"):
        co.integrate(BODY, X, (0, 1), 0.125, archive=tmp_path / "one.zarr")
        co.resume(tmp_path / "one.zarr", workers=2)
    with pytest.raises(ValueError, match="resume takes no t_end, events or until for an ensemble"):
        co.resume(archive, t_end=8.0)


def test_what_is_read_before_the_end(tmp_path, monkeypatch):
    archive = tmp_path / "many.zarr"
    cut(archive, monkeypatch, (32, 8))
    found, whole = co.open_archive(archive), co.integrate(BODY, X, (0, 4), 0.125)
    assert not found.finished and found.reached == 0
    np.testing.assert_array_equal(found.status, [1] * 4 + [0] * 7)
    assert "4 of 11 members" in repr(found)
    np.testing.assert_array_equal(found.t, whole.t)
    np.testing.assert_array_equal(found.x[:, :4], whole.x[:, :4])
    np.testing.assert_array_equal(found.x[:9, 4:8], whole.x[:9, 4:8])
    assert np.isnan(found.x[9:, 4:8]).all() and np.isnan(found.x[:, 8:]).all()
    assert found.to_xarray()["status"].attrs["flag_meanings"] == "not_computed done failed"


def test_a_block_goes_on_from_its_marker(tmp_path, monkeypatch):
    archive = tmp_path / "many.zarr"
    store, blocks = cut(archive, monkeypatch, (1, 7))
    ready, times = PreparedRun(BODY, None, 0.125), times_of((0, 4), 0.125, 1)
    runs = [BlockRun(store, ready.among(block.first, block.last), times, block) for block in blocks]
    assert [own.run.number for own in runs] == [1, 7, 0]
    assert [own.about["archive_finished"] for own in runs] == [0, 0, 0]


def test_chunks_that_no_marker_speaks_of_are_written_again(tmp_path, monkeypatch):
    """As where a worker is killed between its chunks and its marker."""
    archive = tmp_path / "many.zarr"
    _, blocks = cut(archive, monkeypatch, (8,))
    held = (archive / ".coadjoint" / marker_file(0)).read_bytes()
    store, _ = prepared(archive)
    BlockRun(store, PreparedRun(BODY, None, 0.125).among(0, 4), times_of((0, 4), 0.125, 1), blocks[0]).advance(20)
    (archive / ".coadjoint" / marker_file(0)).write_bytes(held)
    assert_same(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive), co.integrate(BODY, X, (0, 4), 0.125))


@pytest.mark.parametrize("what", ["marker", "numbers", "chunk", "folder"])
def test_what_is_damaged_or_removed_is_computed_again(tmp_path, what):
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
        # Its first line is whole, and says that the block is done. Nothing has to go on from its numbers.
        with ArchiveFolder(archive) as folder:
            assert read_marker(folder, 1) is None and read_about(folder, 1) is not None
    else:
        store, _ = prepared(archive)
        assert [block.number for block in left_of(store)] == {"folder": [0, 1, 2]}.get(what, [1])
    assert_same(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive), co.integrate(BODY, X, (0, 4), 0.125))


@pytest.mark.parametrize("failing", [{2, 3}, {1}, {0, 4}, {1, 2, 4}, {0, 1, 2, 3, 4}], ids=str)
@pytest.mark.parametrize("members_per_block", [1, 2, 3, 5])
def test_a_member_that_fails_leaves_the_others_alone(tmp_path, failing, members_per_block):
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
    found, whole = again.value.partial, expected.value.partial
    assert (again.value.step, again.value.time) == (expected.value.step, expected.value.time)
    assert "member 0" not in str(again.value) or first == 0
    np.testing.assert_array_equal(found.failed, [m in failing for m in range(5)])
    np.testing.assert_array_equal(found.status, [1 + (m in failing) for m in range(5)])
    np.testing.assert_array_equal(found.x, whole.x)
    assert found.finished


@pytest.mark.parametrize(
    ("change", "said"),
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
def test_another_ensemble_is_refused_by_name(tmp_path, change, said):
    archive = tmp_path / "many.zarr"
    given = {"system": BODY, "x0": X, "t_span": (0, 4), "step": 0.125}
    co.ensemble(**given, archive=archive)
    before = sorted(path.name for path in archive.rglob("*"))
    with pytest.raises(ArchiveError, match=f"is the archive of another ensemble: ({said}); give another name"):
        co.ensemble(**{**given, **change}, archive=archive)
    assert sorted(path.name for path in archive.rglob("*")) == before


def test_functions_that_are_not_stored_are_told_by_their_fingerprints(tmp_path):
    def system(factor):
        H = co.Separable({0: (lambda y: factor * np.cos(y), lambda y: -factor * np.sin(y))})
        return co.LiePoissonSystem(co.algebras.so(3), H, name="mine")

    archive = tmp_path / "many.zarr"
    first = co.ensemble(system(1.0), X, (0, 4), 0.125, archive=archive)
    assert_same(co.ensemble(system(1.0), X, (0, 4), 0.125, archive=archive), first)
    with pytest.raises(ArchiveError, match="the code or the numbers of functions of system differ"):
        co.ensemble(system(1.5), X, (0, 4), 0.125, archive=archive)


def test_two_calls_at_once(tmp_path, monkeypatch):
    archive = tmp_path / "many.zarr"
    cut(archive, monkeypatch, (8,))
    store = ArchiveStore.opened(archive)
    with pytest.raises(ArchiveError, match="another process is writing to this archive"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    store.close()
    lock = locked(archive / ".coadjoint" / lock_file(1), os.O_CREAT)
    with pytest.raises(ArchiveUnwritten, match="another process is still running some members"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=archive)
    os.close(lock)
    assert_same(co.ensemble(BODY, X, (0, 4), 0.125, archive=archive), co.integrate(BODY, X, (0, 4), 0.125))


def test_other_archives_and_versions(tmp_path, monkeypatch):
    one = tmp_path / "one.zarr"
    co.integrate(BODY, X, (0, 4), 0.125, archive=one)
    with pytest.raises(ArchiveError, match="is the archive of one run, not of an ensemble"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=one)
    monkeypatch.setattr("coadjoint.files.block_run.__version__", "0.0.1")
    with pytest.raises(ArchiveError, match=r"was begun by coadjoint .*, and the worker on .* has 0.0.1"):
        co.ensemble(BODY, X, (0, 4), 0.125, archive=tmp_path / "many.zarr")


def test_a_temporary_archive_goes_with_its_solution(tmp_path, monkeypatch):
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
    monkeypatch.setattr(ensembles, "run_block", lambda *given: {"busy": True})
    with pytest.raises(ArchiveUnwritten):
        co.ensemble(BODY, X, (0, 1), 0.125)
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_what_differs_along_the_members_is_a_coordinate(tmp_path):
    archive = tmp_path / "many.zarr"
    inertia = np.array([body.parameters["inertia"][2] for body in BATCH])
    co.ensemble(BATCH, X, (0, 1), 0.125, archive=archive, coordinates={"inertia_2": inertia}, members_per_block=4)
    with xarray.open_zarr(archive) as plain:
        assert "inertia_2" in plain.coords
        np.testing.assert_array_equal(plain["inertia_2"], inertia)
        assert plain["energy"].swap_dims(member="inertia_2").sel(inertia_2=2.25).shape == (9,)


def test_sizes_of_blocks():
    assert [size_of_blocks(*given) for given in ((1, 3, 1), (7, 3, 4), (10**6, 3, 2), (10**6, 9, 100))] == [
        1, 1, 125024, 2528
    ]  # fmt: skip
    assert size_of_blocks(10**6, 100, 1) == 2**22 // 800
    blocks = blocks_of(11, 4)
    assert [member for block in blocks for member in range(block.first, block.last)] == list(range(11))


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"x0": X[0]}, ValueError, r"x0 has the shape \(3,\); an ensemble needs \(members, ...\)"),
        ({"members_per_block": 0}, ValueError, "members_per_block must be a whole number from 1 up"),
        ({"workers": 0, "archive": None}, ValueError, "workers must be a whole number from 1 up"),
        ({"client": 3}, TypeError, "client is 3; it must be a distributed.Client"),
        ({"client": 3, "workers": 2}, TypeError, "was given a client and workers; give only one"),
        ({"archive": 3}, TypeError, "archive is 3; it must be the path of a folder"),
        ({"archive": "no/such/folder/many.zarr"}, ArchiveError, "the folder .* does not exist"),
        ({"coordinates": {"a b": X[:, 0]}}, ValueError, "coordinates has the name 'a b'; give one of letters"),
        ({"coordinates": {"energy": X[:, 0]}}, ValueError, "coordinates has the name 'energy', which is reserved"),
        ({"coordinates": [1.0]}, TypeError, "coordinates is .*; give a mapping from names to numbers"),
        ({"coordinates": {"a": X}}, ValueError, "coordinates has .* for 'a'"),
        ({"progress": 2}, TypeError, "progress is 2"),
        ({"step": -1}, ValueError, "step is -1"),
    ],
)
def test_wrong_input(change, error, said):
    given = {"system": BODY, "x0": X, "t_span": (0, 1), "step": 0.125}
    with pytest.raises(error, match=said):
        co.ensemble(**{**given, **change})


def test_the_attributes_say_what_was_run(tmp_path):
    archive = tmp_path / "many.zarr"
    co.ensemble(BODY, X, (0, 1), 0.125, archive=archive, members_per_block=4)
    attributes = read_root(archive)[1]
    assert attributes["archive_finished"] == 1 and attributes["archive_block"] == 4
    assert json.loads(attributes["system"])["name"] == "rigid_body"
    assert not list((archive / ".coadjoint").glob("*.lock")), "locks of blocks are removed at the end"
    again = co.open_archive(archive)
    assert_same(again, co.integrate(again.system, again.x0, again.t_span, again.step, again.method))
