"""Actions of many coordinates of copies of an algebra, such as a lattice of spins: one block for each coordinate."""

from __future__ import annotations

import numpy as np

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.actions import Action
from coadjoint.program.block_table import MIN_REPEATED, block_table, joined_tables
from coadjoint.program.blocks import Kind
from coadjoint.program.generators import BasisMatrices
from coadjoint.program.numbers import roundoff
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import SparseRows

# Largest number of parts, each of which is a run of rotations.
MAX_PARTS = 64


def copied_action(algebra: LieAlgebra, parts: Parts) -> Action | None:
    """Return the coadjoint action of parts of coordinates of copies that each rotate one plane; None for others.

    It is bitwise equal to that of `build_action`, which makes a table of all blocks first.
    """
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
    if not np.array_equal(blocks.angle, np.arange(summand.dim)) or np.any(blocks.kind != Kind.ROTATE):
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
        kind=np.full(runs, Kind.ROTATE, dtype=np.uint8),
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
