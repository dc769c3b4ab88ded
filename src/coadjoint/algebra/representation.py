"""Matrix representations: validation, invariant forms, intertwiners with the coadjoint action."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples, triple_name
from coadjoint.algebra.exact.sparse_sums import (
    DEFECT_FACTOR,
    Floats,
    Integers,
    chunks,
    expand,
    group_max_abs,
    groups,
    largest_violation,
)
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.validation import read_numbers

REDUCED_ROWS = 1 << 12  # equations reduced to triangular form at a time


def read_representation(representation: Any, dim: int | None = None) -> Floats:
    """Validate the matrices of a representation and return a float64 copy, shape (n, d, d)."""
    rho = read_numbers(representation, "representation")
    if rho.ndim != 3 or rho.shape[1] != rho.shape[2] or 0 in rho.shape or dim not in (None, rho.shape[0]):
        count = "n" if dim is None else dim
        raise ValueError(
            f"representation must have shape ({count}, d, d), one matrix per basis element, not {rho.shape}"
        )
    wrong = np.argwhere(~np.isfinite(rho))
    if wrong.size:
        i, a, b = wrong[0].tolist()
        raise ValueError(f"representation[{i}, {a}, {b}] is {rho[i, a, b]}; it must be finite")
    return rho


def check_representation(representation: Any, triples: Triples, dim: int, names: Sequence[str]) -> Floats:
    """Check [rho_i, rho_j] = sum_k c_ij^k rho_k for every pair; return a read-only float64 array (n, d, d)."""
    # Each entry must be below 64 u times the sum of the absolute values of its products (u = 2^-53).
    rho = read_representation(representation, dim)
    d = rho.shape[1]
    i, a, b = (index.astype(np.int64) for index in np.nonzero(rho))
    v = rho[i, a, b]
    v_size, c_size = group_max_abs(i, v), group_max_abs(triples.i * dim + triples.j, triples.c)
    by_row, _ = groups(a, i)
    by_column, _ = groups(b, i)
    row_key, column_key = (a * dim + i)[by_row], (b * dim + i)[by_column]
    # For i < j: rho_i rho_j is joined on the columns of rho_i, rho_j rho_i on its rows, c_ij^k rho_k on k.
    joins: list[tuple[Integers, Integers]] = []
    for key, middle in ((row_key, b), (column_key, a)):
        start = np.searchsorted(key, middle * dim + i, side="right")
        joins.append((start, np.maximum(np.searchsorted(key, (middle + 1) * dim), start)))
    structure = np.searchsorted(i, triples.k), np.searchsorted(i, triples.k, side="right")
    cost = sum(stop - start for start, stop in joins)
    per_element = np.bincount(i, weights=cost, minlength=dim).astype(np.float64)
    per_element += np.bincount(triples.i, weights=structure[1] - structure[0], minlength=dim)
    for part in chunks(np.arange(dim), per_element.astype(np.int64)):
        entries = slice(*np.searchsorted(i, [part.start, part.stop]))
        constant_rows = slice(*np.searchsorted(triples.i, [part.start, part.stop]))
        # p, q: entries of rho_i and rho_j in rho_i rho_j; r, s: in rho_j rho_i
        p, q = expand(joins[0][0][entries], joins[0][1][entries])
        p, q = p + entries.start, by_row[q]
        r, s = expand(joins[1][0][entries], joins[1][1][entries])
        r, s = r + entries.start, by_column[s]
        row, element = expand(structure[0][constant_rows], structure[1][constant_rows])
        row += constant_rows.start
        pair = [i[p] * dim + i[q], i[r] * dim + i[s], (triples.i * dim + triples.j)[row]]
        position = [a[p] * d + b[q], a[s] * d + b[r], a[element] * d + b[element]]
        keys = np.concatenate(pair), np.concatenate(position)
        factors = np.concatenate([v[p], -v[r], -triples.c[row]]), np.concatenate([v[q], v[s], v[element]])
        sizes = (
            np.concatenate([v_size[p], v_size[r], c_size[row]]),
            np.concatenate([v_size[q], v_size[s], v_size[element]]),
        )
        violation = largest_violation(keys, factors, sizes)
        if violation is not None:
            first, second = divmod(int(keys[0][violation[0]]), dim)
            entry = divmod(int(keys[1][violation[0]]), d)
            raise ValueError(
                f"representation violates the commutator of {triple_name((first, second), names)}: "
                f"[rho_i, rho_j] - sum_k c_ij^k rho_k has {violation[1]:.3g} at {entry}, where it must be zero"
            )
    rho.flags.writeable = False
    return rho


def _solutions(left: Floats, right: Floats) -> Floats:
    """Return a basis (r, m, d) of the matrices X with X right_i = left_i X for all i."""
    m, d = left.shape[1], right.shape[1]
    size = np.maximum(np.abs(left).max(axis=(1, 2)), np.abs(right).max(axis=(1, 2)))
    size = np.where(size > 0.0, size, 1.0)[:, None, None]  # equal weight for every i, independent of units
    left, right = left / size, right / size
    per_fold = max(1, REDUCED_ROWS // (m * d))
    folded = 8 * (m * d) ** 2 * (per_fold + 3)
    check_available_memory(folded, f"the analysis of a representation by {d} x {d} matrices")
    triangle: Floats = np.zeros((0, m * d))
    for begin in range(0, left.shape[0], per_fold):
        blocks = [
            np.kron(np.eye(m), r.T) - np.kron(l, np.eye(d))
            for l, r in zip(left[begin : begin + per_fold], right[begin : begin + per_fold], strict=True)
        ]
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, *blocks]), mode="r"))
    _, singular, basis = np.linalg.svd(triangle, full_matrices=True)
    tolerance = DEFECT_FACTOR * UNIT_ROUNDOFF * m * d * max(float(singular.max(initial=0.0)), UNIT_ROUNDOFF)
    rank = int(np.count_nonzero(singular > tolerance))
    return basis[rank:].reshape(-1, m, d)


def _generic_of_full_rank(basis: Floats) -> Floats | None:
    """Return a seeded random combination of full rank with largest entry 1, or None if all are singular."""
    if basis.shape[0] == 0:
        return None
    combination = np.tensordot(np.random.default_rng(0).standard_normal(basis.shape[0]), basis, axes=1)
    singular = np.linalg.svd(combination, compute_uv=False)
    m, d = combination.shape
    if m > d or singular[-1] <= DEFECT_FACTOR * UNIT_ROUNDOFF * m * d * singular[0]:
        return None
    return combination / combination.flat[np.argmax(np.abs(combination))]


def invariant_form(rho: Any) -> NDArray[np.float64] | None:
    """Find a nonsingular P with rho_i^T P + P rho_i = 0 for all i, a bilinear form that the group keeps; else None."""
    matrices = read_representation(rho)
    transposed = matrices.transpose(0, 2, 1)
    if np.array_equal(transposed, -matrices):
        return np.eye(matrices.shape[1])
    return _generic_of_full_rank(_solutions(-transposed, matrices))


def intertwiner(rho: Any, D: Any) -> NDArray[np.float64] | None:
    """Find T (m, d) of full row rank with T rho_i = D_i T for all i, rho (n, d, d) and D (n, m, m); else None."""
    matrices = read_representation(rho)
    actions = read_representation(D, matrices.shape[0])
    if actions.shape[1] > matrices.shape[1]:
        return None
    return _generic_of_full_rank(_solutions(actions, matrices))
