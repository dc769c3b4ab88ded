"""A file of an archive is not there, damaged, or cannot be read now: never one for the other, and not after waiting."""

import http.server
import inspect
import io
import json
import os
import shutil
import sys
import threading
import time
import urllib.error
import urllib.request
import zipfile
from pathlib import Path

import fsspec
import numpy as np
import pytest
from storing import contents

import coadjoint as co
from guards import bounded_work
from hostile_archives import BODY, HIDDEN, ROOT, STEP, X, archives, begin, edit_root
from refusals import refused

MANY = np.multiply.outer([1.0, 0.5, 0.2], X)
NOW = "cannot be read now"
pytestmark = pytest.mark.usefixtures("no_fsync")


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """Archives, and an unfinished ensemble: the second of its blocks has not begun."""
    folder = tmp_path_factory.mktemp("answers") / "base"
    archives(folder)
    shutil.copytree(folder / "blocks", folder / "unfinished")
    edit_root(folder / "unfinished", lambda attributes, _: attributes.update(archive_finished=0))
    return folder


class Web(fsspec.AbstractFileSystem):
    """Files of a server. Like that of fsspec, it says of any failed request that the file is not found."""

    protocol, cachable = "web", False

    def info(self, path, **options):
        try:
            with urllib.request.urlopen(urllib.request.Request(f"http://{path}", method="HEAD")) as answer:
                return {"name": path, "type": "file", "size": int(answer.headers["Content-Length"])}
        except urllib.error.HTTPError as reason:
            reason.close()
            raise FileNotFoundError(path) from reason

    def _open(self, path, *arguments, **options):
        with urllib.request.urlopen(f"http://{path}") as answer:
            return io.BytesIO(answer.read())


@pytest.fixture
def server(base):
    """A server of these archives; `answers` has other answers, by the end of the path: a status, or none at all."""
    fsspec.register_implementation("web", Web, clobber=True)
    answers, stop = {}, threading.Event()

    class Handler(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *arguments):
            super().__init__(*arguments, directory=str(base))

        def send_head(self):
            answer = next((answer for end, answer in answers.items() if self.path.endswith(end)), 200)
            if answer == 200:
                return super().send_head()
            if answer == "silence" or self.command == "GET":
                stop.wait()
            elif answer == "half":
                self.send_response(200)
                self.send_header("Content-Length", "1000")
                self.end_headers()
            else:
                self.send_error(answer)
            return None

        def log_message(self, *arguments):
            pass

    class Server(http.server.ThreadingHTTPServer):
        daemon_threads = True

    with Server(("127.0.0.1", 0), Handler) as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield f"web://127.0.0.1:{running.server_port}", answers
        stop.set()
        running.shutdown()
        thread.join()


def test_archives_on_a_server_are_read(base, server):
    for name in ("vector", "finished", "blocks", "unfinished"):
        found = co.open_archive(f"{server[0]}/{name}")
        assert np.array_equal(found.x, co.open_archive(base / name).x, equal_nan=True)


@pytest.mark.parametrize("status", [403, 500, 503])
@pytest.mark.parametrize("name", [ROOT, f"{HIDDEN}/block-000000", "x/c.0.0.0", "x0/c.0.0", "status/c.0"])
def test_servers_that_fail_say_nothing_about_the_archive(server, status, name):
    url, answers = server[0] + "/unfinished", server[1]
    answers[name] = status
    with refused(ValueError, url, name, NOW, status) as error:
        found = co.open_archive(url)
        _ = found.x, found.x0, found.status
    assert "missing" not in str(error.value) and "damaged" not in str(error.value)
    answers.clear()
    found = co.open_archive(url)
    assert found.status.tolist() == [1, 1, 0] and np.isnan(found.x[:, 2]).all() and not np.isnan(found.x[:, :2]).any()


def test_files_that_a_server_does_not_have_are_missing(server):
    url, answers = server[0] + "/unfinished", server[1]
    for name, named in ((ROOT, "there is no archive"), ("x/c.0.0.0", "x/c.0.0.0 is missing")):
        answers[name] = 404
        with refused(ValueError, url, named):
            _ = co.open_archive(url).x
        answers.clear()
    answers["block-000000"] = 410
    assert np.isnan(co.open_archive(url).x).all(), "as if it had not begun"


