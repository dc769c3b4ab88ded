"""Smallest parts of a quadratic Hamiltonian: sets of coupled commuting coordinates, and completed squares."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, connected
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.commutation import has_noncommuting, noncommuting
from coadjoint.program.generators import check_products
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.squares import DENSE_ROW, MAX_RATIONAL_SIZE, Squares, sparse_squares
from coadjoint.program.sparse_rows import SparseRows, order_by, run_starts, starts_of
from coadjoint.program.term_table import rows_of_form
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.repeated_rows import values_at
from coadjoint.systems.hamiltonians.terms import QuadraticTerm

# Number of entries above which the width of squares is checked.
MIN_CHECKED_ENTRIES = 1 << 14


def quadratic_atoms(term: QuadraticTerm, algebra: LieAlgebra, separate: bool) -> Parts:
    """Split a quadratic term into parts of one share each, by the first coordinate of each connected set."""
    label, members, squared = _sets(term, algebra, separate)
    if not separate and np.any(squared):
        terms = separated_products(term, algebra, squared[label] & (label >= 0), label)
        if len(terms) > 1:
            return Parts.concatenate([quadratic_atoms(one, algebra, separate) for one in terms])
    plain = members[~squared[label[members]]]
    atoms = [_coupled(term, plain, label[plain])]
    owner = [label[plain][run_starts(label[plain])]]
    if np.any(squared):
        central = np.diff(algebra.neighbours()[0]) == 0
        squares, cluster = _square_atoms(term, members[squared[label[members]]], label, central)
        atoms, owner = [*atoms, squares], [*owner, cluster]
    return Parts.concatenate(atoms).take(np.argsort(np.concatenate(owner), kind="stable"))


def coupled_atoms(term: QuadraticTerm, algebra: LieAlgebra) -> Parts | None:
    """Return `quadratic_atoms` if all coupled coordinates commute, else None."""
    label, members, squared = _sets(term, algebra, separate=False)
    return None if np.any(squared) else _coupled(term, members, label[members])


def check_width(term: QuadraticTerm, algebra: LieAlgebra) -> None:
    """Raise NotSplittable if completed squares of many coupled coordinates have too many entries."""
    if term.multiplications < MIN_CHECKED_ENTRIES or int(np.diff(term.indptr).max(initial=0)) < DENSE_ROW:
        return
    label, members, squared = _sets(term, algebra, separate=False)
    label = label[members]
    size, entries = np.bincount(label), np.bincount(label, weights=np.diff(term.indptr)[members])
    full = squared & (entries >= DENSE_ROW * size)
    # The generator of a coordinate has as many entries as structure constants contain it.
    i, j, _, _ = algebra.triples
    entries_of = np.bincount(np.concatenate([i, j]), minlength=algebra.dim)
    products = np.bincount(label, weights=entries_of[members]) / 2
    check_products(np.repeat(products[full].astype(np.int64), size[full]), "the Hamiltonian")


def _sets(term: QuadraticTerm, algebra: LieAlgebra, separate: bool) -> tuple[Integers, Integers, NDArray[np.bool_]]:
    """Label the connected sets of coupled coordinates, -1 if a coordinate is unused."""
    used = term.linear != 0
    first: NDArray[Any]
    second: NDArray[Any]
    if (matrix := term.repeated) is not None:
        first, second = matrix.edges()
        used |= matrix.lengths > 0
    else:
        rows = term.rows
        above = rows < term.indices
        first, second = rows[above], term.indices[above].astype(np.int64)
        used[rows] = True
    label = connected(len(term.linear), first, second)
    label[~used] = -1
    members = np.flatnonzero(used)
    members = members[order_by(label[members])]
    size = np.bincount(label[members], minlength=1)
    squared = size > 1
    if not separate:
        squared = squared & has_noncommuting(algebra, label)[: len(size)]
    return label, members, squared


def separated_products(
    term: QuadraticTerm, algebra: LieAlgebra, squared: NDArray[np.bool_], label: Integers
) -> list[QuadraticTerm]:
    """Split the products of large sparse sets into terms of which all coordinates commute; squares would fill up."""
    rows, indices, values, size = term.rows, term.indices, term.values, len(term.linear)
    number = np.bincount(label[squared], minlength=size)
    entries = np.bincount(label[rows][squared[rows]], minlength=size)
    large = squared & ((number > MAX_RATIONAL_SIZE) & (entries < DENSE_ROW * number))[label]
    above = np.flatnonzero((rows < indices) & large[rows])
    i, j = rows[above], indices[above].astype(np.int64)
    bound = noncommuting(algebra, i, j)
    site = connected(size, i[bound], j[bound])
    if np.bincount(site[large], minlength=1).max(initial=0) > MAX_RATIONAL_SIZE:
        return [term]
    between = site[i] != site[j]
    i, j = i[between], j[between]
    pairs = np.stack([i, j], axis=1)
    color = _colors(i, j, algebra)
    # Each entry of M goes with its product, and what concerns one coordinate with the first of its products.
    colors = int(color.max(initial=-1)) + 1
    owner = np.full(size, colors)
    np.minimum.at(owner, pairs.ravel(), np.repeat(color, 2))
    owner[np.bincount(site, minlength=size)[site] > 1] = colors
    of_entry = np.where(rows == indices, owner[rows], colors)
    key = i * size + j
    order = np.argsort(key)
    keys = np.minimum(rows, indices) * size + np.maximum(rows, indices)
    position = np.minimum(np.searchsorted(key[order], keys), len(key) - 1)
    product = key[order][position] == keys if len(key) else np.zeros(len(keys), dtype=bool)
    of_entry[product] = color[order][position[product]]
    terms: list[QuadraticTerm] = []
    for c in range(colors + 1):
        chosen = of_entry == c
        linear = np.where(owner == c, term.linear, 0.0)
        if np.any(chosen) or np.any(linear):
            indptr = np.searchsorted(rows[chosen], np.arange(size + 1))
            constant = term.constant if not terms else 0 * term.constant
            terms.append(
                QuadraticTerm(indptr, indices[chosen], values[chosen], linear, constant=constant, piece=term.piece)
            )
    return terms


def _colors(i: Integers, j: Integers, algebra: LieAlgebra) -> Integers:
    """Return the groups of products x_i x_j by first fit: in a group all coordinates commute."""
    start, indices = (column.tolist() for column in algebra.neighbours())
    others = [indices[first:last] for first, last in pairwise(start)]
    groups = [0] * len(others)  # of the products with each coordinate, as bits
    color = []
    for first, second in zip(i.tolist(), j.tolist(), strict=True):
        taken = 0
        for k in others[first]:
            taken |= groups[k]
        for k in others[second]:
            taken |= groups[k]
        free = ~taken & (taken + 1)
        groups[first] |= free
        groups[second] |= free
        color.append(free.bit_length() - 1)
    return np.array(color, dtype=np.int64)


def _coupled(term: QuadraticTerm, members: Integers, label: Integers) -> Parts:
    """Build one part per set of coordinates, with the rows of M as angles."""
    row = np.append(np.flatnonzero(run_starts(label)), len(members))
    matrix = rows_of_form(term)
    weights = matrix if len(members) == len(term.linear) and np.all(np.diff(members) == 1) else matrix.take(members)
    units = SparseRows.units(members)
    return Parts.linear(units, values_at(term.linear, members), weights.with_target(units.coordinate), row, source=0)


def _square_atoms(
    term: QuadraticTerm, members: Integers, label: Integers, central: NDArray[np.bool_]
) -> tuple[Parts, Integers]:
    """Build one part per completed square; also return the label of its set."""
    ends = np.append(np.flatnonzero(run_starts(label[members])), len(members))
    local_index = np.zeros(len(term.linear), dtype=np.int64)
    local_index[members] = np.arange(len(members)) - np.repeat(ends[:-1], np.diff(ends))
    matrix = rows_of_form(term).take(members)
    local, linear = local_index[matrix.coordinate], term.linear[members]
    cache: dict[Any, Squares] = {}
    squares: list[Squares] = []
    for first, last in pairwise(ends.tolist()):
        start, entries = matrix.start[first : last + 1], slice(*matrix.start[[first, last]])
        block = SparseRows(start - start[0], local[entries].astype(np.uint32), matrix.value[entries])
        # Sets that repeat, as in a lattice, have equal squares, which are computed once.
        own = central[members[first:last]]
        key = tuple(column.tobytes() for column in (*block, linear[first:last], own))
        if key not in cache:
            cache[key] = _without_rounding(sparse_squares(block, linear[first:last], own), block.value)
        squares.append(cache[key])
    counts = np.array([len(square.weights) for square in squares])
    forms = SparseRows.concatenate([square.forms for square in squares])
    shift = np.repeat(ends[:-1], [len(square.forms.value) for square in squares])
    forms = forms._replace(coordinate=members[forms.coordinate + shift].astype(np.uint32))
    factor = np.concatenate([square.weights for square in squares])
    used = factor != 0
    used_forms = forms.take(np.flatnonzero(used))
    lengths = np.where(used, np.diff(forms.start), 0)
    weights = SparseRows(
        starts_of(lengths), used_forms.coordinate, np.repeat(factor[used], np.diff(used_forms.start)) * used_forms.value
    )
    offset = np.concatenate([square.linear for square in squares])
    parts = Parts.linear(forms, offset, weights, np.arange(len(factor) + 1))
    if np.diff(ends).max() > MAX_RATIONAL_SIZE:
        parts.pivots = np.concatenate([square.pivots for square in squares])
        parts.pivots[:, 1:] = members[parts.pivots[:, 1:] + np.repeat(ends[:-1], counts)[:, None]]
    return parts, np.repeat(label[members[ends[:-1]]], counts)


def _without_rounding(squares: Squares, entries: NDArray[np.float64]) -> Squares:
    """Drop squares below the rounding of the entries, which vanish after a Casimir shift."""
    # The entries are differences, rounded twice, and each pivot twice again.
    floor = 8 * UNIT_ROUNDOFF * np.max(np.abs(entries))
    largest = np.maximum.reduceat(np.abs(squares.forms.value), squares.forms.start[:-1])
    significant = np.flatnonzero((squares.linear != 0) | (np.abs(squares.weights) * largest**2 > floor))
    rest = (column[significant] for column in squares[1:])
    return Squares(squares.forms.take(significant), *rest)
