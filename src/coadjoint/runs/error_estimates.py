"""Error estimates of runs: of a step, with warnings if it is large, and at the end by more accurate runs."""

from __future__ import annotations

import math
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import LargeStepWarning, RoundingWarning
from coadjoint.long_operations import warn_caller
from coadjoint.runs.measured_steps import (
    EXCESS,
    ROUNDING,
    SUSPECTED,
    TURN,
    WARNED,
    MeasuredSteps,
    WorstStep,
    error_by_comparison,
    most_steps,
    states_at,
    trial_states,
)
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.quantities import sum_of_absolute_terms
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import advance_in_turns
from coadjoint.runs.times import Times
from coadjoint.systems.energy_derivatives import gradients_at
from coadjoint.systems.evaluation import ignore_overflow

# Largest error over a run without a warning, relative to the size of the motion, or of an invariant.
OVER_RUN = 0.05
GROWN = 16.0  # growth of the errors of steps over a run of which their sum is no bound
AMPLIFIED = 3.0  # error in a part of a run, relative to the sum of those of its steps, of an unstable motion
COMPARED = 64  # points at which a run is compared with one of half the step
ENERGY_SUSPECTED = 0.01  # deviation of an invariant from which on the run is repeated
# Number of members whose invariants deviate most, and of points at which the size of an invariant is taken; every third
# has the gradient of the energy, which may be a function in Python.
MOST_LOST, SIZED, SLOPED = 16, 16, 3
LOST_DIGITS = 2.0**-36  # size of a motion, or of an invariant in its terms, of which rounding leaves few digits
# Largest rounding of a group in the run, relative to its size, without a warning: half of the 2 per cent that must
# warn, since the estimate may be half of the error.
ROUNDED = 0.01
# Saved points of the run that is repeated to measure rounding.
ROUNDED_POINTS = 16
WHOLE_STEP_TOLERANCE = 2.0**-40  # relative tolerance for a whole number of steps
# Errors with the step that a warning suggests: of a step, relative to the change of the state in it, and over the run.
SUGGESTED, MADE_SMALL = 0.002, 0.1 * OVER_RUN
TRIALS, SHORTENED = 8, 0.25  # largest number of steps tried as a suggestion, and by how much each is shorter at most


def step_error(solution: Solution) -> float:
    """Return the largest error of a step among the members, relative to the change of the state; see `Solution`."""
    return _counted(*MeasuredSteps(solution, None, suspects_of(solution, deviations_of(solution))).worst())


def _counted(error: float, steps: list[WorstStep]) -> float:
    """Return the error of a step; NaN if the worst step is from a state at rest, which changes by its error alone."""
    return math.nan if max(steps, key=lambda step: step.truncation).at_rest else error


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