@pytest.mark.parametrize("read", [co.open_archive, lambda path: co.resume(path, (0.0, 2.0))])
def test_an_archive_copied_without_its_hidden_folder_names_it(tmp_path, read):
    """As by `cp -r run.zarr/* there`; its results are there."""
    run = co.integrate(co.systems.rigid_body((1, 2, 3)), (1.0, 0.2, 0.5), (0.0, 1.0), 0.1, archive=tmp_path / "run")
    shutil.copytree(tmp_path / "run", tmp_path / "there", ignore=shutil.ignore_patterns(HIDDEN))
    with refused(ValueError, tmp_path / "there", HIDDEN, "is missing", "co.load"):
        read(tmp_path / "there")
    np.testing.assert_array_equal(co.load(tmp_path / "there").x, run.x)


@pytest.mark.parametrize("answer", ["silence", "half"])
@pytest.mark.parametrize("name", [ROOT, "x/c.0.0"])
def test_servers_that_stop_answering_are_not_waited_for(server, monkeypatch, answer, name):
    url, answers = server[0] + "/finished", server[1]
    monkeypatch.setenv("COADJOINT_TIMEOUT", "0.25")
    answers[name], began = answer, time.monotonic()
    with refused(ValueError, url, NOW, "no answer within 0.25 s", "COADJOINT_TIMEOUT"):
        _ = co.open_archive(url).x
    assert time.monotonic() - began < 30
    for wrong in ("0", "-1", "soon", "nan"):
        monkeypatch.setenv("COADJOINT_TIMEOUT", wrong)
        with refused(ValueError, "COADJOINT_TIMEOUT", wrong):
            co.open_archive(url)


def unreadable(monkeypatch, name, error):
    """Let files of a name fail to open."""
    opened = os.open

    def failing(path, flags, *more, **options):
        if os.path.basename(os.fspath(path)) == name:
            raise error
        return opened(path, flags, *more, **options)

    monkeypatch.setattr(os, "open", failing)


FILES = {
    "root": ("unfinished", ROOT), "marker": ("unfinished", "block-000000"), "chunk": ("unfinished", "c.0.0.0"),
    "run": ("vector", "c.0.0"),
}  # fmt: skip


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), OSError(5, "Input/output error")], ids=str)
@pytest.mark.parametrize("case", FILES)
def test_files_that_cannot_be_read_are_left_alone(base, tmp_path, case, error):
    """Neither is a block computed again whose marker cannot be read."""
    name, file = FILES[case]
    path = tmp_path / "run.zarr"
    shutil.copytree(base / name, path)
    before = contents(path)
    with pytest.MonkeyPatch.context() as patched:
        unreadable(patched, file, error)
        with refused(ValueError, path, NOW, error.strerror):
            _ = co.open_archive(path).x
        if case != "chunk":  # of a block that is finished
            with refused((ValueError, OSError), path, error.strerror):
                co.resume(path)
    kept = contents(path)
    assert all(kept[name] == content for name, content in before.items() if name.name.startswith(("c.", "block-")))
    assert co.resume(path).finished


@pytest.mark.parametrize("name", ["zarr.json", "x/c.0.0", "state-"])
def test_lack_of_memory_is_no_damage(base, name):
    class Small(fsspec.get_filesystem_class("memory")):
        protocol, cachable, store, pseudo_dirs = "small", False, {}, [""]

        def open(self, path, *arguments, **options):
            if name in path and self.is_small:
                raise MemoryError
            return super().open(path, *arguments, **options)

    filesystem = Small()
    filesystem.is_small = False
    filesystem.put(str(base / "vector"), "/run.zarr", recursive=True)
    for small in (True, False):
        filesystem.is_small = small
        if small:
            with refused(ValueError, name, NOW, "memory"):
                _ = co.open_archive(filesystem.get_mapper("/run.zarr")).x
    assert co.open_archive(filesystem.get_mapper("/run.zarr")).x.shape == (7, 3)


