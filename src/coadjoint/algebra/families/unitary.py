"""The unitary algebras su(n) and u(n), represented by real matrices of twice the size."""

from __future__ import annotations

from coadjoint.algebra.constants import check_algebra_memory
from coadjoint.algebra.families.matrix_bases import Entry, Form, matrix_algebra, pairs, real_form, traceless
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.short_repr import short
from coadjoint.validation import read_integer


def _antihermitian(n: int) -> tuple[list[Entry], list[Entry], list[Entry]]:
    """Return for j < k the elements -(i/2)(E_jk + E_kj) and -(1/2)(E_jk - E_kj): real, imaginary, weights."""
    real, imaginary, weights = [], [], []
    for number, (j, k) in enumerate(pairs(n)):
        imaginary += [(2 * number, j, k, -0.5), (2 * number, k, j, -0.5)]
        real += [(2 * number + 1, j, k, -0.5), (2 * number + 1, k, j, 0.5)]
        weights += [(2 * number, j + n, k, -2.0), (2 * number + 1, j, k, -2.0)]
    return real, imaginary, weights


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
