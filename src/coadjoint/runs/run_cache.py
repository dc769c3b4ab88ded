"""What a prepared run keeps from call to call."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

from coadjoint.runs.times import RecentTimes

if TYPE_CHECKING:
    from coadjoint.runs.crossings.crossings import WatchedEvents
    from coadjoint.runs.derivatives.differentiable_run import DifferentiableRun
    from coadjoint.runs.final_state import FinalStateRun
    from coadjoint.runs.inputs import InputLoops
    from coadjoint.runs.loops.loops import Loops
    from coadjoint.runs.plan import Plan
    from coadjoint.runs.results.observables import Observed


class RunCache:
    """Loops by their steps, and what the last calls have compiled; a copy of a prepared run begins with an empty one.

    Threads share it; what is built holds its lock. A call removes an entry of `ends` while it runs, so that concurrent
    calls never share one.
    """

    def __init__(self, step: float, loops: dict[float, Loops | InputLoops] | None = None) -> None:
        self.lock = threading.RLock()
        self.loops: dict[float, Loops | InputLoops] = {} if loops is None else loops
        self.times = RecentTimes(step)
        self.plan: Plan | None = None
        self.ends: list[FinalStateRun] = []
        self.observed: Observed | None = None
        self.events: WatchedEvents | None = None
        self.derivatives: DifferentiableRun | None = None
        self.of_members: dict[int, Any] = {}
