"""Fits of one scheme, by trials over the window of a pilot: its number of steps, or the tolerance of its own steps."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.pilot import LARGE_ERROR, REFERENCE, Pilot, Trial
from coadjoint.rounding import UNIT_ROUNDOFF

MAX_TRIALS = 10  # runs of one scheme; most take two or three
# Largest cost of a trial, in rotations (30 ms), for any accuracy; smaller steps are extrapolated by the order.
MAX_TRIAL_COST = 3e6
# Largest cost of the confirmation of a choice, which may be repeated.
MAX_CONFIRMATION_COST = 16 * MAX_TRIAL_COST
MAX_CORRECTIONS = 6  # runs of a confirmation, each with STEP_INCREASE times the steps or more
# Factor on the number of steps where the order does not predict the error.
STEP_INCREASE = 1.2
# Smallest ratio of a measurable truncation error to rounding and to the error of the reference.
MEASURABLE_RATIO = 16.0
# Accepted ratio of the error to its target.
ACCEPTED_RATIO = 2.0
# Errors up to this multiple of the expected rounding may be rounding.
ROUNDING_MULTIPLE = 4.0
# Factor on the number of steps at which an unstable scheme fails, with which it mostly succeeds.
UNSTABLE_STEP_FACTOR = 1.5
# Relative errors at the end from which on no extrapolation to smaller steps is possible.
MEANINGLESS_ERROR = 1.0
# Largest ratio of steps across which a trial is extrapolated without another one.
MAX_EXTRAPOLATION = 1.3
# A scheme is abandoned at (1 + this / order) times the cost of another: trials predict the steps of high orders more
# accurately.
ABANDON_COST_EXCESS = 6.0
# Bounds of the steps of a first trial: usual * MUCH_FINER and usual / MUCH_COARSER.
MAX_INITIAL_REFINEMENT, MAX_INITIAL_COARSENING = 4.0, 10.0
# Of the tolerance of a scheme with variable steps, most fits take two runs.
MAX_TOLERANCE_TRIALS = 6
# Accepted ratio of the target error to the error.
GOAL_RATIO = 4.0
# Largest factor between the tolerances of consecutive trials.
MAX_TOLERANCE_RATIO = 1e6
# Ratio of the costs of two schemes above which a fit is abandoned.
ABANDON_COST_RATIO = 1.2
# Initial ratio of the tolerance to the target error, since errors of steps add up.
INITIAL_TOLERANCE_RATIO = 0.1

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
    abandoned: bool = False
    """Whether a trial predicted a much higher cost than another scheme's; `steps` is then a guess."""

    @cached_property
    def extrapolated(self) -> float:
        """Ratio, at least 1, between the steps of the fit and those of the trial."""
        ratio = self.steps / (self.trial.steps * self.pilot.windows)
        return max(ratio, 1.0 / ratio)

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


def _expected_rounding(pilot: Pilot, candidate: Candidate, steps: int, windows: float, margin: float = 1.0) -> float:
    return roundoff(pilot, steps, candidate.flows, candidate.summed_exactly, windows, margin)


