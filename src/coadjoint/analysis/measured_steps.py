"""Steps of a run measured at a few points: the error by two half steps, the change of the state, and rounding."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.analysis.powers import error_by_comparison
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.preparation import Preparation, trial_run
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import ends_by_events, member_count
from coadjoint.runs.run import Run, advance_in_turns, advance_up
from coadjoint.runs.start import any_momenta_of, vector_size
from coadjoint.runs.times import Times
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.evaluation import ignore_overflow

Floats = NDArray[np.float64]

# Weight of the error of the single fastest step, beside that of the others in the root mean square.
FASTEST = 0.4
# Least speed of a passage, relative to the mean speed; below, the steps at the points represent all.
PASSAGE = 2.0
# Largest number of steps between two saved points that are repeated to find the fastest one, and part of the run.
STEPS, PART = 1000, 0.05
# Smallest number of entries of the states at the points whose steps take several threads.
THREADED = 2**16
# Largest number of entries of the states in repeated steps, if they are not a small part of the run.
REPEATED = 2**18
# Differences between a step and two half steps by rounding alone, relative to the state.
ROUNDING = 64 * UNIT_ROUNDOFF
# Error of a step, relative to the change of the state in it, with which the scheme no longer follows the motion.
WARNED = 0.02
# Path of a turn, in sizes of the motion: pi for a circle, 4 for a turn along a line.
TURN = 5.0
# Error of a step from which on the run is repeated, not a turn alone: such errors add up to `OVER_RUN` over a turn.
SUSPECTED = 0.01
# Largest change by the field in a step, relative to the error of a step, of a state that is at rest.
AT_REST = 0.01
# Differences between a step and two half steps by rounding alone, relative to that by its direction.
HALVED = 8.0
# Rounding of a group in a step, relative to its size, below which the group keeps its digits in any run.
EXCESS = 2.0**14 * UNIT_ROUNDOFF
# Rounding of a step, relative to a group at the start, above which the group is zero but for rounding.
OF_ZERO = 1.0 / 64.0
# Largest rounding of a group in the run, relative to its size, without a warning: half of the 2 per cent that must
# warn, since the estimate may be half of the error.
ROUNDED = 0.01
# Saved points of the run that is repeated to measure rounding.
ROUNDED_POINTS = 16

# Largest number of points, and of members, at which the step is repeated.
POINTS, MEMBERS = 5, 64
# Largest number of entries of the states that are repeated; at least one state.
NUMBERS = 2**20


class WorstStep(NamedTuple):
    """The largest error of a step, and the part of it that shorter steps reduce; its chosen member, time and state."""

    error: float
    truncation: float
    m: int
    t: float
    state: Floats
    total: float = math.inf
    """Such errors in all steps, relative to the motion."""
    at_rest: bool = False


class MeasuredSteps:
    """Steps of a run at a few points: their errors, changes and rounding, by member and group of coordinates."""

    @ignore_overflow
    def __init__(self, solution: Solution, prepared: Preparation | None) -> None:
        # An archive need not know its scheme and system; that of a run with inputs has their values.
        described: Any = solution if prepared is None or prepared.takes_inputs else prepared
        method, system = described.method, described.system
        if method.own_steps:
            raise TypeError(f"{method} chooses its own steps, and controls their error; there is no step to measure")
        if system.has_noise:
            raise TypeError(f"{system.name} has random forces, which are defined for whole steps only")
        # Loops of a run with attitudes need elements, and those with inputs their values.
        if prepared is None or prepared.representation is not None or prepared.takes_inputs:
            prepared = Preparation(system, method, solution.step, watch=False, threads=1)
        self.solution, self.method, self.system = solution, method, system
        self.groups = CoordinateGroups(system)
        self.h = math.copysign(solution.step, solution.t_span[1] - solution.t_span[0])
        self.members = members = sampled_members(solution, system)
        self.points = points = sampled_points(solution, system, members)
        if system.is_batch and len(members) < len(system):
            prepared = prepared.sampled(members)
        # Rounding is that of this thread.
        self.alone = prepared.in_one_thread()
        self.prepared = prepared if sum(states.size for _, states, _ in points) >= THREADED else self.alone
        runs: tuple[Preparation, ...] = (self.prepared, self.alone)
        states = [states for _, states, _ in points]
        if any(one.hamiltonian.timed or one.forces for one in prepared.system.distinct):
            step = np.stack([self._step(runs, x, t) for t, x, _ in points], axis=1)
        else:
            # The members at all points side by side.
            if system.is_batch:
                repeated = np.tile(np.arange(len(members)), len(points))
                runs = tuple(run.sampled(repeated) for run in dict.fromkeys(runs))
            step = self._step(runs, np.concatenate(states), points[0][0])
            step = step.reshape(3, len(points), -1, self.groups.count)
        norms = self.groups.norms(states[0][None] if len(points) == 1 else np.stack(states))
        held = np.stack([held for _, _, held in points])
        if not held.all():
            step, norms = np.where(held[..., None], step, 0.0), norms * held[..., None]
        # By point, member and group: errors of a step by its length, changes in it, and differences by rounding.
        self.errors, self.changes, self.rounding_at_points = step
        self.starts, self.sizes, self.rounding = norms[0], norms.max(axis=0), self.rounding_at_points.max(axis=0)
        self.weights = self._weights()

    def _step(
        self, runs: tuple[Preparation, ...], states: Floats, t: float, known_rounding: Floats | None = None
    ) -> Floats:
        """Return errors, changes and rounding of a step, (3, members, groups), zero if it cannot be repeated."""
        # Rounding is measured by the last run, unless it is known.
        h, groups, prepared = self.h, self.groups, runs[0]
        middle, halved = trial_states(prepared, states, Times(t, 0.5 * h, 2, 1).with_saved_steps([1, 2]))
        change = groups.norms(middle - states)
        # Without the arrays of this run, of a large state.
        halved, middle = halved.copy(), None
        whole = Times(t, h, 1, 1).with_saved_steps([1])
        (full,) = trial_states(prepared, states, whole)
        # The difference of two half steps from a step of order p is all but 2^-p of the error of the latter.
        errors = error_by_comparison(groups.norms(full - halved), 0.5**self.prepared.scheme.order)
        changes = np.maximum(groups.norms(full - states), change)
        if known_rounding is None:
            halved, full = None, full.copy()
            (up,) = trial_states(runs[-1], states, whole, advance_up)
            rounding = groups.norms(up - full)
            rounding[~np.isfinite(rounding)] = 0.0
        else:
            rounding = known_rounding
        sizes = groups.norms(states)
        # If a step loses the largest group too, it is so large that it amplifies rounding.
        amplified = np.where(sizes == sizes.max(axis=1, keepdims=True), rounding > WARNED * sizes, False)
        rounded = np.where(amplified.any(axis=1, keepdims=True), 0.0, HALVED * rounding)
        errors = np.maximum(0.0, errors - np.maximum(ROUNDING * sizes, rounded))
        failed = ~np.isfinite(errors + changes).all(axis=1)
        errors[failed], changes[failed] = 0.0, 0.0
        return np.stack([errors, changes, rounding])

    @property
    def lossy(self) -> bool:
        """Whether a step loses many digits of a group."""
        return bool(np.any(self.rounding > EXCESS * self.sizes))

    def _weights(self) -> Floats:
        """Return the weights of the groups, (members, groups); groups that start at zero take the size of the state."""
        if self.groups.count == 1:
            return np.ones_like(self.sizes)
        whole = np.sqrt(np.sum(self.sizes**2, axis=1, keepdims=True))
        sizes = np.where(OF_ZERO * self.starts > self.rounding, self.sizes, np.maximum(self.sizes, whole))
        return np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 0.0)

    def scaled(self, states: Floats, members: Any) -> Floats:
        """Return states (..., members, n) of the chosen members with groups relative to their sizes."""
        return states if self.groups.count == 1 else states * self.weights[members][..., self.groups.labels]

    @ignore_overflow
    def errors_of_groups(self) -> Floats:
        """Return the error of a step with its rounding, relative to the change of the group, the largest of members."""
        errors = np.sum(self.errors**2 + self._excess() ** 2, axis=0)
        return _ratios(errors, np.sum(self.changes**2, axis=0)).max(axis=0)

    def _excess(self) -> Floats:
        """Return the rounding of the steps beyond that of a group that keeps its digits."""
        return np.maximum(0.0, self.rounding_at_points - EXCESS * self.sizes)

    @ignore_overflow
    def worst(self) -> WorstStep:
        """Return the largest error of a step, relative to the change in it."""
        solution, system, weights = self.solution, self.system, self.weights

        def total(part: Floats) -> Floats:
            squares: Floats = (part * weights) ** 2
            return squares.sum(axis=(0, 2))

        errors, changes = total(self.errors), total(self.changes)
        relative = _ratios(errors, changes)
        with_rounding = _ratios(errors + total(self._excess()), changes) if self.lossy else relative
        worst = int(np.argmax(relative))
        t, states, _ = self.points[int(np.argmax(np.sum((self.errors[:, worst] * weights[worst]) ** 2, axis=1)))]
        at_rest, mean = False, math.sqrt(errors[worst] / sum(held[worst] for _, _, held in self.points))
        if relative[worst] > SUSPECTED:
            one = system.of_member(int(self.members[worst]))
            field = one.rows_of(one.vector_field(one.states_of(self.points[0][1][worst]), self.points[0][0]))
            at_rest = bool(np.linalg.norm(self.scaled(field, worst)) * abs(self.h) <= AT_REST * mean)
        state = states[worst : worst + 1]
        total_error = self.step_count(worst) * mean / (self.motion_of(worst) or math.inf)
        largest = WorstStep(float(with_rounding.max()), float(relative[worst]), worst, t, state, total_error, at_rest)
        if solution._in_memory and len(solution.t) > 1:
            passage, closest = self._passages()
            found = [] if passage is None else [self._fastest_step(*passage)]
            for fastest in filter(None, [*found, self._fastest_step(closest)]):
                if fastest.truncation > largest.truncation:
                    largest = fastest._replace(error=max(largest.error, fastest.error))
        return largest

    def steps_of_turn(self, m: int) -> float:
        """Return the number of steps in which the path of a chosen member is several times the size of its motion."""
        squares = np.sum((self.changes[:, m] * self.weights[m]) ** 2, axis=1)
        mean = math.sqrt(squares.sum() / sum(held[m] for _, _, held in self.points))
        return max(1.0, math.ceil(TURN * self.motion_of(m) / mean)) if mean > 0.0 else math.inf

    def motion_of(self, m: int) -> float:
        """Return the largest distance of a chosen member from its start at the points."""
        known = np.array([states[m] for _, states, held in self.points if held[m]])
        return float(np.linalg.norm(self.scaled(known - known[0], m), axis=1).max())

    def step_count(self, m: int) -> float:
        """Return the number of steps of a chosen member."""
        solution = self.solution
        end = float(ends_by_events(solution)[self.members[m]])
        return abs((solution.t_span[1] if math.isnan(end) else end) - solution.t_span[0]) / solution.step

    @ignore_overflow
    def rounded_group(self) -> tuple[float, int, int] | None:
        """Return the largest change of a group by rounding in the run of a chosen member, that member, and the group.

        The change is relative to the size of the group; None if it is small.
        """
        # If a step loses so many digits that the run could, the run of that member is repeated, or the part of it that
        # few steps reach, with rounding up and down in turns. Groups that are zero but for rounding are left out.
        if not self.lossy:
            return None
        counts = np.array([self.step_count(m) for m in range(len(self.members))])[:, None]
        largest = self.sizes == self.sizes.max(axis=1, keepdims=True)
        own = largest | (self.rounding * np.sqrt(counts) < self.sizes)
        lost = np.where(own & (self.rounding > EXCESS * self.sizes), self.rounding * counts, 0.0)
        ratios = np.divide(lost, self.sizes, out=np.zeros_like(lost), where=self.sizes > 0.0)
        if not ratios.max() > ROUNDED:
            return None
        m = int(np.argmax(ratios.max(axis=1)))
        prepared, state = self.of_member(m), self.points[0][1][m : m + 1]
        whole = float(counts[m, 0])
        steps = max(1, min(math.ceil(whole * (1.0 - ROUNDING)), most_steps(self.solution, state.size, self.h)))
        times = Times(self.solution.t_span[0], self.h, steps, max(1, steps // ROUNDED_POINTS))
        path = trial_states(prepared, state, times)
        rounded = np.concatenate(
            [trial_states(prepared, state, times, partial(advance_in_turns, first=first)) for first in (1, -1)],
            axis=1,
        )
        differences = self.groups.norms(rounded - path).max(axis=(0, 1))
        sizes = self.groups.norms(path)[:, 0].max(axis=0)
        errors = np.divide(
            differences, sizes, out=np.zeros_like(sizes), where=own[m] & (self.starts[m] > 0.0) & (sizes > 0.0)
        )
        # Beyond the steps repeated, errors of rounding are taken as a random walk.
        errors = np.nan_to_num(errors, nan=0.0, posinf=0.0) * math.sqrt(max(1.0, whole / steps))
        # The group that loses most digits is named, others follow it.
        group = int(np.argmax(np.where(errors > ROUNDED, ratios[m], -1.0)))
        return (float(errors[group]), m, group) if errors[group] > ROUNDED else None

    def radians_in_step(self, m: int, group: int) -> float:
        """Return the angle by which a step turns a group if its rounding is that of the angle, otherwise 0."""
        one, moves = self.system.of_member(int(self.members[m])), [0.0]
        for t, states, held in self.points:
            if held[m]:
                field = one.rows_of(one.vector_field(one.states_of(states[m]), t))
                moves.append(abs(self.h) * float(self.groups.norms(field[None])[0, group]))
        by_angle = self.rounding[m, group] <= ROUNDING * max(moves)
        return max(moves) / float(self.sizes[m, group]) if by_angle else 0.0

    def _passages(self) -> tuple[tuple[int, int] | None, int]:
        """Return the fastest passage (saved interval and member, or None), and the interval of the least change."""
        # Of long runs, first the fastest of many equal pieces is found.
        solution, members = self.solution, self.members
        count = len(solution.t) - 1
        stride = min(count, max(1, count * len(members) * self.system.dim // NUMBERS))

        def speeds(first: int, last: int, stride: int) -> Floats:
            """Speeds between every stride-th saved point, (intervals, members); NaN of members that have ended."""
            states = solution.x[first : last + 1 : stride]
            states = states.reshape(len(states), -1, states[0].size // max(1, member_count(solution)))[:, members]
            elapsed = np.abs(np.diff(solution.t[first : last + 1 : stride]))[:, None]
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                found = np.linalg.norm(self.scaled(np.diff(states, axis=0), slice(None)), axis=2) / elapsed
            return np.where(np.isfinite(found), found, np.nan)

        found = speeds(0, count, stride)
        known = ~np.isnan(found)
        mean = np.where(known, found, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        ratios = np.where(known, found / np.where(mean > 0.0, mean, np.inf), 1.0)
        m = int(np.argmax(ratios.max(axis=0)))
        closest = stride * int(np.argmin(ratios.sum(axis=1)))
        if ratios[:, m].max() < PASSAGE:
            return None, closest
        first = stride * int(np.argmax(ratios[:, m]))
        last = min(first + stride, count)
        inner = np.nan_to_num(speeds(first, last, 1)[:, m], nan=0.0) if stride > 1 else np.zeros(1)
        return (first + int(np.argmax(inner)), m), closest

    def _fastest_step(self, k: int, m: int | None = None) -> WorstStep | None:
        """Return the fastest step after saved point k of a chosen member, with the part of its error that counts.

        By default it is the member whose fastest step is the fastest relative to its mean; None if it is no passage.
        """
        solution, h, chosen = self.solution, self.h, slice(None) if m is None else slice(m, m + 1)
        members, t = self.members[chosen], float(solution.t[k])
        states = states_at(solution, members, k)
        steps = math.ceil(abs(float(solution.t[k + 1]) - t) / abs(h) * (1.0 - ROUNDING))
        most = most_steps(solution, states.size, h)
        if not 1 < steps <= (most if m is None else max(STEPS, most)):
            return None if m is None else self._error_of(m, states, t)
        path = trial_states(self.prepared if m is None else self.of_member(m), states, Times(t, h, steps, 1))
        # Steps after the end of a member are not in the run.
        left = (ends_by_events(solution)[members] - t) / h
        path[np.arange(steps + 1)[:, None] - 1.0 > np.where(np.isnan(left), np.inf, left)] = np.nan
        with np.errstate(over="ignore", invalid="ignore"):
            lengths = np.nan_to_num(
                np.linalg.norm(self.scaled(np.diff(path, axis=0), chosen), axis=2), nan=0.0, posinf=0.0
            )
        mean = lengths.mean(axis=0)
        ratios = lengths.max(axis=0) / np.where(mean > 0.0, mean, np.inf)
        fastest = int(np.argmax(ratios))
        if m is None and ratios[fastest] < PASSAGE:
            return None
        j, m = int(np.argmax(lengths[:, fastest])), fastest if m is None else m
        return self._error_of(m, path[j, fastest][None], t + j * h)

    def of_member(self, m: int) -> Preparation:
        """Return the run of a chosen member in one thread."""
        return self.alone.sampled(np.array([m])) if self.system.is_batch else self.alone

    def _error_of(self, m: int, state: Floats, t: float) -> WorstStep:
        """Return a step of a chosen member from a state (1, n), with the part of its error that counts."""
        step = self._step((self.of_member(m),), state, t, self.rounding[m : m + 1])
        errors, changes = np.sum((step[:2] * self.weights[m]) ** 2, axis=2)
        error = FASTEST * float(_ratios(errors, changes)[0])
        return WorstStep(error, error, m, t, state.copy())


def most_steps(solution: Solution, numbers: int, h: float) -> int:
    """Return the largest number of steps that are repeated from so many numbers: few, or a small part of the run."""
    whole = abs(solution.t_span[1] - solution.t_span[0]) / abs(h)
    return max(min(STEPS, REPEATED // numbers), min(int(PART * whole), NUMBERS // numbers))


def trial_states(
    prepared: Preparation, states: Floats, times: Times, advance: Callable[[Run], None] = Run.advance
) -> Floats:
    """Return the states of a trial run, (times, members, n); NaN of members that fail."""
    run = trial_run(prepared, times, states, advance)
    x: Any = run.saved["x"][..., : states.shape[1]]
    x[:, run.state["status"] != 0] = np.nan
    return x


def _ratios(errors: Floats, changes: Floats) -> Floats:
    """Return the roots of the ratios of squares; zero where nothing changes."""
    ratios: Floats = np.nan_to_num(np.sqrt(errors / changes), nan=0.0)
    return ratios


def states_at(solution: Solution, members: NDArray[np.int64], k: int) -> Floats:
    """Return the momenta of the members at a saved point; of members that have ended or failed, those at the start."""
    states = np.where(np.isfinite(solution.x[k]), solution.x[k], solution.x0)
    return any_momenta_of(solution.system, states)[0][members]


def sampled_members(solution: Solution, system: Any) -> NDArray[np.int64]:
    """Return the members whose steps are repeated: the first few of each system, or of systems at equal distances."""
    if not system.is_batch:
        return np.arange(min(member_count(solution), MEMBERS))
    order = np.argsort(system.owners, kind="stable")
    owners = system.owners[order]
    count = int(owners[-1]) + 1
    chosen = np.isin(owners, np.linspace(0, count - 1, min(count, MEMBERS)).astype(np.int64))
    first = np.arange(len(order)) - np.searchsorted(owners, owners) < max(1, MEMBERS // count)
    return np.sort(order[chosen & first])


def sampled_points(
    solution: Solution, system: Any, members: NDArray[np.int64]
) -> list[tuple[float, Floats, NDArray[np.bool_]]]:
    """Return a few times of a run, the start included, the states (members, n) of some members, and who has one."""
    size = vector_size(system)
    start = any_momenta_of(system, solution.x0)[0] if size is None else np.asarray(solution.x0).reshape(-1, size)
    start = start if len(start) == 1 else start[members]
    count = max(1, min(POINTS, NUMBERS // start.size, len(solution.t) - 1))
    points = [(solution.t_span[0], start, np.ones(len(start), dtype=bool))]
    if not solution._in_memory:
        return points  # archives are not read to check steps
    for k in np.linspace(0, len(solution.t) - 1, count, endpoint=False).astype(int)[1:].tolist():
        # Steps of members that have ended or failed are left out.
        held = np.isfinite(solution.x[k]).reshape(member_count(solution), -1).all(axis=1)
        points.append((float(solution.t[k]), states_at(solution, members, k), held[members]))
    return points
