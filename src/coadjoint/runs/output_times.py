"""States of a run at arbitrary times, reached from the preceding step by a partial step of the same scheme."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import NamedArrays
from coadjoint.runs.events import TerminalEvent
from coadjoint.runs.loops.execution import status_name
from coadjoint.runs.partial_steps import PartialSteps, reject_noise
from coadjoint.runs.run import Run
from coadjoint.runs.times import Times, accumulated_rounding
from coadjoint.short_repr import distinct
from coadjoint.validation import are_finite, read_numbers

Floats = NDArray[np.float64]

ULP_TOLERANCE = 4
"""Times this close to a step, in units in the last place of the larger end of the span, are at the step."""
ROWS_PER_CALL = 2**16
"""States processed at once."""


class OutputTimes(NamedTuple):
    """Output times, with the number of the step at or before each and the remaining time `length` after it."""

    t: Floats
    number: NDArray[np.int64]
    length: Floats

    @property
    def marks(self) -> NDArray[np.int64]:
        """Numbers of the steps from which the output times are reached, and 0."""
        return np.union1d(self.number, 0)

    @property
    def ends(self) -> NDArray[np.int64]:
        """For each output time, the number of the step, whole or partial, that ends there."""
        return self.number + (self.length != 0.0)


def output_times_of(t_eval: Any, times: Times, save_every: Any = 1, whole_steps: bool = False) -> OutputTimes:
    """Validate `t_eval`, (k,), sorted in the direction of the run and in its span, and locate it among the steps."""
    if save_every != 1:
        raise ValueError("the run was given save_every and t_eval; give only one of them")
    values = read_numbers(t_eval, "t_eval")
    if values.ndim != 1 or not len(values):
        raise ValueError(f"t_eval has the shape {values.shape}; it must be a row of times, at least one")
    if not are_finite(values):
        raise ValueError("t_eval contains NaN or infinity; every time must be finite")
    t = np.array(values, dtype=np.float64)
    forward = times.h > 0.0
    unsorted = np.flatnonzero(t[1:] < t[:-1] if forward else t[1:] > t[:-1])
    if len(unsorted):
        k = int(unsorted[0]) + 1
        raise ValueError(
            "t_eval[{}] is {} and comes after {}; times must be sorted in the direction of t_span".format(
                k, *distinct(t[k], t[k - 1])
            )
        )
    beyond = accumulated_rounding(max(len(t), times.steps + 1), times.t0, times.end, abs(times.h))
    low, high = (times.t0, times.end) if forward else (times.end, times.t0)
    outside = np.flatnonzero((t < low - beyond) | (t > high + beyond))
    if len(outside):
        k = int(outside[0])
        found, first, last = distinct(t[k], times.t0, times.end)
        raise ValueError(f"t_eval[{k}] is {found}; it must lie within t_span, from {first} to {last}")
    tolerance = beyond
    if not whole_steps:
        tolerance = ULP_TOLERANCE * np.spacing(max(abs(times.t0), abs(times.end), abs(times.h)))
    steps = np.clip((t - times.t0) / times.h, 0, times.steps)
    nearest = np.rint(steps).astype(np.int64)
    at_step = (np.abs(t - times.at(nearest)) <= tolerance) | (t < low) | (t > high)
    before = np.minimum(np.floor(steps).astype(np.int64), max(times.steps - 1, 0))
    # Division may round up to a whole number from just below.
    early = (t - times.at(before)) * (1.0 if forward else -1.0) < 0.0
    number = np.where(at_step, nearest, before - early)
    return OutputTimes(t, number, np.where(at_step, 0.0, t - times.at(number)))


def check_partial_steps(system: Any, moments: OutputTimes) -> None:
    """Reject output times between steps for systems without partial steps (noise)."""
    if np.any(moments.length):
        reject_noise(system)


def resample(run: Run, moments: OutputTimes) -> None:
    """Replace the saved points of a finished run, the steps in `moments.marks`, by its states at `moments`."""
    marked_points, members = run.saved, len(run.start.momenta)
    direction, ends = (1.0 if run.times.h > 0.0 else -1.0), run.ends
    if run.ending is not None:
        before = direction * moments.t < direction * run.ending.t
        moments = OutputTimes(moments.t[before], moments.number[before], moments.length[before])
    # Exactly n h at a step, independent of the rounding of its time.
    elapsed = moments.number * run.times.h + moments.length
    times = run.times.with_saved_steps(moments.marks)._replace(marks=moments.ends, between=moments.t, elapsed=elapsed)
    if run.ending is not None:
        times = _with_ending(times, run.ending)
        run.ending = run.ending._replace(points=times.points)
    plan = run.plan.with_times(times)
    saved, points = NamedArrays(plan.layout.saved), np.searchsorted(run.times.saved, moments.number)
    names = ("x", "group", "values")
    source, target = ([arrays[name] for name in names] for arrays in (marked_points, saved))
    for to_array, from_array in zip(target, source, strict=True):
        to_array[: len(points)] = from_array[points]
    if run.ending is not None:
        saved["x"][-1, 0], saved["values"][-1, 0] = run.ending.x, run.ending.values
    partial = np.flatnonzero(moments.length)
    if len(partial):
        parts = PartialSteps(run.plan.base, run.plan.method, run.loops, run.plan.workers)
        # A failed member has no partial steps within its failed step.
        last = np.where(run.state["status"] == 0, run.times.steps + 1, run.state["step"])
        chunk = max(1, ROWS_PER_CALL // members)
        for first in range(0, len(partial), chunk):
            chunk_points = partial[first : first + chunk]
            _fill(parts, run, moments, chunk_points, (last, direction * ends), target)
        late = (moments.ends[:, None] >= last) & (run.state["status"] != 0)
        for array in target:
            array[: len(late)][late] = np.nan
    run.initial, run.saved, run.plan = marked_points["values"][0], saved, plan


def _with_ending(times: Times, ending: TerminalEvent) -> Times:
    """Append the time of the terminal event to the output times."""
    assert times.marks is not None and times.between is not None and times.elapsed is not None
    return times._replace(
        marks=np.append(times.marks, ending.steps),
        between=np.append(times.between, ending.t),
        elapsed=np.append(times.elapsed, ending.t - times.t0),
    )


def _fill(
    parts: PartialSteps, run: Run, moments: OutputTimes, some: NDArray[np.int64], limits: Any, target: list[Floats]
) -> None:
    """Compute the states at these output times by partial steps, for members that have neither failed nor ended."""
    x, group, values = target
    k, owners = (axis.ravel() for axis in np.meshgrid(some, np.arange(x.shape[1]), indexing="ij"))
    failing, ending = limits
    past_end = (1.0 if run.times.h > 0.0 else -1.0) * moments.t[k] > ending[owners]
    active = (moments.ends[k] < failing[owners]) & ~past_end
    for array in target:
        array[k[~active], owners[~active]] = np.nan
    k, owners = k[active], owners[active]
    if not len(k):
        return
    starts = run.times.at(moments.number[k])
    result = parts.attempt(x[k, owners], group[k, owners], starts, moments.length[k], owners, watched=True)
    x[k, owners], group[k, owners] = result.momenta, result.groups
    for row in np.flatnonzero(result.status).tolist():
        m, step = int(owners[row]), int(moments.ends[k[row]])
        if step < failing[m]:
            failing[m] = step
            run.mark_failed(m, step, status_name(result.status[row]), float(result.residual[row]))
    if (measures := run.loops.measured) is not None:
        measured = measures.at(result.momenta, moments.t[k])
    else:
        # Multivalued invariants were followed along the run, and are continued from there by whole periods.
        saved = values[k, owners]
        with np.errstate(invalid="ignore"):  # an energy that overflowed
            measured = np.where(saved == result.before, result.values, result.values + (saved - result.before))
    values[k, owners] = measured
