"""Linear equations for the homogeneous polynomial Casimirs of one degree, and their independent blocks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.components import connected, parts
from coadjoint.algebra.exact.sparse_sums import DEFECT_FACTOR, Integers, expand, group_max_abs, groups
from coadjoint.rounding import UNIT_ROUNDOFF

Vector = dict[int, Any]  # unknown -> coefficient, sorted; the first coefficient is 1


class CasimirEquations(NamedTuple):
    """Sparse linear equations for the coefficients v of a polynomial that every derivation e_i annihilates."""

    # In the derivative along e_i, i = along[m], monomial target[m] has the term values[m] v[columns[m]].

    unknowns: int
    along: Integers
    target: Integers
    columns: Integers
    values: NDArray[Any]


def monomial_count(dim: int, degree: int) -> int:
    """Return the number of monomials of a degree in `dim` coordinates."""
    return math.comb(dim + degree - 1, degree)


def monomials(dim: int, degree: int) -> Integers:
    """Return the monomials of a degree as sorted tuples of coordinates, in the order of `Polynomial.monomials`."""
    rows = np.zeros((1, 0), dtype=np.int64)
    for _ in range(degree):
        last = rows[:, -1] if rows.shape[1] else np.zeros(1, dtype=np.int64)
        row, variable = expand(last, np.full(last.size, dim, dtype=np.int64))
        rows = np.column_stack([rows[row], variable])
    return rows


def monomial_positions(basis: Integers, dim: int) -> Integers:
    """Return the positions of sorted tuples in the list `monomials`."""
    count, degree = basis.shape
    result = np.zeros(count, dtype=np.int64)
    previous = np.zeros(count, dtype=np.int64)
    for slot in range(degree):
        # number of tuples of the remaining length with all entries >= a
        counts = np.array([monomial_count(dim - a, degree - slot) for a in range(dim)], dtype=np.int64)
        result += counts[previous] - counts[basis[:, slot]]
        previous = basis[:, slot]
    return result


def equations(triples: Triples, values: NDArray[Any], basis: Integers, dim: int) -> CasimirEquations:
    """Assemble J(x) grad C(x) = 0, sum_jk c_ij^k x_k dC/dx_j = 0 for all i, monomial by monomial.

    Indices are those of `triples` (i < j), constants `values` (integer objects or floats), `basis` (N, degree) from
    `monomials`. A sum of floats below 64 u times its absolute terms counts as zero (u = 2^-53), each constant taken as
    the largest in its bracket, as in the Jacobi check.

    Examples
    --------
    >>> heisenberg = Triples(np.array([0]), np.array([1]), np.array([2]), np.array([1.0]))
    >>> found = equations(heisenberg, heisenberg.c, monomials(3, 1), 3)  # [e1, e2] = e3
    >>> [part.tolist() for part in found[1:]]
    [[0, 1], [2, 2], [1, 0], [1.0, -1.0]]
    """
    count, degree = basis.shape
    acting, removed = np.concatenate([triples.i, triples.j]), np.concatenate([triples.j, triples.i])
    added, constants = np.concatenate([triples.k, triples.k]), np.concatenate([values, -values])
    if constants.dtype == object and max(map(abs, constants.tolist()), default=0) * degree * dim < 2**62:
        constants = constants.astype(np.int64)
    by_removed = np.argsort(removed, kind="stable")
    acting, added, constants = acting[by_removed], added[by_removed], constants[by_removed]
    begin = np.searchsorted(removed[by_removed], np.arange(dim + 1)).astype(np.int64)
    positions, entries = [], []
    for slot in range(degree):
        variable = basis[:, slot]
        column, source = expand(begin[variable], begin[variable + 1])
        changed = basis[column]
        changed[:, slot] = added[source]
        changed.sort(axis=1)
        positions.append((acting[source] * count + monomial_positions(changed, dim)) * count + column)
        entries.append(source)
    position, entry = np.concatenate(positions), np.concatenate(entries)
    term = constants[entry]
    order, starts = groups(position)
    value = np.add.reduceat(term[order], starts) if order.size else term
    tolerance: Any = 0
    if constants.dtype.kind == "f" and order.size:
        sizes = np.tile(group_max_abs(triples.i * dim + triples.j, values), 2)[by_removed]
        tolerance = DEFECT_FACTOR * UNIT_ROUNDOFF * np.add.reduceat(sizes[entry][order], starts)
    nonzero = np.asarray(np.abs(value) > tolerance, dtype=bool)
    row, column = np.divmod(position[order[starts]][nonzero], count)
    along, target = np.divmod(row, count)
    return CasimirEquations(count, along, target, column, value[nonzero])


def blocks(linear_equations: CasimirEquations) -> Iterator[tuple[Integers, CasimirEquations]]:
    """Yield the independent blocks: their sorted unknowns, and their equations renumbered from 0.

    Unknowns that one equation sets to zero are eliminated repeatedly; the remaining equations split into connected
    blocks. This finds every grading visible in the basis: weights of diagonal elements, reflection signs of so(n).

    Examples
    --------
    >>> sl2 = Triples(*np.array([[0, 0, 1], [1, 2, 2], [0, 1, 2]]), np.array([1.0, -2.0, 1.0]))
    >>> found = blocks(equations(sl2, sl2.c, monomials(3, 2), 3))
    >>> [unknowns.tolist() for unknowns, _ in found]  # x1 x3 and x2^2
    [[2, 3]]
    """
    names, rows = np.unique(
        linear_equations.along * linear_equations.unknowns + linear_equations.target, return_inverse=True
    )
    rows = rows.astype(np.int64)
    columns, values = linear_equations.columns, linear_equations.values
    unresolved = np.ones(linear_equations.unknowns, dtype=bool)
    single = np.bincount(rows, minlength=names.size)[rows] == 1
    while single.any():
        unresolved[columns[single]] = False
        remaining = unresolved[columns]
        rows, columns, values = rows[remaining], columns[remaining], values[remaining]
        single = np.bincount(rows, minlength=names.size)[rows] == 1
    label = connected(linear_equations.unknowns + names.size, columns, linear_equations.unknowns + rows)[
        : linear_equations.unknowns
    ]
    order = np.argsort(label[columns], kind="stable")
    owner = label[columns][order]
    local_index = np.zeros(linear_equations.unknowns, dtype=np.int64)
    for members in parts(label):
        if unresolved[members[0]]:
            local_index[members] = np.arange(members.size)
            block_rows = order[slice(*np.searchsorted(owner, [members[0], members[0] + 1]))]
            along, target = np.divmod(names[rows[block_rows]], linear_equations.unknowns)
            target = np.unique(target, return_inverse=True)[1].astype(np.int64)
            yield (
                members,
                CasimirEquations(members.size, along, target, local_index[columns[block_rows]], values[block_rows]),
            )


def solutions(
    linear_equations: CasimirEquations, largest: int, one: Any, block_kernel: Callable[[CasimirEquations], list[Vector]]
) -> list[Vector]:
    """Return the solutions in reduced row echelon form, {unknown: value}, by leading unknown, from those of each block.

    ValueError for a block above `largest` unknowns, which is solved as a dense matrix. `one` is a free coefficient.
    """
    found: list[Vector] = []
    for unknowns, part in blocks(linear_equations):
        if part.unknowns > largest and part.values.size:
            raise ValueError(
                f"{part.unknowns} coefficients of a Casimir are coupled, above the limit of {largest}; "
                f"lower max_degree, or choose a basis with diagonal or sparse brackets"
            )
        of_block = block_kernel(part) if part.values.size else [{index: one} for index in range(part.unknowns)]
        found += [{int(unknowns[index]): value for index, value in vector.items()} for vector in of_block]
    return sorted(found, key=lambda vector: next(iter(vector)))
