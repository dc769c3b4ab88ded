"""Pilot: errors of short trial runs against a reference over a window from the start, and their growth beyond it."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from coadjoint.long_operations import note_progress
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import reference_scheme
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.loops.loops import Loops, loops_of_batch, loops_of_system
from coadjoint.runs.plan_and_state import Plan
from coadjoint.runs.run import Run
from coadjoint.runs.start import start_without_groups
from coadjoint.runs.times import Times
from coadjoint.short_repr import distinct
from coadjoint.systems.batch import Batch
from coadjoint.systems.coordinates import CoordinateGroups
from coadjoint.systems.system import System

REFERENCE = reference_scheme(16)
# Points of a window at which errors are measured; many divisors, so that runs of any number of steps share some.
POINTS = 240
# Largest number of refinements of the reference; relative changes above UNCONVERGED_CHANGE that stop decreasing
# count as rounding only after MIN_STALLED_REFINEMENTS refinements.
REFINEMENTS = 9
UNCONVERGED_CHANGE = 1e-3
MIN_STALLED_REFINEMENTS = 3
# Smallest number of points from which growth is measured.
MIN_GROWTH_POINTS = 12
# Relative agreement of a step of the reference with two half steps at which it is accepted.
STEP_AGREEMENT = 2.0**-40
# Relative change at which refinement stops: halving the step of an order-16 method leaves 2^-16 of the error, and 16
# times that is at most 64 round-offs.
CONVERGED_CHANGE = 2.0**-35
# Largest expected ratio of two changes by rounding.
MAX_ROUNDING_RATIO = 4.0
# Number of runs with different steps, whose changes by rounding are samples of one distribution.
REPETITIONS = 3
# Rounding below this fraction of the accuracy at the end is negligible, and not measured more precisely.
NEGLIGIBLE_ROUNDING = 2.0**-14
# Largest initial step of the search, in radians at the initial rate.
MAX_INITIAL_ANGLE = 2.0
HALVINGS_OF_GROUPS = 24  # of the initial step, until one is accurate in every group of coordinates
MIN_STEP_FRACTION = 2.0**-60  # of the span: smaller steps would not change the time
# Steps of the reference in a window, for dimensions up to 16; proportionally fewer above, but at least POINTS / 5.
WINDOW_STEPS = 240
# Tolerance on the length of its steps: 240 steps serve where 256 were needed.
STEP_LENGTH_TOLERANCE = 1.07
# Spans of at most this many windows are run as a whole.
MAX_WHOLE_WINDOWS = 2.5
# A trial over the whole span has its error at the end in the last of so many parts.
LAST_PART = 8
# Share of the accuracy for truncation errors at the end where they are extrapolated beyond the window.
EXTRAPOLATED_SHARE = 0.5
# Relative change of the initial state whose growth is measured.
PERTURBATION = 2.0**-30
MAX_PERTURBATION_GROWTH = 0.1  # relative change of the state beyond which the growth is not that of small changes
SEED = 1993  # of the directions of the changes, so that choices are reproducible

# Growth faster than t^2.5 in both doublings of time counts as exponential.
EXPONENTIAL_RATIO = 2.0**2.5
# This growth in the last half alone, after slower growth, counts as the onset of exponential growth.
ONSET_RATIO = 16.0

# Relative error above which the order does not predict the error.
LARGE_ERROR = 0.05

ResultT = TypeVar("ResultT")
# Largest dimension that is cached: larger tables take much memory, and building them is cheap relative to the steps.
MAX_CACHED_DIMENSION = 64
# Entries per system, after which its cache is cleared, and number of systems (least recently used first out).
MAX_ENTRIES = 256
MAX_SYSTEMS = 16


class PilotErrors(NamedTuple):
    """The largest errors of the second halves of a quarter, a half and the whole of a window."""

    quarter: float
    half: float
    whole: float

    @classmethod
    def of_run(cls, errors: NDArray[np.float64], last: int = 2) -> PilotErrors:
        """Return those of errors at evenly spaced points of a window, without its start; of the whole, the last part of
        so many equal ones.
        """
        count = len(errors)
        parts = errors[count // 8 : count // 4], errors[count // 4 : count // 2], errors[count - -(-count // last) :]
        return cls(*(float(np.max(part, initial=0.0)) for part in parts))

    def factor(self, windows: float, min_power: float = 1.0) -> float:
        """Return the ratio (>= 1, or inf) of the error after `windows` >= 1 windows to that after one."""
        # Linear, unless both doublings show a faster power; exponential above t^2.5. `min_power` 2: lost integrals.
        if windows <= 1.0 or self.whole == 0.0:
            return 1.0
        late, early = _ratio(self.whole, self.half), _ratio(self.half, self.quarter)
        slowest = min(late, early)
        if slowest > EXPONENTIAL_RATIO or (late > ONSET_RATIO and math.sqrt(late * early) > EXPONENTIAL_RATIO):
            # Their product is the growth over three quarters of a window.
            exponent = math.log(late * early) / 0.75 * (windows - 1.0)
            return math.exp(exponent) if exponent < 700.0 else math.inf
        return windows ** max(min_power, math.log2(slowest) if slowest > 0.0 else 0.0)


def _ratio(late: float, early: float) -> float:
    return late / early if early > 0.0 else 1.0


class Trial(NamedTuple):
    """A run over the window: steps, errors, iterations and evaluations per step and member, use of Newton's method."""

    steps: int
    growth: PilotErrors
    iterations: float
    evaluations: float
    newton: bool = False

    @property
    def error(self) -> float:
        """The largest error in the second half of the window, relative to the largest momentum."""
        return self.growth.whole


