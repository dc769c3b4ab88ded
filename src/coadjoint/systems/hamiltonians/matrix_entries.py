"""Entries of quadratic Hamiltonians: from arrays, sparse matrices and polynomials, with the check of symmetry."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.exact.sparse_sums import distinct
from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.validation import REAL_KINDS, read_finite, to_array

BYTES_PER_ENTRY = 100  # peak, while entries are sorted and compared with the transposed ones
SPARSE = "give a sparse matrix, or a diagonal"


class Entries(NamedTuple):
    """The entries of a quadratic Hamiltonian: rows, columns and values of M, and the linear part."""

    rows: npt.NDArray[np.int64]
    columns: npt.NDArray[np.int64]
    entries: npt.NDArray[Any]
    linear: npt.NDArray[Any]


def entries_of_polynomial(polynomial: Polynomial) -> tuple[Entries, Any]:
    """Return the entries of a polynomial of degree at most two, with its coefficients unchanged, and the constant."""
    n = polynomial.dim
    exact = not all(isinstance(c, float) for c in polynomial.monomials.values())
    kind: Any = object if exact else np.float64
    linear = np.full(n, 0, dtype=kind)
    constant: Any = 0.0
    rows: list[int] = []
    columns: list[int] = []
    entries: list[Any] = []
    for exponents, coefficient in polynomial.monomials.items():
        factors = factors_of(exponents)
        if len(factors) == 2:
            i, j = factors
            rows += [i] if i == j else [i, j]
            columns += [i] if i == j else [j, i]
            entries += [2 * coefficient] if i == j else [coefficient, coefficient]
        elif len(factors) == 1:
            linear[factors[0]] = coefficient
        else:
            constant = coefficient
    packed = np.empty(len(entries), dtype=kind)
    packed[:] = entries
    return Entries(np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64), packed, linear), constant


def real_array(argument: npt.ArrayLike, name: str) -> npt.NDArray[Any]:
    """Return a copy as float64, or as objects if it contains fractions; raise an error unless real and finite."""
    array = to_array(argument, name)
    check_available_memory(BYTES_PER_ENTRY * array.size, f"{name} of shape {array.shape}", SPARSE)
    floats = read_finite(array, name)
    if array.dtype != object:
        return floats
    exact = np.empty(array.shape, dtype=object)
    # NumPy integers in an array of objects would overflow silently.
    for index, entry in np.ndenumerate(array):
        exact[index] = entry.item() if isinstance(entry, np.generic) else entry
    return exact


def sparse_entries(M: Any) -> tuple[int, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], bool]:
    """Return n, rows, columns and values of a SciPy sparse matrix, sorted by rows, and whether it is symmetric."""
    if M.ndim != 2 or M.shape[0] != M.shape[1]:
        raise ValueError(f"M has shape {M.shape}; give a symmetric (n, n)")
    check_available_memory(BYTES_PER_ENTRY * M.nnz + 40 * M.shape[0], f"M of shape {M.shape}, with {M.nnz} entries,")
    csr = M.tocsr().copy()
    csr.sum_duplicates()
    csr.eliminate_zeros()
    if csr.dtype.kind not in REAL_KINDS:
        raise TypeError(f"M has numbers of type {csr.dtype}; give real numbers")
    n, entries = int(M.shape[0]), csr.data.astype(np.float64)
    rows = np.repeat(np.arange(n, dtype=np.int64), np.diff(csr.indptr))
    bad = np.flatnonzero(~np.isfinite(entries))
    if bad.size:
        raise ValueError(f"M[{rows[bad[0]]}, {csr.indices[bad[0]]}] is {entries[bad[0]]}; give finite numbers")
    transposed = csr.transpose().tocsr()
    pairs = ((transposed.indptr, csr.indptr), (transposed.indices, csr.indices), (transposed.data, csr.data))
    return n, rows, csr.indices, entries, all(np.array_equal(a, b) for a, b in pairs)


def check_symmetric(n: int, rows: npt.NDArray[Any], columns: npt.NDArray[Any], values: npt.NDArray[Any]) -> None:
    """Raise ValueError for asymmetry beyond 64 u of the largest entry, the round-off of a computed symmetric matrix."""
    above, below = rows < columns, rows > columns
    upper, lower = rows[above] * n + columns[above], columns[below] * n + rows[below]
    positions = distinct(np.concatenate([upper, lower]))
    first, second = np.zeros(positions.size), np.zeros(positions.size)
    first[np.searchsorted(positions, upper)] = values[above]
    second[np.searchsorted(positions, lower)] = values[below]
    bad = np.flatnonzero(np.abs(first - second) > 64 * UNIT_ROUNDOFF * np.abs(values).max(initial=0.0))
    if bad.size:
        i, j = divmod(int(positions[bad[0]]), n)
        raise ValueError(
            f"M is not symmetric: M[{i}, {j}] = {first[bad[0]]:g} but M[{j}, {i}] = {second[bad[0]]:g}; "
            "give both the same value"
        )