def fit(
    pilot: Pilot, candidate: Candidate, goal: float, limit: float, predicted_steps: float | None = None
) -> StepFit | None:
    """Fit the steps for a truncation error `goal` at the end; None if none is found up to about the cost `limit`."""
    order = candidate.method.order
    cost_limit = (1.0 + ABANDON_COST_EXCESS / order) * limit
    # Default: the steps of the reference, scaled by the order. With far fewer steps the error is not measurable.
    usual_steps = pilot.window / pilot.natural_step * REFERENCE.order / order
    first = usual_steps if predicted_steps is None else predicted_steps / pilot.windows
    steps = pilot.comparable_steps(
        min(max(first, usual_steps / MAX_INITIAL_COARSENING), MAX_INITIAL_REFINEMENT * usual_steps)
    )
    # If more steps fail than the order predicts, the steps are at the limit of stability.
    safety_factor = min(UNSTABLE_STEP_FACTOR, (LARGE_ERROR / goal) ** (1.0 / order))
    tried: set[int] = set()
    too_few, best = 0, None
    for _ in range(MAX_TRIALS):
        if steps in tried:
            break
        tried.add(steps)
        trial = pilot.trial(candidate.method, steps)
        if trial is None or not trial.error < LARGE_ERROR:
            too_few = max(too_few, steps)
            if trial is not None and _least_cost(pilot, candidate, trial) > cost_limit:
                # More steps are even more expensive.
                return None if best is None else replace(best, abandoned=True)
            if steps > (2**20 if trial is None else MAX_TRIAL_COST / candidate.cost(trial)):
                break
            # Bisect between failing and successful numbers of steps, if there are both.
            steps = pilot.comparable_steps(2 * steps if best is None else math.sqrt(steps * best.trial.steps))
            continue
        noise = MEASURABLE_RATIO * max(pilot.noise, _expected_rounding(pilot, candidate, steps, 1.0))
        best = _extrapolate(pilot, candidate, goal, trial, noise)
        conclusive = best.end < MEANINGLESS_ERROR or _least_cost(pilot, candidate, trial) > cost_limit
        if best.cost > cost_limit and trial.error > noise and conclusive:
            return replace(best, abandoned=True)
        aim = max(goal / candidate.growth(pilot, trial), noise)
        change: float = (max(trial.error, noise / 256) / aim) ** (1.0 / order)
        max_steps = MAX_TRIAL_COST / candidate.cost(trial)
        next_steps = pilot.comparable_steps(
            max(safety_factor * too_few, min(steps * min(max(change, 0.2), 5.0), max_steps))
        )
        if 1 / MAX_EXTRAPOLATION <= next_steps / steps <= MAX_EXTRAPOLATION and trial.error <= 4 * aim:
            break
        steps = next_steps
    if best is None or best.steps >= safety_factor * too_few * pilot.windows:
        return best
    steps = math.ceil(safety_factor * too_few * pilot.windows)
    return replace(best, steps=steps, error=best.error * (best.steps / steps) ** order)


def _least_cost(pilot: Pilot, candidate: Candidate, trial: Trial) -> float:
    """Return a lower bound on the cost with the steps of a trial, with one iteration per step."""
    single = trial._replace(iterations=1.0, evaluations=trial.evaluations / max(trial.iterations, 1.0), newton=False)
    return trial.steps * pilot.windows * candidate.cost(single) * candidate.share


def _extrapolate(pilot: Pilot, candidate: Candidate, goal: float, trial: Trial, noise: float) -> StepFit:
    """Extrapolate by the order from a trial to the goal; trial errors count as at least noise / 256."""
    end = max(trial.error, noise / 256) * candidate.growth(pilot, trial)
    per_window = trial.steps * (end / goal) ** (1.0 / candidate.method.order) if end < math.inf else math.inf
    # Above 2^52 steps, consecutive times are not distinguishable in float64.
    count = min(max(1.0, pilot.windows * per_window), 2.0**52)
    steps = math.ceil(count * (1.0 - 1e-12))
    error = end * (trial.steps * pilot.windows / steps) ** candidate.method.order if end < math.inf else math.inf
    return StepFit(pilot, candidate, steps, error, trial)


