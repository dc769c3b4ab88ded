"""Which tolerance does a scheme need that takes steps of its own? Trials over the window of a pilot."""

from __future__ import annotations

import math

import numpy as np

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import CLEARLY, LARGE, MUCH_DEARER, Fit
from coadjoint.choosing.pilot import Pilot, Trial
from coadjoint.choosing.roundoff import roundoff

MOST_TRIALS = 6
# Errors that are so many times smaller than what is aimed at are near enough.
NEAR = 4.0
# From one trial to the next a tolerance changes no more than by this factor.
FAR = 1e6
# Errors of steps add up: the first guess.
USUAL_SHARE = 0.1


def fit_of_tolerance(pilot: Pilot, candidate: Candidate, goal: float, limit: float) -> Fit | None:
    """Return the tolerance with which a scheme is expected to reach an error at the end of the span.

    The error is about in proportion to the tolerance, so that few trials find it. Where it is no more than rounding,
    what the tolerance allows is taken in its place.

    Parameters
    ----------
    pilot : Pilot
        The window.
    candidate : Candidate
        A scheme that takes steps of its own.
    goal : float
        The truncation error wanted at the end.
    limit : float
        The cost of the best so far; a scheme that will be much dearer is given up.

    Returns
    -------
    Fit or None
        Its candidate has the tolerance, its steps are as many as those that it takes by itself. None where no tolerance
        was found.
    """
    tolerance, best = goal * USUAL_SHARE, None
    for _ in range(MOST_TRIALS):
        tried = candidate.reaching(tolerance)
        trial = own_steps_of(pilot, tried)
        if trial is None or not trial.error < LARGE:
            tolerance /= FAR if trial is None else 1.0 / USUAL_SHARE
            continue
        noise = CLEARLY * max(pilot.noise, roundoff(pilot, trial.steps, 0, True, 1.0))
        error = trial.error if trial.error > noise else min(trial.error, trial.steps * tolerance)
        end = error * tried.growth(pilot, trial)
        if not end < math.inf:
            return None
        steps = max(1, math.ceil(trial.steps * pilot.windows))
        found = Fit(pilot, tried, steps, end, trial)
        if found.cost > (1.0 + MUCH_DEARER / tried.method.order) * limit and end <= goal:
            return None
        if end <= goal and (best is None or found.cost < best.cost):
            best = found
        if goal / NEAR <= end <= goal:
            break
        # Between both ends of what is near enough.
        ratio = goal / (math.sqrt(NEAR) * end) if end > 0.0 else FAR
        tolerance *= min(max(ratio, 1.0 / FAR), FAR)
        again = candidate.reaching(tolerance)
        if again.method == tried.method:
            break
    return best


def own_steps_of(pilot: Pilot, candidate: Candidate) -> Trial | None:
    """Return what a scheme does over the window, by its own steps in place of those of the run; None where it fails."""
    run = pilot.run(candidate.method, pilot.points)
    if np.any(run.state["status"]):
        return None
    order, members = candidate.method.order, len(pilot.momenta)
    own = max(1, math.ceil(int(run.state["evaluations"].sum()) / (order * members)))
    corrections = int(run.state["iterations"].sum()) / (own * members)
    return Trial(own, pilot.growth_of(run.saved["x"]), corrections, float(order))
