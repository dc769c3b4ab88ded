"""Error estimates of runs: of a step, with warnings if it is large, and at the end by more accurate runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.measured_steps import (
    SUSPECTED,
    TURN,
    WARNED,
    MeasuredSteps,
    WorstStep,
    most_steps,
    states_at,
    trial_states,
)
from coadjoint.analysis.powers import error_by_comparison
from coadjoint.errors import LargeStepWarning, RoundingWarning
from coadjoint.long_operations import warn_caller
from coadjoint.methods.forced import effective_scheme
from coadjoint.methods.protocol.method import FinerRun, Method
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.partial_steps import resample
from coadjoint.runs.preparation import Preparation
from coadjoint.runs.results.quantities import sum_of_absolute_terms
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import Run, advance_in_turns
from coadjoint.runs.start import any_momenta_of
from coadjoint.runs.times import Times, output_times_of
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.evaluation import ignore_overflow

# Largest error over a run without a warning, relative to the size of the motion, or of an invariant.
OVER_RUN = 0.05
GROWN = 16.0  # growth of the errors of steps over a run of which their sum is no bound
COMPARED = 64  # points at which a run is compared with one of half the step
ENERGY_SUSPECTED = 0.01  # deviation of an invariant from which on the run is repeated
# Number of members whose invariants deviate most, and of points at which the size of an invariant is taken.
MOST_LOST, SIZED = 16, 16
LOST_DIGITS = 2.0**-36  # size of a motion, or of an invariant in its terms, of which rounding leaves few digits
SUGGESTED = 0.002  # error of the step that a warning suggests, relative to the change of the state in it
# Numbers of steps of the finer runs, relative to the run; the next one is used if the error is not yet resolved. They
# are not powers of two, so that the rounding of their steps differs from that of the run.
REFINEMENTS = (1.5, 1.75, 2.5, 3.5)
SAMPLED_REFINEMENTS = (1.5, 2.5)  # the same of runs with samples, rounded up to whole multiples
# Differences above this multiple of the expected round-off are truncation errors.
ROUNDOFF_FACTOR = 16.0
# Largest number of saved points of a finer run, and of numbers saved at once.
MAX_SAVED_POINTS = 256
WHOLE_STEP_TOLERANCE = 2.0**-40  # relative tolerance for a whole number of steps
MAX_SAVED_NUMBERS = 2**22
# With fewer steps the error may not scale with the order; a finer run takes at least this many more.
FEW_STEPS = 20


def step_error(solution: Solution) -> float:
    """Return the largest error of a step among the members, relative to the change of the state; see `Solution`."""
    return MeasuredSteps(solution, None).worst().error


def step_errors_of_groups(solution: Solution) -> dict[str, float]:
    """Return the same for each group of coordinates, relative to its own change, by the names of the groups."""
    measured = MeasuredSteps(solution, None)
    return dict(zip(measured.groups.names(), measured.errors_of_groups().tolist(), strict=True))


def loses_digits(solution: Solution) -> bool:
    """Test whether a step loses many digits of a group by rounding; False if steps cannot be repeated."""
    method, system = solution.method, solution.system
    if method.own_steps or system.has_noise:
        return False
    return MeasuredSteps(solution, None).lossy


def warn_of_large_step(solution: Solution, prepared: Preparation) -> None:
    """Warn if the error over the run is large, or an invariant is lost, or rounding is a large part of a group."""
    start, end = solution.asked_span
    if prepared.method.own_steps or prepared.system.has_noise or abs(end - start) < 0.5 * solution.step:
        return
    lost, rounded, error, member = KEPT, None, 0.0, 0
    try:
        lost = lost_invariant(solution)
        measured = MeasuredSteps(solution, prepared)
        worst = measured.worst()
        solution.__dict__["_step_error"] = worst.error
        member = int(measured.members[worst.m])
        if not lost.large:
            short = measured.step_count(worst.m) <= most_steps(solution, worst.state.size, measured.h)
            suspected = worst.truncation > SUSPECTED or lost.name or (short and worst.total > OVER_RUN / GROWN)
            error = error_over_run(measured, worst) if suspected else 0.0
            # Where rounding is most of the error of a step, two half steps differ by rounding too.
            large = error > OVER_RUN and worst.truncation > WARNED
            rounded = None if large and worst.error < 2.0 * worst.truncation else measured.rounded_group()
            if large and rounded is not None:
                change, m, group = rounded
                # An unstable run amplifies rounding.
                if change >= 1.0 or measured.sizes[m, group] >= measured.sizes[m].max():
                    rounded = None
            if rounded is not None:
                change, m, group = rounded
                member = int(measured.members[m])
    except Exception:
        # Functions of the user may refuse half steps, which are no part of the run; `step_error` raises their errors.
        rounded, error = None, 0.0
    if lost.large:
        member = lost.member
    motion = "this motion" if solution.failed is None else f"the motion of member {member}"
    if lost.large:
        warn_caller(
            f"the step {solution.step:g} is too large for {motion}: {lost.name} deviates by {lost.ratio:.2g} of its "
            f"size{' from the work of the forces' * lost.balanced}; take a step of about "
            f"{_smaller_step(solution, prepared, lost.ratio, 1.0):.1g}",
            LargeStepWarning,
        )
    elif error > OVER_RUN and rounded is None:
        warn_caller(
            f"the step {solution.step:g} is too large for {motion}: the error of a step of {prepared.method} is "
            f"{worst.truncation:.2g} of the change of the state, and such errors add up to {error:.2g} of the motion, "
            "though invariants may be kept; take a step of about "
            f"{_smaller_step(solution, prepared, error, worst.truncation):.1g}",
            LargeStepWarning,
        )
    elif rounded is not None:
        radians = measured.radians_in_step(m, group)
        reason = (
            f"since a step turns it by about {radians:.1g} radians, and float64 has 16 digits; shorter steps do not "
            "help, a shorter span does"
            if radians
            else f"beside larger numbers that nearly cancel in {prepared.method}; shorter steps do not help, "
            "coordinates or terms of the Hamiltonian in which they cancel exactly do"
        )
        warn_caller(
            f"rounding changes {measured.groups.names()[group]} in {motion} by about {change:.1g} of "
            f"its size, {reason}",
            RoundingWarning,
        )


def _smaller_step(solution: Solution, prepared: Preparation, error: float, truncation: float) -> float:
    """Return the step at which the error over the run, and that of a step, are small, by the order."""
    ratio = min(0.1 * OVER_RUN / min(1.0, error), SUGGESTED / min(error, truncation))
    return solution.step * float(ratio ** (1.0 / prepared.scheme.order))


@ignore_overflow
def error_over_run(measured: MeasuredSteps, worst: WorstStep, turn: float | None = None) -> float:
    """Return the error of the run of a member by half steps, relative to its motion; of a long run, of a part.

    The part begins at the worst step; where errors of steps are small it is a turn. Slow errors that grow in it are
    extrapolated. Of a state at rest the error is relative to the state, since all that changes is error, and so that of
    groups at rest beside others that move.
    """
    m, t, state, h = worst.m, worst.t, worst.state, measured.h
    count = max(1, math.ceil(measured.step_count(m) * (1.0 - WHOLE_STEP_TOLERANCE)))
    most: float = most_steps(measured.solution, state.size, h)
    longest, motion = min(most, count), measured.motion_of(m)
    most = most if worst.truncation > SUSPECTED else min(most, measured.steps_of_turn(m) if turn is None else turn)
    if most >= count:
        t, state = measured.points[0][0], measured.points[0][1][m : m + 1]
    steps, one = int(min(most, count)), measured.of_member(m)
    every = max(1, steps // COMPARED)
    path, finer = (
        measured.scaled(trial_states(one, state, Times(t, h / k, k * steps, k * every))[:, 0], m) for k in (1, 2)
    )
    # From here a turn may take more steps than by the mean speed of all points, as after the start of a controller.
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    if steps < longest and length < 0.5 * TURN * motion:
        return error_over_run(measured, worst, min(longest, TURN * motion * steps / length if length else math.inf))
    norms, left = measured.groups.norms, 0.5**measured.prepared.scheme.order
    differences = error_by_comparison(norms(path - finer), left)
    # A group whose motion in half steps is below the difference rests.
    rests = norms(finer - finer[0]).max(axis=0) < differences.max(axis=0)
    rests &= not (worst.at_rest or rests.all())
    # Steps that failed follow no motion.
    differences[~np.isfinite(differences)] = np.inf

    def grown(some: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the largest error of some groups in the part, and in the run."""
        errors = np.linalg.norm(differences[:, some], axis=1)
        error, early = float(errors.max()), float(errors[: len(errors) // 2 + 1].max())
        return error, error + 2.0 * max(0.0, error - early) * (count / steps - 1.0)

    (error, lengthened), (_, resting) = grown(~rests), grown(rests)
    if worst.at_rest:
        return lengthened / float(np.linalg.norm(measured.scaled(state[0], m)))
    # A motion of which rounding leaves few digits has no errors of steps.
    moved = max(float(np.nanmax(np.linalg.norm(path - path[0], axis=1))), LOST_DIGITS * float(np.linalg.norm(path[0])))
    if moved == 0.0:
        return 0.0
    # The phase of later turns does not count.
    return max(resting, min(lengthened / max(moved, motion), error / moved))


class LostInvariant(NamedTuple):
    """An invariant, named if it is lost, its deviation relative to its size, its member, and whether forces work."""

    name: str
    ratio: float
    member: int
    balanced: bool

    @property
    def large(self) -> bool:
        """Whether the run is wrong."""
        return self.ratio > OVER_RUN


KEPT = LostInvariant("", ENERGY_SUSPECTED, 0, False)


@ignore_overflow
def lost_invariant(solution: Solution) -> LostInvariant:
    """Return the invariant that deviates most in a step, with forces from their work, if by a part that matters."""
    system, balanced = solution.system, bool(solution.work)
    largest = KEPT
    first = 1 + len(solution.casimirs) if balanced else 0
    accounted = {invariant for _, invariant in solution._accounts}
    for i, (name, initial) in enumerate(solution.initial.items()):
        # Of archives only the start is known, where the terms of a Casimir may vanish.
        if (balanced and name not in accounted) or (name != "energy" and not solution._in_memory):
            continue
        deviations = np.atleast_2d(solution._worst[..., first + i]).max(axis=1)
        ratios = np.nan_to_num(deviations / np.abs(np.atleast_1d(initial)), nan=0.0, posinf=np.inf)
        for m in np.argsort(-ratios, kind="stable")[:MOST_LOST].tolist():
            one = system.of_member(m)
            if ratios[m] <= largest.ratio or one.hamiltonian.timed or (one.forces and not balanced):
                continue
            size = _size_of_invariant(solution, one, name, m)
            if size > 0.0 and deviations[m] > largest.ratio * size:
                largest = LostInvariant(name, float(deviations[m] / size), m, balanced)
    return largest


def _size_of_invariant(solution: Solution, one: Any, name: str, m: int) -> float:
    """Return the size of an invariant in the motion of a member: its value, its terms, its change or work of forces."""
    plain, single = one.unforced, solution.failed is None
    invariant = plain.hamiltonian if name == "energy" else plain.casimirs.get(name)
    points = np.unique(np.linspace(0, len(solution.t) - 1, SIZED).astype(int)) if solution._in_memory else [0]
    states = np.array([states_at(solution, np.array([m]), k)[0] for k in points])
    initial = abs(float(np.atleast_1d(solution.initial[name])[m]))
    work = [series[name] if single else series[name][:, m] for series in solution.work.values() if name in series]
    # An invariant that is zero but for rounding has the size of its terms, and the energy what the motion changes in
    # them: those of a close encounter are far larger than at the other points.
    if name == "energy" and not plain.has_matrices:
        slopes = np.abs([plain.hamiltonian.gradient(x, t) for x, t in zip(states, solution.t[points], strict=True)])
        changes = np.median(np.sum(np.abs(states - states.mean(axis=0)) * slopes, axis=1))
        terms = max(changes, LOST_DIGITS * np.sum(np.abs(states) * slopes, axis=1).max())
    else:
        # Terms that vanish at the start, such as those of two axes, need not do so later.
        terms = float(np.nanmax(sum_of_absolute_terms(invariant, plain.states_of(states))))
        if not terms:
            return 0.0 if name != "energy" else initial
    return float(np.nanmax([initial, terms, *(np.nanmax(np.abs(one)) for one in work)]))


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
    # Samples are at starts of steps: only whole fractions of the step divide their periods for certain.
    sampled = any(force.sampled for one in system.distinct for force in one.forces)
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
    """Return the scheme and number of steps of a run of `times` as many steps, and the fraction of the error `left`.

    With samples the number is a multiple of `steps`.
    """
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
    """Return the relative distances from the ends of a finer run, corrected for its error: of states, and of groups.

    A span of whole steps may end after the run, which is then compared by a part of a step.
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

    prepared = Preparation(solution.system, finer.method, abs(plan.h), watch=False)
    size = max(1, MAX_SAVED_NUMBERS // (points * starts.shape[1]))
    size = len(starts) if solution.system.is_batch else size
    if advance is not Run.advance:
        prepared = prepared.in_one_thread()
    chunks = [slice(first, first + size) for first in range(0, len(starts), size)]
    distances = []
    for chunk in chunks:
        distances.append(_distances_of(trial_states(prepared, starts[chunk], plan, follow), groups, ends[chunk]))
    total: NDArray[np.float64] = error_by_comparison(np.concatenate(distances, axis=1), finer.left)
    return total


def _distances_of(x: NDArray[np.float64], groups: CoordinateGroups, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the relative distances of ends from the last of some states (times, members, n); NaN of failed members."""
    size = np.concatenate([np.linalg.norm(x, axis=2, keepdims=True), groups.norms(x)], axis=2).max(axis=0)
    difference = ends - x[-1]
    distances = np.concatenate([np.linalg.norm(difference, axis=1, keepdims=True), groups.norms(difference)], axis=1)
    # If the size is zero, so is the distance.
    return np.asarray((distances / np.where(size > 0.0, size, 1.0)).T)
