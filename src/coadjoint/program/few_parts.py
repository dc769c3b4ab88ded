"""How few parts? Parts that commute are joined."""

from __future__ import annotations

import numpy as np

from coadjoint.algebra.joins import Integers
from coadjoint.program.commutation import Commutation
from coadjoint.program.first_fit import first_fit
from coadjoint.program.parts import Parts

# Larger sets of parts are joined in one order alone: a lattice has thousands, and comes in a good one.
MOST_REORDERED = 64


def few_parts(parts: Parts, commutation: Commutation) -> Parts:
    """Join parts that commute: few, in a fixed order, not always the fewest (a clique cover is NP-hard).

    First fit in the given order and, where that leaves more than two, in the orders of most and of fewest clashes.

    Parameters
    ----------
    parts : Parts
        Sorted by their first coordinates.
    commutation : Commutation
        Of the algebra.

    Returns
    -------
    Parts
        Sorted by their first coordinates.
    """
    if not len(parts):
        return parts
    clashes = commutation.clashes(parts)
    best = first_fit(len(parts), *clashes)
    if best.max() > 1 and len(parts) <= MOST_REORDERED:
        one, other = commutation.clashes(parts, by_coordinates=True)
        ends = np.concatenate([one, other[one != other]])
        number = np.bincount(ends, minlength=len(parts))
        for sign in (-1, 1):
            found = _in_order(np.argsort(sign * number, kind="stable"), *clashes)
            best = found if found.max() < best.max() else best
    return parts.joined(best)


def _in_order(order: Integers, first: Integers, second: Integers) -> Integers:
    """Return the groups of first fit where the parts come in the given order."""
    place = np.argsort(order)
    low, high = np.minimum(place[first], place[second]), np.maximum(place[first], place[second])
    found = first_fit(len(order), low, high)
    return np.asarray(found[place])
