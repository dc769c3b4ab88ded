"""Fit of the tolerance of schemes with variable steps, by trials over the window of a pilot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import LARGE_ERROR, MEASURABLE_RATIO, Fit
from coadjoint.choosing.pilot import Pilot, Trial
from coadjoint.choosing.roundoff import roundoff

MOST_TRIALS = 6
# Accepted ratio of the target error to the error.
GOAL_RATIO = 4.0
# Largest factor between the tolerances of consecutive trials.
MAX_TOLERANCE_RATIO = 1e6
# Ratio of the costs of two schemes above which a fit is abandoned.
ABANDON_COST_RATIO = 1.2
# Initial ratio of the tolerance to the target error, since errors of steps add up.
USUAL_SHARE = 0.1


def first_tolerance_trial(pilot: Pilot, candidate: Candidate, goal: float) -> Fit | None:
    """Return the fit by one trial of a scheme with variable steps; None if it fails."""
    return _tolerance_trial(pilot, candidate, _first_tolerance(pilot, goal))


def extrapolated_fit(found: Fit, goal: float) -> Fit:
    """Extrapolate a fit to another error at the end, by the order."""
    if not 0.0 < found.error < math.inf:
        return found
    change = (found.error / goal) ** (1.0 / found.candidate.method.order)
    return replace(found, steps=max(1, math.ceil(found.steps * change)))


def fit_of_tolerance(
    pilot: Pilot, candidate: Candidate, goal: float, limit: float, first: Fit | None = None
) -> Fit | None:
    """Fit the tolerance of a scheme with variable steps to an error `goal` at the end of the span.

    The error is roughly proportional to the tolerance, so few trials suffice. A scheme is abandoned if it is more
    expensive than `limit`, the lowest cost so far. `first` is the first trial. Returns a fit whose candidate has the
    tolerance, and whose steps are the variable ones; None if no tolerance is found.
    """
    tolerance, best = _first_tolerance(pilot, goal), None
    for count in range(MOST_TRIALS):
        found = first if first is not None and count == 0 else _tolerance_trial(pilot, candidate, tolerance)
        if found is None:
            after = tolerance / MAX_TOLERANCE_RATIO
        elif not found.trial.error < LARGE_ERROR:
            after = tolerance * USUAL_SHARE
        else:
            end = found.error
            if not end < math.inf:
                break
            if end <= goal and (best is None or found.cost < best.cost):
                best = found
            if goal / GOAL_RATIO <= end <= goal or extrapolated_fit(found, goal).cost > ABANDON_COST_RATIO * limit:
                break
            # Aim at the geometric mean of the accepted range.
            ratio = goal / (math.sqrt(GOAL_RATIO) * end) if end > 0.0 else MAX_TOLERANCE_RATIO
            after = tolerance * min(max(ratio, 1.0 / MAX_TOLERANCE_RATIO), MAX_TOLERANCE_RATIO)
        if candidate.reaching(after).method == candidate.reaching(tolerance).method:
            break
        tolerance = after
    return best


def _first_tolerance(pilot: Pilot, goal: float) -> float:
    """Guess a tolerance, between errors of steps that grow like changes of the start and errors that do not grow."""
    return goal * USUAL_SHARE / math.sqrt(max(1.0, pilot.sensitivity.whole))


def _tolerance_trial(pilot: Pilot, candidate: Candidate, tolerance: float) -> Fit | None:
    """Return the fit by a trial with one tolerance; None if it fails.

    An error that may be rounding is bounded by what the tolerance allows.
    """
    tried = candidate.reaching(tolerance)
    trial = own_steps_of(pilot, tried)
    if trial is None:
        return None
    noise = MEASURABLE_RATIO * max(pilot.noise, roundoff(pilot, trial.steps, 0, True, 1.0))
    error = trial.error if trial.error > noise else min(trial.error, trial.steps * tolerance)
    end = error * tried.growth(pilot, trial)
    return Fit(pilot, tried, max(1, math.ceil(trial.steps * pilot.windows)), end, trial)


def own_steps_of(pilot: Pilot, candidate: Candidate) -> Trial | None:
    """Run a scheme over the window, counting its variable steps in place of those of the run; None if it fails."""
    run = pilot.run(candidate.method, pilot.points)
    if np.any(run.state["status"]):
        return None
    order, members = candidate.method.order, len(pilot.momenta)
    own = max(1, math.ceil(int(run.state["evaluations"].sum()) / (order * members)))
    corrections = int(run.state["iterations"].sum()) / (own * members)
    return Trial(own, pilot.growth_of(run.saved["x"]), corrections, float(order))
