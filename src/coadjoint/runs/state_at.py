"""States of a solution at arbitrary times, recomputed from the preceding saved point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.errors import IntegrationError
from coadjoint.runs.partial_steps import noises_of
from coadjoint.runs.prepared_run import PreparedRun
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.results.solution_attributes import ends_by_events, last_times, members_text, unfinished_members
from coadjoint.runs.results.solution_output import StateAt
from coadjoint.runs.times import Times, accumulated_rounding
from coadjoint.short_repr import distinct, short
from coadjoint.validation import are_finite, read_numbers

Floats = NDArray[np.float64]

MAX_STEPS = 10**7
"""Largest number of steps recomputed by one call."""


def state_at(solution: Solution, t: Any) -> StateAt:
    """Return the states of a solution at times within its run, (k,) or a single one; see `Solution.at`."""
    given = read_numbers(t, "t")
    if given.ndim > 1 or not given.size:
        raise ValueError(f"t has the shape {given.shape}; it must be a time, or a row of times")
    if not are_finite(given):
        raise ValueError(f"t is {short(t)}; every time must be finite")
    requested, direction = np.atleast_1d(given), 1.0 if solution.t_span[1] >= solution.t_span[0] else -1.0
    unfinished = unfinished_members(solution)
    ends = np.where(unfinished, last_times(solution, unfinished, direction), ends_by_events(solution))
    if solution.failed is not None and (solution.failed & np.isnan(ends)).any():
        raise ValueError("members of the run have failed; integrate the others alone for states at any time")
    # t_eval may omit the start, and exceed the span by rounding.
    low, high = sorted(solution.t_span)
    known = np.clip(np.append(solution.t_span[0], solution.t), low, high)
    end = float(solution.t[-1]) if solution.t_eval is None else solution.t_span[1]
    saved = direction * known
    count = max(len(requested), len(solution.t), solution.stats.steps + 1)
    beyond = near = accumulated_rounding(count, *solution.t_span, solution.step)
    noisy = bool(noises_of(solution.system))
    if not noisy:
        near = 4 * np.spacing(max(abs(solution.t_span[0]), abs(solution.t_span[1])))
    outside = np.flatnonzero(
        (direction * requested < saved[0] - beyond) | (direction * requested > direction * end + beyond)
    )
    if len(outside):
        shown = distinct(requested[outside[0]], known[0], end)
        raise ValueError(f"t is {shown[0]}; it must lie within the run, from {shown[1]} to {shown[2]}")
    low, high = sorted((float(known[0]), end))
    queries = np.clip(requested, low, high)
    late = np.flatnonzero(np.all(direction * queries[:, None] > direction * ends + near, axis=1))
    if len(late) and unfinished.all():
        raise ValueError(f"t is {requested[late[0]]:g}, which {members_text(unfinished)} of this run have not reached")
    if len(late):
        shown = distinct(requested[late[0]], float(direction * np.max(direction * ends)))
        raise ValueError(f"t is {shown[0]}, after events ended the runs of all members, the last at {shown[1]}")
    before = np.clip(np.searchsorted(saved, direction * queries + near, side="right") - 1, 0, None)
    if noisy:
        # The noise of a step depends on every bit of its time, which is that from the start of the run.
        before[direction * queries - saved[before] > near] = 0
    ahead = np.maximum(direction * queries - saved[before], 0.0)
    steps = np.ceil(np.where(ahead > near, ahead - near, 0.0) / solution.step).astype(np.int64)
    pieces = np.unique(before)
    last = [int(steps[before == j].max()) for j in pieces]
    if sum(last) > MAX_STEPS:
        raise ValueError(
            f"the times lie {sum(last)} steps after saved points, and at most {MAX_STEPS} steps are recomputed; "
            "integrate with t_eval, or with a smaller save_every"
        )
    order = np.lexsort((direction * queries, before))
    edges = np.searchsorted(before[order], [*pieces, pieces[-1] + 1])
    states = [
        _from_point(
            solution, j - 1, float(known[j]), count, queries[order[low:high]], direction, direction * ends + near
        )
        for j, count, low, high in zip(pieces.tolist(), last, edges[:-1], edges[1:], strict=True)
    ]
    positions = 0 if given.ndim == 0 else np.argsort(order, kind="stable")

    def in_order(series: Sequence[Any]) -> Any:
        return None if series[0] is None else np.concatenate(series)[positions]

    casimirs = {name: in_order([state.casimirs[name] for state in states]) for name in states[0].casimirs}
    x, energy, attitude = (in_order([getattr(state, name) for state in states]) for name in ("x", "energy", "attitude"))
    return StateAt(float(given) if given.ndim == 0 else given, x, energy, casimirs, attitude)


def _from_point(
    solution: Solution, j: int, start: float, count: int, queries: Floats, direction: float, until: Floats
) -> StateAt:
    """Return the states at ascending times after saved point j (-1: the start); NaN beyond `until` (members,)."""
    x, element, values = solution.x0, solution.attitude0, solution.initial
    if j >= 0:
        x, element = solution.x[j], None if solution.attitude is None else solution.attitude[j]
        values = {name: series[j] for name, series in solution.casimirs.items()}
    times = Times(start, direction * solution.step, count, 1)
    low, high = sorted((start, times.end))
    t_eval = np.concatenate([[start], np.clip(queries, low, high)])
    past_end = direction * t_eval[:, None] > until
    if past_end[0].any():
        # Ended members need some valid start; their results are discarded.
        x, element = _where(past_end[0], solution.x0, x), _where(past_end[0], solution.attitude0, element)
    try:
        run = _prepared_run(solution).run(x, (start, times.end), t_eval=t_eval, attitude=element)
    except IntegrationError as error:
        run = error.partial
        # A failure after the end of a member is irrelevant.
        if run.failed is None or len(run.t) < len(t_eval) or not past_end[-1][run.failed].all():
            raise
    # Multivalued invariants continue from the branch at the saved point, by whole periods.
    offsets = {name: values[name] - computed[0] for name, computed in run.casimirs.items()}
    casimirs = {
        name: np.where(offsets[name] == 0.0, computed, computed + offsets[name])
        for name, computed in run.casimirs.items()
    }
    x, energy, attitude = run.x, run.energy, run.attitude
    if past_end.any():
        x, energy, attitude = (_where(past_end, np.nan, series) for series in (x, energy, attitude))
        casimirs = {name: _where(past_end, np.nan, series) for name, series in casimirs.items()}
    casimirs = {name: series[1:] for name, series in casimirs.items()}
    return StateAt(queries, x[1:], energy[1:], casimirs, None if attitude is None else attitude[1:])


def _where(mask: NDArray[np.bool_], values: Any, otherwise: Any) -> Any:
    """Like np.where over members and trailing axes; None if `otherwise` is None."""
    if otherwise is None:
        return None
    return np.where(mask.reshape(mask.shape + (1,) * (otherwise.ndim - mask.ndim)), values, otherwise)


def _prepared_run(solution: Solution) -> PreparedRun:
    """Return the prepared run of a solution, cached; copies of the solution build their own."""
    prepared: PreparedRun | None = solution.__dict__.get("_prepared_run")
    if prepared is None:
        attitude: Any = {None: False, "coadjoint": "coadjoint"}.get(solution.carried, True)
        prepared = PreparedRun(solution.system, solution.method, solution.step, attitude=attitude, watch=False)
        solution.__dict__["_prepared_run"] = prepared
    return prepared
