"""Archives with small chunks, commits between two reads, and large arrays."""

import os

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives import archived_run, archived_solution, stored_arrays
from coadjoint.files.archives.archive import Archive
from coadjoint.files.archives.folder import ArchiveError
from coadjoint.runs import piecewise_run
from coadjoint.runs.piecewise_run import PiecewiseRun
from refusals import refused
from same_runs import check_same

BODY, X = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, -1.0, 0.7)
STEP, SPAN = 0.125, (0.0, 2.0)
SEVERAL = np.multiply.outer([1.0, 0.5, -0.25], X)
pytestmark = pytest.mark.usefixtures("no_fsync")


@pytest.fixture
def rows(monkeypatch):
    """Set the number of points of a chunk."""

    def set_rows(count):
        monkeypatch.setattr(stored_arrays, "MAX_CHUNK_ROWS", count)

    return set_rows


EVENTS = [co.Event("x1"), co.Event("x2", terminal=True, direction=1)]


@pytest.mark.parametrize("events", [None, EVENTS], ids=["no events", "events"])
@pytest.mark.parametrize("count", [2, 5])
def test_extra_last_point_after_full_chunks(tmp_path, rows, count, events):
    """It follows sooner than save_every steps after a point that may have filled a chunk."""
    rows(count)
    for steps in range(4 * count - 5, 4 * count + 5):
        run, path = (BODY, X, (0, steps * STEP), STEP, co.GaussLegendre(2)), tmp_path / f"{steps}.zarr"
        expected = co.integrate(*run, save_every=4, events=events)
        found = co.integrate(*run, save_every=4, events=events, archive=path)
        check_same(found, expected)
        for name in ("t", "x", "energy"):
            assert np.array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("events", [None, EVENTS], ids=["no events", "events"])
@pytest.mark.parametrize(("every", "x0"), [(2, X), (1, SEVERAL)], ids=["one", "members"])
@pytest.mark.thinned(2)
def test_states_as_large_as_a_chunk(tmp_path, monkeypatch, every, x0, events):
    """Every saved point of many members or large matrices has chunks of its own."""
    advance, calls, path = PiecewiseRun.advance, [], tmp_path / "run.zarr"

    def bounded(self, until):
        calls.append(until)
        assert len(calls) < 200, "no step is taken"
        advance(self, until)

    monkeypatch.setattr(PiecewiseRun, "advance", bounded)
    monkeypatch.setattr(stored_arrays, "CHUNK_BYTES", 8)
    expected = co.integrate(BODY, x0, SPAN, STEP, save_every=every, events=events)
    co.integrate(BODY, x0, (0.0, 2 * STEP), STEP, save_every=every, events=events, archive=path)
    for end, until in ((2.0, 6), (None, None)):
        found = co.resume(path, end, until=until)
    check_same(found, expected)
    if x0 is SEVERAL:
        options = {"save_every": every, "archive": tmp_path / "many", "members_per_block": 1, "events": events}
        check_same(co.integrate_ensemble(BODY, x0, SPAN, STEP, **options), expected)


@pytest.mark.parametrize("blocks", [False, True])
def test_more_crossings_than_an_archive_holds(tmp_path, monkeypatch, blocks):
    """The steps before are in the archive; with a higher limit the run is resumed."""
    path, run = tmp_path / "run.zarr", (BODY, SEVERAL, (0.0, 200.0), STEP)
    expected = co.integrate(*run, events=EVENTS[0])
    monkeypatch.setattr(archived_run, "MAX_CROSSING_BYTES", 10 * 7 * 8)
    assert len(expected.events.of(0)) > 10
    given = {"archive": path, "events": EVENTS[0], **({"members_per_block": 1} if blocks else {})}
    with refused((ArchiveError, OSError), "crossed", "count"):
        (co.integrate_ensemble if blocks else co.integrate)(*run, **given)
    assert len(co.open_archive(path).events) <= 30
    monkeypatch.undo()
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    check_same(co.resume(path), expected)


@pytest.mark.parametrize("commits", [1, 3, 100])
def test_opening_during_commits(tmp_path, monkeypatch, commits):
    """The state named by the root may be removed before it is read; the root is then read again, a few times."""
    co.integrate(BODY, X, SPAN, STEP, archive=tmp_path / "run.zarr")
    read, moved = Archive.read_state, []

    def gone(self, stored):
        moved.append(stored)
        if len(moved) <= commits:
            self.attributes["elapsed"] += 1.0  # of a root that is not the last one
            raise ArchiveError(f"{self.folder}: the state {stored.file} is missing")
        return read(self, stored)

    monkeypatch.setattr(Archive, "read_state", gone)
    if commits < archived_solution.ATTEMPTS:
        assert co.open_archive(tmp_path / "run.zarr").reached == 16 and len(moved) == commits + 1
    else:
        with refused(ValueError, "state", "missing"):
            co.open_archive(tmp_path / "run.zarr")
        assert len(moved) == archived_solution.ATTEMPTS


