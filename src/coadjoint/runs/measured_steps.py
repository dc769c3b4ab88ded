"""Steps of a run measured at a few points: the error by two half steps, the change of the state, and rounding."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.partial_steps import PartialSteps
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import ends_by_events, member_count
from coadjoint.runs.run import Run, rounding
from coadjoint.runs.start import any_momenta_of, start_without_groups, vector_size
from coadjoint.runs.times import STEP_SHARE, Times
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.evaluation import ignore_overflow

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Weight of the error of the single fastest step, beside that of the others in the root mean square.
FASTEST = 0.4
# Least speed of a passage, relative to the mean speed; below, the steps at the points represent all.
PASSAGE = 2.0
# Short runs, of no more steps than this, are repeated as a whole, so that findings do not depend on saved points;
# so are longer ones in which the energy deviates. Else this part of a run is.
STEPS, PART, SUSPECTED_STEPS = 1000, 0.05, 10000
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
HALVES = 2  # parts of the step with which it is compared
# Rounding of a group in a step, relative to its size, below which the group keeps its digits in any run.
EXCESS = 2.0**14 * UNIT_ROUNDOFF
# Rounding of a step, relative to a group at the start, above which the group is zero but for rounding.
OF_ZERO = 1.0 / 64.0

# Largest number of points, and of members, at which the step is repeated; of members with the fastest passages.
POINTS, MEMBERS, FASTEST_MEMBERS = 5, 64, 4
# Largest number of entries of the states that are repeated; at least one state.
NUMBERS = 2**20


class WorstStep(NamedTuple):
    """The largest error of a step of a chosen member, as far as shorter steps reduce it, its time and state."""

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
    def __init__(self, solution: Solution, prepared: PreparedRun | None, suspects: tuple[int, ...] = ()) -> None:
        # An archive need not know its scheme and system; that of a run with inputs has their values.
        described: Any = solution if prepared is None or prepared.inputs is not None else prepared
        method, system = described.method, described.system
        if method.own_steps:
            raise TypeError(f"{method} chooses its own steps, and controls their error; there is no step to measure")
        if system.has_noise:
            raise TypeError(f"{system.name} has random forces, which are defined for whole steps only")
        # Loops of a run with attitudes need elements, and those with inputs their values.
        if prepared is None or prepared.representation is not None or prepared.inputs is not None:
            prepared = PreparedRun(system, method, solution.step, watch=False, threads=1)
        self.solution, self.method, self.system = solution, method, system
        self.groups = CoordinateGroups(system)
        self.h = math.copysign(solution.step, solution.t_span[1] - solution.t_span[0])
        size, steps = vector_size(system), abs(solution.t_span[1] - solution.t_span[0]) / solution.step
        start = any_momenta_of(system, solution.x0)[0] if size is None else np.asarray(solution.x0).reshape(-1, size)
        n, short = start.shape[1], (SUSPECTED_STEPS, NUMBERS) if suspects else (STEPS, REPEATED)
        self.short = steps <= min(short[0], short[1] // n) + ROUNDING
        most = int(NUMBERS / (n * max(1.0, steps))) if self.short else MEMBERS
        chosen = sampled_members(solution, system, max(1, min(MEMBERS, most)))
        self.members = members = np.union1d(chosen, np.array(suspects, dtype=np.int64))
        self.start = start if len(start) == 1 else start[members]
        if system.is_batch and len(members) < len(system):
            prepared = prepared.sampled(members)
        self.prepared, self.alone = prepared, prepared.in_one_thread()
        self._know_states(int(steps + STEP_SHARE))
        self.points = points = self._points()
        states = [states for _, states, _ in points]
        threads = prepared.threads_for(POINTS * len(members)) if POINTS * self.start.size >= THREADED else (1, 1)
        self._parts = PartialSteps(prepared.system, prepared.method, prepared.loops(self.h), *threads)
        rows, times = np.tile(np.arange(len(members)), len(points)), np.repeat([t for t, *_ in points], len(members))
        step = self._step(rows, np.concatenate(states), times).reshape(3, len(points), -1, self.groups.count)
        norms = self.groups.norms(states[0][None] if len(points) == 1 else np.stack(states))
        held = np.stack([held for _, _, held in points])
        if not held.all():
            step, norms = np.where(held[..., None], step, 0.0), norms * held[..., None]
        # By point, member and group: errors of a step by its length, changes in it, and differences by rounding.
        self.errors, self.changes, self.rounding_at_points = step
        self.starts, self.sizes, self.rounding = norms[0], norms.max(axis=0), self.rounding_at_points.max(axis=0)
        self.weights = self._weights()

    def _know_states(self, steps: int) -> None:
        """Set the times at which states are known, and the path of a short run of which not every step is saved."""
        solution, t0 = self.solution, self.solution.t_span[0]
        whole = solution.save_every == 1 and solution.t_eval is None
        self.t, self._path = solution.t, None
        if self.short and not (solution._in_memory and (solution.incomplete or whole)):
            times = Times(t0, self.h, steps, 1)
            self.t, self._path = times.saved_times, trial_states(self.prepared, self.start, times)
            self._path[(self.t[:, None] - ends_by_events(solution)[self.members]) * self.h > 0.0] = np.nan
        elif not solution._in_memory:
            # Archives are not read to check steps.
            self.t, self._path = np.array([t0]), self.start[None]
        # Samples of forces are at whole steps.
        elapsed = (self.t - t0) / self.h
        self.steps_begin = (np.abs(elapsed - np.rint(elapsed)) <= STEP_SHARE) | np.array(not self.system.has_samples)

    def states(self, k: int) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the states (members, n) at a known time, and who has one: who has not has that of the start."""
        if self._path is not None:
            held = np.isfinite(self._path[k]).all(axis=1)
            return np.where(held[:, None], self._path[k], self.start), held
        held = np.isfinite(self.solution.x[k]).reshape(member_count(self.solution), -1).all(axis=1)
        return states_at(self.solution, self.members, k), held[self.members]

    def _points(self) -> list[tuple[float, Floats, NDArray[np.bool_]]]:
        """Return a few times of the run, the start included, the states (members, n), and who has one."""
        known = np.flatnonzero(self.steps_begin)
        count = max(1, min(POINTS, NUMBERS // self.start.size, len(known) - 1))
        chosen = known[np.linspace(0, len(known) - 1, count, endpoint=False).astype(int)[1:]].tolist()
        start = self.solution.t_span[0], self.start, np.ones(len(self.start), dtype=bool)
        return [start, *((float(self.t[k]), *self.states(k)) for k in chosen)]

    def _step(
        self,
        m: Integers,
        states: Floats,
        t: Floats,
        known_rounding: Floats | None = None,
        h: float | None = None,
        parts: int = HALVES,
    ) -> Floats:
        """Return errors, changes, rounding (3, rows, groups) of steps from states; zero if not repeatable."""
        h, groups, n = self.h if h is None else h, self.groups, states.shape[1]

        def ends(x: Floats, t: Floats, *lengths: float) -> list[Floats]:
            """Return the ends of steps of each of these lengths."""
            count = len(lengths)
            rows = np.tile(x, (count, 1)), np.empty((count * len(x), 0)), np.tile(t, count)
            taken = self._parts.attempt(*rows, np.repeat(lengths, len(x)), np.tile(m, count))
            return np.split(taken.momenta, count)

        # Behind the coordinates are the works of forces.
        works = self._parts.loops.size - n
        start = np.pad(states, ((0, 0), (0, works))) if works else states
        finer, full = ends(start, t, h / parts, h)
        change, full = groups.norms(finer[:, :n] - states), full[:, :n]
        for part in range(1, parts):
            (finer,) = ends(finer, t + part * h / parts, h / parts)
        # The difference of two half steps from a step of order p is all but 2^-p of the error of the latter.
        errors = error_by_comparison(groups.norms(full - finer[:, :n]), parts**-self.prepared.scheme.order)
        changes = np.maximum(groups.norms(full - states), change)
        if known_rounding is None:
            with rounding(1):
                known_rounding = groups.norms(ends(start, t, h)[0][:, :n] - full)
            known_rounding[~np.isfinite(known_rounding)] = 0.0
        sizes = groups.norms(states)
        # If a step loses the largest group too, it is so large that it amplifies rounding.
        amplified = np.where(sizes == sizes.max(axis=1, keepdims=True), known_rounding > WARNED * sizes, False)
        rounded = np.where(amplified.any(axis=1, keepdims=True), 0.0, HALVED * known_rounding)
        errors = np.maximum(0.0, errors - np.maximum(ROUNDING * sizes, rounded))
        failed = ~np.isfinite(errors + changes).all(axis=1)
        # The iteration of an implicit scheme may fail for half a step, and not for a third. Of a step of which both
        # fail all is error.
        moved = groups.norms(full[failed] - states[failed])
        errors[failed] = changes[failed] = np.where(np.isfinite(moved), moved, 0.0)
        step = np.stack([errors, changes, known_rounding])
        if failed.any() and parts == HALVES:
            step[:, failed] = self._step(m[failed], states[failed], t[failed], known_rounding[failed], h, parts + 1)
        return step

    @property
    def lossy(self) -> bool:
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
    def worst(self) -> tuple[float, list[WorstStep]]:
        """Return the largest error of a step, relative to the change in it, and the worst step of each member."""
        system, weights = self.system, self.weights

        def total(part: Floats) -> Floats:
            squares: Floats = (part * weights) ** 2
            return squares.sum(axis=(0, 2))

        errors, changes = total(self.errors), total(self.changes)
        relative = _ratios(errors, changes)
        error = float((_ratios(errors + total(self._excess()), changes) if self.lossy else relative).max())
        steps = []
        for m in range(len(self.members)):
            t, states, _ = self.points[int(np.argmax(np.sum((self.errors[:, m] * weights[m]) ** 2, axis=1)))]
            at_rest, mean = False, math.sqrt(errors[m] / sum(held[m] for _, _, held in self.points))
            if relative[m] > SUSPECTED:
                one = system.of_member(int(self.members[m]))
                field = one.rows_of(one.vector_field(one.states_of(self.start[m]), self.points[0][0]))
                at_rest = bool(np.linalg.norm(self.scaled(field, m)) * abs(self.h) <= AT_REST * mean)
            total_error = self._total_of_steps(self.errors[:, m], m, self.h)
            steps.append(WorstStep(float(relative[m]), m, t, states[m : m + 1], total_error, at_rest))
        for fastest in self._passages():
            error = max(error, fastest.truncation)
            if fastest.truncation > steps[fastest.m].truncation:
                steps[fastest.m] = fastest
        return error, steps

    def _total_of_steps(self, errors: Floats, m: int, h: float) -> float:
        """Return errors (points, groups) of a member added up over steps h of the run, relative to its motion."""
        held = [held[m] for _, _, held in self.points]
        mean = float(np.linalg.norm(errors[held] * self.weights[m], axis=1).mean())
        return self.step_count(m) * abs(self.h / h) * mean / (self.motion_of(m) or math.inf)

    @ignore_overflow
    def in_steps_of(self, h: float, m: int) -> tuple[float, float]:
        """Return the error of steps of another length of a chosen member at the points, and of all in the run."""
        held = np.array([held[m] for _, _, held in self.points])
        states, times = np.array([x[m] for _, x, _ in self.points]), np.array([t for t, *_ in self.points])
        errors, changes, _ = self._step(np.full(len(times), m), states, times, self.rounding_at_points[:, m], h)
        squares = [np.sum((some[held] * self.weights[m]) ** 2) for some in (errors, changes)]
        return float(_ratios(*squares)), self._total_of_steps(errors, m, h)

    def steps_of_turn(self, m: int) -> float:
        """Return the number of steps in which the path of a chosen member is several times the size of its motion."""
        squares = np.sum((self.changes[:, m] * self.weights[m]) ** 2, axis=1)
        mean = math.sqrt(squares.sum() / sum(held[m] for _, _, held in self.points))
        return max(1.0, math.ceil(TURN * self.motion_of(m) / mean)) if mean > 0.0 else math.inf

    def motion_of(self, m: int) -> float:
        """Return the largest distance of a chosen member from its start at the points, or in steps and half steps."""
        known = np.array([states[m] for _, states, held in self.points if held[m]])
        distances = np.linalg.norm(self.scaled(known - known[0], m), axis=1)
        return max(float(distances.max()), self.largest_change(m))

    def largest_change(self, m: int) -> float:
        """Return the largest change of a chosen member in a step, or half of one: the other half may undo it."""
        return float(np.linalg.norm(self.changes[:, m] * self.weights[m], axis=1).max())

    def some_states(self, member: int, count: int) -> tuple[Floats, Floats]:
        """Return times and states (times, n) of one of the chosen `members` at so many known points at most."""
        points = np.unique(np.linspace(0, len(self.t) - 1, count).astype(int))
        m = int(np.searchsorted(self.members, member))
        if self._path is None:
            return self.t[points], np.array([self.states(k)[0][m] for k in points.tolist()])
        known = points[np.isfinite(self._path[points, m]).all(axis=1)]
        return self.t[known], self._path[known, m]

    def has_waves(self, m: int) -> bool:
        """Test whether a chosen member is a fluid, whose fields superpose waves of different frequencies."""
        one = self.system.of_member(int(self.members[m]))
        return bool(one.has_matrices and one.fluid is not None)

    def step_count(self, m: int) -> float:
        solution = self.solution
        end = float(ends_by_events(solution)[self.members[m]])
        return abs((solution.t_span[1] if math.isnan(end) else end) - solution.t_span[0]) / solution.step

    def _passages(self) -> list[WorstStep]:
        """Return the fastest steps of members between the known points between which they change most."""
        # Of long runs, first the fastest of many equal pieces is found.
        solution, members = self.solution, self.members
        count = len(self.t) - 1
        if count < 1:
            return []
        stride = min(count, max(1, count * len(members) * self.system.dim // NUMBERS))

        def speeds(first: int, last: int, stride: int) -> Floats:
            """Speeds between every stride-th known point, (intervals, members); NaN of members that have ended."""
            chosen = slice(first, last + 1, stride)
            if self._path is None:
                states = solution.x[chosen]
                states = states.reshape(len(states), -1, states[0].size // max(1, member_count(solution)))[:, members]
            else:
                states = self._path[chosen]
            elapsed = np.abs(np.diff(self.t[chosen]))[:, None]
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                found = np.linalg.norm(self.scaled(np.diff(states, axis=0), slice(None)), axis=2) / elapsed
            return np.where(np.isfinite(found), found, np.nan)

        found = speeds(0, count, stride)
        known = ~np.isnan(found)
        mean = np.where(known, found, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        ratios = np.where(known, found / np.where(mean > 0.0, mean, np.inf), 1.0)
        fastest = []
        for m in np.argsort(-ratios.max(axis=0), kind="stable")[:FASTEST_MEMBERS].tolist():
            if ratios[:, m].max() >= PASSAGE:
                first = stride * int(np.argmax(ratios[:, m]))
                last = min(first + stride, count)
                inner = np.nan_to_num(speeds(first, last, 1)[:, m], nan=0.0) if stride > 1 else np.zeros(1)
                k = first + int(np.argmax(inner))
                if self.steps_begin[k]:
                    fastest.append((m, *self._fastest_step(k, m)))
        if not fastest:
            return []
        rows, times, states = (np.array(column) for column in zip(*fastest, strict=True))
        step = self._step(rows, states, times, self.rounding[rows])
        errors, changes = np.sum((step[:2] * self.weights[rows]) ** 2, axis=2)
        # The part of their errors that counts.
        truncations = (FASTEST * _ratios(errors, changes)).tolist()
        return [WorstStep(one, m, t, x[None]) for one, (m, t, x) in zip(truncations, fastest, strict=True)]

    def _fastest_step(self, k: int, m: int) -> tuple[float, Floats]:
        """Return time and state (n,) where the fastest step after known point k of a chosen member begins."""
        h, t, state = self.h, float(self.t[k]), self.states(k)[0][m]
        steps = math.ceil(abs(float(self.t[k + 1]) - t) / abs(h) * (1.0 - ROUNDING))
        if not 1 < steps <= max(STEPS, most_steps(self.solution, state.size, h)):
            return t, state
        path = trial_states(self.of_member(m), state[None], Times(t, h, steps, 1))[:, 0]
        # Steps after the end of a member are not in the run.
        left = (ends_by_events(self.solution)[self.members[m]] - t) / h
        path[np.arange(steps + 1) - 1.0 > (math.inf if math.isnan(left) else left)] = np.nan
        with np.errstate(over="ignore", invalid="ignore"):
            lengths = np.linalg.norm(self.scaled(np.diff(path, axis=0), m), axis=1)
        j = int(np.argmax(np.nan_to_num(lengths, nan=0.0, posinf=0.0)))
        return t + j * h, path[j].copy()

    def of_member(self, m: int) -> PreparedRun:
        """Return the run of a chosen member in one thread."""
        return self.alone.sampled(np.array([m])) if self.system.is_batch else self.alone


def most_steps(solution: Solution, numbers: int, h: float) -> int:
    """Return the largest number of steps that are repeated from so many numbers: few, or a small part of the run."""
    whole = abs(solution.t_span[1] - solution.t_span[0]) / abs(h)
    return max(min(STEPS, REPEATED // numbers), min(int(PART * whole), NUMBERS // numbers))


def trial_states(
    prepared: PreparedRun, states: Floats, times: Times, advance: Callable[[Run], None] = Run.advance
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


def sampled_members(solution: Solution, system: Any, most: int) -> NDArray[np.int64]:
    """Return the members whose steps are repeated: the first few of each system, or of systems at equal distances."""
    if not system.is_batch:
        return np.arange(min(member_count(solution), most))
    order = np.argsort(system.owners, kind="stable")
    owners = system.owners[order]
    count = int(owners[-1]) + 1
    chosen = np.isin(owners, np.linspace(0, count - 1, min(count, most)).astype(np.int64))
    first = np.arange(len(order)) - np.searchsorted(owners, owners) < max(1, most // count)
    return np.sort(order[chosen & first])


def error_by_comparison(difference: Any, left: float) -> Any:
    """Return the error of a result from its difference to a better one, which has the fraction `left` of the error."""
    return difference / (1.0 - left)


def trial_run(
    prepared: PreparedRun, times: Times, momenta: NDArray[np.float64], advance: Callable[[Run], None] = Run.advance
) -> Run:
    """Run from momenta (members, n) without group elements; failures are in `status` of its state."""
    run = prepared.begun(times, start_without_groups(prepared.system, momenta))
    advance(run)
    return run