def confirmed_fit(fitted: StepFit, goal: float, required: float) -> StepFit:
    """Run a fit over the window once more, and correct its step until the error at the end serves `required`."""
    # An error that may be rounding is measured too, since large steps amplify rounding beyond its estimate.
    pilot, order = fitted.pilot, fitted.candidate.method.order
    bound = min(ACCEPTED_RATIO * goal, required * (1.0 - ROUNDING_SHARE))
    # The reference has this rounding at most.
    limit = required * (1.0 - ROUNDING_SHARE / ROUNDING_MARGIN)
    if fitted.candidate.method.own_steps:
        return fitted  # its last trial used this tolerance
    end = math.inf
    for _ in range(MAX_CORRECTIONS):
        exact_steps = fitted.steps / pilot.windows
        # At most the steps of the run: a finer trial could succeed where the run fails.
        per_window = fitted.steps if pilot.covers_span else pilot.comparable_steps(exact_steps, finer=False)
        if per_window * fitted.candidate.cost(fitted.trial) > MAX_CONFIRMATION_COST:
            return fitted
        trial = pilot.trial(fitted.candidate.method, per_window)
        if trial is None:
            fitted = replace(fitted, steps=math.ceil(STEP_INCREASE * fitted.steps))
            continue
        rounding = max(pilot.noise, _expected_rounding(pilot, fitted.candidate, per_window, 1.0))
        if may_be_rounding := trial.error <= ROUNDING_MULTIPLE * rounding:
            end = trial.error * pilot.sensitivity.factor(pilot.windows)
            if end <= limit:
                return fitted
        else:
            end = trial.error * (per_window / exact_steps) ** order * fitted.candidate.growth(pilot, trial)
        fitted = replace(fitted, error=end, trial=trial)
        if end <= bound:
            return fitted
        more: float = (end / goal) ** (1.0 / order)
        least = STEP_INCREASE if may_be_rounding else 1.02
        fitted = replace(fitted, steps=math.ceil(fitted.steps * min(max(more, least), 4.0)), error=goal)
    return replace(fitted, error=max(end * required / limit, math.nextafter(required, math.inf)))


def first_tolerance_trial(pilot: Pilot, candidate: Candidate, goal: float) -> StepFit | None:
    """Return the fit by one trial of a scheme with variable steps; None if it fails."""
    return _tolerance_trial(pilot, candidate, _first_tolerance(pilot, goal))


def extrapolated_fit(fitted: StepFit, goal: float) -> StepFit:
    """Extrapolate a fit to another error at the end, by the order."""
    if not 0.0 < fitted.error < math.inf:
        return fitted
    change = (fitted.error / goal) ** (1.0 / fitted.candidate.method.order)
    return replace(fitted, steps=max(1, math.ceil(fitted.steps * change)))


def fit_of_tolerance(
    pilot: Pilot, candidate: Candidate, goal: float, limit: float, first: StepFit | None = None
) -> StepFit | None:
    """Fit the tolerance of variable steps to an error `goal` at the end; None if none is below the cost `limit`."""
    # The error is roughly proportional to the tolerance, so few trials suffice.
    tolerance, best = _first_tolerance(pilot, goal), None
    for count in range(MAX_TOLERANCE_TRIALS):
        fitted = first if first is not None and count == 0 else _tolerance_trial(pilot, candidate, tolerance)
        if fitted is None:
            next_tolerance = tolerance / MAX_TOLERANCE_RATIO
        elif not fitted.trial.error < LARGE_ERROR:
            next_tolerance = tolerance * INITIAL_TOLERANCE_RATIO
        else:
            end = fitted.error
            if not end < math.inf:
                break
            if end <= goal and (best is None or fitted.cost < best.cost):
                best = fitted
            if goal / GOAL_RATIO <= end <= goal or extrapolated_fit(fitted, goal).cost > ABANDON_COST_RATIO * limit:
                break
            # Aim at the geometric mean of the accepted range.
            ratio = goal / (math.sqrt(GOAL_RATIO) * end) if end > 0.0 else MAX_TOLERANCE_RATIO
            next_tolerance = tolerance * min(max(ratio, 1.0 / MAX_TOLERANCE_RATIO), MAX_TOLERANCE_RATIO)
        if candidate.reaching(next_tolerance).method == candidate.reaching(tolerance).method:
            break
        tolerance = next_tolerance
    return best


def _first_tolerance(pilot: Pilot, goal: float) -> float:
    """Guess a tolerance: errors of steps grow between not at all and like changes of the initial state."""
    return goal * INITIAL_TOLERANCE_RATIO / math.sqrt(max(1.0, pilot.sensitivity.whole))


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