def warn_of_large_step(solution: Solution, prepared: PreparedRun) -> bool:
    """Warn if an error over the run is large, or an invariant is lost, or rounding is; return whether the step is."""
    start, end = solution.asked_span
    if prepared.method.own_steps or prepared.system.has_noise or abs(end - start) < 0.5 * solution.step:
        return False
    lost, rounded, measured, wrong = KEPT, None, None, Wrong()
    try:
        deviations = deviations_of(solution)
        try:
            measured = MeasuredSteps(solution, prepared, suspects_of(solution, deviations))
            error_of_step, steps = measured.worst()
            solution.__dict__["_step_error"] = _counted(error_of_step, steps)
        finally:
            lost = lost_invariant(solution, measured, deviations)
        if not lost.large:
            wrong = wrong_member(measured, steps, lost)
            # Where rounding is most of the error of a step, two half steps differ by rounding too.
            large = wrong.error > OVER_RUN and wrong.truncation > WARNED
            rounded = None if large and error_of_step < 2.0 * wrong.truncation else rounded_group(measured)
            if large and rounded is not None:
                change, m, group = rounded
                # An unstable run amplifies rounding.
                if change >= 1.0 or measured.sizes[m, group] >= measured.sizes[m].max():
                    rounded = None
            if rounded is not None:
                change, m, group = rounded
                wrong = Wrong(member=int(measured.members[m]))
    except Exception:
        # Functions of the user may refuse half steps, which are no part of the run; `step_error` raises their errors.
        rounded, wrong = None, Wrong()
    if lost.large:
        warn_of_lost_invariant(solution, prepared, lost, measured)
    elif wrong.error > OVER_RUN:
        warn_caller(
            f"the step {solution.step:g} is too large for {_motion(solution, wrong)}: the error of a step of "
            f"{prepared.method} is {wrong.truncation:.2g} of the change of the state, and such errors add up to "
            f"{wrong.error:.2g} of the motion, though invariants may be kept; take a step of about "
            f"{_smaller_step(solution, prepared, wrong.error, wrong.truncation, measured, wrong.row):.2g}",
            LargeStepWarning,
        )
    elif rounded is not None and measured is not None:
        radians = radians_in_step(measured, m, group)
        reason = (
            f"since a step turns it by about {radians:.1g} radians, and float64 has 16 digits; shorter steps do not "
            "help, a shorter span does"
            if radians
            else f"beside larger numbers that nearly cancel in {prepared.method}; shorter steps do not help, "
            "coordinates or terms of the Hamiltonian in which they cancel exactly do"
        )
        warn_caller(
            f"rounding changes {measured.groups.names()[group]} in {_motion(solution, wrong)} by about {change:.1g} of "
            f"its size, {reason}",
            RoundingWarning,
        )
    return lost.large or wrong.error > OVER_RUN


def warn_of_lost_invariant(
    solution: Solution, prepared: PreparedRun, lost: LostInvariant, measured: MeasuredSteps | None = None
) -> None:
    """Warn of an invariant that is not kept."""
    rows = [] if measured is None else np.flatnonzero(measured.members == lost.member).tolist()
    # States of other systems may have left their orbits, and no longer move as in the start.
    row = next((m for m in rows if measured is not None and measured.has_waves(m)), -1)
    warn_caller(
        f"the step {solution.step:g} is too large for {_motion(solution, lost)}: {lost.name} deviates by "
        f"{lost.ratio:.2g} of its size{' from the work of the forces' * lost.balanced}; take a step of about "
        f"{_smaller_step(solution, prepared, lost.ratio, 1.0, measured, row):.2g}",
        LargeStepWarning,
    )


def warn_of_blocks(solution: Solution, prepared: PreparedRun, found: list[list[Any]]) -> None:
    """Warn of the invariant that deviates most among those that blocks of an ensemble have lost."""
    lost = [LostInvariant(*one) for one in found]
    largest = max(lost, key=lambda one: one.ratio)
    warn_of_lost_invariant(solution, prepared, largest._replace(members=sum(one.members for one in lost)))


def _motion(solution: Solution, worst: Wrong | LostInvariant) -> str:
    others = f" (and of at least {worst.members - 1} others)" if worst.members > 1 else ""
    return "this motion" if solution.failed is None else f"the motion of member {worst.member}{others}"


def _smaller_step(
    solution: Solution,
    prepared: PreparedRun,
    error: float,
    truncation: float,
    measured: MeasuredSteps | None = None,
    row: int = -1,
) -> float:
    """Return the step at which the error over the run, and that of a step, are small, by the order and by trials."""
    ratio = min(MADE_SMALL / min(1.0, error), SUGGESTED / max(SUGGESTED, min(error, truncation)))
    step = solution.step * float(ratio ** (1.0 / prepared.scheme.order))
    if measured is None or row < 0:
        return step
    # From a large step the order does not tell how small another must be.
    for _ in range(TRIALS):
        of_step, total = measured.in_steps_of(math.copysign(step, measured.h), row)
        excess = max(of_step / SUGGESTED, total / MADE_SMALL if measured.has_waves(row) else 0.0)
        if not excess > 1.0:
            break
        step *= max(SHORTENED, excess ** (-1.0 / prepared.scheme.order))
    return step


