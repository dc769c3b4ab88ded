"""Files that users name, read without waiting for what is no file: a pipe or a device may never end."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short


def open_regular(path: str | Path) -> BinaryIO:
    """Open a file to read it; OSError if it is a pipe, a device or another special file."""
    file = open(path, "rb", opener=_without_waiting)
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is no regular file, such as a pipe", str(path))
    return file


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def content_of(path: Path, limit: int, what: str, factor: int = 1, advice: str = "") -> bytes:
    """Return the bytes of a regular file; ValueError above a limit, or if `factor` times its size is not available."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise ValueError(f"{path} has {size} bytes, and {what} at most {limit}{advice}")
        check_available_memory(factor * size, f"{path}, {what},")
        return file.read(limit)


def read_array_file(path: Path, named: str) -> NDArray[Any]:
    """Return the array of numbers in a file ``.npy``, without unpickling."""
    with open_regular(path) as file:
        check_available_memory(2 * os.fstat(file.fileno()).st_size, f"the array in {short(named)}")
        try:
            values = np.load(file, allow_pickle=False)
        except Exception:  # a damaged header raises arbitrary errors, also those of Python's parser and of zip files
            values = None
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "iufc":
        raise ValueError(f"{short(named)} holds no array of numbers; give a file of numpy.save")
    return values
