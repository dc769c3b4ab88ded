"""The h^2 term of all orders of the parts, as sums of the same brackets {A, {B, C}}."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.modified_energy.second_order import Floats, Samples
from coadjoint.program.parts.part import Parts

# Relative step of the central differences; brackets are smooth, so the relative error is about (2^-14)^2.
DIFFERENCE_STEP = 2.0**-14


class NestedBrackets:
    """Brackets {H_i, {H_j, H_k}}, j < k, of the pieces of at least two parts; {F, G} = (grad F)^T J(x) grad G."""

    def __init__(self, algebra: LieAlgebra, parts: Parts) -> None:
        self.algebra, self.parts = algebra, parts
        self.pairs = list(combinations(range(len(parts)), 2))

    def values(self, points: Floats, t: float = 0.0) -> Floats:
        """Return the brackets at points (k, n), shape (parts, pairs, k)."""
        samples = Samples([self.algebra], [self.parts], points, t)
        j, k = np.array(self.pairs).T
        return samples.nested_brackets(j, k)

    def gradients(self, points: Floats, t: float = 0.0) -> Floats:
        """Return the gradients at points (k, n), shape (parts, pairs, k, n), by central differences."""
        size = np.max(np.abs(points), axis=1, keepdims=True)
        nudge = DIFFERENCE_STEP * np.where(size > 0.0, size, 1.0)
        columns = []
        for i in range(points.shape[1]):
            ahead, behind = points.copy(), points.copy()
            ahead[:, i : i + 1] += nudge
            behind[:, i : i + 1] -= nudge
            columns.append((self.values(ahead, t) - self.values(behind, t)) / (ahead - behind)[:, i])
        return np.stack(columns, axis=-1)

    def weights(self, order: Sequence[int]) -> Floats:
        """Return the coefficients of the brackets in H2, shape (parts, pairs), for an order of a forward sweep.

        A part A followed by the sum D of all later ones contributes -{A, {A, D}}/24 + {D, {D, A}}/12.
        """
        place = {pair: number for number, pair in enumerate(self.pairs)}
        found = np.zeros((len(self.parts), len(self.pairs)))

        def add(i: int, j: int, k: int, factor: float) -> None:
            found[i, place[min(j, k), max(j, k)]] += factor if j < k else -factor

        for first, a in enumerate(order):
            later = order[first + 1 :]
            for d in later:
                add(a, a, d, -1.0 / 24.0)
                for e in later:
                    add(e, d, a, 1.0 / 12.0)
        return found
