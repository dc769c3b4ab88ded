"""Work of steps that are functions of the user: measured, since the operations in them are not counted."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.pilot import REFERENCE, Pilot, short_run
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.compiled_step import CompiledStepMethod
from coadjoint.methods.protocol.cost_model import Work
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.step_method import StepMethod
from coadjoint.methods.protocol.substep_method import SubstepMethod
from coadjoint.runs.run import Run

# Least duration (seconds) and largest number of steps of a timed run.
MIN_SECONDS = 2e-3
MAX_STEPS = 2**15
# Pairs of timed runs, of the scheme and of the reference; the median of their ratios counts.
PAIRS = 5


def with_measured_work(pilot: Pilot, candidate: Candidate) -> Candidate:
    """Return a candidate with a step of the user with its measured work; others, and steps that fail, unchanged.

    The time of a step is compared with that of the reference scheme in the same moment, whose work is counted, so that
    the result depends little on the speed of the machine and on its load.
    """
    if candidate.group is not None or candidate.method.own_steps or not _is_uncounted(candidate.method):
        return candidate
    note_progress(f"timing the steps of {type(candidate.method).__name__}")
    cost = _measured_cost(pilot, candidate.method)
    return candidate if cost is None else replace(candidate, work=Work(lambda iterations, evaluations: cost))


def _is_uncounted(method: Method) -> bool:
    """Return whether a step, or that of the base of a composition or projection, is of the user and has no `work`."""
    base = getattr(method.expanded, "base", None)
    if isinstance(base, Method):
        return _is_uncounted(base)
    if isinstance(method, StepMethod):
        plain: Any = StepMethod.work_of_substeps
    elif isinstance(method, CompiledStepMethod):
        if isinstance(method.compiled_step, str) or type(method).operations is not CompiledStepMethod.operations:
            return False
        plain = CompiledStepMethod.work_of_substeps
    else:
        return False
    return type(method).work is SubstepMethod.work and type(method).work_of_substeps is plain


def _measured_cost(pilot: Pilot, method: Method) -> float | None:
    """Return the cost of a step in rotations; None if a run fails."""
    timed = [_Timed(pilot, method), _Timed(pilot, REFERENCE)]
    if not all(each.find_count() for each in timed):
        return None
    ratios = []
    for _ in range(PAIRS):
        own, reference = (each.run() for each in timed)
        if own is None or reference is None:
            return None
        own_time, reference_time = (each.seconds / each.count for each in timed)
        ratios.append(own_time / reference_time)
    assert reference is not None
    iterations, evaluations = (
        int(reference.state[name].sum()) / timed[1].count for name in ("iterations", "evaluations")
    )
    return median(ratios) * REFERENCE.work(pilot.system).cost(iterations, evaluations)


class _Timed:
    """Runs of a scheme at the start of a window, of the first member, with `count` steps in total."""

    def __init__(self, pilot: Pilot, method: Method) -> None:
        self._pilot, self._method = pilot, method
        # The steps of a first trial, as in `fit`.
        self._step = min(pilot.natural_step * method.order / REFERENCE.order, pilot.window)
        self._longest = max(1, math.floor(pilot.window / self._step))
        self.count, self.seconds = 1, 0.0

    def run(self) -> Run | None:
        """Take the steps, from several copies of the state if the window is short; None if they fail."""
        pilot, steps = self._pilot, min(self.count, self._longest)
        copies = self.count // steps
        self.count = copies * steps
        momenta = np.repeat(pilot.momenta[:1], copies, axis=0)
        length = math.copysign(steps * self._step, pilot.span)
        run = short_run(pilot.system, self._method, momenta, pilot.t0, length, steps, steps, advanced=False)
        begun = time.process_time()  # less disturbed by other programs than the time of a clock
        run.advance()
        self.seconds = time.process_time() - begun
        return None if np.any(run.state["status"]) else run

    def find_count(self) -> bool:
        """Double the steps until they take `MIN_SECONDS`; return whether they succeed."""
        self.run()  # compiles
        while (run := self.run()) is not None and self.seconds < MIN_SECONDS and self.count < MAX_STEPS:
            self.count *= 2
        return run is not None
