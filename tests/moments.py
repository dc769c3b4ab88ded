"""The Lie algebra of moments of degrees 2 and 4 of a distribution of q and p, of rank six."""

import coadjoint as co

MOMENTS = [(d - j, j) for d in (2, 4) for j in range(d + 1)]
"""x_ij is the integral of q^i p^j."""


def moments() -> co.LieAlgebra:
    """Return [x_ij, x_kl] = (i l - j k) x_(i+k-1)(j+l-1)."""
    place = {pair: number for number, pair in enumerate(MOMENTS)}
    brackets: dict[tuple[int, int], dict[int, int]] = {}
    for (i, j), a in place.items():
        for (k, m), b in place.items():
            image = (i + k - 1, j + m - 1)
            if a < b and image in place and i * m != j * k:
                brackets[a, b] = {place[image]: i * m - j * k}
    return co.LieAlgebra.from_brackets(len(MOMENTS), brackets, name="moments {2, 4}")
