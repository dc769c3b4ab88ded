"""The Heisenberg algebras: canonical variables."""

from __future__ import annotations

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.matrix_algebras import Sparse, matrices, whole
from coadjoint.algebra.polynomial import Polynomial


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
    n = whole(n, 1, "n of heisenberg(n)")
    basis = [f"q{i}" for i in range(1, n + 1)] + [f"p{i}" for i in range(1, n + 1)] + ["z"]
    upper = [(i, 0, i + 1, 1.0) for i in range(n)] + [(n + i, i + 1, n + 1, 1.0) for i in range(n)]
    rho = matrices(Sparse([*upper, (2 * n, 0, n + 1, 1.0)]), 2 * n + 1, n + 2)
    return LieAlgebra(
        [(i, n + i, 2 * n, 1.0) for i in range(n)],
        dim=2 * n + 1,
        basis=basis,
        name=f"heisenberg({n})",
        representation=rho,
        casimirs={"z": Polynomial.variable(2 * n, 2 * n + 1)},
    )