@pytest.mark.parametrize("name", ["x", "casimir_x_2"])
def test_resuming_checks_all_committed_chunks(tmp_path, rows, name):
    """Any chunk may be missing; the last ones, to which the run appends, may be damaged as well."""
    rows(2)
    for path, until in ((tmp_path / "run.zarr", 9), (tmp_path / "odd.zarr", 8)):
        co.integrate(BODY, X, (0.0, 2 * STEP), STEP, archive=path)
        co.resume(path, 2.0, until=until)
        chunks = sorted((path / name).glob("c.*"))
        assert len(chunks) == 5
        for chunk in chunks[::2]:
            content = chunk.read_bytes()
            chunk.unlink()
            with refused(ValueError, f"{name}/{chunk.name} is missing"):
                co.resume(path)
            chunk.write_bytes(content)
    content = chunk.read_bytes()
    chunk.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with refused(ValueError, f"{name}/{chunk.name} is damaged", "checksum"):
        co.resume(path)
    chunk.write_bytes(content)
    for path in (tmp_path / "run.zarr", tmp_path / "odd.zarr"):
        check_same(co.resume(path), co.integrate(BODY, X, SPAN, STEP))


def test_large_array_is_refused_before_allocation(tmp_path, monkeypatch):
    found = co.integrate(BODY, X, (0, 4000), STEP, archive=tmp_path / "run.zarr")
    monkeypatch.setattr("coadjoint.memory.UNCHECKED_BYTES", 0)
    monkeypatch.setattr("coadjoint.memory.available", lambda: 10**6)
    with refused(ValueError, "x of the archive", "2 MB", "to_xarray"):
        _ = found.x
    assert found.to_xarray()["x"][-1].shape == (3,)


@pytest.mark.parametrize("options", [{}, {"attitude": True, "save_every": 3}])
@pytest.mark.parametrize("span", [(0, 4), (7.5, 3.5)])
def test_blocks_of_several_chunks(tmp_path, rows, span, options):
    """A missing chunk of any row is computed again with its block."""
    rows(8)
    path, x0 = tmp_path / "many.zarr", np.random.default_rng(3).standard_normal((11, 3))
    found = co.integrate_ensemble(BODY, x0, span, STEP, archive=path, members_per_block=4, **options)
    expected = co.integrate(BODY, x0, span, STEP, **options)
    assert len(list((path / "x").glob("c.*.0.0"))) == -(-len(found.t) // 8)
    check_same(found, expected)
    for row in range(-(-len(found.t) // 8)):
        (path / "x" / f"c.{row}.1.0").unlink()
        check_same(co.resume(path), expected)


def test_points_without_a_marker_are_not_shown(tmp_path, monkeypatch):
    """They are in the chunk of committed ones, which is written again before its marker, and every few steps here."""
    monkeypatch.setattr(piecewise_run, "TAKING_INTERVAL", 0.0)
    monkeypatch.setattr(piecewise_run, "TAKING_RATIO", 0.0)
    states, path, span = np.random.default_rng(3).standard_normal((11, 3)), tmp_path / "many.zarr", (0.0, 1000 * STEP)
    expected, replace, markers = co.integrate(BODY, states, span, STEP), os.replace, []

    def stopped(source, target, **folders):
        markers.append(os.path.basename(target) == "block-000001")
        if markers[-1] and sum(markers) == 2:
            raise KeyboardInterrupt
        replace(source, target, **folders)

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(os, "replace", stopped)
        co.integrate_ensemble(BODY, states, span, STEP, archive=path, members_per_block=4)
    found = co.open_archive(path)
    rows, x = 1 + piecewise_run.FIRST_PIECE, np.array(found.x)
    assert rows < 1001 and found.status.tolist() == [1] * 4 + [0] * 7
    np.testing.assert_array_equal(x[:rows, :8], expected.x[:rows, :8])
    assert np.isnan(x[rows:, 4:]).all() and np.isnan(x[1:, 8:]).all()
    check_same(co.resume(path), expected)
