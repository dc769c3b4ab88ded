"""The action of every part in one representation, as runs of equal blocks: the rows' right-hand column."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.blocks import Block, Entries, Kind, blocks_of
from coadjoint.program.numbers import Number, array_of, convert, roundoff
from coadjoint.program.parts import Part


class Action(NamedTuple):
    """exp(theta D) of every part on vectors of `size` components.

    Part p has the runs run[p] to run[p + 1]. A run has `angles` of them, theta[angle], theta[angle + 1], ..., and for
    each of them `repeat` blocks of one kind with the same constants (a shear has a constant for each block). `width` is
    the number of coordinates of a CUBIC or SERIES block and `degree` the length of its sum; its entries follow as
    compressed sparse rows, `width` + 1 starts and the columns after the coordinates, the values of D (of a CUBIC block
    then those of D^2, and what rounding left of them) after the constants.
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


class BasisMatrices:
    """One sparse matrix for each basis element of the algebra, combined linearly on request."""

    def __init__(self, size: int, count: int, basis: NDArray[Any], rows: Any, columns: Any, values: Any) -> None:
        order = np.lexsort((columns, rows, basis))
        self.size = size
        self._start = np.searchsorted(basis[order], np.arange(count + 1))
        self._rows, self._columns, self._values = rows[order], columns[order], values[order]

    @classmethod
    def coadjoint(cls, algebra: LieAlgebra) -> BasisMatrices:
        """Return D_i with J(x) e_i = D_i x: the action on momenta, (D_i)_jk = c_ji^k."""
        i, j, k, c = algebra.triples
        basis, rows = np.concatenate([j, i]), np.concatenate([i, j])
        return cls(algebra.dim, algebra.dim, basis, rows, np.concatenate([k, k]), np.concatenate([c, -c]))

    @classmethod
    def on_group(cls, algebra: LieAlgebra, representation: NDArray[Any] | None) -> BasisMatrices:
        """Return -rho_i^T (-D_i^T where None is given): the action on the rows of a group element, g' = -g rho."""
        if representation is None:
            plain = cls.coadjoint(algebra)
            basis = np.repeat(np.arange(algebra.dim), np.diff(plain._start))
            return cls(algebra.dim, algebra.dim, basis, plain._columns, plain._rows, -plain._values)
        basis, rows, columns = np.nonzero(representation)
        return cls(representation.shape[1], algebra.dim, basis, columns, rows, -representation[basis, rows, columns])

    def combination(self, form: tuple[Sequence[int], Sequence[Any]], number: Number) -> Entries:
        """Return sum_i form_i D_i; entries that cancel up to rounding are dropped."""
        total: Entries = {}
        size: dict[tuple[int, int], Any] = {}
        for i, factor in zip(*form, strict=True):
            weight = convert(number, factor)
            for entry in range(self._start[i], self._start[i + 1]):
                key = (int(self._rows[entry]), int(self._columns[entry]))
                term = weight * convert(number, self._values[entry])
                total[key] = total.get(key, 0) + term
                size[key] = size.get(key, 0) + abs(term)
        u = roundoff(number)
        return {key: value for key, value in total.items() if abs(value) > 4 * u * size[key]}


def build_action(matrices: BasisMatrices, parts: Iterable[Part], number: Number = float) -> Action:
    """Classify the generators of every part and lay them out in runs.

    Parameters
    ----------
    matrices : BasisMatrices
        The representation.
    parts : iterable of Part
        Their forms name the generators; the order of the forms is the order of the angles.
    number : callable
        Number type of the constants.

    Returns
    -------
    Action
        The table.
    """
    layout = _Layout()
    for part in parts:
        blocks = [blocks_of(matrices.combination(form, number), roundoff(number)) for form in part.forms]
        groups = [
            group for angle, level in enumerate(_levels(blocks)) for group in _groups(angle, level, blocks[angle])
        ]
        for chain in _chains(groups):
            layout.add_run(chain)
        layout.end_part()
    return layout.action(matrices.size, number)


