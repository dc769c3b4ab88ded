"""Runs of random cases, and all their numbers."""

from __future__ import annotations

import contextlib
import io
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co

from .cases import Case


class Result(NamedTuple):
    """Results of a run: arrays by name, with members on the second axis unless the name has a star; and its failure.

    Crossings are rows of numbers for each member: time, event, direction, state. `failed` are the status and the step
    of members that failed, and zeros.
    """

    arrays: dict[str, np.ndarray]
    failure: tuple[Any, ...] | None
    crossings: tuple[np.ndarray, ...]
    failed: np.ndarray


def result_of(solution: co.Solution, failure: tuple[Any, ...] | None) -> Result:
    """Return every number of a solution; a single state is an ensemble of one."""
    along = {"x": solution.x, "energy": solution.energy, **{f"C {n}": v for n, v in solution.casimirs.items()}}
    if solution.attitude is not None:
        along["attitude"] = solution.attitude
    single = solution.x.ndim == 2
    arrays = {name: values[:, None] if single else values for name, values in along.items()}
    for name, drift in solution.drift().items():
        arrays[f"*{name}"] = np.atleast_2d(drift.tenths)
    state = solution._state
    failed = np.column_stack([state["status"], np.where(state["status"] != 0, state["step"], 0)])
    return Result(arrays, failure, crossings_of(solution.events, 1 if single else solution.x.shape[1]), failed)


def crossings_of(events: Any, members: int) -> tuple[np.ndarray, ...]:
    """Return the crossings of each member, one per row."""
    if events is None:
        return ()
    rows = np.column_stack([events.t, events.which, events.direction, events.x])
    return tuple(rows[events.member == m] for m in range(members))


def run(case: Case, members: Any = slice(None), **changes: Any) -> Result:
    """Run the case, or some of its members, with something changed."""
    chosen = np.arange(len(case.x0))[members]
    if case.batch:
        system = case.systems[int(chosen)] if chosen.ndim == 0 else co.batch([case.systems[m] for m in chosen])
    else:
        system = case.systems[0]
    arguments = {"attitude": case.attitude, "save_every": case.save_every, "watch": case.watch, "threads": 1}
    arguments |= {"events": case.events} | changes
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            solution = co.integrate(system, case.x0[chosen], case.t_span, case.step, case.method, **arguments)
            return result_of(solution, None)
    except co.IntegrationError as error:
        return result_of(error.partial, (error.step, error.time, repr(error.residual), str(error)))
