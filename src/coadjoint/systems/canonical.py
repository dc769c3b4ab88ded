"""Canonical variables (q, p) beside g*, all of it Lie-Poisson: a Heisenberg algebra whose central coordinate is 1."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.heisenberg import heisenberg
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.products import direct_sum
from coadjoint.given import read_finite


def beside(pairs: int, g: LieAlgebra) -> LieAlgebra:
    """Return the direct sum of `heisenberg(pairs)` and g: canonical variables beside g*.

    Choose it for Hamiltonians of positions and momenta, and of momenta on g*. Where z = 1 and sign = +1, the equations
    are ``q' = dH/dp``, ``p' = -dH/dq`` and those on g*; with sign = -1 time runs backward. z does not change.

    Parameters
    ----------
    pairs : int
        Number of pairs (q_i, p_i).
    g : LieAlgebra
        The other coordinates.

    Returns
    -------
    LieAlgebra
        In the order q1, ..., qn, p1, ..., pn, z, then g. Its Casimirs are ``"z"`` and those that are known of g, by
        their names.

    Examples
    --------
    >>> import coadjoint as co
    >>> g = beside(1, co.algebras.so(3))
    >>> g.basis, list(g.casimirs_known)
    (('q1', 'p1', 'z', 'e1', 'e2', 'e3'), ['z', '|x|^2'])
    >>> H = co.Quadratic([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    >>> co.LiePoissonSystem(g, H).vector_field(canonical_state(0.25, 0.5, [1.0, 2.0, 3.0]))
    array([ 0.5 , -0.25,  0.  ,  0.  ,  0.  ,  0.  ])
    """
    both = direct_sum(heisenberg(pairs), g)
    casimirs = {name.rpartition(" [")[0]: casimir for name, casimir in both.casimirs_known.items()}
    return LieAlgebra._proved(both.triples, both.dim, both.basis, both.name, both.representation, casimirs)


def canonical_state(q: Any, p: Any, x: Any = ()) -> npt.NDArray[np.float64]:
    """Return the state (q, p, 1, x) of a system on `beside`.

    Parameters
    ----------
    q, p : number or (pairs,)
        Positions and momenta.
    x : (g.dim,)
        The other coordinates.

    Returns
    -------
    (2 pairs + 1 + g.dim,) array

    Raises
    ------
    TypeError, ValueError
        Not finite numbers, or not as many positions as momenta.

    Examples
    --------
    >>> canonical_state([1, 2], [3, 4], [5])
    array([1., 2., 3., 4., 1., 5.])
    """
    positions, momenta = np.atleast_1d(read_finite(q, "q")), np.atleast_1d(read_finite(p, "p"))
    if positions.shape != momenta.shape or positions.ndim > 1:
        raise ValueError(f"q has shape {positions.shape} and p {momenta.shape}; give one number for each pair")
    return np.concatenate([positions, momenta, [1.0], read_finite(x, "x").ravel()])