class Pilot:
    """A window from the start of a run, its reference, and the growth of small changes of the initial state in it."""

    # `momenta` (members, n) are those of the sampled members; rounding far below `accuracy` is not measured again.
    # `share` is that of the accuracy which truncation errors of these members may take.

    def __init__(
        self,
        system: System | Batch,
        momenta: NDArray[np.float64],
        t0: float,
        span: float,
        accuracy: float = 0.0,
        share: float = 1.0,
    ) -> None:
        self.system, self.momenta, self.t0, self.span = system, momenta, t0, span
        # Errors are relative to the sizes of groups of coordinates, whose units are independent.
        self.groups = CoordinateGroups(system)
        self.natural_step = self._natural_step()
        min_steps = POINTS // 5
        steps = max(min_steps, min(WINDOW_STEPS, WINDOW_STEPS * 16 // system.dim))
        self.window = (
            abs(span) if abs(span) <= MAX_WHOLE_WINDOWS * steps * self.natural_step else steps * self.natural_step
        )
        self.windows = abs(span) / self.window
        self.share = share if self.covers_span else EXTRAPOLATED_SHARE * share
        self.points = POINTS if steps >= POINTS else min_steps
        coarse, self.reference, self.reference_steps = self._converged_reference()
        self.size = self.groups.sizes(self.reference)
        # A group that is zero but for rounding has no size: it is lost at once, relative to its size until then, even
        # if its rounding grows, and remains so; others are lost only after their errors grew.
        differences = self.groups.norms(self.reference - coarse)
        lost = np.ones(self.size.shape, dtype=bool)
        for part in (self.points // 16 + 1, self.points + 1):
            lost &= differences[:part].max(axis=0) > UNCONVERGED_CHANGE * self.groups.sizes(self.reference[:part])
        self.size = np.where(lost, np.inf, self.size)
        self.sensitivity = self._sensitivity(coarse)
        self.noise = self._noise(coarse, accuracy)
        self.speed = self._speed()

    @property
    def covers_span(self) -> bool:
        """Whether the window is the whole span."""
        return self.windows == 1.0

    def comparable_steps(self, steps: float, finer: bool = True) -> int:
        """Round a number of steps (up if `finer`) to one that shares enough points with the reference."""
        number = max(1, math.ceil(steps) if finer else math.floor(steps))
        while math.gcd(number, self.points) < min(
            number, MIN_GROWTH_POINTS if number < 8 * MIN_GROWTH_POINTS else 2 * MIN_GROWTH_POINTS, self.points
        ):
            number += 1 if finer else -1
        return number

    def run(self, method: Method, steps: int, momenta: NDArray[np.float64] | None = None) -> Run:
        """Run over the window, saving the points shared with the reference."""
        start = self.momenta if momenta is None else momenta
        length = math.copysign(self.window, self.span)
        every = steps // math.gcd(steps, self.points)
        return short_run(self.system, method, start, self.t0, length, steps, every)

    def trial(self, method: Method, steps: int | None = None) -> Trial | None:
        """Run a scheme over the window; None if a member fails. Without `steps`, those that it chooses are counted."""
        run, members = self.run(method, self.points if steps is None else steps), len(self.momenta)
        if np.any(run.state["status"]):
            return None
        iterations, evaluations = int(run.state["iterations"].sum()), int(run.state["evaluations"].sum())
        newton, per_step = method.took_newton(run.state["memory"]), float(method.order)
        if steps is None:
            steps = max(1, math.ceil(evaluations / (method.order * members)))
        else:
            per_step = evaluations / (steps * members)
        return Trial(steps, self.growth_of(run.saved["x"]), iterations / (steps * members), per_step, newton)

    def growth_of(self, states: NDArray[np.float64], motion: NDArray[np.float64] | None = None) -> PilotErrors:
        """Compare states at evenly spaced points of the window with the reference, or with another motion."""
        count = len(states) - 1
        reference = self.reference if motion is None else motion
        differences = self.groups.ratios(states - reference[:: self.points // count], self.size)
        # If nothing is extrapolated, errors at the end count.
        last = LAST_PART if self.covers_span and motion is None else 2
        return PilotErrors.of_run(np.max(differences, axis=1)[1:], last)

    def _natural_step(self) -> float:
        """Return the largest step, among halves of the span, at which the reference is accurate from the start."""
        rates = rates_of(self.system, self.groups, self.momenta, self.t0)
        if not np.all(np.isfinite(rates)):
            raise ValueError(
                f"the vector field at x0 is not finite, so {self.system.name} cannot be integrated from it"
            )
        # If a group is zero but for rounding, no step is accurate in it.
        for groups, halvings in ((self.groups, HALVINGS_OF_GROUPS), (None, 64)):
            found = self._accepted_step(groups, halvings, float(np.max(rates)))
            if found is not None:
                return found
        raise ValueError(f"no step is small enough for {self.system.name} at x0: a trial run fails at the first step")

    def _accepted_step(self, groups: CoordinateGroups | None, halvings: int, rate: float) -> float | None:
        """Return the largest accurate step, by groups or of the whole state, after at most so many halvings."""
        h = abs(self.span)
        while h * rate > MAX_INITIAL_ANGLE and h > MIN_STEP_FRACTION * abs(self.span):
            h /= 2
        initial_h = h
        full: NDArray[np.float64] | None = None
        for _ in range(halvings):
            halves = self._first_steps(h, 2)
            full = full if full is not None or halves is None else self._first_steps(h, 1)
            if _agree(groups, full, halves):
                break
            # The first of two half steps is the next full step.
            full = None if halves is None else halves[:2]
            h /= 2
        else:
            return None
        # Near x = 0 the initial rate is no scale of the motion, so an accepted first step may grow.
        while (
            h >= initial_h
            and 2 * h <= abs(self.span)
            and _agree(groups, *(self._first_steps(2 * h, n) for n in (1, 2)))
        ):
            h *= 2
        return h

    def _first_steps(self, time: float, steps: int) -> NDArray[np.float64] | None:
        """Return the states of a few steps of the reference, with the start; None if a member fails."""
        signed = math.copysign(time, self.span)
        run = short_run(self.system, REFERENCE, self.momenta, self.t0, signed, steps)
        return None if np.any(run.state["status"]) else run.saved["x"]

    def _converged_reference(self) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
        """Refine the reference until it converges; return the last two, and the steps of the last one."""
        min_steps = self.points * math.ceil(self.window / self.natural_step / self.points / STEP_LENGTH_TOLERANCE)
        previous, change, stalled = None, None, 0
        failed: Run | None = None
        for steps in (min_steps * 2**k for k in range(REFINEMENTS)):
            run = self.run(REFERENCE, steps)
            if np.any(run.state["status"]):
                failed, previous = run, None
                continue
            states = run.saved["x"]
            if previous is not None:
                size, difference = self.groups.sizes(states), self.groups.norms(states - previous).max(axis=0)
                stalled = stalled + 1 if change is not None and not np.any(difference < change / 16) else 0
                # Large changes may decrease only at smaller steps, or not at all if the motion is chaotic.
                done = stalled >= (1 if np.all(difference <= UNCONVERGED_CHANGE * size) else MIN_STALLED_REFINEMENTS)
                if done or np.all(difference <= CONVERGED_CHANGE * size):
                    return previous, states, steps
                change = difference
            previous = states
        raise ValueError(self._failure_text(failed))

    def _failure_text(self, failed: Run | None) -> str:
        if failed is None:
            return f"the motion of {self.system.name} from x0 is too irregular: no step of its trial run converges"
        step = int(np.max(failed.state["step"][failed.state["status"] != 0]))
        when = distinct(self.t0 + step * failed.times.h, self.t0)[0]
        return (
            f"the motion of {self.system.name} from x0 cannot be computed over t_span: its trial run fails near "
            f"t = {when}, where it blows up or stops being defined; end t_span before that"
        )

    def _noise(self, coarse: NDArray[np.float64], accuracy: float) -> float:
        """Return the rounding error of the reference, relative to the motion, at the worst point."""

        def largest(states: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray(self.groups.ratios(states - self.reference, self.size).max(axis=0))

        difference = largest(coarse)
        change = MAX_ROUNDING_RATIO * difference
        # A single change may be small by chance, or truncation of the coarse run; other numbers of steps show rounding.
        if np.any(self.sensitivity.factor(self.windows) * change > NEGLIGIBLE_ROUNDING * accuracy):
            repeated = [self.run(REFERENCE, self.reference_steps + k * self.points) for k in range(1, REPETITIONS + 1)]
            succeeded = [repetition.saved["x"] for repetition in repeated if not np.any(repetition.state["status"])]
            if succeeded:
                spread = np.max([largest(states) for states in succeeded], axis=0)
                change = np.maximum(spread, np.minimum(difference, MAX_ROUNDING_RATIO * spread))
        return max(UNIT_ROUNDOFF, float(np.max(change)))

    def _sensitivity(self, coarse: NDArray[np.float64]) -> PilotErrors:
        """Return the relative growth of a small change of the initial state, with the steps of the coarse reference."""
        direction = np.random.default_rng(SEED).standard_normal(self.momenta.shape)
        # Each group by its own size: small ones, too, have rounding errors in proportion.
        own = self.groups.norms(self.reference).max(axis=0)
        direction *= PERTURBATION * (own / self.groups.norms(direction))[:, self.groups.labels]
        run = self.run(REFERENCE, self.reference_steps // 2, self.momenta + direction)
        grown = None if np.any(run.state["status"]) else self.growth_of(run.saved["x"], coarse)
        if grown is None or grown.whole > MAX_PERTURBATION_GROWTH:
            # Growth saturates at the size of the motion, so exponential growth is assumed.
            return PilotErrors(math.sqrt(PERTURBATION), 1.0, 1.0 / PERTURBATION)
        return PilotErrors(*(value / PERTURBATION for value in grown))

    def _speed(self) -> float:
        """Return the largest speed relative to the size, over the window."""
        h = math.copysign(self.window / self.points, self.span)
        every = range(0, self.points + 1, self.points // 12)
        return max(
            float(np.max(rates_of(self.system, self.groups, self.reference[k], self.t0 + k * h, self.size)))
            for k in every
        )


def _agree(
    groups: CoordinateGroups | None, full: NDArray[np.float64] | None, halves: NDArray[np.float64] | None
) -> bool:
    """Test whether one step and two half steps succeed and agree, in each group or as a whole."""
    if full is None or halves is None:
        return False
    difference = full[-1] - halves[-1]
    if groups is None:
        size = np.max(np.linalg.norm(halves, axis=2), axis=0)
        return bool(np.all(np.linalg.norm(difference, axis=1) <= STEP_AGREEMENT * size))
    return bool(np.all(groups.norms(difference) <= STEP_AGREEMENT * groups.sizes(halves)))


def rates_of(
    system: System | Batch,
    groups: CoordinateGroups,
    states: NDArray[np.float64],
    t: float,
    sizes: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Return the largest rates of groups at states (members, n), by default relative to their sizes there."""
    fields = np.array([system.of_member(m).vector_field(x, t) for m, x in enumerate(states)])
    units = np.abs(fields).max(axis=1, keepdims=True)  # squares of fields may overflow
    units[units == 0.0] = 1.0
    return groups.ratios(fields / units, groups.sizes(states[None]) if sizes is None else sizes) * units[:, 0]


def short_run(
    system: System | Batch,
    method: Method,
    momenta: NDArray[np.float64],
    t0: float,
    time: float,
    steps: int,
    save_every: int = 1,
    advanced: bool = True,
) -> Run:
    """Run without attitude and watching (unless `advanced`, before its first step); `status` records failures."""
    start = start_without_groups(system, momenta)
    times = Times(t0, time / steps, steps, save_every)
    note_progress(f"a pilot run of {steps} step{'' if steps == 1 else 's'} by {type(method).__name__}")
    run = Run(Plan(system, method, loops_of(system, method, times.h), times, start.groups.shape), start)
    if advanced:
        run.advance()
    return run


@lru_cache(maxsize=MAX_SYSTEMS)
def _cache_of(system: System | Batch) -> dict[Hashable, Any]:
    return {}


def cached_for_system(system: System | Batch, key: Hashable, compute: Callable[[], ResultT]) -> ResultT:
    """Return a result cached for an immutable system and a hashable key; callers must not modify it."""
    if system.dim > MAX_CACHED_DIMENSION:
        return compute()
    try:
        cache = _cache_of(system)
        result: ResultT = cache[key]
    except KeyError:
        result = compute()
        if len(cache) >= MAX_ENTRIES:
            cache.clear()
        cache[key] = result
    except TypeError:
        return compute()
    return result


def loops_of(system: System | Batch, method: Method, h: float) -> Loops:
    """Return the loops of a short run, cached if they depend on neither the step nor user functions."""

    def build() -> Loops:
        if system.is_batch:
            return loops_of_batch(system, method, h, [None] * len(system))
        return loops_of_system(system, method, h, casimirs={})

    return (
        cached_for_system(system, ("loops", method), build)
        if method.tables_of_any_step and not _has_functions(system)
        else build()
    )


def _has_functions(system: System | Batch) -> bool:
    return any(one.algebra is None or any(term.called for term in one.hamiltonian.terms()) for one in system.distinct)
