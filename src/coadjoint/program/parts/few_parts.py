"""Joining of commuting parts into few parts."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.program.commutation import Commutation, Pairs
from coadjoint.program.parts.first_fit import first_fit
from coadjoint.program.parts.part import Parts
from coadjoint.program.pattern_cache import MAX_PATTERN_SIZE, Pattern

# Above this number parts are joined in the given order only; lattices have thousands, in a good order.
MAX_REORDERED = 64


def few_parts(parts: Parts, commutation: Commutation) -> Parts:
    """Join commuting parts, both input and result sorted by first coordinate, deterministically.

    First fit in the given order; if more than two groups remain, also in the orders of most and of fewest clashes. Not
    always the minimum, since a minimal clique cover is NP-hard.
    """
    if not len(parts):
        return parts
    coupled_pairs = commutation.coupled_pairs(parts)
    noncommuting_pairs = commutation.noncommuting_pairs(parts, coupled_pairs)
    if len(parts) > MAX_PATTERN_SIZE:
        return parts.joined(_few_groups(len(parts), noncommuting_pairs, coupled_pairs))
    return parts.joined(
        _cached_groups(len(parts), Pattern((noncommuting_pairs, coupled_pairs), *noncommuting_pairs, *coupled_pairs))
    )


@lru_cache(maxsize=1024)
def _cached_groups(count: int, pairs: Pattern[tuple[Pairs, Pairs]]) -> Integers:
    return _few_groups(count, *pairs.source)


def _few_groups(count: int, noncommuting_pairs: Pairs, coupled_pairs: Pairs) -> Integers:
    best = first_fit(count, *noncommuting_pairs)
    if best.max() > 1 and count <= MAX_REORDERED:
        one, other = coupled_pairs
        number = np.bincount(np.concatenate([one, other[one != other]]), minlength=count)
        for sign in (-1, 1):
            found = _in_order(np.argsort(sign * number, kind="stable"), *noncommuting_pairs)
            best = found if found.max() < best.max() else best
    return best


def _in_order(order: Integers, first: Integers, second: Integers) -> Integers:
    """Return the groups of first fit in the given order."""
    place = np.argsort(order)
    low, high = np.minimum(place[first], place[second]), np.maximum(place[first], place[second])
    found = first_fit(len(order), low, high)
    return np.asarray(found[place])
