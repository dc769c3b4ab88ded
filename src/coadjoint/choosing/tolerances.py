"""Fit of the tolerance of schemes with variable steps, by trials over the window of a pilot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import LARGE_ERROR, MEASURABLE_RATIO, Fit
from coadjoint.choosing.pilot import Pilot, Trial
from coadjoint.choosing.roundoff import roundoff

MAX_TRIALS = 6  # runs of one scheme, each with another tolerance; most take two
# Accepted ratio of the target error to the error.
GOAL_RATIO = 4.0
# Largest factor between the tolerances of consecutive trials.
MAX_TOLERANCE_RATIO = 1e6
# Ratio of the costs of two schemes above which a fit is abandoned.
ABANDON_COST_RATIO = 1.2
# Initial ratio of the tolerance to the target error, since errors of steps add up.
INITIAL_TOLERANCE_RATIO = 0.1


def first_tolerance_trial(pilot: Pilot, candidate: Candidate, goal: float) -> Fit | None:
    """Return the fit by one trial of a scheme with variable steps; None if it fails."""
    return _tolerance_trial(pilot, candidate, _first_tolerance(pilot, goal))


def extrapolated_fit(fitted: Fit, goal: float) -> Fit:
    """Extrapolate a fit to another error at the end, by the order."""
    if not 0.0 < fitted.error < math.inf:
        return fitted
    change = (fitted.error / goal) ** (1.0 / fitted.candidate.method.order)
    return replace(fitted, steps=max(1, math.ceil(fitted.steps * change)))


def fit_of_tolerance(
    pilot: Pilot, candidate: Candidate, goal: float, limit: float, first: Fit | None = None
) -> Fit | None:
    """Fit the tolerance of a scheme with variable steps to an error `goal` at the end of the span.

    The error is roughly proportional to the tolerance, so few trials suffice. A scheme is abandoned if it is more
    expensive than `limit`, the lowest cost so far. `first` is the first trial. Returns a fit whose candidate has the
    tolerance, and whose steps are the variable ones; None if no tolerance is found.
    """
    tolerance, best = _first_tolerance(pilot, goal), None
    for count in range(MAX_TRIALS):
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


def _tolerance_trial(pilot: Pilot, candidate: Candidate, tolerance: float) -> Fit | None:
    """Return the fit by a trial with one tolerance; None if it fails.

    An error that may be rounding is bounded by the sum of the tolerances of the steps.
    """
    adjusted = candidate.reaching(tolerance)
    trial = variable_step_trial(pilot, adjusted)
    if trial is None:
        return None
    noise = MEASURABLE_RATIO * max(pilot.noise, roundoff(pilot, trial.steps, 0, True, 1.0))
    error = trial.error if trial.error > noise else min(trial.error, trial.steps * tolerance)
    end = error * adjusted.growth(pilot, trial)
    return Fit(pilot, adjusted, max(1, math.ceil(trial.steps * pilot.windows)), end, trial)


def variable_step_trial(pilot: Pilot, candidate: Candidate) -> Trial | None:
    """Run a scheme over the window, counting its variable steps in place of those of the run; None if it fails."""
    run = pilot.run(candidate.method, pilot.points)
    if np.any(run.state["status"]):
        return None
    order, members = candidate.method.order, len(pilot.momenta)
    step_count = max(1, math.ceil(int(run.state["evaluations"].sum()) / (order * members)))
    corrections = int(run.state["iterations"].sum()) / (step_count * members)
    return Trial(step_count, pilot.growth_of(run.saved["x"]), corrections, float(order))
