"""Layers of a directed acyclic graph: how long is the longest path to each node?"""

from __future__ import annotations

import numpy as np

from coadjoint.algebra.joins import Integers, distinct, expand
from coadjoint.program.sparse_rows import order_by, starts_of


def layers(count: int, source: Integers, target: Integers) -> Integers:
    """Return the number of edges on the longest path to each node, and -1 for what lies on a cycle or behind one.

    Layer after layer, each as a whole.

    Parameters
    ----------
    count : int
        Number of nodes.
    source, target : integer arrays of equal length
        The edges.

    Returns
    -------
    integer array, shape (count,)

    Examples
    --------
    >>> layers(5, np.array([0, 1, 0, 3, 4]), np.array([1, 2, 2, 4, 3])).tolist()
    [0, 1, 2, -1, -1]
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
