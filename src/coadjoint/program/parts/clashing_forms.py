"""Fast test for noncommuting pairs of long linear forms, by single components of their brackets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Floats, Integers
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.sparse_rows import order_by, starts_of
from coadjoint.rounding import UNIT_ROUNDOFF

# A bracket of two forms counts as zero below this relative size (round-off of its products).
BRACKET_ROUNDOFF = 16 * UNIT_ROUNDOFF
# Cost of sorting one product, in multiplications of a dense matrix product.
COST_RATIO = 32


def surely_noncommuting(
    forms: Floats, algebra: LieAlgebra, first: Integers, second: Integers, costs: Integers
) -> NDArray[np.bool_]:
    """Test pairs of dense forms, shape (forms, n), for a bracket component that is nonzero far beyond rounding.

    For unrelated long forms one or two components suffice; pairs not decided here need the sum of all products. `costs`
    has the number of products in each bracket. A component counts as nonzero only if this holds for two summation
    orders, so the result is the same on every machine.
    """
    size = forms.shape[1]
    i, j, k, c = algebra.triples
    order = order_by(k)
    i, j, c = i[order], j[order], c[order]
    count = np.bincount(k, minlength=size)
    start = starts_of(count)
    found = np.zeros(len(first), dtype=bool)
    left = np.arange(len(first))
    # Components with the most products decide the most pairs. A sum of m products has an error below m round-offs.
    for component in np.argsort(-count, kind="stable").tolist():
        own = slice(start[component], start[component + 1])
        products = 4 * count[component] * len(forms) ** 2
        if not products or COST_RATIO * int(costs[left].sum()) < products:
            break
        one, other = c[own] * forms[:, i[own]], forms[:, j[own]]
        half, size_of_half = one @ other.T, np.abs(one) @ np.abs(other).T
        bracket, bound = half - half.T, size_of_half + size_of_half.T
        sure = np.abs(bracket) > (BRACKET_ROUNDOFF + 8 * count[component] * UNIT_ROUNDOFF) * bound
        told = sure[first[left], second[left]]
        found[left[told]] = True
        left = left[~told]
    return found
