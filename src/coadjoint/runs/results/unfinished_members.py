"""Members of unfinished and interrupted ensembles that have not been computed to the last saved point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coadjoint.short_repr import short

if TYPE_CHECKING:
    from coadjoint.runs.results.solution import Solution


def unfinished_members(solution: Solution) -> NDArray[np.bool_]:
    """Return which members have not been computed to the last saved point, (members,); failed ones are not among them.

    Those of a single run are none, since it ends at its last saved point.
    """
    members = 1 if solution.failed is None else len(solution.failed)
    if solution.failed is None or not solution.incomplete or not len(solution.t):
        return np.zeros(members, dtype=bool)
    if (pending := solution._pending_members) is not None:
        return pending
    waiting = ~np.isfinite(solution.x[-1]).reshape(members, -1).all(axis=1) & ~solution.failed
    return waiting if solution.events is None else waiting & np.isnan(solution.events.ends(members))


def ends_by_events(solution: Solution) -> NDArray[np.float64]:
    """Return the times at which events ended the members; NaN where none did, and for a single run."""
    if solution.failed is None or solution.events is None:
        return np.full(1 if solution.failed is None else len(solution.failed), np.nan)
    return solution.events.ends(len(solution.failed))


def last_times(solution: Solution, unfinished: NDArray[np.bool_], direction: float) -> NDArray[np.float64]:
    """Return the last saved times of unfinished members, (members,); before all times where none is, and of others."""
    ends = np.full(len(unfinished), -direction * np.inf)
    for m in np.flatnonzero(unfinished).tolist():
        saved = np.flatnonzero(np.isfinite(solution.x[:, m]).reshape(len(solution.t), -1).all(axis=1))
        if len(saved):
            ends[m] = solution.t[saved[-1]]
    return ends


def members_text(mask: NDArray[np.bool_]) -> str:
    """Describe members for messages: all, or their numbers."""
    numbers = np.flatnonzero(mask).tolist()
    return "all members" if len(numbers) == len(mask) else f"the members {short(numbers)}"
