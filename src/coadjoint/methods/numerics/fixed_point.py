"""When a fixed-point iteration of arrays of JAX or PyTorch ends, and whether its last correction is round-off."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from coadjoint.methods.numerics.solvers import (
    LARGEST_CORRECTION,
    LARGEST_ROUNDOFF,
    LARGEST_SAMPLED,
    SAMPLED,
    SAMPLES,
    STALLED,
)
from coadjoint.rounding import UNIT_ROUNDOFF

# `xp` has the functions of arrays of the library; entries of z have round-off of their own sizes and of `size`.


def corrections(xp: Any, z: Any, found: Any, size: Any) -> Any:
    """Return the relative corrections of entries."""
    change = abs(found - z)
    return xp.where(change > 0.0, change / (abs(found) + size), 0.0)


def is_unfinished(correction: Any, stalled: Any) -> Any:
    """Test the largest correction, which has not fallen in so many iterations: the smaller it is, the fewer of them."""
    falling = (correction > LARGEST_ROUNDOFF) | (stalled < STALLED)
    return falling & ((correction > LARGEST_CORRECTION) | (stalled < 1)) & (correction > 2.0 * UNIT_ROUNDOFF)


def allowed_change(extent: Any, size: Any) -> Any:
    """Return the largest change of a solution of this extent."""
    return LARGEST_CORRECTION * extent + 16.0 * UNIT_ROUNDOFF * size


def is_undecided(change: Any, allowed: Any, extent: Any, size: Any, sample: Any) -> Any:
    """Test whether a change that is not allowed may be the round-off of terms that cancel, which samples decide."""
    return (change > allowed) & (change <= LARGEST_SAMPLED * (extent + size)) & (sample <= SAMPLES)


def sampled(
    xp: Any, largest: Callable[[Any], Any], function: Any, entries: Any, size: Any, sample: Any, *known: Any
) -> tuple[Any, Any, Any]:
    """Return `known`, the solution, its change, and the allowed one, at least the distance at a disturbed point."""
    z, change, allowed = known
    roundings = UNIT_ROUNDOFF * xp.round(8.0 * xp.cos(sample * entries)) * (abs(z) + size)
    found = function(z)
    distance = largest(abs(function(z + roundings) - found))
    return found, xp.minimum(change, largest(abs(found - z))), xp.maximum(allowed, SAMPLED * distance)
