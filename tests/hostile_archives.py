"""Random changes of archives, as an untrusted sender could make them: metadata, chunks, states and links."""

from __future__ import annotations

import copy
import hashlib
import io
import json
import os
import random
import shutil
from contextlib import suppress
from math import inf, nan
from pathlib import Path

import google_crc32c
import numpy as np
from numcodecs import Blosc

import coadjoint as co

BODY, X = co.systems.rigid_body(inertia=(1, 2, 2.5)), (0.3, -1.0, 0.7)
SPAN, STEP = (0.0, 4.0), 0.125
METHOD = co.GaussLegendre(2)
ROOT, HIDDEN = "zarr.json", ".coadjoint"


def sign(root):
    """Give a root the checksum that the page on archives defines, as anybody can."""
    root["attributes"].pop("archive_sha256", None)
    content = {"attributes": root["attributes"], "metadata": root["consolidated_metadata"]["metadata"]}
    root["attributes"]["archive_sha256"] = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def edit_root(path, change):
    """Change attributes and arrays of an archive, with a matching checksum."""
    root = json.loads((path / ROOT).read_text())
    change(root["attributes"], root["consolidated_metadata"]["metadata"])
    sign(root)
    (path / ROOT).write_text(json.dumps(root))


def edit_attributes(path, **attributes):
    edit_root(path, lambda found, _: found.update(attributes))


def write_marker(archive, number, head, raw):
    """Write the marker of a block, with a matching checksum."""
    run = json.loads((archive / ROOT).read_text())["attributes"]["archive_run"]
    name = f"block-{number:06d}"
    digest = hashlib.sha256(f"{run} {name} {head}".encode("utf-8", "surrogatepass")).hexdigest()
    (archive / HIDDEN / name).write_bytes(f"{digest} {head}\n".encode("utf-8", "surrogatepass") + raw)


def nested_lists(depth):
    value = []
    for _ in range(depth):
        value = [value]
    return value


STRANGE = (
    None, True, False, -1, 0, 1, 3, 2.5, 1e308, inf, -inf, nan, 2**31, 2**63, 10**30, 10**400, "", ".", "..", "/",
    "../outside/kept", "../../outside", "x/../../outside", "zarr.json", ".coadjoint", ".coadjoint/lock", "a\0b",
    "x" * 5000, "x" * 255, "\ud800", "é", "con", "-1", "NaN", "[]", "{}", "[[", "1e999", "9" * 5000, [], {}, [1], ["x"],
    [[]], [-1],
    [2**62], [10**30, 1], [0], [1.0, nan], {"x": 1}, {"name": "pickle"}, {"name": "gzip"}, nested_lists(20),
    nested_lists(150),
    [["a", "b", {}]], [["state-..npz", "0", {"number": 0, "time": 1, "block": 1}]], "float32", "object",
    "string", "int64",
)  # fmt: skip
"""Replacement values for entries of the metadata, some of them paths to the folder beside the archive."""


def outside_names(outside):
    """Return names that lead out of the archive, one of each kind."""
    return (str(outside), f"{outside}/kept", f"../{outside.name}", f"../{outside.name}/kept", f"x/../../{outside.name}")


def begin(path, system=BODY, x0=X, method=METHOD, *, end=SPAN[1], until=13, **options):
    """Write the archive of a run that stopped at a step."""
    sense = 1 if end > SPAN[0] else -1
    co.integrate(system, x0, (SPAN[0], SPAN[0] + 2 * sense * STEP), STEP, method, save_every=2, archive=path, **options)
    return co.resume(path, end, until=until)


def archives(folder):
    """Write unfinished archives of each kind and a finished one; return their names."""
    folder.mkdir()
    damped = BODY.with_forces(co.forces.LinearDamping(0.125))
    runs = {
        "vector": (BODY, X, co.GaussLegendre(2), {"attitude": "coadjoint"}),
        "members": (damped, np.multiply.outer([1.0, 0.5], X), co.GaussLegendre(1), {"observe": {"q": POLYNOMIAL}}),
    }
    for name, (system, x0, method, options) in runs.items():
        begin(folder / name, system, x0, method, **options)
    co.integrate(BODY, X, SPAN, STEP, archive=folder / "finished")
    co.integrate_ensemble(
        BODY, np.multiply.outer([1.0, 0.5, 0.2], X), SPAN, STEP, archive=folder / "blocks", members_per_block=2
    )
    (folder / "blocks" / HIDDEN / "block-000001").unlink()
    return [*runs, "finished", "blocks"]


REFUSALS = (ValueError, co.IntegrationError, OSError)
POLYNOMIAL = co.Polynomial({(1, 1, 0): 2.0})


def snapshot(folder):
    """Return names, content and times of everything in a folder, without following links."""
    found = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        content = os.readlink(path) if path.is_symlink() else path.read_bytes() if path.is_file() else None
        found[str(path.relative_to(folder))] = (status.st_mtime_ns, status.st_mode, status.st_ino, content)
    return found


