"""Generators of all angles as sparse entries, the connected components of their patterns, and a check of their cost."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, chunks, connected, distinct, expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.long_operations import warn_if_long
from coadjoint.memory import check_available_memory, format_bytes
from coadjoint.program.numbers import Number, array_of, roundoff
from coadjoint.program.sparse_rows import SparseRows, layers, order_by, run_starts, run_sums, starts_of

# Generators with at most this many products are not counted: lattices may have millions of them.
MIN_COUNTED_PRODUCTS = 1 << 12
MAX_PRODUCTS = 1 << 24  # of all generators: above, building takes half a minute and 2.5 GB
BYTES_PER_PRODUCT = 150  # peak memory of building, measured
SECONDS_PER_PRODUCT = 2e-6  # of building, measured
# Per product, for one step of order two: two sweeps, with a series of twenty products per entry.
SECONDS_PER_STEP = 4e-8


NOTHING_OMITTED = np.zeros((0, 3), dtype=np.int64)
"""Entries (angle, row, column) of generators that are left out: none."""


class Generators(NamedTuple):
    """Nonzero entries of one matrix per angle, sorted by angle, row and column."""

    angle: Integers
    row: Integers
    column: Integers
    value: NDArray[Any]

    def without(self, omitted: Integers) -> Generators:
        """Return the entries that are not among those of `omitted`, (angle, row, column)."""
        if not len(omitted):
            return self
        size = 1 + max(int(column.max(initial=0)) for column in (*self[1:3], omitted[:, 1:]))
        codes, without = ((a * size + i) * size + k for a, i, k in (self[:3], omitted.T))
        retained = ~np.isin(codes, without)
        return Generators(*(column[retained] for column in self))


class BasisMatrices:
    """One sparse matrix per basis element of the algebra, with lazy linear combinations."""

    def __init__(self, size: int, start: Integers, rows: Integers, columns: Integers, values: NDArray[Any]) -> None:
        self.size = size
        self._start, self._rows, self._columns, self._values = start, rows, columns, values

    @property
    def entries(self) -> tuple[Integers, Integers, Integers, NDArray[Any]]:
        return self._start, self._rows, self._columns, self._values

    @classmethod
    def coadjoint(cls, algebra: LieAlgebra) -> BasisMatrices:
        """Construct D_i with J(x) e_i = D_i x: the action on momenta, (D_i)_jk = c_ji^k."""
        start, entries = algebra.actions
        return cls(algebra.dim, start, entries.j, entries.k, entries.c)

    @classmethod
    def on_group(cls, algebra: LieAlgebra, representation: NDArray[Any] | None) -> BasisMatrices:
        """Construct -rho_i^T (-D_i^T for None): the action on rows of a group element, g' = -g rho."""
        if representation is None:
            start, entries = algebra.actions
            size, basis, rows, columns, values = algebra.dim, entries.i, entries.k, entries.j, -entries.c
        else:
            basis, columns, rows = np.nonzero(representation)
            size, values = representation.shape[1], -representation[basis, columns, rows]
        order = order_by(basis, rows, columns)
        start = np.searchsorted(basis, np.arange(algebra.dim + 1))
        return cls(size, start, rows[order], columns[order], values[order])

    def products(self, forms: SparseRows) -> Integers:
        """Count the products summed in the generator of each form."""
        cost = starts_of(np.diff(self._start)[forms.coordinate])
        return np.diff(cost[forms.start])

    def combinations(self, forms: SparseRows, number: Number) -> Iterator[Generators]:
        """Yield sum_i form_i D_i in chunks of angles, without entries that cancel up to rounding."""
        cost = np.diff(self._start)[forms.coordinate]
        owner = forms.owner
        for part in chunks(owner, cost):
            first = self._start[forms.coordinate[part]]
            entry, index = expand(first, first + cost[part])
            factor, value = array_of(number, forms.value[part]), array_of(number, self._values[index])
            angle, row, column, term = (
                owner[part][entry],
                self._rows[index],
                self._columns[index],
                factor[entry] * value,
            )
            order = order_by(angle, row, column)
            angle, row, column, term = angle[order], row[order], column[order], term[order]
            begins = run_starts(angle, row, column)
            total, bound = run_sums(term, begins), run_sums(abs(term), begins)
            # Each product and each sum is rounded once: less than this is what cancels.
            nonzero = np.asarray(abs(total) > 4 * roundoff(number) * bound, dtype=bool)
            first_index = np.flatnonzero(begins)[nonzero]
            yield Generators(angle[first_index], row[first_index], column[first_index], total[nonzero])


