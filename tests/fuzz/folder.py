"""The folder of configuration runs: files that configurations may name, and snapshots of its content."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np


class Touching:
    """An object that creates a file when it is unpickled."""

    def __reduce__(self):
        return (open, ("pwned", "w"))


def make(outside):
    """Create and return the folder of a run inside of another one, with valid and invalid state files."""
    folder = outside / "work"
    (folder / "a").mkdir(parents=True)
    (folder / "folder.npy").mkdir()
    np.save(folder / "states.npy", [[1.0, 0.5, 0.2], [0.1, 1.0, 0.2]])
    np.save(outside / "states.npy", [[1.0, 0.5, 0.2]])
    np.save(folder / "matrices.npy", np.diag([1j, -1j, 0, 0, 0]))
    np.save(folder / "bool.npy", np.ones(3, dtype=bool))
    np.save(folder / "nan.npy", [1.0, np.nan, 2.0])
    np.save(folder / "objects.npy", np.array([Touching(), 1.0, 2.0], dtype=object), allow_pickle=True)
    (folder / "pickle.npy").write_bytes(pickle.dumps(Touching()))
    (folder / "text.npy").write_text("1.0 2.0 3.0")
    expected = (folder / "states.npy").read_bytes()
    (folder / "cut.npy").write_bytes(expected[:-9])
    huge = expected.replace(b"(2, 3)", b"(9" + b"0" * 12 + b", 3)").replace(b" " * 13, b"", 1)
    (folder / "huge.npy").write_bytes(huge)
    os.symlink("states.npy", folder / "link.npy")
    os.symlink("loop.npy", folder / "loop.npy")
    os.symlink(outside / "elsewhere", folder / "link")
    return folder


def snapshot(outside):
    """Return sizes and times of all files by name."""
    found = {}
    for place, folders, files in os.walk(outside):
        for name in (*folders, *files):
            path = Path(place, name)
            state = path.lstat()
            found[str(path.relative_to(outside))] = None if path.is_dir() else (state.st_size, state.st_mtime_ns)
    return found
