"""Action of each part in one representation, as runs of equal blocks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.block_table import BlockTable, block_table, joined_tables
from coadjoint.program.blocks import Kind
from coadjoint.program.generators import BasisMatrices
from coadjoint.program.graph_layers import layers
from coadjoint.program.numbers import Number, array_of, roundoff
from coadjoint.program.parts.generator_cost import check_products
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import order_by, run_starts, starts_of


class Action(NamedTuple):
    """exp(theta D) of each part on vectors of `size` components, stored by columns.

    Part p has the runs run[p] to run[p + 1]. A run applies theta[angle], theta[angle + 1], ... (`angles` of them), each
    to `repeat` blocks of one kind with shared constants (a shear has a constant per block), from indices[place] and
    constants[constant] on. For CUBIC and SERIES blocks, `width` is the number of coordinates, `degree` the number of
    terms of the sum, and the coordinates are followed by compressed sparse rows: `width` + 1 starts, then `entries`
    columns. The values of D (of a CUBIC block those of D^2 and their rounding errors) follow the constants.
    """

    size: int
    run: NDArray[np.uint32]
    kind: NDArray[np.uint8]
    angles: NDArray[np.uint32]
    repeat: NDArray[np.uint32]
    angle: NDArray[np.uint32]
    place: NDArray[np.uint32]
    constant: NDArray[np.uint32]
    width: NDArray[np.uint32]
    entries: NDArray[np.uint32]
    degree: NDArray[np.uint32]
    indices: NDArray[np.uint32]
    constants: NDArray[Any]


def build_action(matrices: BasisMatrices, parts: Parts, number: Number = float) -> Action:
    """Classify the generators of each part and arrange their blocks in runs.

    The angles have the order of `parts.forms`. Raises TooWide if the generators are sums of too many products.
    """
    check_products(matrices.products(parts.forms), "the Hamiltonian")
    tables = [block_table(some, roundoff(number)) for some in matrices.combinations(parts.forms, number)]
    if not tables:
        return _empty(matrices.size, len(parts), number)
    blocks = joined_tables(tables)
    part_of_angle = parts.part_of_angle
    level = _levels(blocks, part_of_angle)
    groups, blocks = _groups(blocks, part_of_angle, level)
    return _arrange(matrices.size, blocks, groups, parts)


class _Groups(NamedTuple):
    """Blocks of one kind that share an angle (and constants, except for shears), in table order.

    Group g has the blocks block[g] to block[g + 1]; `begins` marks the groups that start a new run.
    """

    part: Integers
    angle: Integers
    block: Integers
    begins: NDArray[np.bool_]


def _levels(blocks: BlockTable, part_of_angle: Integers) -> Integers:
    """Assign a level to each angle, so that generators of one level have no coordinate in common.

    The generators of a part commute, but single overlapping blocks of two of them need not.
    """
    angle = np.repeat(blocks.angle, blocks.width)
    _, place = expand(blocks.begin[:-1], blocks.begin[:-1] + blocks.width)
    coordinate, part = blocks.indices[place], part_of_angle[angle]
    order = order_by(part, coordinate)
    angle, first = angle[order], run_starts(part[order], coordinate[order])
    again = np.flatnonzero(~first[1:] & (angle[1:] != angle[:-1]))
    if not len(again):
        return np.zeros(len(part_of_angle), dtype=np.int64)
    return layers(len(part_of_angle), angle[again], angle[again + 1])


def _sharing_labels(blocks: BlockTable) -> Integers:
    """Label the blocks that may share a group: shears, and blocks of one kind with equal constants."""
    shared = np.zeros(len(blocks.kind), dtype=np.int64)
    apart = blocks.entries > 0
    shared[apart] = np.flatnonzero(apart)
    for kind, count in ((Kind.SCALE, 1), (Kind.ROTATE, 1), (Kind.PLANE, 4)):
        own = np.flatnonzero(blocks.kind == kind)
        for column in range(count):
            values, number = np.unique(blocks.constants[blocks.constant_begin[own] + column], return_inverse=True)
            _, shared[own] = np.unique(shared[own] * len(values) + number, return_inverse=True)
    return shared


def _groups(blocks: BlockTable, part_of_angle: Integers, level: Integers) -> tuple[_Groups, BlockTable]:
    """Group the blocks, and order the groups so that equal shapes with consecutive angles form one run.

    Blocks of one level have no coordinate in common, so their order is free.
    """
    shared = _sharing_labels(blocks)
    order = order_by(blocks.angle, blocks.kind, shared)
    member = np.arange(len(blocks.angle))[order]
    begins = np.flatnonzero(run_starts(blocks.angle[member], blocks.kind[member], shared[member]))
    leader = member[begins]
    count, kind, angle = np.diff(np.append(begins, len(member))), blocks.kind[leader], blocks.angle[leader]
    rank = _ranks(angle, kind, count, leader)
    part, height = part_of_angle[angle], level[angle]
    order = np.arange(len(leader))[order_by(part, height, kind, count, rank, angle)]
    part, height, angle, begins = part[order], height[order], angle[order], begins[order]
    kind, count = kind[order], count[order]
    new = run_starts(part, height, kind, count)
    new[1:] |= angle[1:] != angle[:-1] + 1
    new |= (kind == Kind.CUBIC) | (kind == Kind.SERIES)
    chosen = member[expand(begins, begins + count)[1]]
    sorted_ = bool(np.all(chosen[1:] > chosen[:-1]))
    return _Groups(part, angle, starts_of(count), new), blocks if sorted_ else blocks.take(chosen)


def _ranks(angle: Integers, kind: NDArray[np.uint8], count: Integers, leader: Integers) -> Integers:
    """Number the groups of one angle and shape by their first blocks."""
    order = np.arange(len(angle))[order_by(angle, kind, count, leader)]
    first = run_starts(angle[order], kind[order], count[order])
    place = np.arange(len(order))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = place - np.maximum.accumulate(np.where(first, place, 0))
    return rank


def _arrange(size: int, blocks: BlockTable, groups: _Groups, parts: Parts) -> Action:
    first = np.flatnonzero(groups.begins)
    leader = groups.block[first]
    kind = blocks.kind
    # The blocks of a group share the constants of its first block, except for shears.
    kept = (kind == Kind.SHEAR) | (kind == Kind.CUBIC) | (kind == Kind.SERIES)
    kept[groups.block[:-1]] = True
    length = np.where(kept, np.diff(blocks.constant_begin), 0)
    constants = blocks.constants if kept.all() else blocks.constants[np.repeat(kept, np.diff(blocks.constant_begin))]
    part = groups.part[first]

    def column(values: Any) -> NDArray[np.uint32]:
        return np.ascontiguousarray(values, dtype=np.uint32)

    return Action(
        size=size,
        run=column(np.searchsorted(part, np.arange(len(parts) + 1))),
        kind=kind[leader],
        angles=column(np.diff(np.append(first, len(groups.angle)))),
        repeat=column(np.diff(groups.block)[first]),
        angle=column(groups.angle[first] - parts.angle[part]),
        place=column(blocks.begin[leader]),
        constant=column(starts_of(length)[leader]),
        width=blocks.width[leader],
        entries=blocks.entries[leader],
        degree=blocks.degree[leader],
        indices=blocks.indices,
        constants=constants,
    )


def empty_action() -> Action:
    """Return the action of a program without a group element."""
    return _empty(0, 0, float)


def _empty(size: int, parts: int, number: Number) -> Action:
    none, kind = np.zeros(0, dtype=np.uint32), np.zeros(0, dtype=np.uint8)
    return Action(
        size,
        np.zeros(parts + 1, dtype=np.uint32),
        kind,
        none,
        none,
        none,
        none,
        none,
        none,
        none,
        none,
        none,
        array_of(number, []),
    )
