"""Estimates of the error at the end of a run, by comparison with more accurate runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.powers import error_by_comparison
from coadjoint.analysis.step_error import loses_digits
from coadjoint.methods.forced import effective_scheme
from coadjoint.methods.protocol.method import FinerRun, Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.preparation import Preparation, trial_run
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import Run, advance_in_turns
from coadjoint.runs.start import any_momenta_of
from coadjoint.runs.times import Times
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.evaluation import ignore_overflow

# Numbers of steps of the finer runs, relative to the run; the next one is used if the error is not yet resolved. They
# are not powers of two, so that the rounding of their steps differs from that of the run.
REFINEMENTS = (1.5, 1.75, 2.5, 3.5)
# Differences above this multiple of the expected round-off are truncation errors.
ROUNDOFF_FACTOR = 16.0
# Largest number of saved points of a finer run, and of numbers saved at once.
MAX_SAVED_POINTS = 256
WHOLE_STEP_TOLERANCE = 2.0**-40  # relative tolerance for a whole number of steps
MAX_SAVED_NUMBERS = 2**22
# With fewer steps the error may not scale with the order; a finer run takes at least this many more.
FEW_STEPS = 20


@ignore_overflow
def error_at_end(solution: Solution) -> NDArray[np.float64]:
    """Estimate the relative errors at the end, (1 + groups, members): of the state, and of each group."""
    # The run is compared with one of 1.5 times as many steps, corrected by the order; if the difference is within
    # round-off, also with a further one; and if steps lose many digits, with one that rounds differently.
    system = solution.system
    if system.has_noise:
        raise TypeError(
            f"{system.name} has random forces, whose noise belongs to the step; compare averages of ensembles with two "
            "steps"
        )
    starts = solution._starts
    if starts is None:
        starts, _ = any_momenta_of(system, solution.x0)
    last = np.asarray(solution.x[-1])
    lost = ~np.isfinite(last.reshape(len(starts), -1)).all(axis=1)
    if lost.all():
        raise ValueError(
            "no member has a state at the end of the run: they have not run yet, have failed, or were ended"
        )
    # Those without a last state are replaced, and left out.
    ends, _ = any_momenta_of(
        system, np.where(lost.reshape(-1, *(1,) * (solution.x0.ndim - 1)), solution.x0, last) if lost.any() else last
    )
    time = float(solution.t[-1]) - solution.t_span[0]
    steps = math.ceil(abs(time) / solution.step * (1.0 - WHOLE_STEP_TOLERANCE))
    groups = CoordinateGroups(system)
    if steps == 0:
        return np.zeros((1 + groups.count, len(starts)))
    # Without a choice the growth of rounding is not known, and is taken as a random walk.
    roundoff = UNIT_ROUNDOFF * math.sqrt(steps) if solution.choice is None else solution.choice.roundoff
    squares, counts = np.zeros((1 + groups.count, len(starts))), np.zeros(len(starts), dtype=int)
    pending = np.flatnonzero(~lost)
    order = effective_scheme(system, solution.method).order
    for refinement in REFINEMENTS:
        if not len(pending):
            break
        members = np.arange(len(starts)) if system.is_batch else pending
        finer = finer_run(solution.method, steps, refinement, order)
        distances = _distances(solution, groups, starts[members], ends[members], time, finer)
        distances = distances[:, pending] if system.is_batch else distances
        valid = np.isfinite(distances[0])
        squares[:, pending[valid]] += distances[:, valid] ** 2
        counts[pending[valid]] += 1
        # A single difference within round-off may be small by chance, so a second one is required.
        resolved = valid & ((distances[0] > ROUNDOFF_FACTOR * roundoff) | (counts[pending] == 2))
        pending = pending[~resolved]
    errors = np.sqrt(squares / np.maximum(counts, 1))
    if loses_digits(solution):
        same_steps = FinerRun(solution.method, steps, 0.0)
        rounded = _distances(solution, groups, starts, ends, time, same_steps, advance_in_turns)
        errors = np.maximum(errors, np.where(np.isfinite(rounded), rounded, 0.0))
    errors[:, counts == 0] = np.inf
    errors[:, lost] = np.nan
    return np.maximum(errors, UNIT_ROUNDOFF)


def finer_run(method: Method, steps: int, times: float, order: int) -> FinerRun:
    """Return the scheme and number of steps of a run of `times` as many steps, and the fraction of the error `left`."""
    by_own_steps = method.finer(steps, times)
    if by_own_steps is not None:
        return by_own_steps
    count = math.ceil(times * (steps + FEW_STEPS))
    return FinerRun(method, count, (steps / count) ** order)


def _distances(
    solution: Solution,
    groups: CoordinateGroups,
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    time: float,
    finer: FinerRun,
    advance: Callable[[Run], None] = Run.advance,
) -> NDArray[np.float64]:
    """Return the relative distances from the ends of a finer run, corrected for its error: of states, and of groups."""
    points = max(2, min(MAX_SAVED_POINTS, MAX_SAVED_NUMBERS // starts.shape[1]))
    every = -(-finer.steps // points)
    plan = Times(solution.t_span[0], time / finer.steps, finer.steps, every)
    prepared = Preparation(solution.system, finer.method, abs(plan.h), watch=False)
    size = max(1, MAX_SAVED_NUMBERS // (points * starts.shape[1]))
    size = len(starts) if solution.system.is_batch else size
    if advance is not Run.advance:
        prepared = prepared.in_one_thread()
    chunks = [slice(first, first + size) for first in range(0, len(starts), size)]
    distances = []
    for chunk in chunks:
        distances.append(_distances_of(trial_run(prepared, plan, starts[chunk], advance), groups, ends[chunk]))
    total: NDArray[np.float64] = error_by_comparison(np.concatenate(distances, axis=1), finer.left)
    return total


def _distances_of(run: Run, groups: CoordinateGroups, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    x: Any = run.saved["x"][..., : ends.shape[1]]
    failed = run.state["status"] != 0
    size = np.concatenate([np.linalg.norm(x, axis=2, keepdims=True), groups.norms(x)], axis=2).max(axis=0)
    difference = ends - x[-1]
    distances = np.concatenate([np.linalg.norm(difference, axis=1, keepdims=True), groups.norms(difference)], axis=1)
    # If the size is zero, so is the distance.
    return np.where(failed, np.inf, (distances / np.where(size > 0.0, size, 1.0)).T)