class Wrong(NamedTuple):
    """The largest error over the run of a member, the error of its steps, and how many members have a large one."""

    error: float = 0.0
    truncation: float = 0.0
    member: int = 0
    members: int = 0
    row: int = -1
    """Number among the measured members, if other steps can be tried: not at rest, where all changes are errors."""


def wrong_member(measured: MeasuredSteps, steps: list[WorstStep], lost: LostInvariant) -> Wrong:
    """Return the largest error over the run of members in which errors of steps may add up, or which `lost` energy."""

    def is_suspected(one: WorstStep) -> bool:
        adds_up = (measured.short and one.total > OVER_RUN / GROWN) or phases_add_up(measured, one)
        return one.truncation > SUSPECTED or adds_up or (bool(lost.name) and lost.member == measured.members[one.m])

    suspected = sorted(filter(is_suspected, steps), key=lambda one: -max(one.truncation, min(1.0, one.total)))
    # Of a run that cannot be repeated by half steps all is error.
    errors = [1.0 if math.isinf(error := error_over_run(measured, one)) else error for one in suspected[:MOST_LOST]]
    if not errors:
        return Wrong()
    error = max(errors)
    worst = suspected[errors.index(error)]
    count = sum(one > OVER_RUN for one in errors)
    return Wrong(error, worst.truncation, int(measured.members[worst.m]), count, -1 if worst.at_rest else worst.m)


def phases_add_up(measured: MeasuredSteps, worst: WorstStep) -> bool:
    """Test whether phase errors of waves may be large over the run, though they are small over a turn."""
    return math.isfinite(worst.total) and worst.total > OVER_RUN and measured.has_waves(worst.m)


@ignore_overflow
def error_over_run(measured: MeasuredSteps, worst: WorstStep, turn: float | None = None) -> float:
    """Return the error of a member's run by half steps, relative to its motion; of a long run, of a part.

    The part begins at the worst step; where errors of steps are small it is a turn. Slow errors that grow in it are
    extrapolated. At rest the error is relative to the state, since all that changes is error; so for groups at rest.
    """
    m, t, state, h = worst.m, worst.t, worst.state, measured.h
    count = max(1, math.ceil(measured.step_count(m) * (1.0 - WHOLE_STEP_TOLERANCE)))
    most: float = most_steps(measured.solution, state.size, h)
    longest, motion = min(most, count), measured.motion_of(m)
    adds_up = phases_add_up(measured, worst)
    most = (
        most
        if worst.truncation > SUSPECTED or adds_up
        else min(most, measured.steps_of_turn(m) if turn is None else turn)
    )
    if most >= count:
        t, state = measured.points[0][0], measured.start[m : m + 1]
    steps, one = int(min(most, count)), measured.of_member(m)
    # Forces of tables and orbits may be known no longer than the run lasts: the part ends within it.
    end = measured.solution.asked_span[1] - steps * h
    if (t - end) * h > 0.0:
        t, states, _ = max((p for p in measured.points if p[2][m] and (p[0] - end) * h <= 0.0), key=lambda p: p[0] * h)
        state = states[m : m + 1]
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
    moved = np.nanmax([*np.linalg.norm(path - path[0], axis=1), LOST_DIGITS * np.linalg.norm(path[0])])
    moved = max(float(moved), measured.largest_change(m))
    if moved == 0.0:
        return 0.0
    # The phase of later turns does not count, but for waves, whose errors add up and are not amplified.
    summed = worst.total * motion / max(moved, motion) if adds_up else 0.0
    if error > AMPLIFIED * summed * max(moved, motion) * steps / count:
        summed = 0.0
    return max(resting, min(lengthened / max(moved, motion), max(error / moved, summed)))


