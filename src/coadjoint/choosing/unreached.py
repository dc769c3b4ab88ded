"""Errors for accuracies that no scheme reaches."""

from __future__ import annotations

import math
from collections.abc import Sequence

from coadjoint.choosing.candidates import Candidate


def too_expensive(candidates: Sequence[Candidate], accuracy: float, time: float) -> ValueError:
    """Return the error for schemes without a step of acceptable cost."""
    return ValueError(
        f"no step of {_scheme_text(candidates)} reaches the accuracy {accuracy:g} over the time {time:g} at "
        "an acceptable cost; ask for a larger error, or for a shorter time"
    )


def below_rounding(candidates: Sequence[Candidate], accuracy: float, time: float, reachable: float) -> ValueError:
    """Return the error for an accuracy below the smallest one that rounding allows."""
    if not reachable < 1.0:
        return none_reached(candidates, time)
    return ValueError(
        f"accuracy {accuracy:g} is below what float64 reaches with {_scheme_text(candidates)} over the time {time:g}; "
        f"with rounding, {rounded_up(reachable)} is the least; ask for that, or for a shorter time"
    )


def none_reached(candidates: Sequence[Candidate], time: float) -> ValueError:
    """Return the error for a motion in which rounding grows to its size."""
    return ValueError(
        f"no accuracy is reached in float64 with {_scheme_text(candidates)} over the time {time:g}: small changes "
        "of the initial state grow to the size of the motion; take a shorter time"
    )


def rounded_up(value: float) -> str:
    """Format a number with two digits, rounded up."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / unit) * unit:.1e}"


def _scheme_text(candidates: Sequence[Candidate]) -> str:
    return str(candidates[0].method) if len(candidates) == 1 else "any scheme"
