"""Candidate schemes for a system, and the cost of a step of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

from coadjoint.choosing.pilot import Pilot, Trial
from coadjoint.choosing.system_cache import cached_for_system
from coadjoint.kernels.interface import limit
from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.cost_model import MIN_LANE_MEMBERS, Work, newton_work
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.start import momenta_of, representations_of, start_of
from coadjoint.systems.system import System


@dataclass(frozen=True)
class Candidate:
    """A scheme that supports a system, with the work of its step.

    `compensation_open` states whether compensated summation may be chosen, `in_lanes` whether members run side by side,
    `group` is the representation of the group element.
    """

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
        """Whether phase errors grow linearly.

        This holds for symmetric schemes and Poisson maps, and if restored invariants confine the motion to a curve.
        """
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
    system: System, schemes: Sequence[Method], x0: Any, attitude: Any, strict: bool
) -> list[Candidate]:
    """Return the schemes, at least one, that support a system and the attitude requested.

    With `strict`, the ValueError or TypeError of an unsupported scheme is raised; else only if no scheme is left.
    """
    members = len(momenta_of(system, x0)[0])
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
            candidates.append(
                Candidate(system, method, _work_of(system, method, group), compensation_open, in_lanes, group)
            )
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
