"""Trials of one scheme over the window of a pilot, until its error can be extrapolated to the wanted one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

from coadjoint.choosing.candidates import Candidate
from coadjoint.choosing.pilot import REFERENCE, Pilot, Trial
from coadjoint.choosing.roundoff import MARGIN, roundoff

MOST_TRIALS = 10
# A trial costs no more than so many rotations (30 ms), whatever the accuracy: smaller steps follow by the order.
DEAREST_TRIAL = 3e6
# The last look at a choice may take longer, and repeat itself.
DEAREST_CONFIRMATION = 16 * DEAREST_TRIAL
MOST_CORRECTIONS = 6
# Truncation is told from rounding, and from the error of the reference, when it is so many times larger.
CLEARLY = 16.0
# Rounding is hardly ever so many times what is expected of it.
MOSTLY = 4.0
# Beyond this relative error the order says nothing.
LARGE = 0.05
# So many times the steps with which an unstable scheme fails, it mostly succeeds.
UNSTABLE = 1.5
# Errors at the end that are no smaller than the motion are not followed to smaller steps.
WHOLE = 1.0
# Steps within this factor of what is wanted are near enough to extrapolate.
NEAR = 1.3
# A choice that costs (1 + this / order) times as much as another is given up: the higher the order, the better is known
# from a trial how many steps are needed.
MUCH_DEARER = 6.0
# A first trial takes no more than so many times the usual steps, and no fewer than one of so many.
MUCH_FINER, MUCH_COARSER = 4.0, 10.0


@dataclass(frozen=True)
class Fit:
    """A scheme with the number of its steps in the span, and the truncation error expected at the end."""

    pilot: Pilot
    candidate: Candidate
    steps: int
    error: float
    trial: Trial
    given_up: bool = False
    """Whether a trial showed that it will be much dearer than another; its steps are a guess then."""

    @cached_property
    def extrapolated(self) -> float:
        """How many times finer or coarser the steps are than those of the trial; at least 1."""
        ratio = self.steps / (self.trial.steps * self.pilot.windows)
        return max(ratio, 1.0 / ratio)

    @cached_property
    def cost(self) -> float:
        """Work of the run of one member, in rotations."""
        return self.steps * self.candidate.cost(self.trial) * self.candidate.share

    @cached_property
    def end(self) -> float:
        """The truncation error expected at the end with the steps of the trial; from `WHOLE` on it tells nothing."""
        return self.trial.error * self.candidate.growth(self.pilot, self.trial)

    @cached_property
    def roundoff(self) -> float:
        """Rounding error at the end of the span, at most; steps of a scheme's own are tried as they are run."""
        seen = self.end - self.error if self.candidate.method.own_steps else 0.0
        return max(seen, _rounding(self.pilot, self.candidate, self.steps, self.pilot.windows, MARGIN))


def _rounding(pilot: Pilot, candidate: Candidate, steps: int, windows: float, margin: float = 1.0) -> float:
    return roundoff(pilot, steps, candidate.flows, candidate.summed_exactly, windows, margin)


