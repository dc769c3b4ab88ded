"""Action of each part in one representation, as runs of equal blocks, and its blocks as matrices."""

from __future__ import annotations

from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.program.block_table import BlockTable, block_table, joined_tables, repeated_block_table
from coadjoint.program.blocks import RULES, Kind
from coadjoint.program.generators import BasisMatrices, check_products
from coadjoint.program.numbers import Number, array_of, roundoff
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import layers, order_by, run_starts, starts_of

NOTHING_OMITTED = np.zeros((0, 3), dtype=np.int64)


class Action(NamedTuple):
    """exp(theta D) of each part on vectors of `size` components, stored by columns.

    Part p has the runs run[p] to run[p + 1]. A run applies theta[angle], theta[angle + 1], ... (`angles` of them), each
    to `repeat` blocks of one kind with shared constants (a shear has a constant per block), from indices[position] and
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
    position: NDArray[np.uint32]
    constant: NDArray[np.uint32]
    width: NDArray[np.uint32]
    entries: NDArray[np.uint32]
    degree: NDArray[np.uint32]
    indices: NDArray[np.uint32]
    constants: NDArray[Any]


def build_action(
    matrices: BasisMatrices, parts: Parts, number: Number = float, omitted: Integers = NOTHING_OMITTED
) -> Action:
    """Classify the generators of each part and arrange their blocks in runs.

    The angles have the order of `parts.forms`. Entries `omitted`, (angle, row, column), count as zero. Raises
    SplittingTooExpensive for generators of too many products.
    """
    check_products(matrices.products(parts.forms), "the Hamiltonian")
    repeated = repeated_block_table(matrices, parts.forms) if number is float and not len(omitted) else None
    tables = (
        [
            block_table(generators.without(omitted), roundoff(number))
            for generators in matrices.combinations(parts.forms, number)
        ]
        if repeated is None
        else [repeated]
    )
    if not tables:
        return _empty_action(matrices.size, len(parts), number)
    blocks = joined_tables(tables)
    groups, selection = arranged_blocks(blocks, parts)
    in_order = bool(np.all(selection[1:] > selection[:-1]))
    return arranged_runs(matrices.size, blocks if in_order else blocks.take(selection), groups, parts)


def arranged_blocks(blocks: BlockTable, parts: Parts) -> tuple[Groups, Integers]:
    """Return the groups of blocks, and the order of the blocks in them."""
    part_of_angle = parts.part_of_angle
    return _group_blocks(blocks, part_of_angle, _angle_levels(blocks, part_of_angle))


class Groups(NamedTuple):
    """Blocks of one kind that share an angle (and constants, except for shears), in table order.

    Group g has the blocks block[g] to block[g + 1]; `begins` marks the groups that start a new run.
    """

    part: Integers
    angle: Integers
    block: Integers
    begins: NDArray[np.bool_]


def _angle_levels(blocks: BlockTable, part_of_angle: Integers) -> Integers:
    """Assign a level to each angle, so that generators of one level have no coordinate in common.

    The generators of a part commute, but single overlapping blocks of two of them need not.
    """
    angle = np.repeat(blocks.angle, blocks.width)
    _, index = expand(blocks.begin[:-1], blocks.begin[:-1] + blocks.width)
    coordinate, part = blocks.indices[index], part_of_angle[angle]
    order = order_by(part, coordinate)
    angle, first = angle[order], run_starts(part[order], coordinate[order])
    overlaps = np.flatnonzero(~first[1:] & (angle[1:] != angle[:-1]))
    if not len(overlaps):
        return np.zeros(len(part_of_angle), dtype=np.int64)
    return layers(len(part_of_angle), angle[overlaps], angle[overlaps + 1])


def _sharing_labels(blocks: BlockTable) -> Integers:
    """Label the blocks that may share a group: shears, and blocks of one kind with equal constants."""
    label = np.zeros(len(blocks.kind), dtype=np.int64)
    with_entries = blocks.entries > 0
    label[with_entries] = np.flatnonzero(with_entries)
    for kind in (Kind.SCALE, Kind.ROTATE, Kind.PLANE):
        members = np.flatnonzero(blocks.kind == kind)
        for column in range(RULES[kind].header):
            values, inverse = np.unique(blocks.constants[blocks.constant_begin[members] + column], return_inverse=True)
            _, label[members] = np.unique(label[members] * len(values) + inverse, return_inverse=True)
    return label


def _group_blocks(blocks: BlockTable, part_of_angle: Integers, level: Integers) -> tuple[Groups, Integers]:
    """Group the blocks, and order the groups so that equal shapes with consecutive angles form one run.

    Blocks of one level have no coordinate in common, so their order is free.
    """
    label = _sharing_labels(blocks)
    order = order_by(blocks.angle, blocks.kind, label)
    member = np.arange(len(blocks.angle))[order]
    begins = np.flatnonzero(run_starts(blocks.angle[member], blocks.kind[member], label[member]))
    leader = member[begins]
    count, kind, angle = np.diff(np.append(begins, len(member))), blocks.kind[leader], blocks.angle[leader]
    rank = _group_ranks(angle, kind, count, leader)
    part, group_level = part_of_angle[angle], level[angle]
    order = np.arange(len(leader))[order_by(part, group_level, kind, count, rank, angle)]
    part, group_level, angle, begins = part[order], group_level[order], angle[order], begins[order]
    kind, count = kind[order], count[order]
    begins_run = run_starts(part, group_level, kind, count)
    begins_run[1:] |= angle[1:] != angle[:-1] + 1
    begins_run |= (kind == Kind.CUBIC) | (kind == Kind.SERIES)
    selection = member[expand(begins, begins + count)[1]]
    return Groups(part, angle, starts_of(count), begins_run), selection


def _group_ranks(angle: Integers, kind: NDArray[np.uint8], count: Integers, leader: Integers) -> Integers:
    """Assign numbers to the groups of one angle and shape by their first blocks."""
    order = np.arange(len(angle))[order_by(angle, kind, count, leader)]
    first = run_starts(angle[order], kind[order], count[order])
    position = np.arange(len(order))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = position - np.maximum.accumulate(np.where(first, position, 0))
    return rank


def arranged_runs(size: int, blocks: BlockTable, groups: Groups, parts: Parts) -> Action:
    """Return the action of blocks in the order of their groups."""
    first = np.flatnonzero(groups.begins)
    leader = groups.block[first]
    kind = blocks.kind
    # The blocks of a group share the constants of its first block, except for shears.
    stored = (kind == Kind.SHEAR) | (kind == Kind.CUBIC) | (kind == Kind.SERIES)
    stored[groups.block[:-1]] = True
    length = np.where(stored, np.diff(blocks.constant_begin), 0)
    constants = (
        blocks.constants if stored.all() else blocks.constants[np.repeat(stored, np.diff(blocks.constant_begin))]
    )
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
        position=column(blocks.begin[leader]),
        constant=column(starts_of(length)[leader]),
        width=blocks.width[leader],
        entries=blocks.entries[leader],
        degree=blocks.degree[leader],
        indices=blocks.indices,
        constants=constants,
    )


def empty_action() -> Action:
    """Return the action of a program without a group element."""
    return _empty_action(0, 0, float)


def _empty_action(size: int, parts: int, number: Number) -> Action:
    empty, kind = np.zeros(0, dtype=np.uint32), np.zeros(0, dtype=np.uint8)
    return Action(
        size,
        np.zeros(parts + 1, dtype=np.uint32),
        kind,
        empty,
        empty,
        empty,
        empty,
        empty,
        empty,
        empty,
        empty,
        empty,
        array_of(number, []),
    )


def run_blocks(action: Action, run: int, q: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return the blocks of a run at its angle number q, as (coordinates, matrix); all but shears share one matrix."""
    kind, repeat = Kind(action.kind[run]), int(action.repeat[run])
    width, index, constant = int(action.width[run]), int(action.position[run]), int(action.constant[run])
    constants, rule = action.constants, RULES[kind]
    first = index + q * repeat * width
    coordinates = action.indices[first : first + repeat * width].astype(np.int64).reshape(repeat, width)
    own = repeat if kind == Kind.SHEAR else 1
    matrices = np.full((own, width, width), 0 * constants[constant], dtype=constants.dtype)
    for b, matrix in enumerate(matrices):
        if rule.matrix is not None:
            begin = constant + rule.header * (q * own + b)
            for place, value in zip(
                np.ndindex(width, width), chain(*rule.matrix(*constants[begin:][: rule.header])), strict=True
            ):
                matrix[place] = value
        else:
            starts = action.indices[index + width : index + 2 * width + 1].astype(np.int64)
            columns = action.indices[index + 2 * width + 1 :][: int(action.entries[run])]
            values = constants[constant + rule.header :][: len(columns)]
            matrix[np.repeat(np.arange(width), np.diff(starts)), columns] = values
    return [(each, matrices[b % own]) for b, each in enumerate(coordinates)]


def run_entries(action: Action, run: int, q: int) -> dict[tuple[int, int], Any]:
    """Return the nonzero entries of a run's generator at its angle number q."""
    entries = {}
    for coordinates, matrix in run_blocks(action, run, q):
        for i, j in np.argwhere(matrix != 0):
            entries[int(coordinates[i]), int(coordinates[j])] = matrix[i, j]
    return entries
