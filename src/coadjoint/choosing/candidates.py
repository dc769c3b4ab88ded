"""Candidate schemes for a system, and the cost of a step of each."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from statistics import median
from typing import Any

import numpy as np

from coadjoint.choosing.pilot import REFERENCE, Pilot, Trial, cached_for_system, short_run
from coadjoint.choosing.sample import SAMPLE_SIZE
from coadjoint.kernels.interface import limit
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.cost_model import MIN_LANE_MEMBERS, Work, newton_work
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.run import Run
from coadjoint.runs.start import momenta_of, representations_of, start_of
from coadjoint.systems.batch import Batch
from coadjoint.systems.system import System

# Least duration (seconds) and largest number of steps of a timed run.
MIN_SECONDS = 2e-3
MAX_STEPS = 2**15
# Pairs of timed runs, of the scheme and of the reference; the median of their ratios counts.
PAIRS = 5


@dataclass(frozen=True)
class Candidate:
    """A scheme that supports a system, the work of its step, and whether it may compensate sums and use lanes."""

    system: System
    method: Method
    work: Work
    compensation_open: bool
    in_lanes: bool = False
    group: Any = None

    def reaching(self, tolerance: float) -> Candidate:
        """Return the same scheme, with variable steps, for another tolerance."""
        method = self.method.reaching(self.system, tolerance)
        return replace(self, method=method, work=_work_of(self.system, method, self.group))

    @property
    def summed_exactly(self) -> bool:
        """Whether the momentum is summed with compensation."""
        return self.method.compensates

    @property
    def flows(self) -> int:
        """Number of flows per step; 0 for schemes that are not composed of flows."""
        return self.work.flows

    def cost(self, trial: Trial) -> float:
        """Return the cost of one step, in rotations."""
        work = self.work.cost(trial.iterations, trial.evaluations)
        return work + newton_work(self.system.dim, trial.evaluations / trial.iterations) if trial.newton else work

    @property
    def share(self) -> float:
        """Fraction of the cost of a step per member."""
        return self.work.in_lanes if self.in_lanes else 1.0

    def growth(self, pilot: Pilot, trial: Trial) -> float:
        """Return the ratio of the error at the end of the span to that of a trial."""
        return trial.growth.factor(pilot.windows, 1.0 if self._grows_like_time else 2.0)

    @cached_property
    def _grows_like_time(self) -> bool:
        """Whether phase errors grow linearly: symmetric schemes, Poisson maps, or a motion confined to a curve."""
        if self.method.symmetric or self.method.properties(self.system).poisson:
            return True
        invariants = self.method.restored(self.system)
        return invariants is not None and self.system.dim - len(invariants) <= 2

    def compensated(self) -> Candidate | None:
        """Return the same scheme with compensated summation; None if the choice is not open."""
        method = self.method.with_compensation() if self.compensation_open else None
        if method is None:
            return None
        compensated_work = self.work.compensated
        return replace(self, method=method, work=self.work if compensated_work is None else compensated_work())


def supported_candidates(
    system: System | Batch, schemes: Sequence[Method], x0: Any, attitude: Any, strict: bool
) -> list[Candidate]:
    """Return the schemes, at least one, that support a system; with `strict` the error of any other one is raised."""
    # Members of a batch have one structure, so the first system has the work of each; some more may be unsupported.
    members, systems = len(momenta_of(system, x0)[0]), system.distinct[:SAMPLE_SIZE]
    in_lanes = members >= MIN_LANE_MEMBERS and system.dim <= limit("WIDEST")
    candidates: list[Candidate] = []
    first_error: Exception | None = None
    for method in schemes:
        note_progress(f"the work of {type(method).__name__}")
        try:
            group = representations_of(system, method, attitude)[0]
            if group is not None:
                start_of(system, method, x0, attitude)  # validates the initial group element
            compensation_open = not strict or len(schemes) > 1
            work, *_ = [_work_of(each, method, group) for each in systems]
            candidates.append(Candidate(systems[0], method, work, compensation_open, in_lanes, group))
        except (ValueError, TypeError) as error:
            if strict:
                raise
            first_error = first_error or error
    if not candidates and first_error is not None:
        raise first_error
    return candidates


def _work_of(system: System, method: Method, representation: Any) -> Work:
    if representation is None:
        return cached_for_system(system, ("work", method), partial(_work, system, method, None))
    return _work(system, method, representation)


def _work(system: System, method: Method, representation: Any) -> Work:
    """Return the work of a step; raise ValueError or TypeError if the scheme does not support the system."""
    method.properties(system)
    return method.work(system, representation)


def with_measured_work(pilot: Pilot, candidate: Candidate) -> Candidate:
    """Return a candidate with a step of the user with its measured work; others, and steps that fail, unchanged."""
    # Timed beside the reference scheme, whose work is counted: the result depends little on the speed of the machine.
    if candidate.group is not None or candidate.method.own_steps or candidate.method._counted:
        return candidate
    note_progress(f"timing the steps of {type(candidate.method).__name__}")
    cost = _measured_cost(pilot, candidate.method)
    return candidate if cost is None else replace(candidate, work=Work(lambda iterations, evaluations: cost))


def _measured_cost(pilot: Pilot, method: Method) -> float | None:
    """Return the cost of a step in rotations; None if a run fails."""
    own_count, reference_count = (_count_to_time(pilot, one) for one in (method, REFERENCE))
    if own_count is None or reference_count is None:
        return None
    ratios = []
    for _ in range(PAIRS):
        own, reference = _timed(pilot, method, own_count), _timed(pilot, REFERENCE, reference_count)
        if own is None or reference is None:
            return None
        (_, own_count, own_seconds), (run, reference_count, seconds) = own, reference
        ratios.append((own_seconds / own_count) / (seconds / reference_count))
    iterations, evaluations = (int(run.state[name].sum()) / reference_count for name in ("iterations", "evaluations"))
    return median(ratios) * REFERENCE.work(pilot.system.of_member(0)).cost(iterations, evaluations)


def _timed(pilot: Pilot, method: Method, count: int) -> tuple[Run, int, float] | None:
    """Take about `count` steps from the first member; return the run, their number and seconds, None if they fail."""
    # The steps of a first trial, as in `fit`, from several copies of the state if the window is short.
    step = min(pilot.natural_step * method.order / REFERENCE.order, pilot.window)
    steps = min(count, max(1, math.floor(pilot.window / step)))
    copies = count // steps
    momenta, length = np.repeat(pilot.momenta[:1], copies, axis=0), math.copysign(steps * step, pilot.span)
    system = pilot.system.of_member(0)
    run = short_run(system, method, momenta, pilot.t0, length, steps, steps, advanced=False)
    begun = time.process_time()  # less disturbed by other programs than the time of a clock
    run.advance()
    seconds = time.process_time() - begun
    return None if np.any(run.state["status"]) else (run, copies * steps, seconds)


def _count_to_time(pilot: Pilot, method: Method) -> int | None:
    """Return a number of steps that take `MIN_SECONDS`, by doubling; None if they fail."""
    count = 1
    _timed(pilot, method, count)  # compiles
    while (found := _timed(pilot, method, count)) is not None:
        _, count, seconds = found
        if seconds >= MIN_SECONDS or count >= MAX_STEPS:
            return count
        count *= 2
    return None
