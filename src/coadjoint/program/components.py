"""Connected components of the patterns of generators."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.components import connected
from coadjoint.algebra.exact.sparse_sums import Integers, distinct, expand
from coadjoint.program.generators import Generators
from coadjoint.program.graph_layers import layers
from coadjoint.program.sparse_rows import order_by, starts_of


class Components(NamedTuple):
    """Connected sets of coordinates by columns.

    Set s has the members low[s] to low[s + 1] and the entries first[s] to first[s + 1], whose rows and columns are
    local.
    """

    angle: Integers
    low: Integers
    member: Integers
    first: Integers
    row: Integers
    column: Integers
    value: NDArray[Any]

    def take(self, chosen: Integers) -> Components:
        """Select sets, in the order given."""
        member = expand(self.low[chosen], self.low[chosen + 1])[1]
        entry = expand(self.first[chosen], self.first[chosen + 1])[1]
        return Components(
            self.angle[chosen],
            starts_of(np.diff(self.low)[chosen]),
            self.member[member],
            starts_of(np.diff(self.first)[chosen]),
            self.row[entry],
            self.column[entry],
            self.value[entry],
        )

    @property
    def width(self) -> Integers:
        """The number of coordinates of each set."""
        return np.diff(self.low)

    @property
    def lengths(self) -> Integers:
        """The number of entries of each set."""
        return np.diff(self.first)

    @property
    def owner(self) -> Integers:
        """The set of each entry."""
        return np.repeat(np.arange(len(self.angle)), self.lengths)


def components_of(generators: Generators) -> tuple[Components, NDArray[np.bool_], Integers]:
    """Return the connected sets by angle and first coordinate, a shear flag and a depth for each.

    A shear has no coordinate that is both source and target. The depth of other sets is the longest path in their
    pattern, -1 if it has a cycle.
    """
    angle, row, column, value = generators
    size = int(max(row.max(initial=0), column.max(initial=0))) + 1
    targets, sources = angle * size + row, angle * size + column
    nodes = distinct(np.concatenate([targets, sources]))
    target, source = np.searchsorted(nodes, targets), np.searchsorted(nodes, sources)
    label = connected(len(nodes), target, source)
    roots = label == np.arange(len(nodes))
    label = (np.cumsum(roots) - 1)[label]
    count = int(np.count_nonzero(roots))
    hit, struck = np.zeros(len(nodes), dtype=bool), np.zeros(len(nodes), dtype=bool)
    hit[target], struck[source] = True, True
    sheared = np.ones(count, dtype=bool)
    sheared[label[hit & struck]] = False
    low = starts_of(np.bincount(label, minlength=count))
    by_set = order_by(label)
    place = np.empty(len(nodes), dtype=np.int64)
    place[by_set] = np.arange(len(nodes)) - np.repeat(low[:-1], np.diff(low))
    depth = np.zeros(count, dtype=np.int64)
    long = ~sheared & (np.diff(low) > 2)
    if np.any(long):
        depth = _depths(label, long, source, target)
    owner = label[target]
    order = order_by(owner)
    sets = Components(
        nodes[roots] // size,
        low,
        (nodes % size)[by_set],
        starts_of(np.bincount(owner, minlength=count)),
        place[target[order]],
        place[source[order]],
        value[order],
    )
    return sets, sheared, depth


def _depths(label: Integers, chosen: NDArray[np.bool_], source: Integers, target: Integers) -> Integers:
    """Return the number of edges on the longest path in each chosen set; -1 if it has a cycle."""
    own = chosen[label[target]]
    layer = layers(len(label), source[own], target[own])
    depth = np.zeros(len(chosen), dtype=np.int64)
    np.maximum.at(depth, label, layer)
    depth[label[layer < 0]] = -1
    return depth
