"""Which numbers does a given matrix have, and is it symmetric? Dense and sparse matrices, read entry by entry."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.joins import distinct
from coadjoint.systems.points import UNIT_ROUNDOFF


def real_array(given: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    """Return a copy as float64, or as it is where it holds fractions; refuse what is not a finite real number."""
    array = np.array(given)
    if array.dtype.kind not in "biufO":
        raise TypeError(f"{name} has numbers of type {array.dtype}; give real numbers")
    try:
        floats = array.astype(np.float64)
    except (TypeError, ValueError) as reason:
        raise TypeError(f"{name} has an entry that is not a real number ({reason}); give real numbers") from None
    _check_finite(floats, np.argwhere(~np.isfinite(floats)), name)
    return array if array.dtype == object else floats


def _check_finite(values: npt.NDArray[np.float64], bad: npt.NDArray[Any], name: str) -> None:
    if len(bad):
        where = ", ".join(str(int(i)) for i in bad[0])
        place = f"{name}[{where}]" if where else name
        raise ValueError(f"{place} is {values[tuple(bad[0])]}; give finite numbers")


def sparse_entries(M: Any) -> tuple[int, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Return n and the rows, columns and values of a SciPy sparse matrix, without importing SciPy."""
    if M.ndim != 2 or M.shape[0] != M.shape[1]:
        raise ValueError(f"M has shape {M.shape}; give a symmetric (n, n)")
    csr = M.tocsr().copy()
    csr.sum_duplicates()
    if csr.dtype.kind not in "biuf":
        raise TypeError(f"M has numbers of type {csr.dtype}; give real numbers")
    n, entries = int(M.shape[0]), csr.data.astype(np.float64)
    rows = np.repeat(np.arange(n, dtype=np.int64), np.diff(csr.indptr))
    bad = np.flatnonzero(~np.isfinite(entries))
    if bad.size:
        raise ValueError(f"M[{rows[bad[0]]}, {csr.indices[bad[0]]}] is {entries[bad[0]]}; give finite numbers")
    return n, rows, csr.indices, entries


def check_symmetric(n: int, rows: npt.NDArray[Any], columns: npt.NDArray[Any], values: npt.NDArray[Any]) -> None:
    """Refuse an asymmetry beyond 64 u of the largest entry, the round-off of a computed symmetric matrix."""
    above, below = rows < columns, rows > columns
    upper, lower = rows[above] * n + columns[above], columns[below] * n + rows[below]
    places = distinct(np.concatenate([upper, lower]))
    first, second = np.zeros(places.size), np.zeros(places.size)
    first[np.searchsorted(places, upper)] = values[above]
    second[np.searchsorted(places, lower)] = values[below]
    bad = np.flatnonzero(np.abs(first - second) > 64 * UNIT_ROUNDOFF * np.abs(values).max(initial=0.0))
    if bad.size:
        i, j = divmod(int(places[bad[0]]), n)
        raise ValueError(
            f"M is not symmetric: M[{i}, {j}] = {first[bad[0]]:g} but M[{j}, {i}] = {second[bad[0]]:g}; "
            "give both the same value"
        )
