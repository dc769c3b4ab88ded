"""Archives of untrusted origin: refused in one sentence, in bounded memory, without effects outside the archive."""

import hashlib
import io
import itertools
import json
import os
import shutil
import subprocess
import sys

import google_crc32c
import numpy as np
import pytest
from numcodecs import Blosc

import coadjoint as co
from command import command
from hostile_archives import (
    BODY,
    HIDDEN,
    ROOT,
    SPAN,
    STEP,
    X,
    archives,
    attacked,
    begin,
    edit_attributes,
    edit_root,
    outside_names,
    snapshot,
)
from refusals import refused

NAMES = ("vector", "members", "finished", "blocks")
KINDS = ("metadata", "chunk", "state", "link")
pytestmark = [pytest.mark.skipif(os.name == "nt", reason="links and FIFOs"), pytest.mark.usefixtures("no_fsync")]


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile") / "base"
    assert tuple(archives(folder)) == NAMES
    begin(folder / "backward", BODY.with_forces(co.forces.LinearDamping(0.125)), [X, X], end=-4.0)
    fluid = co.systems.torus_euler(3)
    co.integrate(fluid, fluid.random(seed=1), SPAN, STEP, archive=folder / "matrices")
    return folder


def check(base, tmp_path, name, kind, seeds):
    if (name, kind) == ("blocks", "state"):
        return
    for seed in seeds:
        assert not attacked(base, tmp_path / "try", name, kind, seed), (name, kind, seed)


@pytest.mark.thinned(7)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_random_attacks(base, tmp_path, name, kind):
    check(base, tmp_path, name, kind, range(4))


@pytest.mark.long
def test_many_random_attacks(base, tmp_path):
    for name, kind in itertools.product(NAMES, KINDS):
        check(base, tmp_path, name, kind, range(4, 130))


@pytest.fixture
def run(base, tmp_path):
    """An unfinished archive beside a folder of the user."""
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "kept").write_bytes(b"a file of the user")
    shutil.copytree(base / "vector", tmp_path / "run.zarr")
    return tmp_path / "run.zarr", outside


@pytest.mark.thinned(2)
@pytest.mark.parametrize(
    "name", [0, 1, 2, 3, 4, "..", ".", "...", "", " ", "a b", "a-b", "1x", ".hidden", "x.0", "x\0", "x" * 256]
)
def test_paths_as_array_names_are_refused(run, name, capsys):
    """Paths that lead out of the archive, and other names that are no identifiers, are refused."""
    path, outside = run
    name = outside_names(outside)[name] if isinstance(name, int) else name
    edit_root(path, lambda _, arrays: arrays.update({name: arrays.pop("energy")}))
    before = snapshot(outside)
    for call in (co.open_archive, co.resume, co.load):
        with refused(ValueError, "no plain name"):
            call(path)
    done = command(capsys, "resume", path)
    assert done.status == 2 and done.err.count("\n") == 1
    assert snapshot(outside) == before


WRITING = (f"{HIDDEN}/.zarr.json.writing", ".zarr.json.writing", "x/.c.0.0.writing")


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", ["x", HIDDEN, f"{HIDDEN}/lock", "x/c.0.0", *WRITING])
def test_links_are_not_followed(run, name):
    """A link replaces a folder or a file of the archive, or a file to be written."""
    path, outside = run
    link = path / name
    if link.is_dir():
        shutil.move(link, outside / "there")
        link.symlink_to(outside / "there")
    else:
        link.unlink(missing_ok=True)
        link.symlink_to(outside / ("new" if name.endswith("lock") else "kept"))
    before = snapshot(outside)
    if name in WRITING:
        assert co.resume(path).finished  # taken for a leftover of a killed process
    else:
        with refused(ValueError, "symbolic link"):
            co.resume(path)
    assert snapshot(outside) == before


def test_archive_path_may_be_a_link(run, tmp_path):
    (tmp_path / "link").symlink_to(run[0])
    assert co.resume(tmp_path / "link").finished and co.open_archive(run[0]).finished


