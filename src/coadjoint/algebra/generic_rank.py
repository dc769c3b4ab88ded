"""The rank of J(x) at a generic x: dim - rank is the number of independent Casimirs."""

from __future__ import annotations

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.modular import structure_rank
from coadjoint.algebra.numerical_rank import numerical_structure_rank
from coadjoint.algebra.rational_constants import dyadic_constants, rational_constants


def generic_rank(triples: Triples, dim: int) -> int:
    """Return the rank of J(x) at a generic x: behind `LieAlgebra.generic_rank`, which documents it.

    Rounded constants must not be taken for exact. Taken so, they belong to no Lie algebra, and have a larger rank. They
    are read as simple fractions, or as exact floats, where the Jacobi identity then holds exactly. Elsewhere singular
    values decide the rank.

    Parameters
    ----------
    triples : Triples
        With i < j, sorted, unique.
    dim : int

    Returns
    -------
    int

    Raises
    ------
    ValueError
        In floats, the singular values leave no clear gap.

    Examples
    --------
    >>> import numpy as np
    >>> generic_rank(Triples(*np.array([[0, 0, 1], [1, 2, 2], [2, 1, 0]]), np.array([1.0, -1.0, 1.0])), 3)
    2
    """
    whole = rational_constants(triples, dim)
    if whole is None:
        whole = dyadic_constants(triples, dim)
    if whole is None:
        return numerical_structure_rank(triples, dim)
    return structure_rank(triples.i, triples.j, triples.k, whole, dim)
