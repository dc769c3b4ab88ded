"""The linear equations for the homogeneous polynomial Casimirs of one degree, and their independent blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.connected import connected, parts
from coadjoint.algebra.constants import Triples
from coadjoint.algebra.joins import DEFECT_FACTOR, UNIT_ROUNDOFF, Integers, expand, groups


class Equations(NamedTuple):
    """Sparse equations A v = 0 for coefficients v, A[rows, columns] = values.

    Parameters
    ----------
    unknowns : int
        Number N of columns.
    rows : (m,) integer array
        Row i N + t says that the monomial t has coefficient zero in the derivative of C along e_i.
    columns : (m,) integer array
    values : (m,) array
        Whole numbers (object or int64) or floats.
    derivations : int
        Number n of the e_i.

    Examples
    --------
    >>> one = np.array([0])
    >>> Equations(1, one, one, one, 1).unknowns
    1
    """

    unknowns: int
    rows: Integers
    columns: Integers
    values: NDArray[Any]
    derivations: int


def monomials(dim: int, degree: int) -> Integers:
    """Return the monomials of a degree as sorted tuples of coordinates, in the order of `Polynomial.monomials`.

    Examples
    --------
    >>> monomials(2, 2).tolist()
    [[0, 0], [0, 1], [1, 1]]
    """
    rows = np.zeros((1, 0), dtype=np.int64)
    for _ in range(degree):
        last = rows[:, -1] if rows.shape[1] else np.zeros(1, dtype=np.int64)
        which, variable = expand(last, np.full(last.size, dim, dtype=np.int64))
        rows = np.column_stack([rows[which], variable])
    return rows


def equations(triples: Triples, values: NDArray[Any], basis: Integers, dim: int) -> Equations:
    """Return the equations sum_jk c_ij^k x_k dC/dx_j = 0, all i: J(x) grad C(x) = 0, monomial by monomial.

    Parameters
    ----------
    triples : Triples
        Indices of the constants, i < j.
    values : (m,) array
        The constants: whole numbers as objects, or floats.
    basis : (N, d) integer array
        From `monomials`.
    dim : int

    Returns
    -------
    Equations
        Each position once, without zeros; a sum of floats below 64 u times its absolute terms is zero (u = 2^-53).

    Examples
    --------
    >>> heisenberg = Triples(np.array([0]), np.array([1]), np.array([2]), np.array([1.0]))
    >>> found = equations(heisenberg, heisenberg.c, monomials(3, 1), 3)  # [e1, e2] = e3
    >>> found.rows.tolist(), found.columns.tolist(), found.values.tolist()
    ([2, 5], [1, 0], [1.0, -1.0])
    """
    count, degree = basis.shape
    acting = np.concatenate([triples.i, triples.j])
    removed = np.concatenate([triples.j, triples.i])
    added = np.concatenate([triples.k, triples.k])
    constants = np.concatenate([values, -values])
    if constants.dtype == object and constants.size:
        if max(map(abs, constants.tolist())) * degree * dim < 2**62:
            constants = constants.astype(np.int64)
    order = np.argsort(removed, kind="stable")
    acting, added, constants = acting[order], added[order], constants[order]
    begin = np.searchsorted(removed[order], np.arange(dim + 1)).astype(np.int64)
    weights = np.int64(dim) ** np.arange(degree - 1, -1, -1, dtype=np.int64)
    keys = basis @ weights
    positions, terms = [], []
    for place in range(degree):
        variable = basis[:, place]
        column, at = expand(begin[variable], begin[variable + 1])
        changed = basis[column]
        changed[:, place] = added[at]
        changed.sort(axis=1)
        target = np.searchsorted(keys, changed @ weights)
        positions.append((acting[at] * count + target) * count + column)
        terms.append(constants[at])
    position, term = np.concatenate(positions), np.concatenate(terms)
    order, starts = groups(position)
    if not order.size:
        return Equations(count, position, position, term, dim)
    value = np.add.reduceat(term[order], starts)
    least = 0.0
    if term.dtype.kind == "f":
        least = DEFECT_FACTOR * UNIT_ROUNDOFF * np.add.reduceat(np.abs(term[order]), starts)
    kept = np.asarray(np.abs(value) > least, dtype=bool)
    rows, columns = np.divmod(position[order[starts]][kept], count)
    return Equations(count, rows, columns, value[kept], dim)


def blocks(given: Equations) -> Iterator[tuple[Integers, Equations]]:
    """Yield the independent blocks: their unknowns, and their equations with unknowns numbered from 0.

    An equation with one unknown says that it is zero: it is left out, which may leave others with one. What is left
    falls apart into blocks without common equations. This finds every grading that the basis shows: the weights of
    diagonal elements, and the signs under reflections of so(n).

    Parameters
    ----------
    given : Equations

    Yields
    ------
    unknowns : sorted integer array
    part : Equations

    Examples
    --------
    >>> sl2 = Triples(*np.array([[0, 0, 1], [1, 2, 2], [0, 1, 2]]), np.array([1.0, -2.0, 1.0]))
    >>> found = blocks(equations(sl2, sl2.c, monomials(3, 2), 3))
    >>> [unknowns.tolist() for unknowns, _ in found]  # x1 x3 and x2^2
    [[2, 3]]
    """
    row_names, rows = np.unique(given.rows, return_inverse=True)
    rows = rows.astype(np.int64)
    columns, values = given.columns, given.values
    alive = np.ones(given.unknowns, dtype=bool)
    while True:
        single = np.bincount(rows, minlength=row_names.size)[rows] == 1
        if not single.any():
            break
        alive[columns[single]] = False
        kept = alive[columns]
        rows, columns, values = rows[kept], columns[kept], values[kept]
    label = connected(given.unknowns + row_names.size, columns, given.unknowns + rows)[: given.unknowns]
    label[~alive] = -1
    order = np.argsort(label[columns], kind="stable")
    owner = label[columns][order]
    place = np.zeros(given.unknowns, dtype=np.int64)
    for members in parts(label):
        if not alive[members[0]]:
            continue
        place[members] = np.arange(members.size)
        at = order[slice(*np.searchsorted(owner, [members[0], members[0] + 1]))]
        # rows keep their derivation: it is where they are cut for the successive kernels
        derivation, target = np.divmod(row_names[rows[at]], given.unknowns)
        _, target = np.unique(target, return_inverse=True)
        width = int(target.max(initial=-1)) + 1
        renamed = derivation * max(width, members.size) + target
        yield members, Equations(max(width, members.size), renamed, place[columns[at]], values[at], given.derivations)


def monomial_count(dim: int, degree: int) -> int:
    """Return the number of monomials of a degree.

    Examples
    --------
    >>> monomial_count(8, 3)
    120
    """
    return math.comb(dim + degree - 1, degree)
