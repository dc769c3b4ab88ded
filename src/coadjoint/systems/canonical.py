"""Canonical variables (q, p) added to a Lie algebra, by a Heisenberg algebra at central coordinate 1."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.phase_space import heisenberg
from coadjoint.algebra.families.products import direct_sum
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.validation import read_finite


def with_canonical_pairs(pairs: int, g: LieAlgebra) -> LieAlgebra:
    """Return the direct sum of `heisenberg(pairs)` and g, with coordinates q1, ..., qn, p1, ..., pn, z, g."""
    # At z = 1 and sign +1 it gives ``q' = dH/dp``, ``p' = -dH/dq`` and the equations on g*; sign -1 reverses time.
    algebra = direct_sum(heisenberg(pairs), g)
    casimirs = {name.rpartition(" [")[0]: casimir for name, casimir in algebra.casimirs_known.items()}
    return LieAlgebra._from_valid(
        algebra.triples, algebra.dim, algebra.basis, algebra.name, algebra.representation, casimirs
    )


@suggest_keywords
def canonical_state(q: Any, p: Any, x: Any = ()) -> npt.NDArray[np.float64]:
    """Return the state (q, p, 1, x) of a system whose algebra adds canonical pairs to g.

    Parameters
    ----------
    q, p : number or (pairs,)
        Positions and momenta.
    x : (g.dim,)
        Coordinates on g*.

    Returns
    -------
    (2 pairs + 1 + g.dim,) array

    Raises
    ------
    TypeError, ValueError
        Numbers that are not finite, or different numbers of positions and momenta.

    Examples
    --------
    >>> canonical_state([1, 2], [3, 4], [5])
    array([1., 2., 3., 4., 1., 5.])
    """
    positions, momenta = np.atleast_1d(read_finite(q, "q")), np.atleast_1d(read_finite(p, "p"))
    if positions.shape != momenta.shape or positions.ndim > 1:
        raise ValueError(f"q has shape {positions.shape} and p {momenta.shape}; give one number for each pair")
    return np.concatenate([positions, momenta, [1.0], read_finite(x, "x").ravel()])
