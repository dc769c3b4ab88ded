"""Action of each part in one representation, as runs of equal blocks, and the frequencies of rational rotations."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.block_table import MIN_REPEATED, BlockTable, block_table, joined_tables, repeated_block_table
from coadjoint.program.blocks import RULES, BlockKind, Rule
from coadjoint.program.generators import NOTHING_OMITTED, BasisMatrices, check_products
from coadjoint.program.numbers import Number, array_of, is_exact, roundoff
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import Rows, SparseRows, layers, order_by, run_starts, starts_of
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coordinates import coordinate_names
from coadjoint.systems.lie_poisson import LiePoissonSystem


class Action(NamedTuple):
    """exp(theta D) of each part on `size` components: part p has runs run[p] to run[p + 1]; a run applies `angles` from
    `angle` on, each to `repeat` blocks, with indices from `position`, constants from `constant` (see `docs/table.md`).
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
    """Classify the generators of each part and arrange their blocks in runs."""
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
        return empty_action(matrices.size, len(parts), number)
    blocks = joined_tables(tables)
    return _arrange_runs(matrices.size, blocks, parts)


def _angle_levels(blocks: BlockTable, part_of_angle: Integers) -> Integers:
    """Assign a level to each angle, so that generators of one level, which commute, have no coordinate in common."""
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
    for kind, rule in RULES.items():
        if rule.values or rule.per_block:
            continue
        members = np.flatnonzero(blocks.kind == kind)
        for column in range(rule.header):
            values, inverse = np.unique(blocks.constants[blocks.constant_begin[members] + column], return_inverse=True)
            _, label[members] = np.unique(label[members] * len(values) + inverse, return_inverse=True)
    return label


def _kinds_with(test: Callable[[Rule], bool]) -> NDArray[np.bool_]:
    return np.array([test(RULES[kind]) for kind in BlockKind])


def _group_ranks(angle: Integers, kind: NDArray[np.uint8], count: Integers, leader: Integers) -> Integers:
    """Assign numbers to the groups of one angle and shape by their first blocks."""
    order = np.arange(len(angle))[order_by(angle, kind, count, leader)]
    first = run_starts(angle[order], kind[order], count[order])
    position = np.arange(len(order))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = position - np.maximum.accumulate(np.where(first, position, 0))
    return rank


def _arrange_runs(size: int, blocks: BlockTable, parts: Parts) -> Action:
    """Group blocks of a kind and angle (and constants, except shears), so that shapes with consecutive angles join."""
    part_of_angle, label = parts.part_of_angle, _sharing_labels(blocks)
    level = _angle_levels(blocks, part_of_angle)
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
    begins_run |= _kinds_with(lambda rule: rule.values > 0)[kind]
    selection = member[expand(begins, begins + count)[1]]
    if not np.all(selection[1:] > selection[:-1]):
        blocks = blocks.take(selection)
    first, start, kind = np.flatnonzero(begins_run), starts_of(count), blocks.kind
    leader, part = start[first], part[first]
    # The blocks of a group share the constants of its first block, except for shears.
    stored = _kinds_with(lambda rule: rule.values > 0 or rule.per_block)[kind]
    stored[start[:-1]] = True
    lengths = np.diff(blocks.constant_begin)

    def column(values: Any) -> NDArray[np.uint32]:
        return np.ascontiguousarray(values, dtype=np.uint32)

    return Action(
        size=size,
        run=column(np.searchsorted(part, np.arange(len(parts) + 1))),
        kind=kind[leader],
        angles=column(np.diff(np.append(first, len(angle)))),
        repeat=column(count[first]),
        angle=column(angle[first] - parts.angle[part]),
        position=column(blocks.begin[leader]),
        constant=column(starts_of(np.where(stored, lengths, 0))[leader]),
        width=blocks.width[leader],
        entries=blocks.entries[leader],
        degree=blocks.degree[leader],
        indices=blocks.indices,
        constants=blocks.constants if stored.all() else blocks.constants[np.repeat(stored, lengths)],
    )


def empty_action(size: int = 0, parts: int = 0, number: Number = float) -> Action:
    """Return an action that moves nothing; by default that of a flow table without a group element."""
    empty, kind = np.zeros(0, dtype=np.uint32), np.zeros(0, dtype=np.uint8)
    run = np.zeros(parts + 1, dtype=np.uint32)
    return Action._make([size, run, kind, *[empty] * 9, array_of(number, [])])


