"""Estimates of the error at the end of a run, by comparison with more accurate runs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.method import Method
from coadjoint.methods.protocol.own_steps import FinerRun, OwnSteps
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.start import momenta_of, with_group
from coadjoint.runs.times import Times
from coadjoint.systems.protocol import forces_of, is_batch

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


def error_at_end(solution: Solution) -> NDArray[np.float64]:
    """Estimate the error of each member at the end of a run, shape (members,), relative to its largest momentum.

    The run is compared with one of 1.5 times as many steps, corrected by the order; if the difference is within
    round-off, also with a further one. Infinite if all four finer runs fail; NaN without a last state.
    """
    system = solution.system
    if any(force.random for _, force in forces_of(system)):
        raise TypeError(
            f"{system.name} has random forces, whose noise belongs to the step; compare averages of ensembles with two "
            "steps"
        )
    starts = solution.record.starts
    if starts is None:
        starts, _ = momenta_of(system, solution.x0)
    last = np.asarray(solution.x[-1])
    lost = ~np.isfinite(last.reshape(len(starts), -1)).all(axis=1)
    if lost.all():
        raise ValueError(
            "no member has a state at the end of the run: they have not run yet, have failed, or were ended"
        )
    # Those without a last state are replaced, and left out.
    ends, _ = momenta_of(
        system, np.where(lost.reshape(-1, *(1,) * (solution.x0.ndim - 1)), solution.x0, last) if lost.any() else last
    )
    time = float(solution.t[-1]) - solution.t_span[0]
    steps = math.ceil(abs(time) / solution.step * (1.0 - WHOLE_STEP_TOLERANCE))
    if steps == 0:
        return np.zeros(len(starts))
    # Without a choice the growth of rounding is not known, and is taken as a random walk.
    roundoff = UNIT_ROUNDOFF * math.sqrt(steps) if solution.choice is None else solution.choice.roundoff
    squares, counts, pending = np.zeros(len(starts)), np.zeros(len(starts), dtype=int), np.flatnonzero(~lost)
    for refinement in REFINEMENTS:
        if not len(pending):
            break
        members = np.arange(len(starts)) if is_batch(system) else pending
        distances = _distances(solution, starts[members], ends[members], time, steps, refinement)
        distances = distances[pending] if is_batch(system) else distances
        valid = np.isfinite(distances)
        squares[pending[valid]] += distances[valid] ** 2
        counts[pending[valid]] += 1
        # A single difference within round-off may be small by chance, so a second one is required.
        resolved = valid & ((distances > ROUNDOFF_FACTOR * roundoff) | (counts[pending] == 2))
        pending = pending[~resolved]
    squares[counts == 0] = np.inf
    squares[lost] = np.nan
    return np.maximum(np.sqrt(squares / np.maximum(counts, 1)), UNIT_ROUNDOFF)


def finer_run(method: Method, steps: int, times: float) -> FinerRun:
    """Return the scheme and number of steps of a more accurate run than one of `steps` >= 1 steps.

    The number of steps grows by the factor `times`; if the scheme chooses its own steps, they shrink by it. Its `left`
    is the remaining fraction of the error according to the order.
    """
    if method.own_steps and isinstance(method, OwnSteps):
        return method.finer(steps, times)
    count = math.ceil(times * (steps + FEW_STEPS))
    return FinerRun(method, count, (steps / count) ** method.order)


def _distances(
    solution: Solution,
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    time: float,
    steps: int,
    refinement: float,
) -> NDArray[np.float64]:
    """Return the relative distances of end states from those of a finer run, corrected for the error of that run."""
    finer = finer_run(solution.method, steps, refinement)
    points = max(2, min(MAX_SAVED_POINTS, MAX_SAVED_NUMBERS // starts.shape[1]))
    every = -(-finer.steps // points)
    plan = Times(solution.t_span[0], time / finer.steps, finer.steps, every)
    prepared = PreparedRun(solution.system, finer.method, abs(plan.h), watch=False)
    size = max(1, MAX_SAVED_NUMBERS // (points * starts.shape[1]))
    size = len(starts) if is_batch(solution.system) else size
    groups = [slice(first, first + size) for first in range(0, len(starts), size)]
    distances = [_group_distances(prepared, plan, starts[group], ends[group]) for group in groups]
    return np.concatenate(distances) / (1.0 - finer.left)


def _group_distances(
    prepared: PreparedRun, plan: Times, starts: NDArray[np.float64], ends: NDArray[np.float64]
) -> NDArray[np.float64]:
    run = prepared.begun(plan, with_group(prepared.system, starts, False, None, False))
    run.advance()
    x: Any = run.saved["x"][..., : starts.shape[1]]
    failed = run.state["status"] != 0
    size = np.max(np.linalg.norm(x, axis=2), axis=0)
    distances = np.linalg.norm(ends - x[-1], axis=1)
    # If the size is zero, so is the distance.
    return np.where(failed, np.inf, distances / np.where(size > 0.0, size, 1.0))
