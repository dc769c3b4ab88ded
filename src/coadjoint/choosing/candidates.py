"""Which schemes can serve a system, and what does a step of each cost?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

from coadjoint.choosing.pilot import Pilot, Trial
from coadjoint.choosing.remembered import remembered
from coadjoint.kernels.description import limit
from coadjoint.methods.base import Method
from coadjoint.methods.work import CROWD, Work, newton_work
from coadjoint.runs.start import momenta_of, representations_of, start_of
from coadjoint.systems.kinds import System
from coadjoint.waiting import at


@dataclass(frozen=True)
class Candidate:
    """A scheme that serves a system, with the work of its step; a `crowd` of members goes side by side.

    `free` says whether its summation is left open, `group` what a group element is carried in.
    """

    system: System
    method: Method
    work: Work
    free: bool
    crowd: bool = False
    group: Any = None

    def reaching(self, tolerance: float) -> Candidate:
        """Return the same scheme, which takes steps of its own, with another tolerance."""
        method = self.method.reaching(self.system, tolerance)
        return replace(self, method=method, work=_work_of(self.system, method, self.group))

    @property
    def summed_exactly(self) -> bool:
        """Whether the momentum is summed with compensation."""
        return self.method.compensates

    @property
    def flows(self) -> int:
        """Flows of a step; none in schemes that are not made of flows."""
        return self.work.flows

    def cost(self, trial: Trial) -> float:
        """Return the cost of one step, in rotations."""
        work = self.work.cost(trial.iterations, trial.evaluations)
        return work + newton_work(self.system.dim, trial.evaluations / trial.iterations) if trial.newton else work

    @property
    def share(self) -> float:
        """The part of the cost of a step that each of many members has."""
        return self.work.in_a_crowd if self.crowd else 1.0

    def growth(self, pilot: Pilot, trial: Trial) -> float:
        """Return how many times the error of a trial is larger at the end of the span."""
        return trial.growth.factor(pilot.windows, 1.0 if self._grows_like_time else 2.0)

    @cached_property
    def _grows_like_time(self) -> bool:
        """Whether a scheme keeps what would shift phases ever faster: by its symmetry, as a Poisson map, or since all
        that is left of the motion is a curve on which invariants are restored.
        """
        if self.method.symmetric or self.method.properties(self.system).poisson:
            return True
        restored = self.method.restored(self.system)
        return restored is not None and self.system.dim - len(restored) <= 2

    def compensated(self) -> Candidate | None:
        """Return the same scheme summed with compensation; None where that was not left open."""
        better = self.method.with_compensation() if self.free else None
        if better is None:
            return None
        dearer = self.work.compensated
        return replace(self, method=better, work=self.work if dearer is None else dearer())


def admitted(system: System, schemes: Sequence[Method], x0: Any, attitude: Any, strict: bool) -> list[Candidate]:
    """Return the schemes that serve a system and carry what is asked for.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        The system.
    schemes : sequence of Method
        To be looked at, in order.
    x0, attitude
        As for `integrate`.
    strict : bool
        Whether a scheme that does not serve is refused, rather than left out.

    Returns
    -------
    list of Candidate
        At least one.

    Raises
    ------
    ValueError, TypeError
        What a scheme said, if it is refused, or if none is left.
    """
    members = len(momenta_of(system, x0)[0])
    crowd = members >= CROWD and system.dim <= limit("WIDEST")
    found: list[Candidate] = []
    refusal: Exception | None = None
    for method in schemes:
        at(f"the work of {type(method).__name__}")
        try:
            group = representations_of(system, method, attitude)[0]
            if group is not None:
                start_of(system, method, x0, attitude)  # which looks at the element that is given
            free = not strict or len(schemes) > 1
            found.append(Candidate(system, method, _work_of(system, method, group), free, crowd, group))
        except (ValueError, TypeError) as error:
            if strict:
                raise
            refusal = refusal or error
    if not found and refusal is not None:
        raise refusal
    return found


def _work_of(system: System, method: Method, representation: Any) -> Work:
    if representation is None:
        return remembered(system, ("work", method), partial(_work, system, method, None))
    return _work(system, method, representation)


def _work(system: System, method: Method, representation: Any) -> Work:
    """Return the work of a step, if the scheme serves the system."""
    method.properties(system)
    return method.work(system, representation)
