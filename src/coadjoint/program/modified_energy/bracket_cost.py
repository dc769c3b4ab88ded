"""Cost estimate of a modified Hamiltonian: number of products of monomials in its brackets, from sparsity alone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import Rows

MAX_ESTIMATED_DIMENSION = 1500
"""Largest dimension for which products are counted. Larger systems are lattices, whose brackets are short."""
MAX_CUBIC_DIMENSION = 400
"""Largest dimension for which nested brackets are counted, which takes n^3 bytes."""
SAMPLED_PARTS = 6
"""Number of points along the parts at which the brackets are counted."""


def estimated_products(algebra: LieAlgebra, parts: Parts, highest: int) -> float:
    """Estimate a lower bound on the products of monomials in `sweep_logarithm`, from the sparsity pattern. Part p acts
    on the series R of the parts after it. Products up to h^3 are counted, few compared with those of higher powers up
    to `highest`. Returns 0 without an estimate: for parts that are not quadratic forms, and very large systems.
    """
    n = algebra.dim
    if highest < 2 or parts.nonlinear_shares or n > MAX_ESTIMATED_DIMENSION:
        return 0.0
    i, j, k, _ = algebra.triples
    acting = np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k])
    cubic = highest > 2 and n <= MAX_CUBIC_DIMENSION
    slopes = np.zeros((n, n), dtype=bool)  # slopes[i]: coordinates in dR_1/dx_i
    second = np.zeros((n, n, n) if cubic else 0, dtype=bool)  # second[m]: pairs that multiply x_m in R_2
    counts = np.zeros(n)  # counts[i]: monomials in dR_2/dx_i
    stride = max(1, len(parts) // SAMPLED_PARTS)
    total = 0.0
    angles = np.split(np.argsort(parts.part_of_angle, kind="stable"), np.cumsum(np.diff(parts.angle))[:-1])
    for number, p in enumerate(reversed(range(len(parts)))):
        length, pair_counts = slopes.sum(axis=1, dtype=float), np.zeros(n)
        if cubic and number % stride == 0:
            counts = _monomials_per_coordinate(second)
        for angle in angles[p].tolist():
            weights = _mask(parts.weights, angle, n)
            field, field_pattern = _field(acting, _mask(parts.forms, angle, n), weights, parts.offset[angle] != 0, n)
            total += float(field @ (length + counts))
            if cubic and np.any(length):
                pairs = _pairs(field_pattern, slopes)
                second[weights] |= pairs
                pair_counts += np.where(weights, pairs.sum() / 2, 0.0) + pairs.sum(axis=1) * weights.sum()
                total += float(field @ np.minimum(pair_counts, n * (n + 1) / 2))
        for angle in angles[p].tolist():
            form, weights = _mask(parts.forms, angle, n), _mask(parts.weights, angle, n)
            slopes |= (form[:, None] & weights) | (weights[:, None] & form)
    return total


def _mask(rows: Rows, row: int, n: int) -> NDArray[np.bool_]:
    mask = np.zeros(n, dtype=bool)
    mask[rows.coordinate[rows.start[row] : rows.start[row + 1]]] = True
    return mask


def _field(
    acting: tuple[Integers, Integers, Integers],
    form: NDArray[np.bool_],
    weights: NDArray[np.bool_],
    shifted: bool,
    n: int,
) -> tuple[NDArray[np.float64], Integers]:
    """Count the monomials in each component of the field of (form.x) (weights.x); and where it has x_k, as i n + k."""
    row, column, k = acting
    selected = form[column]
    field_pattern = np.unique(row[selected] * n + k[selected])
    component, coordinate = np.divmod(field_pattern, n)
    length = np.bincount(component, minlength=n).astype(float)
    overlap = np.bincount(component[weights[coordinate]], minlength=n)
    return length * (int(weights.sum()) + shifted) - overlap * (overlap - 1) / 2, field_pattern


def _pairs(field_pattern: Integers, slopes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the symmetric pattern of coordinate pairs in the products of the two linear factors of a bracket."""
    n = len(slopes)
    linear = np.zeros((n, n), dtype=np.float32)
    linear[np.divmod(field_pattern, n)] = 1.0
    pattern = (linear.T @ slopes.astype(np.float32)) > 0.0
    return np.asarray(pattern | pattern.T)


def _monomials_per_coordinate(second: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Count for each coordinate the monomials that contain it, in a cubic polynomial given by pairs."""
    n = len(second)
    counts = np.empty(n)
    for i in range(n):
        pairs = second[i] | second[:, i] | second[:, :, i]
        counts[i] = (np.count_nonzero(pairs | pairs.T) + np.count_nonzero(np.diagonal(pairs))) / 2
    return counts
