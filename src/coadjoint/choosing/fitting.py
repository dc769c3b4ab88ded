"""Fits of one scheme, by trials over the window of a pilot: its number of steps, or the tolerance of its own steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.pilot import CONVERGED_CHANGE, LARGE_ERROR, REFERENCE, Pilot, PilotErrors, Trial
from coadjoint.rounding import UNIT_ROUNDOFF

MAX_TRIALS = 10  # runs of one scheme; most take two
# Largest cost of a trial, in rotations (30 ms), for any accuracy; smaller steps are extrapolated by the order.
MAX_TRIAL_COST = 3e6
# Largest cost of the confirmation of a choice, which may be repeated.
MAX_CONFIRMATION_COST = 16 * MAX_TRIAL_COST
MAX_CORRECTIONS = 6  # runs of a confirmation
# Share of the accuracy at which fits aim, and the ratio to it up to which a confirmed error is accepted.
AIMED_SHARE, ACCEPTED_RATIO = 0.6, 1.4
# Smallest target of the error, which is used as a divisor.
MIN_GOAL = 2.0**-1000
# Factor on the number of steps where the order does not predict the error.
STEP_INCREASE = 1.2
# Smallest relative change of the number of steps for which a confirmation is repeated.
MIN_CHANGE = 0.02
# Smallest ratio of a measurable truncation error to rounding and to the error of the reference.
MEASURABLE_RATIO = 16.0
# Errors up to this multiple of the expected rounding may be rounding.
ROUNDING_MULTIPLE = 4.0
# Factor on the number of steps at which an unstable scheme fails, with which it mostly succeeds.
UNSTABLE_STEP_FACTOR = 1.5
# Relative errors at the end from which on no extrapolation to smaller steps is possible.
MEANINGLESS_ERROR = 1.0
# Largest ratio of steps across which a trial is extrapolated without another one.
MAX_EXTRAPOLATION = 1.15
# A scheme is abandoned at (1 + this / order) times the cost of another: trials predict the steps of high orders more
# accurately.
ABANDON_COST_EXCESS = 6.0
# Bounds of the steps of a first trial relative to the usual ones, and of its cost to that of another scheme.
MAX_INITIAL_REFINEMENT, MAX_INITIAL_COARSENING, MAX_TRIAL_RATIO = 4.0, 10.0, 2.0
UNIT_TRIAL = Trial(1, PilotErrors(0.0, 0.0, 0.0), 1.0, 1.0)
# Of the tolerance of a scheme with variable steps, most fits take two runs.
MAX_TOLERANCE_TRIALS = 6
# Accepted ratio of the target error of variable steps to the error.
GOAL_RATIO = 1.5
# Largest factor between the tolerances of consecutive trials.
MAX_TOLERANCE_RATIO = 1e6
# Initial ratio of the tolerance to the target error, since errors of steps add up.
INITIAL_TOLERANCE_RATIO = 0.3

# Unbiased rounding of the momentum per flow, in units of u, measured by Casimirs of so(3) and e(3) after 10^7 steps.
# Smaller for Gauss methods, which preserve quadratic invariants and round only their slopes.
FLOW_WALK = 0.5
GAUSS_WALK = 0.1
# Largest bias per flow that was measured: Casimirs of so(3) with a full M.
FLOW_BIAS = 7e-4
# Runs of the reference with different rounding are samples of the rounding of any scheme: normal variables of one
# width along the direction of fastest growth. Another sample exceeds 4 / 3 ROUNDING_MARGIN times the largest of three
# differences from a fourth with probability 0.003.
ROUNDING_MARGIN = 4.0
# Largest part of the accuracy that rounding alone may take.
ROUNDING_SHARE = 0.5
# Coefficients of a composition are rounded independently, so its time error grows as the root of their number.
COEFFICIENT_ERROR = 3.0
# A compensated sum rounds only the increments. Flows move the state further than the motion does, since other parts
# partly undo their increments.
FLOW_PATH_RATIO = 4.0


@dataclass(frozen=True)
class StepFit:
    """A scheme with the number of its steps in the span, and the truncation error expected at the end."""

    pilot: Pilot
    candidate: Candidate
    steps: int
    error: float
    trial: Trial

    @cached_property
    def cost(self) -> float:
        """Work of the run of one member, in rotations."""
        return self.steps * self.candidate.cost(self.trial) * self.candidate.share

    @cached_property
    def end(self) -> float:
        """The truncation error expected at the end with the steps of the trial."""
        return self.trial.error * self.candidate.growth(self.pilot, self.trial)

    @cached_property
    def roundoff(self) -> float:
        """Upper bound of the rounding error at the end; for variable steps at least the excess in the trial."""
        excess = self.end - self.error if self.candidate.method.own_steps else 0.0
        return max(
            excess, _expected_rounding(self.pilot, self.candidate, self.steps, self.pilot.windows, ROUNDING_MARGIN)
        )

    def target(self, required: float) -> float:
        """Return the truncation error at which its confirmation aims, beside the rounding."""
        return target_error(self.pilot, required - min(self.roundoff, ROUNDING_SHARE * required))

    def reduced(self, error: float) -> StepFit:
        """Return the fit with the steps that the order predicts for an error, if that is smaller."""
        if not error < self.error < math.inf:
            return self
        change: float = (self.error / error) ** (1.0 / self.candidate.method.order)
        return replace(self, steps=math.ceil(self.steps * change), error=error)


def target_error(pilot: Pilot, required: float) -> float:
    """Return the truncation error at the end at which fits aim, for an accuracy."""
    return max(AIMED_SHARE * pilot.share * required, MIN_GOAL)


def _expected_rounding(pilot: Pilot, candidate: Candidate, steps: int, windows: float, margin: float = 1.0) -> float:
    return roundoff(pilot, steps, candidate.flows, candidate.summed_exactly, windows, margin)


def fit(
    pilot: Pilot, candidate: Candidate, goal: float, limit: float, predicted_steps: float | None = None
) -> StepFit | None:
    """Fit the steps for a truncation error `goal` at the end by trials at two steps; a fit above the cost `limit` is a
    guess by one trial, and None if no trial succeeds.
    """
    order = candidate.method.order
    cost_limit = (1.0 + ABANDON_COST_EXCESS / order) * limit
    # Default: the steps of the coarser reference, scaled by the order and the error.
    usual_steps = pilot.reference_steps / 2 * REFERENCE.order / order
    default = usual_steps * (CONVERGED_CHANGE * pilot.windows / goal) ** (1.0 / order)
    first = default if predicted_steps is None else predicted_steps / pilot.windows
    most = MAX_TRIAL_RATIO * limit / pilot.windows / _least_cost(candidate, UNIT_TRIAL._replace(evaluations=order / 2))
    steps = pilot.comparable_steps(
        min(max(first, usual_steps / MAX_INITIAL_COARSENING), MAX_INITIAL_REFINEMENT * usual_steps, most)
    )
    # If more steps fail than the order predicts, the steps are at the limit of stability.
    safety_factor = min(UNSTABLE_STEP_FACTOR, (LARGE_ERROR / goal) ** (1.0 / order))
    tried: set[int] = set()
    too_few, best = 0, None
    while steps not in tried and len(tried) < MAX_TRIALS:
        tried.add(steps)
        trial = pilot.trial(candidate.method, steps)
        if trial is None or not trial.error < LARGE_ERROR:
            too_few = max(too_few, steps)
            if steps > 2**20 if trial is None else steps * pilot.windows * _least_cost(candidate, trial) > cost_limit:
                break
            if trial is not None and steps * candidate.cost(trial) > MAX_TRIAL_COST:
                break
            # Bisect between failing and successful numbers of steps, if there are both.
            steps = pilot.comparable_steps(2 * steps if best is None else math.sqrt(steps * best.trial.steps))
            continue
        noise = MEASURABLE_RATIO * max(pilot.noise, _expected_rounding(pilot, candidate, steps, 1.0))
        best = _extrapolate(pilot, candidate, goal, trial, noise)
        # Shorter steps take fewer iterations.
        near = best.steps <= 2.0 * steps * pilot.windows
        least = best.cost if near else best.steps * _least_cost(candidate, trial)
        if least > cost_limit and trial.error > noise and best.end < MEANINGLESS_ERROR:
            break
        aim = max(goal / candidate.growth(pilot, trial), noise)
        change: float = (max(trial.error, noise * 0.5**order) / aim) ** (1.0 / order)
        max_steps = MAX_TRIAL_COST / candidate.cost(trial)
        next_steps = pilot.comparable_steps(
            max(safety_factor * too_few, min(steps * min(max(change, 0.2), 5.0), max_steps))
        )
        if 1 / MAX_EXTRAPOLATION <= next_steps / steps <= MAX_EXTRAPOLATION:
            break
        steps = next_steps
    if best is None or best.steps >= safety_factor * too_few * pilot.windows:
        return best
    steps = math.ceil(safety_factor * too_few * pilot.windows)
    return replace(best, steps=steps, error=best.error * (best.steps / steps) ** order)


def _least_cost(candidate: Candidate, trial: Trial) -> float:
    """Return a lower bound on the cost of a step: with one iteration."""
    single = trial._replace(iterations=1.0, evaluations=trial.evaluations / max(trial.iterations, 1.0), newton=False)
    return candidate.cost(single) * candidate.share


def _extrapolate(pilot: Pilot, candidate: Candidate, goal: float, trial: Trial, noise: float) -> StepFit:
    """Extrapolate by the order from a trial to the goal; trial errors count as at least noise / 256."""
    end = max(trial.error, noise / 256) * candidate.growth(pilot, trial)
    per_window = trial.steps * (end / goal) ** (1.0 / candidate.method.order) if end < math.inf else math.inf
    # Above 2^52 steps, consecutive times are not distinguishable in float64.
    count = min(max(1.0, pilot.windows * per_window), 2.0**52)
    steps = math.ceil(count * (1.0 - 1e-12))
    error = end * (trial.steps * pilot.windows / steps) ** candidate.method.order if end < math.inf else math.inf
    return StepFit(pilot, candidate, steps, error, trial)


def confirmed_fit(fitted: StepFit, required: float) -> StepFit:
    """Run a fit over the window, and correct its steps until its error at the end is a large part of `required`, but
    leaves the rounding; the error is larger than `required` if that fails.
    """
    pilot, method = fitted.pilot, fitted.candidate.method
    if method.own_steps:
        best = fit_of_tolerance(pilot, fitted.candidate, required)
        return best or replace(fitted, error=math.inf)
    # The reference has this rounding at most.
    limit = required * (1.0 - ROUNDING_SHARE / ROUNDING_MARGIN)
    too_few, failed, accepted, end = 0, False, None, math.inf
    fitted = fitted.reduced(fitted.target(required))
    for _ in range(MAX_CORRECTIONS):
        exact_steps = fitted.steps / pilot.windows
        # At most the steps of the run: a finer trial could succeed where the run fails.
        per_window = fitted.steps if pilot.covers_span else pilot.comparable_steps(exact_steps, finer=False)
        if per_window * fitted.candidate.cost(fitted.trial) > MAX_CONFIRMATION_COST:
            return accepted or fitted
        trial, change, goal = pilot.trial(method, per_window), STEP_INCREASE, fitted.target(required)
        if trial is not None:
            rounding = max(pilot.noise, _expected_rounding(pilot, fitted.candidate, per_window, 1.0))
            # An error that may be rounding is measured too, since large steps amplify rounding beyond its estimate.
            if may_be_rounding := trial.error <= ROUNDING_MULTIPLE * rounding:
                end = trial.error * pilot.sensitivity.factor(pilot.windows)
                if end <= limit:
                    return replace(fitted, error=min(fitted.error, goal))
            else:
                end = trial.error * (per_window / exact_steps) ** method.order * fitted.candidate.growth(pilot, trial)
            fitted = replace(fitted, error=end, trial=trial)
            change = (end / goal) ** (1.0 / method.order)
        if trial is not None and end <= ACCEPTED_RATIO * goal:
            if accepted is not None and accepted.cost <= fitted.cost:
                return accepted  # fewer steps of more iterations
            accepted = fitted
        else:
            too_few = fitted.steps
            change = min(max(change, STEP_INCREASE if trial is None or may_be_rounding else 1.0 + MIN_CHANGE), 4.0)
        steps = math.ceil(change * fitted.steps)
        failed |= trial is None
        if accepted is not None:
            # Between a number of steps that is too small and one that serves, away from the limit of stability.
            if failed:
                return accepted
            steps = max(steps, math.ceil(math.sqrt(too_few * accepted.steps)))
            if steps >= (1.0 - MIN_CHANGE) * accepted.steps:
                return accepted
        fitted = replace(fitted, steps=steps)
    return accepted or replace(fitted, error=max(end * required / limit, math.nextafter(required, math.inf)))


def fit_of_own_steps(pilot: Pilot, candidate: Candidate, required: float) -> StepFit | None:
    """Estimate the cost of variable steps for an accuracy by one trial; None if none succeeds."""
    goal = target_error(pilot, required)
    tolerance = _first_tolerance(pilot, goal)
    for _ in range(MAX_TOLERANCE_TRIALS):
        found = _tolerance_trial(pilot, candidate, tolerance)
        if found is not None and found.trial.error < LARGE_ERROR:
            change = (max(found.error, MIN_GOAL) / goal) ** (1.0 / found.candidate.method.order)
            return replace(found, steps=max(1, math.ceil(found.steps * change))) if change < math.inf else None
        tolerance *= 0.1
    return None


def fit_of_tolerance(pilot: Pilot, candidate: Candidate, required: float) -> StepFit | None:
    """Fit the tolerance of variable steps to an accuracy at the end; None if none serves."""
    # The error is roughly proportional to the tolerance, but not if the order of the scheme changes with it.
    tolerance, best = _first_tolerance(pilot, target_error(pilot, required)), None
    finest, coarsest = 0.0, math.inf  # the largest tolerance that serves, and the smallest that does not
    for _ in range(MAX_TOLERANCE_TRIALS):
        fitted, ratio = _tolerance_trial(pilot, candidate, tolerance), 0.1
        if fitted is not None and fitted.trial.error < LARGE_ERROR and fitted.error < math.inf:
            goal = fitted.target(required)
            served = fitted.error <= ACCEPTED_RATIO * goal
            if served and (best is None or fitted.cost < best.cost):
                best = fitted
            if served and fitted.error >= goal / GOAL_RATIO:
                break
            ratio = goal / max(fitted.error, MIN_GOAL)
            finest, coarsest = (tolerance, coarsest) if served else (finest, tolerance)
        adjusted = tolerance * min(max(ratio, 1.0 / MAX_TOLERANCE_RATIO), MAX_TOLERANCE_RATIO)
        if not finest < adjusted < coarsest:
            adjusted = math.sqrt(finest * coarsest)
        if candidate.reaching(adjusted).method == candidate.reaching(tolerance).method:
            break
        tolerance = adjusted
    return best


def _first_tolerance(pilot: Pilot, goal: float) -> float:
    """Guess a tolerance: errors of steps grow between not at all and like changes of the initial state."""
    return INITIAL_TOLERANCE_RATIO * goal / math.sqrt(max(1.0, pilot.sensitivity.whole))


def _tolerance_trial(pilot: Pilot, candidate: Candidate, tolerance: float) -> StepFit | None:
    """Return the fit by a trial with one tolerance, or None; a rounding-like error is at most the sum of tolerances."""
    adjusted = candidate.reaching(tolerance)
    trial = pilot.trial(adjusted.method)
    if trial is None:
        return None
    noise = MEASURABLE_RATIO * max(pilot.noise, roundoff(pilot, trial.steps, 0, True, 1.0))
    error = trial.error if trial.error > noise else min(trial.error, trial.steps * tolerance)
    end = error * adjusted.growth(pilot, trial)
    return StepFit(pilot, adjusted, max(1, math.ceil(trial.steps * pilot.windows)), end, trial)


def least_roundoff(pilot: Pilot) -> float:
    """Return the rounding error at the end of the span expected for every scheme."""
    return ROUNDING_MARGIN * pilot.noise * pilot.sensitivity.factor(pilot.windows)


def roundoff(pilot: Pilot, steps: int, flows: int, compensated: bool, windows: float, margin: float = 1.0) -> float:
    """Return the rounding error expected at the end, relative to the largest momentum; inf if it overflows."""
    # Brouwer's law: sqrt(N) unbiased updates, whose errors grow like the sensitivity, and rounded units of time.
    number = max(1.0, steps * max(1, flows))
    path = pilot.speed * pilot.window * windows
    growing = pilot.sensitivity.factor(windows)
    growth = max(1.0, pilot.sensitivity.whole * growing)
    if flows == 0:
        model = 1.0 + path + growth * GAUSS_WALK * math.sqrt(number)
        return max(UNIT_ROUNDOFF * model, margin * pilot.noise * growing)
    rounding, bias = (min(1.0, FLOW_PATH_RATIO * path / number), 0.0) if compensated else (1.0, FLOW_BIAS * number)
    model = (
        1.0 + COEFFICIENT_ERROR * path * math.sqrt(flows) + growth * (FLOW_WALK * rounding * math.sqrt(number) + bias)
    )
    return max(UNIT_ROUNDOFF * model, margin * pilot.noise * growing)
