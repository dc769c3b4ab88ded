"""Algebras of commuting matrices, for tests of the flows of parts."""

from typing import Any

import coadjoint as co


def acting(*matrices: Any) -> co.LieAlgebra:
    """Return the algebra of commuting matrices that act on R^m, whose basis elements come last."""
    m = len(matrices[0])
    brackets = {}
    for number, D in enumerate(matrices):
        for j in range(m):
            row = {k: float(D[j, k]) for k in range(m) if D[j, k]}
            if row:
                brackets[j, m + number] = row
    return co.LieAlgebra.from_brackets(m + len(matrices), brackets)
