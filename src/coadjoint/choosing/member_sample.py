"""Deterministic selection of a few representative members of an ensemble."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coadjoint.choosing.pilot import short_run
from coadjoint.methods.suggested_scheme import reference_scheme
from coadjoint.systems.system import System

# Number of members in a pilot, and of the members from which they are selected.
SAMPLE_SIZE = 4
MAX_SCREENED = 256
SCREENING_SCHEME = reference_scheme(4)
# Steps in the time in which the fastest member moves by its own size, and their total number.
STEPS_PER_SIZE = 8
SCREENING_STEPS = 128


def sample_of(system: System, momenta: NDArray[np.float64], t0: float, span: float) -> NDArray[np.float64]:
    """Return the members for a pilot: the first, and those with the largest errors in a coarse short run.

    `momenta` has shape (members, n). Returns up to 4 of them, shape (k, n), in the order of the ensemble.
    """
    members = len(momenta)
    if members <= SAMPLE_SIZE:
        return momenta
    screened = np.unique(np.linspace(0, members - 1, min(members, MAX_SCREENED)).round().astype(np.int64))
    states = momenta[screened]
    sizes = np.linalg.norm(states, axis=1)
    rates = np.array([np.linalg.norm(system.vector_field(x, t0)) for x in states]) / np.where(sizes > 0.0, sizes, 1.0)
    # Members with a nonfinite field are selected first, so that the pilot reports them.
    rates = np.where(np.isfinite(rates), rates, np.inf)
    fastest = float(np.max(rates[np.isfinite(rates)], initial=0.0))
    time = abs(span) if fastest == 0.0 else min(abs(span), SCREENING_STEPS / STEPS_PER_SIZE / fastest)
    ends = [
        short_run(system, SCREENING_SCHEME, states, t0, np.copysign(time, span), n)
        for n in (SCREENING_STEPS, 2 * SCREENING_STEPS)
    ]
    failed = (ends[0].state["status"] != 0) | (ends[1].state["status"] != 0)
    differences = np.max(np.linalg.norm(ends[0].saved["x"][1:] - ends[1].saved["x"][2::2], axis=2), axis=0)
    errors = np.where(failed | ~np.isfinite(rates), np.inf, differences / np.where(sizes > 0.0, sizes, 1.0))
    worst = screened[np.argsort(-errors, kind="stable")[: SAMPLE_SIZE - 1]]
    return momenta[np.unique(np.concatenate([[0], worst]))]