CHILD = """
import resource, sys
import coadjoint as co
found = co.open_archive(sys.argv[1])
found.t, found.to_xarray()["energy"].values
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for read in (lambda: found.x, lambda: found.to_xarray()["x"].values):
    try:
        read()
    except ValueError as refused:
        print(refused)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


def with_checksum(body):
    return body + int(google_crc32c.value(body)).to_bytes(4, "little")


def test_decompression_bomb_takes_bounded_memory(run):
    """A few kilobytes decompress to 128 MB; memory is measured in a separate process."""
    path, _ = run
    packed = bytes(Blosc("zstd", 1, Blosc.SHUFFLE).encode(np.zeros(2**24)))
    assert len(packed) < 2**17
    (path / "x" / "c.0.0").write_bytes(with_checksum(packed))
    output = subprocess.run([sys.executable, "-c", CHILD, path], capture_output=True, text=True, check=True).stdout
    *errors, more = output.splitlines()
    assert len(errors) == 2 and all("x/c.0.0 is damaged" in line for line in errors)
    assert int(more) < 2**15  # kB, a quarter of the decompressed size


def test_chunks_of_another_length_are_refused(run):
    """Fewer or more numbers, bytes after the end and missing ones; texts of other numbers and lengths."""
    path, _ = run
    chunk, names = path / "x" / "c.0.0", path / "component" / "c.0"
    good, numbers = chunk.read_bytes(), Blosc("zstd", 3, Blosc.SHUFFLE)
    packed, rows = good[:-4], len(numbers.decode(good[:-4])) // 24
    lengths = [bytes(numbers.encode(np.zeros(count))) for count in (3 * rows - 1, 3 * rows + 1, 2**20)]
    for body in (*lengths, packed + b"\0", packed[:-1], packed[: len(packed) // 2], packed[:16], packed[:15], b""):
        chunk.write_bytes(with_checksum(body))
        with refused(ValueError, "x/c.0.0 is damaged"):
            _ = co.open_archive(path).x
    for at in (0, len(good) // 2, len(good) - 1):  # without a matching checksum
        chunk.write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
        with refused(ValueError, "x/c.0.0 is damaged", "checksum"):
            _ = co.open_archive(path).x
    chunk.write_bytes(good)
    for body in (b"\4\0\0\0" + bytes(16), (2**31 - 1).to_bytes(4, "little") + bytes(12), b"\3\0\0\0" + bytes(11), b""):
        names.write_bytes(with_checksum(body))
        with refused(ValueError, "component/c.0 is damaged"):
            co.open_archive(path).to_xarray().load()


@pytest.mark.parametrize("name", ["x", "time", "energy", "x0", "drift", "component", "attitude"])
@pytest.mark.parametrize("kind", ["vector", "finished"])
def test_missing_chunk_is_named(base, tmp_path, name, kind):
    if (kind, name) == ("finished", "attitude"):
        return
    path = tmp_path / "run.zarr"
    shutil.copytree(base / kind, path)
    (chunk,) = (path / name).glob("c.*")
    chunk.unlink()
    found = co.open_archive(path)
    for read in (lambda: found.to_xarray().load(), *([lambda: co.resume(path)] if kind == "vector" else [])):
        with refused(ValueError, f"{name}/{chunk.name} is missing"):
            read()


@pytest.mark.parametrize("steps", [7, 2**16 - 2, 2**16 - 1, 2**17 + 9])
def test_a_damaged_last_chunk_is_noticed(tmp_path, steps):
    """Also one that is full: the first chunk has 2^16 points."""
    path = tmp_path / "run.zarr"
    system = co.systems.rigid_body(inertia=(1, 2, 3))
    co.integrate(system, (0.1, 1.0, 0.3), (0, steps / 8), 1 / 8, archive=path)
    co.load(path).check_complete()
    last = max((path / "x").glob("c.*"), key=lambda chunk: int(chunk.name.split(".")[1]))
    last.write_bytes(last.read_bytes()[:-1])
    with refused(ValueError, "x/", last.name):
        co.load(path).check_complete()


def test_missing_chunks_of_an_ensemble_are_refused(base, tmp_path):
    """Only chunks of members that are not computed yet are NaN."""
    path, x0 = tmp_path / "many.zarr", np.multiply.outer([1.0, 0.5, 0.2], X)
    co.integrate_ensemble(BODY, x0, SPAN, STEP, archive=path, members_per_block=2)
    chunk, marker = path / "x" / "c.0.1.0", path / HIDDEN / "block-000001"
    chunk.unlink()
    for finished in (1, 0):
        edit_attributes(path, archive_finished=finished)
        with refused(ValueError, "is missing"):
            _ = co.open_archive(path).x
    marker.unlink()
    found = co.open_archive(path)
    for x in (found.x, found.to_xarray()["x"].values):
        assert np.isfinite(x[:, :2]).all() and np.isnan(x[:, 2]).all()
    assert np.array_equal(co.resume(path).x, co.integrate(BODY, x0, SPAN, STEP).x)


def test_state_of_another_shape_is_refused(run):
    """With a matching digest, as of another run."""
    path, _ = run
    root = (path / ROOT).read_text()
    states = json.loads(json.loads(root)["attributes"]["archive_states"])
    file, _, about = states[-1]
    content = (path / HIDDEN / file).read_bytes()
    with np.load(io.BytesIO(content)) as held:
        numbers = dict(held)
    checked = [name for name in numbers if name != "block" and not name.startswith("undefined")]
    for name, values in ((name, numbers[name]) for name in checked):
        for other in (values[..., None], np.stack([values, values])):
            written = io.BytesIO()
            np.savez(written, **{**numbers, name: other})
            (path / HIDDEN / file).write_bytes(written.getvalue())
            digest = hashlib.sha256(written.getvalue()).hexdigest()
            changed = json.dumps([*states[:-1], [file, digest, about]])
            edit_attributes(path, archive_states=changed)
            with refused(ValueError, "run.zarr"):
                co.resume(path)
    (path / HIDDEN / file).write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    (path / ROOT).write_text(root)
    with refused(ValueError, file, "checksum"):
        co.resume(path)


# Contradictions in the metadata.

FILL = {"float64": "NaN", "int64": 0, "bool": False, "string": ""}


def array(name, kind=None, dims=None, shape=None, chunk=None, **more):
    """Change the type, dimensions, shape or other metadata of an array."""

    def change(_, arrays):
        found = arrays[name]
        if kind:
            found.update(data_type=kind, fill_value=FILL.get(kind, 0))
        if dims:
            found["dimension_names"] = list(dims)
        if shape:
            grid, first = found["chunk_grid"]["configuration"], (dims or found["dimension_names"])[0]
            held = [grid["chunk_shape"][0]] if first == "time" else [max(1, shape[0])]
            found["shape"], grid["chunk_shape"] = list(shape), [*held, *(max(1, size) for size in shape[1:])]
        if chunk:
            found["chunk_grid"]["configuration"]["chunk_shape"] = list(chunk)
        found.update(more)

    return change


def attributes(**kwargs):
    return lambda found, arrays: found.update(kwargs)


def without(name):
    return lambda found, arrays: arrays.pop(name)


def rows(count):
    """Change the length of all arrays over time."""

    def change(_, arrays):
        for found in arrays.values():
            if found.get("dimension_names", ("",))[0] == "time":
                found["shape"][0] = count

    return change


def states(change):
    return lambda found, _: found.update(archive_states=json.dumps(change(json.loads(found["archive_states"]))))


def state(**kwargs):
    return states(lambda found: [*found[:-1], [*found[-1][:2], {**found[-1][2], **kwargs}]])


def all_of(*changes):
    return lambda found, arrays: [change(found, arrays) for change in changes] and None


FAILED = {"run_failed": 1, "failed_step": 3, "failed_time": 0.5, "failed_residual": 0.25, "failed_reason": "overflow"}
CASES = [
    *(
        ("vector", attributes(**{name: value}), (name,))
        for name, value in [
            ("seconds", -0.5), ("seconds", float("nan")), ("steps", 31), ("t_span", "[7.0, 3.0, 1.0]"),
            ("save_every", 0), ("archive_save_every", 0), ("watch", 2), ("evaluations", -1), ("iterations", 0.5),
            ("platform", 3), ("system_repr", 3), ("archive_first_step", 3), ("archive_finished", 2),
            ("steps", 10**400), ("archive_accounts", "[" * 10**5), ("archive_given", '{"system": {"named": [3]}}'),
            ("archive_observed", '{"names": [3], "stored": {}}'), ("archive_observed", '{"names": [], "stored": []}'),
        ]
    ),
    *(
        ("vector", attributes(**{name: value}), ())
        for name in (
            "system", "method", "t_span", "step", "steps", "archive_states", "archive_given", "archive_observed",
        )
        for value in (None, "{", 3)
    ),
    *(
        ("vector", attributes(**FAILED | {name: value}), (name, value))
        for name, value in [
            ("failed_time", True), ("failed_residual", True), ("failed_reason", 3), ("failed_step", 0.5),
            ("run_failed", 2),
        ]
    ),
    ("vector", attributes(step=0.25), ("steps is 32",)),
    ("vector", attributes(archive_steps=33), ("steps",)),
    ("vector", attributes(archive_steps=14), ("list of states",)),
    ("blocks", attributes(archive_steps=33), ("steps is 32",)),
    ("blocks", attributes(archive_steps=31), ("archive_steps is 31",)),
    ("blocks", attributes(archive_block=0), ("archive_block is 0",)),
    ("vector", attributes(archive_format=3), ("format 3", "later version")),
    ("blocks", attributes(archive_format=3), ("format 3", "later version")),
    *(("vector", attributes(archive_format=version), ("archive_format",)) for version in ("1", True, 0, -1, 1.0, None)),
    *(("vector", without(name), (name, "missing")) for name in
      ("time", "x", "x0", "energy", "invariant", "tenth", "drift")),
    *(("backward", without(name), (name, "missing")) for name in ("work", "change", "balance")),
    ("blocks", without("status"), ("array over the members",)),
    ("vector", attributes(archive_accounts='[["damping", "energy"]]'), ("balance", "missing")),
    ("backward", attributes(archive_accounts='[["damping", "energy"]]'), ("contradicts",)),
    ("backward", attributes(archive_accounts='[["damping"]]'), ("archive_accounts",)),
    *(("backward", array(name, "int64"), (name,)) for name in
      ("time", "x", "x0", "energy", "work", "change", "balance", "casimir_x_2", "failed", "invariant")),
    ("vector", array("drift", "int64"), ("drift", "int64")),
    ("vector", array("tenth", "float64"), ("tenth", "float64")),
    ("blocks", array("status", "float64"), ("status", "float64")),
    ("vector", array("x", "object"), ("damaged",)),
    ("vector", array("casimir_x_2", attributes={}), ("casimir_x_2", "long_name")),
    ("vector", array("casimir_x_2", attributes={"long_name": 3}), ("casimir_x_2", "long_name")),
    ("vector", array("x0", dims=("time",), shape=(3,)), ("time",)),
    ("vector", array("x", dims=("row", "component"), shape=(7, 3)), ("x", "row")),
    ("vector", array("x", shape=(7, 4)), ("component",)),
    ("vector", array("x", shape=(7, 2**40), chunk=(1024, 3)), ("component",)),
    ("vector", array("x", shape=(2**40, 3)), ("time",)),
    ("vector", array("x", dims=("time", "row")), ("over other dimensions",)),
    ("vector", array("energy", dims=("time", "component"), shape=(7, 3)), ("over other dimensions",)),
    ("backward", array("energy", dims=("time",), shape=(7,)), ("over other dimensions",)),
    ("matrices", array("x", shape=(33, 3, 4, 2), chunk=(64, 3, 4, 2)), ("x and x0",)),
    ("matrices", all_of(array("x", shape=(33, 3, 3, 3), chunk=(64, 3, 3, 3)), array("x0", shape=(3, 3, 3)),
                        array("part", shape=(3,))),
     ("contradicts",)),
    *(("vector", array("x", **changed), ("metadata in zarr.json is damaged",)) for changed in
      ({"dims": ("time", "a b")}, {"dims": ("time", 3)}, {"shape": (7, 3), "chunk": (1024,)}, {"chunk": (0, 3)},
       {"chunk": (8, 0)}, {"chunk": (8, 4)}, {"chunk": (2**16 + 1, 1)}, {"dimension_names": []})),
    *(("vector", array("x", **{"shape": [7, size]} | {"chunk": (1024, 3)}), ()) for size in (-1, True, 3.0, 2**62 + 1)),
    ("vector", lambda _, arrays: arrays["x"]["codecs"].insert(1, {"name": "gzip"}), ("damaged",)),
    ("vector", all_of(rows(6), state(time=6)), ("6 saved points", "not 7")),
    ("vector", all_of(rows(8), state(time=8)), ("8 saved points", "not 7")),
    ("vector", all_of(rows(8), state(time=8), attributes(**FAILED)), ("8 saved points", "not 7")),
    ("vector", rows(6), ("list of states",)),
    ("vector", state(number=12), ("list of states",)),
    ("vector", states(lambda found: []), ("list of states",)),
    ("vector", states(lambda found: [[*found[-1][:2], {**found[-1][2], "number": n}] for n in (9, 5, 13)]),
     ("list of states",)),
    ("vector", state(block=2), ("block",)),
    ("vector", state(time=-1), ("time",)),
    ("vector", states(lambda found: [[3, *found[-1][1:]]]), ("archive_states",)),
    *(("vector", states(lambda found, name=name: [[name, *found[-1][1:]]]), ()) for name in
      ("lock", "../x/c.0.0", "state-/../lock", "/etc/hostname", "state-\0", "state-a/b", "", "x/state-a")),
    ("blocks", rows(32), ("32 saved points", "not 33")),
]  # fmt: skip


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("name", "change", "named"), CASES, ids=[f"{k} {c[0]}" for k, c in enumerate(CASES)])
def test_contradiction_is_named(base, tmp_path, name, change, named):
    path = tmp_path / "run.zarr"
    # Links to the data, which are refused: the metadata are checked before they are read.
    shutil.copytree(base / name, path, copy_function=os.link)
    text = (path / ROOT).read_text()
    (path / ROOT).unlink()
    (path / ROOT).write_text(text)
    co.open_archive(path)
    edit_root(path, change)
    with pytest.raises((ValueError, TypeError)) as error:
        co.open_archive(path)
        co.resume(path)
    message = str(error.value)
    assert all(str(text) in message for text in named) and "\n" not in message and "run.zarr" in message, (
        message,
        named,
    )


def test_failed_run_may_have_points_before_the_failure(base, tmp_path):
    shutil.copytree(base / "vector", tmp_path / "run.zarr")
    edit_root(tmp_path / "run.zarr", all_of(rows(6), state(time=6), attributes(**FAILED)))
    assert co.open_archive(tmp_path / "run.zarr").reached == 13  # with fewer points it is refused, if it has not failed


@pytest.mark.parametrize(
    "content",
    [
        b"{",
        b"[1]",
        b"",
        b'{"attributes": {}, "consolidated_metadata": {"metadata": {}}}',
        b'{"attributes": {}, "attributes": {"archive_format": 1}, "consolidated_metadata": {"metadata": {}}}',
        b'{"attributes": {"archive_format": 1}, "consolidated_metadata": {"metadata": {"x": {}}}}',
        None,
    ],
)
def test_other_folders_are_no_archives(tmp_path, content):
    if content is not None:
        (tmp_path / ROOT).write_bytes(content)
    for call in (co.open_archive, co.resume):
        with refused(ValueError, tmp_path):
            call(tmp_path)
