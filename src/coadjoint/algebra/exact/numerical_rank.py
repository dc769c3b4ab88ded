"""Ranks of floating-point matrices by singular values, accepted only if they leave a clear gap."""

from __future__ import annotations

import math

import numpy as np

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.components import connected, parts
from coadjoint.algebra.exact.sparse_sums import DEFECT_FACTOR, Floats
from coadjoint.rounding import UNIT_ROUNDOFF

MIN_RANK_GAP = 2.0**10  # the smallest nonzero singular value must exceed round-off by this factor


def rank_from_gap(singular: Floats, roundoff: float, what: str) -> int:
    """Return the number of nonzero singular values (descending), or raise a ValueError if there is no clear gap.

    Values up to `roundoff`, a bound of the spectral norm of the error, are zero; the others must exceed 2^10 times
    that.
    """
    rank = int(np.count_nonzero(singular > roundoff))
    if rank and singular[rank - 1] < MIN_RANK_GAP * roundoff:
        raise ValueError(
            f"the rank of {what} is not clear: its singular value {singular[rank - 1]:.3g} is neither round-off "
            f"(below {roundoff:.3g}) nor above {MIN_RANK_GAP * roundoff:.3g}; give constants that are rational or "
            "more exact"
        )
    return rank


def numerical_structure_rank(triples: Triples, dim: int) -> int:
    """Return the rank of J(x) at generic x by singular values, for constants known only to round-off.

    The largest rank at two seeded normally distributed random points, block by block. Constants are taken as exact to
    64 u times the largest of the block (u = 2^-53), as in the Jacobi check. ValueError without a clear gap.

    Examples
    --------
    >>> numerical_structure_rank(Triples(*np.array([[0, 0, 1], [1, 2, 2], [2, 1, 0]]), np.array([1.0, -1.0, 1.0])), 3)
    2
    """
    i, j, k, c = triples
    rng = np.random.default_rng(0)
    points = rng.standard_normal((2, dim))
    place = np.zeros(dim, dtype=np.int64)
    label = connected(dim, i, j)
    order = np.argsort(label[i], kind="stable")
    owner = label[i][order]
    total = 0
    for part in parts(label):
        if part.size == 1:
            continue
        place[part] = np.arange(part.size)
        at = order[slice(*np.searchsorted(owner, [part[0], part[0] + 1]))]
        ranks = []
        for x in points:
            matrix = np.zeros((part.size, part.size))
            np.add.at(matrix, (place[i[at]], place[j[at]]), c[at] * x[k[at]])
            matrix -= matrix.T.copy()
            # Frobenius norm for an error of 64 u max |c| in every constant
            size = float(np.abs(c[at]).max()) * math.sqrt(2.0) * float(np.linalg.norm(x[k[at]]))
            roundoff = DEFECT_FACTOR * UNIT_ROUNDOFF * size
            ranks.append(rank_from_gap(np.linalg.svd(matrix, compute_uv=False).astype(np.float64), roundoff, "J(x)"))
        total += max(ranks)
    return total