class _Group(NamedTuple):
    """Blocks of one kind that share an angle (and their constants, unless they are shears)."""

    angle: int
    level: int
    rank: int
    blocks: tuple[Block, ...]

    @property
    def shape(self) -> tuple[Kind, int]:
        return self.blocks[0].kind, len(self.blocks)


def _levels(blocks: Sequence[Sequence[Block]]) -> list[int]:
    """Return a level for each angle: generators of one level have no coordinate in common, and one level follows the
    other.

    The generators of a part commute, but a single block of one need not commute with a single block of another that it
    overlaps.
    """
    reached: dict[int, int] = {}
    levels = []
    for own in blocks:
        coordinates = {k for block in own for k in block.coordinates}
        level = max((reached[k] + 1 for k in coordinates if k in reached), default=0)
        reached.update(dict.fromkeys(coordinates, level))
        levels.append(level)
    return levels


def _groups(angle: int, level: int, blocks: Iterable[Block]) -> Iterable[_Group]:
    alike: dict[Any, list[Block]] = {}
    for place, block in enumerate(blocks):
        shared: Any = block.constants
        if block.kind == Kind.SHEAR:
            shared = ()
        elif block.kind in (Kind.CUBIC, Kind.SERIES):
            shared = place
        alike.setdefault((block.kind, shared), []).append(block)
    ranks: dict[tuple[Kind, int], int] = {}
    for members in alike.values():
        shape = (members[0].kind, len(members))
        ranks[shape] = rank = ranks.get(shape, -1) + 1
        yield _Group(angle, level, rank, tuple(members))


def _chains(groups: Iterable[_Group]) -> Iterable[list[_Group]]:
    """Join groups of one shape whose angles follow each other; within a level no blocks share coordinates."""
    chain: list[_Group] = []
    for group in sorted(groups, key=lambda g: (g.level, g.shape, g.rank, g.angle)):
        last = chain[-1] if chain else None
        follows = last and (group.level, group.shape, group.angle) == (last.level, last.shape, last.angle + 1)
        if follows and group.shape[0] not in (Kind.CUBIC, Kind.SERIES):
            chain.append(group)
            continue
        if chain:
            yield chain
        chain = [group]
    if chain:
        yield chain


class _Layout:
    """Collects the columns of an action."""

    def __init__(self) -> None:
        self.run = [0]
        self.rows: list[tuple[int, ...]] = []
        self.indices: list[int] = []
        self.constants: list[Any] = []

    def add_run(self, chain: Sequence[_Group]) -> None:
        first = chain[0].blocks[0]
        start = (len(self.indices), len(self.constants))
        for group in chain:
            for block in group.blocks:
                self.indices.extend(block.coordinates)
            alike = group.blocks if first.kind == Kind.SHEAR else group.blocks[:1]
            for block in alike:
                self.constants.extend(block.constants)
        if first.entries:
            rows = [entry[0] for entry in first.entries]
            self.indices.extend(bisect_left(rows, row) for row in range(len(first.coordinates) + 1))
            self.indices.extend(entry[1] for entry in first.entries)
            for item in range(2, len(first.entries[0])):
                self.constants.extend(entry[item] for entry in first.entries)
        self.rows.append(
            (first.kind, len(chain), len(chain[0].blocks), chain[0].angle, *start)
            + (len(first.coordinates), len(first.entries), first.degree)
        )

    def end_part(self) -> None:
        self.run.append(len(self.rows))

    def action(self, size: int, number: Number) -> Action:
        columns = np.array(self.rows, dtype=np.uint32).reshape(-1, 9).T.copy()
        kind, angles, repeat, angle, place, constant, width, entries, degree = columns
        return Action(
            size=size,
            run=np.array(self.run, dtype=np.uint32),
            kind=kind.astype(np.uint8),
            angles=angles,
            repeat=repeat,
            angle=angle,
            place=place,
            constant=constant,
            width=width,
            entries=entries,
            degree=degree,
            indices=np.array(self.indices, dtype=np.uint32),
            constants=array_of(number, self.constants),
        )


def empty_action() -> Action:
    """Return the action on nothing: no group element is carried."""
    return _Layout().action(0, float)
