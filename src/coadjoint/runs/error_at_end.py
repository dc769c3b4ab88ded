"""Errors of runs at their ends, by more accurate runs."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.forced import effective_scheme
from coadjoint.methods.protocol.method import FinerRun, Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.error_estimates import WHOLE_STEP_TOLERANCE, loses_digits
from coadjoint.runs.measured_steps import OF_ZERO, error_by_comparison, trial_states
from coadjoint.runs.partial_steps import resample
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import Run, advance_in_turns, advance_up
from coadjoint.runs.start import any_momenta_of
from coadjoint.runs.times import Times, output_times_of
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.evaluation import ignore_overflow

# Numbers of steps of the finer runs, relative to the run; the next one is used if the error is not yet resolved. They
# are not powers of two, so that the rounding of their steps differs from that of the run.
REFINEMENTS = (1.5, 1.75, 2.5, 3.5)
SAMPLED_REFINEMENTS = (1.5, 2.5)  # the same of runs with samples, rounded up to whole multiples
# Differences above this multiple of the expected round-off are truncation errors.
ROUNDOFF_FACTOR = 16.0
# Largest number of saved points of a finer run, and of numbers saved at once.
MAX_SAVED_POINTS = 256
MAX_SAVED_NUMBERS = 2**22
# With fewer steps the error may not scale with the order; a finer run takes at least this many more.
FEW_STEPS = 20


@ignore_overflow
def error_at_end(solution: Solution) -> NDArray[np.float64]:
    """Estimate the relative errors at the end, (1 + groups, members): the largest of groups, and of each group."""
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
    # Samples are at starts of steps: only whole fractions of the step divide their periods for certain.
    sampled = system.has_samples
    span = math.copysign(steps * solution.step, time) if sampled else time
    groups = CoordinateGroups(system)
    if steps == 0:
        return np.zeros((1 + groups.count, len(starts)))
    # Without a choice the growth of rounding is not known, and is taken as a random walk.
    roundoff = UNIT_ROUNDOFF * math.sqrt(steps) if solution.choice is None else solution.choice.roundoff
    squares, counts = np.zeros((1 + groups.count, len(starts))), np.zeros(len(starts), dtype=int)
    pending = np.flatnonzero(~lost)
    order = effective_scheme(system, solution.method).order
    for refinement in SAMPLED_REFINEMENTS if sampled else REFINEMENTS:
        if not len(pending):
            break
        members = np.arange(len(starts)) if system.is_batch else pending
        finer = finer_run(solution.method, steps, refinement, order, sampled)
        distances = _distances(solution, groups, starts[members], ends[members], span, finer)
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
        rounded = _distances(solution, groups, starts, ends, span, same_steps, advance_in_turns)
        errors = np.maximum(errors, np.where(np.isfinite(rounded), rounded, 0.0))
    errors[:, counts == 0] = np.inf
    errors[:, lost] = np.nan
    return np.maximum(errors, UNIT_ROUNDOFF)


def finer_run(method: Method, steps: int, times: float, order: int, sampled: bool) -> FinerRun:
    """Return scheme and steps of a run `times` as fine (with samples a multiple of `steps`), and the error `left`."""
    by_own_steps = method.finer(steps, times)
    if by_own_steps is not None:
        return by_own_steps
    count = math.ceil(times * (steps + FEW_STEPS))
    count = steps * -(-count // steps) if sampled else count
    return FinerRun(method, count, (steps / count) ** order)


def _distances(
    solution: Solution,
    groups: CoordinateGroups,
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    span: float,
    finer: FinerRun,
    advance: Callable[[Run], None] = Run.advance,
) -> NDArray[np.float64]:
    """Return relative distances from the ends of a finer run, corrected for its error: largest, and by group.

    If a span of whole steps ends after the run, a partial step makes the comparison.
    """
    points = max(2, min(MAX_SAVED_POINTS, MAX_SAVED_NUMBERS // starts.shape[1]))
    every = -(-finer.steps // points)
    plan, end = Times(solution.t_span[0], span / finer.steps, finer.steps, every), float(solution.t[-1])
    follow = advance
    if abs(span) > abs(end - plan.t0) * (1.0 + WHOLE_STEP_TOLERANCE):
        known = plan.saved_times
        moments = output_times_of(np.append(known[np.abs(known - plan.t0) < abs(end - plan.t0)], end), plan)
        plan = plan.with_saved_steps(moments.marks)

        def follow(run: Run) -> None:
            advance(run)
            resample(run, moments)

    prepared = PreparedRun(solution.system, finer.method, abs(plan.h), watch=False)
    size = max(1, MAX_SAVED_NUMBERS // (points * starts.shape[1]))
    size = len(starts) if solution.system.is_batch else size
    if advance is not Run.advance:
        prepared = prepared.in_one_thread()
    chunks = [slice(first, first + size) for first in range(0, len(starts), size)]
    distances = []
    for chunk in chunks:
        x = trial_states(prepared, starts[chunk], plan, follow)
        sizes = groups.sizes(x)
        # If the size is zero, so is the distance.
        of_groups = groups.norms(ends[chunk] - x[-1]) / np.where(sizes > 0.0, sizes, 1.0)
        counted = np.where(_of_zero(prepared, x, plan, groups, sizes), 0.0, of_groups)
        distances.append(np.concatenate([counted.max(axis=1, keepdims=True), of_groups], axis=1).T)
    total: NDArray[np.float64] = error_by_comparison(np.concatenate(distances, axis=1), finer.left)
    return total


def _of_zero(
    prepared: PreparedRun, x: NDArray[np.float64], plan: Times, groups: CoordinateGroups, sizes: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return the groups (members, groups) that are zero but for rounding in a run (times, members, n)."""
    if groups.count == 1:
        return np.zeros(sizes.shape, dtype=bool)
    alone, first = prepared.in_one_thread(), Times(plan.t0, plan.h, 1, 1).with_saved_steps([1])
    up, nearest = (trial_states(alone, x[0], first, advance)[0] for advance in (advance_up, Run.advance))
    start = groups.norms(x[0])
    return OF_ZERO * np.where(start > 0.0, start, sizes / math.sqrt(plan.steps)) < groups.norms(up - nearest)
