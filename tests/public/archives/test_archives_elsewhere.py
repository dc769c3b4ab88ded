"""Archives in file systems of fsspec: read with all checks of local ones, and neither written nor resumed."""

import importlib.util
import itertools
import os
import pickle
import random
import shutil
import subprocess
import sys

import fsspec
import numpy as np
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from fsspec.spec import AbstractFileSystem

import coadjoint as co
from command import command
from hostile_archives import BODY, REFUSALS, SPAN, STEP, X, archives, change
from refusals import refused

NAMES = ("vector", "members", "finished", "blocks")


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("archives") / "base"
    assert tuple(archives(folder)) == NAMES
    return folder


@pytest.fixture
def bucket():
    """A file system in memory, emptied afterwards."""
    filesystem = MemoryFileSystem()
    yield filesystem
    filesystem.rm("/bucket", recursive=True)


def copied(filesystem, folder, name="run.zarr"):
    """Copy an archive into a file system, in place of an earlier one; return its URL."""
    if filesystem.exists(f"/bucket/{name}"):
        filesystem.rm(f"/bucket/{name}", recursive=True)
    filesystem.put(str(folder), f"/bucket/{name}", recursive=True)
    return f"memory://bucket/{name}"


def readings(location):
    """Yield functions that read an archive in every way."""
    yield lambda: co.load(location).finished
    found = co.open_archive(location)
    for name in ("x", "t", "energy", "attitude", "x0", "reached", "stats", "failed", "status", "blocks", "incomplete"):
        yield lambda name=name: getattr(found, name)
    yield lambda: (dict(found.casimirs), dict(found.observed), dict(found.initial), found.change(), found.balance())
    yield lambda: found.to_xarray().load()
    yield lambda: found.check_complete()


def outcomes(location, shown):
    """Return bits and texts of all results, or the refusal in place of each, with `shown` in place of the location."""
    kept = []
    try:
        for reading in readings(location):
            try:
                kept.append(pickle.dumps(reading()))
            except REFUSALS as reason:
                kept.append(str(reason).replace(str(location), shown))
    except REFUSALS as reason:  # it cannot be opened
        kept.append(str(reason).replace(str(location), shown))
    return kept


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.thinned(2)
def test_archives_are_read_from_urls_and_mappings(base, tmp_path, bucket, name):
    url = copied(bucket, base / name, f"{name}.zarr")
    expected = outcomes(base / name, "HERE")
    assert not any(isinstance(result, str) for result in expected)
    local = (base / name).as_uri()
    packed = "zip://::" + shutil.make_archive(str(tmp_path / "run"), "zip", base / name)
    for location in (url, f"{url}/", f"simplecache::{url}", packed, local, bucket.get_mapper(f"bucket/{name}.zarr")):
        assert outcomes(location, "HERE") == expected
    found = co.open_archive(url)
    assert found.path == url and url in repr(found) and co.open_archive(local).path == base / name
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.x, found.x)
    assert again.path == url and repr(found.system) == repr(co.load(base / name).system)


@pytest.mark.parametrize(("name", "kind"), [*itertools.product(NAMES, ("metadata", "chunk")), ("vector", "state")])
@pytest.mark.thinned(2)
def test_changed_archives_are_refused_as_local_ones(base, tmp_path, bucket, name, kind):
    refusals = 0
    for seed in range(6):
        folder = tmp_path / f"{seed}" / "run.zarr"
        shutil.copytree(base / name, folder)
        change(folder, kind, random.Random(f"{name} {kind} {seed}"), tmp_path)
        expected = outcomes(folder, "HERE")
        assert outcomes(copied(bucket, folder), "HERE") == expected
        refusals += any(isinstance(result, str) for result in expected)
    assert refusals


def test_a_missing_chunk_is_named(base, bucket):
    url = copied(bucket, base / "finished")
    bucket.rm("/bucket/run.zarr/x/c.0.0")
    found = co.open_archive(url)
    for read in (lambda: found.x, found.check_complete):
        with refused(ValueError, url, "x/c.0.0 is missing"):
            read()


def test_a_later_copy_is_read_when_it_is_opened_again(tmp_path, bucket):
    path, end = tmp_path / "run.zarr", SPAN[0] + 5 * STEP
    co.integrate(BODY, X, (SPAN[0], end), STEP, save_every=2, archive=path)
    url = copied(bucket, path)
    found = co.open_archive(url)
    longer = co.resume(path, SPAN[1])
    copied(bucket, path)
    with refused(ValueError, url, "was resumed to a later end"):
        _ = found.x
    np.testing.assert_array_equal(co.open_archive(url).x, longer.x)


class Listed(AbstractFileSystem):
    """Files of this machine by a file system that keeps its listings, as those of object stores do."""

    cachable = False

    def ls(self, path, detail=True, **_):
        path = self._strip_protocol(path)
        if path not in self.dircache:
            names = [path] if os.path.isfile(path) else [f"{path}/{name}" for name in os.listdir(path)]
            kinds = {True: "directory", False: "file"}
            found = [{"name": n, "size": os.path.getsize(n), "type": kinds[os.path.isdir(n)]} for n in names]
            if names == [path]:
                return found if detail else names
            self.dircache[path] = found
        found = self.dircache[path]
        return found if detail else [one["name"] for one in found]

    def invalidate_cache(self, path=None):
        self.dircache.clear()

    def _open(self, path, mode="rb", **_):
        return open(self._strip_protocol(path), mode)