def fit(pilot: Pilot, candidate: Candidate, goal: float, limit: float, guess: float | None = None) -> Fit | None:
    """Return the number of steps with which a scheme is expected to reach an error at the end of the span.

    Parameters
    ----------
    pilot : Pilot
        The window.
    candidate : Candidate
        The scheme.
    goal : float
        The truncation error wanted at the end.
    limit : float
        The cost of the best so far, or what it is likely to be; a scheme that will be much dearer is given up.
    guess : float, optional
        How many steps over the span it may need.

    Returns
    -------
    Fit or None
        None where no number of steps was found.
    """
    order = candidate.method.order
    dear = (1.0 + MUCH_DEARER / order) * limit
    # Without a better guess, the steps of the reference in proportion to the order. Far below them nothing can be seen.
    usual = pilot.window / pilot.natural_step * REFERENCE.order / order
    first = usual if guess is None else guess / pilot.windows
    steps = pilot.fitting(min(max(first, usual / MUCH_COARSER), MUCH_FINER * usual))
    # Where fewer steps fail than the order lets expect, steps are at the border of what is stable.
    away = min(UNSTABLE, (LARGE / goal) ** (1.0 / order))
    seen: set[int] = set()
    too_few, best = 0, None
    for _ in range(MOST_TRIALS):
        if steps in seen:
            break
        seen.add(steps)
        trial = pilot.trial(candidate.method, steps)
        if trial is None or not trial.error < LARGE:
            too_few = max(too_few, steps)
            if trial is not None and _least_cost(pilot, candidate, trial) > dear:
                # More of them are dearer still.
                return None if best is None else replace(best, given_up=True)
            if steps > (2**20 if trial is None else DEAREST_TRIAL / candidate.cost(trial)):
                break
            # Between a number of steps that failed and one that did not, where there are both.
            steps = pilot.fitting(2 * steps if best is None else math.sqrt(steps * best.trial.steps))
            continue
        noise = CLEARLY * max(pilot.noise, _rounding(pilot, candidate, steps, 1.0))
        best = _extrapolated(pilot, candidate, goal, trial, noise)
        known = best.end < WHOLE or _least_cost(pilot, candidate, trial) > dear
        if best.cost > dear and trial.error > noise and known:
            return replace(best, given_up=True)
        aim = max(goal / candidate.growth(pilot, trial), noise)
        change: float = (max(trial.error, noise / 256) / aim) ** (1.0 / order)
        most = DEAREST_TRIAL / candidate.cost(trial)
        wanted = pilot.fitting(max(away * too_few, min(steps * min(max(change, 0.2), 5.0), most)))
        if 1 / NEAR <= wanted / steps <= NEAR and trial.error <= 4 * aim:
            break
        steps = wanted
    if best is None or best.steps >= away * too_few * pilot.windows:
        return best
    steps = math.ceil(away * too_few * pilot.windows)
    return replace(best, steps=steps, error=best.error * (best.steps / steps) ** order)


def _least_cost(pilot: Pilot, candidate: Candidate, trial: Trial) -> float:
    """Return what the run costs at the least with the steps of a trial: shorter ones iterate less, at least once."""
    once = trial._replace(iterations=1.0, evaluations=trial.evaluations / max(trial.iterations, 1.0), newton=False)
    return trial.steps * pilot.windows * candidate.cost(once) * candidate.share


def _extrapolated(pilot: Pilot, candidate: Candidate, goal: float, trial: Trial, noise: float) -> Fit:
    """Follow the order from a trial to the goal; downward only as far as the trial can be told from rounding."""
    end = max(trial.error, noise / 256) * candidate.growth(pilot, trial)
    per_window = trial.steps * (end / goal) ** (1.0 / candidate.method.order) if end < math.inf else math.inf
    # The span cannot be told from its step where there are more steps than float64 counts.
    count = min(max(1.0, pilot.windows * per_window), 2.0**52)
    steps = math.ceil(count * (1.0 - 1e-12))
    error = end * (trial.steps * pilot.windows / steps) ** candidate.method.order if end < math.inf else math.inf
    return Fit(pilot, candidate, steps, error, trial)


def confirmed(found: Fit, goal: float, bound: float) -> Fit:
    """Run a choice over the window once more, and correct its step where it misses.

    Parameters
    ----------
    found : Fit
        The choice.
    goal : float
        The truncation error that it aims at.
    bound : float
        What it must not exceed.

    Returns
    -------
    Fit
        With the error that was measured, where it is more than rounding and a run over the window is not too dear; as
        it was where steps are the scheme's own.
    """
    pilot, order = found.pilot, found.candidate.method.order
    if found.candidate.method.own_steps:
        return found  # its last trial was that of the choice
    for _ in range(MOST_CORRECTIONS):
        wanted = found.steps / pilot.windows
        # No finer than what is run, which could fail where this does not.
        per_window = found.steps if pilot.whole else pilot.fitting(wanted, finer=False)
        if per_window * found.candidate.cost(found.trial) > DEAREST_CONFIRMATION:
            return found
        trial = pilot.trial(found.candidate.method, per_window)
        if trial is None:
            found = replace(found, steps=math.ceil(1.2 * found.steps))
            continue
        if trial.error <= MOSTLY * max(pilot.noise, _rounding(pilot, found.candidate, per_window, 1.0)):
            return found
        end = trial.error * (per_window / wanted) ** order * found.candidate.growth(pilot, trial)
        found = replace(found, error=end, trial=trial)
        if end <= bound:
            return found
        more: float = (end / goal) ** (1.0 / order)
        found = replace(found, steps=math.ceil(found.steps * min(max(more, 1.02), 4.0)), error=goal)
    return found
