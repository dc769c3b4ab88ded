"""Runs from loops of one's own, before their first step."""

from __future__ import annotations

from typing import Any

from coadjoint.runs.run import Run
from coadjoint.runs.run_setup import RunSetup
from coadjoint.runs.start import Start
from coadjoint.runs.times import Times


def started(
    system: Any,
    method: Any,
    loops: Any,
    times: Times,
    start: Start,
    watching: bool,
    workers: int = 1,
    state: Any = None,
) -> Run:
    """Return a run from its start, or from a state."""
    return Run(system, method, RunSetup(loops, times, start.groups.shape, watching, workers), start, state)