class LostInvariant(NamedTuple):
    """An invariant, named if it is lost, its deviation relative to its size, the member, and whether forces work."""

    name: str
    ratio: float
    member: int
    balanced: bool
    members: int = 1
    """At least so many have lost it."""

    @property
    def large(self) -> bool:
        return self.ratio > OVER_RUN


KEPT = LostInvariant("", ENERGY_SUSPECTED, 0, False)


class Deviation(NamedTuple):
    """The largest deviation of an invariant of a member, with forces from their work, that may be large."""

    name: str
    member: int
    size: float


@ignore_overflow
def deviations_of(solution: Solution) -> list[Deviation]:
    """Return the deviations that are large beside the invariants at the start, of some members for each invariant."""
    balanced, found = bool(solution.work), []
    first = 1 + len(solution.casimirs) if balanced else 0
    accounted = {invariant for _, invariant in solution._work_integrals}
    sizes = np.abs([np.atleast_1d(initial) for initial in solution.initial.values()])
    worst = solution._worst[..., first : first + len(sizes)].max(axis=-2).reshape(-1, len(sizes)).T
    ratios = np.nan_to_num(worst / sizes, nan=0.0, posinf=np.inf)
    for name, row, deviations in zip(solution.initial, ratios, worst, strict=True):
        if not row.max(initial=0.0) > ENERGY_SUSPECTED or (balanced and name not in accounted):
            continue
        for m in np.argsort(-row, kind="stable")[:MOST_LOST].tolist():
            one = solution.system.of_member(m)
            if row[m] > ENERGY_SUSPECTED and not one.hamiltonian.timed and (balanced or not one.forces):
                found.append(Deviation(name, m, float(deviations[m])))
    return found


def suspects_of(solution: Solution, deviations: list[Deviation]) -> tuple[int, ...]:
    """Return the members of a run in memory whose energy deviates most; Casimirs may be zero at the start."""
    return tuple(one.member for one in deviations if one.name == "energy") if solution._in_memory else ()


