"""Initial states of configuration files: numbers, or the name of a NumPy file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.system_checks import unforced

NPY_SUFFIX = ".npy"


def initial_state(system: Any, given: Any, folder: Path) -> Any:
    """Return the initial state or states as `integrate` takes them, from numbers or a file ``.npy``.

    Relative file names begin at `folder`. Entries of complex matrices may be pairs of real and imaginary part.

    Examples
    --------
    >>> from coadjoint.systems.fluids.sphere_euler import sphere_euler
    >>> initial_state(sphere_euler(N=2), [[[0, 1], [2, 0]], [[-2, 0], [0, -1]]], Path()).tolist()
    [[1j, (2+0j)], [(-2+0j), -1j]]
    """
    if isinstance(given, str):
        return array_of_file(folder / given, given)
    moved = unforced(system)
    if not (isinstance(moved, MatrixSystem) and moved.complex):
        return given
    array = np.array(given, dtype=np.float64)
    pairs = array.ndim > 2 and array.shape[-1] == 2 and array.shape[-3:-1] == moved.algebra.shape
    return array[..., 0] + 1j * array[..., 1] if pairs else array


def array_of_file(path: Path, named: str) -> NDArray[Any]:
    """Return the array of numbers in a file ``.npy``, without unpickling; errors refer to the file as `named`."""
    if path.suffix != NPY_SUFFIX:
        raise ValueError(f"{short(named)} is no state; give numbers, or the name of a file {NPY_SUFFIX}")
    try:
        size = path.stat().st_size
    except OSError as reason:
        raise ValueError(f"{short(named)} cannot be read ({getattr(reason, 'strerror', None) or reason})") from None
    check_available_memory(2 * size, f"the states in {short(named)}")
    try:
        found = np.load(path, allow_pickle=False)
    except (OSError, EOFError, ValueError, MemoryError):  # a header may declare more than the file has
        found = None
    if not isinstance(found, np.ndarray) or found.dtype.kind not in "iufc":
        raise ValueError(f"{short(named)} holds no array of numbers")
    return found
