"""The orthogonal algebras so(n) and so(p, q), and the Euclidean algebras e(n) = se(n)."""

from __future__ import annotations

from coadjoint.algebra.constants import check_algebra_memory
from coadjoint.algebra.families.matrix_bases import Entry, Form, matrix_algebra, pairs
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import shared
from coadjoint.short_repr import short
from coadjoint.validation import read_integer


def rotations(p: int, q: int = 0) -> tuple[list[Entry], list[Entry]]:
    """Return the sparse basis of so(p, q) and its coordinate functions; hat matrices for so(3)."""
    if (p, q) == (3, 0):
        cyclic = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        weights = [(k, j, i, 1.0) for k, i, j in cyclic]  # hat(e_k) e_i = e_j
        return weights + [(k, i, j, -1.0) for k, i, j in cyclic], weights
    sign = [1.0] * p + [-1.0] * q
    upper = list(enumerate(pairs(p + q)))
    basis = [entry for k, (i, j) in upper for entry in ((k, i, j, sign[j]), (k, j, i, -sign[i]))]
    return basis, [(k, i, j, sign[j]) for k, (i, j) in upper]


@suggest_keywords
@shared
def so(n: int, q: int = 0) -> LieAlgebra:
    """Return so(n), the skew-symmetric n x n matrices, or so(p, q), the algebra of a form of signature (p, q).

    so(3) has c_12^3 = +1 and the hat matrices, hat(u) v = u x v, as representation. For n >= 4 (and n = 2) the basis is
    E_ij - E_ji, i < j, in the order 12, 13, ..., 1n, 23, ...; these matrices are the representation. For so(p, q) with
    p, q > 0 it is s_j E_ij - s_i E_ji, s_i = 1 for i <= p and -1 after: matrices X with X^T S + S X = 0.

    Parameters
    ----------
    n : int
        Size of the matrices, from 2; the dimension is n (n - 1)/2. With q > 0 the number p of positive signs, from 0;
        the size is p + q.
    q : int, optional
        Number of negative signs.

    Returns
    -------
    LieAlgebra
        With the Casimir ``"|x|^2"`` (``"quadratic"`` for q > 0: sum s_i s_j x_ij^2), and ``"Pfaffian"`` for size 4.
        so(2) is abelian and has ``"x1"``. There are floor(n/2) independent ones; ``casimirs(max_degree=n)`` finds all.

    Raises
    ------
    ValueError
        n or q is not an integer, or their sum is below 2.

    Examples
    --------
    >>> so(4)
    LieAlgebra('so(4)', dim=6, 12 brackets)
    >>> so(4).casimirs_known["Pfaffian"]
    x1*x6 - x2*x5 + x3*x4
    >>> so(3, 1).casimirs_known["quadratic"]
    x1^2 + x2^2 - x3^2 + x4^2 - x5^2 - x6^2
    """
    q = read_integer(q, "q of so(p, q)", 0)
    n = read_integer(n, "n of so(n)", 2) if q == 0 else read_integer(n, "p of so(p, q)", max(0, 2 - q))
    if n == 0:
        return so(q)
    size = n + q
    check_algebra_memory(f"so({short(size)})", size * (size - 1) // 2, size * (size - 1) * (size - 2) // 2)
    basis, weights = rotations(n, q)
    sign = [1] * n + [-1] * q
    casimirs: dict[str, Form] = {}
    if size > 2:
        name = "quadratic" if q else "|x|^2"
        casimirs[name] = [(k, k, sign[i] * sign[j]) for k, (i, j) in enumerate(pairs(size))]
    if size == 4:
        casimirs["Pfaffian"] = [(0, 5, 1), (1, 4, -1), (2, 3, 1)]
    name = f"so({n},{q})" if q else f"so({n})"
    return matrix_algebra(name, basis, weights, size, casimirs, {"x1": [0]} if size == 2 else None)


@suggest_keywords
@shared
def e(n: int = 3) -> LieAlgebra:
    """Return e(n), the rigid motions of n-dimensional space: first rotations, in the basis of so(n), then translations.

    For n = 3 the state is the angular momentum m (x1-x3) and p (x4-x6): the weight vector of a heavy top, or the linear
    momentum of a body in a fluid.

    Parameters
    ----------
    n : int, optional
        Dimension of the space, from 2; that of the algebra is n (n + 1)/2.

    Returns
    -------
    LieAlgebra
        With the representation by affine (n + 1) x (n + 1) matrices and the Casimirs ``"|p|^2"``, the sum of the
        squares of the last n coordinates, and for n = 3 ``"m.p"`` = x1 x4 + x2 x5 + x3 x6. There are floor((n + 1)/2)
        independent ones; ``casimirs(max_degree=n)`` finds all.

    Raises
    ------
    ValueError
        n is not an integer from 2 up.

    Examples
    --------
    >>> e(3).casimirs_known["m.p"]
    x1*x4 + x2*x5 + x3*x6
    >>> e(2).casimirs_known["|p|^2"]
    x2^2 + x3^2
    """
    n = read_integer(n, "n of e(n)", 2)
    check_algebra_memory(f"e({short(n)})", n * (n + 1) // 2, n * n * (n - 1) // 2)
    basis, weights = rotations(n)
    begin = n * (n - 1) // 2
    translations = [(begin + i, i, n, 1.0) for i in range(n)]
    casimirs: dict[str, Form] = {"|p|^2": [(begin + i, begin + i, 1) for i in range(n)]}
    if n == 3:
        casimirs["m.p"] = [(i, i + 3, 1) for i in range(3)]
    return matrix_algebra(f"e({n})", basis + translations, weights + translations, n + 1, casimirs)


@suggest_keywords
@shared
def se(n: int = 3) -> LieAlgebra:
    """Return se(n), the algebra of the special Euclidean group: it is e(n), another name for the same algebra.

    Parameters
    ----------
    n : int, optional
        As for `e`.

    Returns
    -------
    LieAlgebra

    Raises
    ------
    ValueError
        n is not an integer from 2 up.

    Examples
    --------
    >>> se(3) == e(3)
    True
    """
    return e(read_integer(n, "n of se(n)", 2))