@ignore_overflow
def lost_invariant(
    solution: Solution, measured: MeasuredSteps | None = None, deviations: list[Deviation] | None = None
) -> LostInvariant:
    """Return the invariant that deviates most in a step, relative to its size, if by a part that matters."""
    largest, lost = KEPT, set()

    @cache
    def motion(m: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        if measured is not None and m in measured.members:
            return measured.some_states(m, SIZED)
        points = np.unique(np.linspace(0, len(solution.t) - 1, SIZED).astype(int)) if solution._in_memory else [0]
        return solution.t[points], np.array([states_at(solution, np.array([m]), k)[0] for k in points])

    for name, m, deviation in deviations_of(solution) if deviations is None else deviations:
        # Of long runs in archives only the start is known, where the terms of a Casimir may vanish.
        if name != "energy" and not (solution._in_memory or (measured is not None and measured.short)):
            continue
        size = _size_of_invariant(solution, name, m, *motion(m))
        if size > 0.0 and deviation > OVER_RUN * size:
            lost.add(m)
        if size > 0.0 and deviation > largest.ratio * size:
            largest = LostInvariant(name, deviation / size, m, bool(solution.work))
    return largest._replace(members=len(lost))


def _size_of_invariant(
    solution: Solution, name: str, m: int, t: NDArray[np.float64], states: NDArray[np.float64]
) -> float:
    """Return the size of an invariant in the motion of a member: its value, its terms, its change or work of forces."""
    plain, single = solution.system.of_member(m).unforced, solution.failed is None
    invariant = plain.hamiltonian if name == "energy" else plain.casimirs.get(name)
    initial = abs(float(np.atleast_1d(solution.initial[name])[m]))
    work = [series[name] if single else series[name][:, m] for series in solution.work.values() if name in series]
    # An invariant that is zero but for rounding has the size of its terms, and the energy what the motion changes in
    # them: those of a close encounter are far larger than at the other points.
    if name == "energy" and not plain.has_matrices:
        some, mean = states[::SLOPED], states.mean(axis=0)
        slopes = np.abs(gradients_at(plain, some[:, None], t[::SLOPED])[:, 0])
        changes = np.median(np.sum(np.abs(some - mean) * slopes, axis=1))
        # At rest the gradient too is rounding.
        rounded = ROUNDING * np.max(sum_of_absolute_terms(invariant, some))
        terms = max(changes, LOST_DIGITS * np.sum(np.abs(some) * slopes, axis=1).max(), rounded / OVER_RUN)
    else:
        # Terms that vanish at the start, such as those of two axes, need not do so later.
        terms = float(np.nanmax(sum_of_absolute_terms(invariant, plain.states_of(states))))
        if not terms:
            return 0.0 if name != "energy" else initial
    return float(np.nanmax([initial, terms, *(np.nanmax(np.abs(one)) for one in work)]))


@ignore_overflow
def rounded_group(measured: MeasuredSteps) -> tuple[float, int, int] | None:
    """Return the largest change of a group by rounding relative to its size, its member and group; None if small."""
    # If a step loses so many digits that the run could, the run of that member is repeated, or the part of it that
    # few steps reach, with rounding up and down in turns. Groups that are zero but for rounding are left out.
    if not measured.lossy:
        return None
    counts = np.array([measured.step_count(m) for m in range(len(measured.members))])[:, None]
    largest = measured.sizes == measured.sizes.max(axis=1, keepdims=True)
    own = largest | (measured.rounding * np.sqrt(counts) < measured.sizes)
    lost = np.where(own & (measured.rounding > EXCESS * measured.sizes), measured.rounding * counts, 0.0)
    ratios = np.divide(lost, measured.sizes, out=np.zeros_like(lost), where=measured.sizes > 0.0)
    if not ratios.max() > ROUNDED:
        return None
    m = int(np.argmax(ratios.max(axis=1)))
    prepared, state = measured.of_member(m), measured.start[m : m + 1]
    whole = float(counts[m, 0])
    steps = max(1, min(math.ceil(whole * (1.0 - ROUNDING)), most_steps(measured.solution, state.size, measured.h)))
    times = Times(measured.solution.t_span[0], measured.h, steps, max(1, steps // ROUNDED_POINTS))
    path = trial_states(prepared, state, times)
    rounded = np.concatenate(
        [trial_states(prepared, state, times, partial(advance_in_turns, first=first)) for first in (1, -1)],
        axis=1,
    )
    differences = measured.groups.norms(rounded - path).max(axis=(0, 1))
    sizes = measured.groups.norms(path)[:, 0].max(axis=0)
    errors = np.divide(
        differences, sizes, out=np.zeros_like(sizes), where=own[m] & (measured.starts[m] > 0.0) & (sizes > 0.0)
    )
    # Beyond the steps repeated, errors of rounding are taken as a random walk.
    errors = np.nan_to_num(errors, nan=0.0, posinf=0.0) * math.sqrt(max(1.0, whole / steps))
    # The group that loses most digits is named, others follow it.
    group = int(np.argmax(np.where(errors > ROUNDED, ratios[m], -1.0)))
    return (float(errors[group]), m, group) if errors[group] > ROUNDED else None


def radians_in_step(measured: MeasuredSteps, m: int, group: int) -> float:
    """Return the angle by which a step turns a group if its rounding is that of the angle, otherwise 0."""
    one, moves = measured.system.of_member(int(measured.members[m])), [0.0]
    for t, states, held in measured.points:
        if held[m]:
            field = one.rows_of(one.vector_field(one.states_of(states[m]), t))
            moves.append(abs(measured.h) * float(measured.groups.norms(field[None])[0, group]))
    by_angle = measured.rounding[m, group] <= ROUNDING * max(moves)
    return max(moves) / float(measured.sizes[m, group]) if by_angle else 0.0
