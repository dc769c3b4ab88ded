"""Candidate schemes for a system, the cost of a step of each, and the sample of members with which they are tried."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.choosing.pilot import (
    LARGE_ERROR,
    Pilot,
    PilotErrors,
    Trial,
    cached_for_system,
    rates_of,
    short_run,
)
from coadjoint.kernels.interface import limit
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.cost_model import MIN_LANE_MEMBERS, Work, newton_work
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import reference_scheme
from coadjoint.runs.start import momenta_of, representations_of, start_of
from coadjoint.systems.batch import Batch, selected
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.system import System

# Number of members in a pilot, and of the members from which they are selected.
SAMPLE_SIZE = 4
MAX_SCREENED = 256
SCREENING_SCHEME = reference_scheme(4)
# Steps in the time in which the fastest member moves by its own size, and their total number.
STEPS_PER_SIZE = 8
SCREENING_STEPS = 128
# Ratio of the largest error of the chosen scheme among all members to that in the pilot above which the latter is not
# representative: schemes differ in their worst members. Below it, the accuracy is reached nevertheless.
UNSEEN_RATIO = 1.15

Sample = tuple[System | Batch, NDArray[np.float64]]


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


def sample_of(system: System | Batch, momenta: NDArray[np.float64], t0: float, span: float) -> Sample:
    """Return up to 4 members for a pilot, in order: the first, and those with the largest errors in a coarse run."""
    if len(momenta) <= SAMPLE_SIZE:
        return system, momenta
    screened, states = _screened(system, momenta)
    rates = rates_of(screened, CoordinateGroups(screened), states, t0)
    finite = np.isfinite(rates)
    fastest = float(np.max(rates[finite], initial=0.0))
    time = abs(span) if fastest == 0.0 else min(abs(span), SCREENING_STEPS / STEPS_PER_SIZE / fastest)
    errors = _errors_of_members(screened, states, t0, np.copysign(time, span), SCREENING_SCHEME, SCREENING_STEPS)
    # Members with a nonfinite field are selected first, so that the pilot reports them.
    return _worst(screened, states, np.where(finite, np.max(errors, axis=0), np.inf))


def unseen_sample(
    system: System | Batch, momenta: NDArray[np.float64], pilot: Pilot, method: Method, step: float
) -> Sample | None:
    """Return the members with the largest errors of a scheme at the end; None if those of the pilot stand for them."""
    # The whole window, since errors of some members grow late. Few steps rank members alike, unless errors saturate.
    all_steps = max(1, round(pilot.window / step))
    steps = min(SCREENING_STEPS, all_steps)

    def at_end(system: System | Batch, states: NDArray[np.float64]) -> NDArray[np.float64]:
        time = math.copysign(pilot.window, pilot.span)
        growth = map(PilotErrors.of_run, _errors_of_members(system, states, pilot.t0, time, method, steps).T)
        return np.array([each.whole * each.factor(pilot.windows) for each in growth])

    screened, states = _screened(system, momenta)
    while np.max(errors := at_end(screened, states)) > LARGE_ERROR and steps < all_steps:
        steps = min(4 * steps, all_steps)
    known = at_end(pilot.system, pilot.momenta)
    return _worst(screened, states, errors) if np.max(errors) > UNSEEN_RATIO * np.max(known) else None


def _screened(system: System | Batch, momenta: NDArray[np.float64]) -> Sample:
    """Return a sample of at most `MAX_SCREENED` members, evenly over their numbers."""
    members = len(momenta)
    return _members(
        system, momenta, np.unique(np.linspace(0, members - 1, min(members, MAX_SCREENED)).round().astype(np.int64))
    )


def _errors_of_members(
    system: System | Batch, states: NDArray[np.float64], t0: float, time: float, method: Method, steps: int
) -> NDArray[np.float64]:
    """Return the differences (points, members) from a run with half the step, relative to groups; inf if one fails."""
    every = max(1, steps // SCREENING_STEPS)  # bounds the memory of runs of many steps
    full, halved = (short_run(system, method, states, t0, time, k * steps, k * every) for k in (1, 2))
    failed = (full.state["status"] != 0) | (halved.state["status"] != 0)
    groups, x = CoordinateGroups(system), halved.saved["x"]
    return np.where(failed, np.inf, groups.ratios(full.saved["x"][1:] - x[1:], groups.sizes(x)))


def _worst(system: System | Batch, states: NDArray[np.float64], errors: NDArray[np.float64]) -> Sample:
    worst = np.argsort(-errors, kind="stable")[: SAMPLE_SIZE - 1]
    return _members(system, states, np.unique(np.concatenate([[0], worst])))


def _members(system: System | Batch, momenta: NDArray[np.float64], members: NDArray[np.int64]) -> Sample:
    return (selected(system, members) if system.is_batch else system), momenta[members]