def given_matrices(representation: Any) -> NDArray[Any] | None:
    """Return the matrices of a representation; None for "coadjoint", whose matrices are those of the algebra."""
    return None if isinstance(representation, str) else representation


def group_side(dim: int, representation: NDArray[Any] | str | None) -> int:
    """Return the number of rows of a group element in a representation of an algebra; 0 for None."""
    if representation is None:
        return 0
    matrices = given_matrices(representation)
    return dim if matrices is None else int(matrices.shape[-1])


class Components(NamedTuple):
    """Connected sets of coordinates by columns."""

    angle: Integers
    low: Integers
    member: Integers
    first: Integers
    row: Integers
    column: Integers
    value: NDArray[Any]

    def take(self, chosen: Integers) -> Components:
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
        return np.diff(self.low)

    @property
    def lengths(self) -> Integers:
        return np.diff(self.first)

    @property
    def owner(self) -> Integers:
        return np.repeat(np.arange(len(self.angle)), self.lengths)


def components_of(generators: Generators) -> tuple[Components, NDArray[np.bool_], Integers]:
    """Return connected sets by angle and first coordinate, whether each is a shear (no coordinate source and target),
    and its depth: the longest path in the pattern, -1 for a cycle.
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
    is_target, is_source = np.zeros(len(nodes), dtype=bool), np.zeros(len(nodes), dtype=bool)
    is_target[target], is_source[source] = True, True
    sheared = np.ones(count, dtype=bool)
    sheared[label[is_target & is_source]] = False
    low = starts_of(np.bincount(label, minlength=count))
    by_set = order_by(label)
    local_index = np.empty(len(nodes), dtype=np.int64)
    local_index[by_set] = np.arange(len(nodes)) - np.repeat(low[:-1], np.diff(low))
    depth = np.zeros(count, dtype=np.int64)
    wide = ~sheared & (np.diff(low) > 2)
    if np.any(wide):
        depth = _depths(label, wide, source, target)
    owner = label[target]
    order = order_by(owner)
    sets = Components(
        nodes[roots] // size,
        low,
        (nodes % size)[by_set],
        starts_of(np.bincount(owner, minlength=count)),
        local_index[target[order]],
        local_index[source[order]],
        value[order],
    )
    return sets, sheared, depth


def _depths(label: Integers, chosen: NDArray[np.bool_], source: Integers, target: Integers) -> Integers:
    """Return the number of edges on the longest path in each chosen set; -1 if it has a cycle."""
    inside = chosen[label[target]]
    layer = layers(len(label), source[inside], target[inside])
    depth = np.zeros(len(chosen), dtype=np.int64)
    np.maximum.at(depth, label, layer)
    depth[label[layer < 0]] = -1
    return depth


class NotSplittable(ValueError):
    """H is no sum of functions with known flows, or these take minutes to prepare; the message names the piece."""


def check_products(products: NDArray[np.int64] | Integers, what: str) -> None:
    """Raise NotSplittable if generators are sums of too many products, ValueError if they exceed the memory."""
    wide = products[products > MIN_COUNTED_PRODUCTS]
    total = int(wide.sum())
    if total > MAX_PRODUCTS:
        raise NotSplittable(
            f"{what} has {len(wide)} flows of {total // len(wide)} products each: a splitting would need about "
            f"{SECONDS_PER_PRODUCT * total:.0f} s and {format_bytes(BYTES_PER_PRODUCT * total)} for its preparation, "
            f"and {SECONDS_PER_STEP * total:.0f} s per step; use GaussLegendre, which needs no preparation"
        )
    check_available_memory(BYTES_PER_PRODUCT * total, f"a splitting of {what}", "take GaussLegendre")
    warn_if_long(f"preparing a splitting of {what}", SECONDS_PER_PRODUCT * total, "GaussLegendre needs no preparation")