def depth():
    frame, count = inspect.currentframe(), 0
    while frame:
        frame, count = frame.f_back, count + 1
    return count


@pytest.mark.parametrize("name", ["vector", "unfinished"])
def test_a_recursion_limit_is_no_damage(base, name):
    """At any depth of the caller, a sound archive is read, or it is the recursion that fails."""
    expected, limit, read = co.open_archive(base / name).x, sys.getrecursionlimit(), 0
    for left in range(10, 120, 2):
        try:
            sys.setrecursionlimit(depth() + left)
            x = co.open_archive(base / name).x
        except RecursionError:
            continue
        except ValueError as reason:
            sys.setrecursionlimit(limit)
            assert NOW in str(reason), str(reason)
        else:
            read += np.array_equal(x, expected, equal_nan=True)
        finally:
            sys.setrecursionlimit(limit)
    assert 0 < read < 55


# Archives that claim more than their folder holds.


def claimed(members, size=1):
    """Claim so many members, in blocks of a size."""

    def change(attributes, arrays):
        attributes["archive_block"] = size
        for array in arrays.values():
            dims = array.get("dimension_names", [])
            if "member" in dims:
                k, chunk = dims.index("member"), array["chunk_grid"]["configuration"]["chunk_shape"]
                array["shape"][k], chunk[k] = members, min(size, members)

    return change


def longer(steps):
    """Claim so many steps."""

    def change(attributes, arrays):
        attributes.update(steps=steps, t_span=json.dumps([0.0, steps * STEP]), archive_steps=steps)
        for array in arrays.values():
            if array.get("dimension_names", [""])[0] == "time":
                array["shape"][0] = steps + 1

    return change


@pytest.mark.parametrize("form", [1, 2])
@pytest.mark.parametrize("change", [claimed(10**9), claimed(10**9, 7), claimed(2**40), longer(10**12)])
def test_claims_beyond_the_folder_are_refused_in_bounded_work(base, tmp_path, form, change):
    path = tmp_path / "blocks.zarr"
    if form == 1:
        with zipfile.ZipFile(Path(__file__).parent / "reference_archives" / "format_1.zip") as held:
            held.extractall(tmp_path)
        root = json.loads((path / ROOT).read_text())
        change(root["attributes"], root["consolidated_metadata"]["metadata"])
        (path / ROOT).write_text(json.dumps(root))
    else:
        shutil.copytree(base / "blocks", path)
        edit_root(path, change)
    with bounded_work(10.0):
        for use in (co.open_archive, co.load, co.resume):
            with refused(ValueError, path, "chunks"):
                use(path)


def test_claims_about_a_run_are_refused(base, tmp_path):
    path = tmp_path / "run.zarr"
    shutil.copytree(base / "vector", path)
    edit_root(path, longer(10**12))
    with bounded_work(10.0), refused(ValueError, path):
        co.open_archive(path)


def test_an_ensemble_with_many_blocks_is_described(tmp_path):
    """One of 50 blocks has been computed."""
    path = tmp_path / "run.zarr"
    states = np.random.default_rng(1).standard_normal((50, 3))
    co.integrate_ensemble(BODY, states, (0, STEP), STEP, archive=path, members_per_block=1)
    for marker in sorted((path / HIDDEN).glob("block-*"))[1:]:
        marker.unlink()
    found = co.open_archive(path)
    assert not found.finished and found.reached == 0 and "1 of 50 members" in repr(found) and len(found.blocks) == 50
    assert found.status.tolist() == [1] + [0] * 49
    found.check_complete()


def test_chunks_of_a_short_run_are_those_of_a_long_one(tmp_path):
    """Many small ones would take many times longer to write."""
    path, steps = tmp_path / "run.zarr", 10**5
    begin(path, until=2)
    found = co.resume(path, steps * STEP)
    co.integrate(BODY, X, found.t_span, STEP, found.method, save_every=2, archive=tmp_path / "whole.zarr")

    for name in ("x", "energy"):
        chunks = [sorted(chunk.name for chunk in (tmp_path / p / name).glob("c.*")) for p in ("run.zarr", "whole.zarr")]
        assert chunks[0] == chunks[1] and len(chunks[0]) == 1
