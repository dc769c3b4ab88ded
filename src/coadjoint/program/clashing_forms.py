"""Which of many long linear forms surely do not commute? Told by single components of their brackets, all at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.joins import Floats, Integers
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.sparse_rows import order_by, starts_of
from coadjoint.rounding import UNIT_ROUNDOFF

# A bracket of two forms is zero where it is below this many units of round-off of its products.
BRACKET_ROUNDOFF = 16 * UNIT_ROUNDOFF
# A product of matrices costs so much less for each multiplication than sorting products does.
CHEAPER = 32


def surely_clashing(
    forms: Floats, algebra: LieAlgebra, first: Integers, second: Integers, costs: Integers
) -> NDArray[np.bool_]:
    """Return for pairs of forms whether a component of their bracket is nonzero by far more than rounding can do.

    Two long forms that have nothing to do with each other are told apart by one component or two, of as many as the
    algebra has. What is not told here is left to the sum of all products. That a component is nonzero is said where
    both ways of adding it up say so, whatever their order, so that the answer is the same on every machine.

    Parameters
    ----------
    forms : ndarray, shape (forms, n)
        Dense.
    algebra : LieAlgebra
        Where they are added up.
    first, second : integer arrays, shape (pairs,)
        The pairs.
    costs : integer array, shape (pairs,)
        How many products the whole bracket of each pair has.

    Returns
    -------
    ndarray of bool, shape (pairs,)

    Examples
    --------
    >>> import coadjoint as co
    >>> forms = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [3.0, 0.0, 0.0]])
    >>> pairs = np.array([0, 0]), np.array([1, 2])
    >>> surely_clashing(forms, co.algebras.so(3), *pairs, np.full(2, 10**6)).tolist()
    [True, False]
    """
    size = forms.shape[1]
    i, j, k, c = algebra.triples
    order = order_by(k)
    i, j, c = i[order], j[order], c[order]
    count = np.bincount(k, minlength=size)
    start = starts_of(count)
    found = np.zeros(len(first), dtype=bool)
    left = np.arange(len(first))
    # The components with the most products tell the most. A sum of m products is wrong by less than m round-offs.
    for component in np.argsort(-count, kind="stable").tolist():
        own = slice(start[component], start[component + 1])
        products = 4 * count[component] * len(forms) ** 2
        if not products or CHEAPER * int(costs[left].sum()) < products:
            break
        one, other = c[own] * forms[:, i[own]], forms[:, j[own]]
        half, size_of_half = one @ other.T, np.abs(one) @ np.abs(other).T
        bracket, bound = half - half.T, size_of_half + size_of_half.T
        sure = np.abs(bracket) > (BRACKET_ROUNDOFF + 8 * count[component] * UNIT_ROUNDOFF) * bound
        told = sure[first[left], second[left]]
        found[left[told]] = True
        left = left[~told]
    return found