def test_a_listing_that_is_kept_hides_no_later_end(tmp_path):
    path, files = str(tmp_path / "run.zarr"), Listed()
    co.integrate(BODY, X, (SPAN[0], SPAN[0] + 5 * STEP), STEP, archive=path)
    location = fsspec.FSMap(path, files)
    assert len(co.open_archive(location).t) == 6
    files.ls(path)
    longer = co.resume(path, SPAN[1])
    np.testing.assert_array_equal(co.open_archive(location).x, longer.x)


def writers(location):
    """Yield what writes to an archive."""
    yield lambda: co.resume(location)
    yield lambda: co.integrate(BODY, X, SPAN, STEP, archive=location)
    yield lambda: co.integrate_ensemble(BODY, [X, X], SPAN, STEP, archive=location)


def test_runs_elsewhere_are_neither_written_nor_resumed(base, bucket, capsys):
    url, before = copied(bucket, base / "vector"), dict(bucket.get_mapper("bucket"))
    for write in writers(url):
        with refused(ValueError, url, "folders of this machine", "locks"):
            write()
    for write in writers(bucket.get_mapper("bucket/run.zarr")):
        with refused(TypeError, "FSMap", "path of a folder"):
            write()
    outcome = command(capsys, "resume", url)
    assert outcome.status == 2 and "folders of this machine" in outcome.err
    assert dict(bucket.get_mapper("bucket")) == before


@pytest.mark.parametrize(
    ("location", "error", "words"),
    [
        ("memory://bucket/nothing", ValueError, ["there is no archive"]),
        ({}, TypeError, ["is {}", "path"]),
        ("protocol-without-a-name://bucket/run.zarr", ValueError, ["protocol-without-a-name"]),
        ("http://[::1/run.zarr", (ValueError, ImportError), ["http"]),
    ],
)
def test_urls_without_archives(location, error, words):
    for read in (co.open_archive, co.load):
        with refused(error, *words):
            read(location)


class Hostile(MemoryFileSystem):
    """Files of a given status, or whose opening raises an error."""

    protocol, cachable, store = "hostile", False, MemoryFileSystem.store
    status, error = {}, None

    def info(self, path, **options):
        return {**super().info(path, **options), **(self.status if "/x/" in path else {})}

    def open(self, path, *arguments, **options):
        if "/x/" in path and self.error is not None:
            raise self.error
        return super().open(path, *arguments, **options)


@pytest.mark.parametrize(
    ("status", "error", "word"),
    [
        ({"size": 2**50}, AssertionError("read"), "is damaged (it has"),
        ({"size": None}, AssertionError("read"), "cannot be read now (its length is unknown"),
        ({"size": -1}, AssertionError("read"), "cannot be read now (its length is unknown"),
        ({"type": "link"}, AssertionError("read"), "is damaged (no regular file"),
        ({"islink": True}, AssertionError("read"), "is damaged (no regular file"),
        ({"size": 3}, None, "is damaged"),
        ({}, RuntimeError("a server\nanswered"), "cannot be read now (a server answered"),
        ({}, PermissionError("not for you"), "cannot be read now (not for you"),
        ({}, KeyError(), "cannot be read now (KeyError"),
    ],
)
def test_files_are_bounded_and_errors_are_archive_errors(base, bucket, status, error, word):
    copied(bucket, base / "finished")
    filesystem = Hostile()
    filesystem.status, filesystem.error = status, error
    found = co.open_archive(filesystem.get_mapper("/bucket/run.zarr"))
    assert found.energy.shape == found.t.shape
    with refused(ValueError, f"x/c.0.0 {word}"):
        _ = found.x


def test_fsspec_is_needed_for_urls_alone(base, monkeypatch):
    code = f"import coadjoint as co, sys; co.load({str(base / 'blocks')!r}).x; sys.exit('fsspec' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *more: None if name == "fsspec" else find(name, *more))
    assert co.load(base / "blocks").finished is False
    for read in (co.open_archive, co.load):
        with refused(ModuleNotFoundError, "memory://run.zarr", "fsspec", "coadjoint[remote]"):
            read("memory://run.zarr")


def test_mappings_of_this_machine_follow_no_links(base, tmp_path):
    """They are the folder itself, unless they are within another file system."""
    shutil.copytree(base / "finished", tmp_path / "run.zarr")
    within = fsspec.filesystem("dir", path=str(tmp_path), fs=fsspec.filesystem("file")).get_mapper("run.zarr")
    locations = ((tmp_path / "run.zarr").as_uri(), fsspec.get_mapper(str(tmp_path / "run.zarr")), within)
    for inside in ("x", "x/c.0.0"):
        for location in locations:
            assert co.open_archive(location).x.shape == (33, 3)
        (tmp_path / "run.zarr" / inside).rename(tmp_path / "elsewhere")
        (tmp_path / "run.zarr" / inside).symlink_to(tmp_path / "elsewhere")
        for location in locations:
            with refused(ValueError, "x/c.0.0 is damaged"):
                _ = co.open_archive(location).x
        (tmp_path / "run.zarr" / inside).unlink()
        (tmp_path / "elsewhere").rename(tmp_path / "run.zarr" / inside)
