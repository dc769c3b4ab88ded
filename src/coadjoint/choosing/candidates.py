"""Which schemes can serve a system, and what does a step of each cost?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from coadjoint.choosing.pilot import Pilot, Trial
from coadjoint.choosing.work import CROWD, FLOWS_OF_A_CROWD, WIDEST_CROWD, newton_work, step_work
from coadjoint.methods.base import FlowMethod, Method
from coadjoint.methods.splitting import Splitting
from coadjoint.methods.step_method import StepMethod
from coadjoint.program.table import Program, build_program
from coadjoint.runs.start import start_of
from coadjoint.systems.kinds import System
from coadjoint.systems.lie_poisson import LiePoissonSystem


@dataclass(frozen=True)
class Candidate:
    """A scheme that serves a system, with its table if it is made of flows; a `crowd` of members goes side by side."""

    system: System
    method: Method
    program: Program | None
    group: Any
    free: bool
    crowd: bool = False

    @property
    def summed_exactly(self) -> bool:
        """Whether the momentum is summed with compensation: always, but in splittings."""
        return not isinstance(self.method, FlowMethod) or self.program is None or bool(self.method.compensated)

    @property
    def flows(self) -> int:
        """Flows of a step; none in other schemes."""
        return 0 if self.program is None else int(self.program.rows.section[2] - self.program.rows.section[1])

    def cost(self, trial: Trial) -> float:
        """Return the cost of one step, in rotations."""
        work = step_work(self.system, self.method, self.program, trial.iterations, trial.evaluations, self.group)
        return work + newton_work(self.system.dim, trial.evaluations / trial.iterations) if trial.newton else work

    @property
    def share(self) -> float:
        """The part of the cost of a step that each of many members has."""
        return FLOWS_OF_A_CROWD if self.crowd and self.program is not None else 1.0

    def growth(self, pilot: Pilot, trial: Trial) -> float:
        """Return how many times the error of a trial is larger at the end of the span."""
        return trial.growth.factor(pilot.windows, 1.0 if self._grows_like_time() else 2.0)

    def _grows_like_time(self) -> bool:
        """Whether a scheme keeps what would shift phases ever faster: by its symmetry, as a Poisson map, or since all
        that is left of the motion is a curve on which invariants are restored.
        """
        if self.method.symmetric or self.method.properties(self.system).poisson:
            return True
        restored = self.method.restored(self.system) if isinstance(self.method, StepMethod) else None
        return restored is not None and self.system.dim - len(restored) <= 2

    def compensated(self) -> Candidate | None:
        """Return the same splitting summed with compensation; None where that was not left open."""
        if not self.free or not isinstance(self.method, Splitting) or self.method.compensated is not None:
            return None
        return replace(self, method=replace(self.method, compensated=True))


def admitted(system: System, schemes: Sequence[Method], x0: Any, attitude: Any, strict: bool) -> list[Candidate]:
    """Return the schemes that serve a system and carry what is asked for.

    Parameters
    ----------
    system : LiePoissonSystem or PoissonSystem
        What moves.
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
    found: list[Candidate] = []
    refusal: Exception | None = None
    for method in schemes:
        try:
            found.append(_candidate(system, method, x0, attitude, free=not strict or len(schemes) > 1))
        except (ValueError, TypeError) as error:
            if strict:
                raise
            refusal = refusal or error
    if not found and refusal is not None:
        raise refusal
    return found


def _candidate(system: System, method: Method, x0: Any, attitude: Any, free: bool) -> Candidate:
    start = start_of(system, method, x0, attitude)
    group = start.representation
    method.properties(system)
    innermost = method.innermost
    program = None
    if isinstance(method, FlowMethod) and isinstance(innermost, FlowMethod):
        assert isinstance(system, LiePoissonSystem)
        program = build_program(system, method, group=group)
    crowd = len(start.momenta) >= CROWD and system.dim <= WIDEST_CROWD
    return Candidate(system, method, program, group, free, crowd)
