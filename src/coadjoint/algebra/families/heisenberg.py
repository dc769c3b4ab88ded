"""Heisenberg algebras: canonical variables."""

from __future__ import annotations

import numpy as np

from coadjoint.algebra.constants import Triples, check_algebra_memory
from coadjoint.algebra.families.matrix_bases import MAX_REPRESENTATION_NUMBERS, Sparse, matrices
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.short_repr import short
from coadjoint.validation import read_integer


def heisenberg(n: int = 1) -> LieAlgebra:
    """Return the Heisenberg algebra: [q_i, p_i] = z, in the order q1 ... qn, p1 ... pn, z.

    With the central coordinate z fixed to 1 it carries canonical variables.

    Parameters
    ----------
    n : int, optional
        Number of pairs, from 1; the dimension is 2 n + 1.

    Returns
    -------
    LieAlgebra
        With the representation by (n + 2) x (n + 2) upper triangular matrices (up to 128 MB of them) and the
        Casimir ``"z"``.

    Raises
    ------
    ValueError
        n is not an integer from 1 up.

    Examples
    --------
    >>> heisenberg().basis
    ('q1', 'p1', 'z')
    """
    n = read_integer(n, "n of heisenberg(n)")
    check_algebra_memory(f"heisenberg({short(n)})", 2 * n + 1, n)
    basis = (*(f"q{i}" for i in range(1, n + 1)), *(f"p{i}" for i in range(1, n + 1)), "z")
    rho = None
    if (2 * n + 1) * (n + 2) ** 2 <= MAX_REPRESENTATION_NUMBERS:
        upper = [(i, 0, i + 1, 1.0) for i in range(n)] + [(n + i, i + 1, n + 1, 1.0) for i in range(n)]
        rho = matrices(Sparse([*upper, (2 * n, 0, n + 1, 1.0)]), 2 * n + 1, n + 2)
    q = np.arange(n, dtype=np.int64)
    # All double brackets vanish, so the Jacobi identity holds.
    constants = Triples(q, q + n, np.full(n, 2 * n, dtype=np.int64), np.ones(n))
    z = {"z": Polynomial.variable(2 * n, 2 * n + 1)}
    return LieAlgebra._from_valid(constants, 2 * n + 1, basis, f"heisenberg({n})", rho, z)