def run_blocks(action: Action, run: int, q: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return the blocks of a run at its angle number q, as (coordinates, matrix); all but shears share one matrix."""
    kind, repeat = BlockKind(action.kind[run]), int(action.repeat[run])
    width, index, constant = int(action.width[run]), int(action.position[run]), int(action.constant[run])
    constants, rule = action.constants, RULES[kind]
    first = index + q * repeat * width
    coordinates = action.indices[first : first + repeat * width].astype(np.int64).reshape(repeat, width)
    own = repeat if rule.per_block else 1
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


def generator_entries(action: Action, part: int, angle: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return the rows, columns and values of the nonzero entries of the generator of one form of a part."""
    row, column = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    value = [action.constants[:0]]
    for run in range(action.run[part], action.run[part + 1]):
        q = angle - int(action.angle[run])
        for coordinates, matrix in run_blocks(action, run, q) if 0 <= q < action.angles[run] else ():
            i, j = np.nonzero(matrix != 0)
            row.append(coordinates[i])
            column.append(coordinates[j])
            value.append(matrix[i, j])
    return np.concatenate(row), np.concatenate(column), np.concatenate(value)


# Largest number of parts, each of which is a run of rotations.
MAX_PARTS = 64


def copied_action(algebra: LieAlgebra, parts: Parts) -> Action | None:
    """Return the action of parts that rotate one plane of each copy, bitwise as by `build_action`; else None."""
    count = len(parts.offset)
    if algebra._copied is None or count < MIN_REPEATED or len(parts) > MAX_PARTS:
        return None
    forms = parts.forms
    if len(forms.coordinate) != count or not np.all(np.diff(forms.start) == 1) or not np.all(forms.value == 1.0):
        return None
    summand, _ = algebra._copied
    units = SparseRows.units(np.arange(summand.dim))
    generators = BasisMatrices.coadjoint(summand).combinations(units, float)
    tables = [block_table(one, roundoff(float)) for one in generators]
    if not tables:
        return None
    blocks = joined_tables(tables)
    if not np.array_equal(blocks.angle, np.arange(summand.dim)) or np.any(blocks.kind != BlockKind.ROTATE):
        return None
    inner = forms.coordinate % np.uint32(summand.dim)
    indices = blocks.indices.reshape(summand.dim, 2).astype(np.uint32)[inner]
    indices += (forms.coordinate - inner)[:, None]
    first = parts.angle
    sizes = np.diff(first)
    for begin, size in zip(first[:-1].tolist(), sizes.tolist(), strict=True):
        moved = np.zeros(algebra.dim, dtype=bool)
        moved[indices[begin : begin + size]] = True
        if np.count_nonzero(moved) < 2 * size:  # planes with a common coordinate
            return None
    used = sizes > 0
    runs = int(np.count_nonzero(used))
    begin = first[:-1][used].astype(np.uint32)
    ones, zeros = np.ones(runs, dtype=np.uint32), np.zeros(runs, dtype=np.uint32)
    return Action(
        size=algebra.dim,
        run=np.concatenate([[0], np.cumsum(used)]).astype(np.uint32),
        kind=np.full(runs, BlockKind.ROTATE, dtype=np.uint8),
        angles=sizes[used].astype(np.uint32),
        repeat=ones,
        angle=zeros,
        position=2 * begin,
        constant=begin,
        width=2 * ones,
        entries=zeros,
        degree=np.full(runs, blocks.degree[0], dtype=np.uint32),
        indices=indices.ravel(),
        constants=blocks.constants[inner],
    )


def rational_frequencies(system: LiePoissonSystem, parts: Parts, state: Action, number: Number) -> NDArray[Any]:
    """Return w of 2/w atan(w angle/2) by angle, as exact w^2; 0 for exact angles.

    It is the flow of another function of l.x if the generator has one frequency and the angle depends on l.x alone;
    otherwise raise ValueError, unless the generator is nilpotent.
    """
    least, largest, known, _ = _frequencies(state, parts, number, squared=is_exact(number))
    # Frequencies are roots of sums of some products, rounded alike.
    known = known & np.asarray(largest - least <= 64 * roundoff(number) * largest, dtype=bool)
    turning = known & np.asarray(largest != 0, dtype=bool)
    wrong = np.flatnonzero(~known | (turning & _coupled(parts)))
    if len(wrong):
        entries = slice(*parts.forms.start[[wrong[0], wrong[0] + 1]])
        names = coordinate_names(system)
        name = " + ".join(names[i] for i in parts.forms.coordinate[entries])
        reason = "is a rotation whose angle depends on other quantities too"
        if not known[wrong[0]]:
            reason = "is neither nilpotent nor a rotation of a single frequency"
        raise ValueError(
            f'rotation="rational" would not be a Poisson map for {system.name}: the flow along {name} '
            f'{reason}; take rotation="exact"'
        )
    return largest


def _frequencies(action: Action, parts: Parts, number: Number, squared: bool = False) -> tuple[NDArray[Any], ...]:
    """Return by angle the extreme frequencies of its blocks, if all are nilpotent or rotations, and if any exist."""
    run = np.repeat(np.arange(len(action.kind)), action.angles)
    q = np.arange(len(run)) - np.repeat(starts_of(action.angles)[:-1], action.angles)
    part = np.repeat(np.arange(len(parts)), np.diff(action.run))[run]
    angle, kind = parts.angle[part] + action.angle[run] + q, action.kind[run]
    first_constant = action.constant[run].astype(np.int64)
    is_rotation = kind == BlockKind.ROTATE
    first = action.constants[first_constant + np.where(is_rotation, q, 0)]
    cubic = (kind == BlockKind.CUBIC) & np.asarray(first < 0, dtype=bool)
    nilpotent = (kind == BlockKind.SHEAR) | ((kind == BlockKind.SERIES) & np.asarray(first == 0, dtype=bool))
    frequency = np.where(is_rotation, first**2 if squared else first, 0 * first)
    frequency[cubic] = -first[cubic] if squared else action.constants[first_constant[cubic] + 1]
    known, acting = np.ones(len(parts.offset), dtype=bool), np.zeros(len(parts.offset), dtype=bool)
    acting[angle] = True
    known[angle[~(is_rotation | cubic | nilpotent)]] = False
    largest = array_of(number, np.zeros(len(parts.offset), dtype=np.int64))
    np.maximum.at(largest, angle, frequency)
    least = largest.copy()
    np.minimum.at(least, angle, frequency)
    return least, largest, known, acting


def _coupled(parts: Parts) -> NDArray[np.bool_]:
    """Test for each angle whether it depends on more than its own form."""
    coupled = ~_is_along_form(parts.forms, parts.weights)
    for s in parts.nonlinear:
        angles, share = slice(int(parts.row[s]), int(parts.row[s + 1])), parts.gradients.get(s)
        if share is not None and share.polynomial is not None:
            mixed = [e for e in share.polynomial.monomials if sum(1 for power in e if power) > 1]
            coupled[angles] = [any(e[i] for e in mixed) for i in share.coordinates]
        else:
            coupled[angles] = angles.stop - angles.start > 1
    return coupled


def _is_along_form(forms: SparseRows, weights: Rows) -> NDArray[np.bool_]:
    """Test whether the weights of each angle are a multiple of its form, up to rounding."""
    length = np.diff(weights.start)
    is_along = np.asarray((length == 0) | (length == np.diff(forms.start)))
    same = np.flatnonzero(is_along & (length > 0))
    form, weight = forms.take(same), weights.take(same)
    first = form.start[:-1][form.owner]
    left, right = weight.value * form.value[first], weight.value[first] * form.value
    # Weights and forms are rounded twice each.
    agree = np.asarray(abs(left - right) <= 8 * UNIT_ROUNDOFF * abs(left), dtype=bool)
    agree &= form.coordinate == weight.coordinate
    is_along[same[form.owner[~agree]]] = False
    return is_along


def rational_angle(angle: Any, frequency: Any, atan: Any) -> Any:
    """Return the angle 2/w atan(w angle/2) of a rational rotation of frequency w, or the angle itself for w = 0."""
    return angle if frequency == 0 else 2 / frequency * atan(frequency * angle / 2)


def rational_angle_series(angle: Any, squared_frequency: Any, count: int) -> Any:
    """Return 2/w atan(w angle/2) = angle (1 - z/3 + z^2/5 - ...), z = (w angle/2)^2, for a series in h."""
    if squared_frequency == 0:
        return angle
    z = angle * angle * (squared_frequency / 4)
    power = total = angle
    for k in range(3, count, 2):
        power = power * z * -1
        total = total + power / k
    return total


def acts_rationally(action: Action, parts: Parts, frequency: NDArray[Any]) -> NDArray[np.bool_]:
    """Test for each part whether its blocks in a representation have the frequencies of the coadjoint ones."""
    least, largest, known, acting = _frequencies(action, parts, float)
    difference = np.maximum(np.abs(least - frequency), np.abs(largest - frequency))
    agree = np.ones(len(parts), dtype=bool)
    agree[parts.part_of_angle[acting & ~(known & (difference <= 64 * UNIT_ROUNDOFF * np.abs(frequency)))]] = False
    return agree
