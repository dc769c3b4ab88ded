"""Matrix representations: are they one, what form do they keep, and how do they carry the coadjoint action?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples, triple_name
from coadjoint.algebra.joins import DEFECT_FACTOR, Floats, Integers, chunks, expand, groups, largest_alike, violated
from coadjoint.given import read_numbers
from coadjoint.memory import check_room
from coadjoint.rounding import UNIT_ROUNDOFF

FOLDED_ROWS = 1 << 12  # equations of the linear systems that are folded into a triangle at a time


def read_representation(representation: Any, dim: int | None = None) -> Floats:
    """Return a float64 copy of the matrices of a representation, shape (n, d, d), or say what is wrong with them.

    Examples
    --------
    >>> read_representation([[[1, 0], [0, 1]]]).shape
    (1, 2, 2)
    """
    rho = read_numbers(representation, "representation")
    if rho.ndim != 3 or rho.shape[1] != rho.shape[2] or 0 in rho.shape or dim not in (None, rho.shape[0]):
        count = "n" if dim is None else dim
        raise ValueError(
            f"representation must have shape ({count}, d, d), one matrix per basis element, not {rho.shape}"
        )
    wrong = np.argwhere(~np.isfinite(rho))
    if wrong.size:
        i, a, b = wrong[0].tolist()
        raise ValueError(f"representation[{i}, {a}, {b}] is {rho[i, a, b]}; it must be finite")
    return rho


def check_representation(representation: Any, triples: Triples, dim: int, names: Sequence[str]) -> Floats:
    """Check [rho_i, rho_j] = sum_k c_ij^k rho_k for every pair, entry by entry, from the nonzero entries only.

    Each entry must be below 64 u times the sum of the absolute values of the products in it.

    Parameters
    ----------
    representation : (n, d, d) array
    triples : Triples
        Structure constants with i < j.
    dim : int
    names : sequence of str
        Names of the basis elements, for messages.

    Returns
    -------
    (n, d, d) float64 array, read-only

    Raises
    ------
    TypeError, ValueError
        Not numbers, wrong shape, not finite, or a commutator that is violated, named.

    Examples
    --------
    >>> zero = Triples(*np.zeros((3, 0), dtype=int), np.zeros(0))
    >>> check_representation([[[2.0]]], zero, 1, ("e1",))
    array([[[2.]]])
    """
    rho = read_representation(representation, dim)
    d = rho.shape[1]
    i, a, b = (index.astype(np.int64) for index in np.nonzero(rho))
    v = rho[i, a, b]
    v_size, c_size = largest_alike(i, v), largest_alike(triples.i * dim + triples.j, triples.c)
    by_row, _ = groups(a, i)
    by_column, _ = groups(b, i)
    row_key, column_key = (a * dim + i)[by_row], (b * dim + i)[by_column]
    # for i < j: rho_i rho_j is joined by the columns of rho_i, rho_j rho_i by its rows, c_ij^k rho_k by k
    joins: list[tuple[Integers, Integers]] = []
    for key, middle in ((row_key, b), (column_key, a)):
        start = np.searchsorted(key, middle * dim + i, side="right")
        joins.append((start, np.maximum(np.searchsorted(key, (middle + 1) * dim), start)))
    structure = np.searchsorted(i, triples.k), np.searchsorted(i, triples.k, side="right")
    cost = sum(stop - start for start, stop in joins)
    per_element = np.bincount(i, weights=cost, minlength=dim).astype(np.float64)
    per_element += np.bincount(triples.i, weights=structure[1] - structure[0], minlength=dim)
    for part in chunks(np.arange(dim), per_element.astype(np.int64)):
        entries = slice(*np.searchsorted(i, [part.start, part.stop]))
        listed = slice(*np.searchsorted(triples.i, [part.start, part.stop]))
        one, other = expand(joins[0][0][entries], joins[0][1][entries])
        one, other = one + entries.start, by_row[other]
        two, also = expand(joins[1][0][entries], joins[1][1][entries])
        two, also = two + entries.start, by_column[also]
        row, element = expand(structure[0][listed], structure[1][listed])
        row += listed.start
        pair = [i[one] * dim + i[other], i[two] * dim + i[also], (triples.i * dim + triples.j)[row]]
        place = [a[one] * d + b[other], a[also] * d + b[two], a[element] * d + b[element]]
        keys = np.concatenate(pair), np.concatenate(place)
        factors = np.concatenate([v[one], -v[two], -triples.c[row]]), np.concatenate([v[other], v[also], v[element]])
        sizes = (
            np.concatenate([v_size[one], v_size[two], c_size[row]]),
            np.concatenate([v_size[other], v_size[also], v_size[element]]),
        )
        found = violated(keys, factors, sizes)
        if found is not None:
            first, second = divmod(int(keys[0][found[0]]), dim)
            at = divmod(int(keys[1][found[0]]), d)
            raise ValueError(
                f"representation violates the commutator of {triple_name((first, second), names)}: "
                f"[rho_i, rho_j] - sum_k c_ij^k rho_k has {found[1]:.3g} at {at}, where it must be zero"
            )
    rho.flags.writeable = False
    return rho


def _solutions(left: Floats, right: Floats) -> Floats:
    """Return a basis (r, m, d) of the matrices X with X right_i = left_i X for all i."""
    m, d = left.shape[1], right.shape[1]
    size = np.maximum(np.abs(left).max(axis=(1, 2)), np.abs(right).max(axis=(1, 2)))
    size = np.where(size > 0.0, size, 1.0)[:, None, None]  # every i counts alike, whatever its units
    left, right = left / size, right / size
    per_fold = max(1, FOLDED_ROWS // (m * d))
    folded = 8 * (m * d) ** 2 * (per_fold + 3)
    check_room(folded, f"to look at a representation by {d} x {d} matrices")
    triangle: Floats = np.zeros((0, m * d))
    for begin in range(0, left.shape[0], per_fold):
        blocks = [
            np.kron(np.eye(m), r.T) - np.kron(l, np.eye(d))
            for l, r in zip(left[begin : begin + per_fold], right[begin : begin + per_fold], strict=True)
        ]
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, *blocks]), mode="r"))
    _, singular, basis = np.linalg.svd(triangle, full_matrices=True)
    tolerance = DEFECT_FACTOR * UNIT_ROUNDOFF * m * d * max(float(singular.max(initial=0.0)), UNIT_ROUNDOFF)
    rank = int(np.count_nonzero(singular > tolerance))
    return basis[rank:].reshape(-1, m, d)


def _generic_of_full_rank(basis: Floats) -> Floats | None:
    """Return a seeded random combination of full rank, largest entry 1, or None where there is none.

    A generic combination has the largest rank that any has; the seed makes the answer the same every time.
    """
    if basis.shape[0] == 0:
        return None
    combination = np.tensordot(np.random.default_rng(0).standard_normal(basis.shape[0]), basis, axes=1)
    singular = np.linalg.svd(combination, compute_uv=False)
    m, d = combination.shape
    if m > d or singular[-1] <= DEFECT_FACTOR * UNIT_ROUNDOFF * m * d * singular[0]:
        return None
    return combination / combination.flat[np.argmax(np.abs(combination))]


def invariant_form(rho: Any) -> NDArray[np.float64] | None:
    """Find a nonsingular P with rho_i^T P + P rho_i = 0 for all i: the bilinear form that the group keeps.

    Parameters
    ----------
    rho : (n, d, d) array
        Matrices of a representation.

    Returns
    -------
    (d, d) array, or None
        The identity where all rho_i are skew-symmetric; else a form with largest entry 1; None where every form that is
        kept is singular. Ranks are decided at 64 u times the size of the linear system (u = 2^-53).

    Raises
    ------
    TypeError, ValueError
        rho does not hold finite numbers or has another shape.

    Examples
    --------
    >>> invariant_form([[[0.0, -1.0], [1.0, 0.0]]])
    array([[1., 0.],
           [0., 1.]])
    >>> invariant_form([[[1.0, 0.0], [0.0, 2.0]]]) is None
    True
    """
    matrices = read_representation(rho)
    transposed = matrices.transpose(0, 2, 1)
    if np.array_equal(transposed, -matrices):
        return np.eye(matrices.shape[1])
    return _generic_of_full_rank(_solutions(-transposed, matrices))


def intertwiner(rho: Any, D: Any) -> NDArray[np.float64] | None:
    """Find a T of full row rank with T rho_i = D_i T for all i: it carries vectors of rho to the action D.

    Parameters
    ----------
    rho : (n, d, d) array
        Matrices of a representation.
    D : (n, m, m) array
        Matrices of another one, for instance the coadjoint matrices D_{e_i}.

    Returns
    -------
    (m, d) array, or None
        None where there is none, in particular for d < m. Ranks are decided as in `invariant_form`.

    Raises
    ------
    TypeError, ValueError
        An argument does not hold finite numbers or has another shape, or the two differ in n.

    Examples
    --------
    >>> turn = [[[0.0, -1.0], [1.0, 0.0]]]
    >>> intertwiner(turn, turn).shape
    (2, 2)
    >>> intertwiner(turn, [[[1.0]]]) is None
    True
    """
    matrices = read_representation(rho)
    actions = read_representation(D, matrices.shape[0])
    if actions.shape[1] > matrices.shape[1]:
        return None
    return _generic_of_full_rank(_solutions(actions, matrices))
