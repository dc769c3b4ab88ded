"""Which tolerance does a scheme need that takes steps of its own? Trials over the window of a pilot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.fitting import CLEARLY, LARGE, Fit
from coadjoint.choosing.pilot import Pilot, Trial
from coadjoint.choosing.roundoff import roundoff

MOST_TRIALS = 6
# Errors that are so many times smaller than what is aimed at are near enough.
NEAR = 4.0
# From one trial to the next a tolerance changes no more than by this factor.
FAR = 1e6
# What costs so many times as much as another is given up.
DEARER = 1.2
# Errors of steps add up: the first guess.
USUAL_SHARE = 0.1


def first_look(pilot: Pilot, candidate: Candidate, goal: float) -> Fit | None:
    """Return what one trial of a scheme that takes steps of its own shows; None where it fails."""
    return _look(pilot, candidate, _first_tolerance(pilot, goal))


def expected(found: Fit, goal: float) -> Fit:
    """Return about what another error at the end takes, by the order."""
    if not 0.0 < found.error < math.inf:
        return found
    change = (found.error / goal) ** (1.0 / found.candidate.method.order)
    return replace(found, steps=max(1, math.ceil(found.steps * change)))


def fit_of_tolerance(
    pilot: Pilot, candidate: Candidate, goal: float, limit: float, first: Fit | None = None
) -> Fit | None:
    """Return the tolerance with which a scheme is expected to reach an error at the end of the span.

    The error is about in proportion to the tolerance, so that few trials find it.

    Parameters
    ----------
    pilot : Pilot
        The window.
    candidate : Candidate
        A scheme that takes steps of its own.
    goal : float
        The truncation error wanted at the end.
    limit : float
        The cost of the best so far; a scheme that will be dearer is given up.
    first : Fit, optional
        What a first look has shown.

    Returns
    -------
    Fit or None
        Its candidate has the tolerance, its steps are as many as those that it takes by itself. None where no tolerance
        was found.
    """
    tolerance, best = _first_tolerance(pilot, goal), None
    for count in range(MOST_TRIALS):
        found = first if first is not None and count == 0 else _look(pilot, candidate, tolerance)
        if found is None:
            after = tolerance / FAR
        elif not found.trial.error < LARGE:
            after = tolerance * USUAL_SHARE
        else:
            end = found.error
            if not end < math.inf:
                break
            if end <= goal and (best is None or found.cost < best.cost):
                best = found
            if goal / NEAR <= end <= goal or expected(found, goal).cost > DEARER * limit:
                break
            # Between both ends of what is near enough.
            ratio = goal / (math.sqrt(NEAR) * end) if end > 0.0 else FAR
            after = tolerance * min(max(ratio, 1.0 / FAR), FAR)
        if candidate.reaching(after).method == candidate.reaching(tolerance).method:
            break
        tolerance = after
    return best


def _first_tolerance(pilot: Pilot, goal: float) -> float:
    """Return a guess: some errors of steps grow as changes of the start do, and others stay."""
    return goal * USUAL_SHARE / math.sqrt(max(1.0, pilot.sensitivity.whole))


def _look(pilot: Pilot, candidate: Candidate, tolerance: float) -> Fit | None:
    """Return what a trial with one tolerance shows; None where it fails.

    An error that may be rounding is taken for no more than what the tolerance allows.
    """
    tried = candidate.reaching(tolerance)
    trial = own_steps_of(pilot, tried)
    if trial is None:
        return None
    noise = CLEARLY * max(pilot.noise, roundoff(pilot, trial.steps, 0, True, 1.0))
    error = trial.error if trial.error > noise else min(trial.error, trial.steps * tolerance)
    end = error * tried.growth(pilot, trial)
    return Fit(pilot, tried, max(1, math.ceil(trial.steps * pilot.windows)), end, trial)


def own_steps_of(pilot: Pilot, candidate: Candidate) -> Trial | None:
    """Return what a scheme does over the window, by its own steps in place of those of the run; None where it fails."""
    run = pilot.run(candidate.method, pilot.points)
    if np.any(run.state["status"]):
        return None
    order, members = candidate.method.order, len(pilot.momenta)
    own = max(1, math.ceil(int(run.state["evaluations"].sum()) / (order * members)))
    corrections = int(run.state["iterations"].sum()) / (own * members)
    return Trial(own, pilot.growth_of(run.saved["x"]), corrections, float(order))
