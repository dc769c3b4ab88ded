"""The algebras gl, sl, sp, su, u, so(n), so(p, q) and e(n) = se(n); complex matrices as real ones of twice the size."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

from coadjoint.algebra.constants import check_algebra_memory
from coadjoint.algebra.families.matrix_bases import Entry, Form, matrix_algebra, real_form, traceless
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.caching import shared
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import read_integer


@suggest_keywords
@shared
def gl(n: int) -> LieAlgebra:
    """Return gl(n), all n x n matrices, in the basis E_11, E_12, ..., E_nn.

    Parameters
    ----------
    n : int
        Size of the matrices, from 1; the dimension is n^2.

    Returns
    -------
    LieAlgebra
        With these matrices as representation and the Casimirs ``"trace"`` and, for n > 1, ``"quadratic"``,
        sum x_ij x_ji. There are n independent ones; ``casimirs(max_degree=n)`` finds all.

    Raises
    ------
    ValueError
        n is not an integer from 1 up.

    Examples
    --------
    >>> gl(2).casimirs_known["quadratic"]
    x1^2 + 2*x2*x3 + x4^2
    """
    n = read_integer(n, "n of gl(n)")
    check_algebra_memory(f"gl({short(n)})", n * n, n**3)
    basis = [(i * n + j, i, j, 1.0) for i in range(n) for j in range(n)]
    casimirs: dict[str, Form] = {"quadratic": [(i * n + j, j * n + i, 1) for i in range(n) for j in range(n)]}
    trace = [i * n + i for i in range(n)]
    return matrix_algebra(f"gl({n})", basis, basis, n, casimirs if n > 1 else {}, {"trace": trace})


@suggest_keywords
@shared
def sl(n: int = 2) -> LieAlgebra:
    """Return sl(n), the n x n matrices of trace zero.

    sl(2) is A_{3,8}: [e1, e2] = e1, [e1, e3] = -2 e2, [e2, e3] = e3; in terms of (E, H, F) the basis is (F, H/2, E).
    For n >= 3 the basis is E_ij, i != j, in the order 12, 13, ..., n(n-1), and then H_k = E_kk - E_(k+1)(k+1).

    Parameters
    ----------
    n : int, optional
        Size of the matrices, from 2; the dimension is n^2 - 1.

    Returns
    -------
    LieAlgebra
        With these matrices as representation, and the Casimir of the trace form, ``"x1*x3 + x2^2"`` for n = 2 and
        ``"quadratic"`` for n >= 3. There are n - 1 independent ones; ``casimirs(max_degree=n)`` finds all.

    Raises
    ------
    ValueError
        n is not an integer from 2 up.

    Examples
    --------
    >>> sl(2).bracket([1, 0, 0], [0, 0, 1])
    array([ 0., -2.,  0.])
    >>> sl(3)
    LieAlgebra('sl(3)', dim=8, 21 brackets)
    """
    n = read_integer(n, "n of sl(n)", 2)
    check_algebra_memory(f"sl({short(n)})", n * n - 1, 2 * n**3)
    if n == 2:
        matrix_basis = [(0, 1, 0, 1.0), (1, 0, 0, 0.5), (1, 1, 1, -0.5), (2, 0, 1, 1.0)]
        weights = [(0, 1, 0, 1.0), (1, 0, 0, 1.0), (1, 1, 1, -1.0), (2, 0, 1, 1.0)]
        return matrix_algebra("sl(2)", matrix_basis, weights, 2, {"x1*x3 + x2^2": [(0, 2, 1), (1, 1, 1)]})
    number = {pair: k for k, pair in enumerate((i, j) for i in range(n) for j in range(n) if i != j)}
    begin = len(number)
    off_diagonal = [(k, i, j, 1.0) for (i, j), k in number.items()]
    diagonal = [(begin + k, k + d, k + d, 1.0 - 2.0 * d) for k in range(n - 1) for d in (0, 1)]
    weights = [(begin + k, i, i, 1.0) for k in range(n - 1) for i in range(k + 1)]
    form: Form = [(k, number[j, i], 1) for (i, j), k in number.items()]
    return matrix_algebra(
        f"sl({n})", off_diagonal + diagonal, off_diagonal + weights, n, {"quadratic": form + traceless(n, begin, 1)}
    )


@suggest_keywords
@shared
def sp(size: int) -> LieAlgebra:
    """Return sp(2n, R), the matrices (A, B; C, -A^T) with n x n blocks, B and C symmetric: linear Hamiltonian fields.

    The basis is A_ij = E_ij - E_(n+j)(n+i), row by row; then B_ij = E_i(n+j) + E_j(n+i), i < j, with B_ii = E_i(n+i),
    in the order 11, 12, ..., 22, ...; then C_ij, the transposed matrices.

    Parameters
    ----------
    size : int
        Size 2 n of the matrices, even, from 2: ``sp(4)`` is sp(4, R). The dimension is n (2 n + 1).

    Returns
    -------
    LieAlgebra
        With these matrices as representation, and the Casimir ``"quadratic"`` of the trace form. There are n
        independent ones; ``casimirs(max_degree=size)`` finds all.

    Raises
    ------
    ValueError
        size is not an even integer from 2 up.

    Examples
    --------
    >>> sp(2).casimirs_known["quadratic"]
    (1/2)*x1^2 + 2*x2*x3
    """
    size = read_integer(size, "size of sp(size)", 2)
    if size % 2:
        raise ValueError(f"size of sp(size) must be even, not {short(size)}: sp(2n, R) consists of 2n x 2n matrices")
    n = size // 2
    check_algebra_memory(f"sp({short(size)})", n * (size + 1), size**3)
    upper = [(i, j) for i in range(n) for j in range(i, n)]
    b, c = n * n, n * n + len(upper)
    basis = [(i * n + j, i, j, 1.0) for i in range(n) for j in range(n)]
    basis += [(i * n + j, n + j, n + i, -1.0) for i in range(n) for j in range(n)]
    weights = basis[: n * n]
    form: Form = [(i * n + j, j * n + i, Fraction(1, 2)) for i in range(n) for j in range(n)]
    for k, (i, j) in enumerate(upper):
        for row, column in {(i, j), (j, i)}:
            basis += [(b + k, row, n + column, 1.0), (c + k, n + row, column, 1.0)]
        weights = [*weights, (b + k, i, n + j, 1.0), (c + k, n + i, j, 1.0)]
        form.append((b + k, c + k, 2 if i == j else 1))
    return matrix_algebra(f"sp({size})", basis, weights, 2 * n, {"quadratic": form})


def _antihermitian(n: int) -> tuple[list[Entry], list[Entry], list[Entry]]:
    """Return for j < k the elements -(i/2)(E_jk + E_kj) and -(1/2)(E_jk - E_kj): real, imaginary, weights."""
    real, imaginary, weights = [], [], []
    for number, (j, k) in enumerate(combinations(range(n), 2)):
        imaginary += [(2 * number, j, k, -0.5), (2 * number, k, j, -0.5)]
        real += [(2 * number + 1, j, k, -0.5), (2 * number + 1, k, j, 0.5)]
        weights += [(2 * number, j + n, k, -2.0), (2 * number + 1, j, k, -2.0)]
    return real, imaginary, weights


@suggest_keywords
@shared
def su(n: int) -> LieAlgebra:
    """Return su(n), the anti-Hermitian n x n matrices of trace zero.

    The basis is, for each pair j < k in the order 12, 13, ..., 23, ..., first -(i/2)(E_jk + E_kj) and then
    -(1/2)(E_jk - E_kj); after these -(i/2)(E_kk - E_(k+1)(k+1)), k < n. For su(2) it is -(i/2) times the Pauli
    matrices, so that su(2) has the constants of so(3), c_12^3 = +1.

    Parameters
    ----------
    n : int
        Size of the matrices, from 2; the dimension is n^2 - 1.

    Returns
    -------
    LieAlgebra
        With the representation by real 2n x 2n matrices (A, -B; B, A) for A + i B, and the Casimir ``"quadratic"`` of
        the trace form. There are n - 1 independent ones; ``casimirs(max_degree=n)`` finds all.

    Raises
    ------
    ValueError
        n is not an integer from 2 up.

    Examples
    --------
    >>> import coadjoint as co
    >>> su(2) == co.algebras.so(3)
    True
    >>> su(3).casimirs_known["quadratic"].degree
    2
    """
    n = read_integer(n, "n of su(n)", 2)
    check_algebra_memory(f"su({short(n)})", n * n - 1, 3 * n**3)
    real, imaginary, weights = _antihermitian(n)
    begin = n * (n - 1)
    imaginary += [(begin + k, k + d, k + d, d - 0.5) for k in range(n - 1) for d in (0, 1)]
    weights += [(begin + k, i + n, i, -2.0) for k in range(n - 1) for i in range(k + 1)]
    form: Form = [(k, k, 1) for k in range(begin)]
    basis = real_form(real, imaginary, n)
    return matrix_algebra(f"su({n})", basis, weights, 2 * n, {"quadratic": form + traceless(n, begin, 2)})


@suggest_keywords
@shared
def u(n: int) -> LieAlgebra:
    """Return u(n), the anti-Hermitian n x n matrices.

    The basis is that of `su` for the pairs j < k, followed by -(i/2) E_kk, k = 1 ... n.

    Parameters
    ----------
    n : int
        Size of the matrices, from 1; the dimension is n^2.

    Returns
    -------
    LieAlgebra
        With the representation by real 2n x 2n matrices as for `su`, and the Casimirs ``"trace"`` (the sum of the last
        n coordinates) and, for n > 1, ``"quadratic"``. There are n; ``casimirs(max_degree=n)`` finds all.

    Raises
    ------
    ValueError
        n is not an integer from 1 up.

    Examples
    --------
    >>> u(2).casimirs_known
    mappingproxy({'trace': x3 + x4, 'quadratic': x1^2 + x2^2 + 2*x3^2 + 2*x4^2})
    """
    n = read_integer(n, "n of u(n)")
    check_algebra_memory(f"u({short(n)})", n * n, 3 * n**3)
    real, imaginary, weights = _antihermitian(n)
    begin = n * (n - 1)
    imaginary += [(begin + k, k, k, -0.5) for k in range(n)]
    weights += [(begin + k, k + n, k, -2.0) for k in range(n)]
    form: Form = [(k, k, 1 if k < begin else 2) for k in range(n * n)]
    basis = real_form(real, imaginary, n)
    forms = {"quadratic": form} if n > 1 else {}
    return matrix_algebra(f"u({n})", basis, weights, 2 * n, forms, {"trace": range(begin, n * n)})


def rotations(p: int, q: int = 0) -> tuple[list[Entry], list[Entry]]:
    """Return the sparse basis of so(p, q) and its coordinate functions; hat matrices for so(3)."""
    if (p, q) == (3, 0):
        cyclic = ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        weights = [(k, j, i, 1.0) for k, i, j in cyclic]  # hat(e_k) e_i = e_j
        return weights + [(k, i, j, -1.0) for k, i, j in cyclic], weights
    sign = [1.0] * p + [-1.0] * q
    upper = list(enumerate(combinations(range(p + q), 2)))
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
        casimirs[name] = [(k, k, sign[i] * sign[j]) for k, (i, j) in enumerate(combinations(range(size), 2))]
    if size == 4:
        casimirs["Pfaffian"] = [(0, 5, 1), (1, 4, -1), (2, 3, 1)]
    name = f"so({n},{q})" if q else f"so({n})"
    return matrix_algebra(name, basis, weights, size, casimirs, {"x1": [0]} if size == 2 else None)


@suggest_keywords
@shared
def e(n: int = 3) -> LieAlgebra:
    """Return e(n), the rigid motions of n-dimensional space: first rotations, in the basis of so(n), then translations.

    For n = 3 the state is the angular momentum m (x1-x3) and p (x4-x6): the weight vector of a heavy top, or the linear
    momentum of a body in a fluid. For n = 2 the first coordinate is the angular momentum counted clockwise, since
    [e1, e2] = -e3 and [e1, e3] = e2.

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
