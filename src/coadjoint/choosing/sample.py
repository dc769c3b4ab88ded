"""Members of an ensemble or a batch for a pilot: those with the largest errors."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coadjoint.choosing.pilot import LARGE_ERROR, Pilot, PilotErrors, short_run, speeds_of
from coadjoint.methods.protocol.method import Method
from coadjoint.methods.registry import reference_scheme
from coadjoint.systems.batch import Batch, selected
from coadjoint.systems.system import System

# Number of members in a pilot, and of the members from which they are selected.
SAMPLE_SIZE = 4
MAX_SCREENED = 256
SCREENING_SCHEME = reference_scheme(4)
# Steps in the time in which the fastest member moves by its own size, and their total number.
STEPS_PER_SIZE = 8
SCREENING_STEPS = 128
# Ratio of the largest error of the chosen scheme among all members to that in the pilot above which the latter is not
# representative: schemes differ in their worst members. Below it, the safety factor of the target serves.
UNSEEN_RATIO = 2.0

Sample = tuple[System | Batch, NDArray[np.float64]]


def sample_of(system: System | Batch, momenta: NDArray[np.float64], t0: float, span: float) -> Sample:
    """Return up to 4 members for a pilot, in order: the first, and those with the largest errors in a coarse run."""
    if len(momenta) <= SAMPLE_SIZE:
        return system, momenta
    screened, states = _screened(system, momenta)
    rates = speeds_of(screened, states, t0) / _sizes(states)
    finite = np.isfinite(rates)
    fastest = float(np.max(rates[finite], initial=0.0))
    time = abs(span) if fastest == 0.0 else min(abs(span), SCREENING_STEPS / STEPS_PER_SIZE / fastest)
    errors = _errors_of_members(screened, states, t0, np.copysign(time, span), SCREENING_SCHEME, SCREENING_STEPS)
    # Members with a nonfinite field are selected first, so that the pilot reports them.
    return _worst(screened, states, np.where(finite, np.max(errors, axis=0), np.inf))


def sample_of_scheme(
    system: System | Batch, momenta: NDArray[np.float64], pilot: Pilot, method: Method, step: float
) -> Sample | None:
    """Return the members with the largest errors of a scheme at the end; None if those of the pilot stand for them."""
    # The whole window, since errors of some members grow late. Few steps rank members alike, unless errors saturate.
    all_steps = max(1, round(pilot.window / step))
    steps = min(SCREENING_STEPS, all_steps)

    def at_end(system: System | Batch, states: NDArray[np.float64]) -> NDArray[np.float64]:
        time = math.copysign(pilot.window, pilot.span)
        growth = map(PilotErrors.of_run, _errors_of_members(system, states, pilot.t0, time, method, steps).T)
        return np.array([each.whole * each.factor(pilot.windows) for each in growth])

    screened, states = _screened(system, momenta)
    while np.max(errors := at_end(screened, states)) > LARGE_ERROR and steps < all_steps:
        steps = min(4 * steps, all_steps)
    known = at_end(pilot.system, pilot.momenta)
    return _worst(screened, states, errors) if np.max(errors) > UNSEEN_RATIO * np.max(known) else None


def _screened(system: System | Batch, momenta: NDArray[np.float64]) -> Sample:
    """Return a sample of at most `MAX_SCREENED` members, evenly over their numbers."""
    members = len(momenta)
    return _members(
        system, momenta, np.unique(np.linspace(0, members - 1, min(members, MAX_SCREENED)).round().astype(np.int64))
    )


def _sizes(states: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the norms of states (members, n), as divisors."""
    sizes = np.linalg.norm(states, axis=1)
    return np.where(sizes > 0.0, sizes, 1.0)


def _errors_of_members(
    system: System | Batch, states: NDArray[np.float64], t0: float, time: float, method: Method, steps: int
) -> NDArray[np.float64]:
    """Return the differences (points, members) from a run with half the step, relative to x0; inf if one fails."""
    every = max(1, steps // SCREENING_STEPS)  # bounds the memory of runs of many steps
    full, halved = (short_run(system, method, states, t0, time, k * steps, k * every) for k in (1, 2))
    failed = (full.state["status"] != 0) | (halved.state["status"] != 0)
    differences = np.linalg.norm(full.saved["x"][1:] - halved.saved["x"][1:], axis=2)
    return np.where(failed, np.inf, differences / _sizes(states))


def _worst(system: System | Batch, states: NDArray[np.float64], errors: NDArray[np.float64]) -> Sample:
    worst = np.argsort(-errors, kind="stable")[: SAMPLE_SIZE - 1]
    return _members(system, states, np.unique(np.concatenate([[0], worst])))


def _members(system: System | Batch, momenta: NDArray[np.float64], members: NDArray[np.int64]) -> Sample:
    return (selected(system, members) if system.is_batch else system), momenta[members]
