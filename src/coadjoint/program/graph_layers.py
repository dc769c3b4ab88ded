"""Layers of a directed acyclic graph."""

from __future__ import annotations

import numpy as np

from coadjoint.algebra.exact.sparse_sums import Integers, distinct, expand
from coadjoint.program.sparse_rows import order_by, starts_of


def layers(count: int, source: Integers, target: Integers) -> Integers:
    """Return the length of the longest path to each node, shape (count,); -1 for nodes on or behind a cycle.

    The edges lead from `source` to `target`. Computed layer by layer, each vectorised.
    """
    layer = np.full(count, -1, dtype=np.int64)
    waiting = np.bincount(target, minlength=count)
    order = order_by(source)
    start, ends = starts_of(np.bincount(source, minlength=count)), target[order]
    ready, depth = np.flatnonzero(waiting == 0), 0
    while len(ready):
        layer[ready] = depth
        _, places = expand(start[ready], start[ready + 1])
        reached = ends[places]
        np.subtract.at(waiting, reached, 1)
        ready, depth = distinct(reached[waiting[reached] == 0]), depth + 1
    return layer