def entry_paths(value, path=()):
    """Yield the paths of all entries of lists and tables."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in inside:
        yield (*path, key)
        yield from entry_paths(entry, (*path, key))


def changed(tree, rng, strange):
    """Return metadata with an entry deleted, exchanged, renamed or replaced, also within JSON texts."""
    tree = copy.deepcopy(tree)
    *path, last = rng.choice(list(entry_paths(tree)))
    within = tree
    for key in path:
        within = within[key]
    held = within[last]
    kind = rng.choice(["delete", "strange", "strange", "strange", "rename", "swap", "inner", "inner"])
    if kind == "inner" and isinstance(held, str) and held[:1] in "[{":
        try:
            inner = [json.loads(held)]
            within[last] = json.dumps(changed(inner, rng, strange)[0])
        except (ValueError, LookupError):
            within[last] = held[: len(held) // 2]
    elif kind == "delete":
        del within[last]
    elif kind == "rename" and isinstance(within, dict):
        within[str(rng.choice([one for one in strange if isinstance(one, str)]))] = within.pop(last)
    elif kind == "swap":
        *other, key = rng.choice(list(entry_paths(tree)))
        there = tree
        for step in other:
            there = there[step]
        within[last] = copy.deepcopy(there[key])
    else:
        within[last] = copy.deepcopy(rng.choice(strange))
    return tree


def changed_text(text, rng):
    """Return the text of metadata cut, doubled, not in UTF-8, or with a duplicate key."""
    at = rng.randrange(len(text))
    return rng.choice(
        [
            text[:at],
            text[:at] + bytes([rng.randrange(256)]) + text[at + 1 :],
            text + text,
            b"[" * 10**5,
            b"\xff\xfe" + text,
            text.replace(b'"attributes"', b'"attributes": {}, "attributes"', 1),
            text.replace(b": 0", b": " + b"9" * 5000, 1),
            b"",
        ]
    )


def change_metadata(archive, rng, outside):
    """Change the root, the metadata of an array, or the marker of a block."""
    strange = (*STRANGE, *outside_names(outside))
    markers = sorted((archive / HIDDEN).glob("block-??????"))
    if markers and rng.random() < 0.3:
        marker = rng.choice(markers)
        line, _, raw = marker.read_bytes().partition(b"\n")
        head = json.dumps(changed(json.loads(line.partition(b" ")[2]), rng, strange))
        write_marker(archive, int(marker.name[-6:]), head, raw)
        return
    root = archive / ROOT
    if rng.random() < 0.1:
        root.write_bytes(changed_text(root.read_bytes(), rng))
    else:
        tree = json.loads(root.read_text())
        for _ in range(rng.choice([1, 1, 1, 2, 5])):
            tree = changed(tree, rng, strange)
        with suppress(LookupError, TypeError, AttributeError):  # a root without attributes or metadata
            sign(tree)
        root.write_text(json.dumps(tree))


def hostile_chunk(raw, rng):
    """Return a changed chunk, mostly with a matching checksum."""
    body = bytearray(raw[:-4])
    kind = rng.choice(["flip", "flip", "cut", "header", "bomb", "longer", "random", "empty", "texts", "numbers"])
    if kind == "flip":
        for _ in range(rng.choice([1, 3, 20])):
            body[rng.randrange(len(body))] = rng.randrange(256)
    elif kind == "cut":
        del body[rng.randrange(len(body)) :]
    elif kind == "header":
        at = rng.choice([0, 1, 2, 3, 4, 8, 12])
        body[at : at + 4] = rng.choice([0, 1, 2**31 - 1, 2**31, 2**32 - 1, len(body)]).to_bytes(4, "little")
    elif kind == "bomb":
        body = bytearray(BOMB)
    elif kind == "longer":
        body += bytes(rng.randrange(1, 10**5))
    elif kind == "random":
        body = bytearray(rng.randbytes(rng.randrange(1, 1000)))
    elif kind == "texts":
        body = bytearray((2**31 - 1).to_bytes(4, "little") + b"\3\0\0\0abc")
    elif kind == "numbers":
        body = bytearray(
            Blosc("zstd", 3, Blosc.SHUFFLE).encode(np.full(rng.randrange(1, 5000), rng.choice([nan, 1e308])))
        )
    else:
        body = bytearray()
    total = google_crc32c.value(bytes(body)) if rng.random() < 0.9 else 0
    return bytes(body) + int(total).to_bytes(4, "little")


BOMB = Blosc("zstd", 9, Blosc.SHUFFLE).encode(np.zeros(2**25, dtype=np.int8))
"""32 MB of zeros in a few kilobytes; a header may claim 2 GB."""


def change_state(archive, rng):
    """Change the state from which the run continues, and its digest accordingly."""
    root = json.loads((archive / ROOT).read_text())
    states = json.loads(root["attributes"]["archive_states"])
    file, _, about = states[-1]
    with np.load(archive / HIDDEN / file) as held:
        numbers = {name: held[name] for name in held.files}
    name = rng.choice(sorted(numbers))
    kind, content = rng.choice(["strange", "shape", "compressed", "cut", "drop", "pickle", "header"]), io.BytesIO()
    if kind == "strange":
        number = rng.choice([nan, inf, 1e308, -1, 10**6])
        numbers[name] = np.full_like(
            numbers[name],
            number if numbers[name].dtype.kind == "f" else int(min(abs(number), 9)) if number == number else 7,
        )
    elif kind == "shape":
        numbers[name] = rng.choice(
            [np.zeros((2, 3)), np.zeros(0), numbers[name].ravel(), numbers[name].astype(np.float32)]
        )
    elif kind == "drop":
        del numbers[name]
    elif kind == "pickle":
        numbers[name] = np.array([Sentinel()], dtype=object)
    (np.savez_compressed if kind == "compressed" else np.savez)(content, **numbers)
    raw = content.getvalue()
    if kind == "cut":
        raw = raw[: rng.randrange(len(raw))]
    elif kind == "header":
        raw = (
            raw.replace(b"'shape': (", b"'shape': (99999999999, ", 1)
            if rng.random() < 0.5
            else raw.replace(b"<f8", b"|O8")
        )
    (archive / HIDDEN / file).write_bytes(raw)
    states[-1] = [file, hashlib.sha256(raw).hexdigest(), about]
    edit_attributes(archive, archive_states=json.dumps(states))


class Sentinel:
    """Object that records when it is unpickled."""

    unpickled = False

    def __reduce__(self):
        return setattr, (Sentinel, "unpickled", True)


def put_link(archive, rng, outside):
    """Replace a file or folder, or a file to be written, by a symbolic link."""
    files = sorted(path.relative_to(archive) for path in archive.rglob("*"))
    name = rng.choice(files)
    if rng.random() < 0.4:
        name = rng.choice([name.with_name(f".{name.name}.writing"), Path("x/c.1.0"), Path(HIDDEN, "block-000001.lock")])
    path = archive / name
    if path.is_dir() and not path.is_symlink():
        shutil.move(path, outside / f"moved-{name.name}")
        path.symlink_to(outside / f"moved-{name.name}")
        return
    path.unlink(missing_ok=True)
    path.parent.mkdir(exist_ok=True)
    kind = rng.choice(["kept", "kept", "new", "folder", "fifo"])
    if kind == "fifo":
        os.mkfifo(path)
    else:
        path.symlink_to({"kept": outside / "kept", "new": outside / "new", "folder": outside}[kind])


def change(archive, kind, rng, outside):
    """Make a random change of one kind."""
    if kind == "metadata":
        change_metadata(archive, rng, outside)
    elif kind == "chunk":
        file = rng.choice(sorted(archive.rglob("c.*")))
        file.write_bytes(hostile_chunk(file.read_bytes(), rng))
    elif kind == "state":
        change_state(archive, rng)
    else:
        put_link(archive, rng, outside)


def use(archive, name):
    """Yield the operations of a user on an archive."""
    found = co.open_archive(archive)
    yield from (
        lambda: [found.x, found.t, found.energy, dict(found.casimirs), dict(found.observed), found.work],
        lambda: found.attitude,
        lambda: [repr(found), found.stats, found.change(), found.initial, found.finished, found.reached, found.failed],
        lambda: [found.system, found.method, found.x0],
        lambda: found.to_xarray().load(),
    )
    yield lambda: co.load(archive)
    if name == "blocks":
        yield lambda: co.resume(archive)
        yield lambda: co.integrate_ensemble(BODY, np.multiply.outer([1.0, 0.5, 0.2], X), SPAN, STEP, archive=archive)
    else:
        yield lambda: co.resume(archive, until=20)
        yield lambda: co.resume(archive, 5.0, until=20)


def outcomes(archive, name):
    """Return the refusals of all operations; other exceptions are raised."""
    refused = []

    def tried(operation):
        try:
            return operation()
        except REFUSALS as reason:
            refused.append(reason)

    uses = tried(lambda: list(use(archive, name)))
    # If it cannot be opened, the other uses cannot be named.
    for each in uses or (lambda: co.load(archive), lambda: co.resume(archive, until=20)):
        tried(each)
    return refused


def attacked(base, folder, name, kind, seed):
    """Attack a copy of an archive; return a description of the failure, or an empty string."""
    rng = random.Random(f"{name} {kind} {seed}")
    shutil.rmtree(folder, ignore_errors=True)
    outside = folder / "outside"
    outside.mkdir(parents=True)
    (outside / "kept").write_bytes(b"a file of the user")
    (outside / "folder").mkdir()
    (outside / "folder" / "kept").write_bytes(b"another one")
    shutil.copytree(base / name, folder / "in" / "run", symlinks=True)
    change(folder / "in" / "run", kind, rng, outside)
    before = snapshot(outside)
    try:
        refused = outcomes(folder / "in" / "run", name)
    except Exception as wrong:
        return f"{type(wrong).__name__}: {wrong}"
    names = os.listdir(folder / "in"), set(os.listdir(folder))
    if snapshot(outside) != before or names != (["run"], {"in", "outside"}):
        return "something outside of the archive has changed"
    if Sentinel.unpickled:
        return "an object was unpickled"
    for reason in refused:
        text = str(reason)
        if "\n" in text or not text.isprintable() or not 10 < len(text) <= 1000:
            return f"no sentence: {text!r}"
    return ""
