"""Rank of J(x) at a generic x; dim - rank is the number of independent Casimirs."""

from __future__ import annotations

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.modular import structure_rank
from coadjoint.algebra.exact.numerical_rank import numerical_structure_rank
from coadjoint.algebra.exact.rational_constants import dyadic_constants, rational_constants


def generic_rank(triples: Triples, dim: int) -> int:
    """Return the rank of J(x) at a generic x: the implementation of `LieAlgebra.generic_rank`.

    Rounded constants treated as exact violate the Jacobi identity and give too large a rank, so the exact rank is used
    only if simple fractions or the exact floats fulfil it; otherwise singular values decide.
    """
    whole = rational_constants(triples, dim)
    if whole is None:
        whole = dyadic_constants(triples, dim)
    if whole is None:
        return numerical_structure_rank(triples, dim)
    return structure_rank(triples.i, triples.j, triples.k, whole, dim)
