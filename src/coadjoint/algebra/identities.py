"""Checks of structure constants: antisymmetry and the Jacobi identity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coadjoint.algebra.constants import Triples, triple_name
from coadjoint.algebra.exact.sparse_sums import DEFECT_FACTOR, chunks, expand, group_max_abs, groups, largest_violation
from coadjoint.rounding import UNIT_ROUNDOFF


def antisymmetric(triples: Triples, dim: int, names: Sequence[str], complete: bool) -> Triples:
    """Check antisymmetry and return the constants with i < j, sorted, unique and nonzero.

    Opposite values may differ by 64 u times the largest constant that involves e_i, or e_j if that is smaller (u =
    2^-53). If not `complete`, a pair listed in one order only defines the other; otherwise unlisted constants are zero.

    Examples
    --------
    >>> given = Triples(np.array([1]), np.array([0]), np.array([1]), np.array([2.0]))
    >>> antisymmetric(given, 2, ("e1", "e2"), False).c
    array([-2.])
    """
    order, starts = groups(triples.i, triples.j, triples.k)
    i, j, k, c = triples.rows(order)
    first = np.repeat(starts, np.diff(np.append(starts, order.size)))
    wrong = np.flatnonzero(c != c[first])
    if wrong.size:
        row = int(wrong[0])
        where = triple_name((int(i[row]), int(j[row]), int(k[row])), names)
        raise ValueError(
            f"structure constant {where} is given twice, as {c[first[row]]:g} and as {c[row]:g}; give it once"
        )
    i, j, k, c = i[starts], j[starts], k[starts], c[starts]
    size = np.zeros(dim)
    np.maximum.at(size, i, np.abs(c))
    np.maximum.at(size, j, np.abs(c))
    allowed = DEFECT_FACTOR * UNIT_ROUNDOFF * np.minimum(size[i], size[j])
    diagonal = np.flatnonzero((i == j) & ((np.abs(c) > allowed) | (not complete and c != 0.0)))
    if diagonal.size:
        row = int(diagonal[0])
        raise ValueError(
            f"[{names[i[row]]}, {names[i[row]]}] (index {i[row]}) must be zero, but has component {c[row]:g} "
            f"along {names[k[row]]}"
        )
    off_diagonal = i != j
    i, j, k, c, allowed = i[off_diagonal], j[off_diagonal], k[off_diagonal], c[off_diagonal], allowed[off_diagonal]
    forward = i < j
    low, high = np.minimum(i, j), np.maximum(i, j)
    order, starts = groups(low * dim + high, k)
    ahead, behind = (
        np.add.reduceat(np.where(side, c, 0.0)[order], starts) if order.size else c[:0] for side in (forward, ~forward)
    )
    allowed = allowed[order[starts]] if order.size else allowed
    low, high, k = low[order[starts]], high[order[starts]], k[order[starts]]
    paired = np.full(low.size, complete)
    if not complete and not forward.all():
        pairs = (i * dim + j)[forward], (j * dim + i)[~forward]
        paired = np.isin(low * dim + high, np.intersect1d(*pairs))
    wrong = np.flatnonzero(paired & (np.abs(0.5 * ahead + 0.5 * behind) > 0.5 * allowed))
    if wrong.size:
        row = int(wrong[0])
        pair = int(low[row]), int(high[row])
        raise ValueError(
            f"antisymmetry violated for {triple_name(pair, names)}: component {names[k[row]]} is {ahead[row]:g} in "
            f"[{names[pair[0]]}, {names[pair[1]]}] and {behind[row]:g} in the opposite order; they must be opposite"
        )
    exact = ahead == -behind
    value = np.where(paired, np.where(exact, ahead, 0.5 * ahead - 0.5 * behind), ahead - behind)
    nonzero = value != 0.0
    return Triples(low[nonzero], high[nonzero], k[nonzero], value[nonzero])


def both_orders(triples: Triples) -> Triples:
    """Return the constants of i < j followed by those of i > j.

    Examples
    --------
    >>> both_orders(Triples(np.array([0]), np.array([1]), np.array([1]), np.array([2.0]))).c
    array([ 2., -2.])
    """
    i, j, k, c = triples
    return Triples(np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k]), np.concatenate([c, -c]))


def check_jacobi(triples: Triples, dim: int, names: Sequence[str]) -> None:
    """Check the Jacobi identity sum_m (c_ab^m c_md^l + c_bd^m c_ma^l + c_da^m c_mb^l) = 0 for all a < b < d and l.

    The tolerance is 64 u times the sum of the absolute products, each constant taken as the largest in its bracket.
    Only products of nonzero constants are formed, in runs of bounded memory; the worst defect of the first bad run is
    reported.

    Examples
    --------
    >>> so3 = Triples(*np.array([[0, 0, 1], [1, 2, 2], [2, 1, 0]]), np.array([1.0, -1.0, 1.0]))
    >>> check_jacobi(so3, 3, ("e1", "e2", "e3"))
    """
    both = both_orders(triples)
    order, _ = groups(both.i, both.j, both.k)
    outer = both.rows(order)  # by first, then second index
    outer_size = group_max_abs(outer.i * dim + outer.j, outer.c)
    order, _ = groups(triples.k, triples.i)
    inner = triples.rows(order)  # by component, then first index
    inner_size = group_max_abs(inner.i * dim + inner.j, inner.c)
    outer_key, inner_key = outer.i * dim + outer.j, inner.k * dim + inner.i
    # The free indices of the other factor must exceed a: a contiguous range of the sorted rows.
    outer_start = np.searchsorted(outer_key, outer.k * dim + outer.i, side="right")
    outer_stop = np.searchsorted(outer_key, (outer.k + 1) * dim)
    outer_stop = np.where(outer.j > outer.i, np.maximum(outer_stop, outer_start), outer_start)
    inner_start = np.searchsorted(inner_key, outer.j * dim + outer.i, side="right")
    inner_stop = np.maximum(np.searchsorted(inner_key, (outer.j + 1) * dim), inner_start)
    costs = (outer_stop - outer_start) + (inner_stop - inner_start)
    for part in chunks(outer.i, costs.astype(np.int64)):
        a, b, m, c = outer.rows(part)
        row, position = expand(outer_start[part], outer_stop[part])  # +-c_ab^m c_md^l
        third = outer.j[position]
        row, position, third = (column[third != b[row]] for column in (row, position, third))
        low, high = np.minimum(b[row], third), np.maximum(b[row], third)
        inner_row, inner_position = expand(inner_start[part], inner_stop[part])  # c_bd^m c_ma^l = -c_am^l c_bd^m
        first = np.concatenate([np.where(b[row] < third, c[row], -c[row]), -c[inner_row]])
        second = np.concatenate([outer.c[position], inner.c[inner_position]])
        size = outer_size[part]
        sizes = (
            np.concatenate([size[row], size[inner_row]]),
            np.concatenate([outer_size[position], inner_size[inner_position]]),
        )
        pair = np.concatenate([a[row] * dim + low, a[inner_row] * dim + inner.i[inner_position]])
        rest = np.concatenate([high * dim + outer.k[position], inner.j[inner_position] * dim + m[inner_row]])
        violation = largest_violation((pair, rest), (first, second), sizes)
        if violation is not None:
            (a_, b_), (d_, l_) = divmod(int(pair[violation[0]]), dim), divmod(int(rest[violation[0]]), dim)
            raise ValueError(
                f"Jacobi identity violated for {triple_name((a_, b_, d_), names)}: defect {violation[1]:.3g} in "
                f"component {names[l_]}, where it must be zero to {DEFECT_FACTOR} units of round-off of its products"
            )
