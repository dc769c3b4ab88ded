"""Single trajectories of few steps: one kernel call whose buffer becomes the `Solution`, or its last state alone."""

from __future__ import annotations

import ctypes
import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray
from numpy.typing import NDArray

from coadjoint.kernels.loop import Layout, as_c_double, raise_outcome
from coadjoint.kernels.tables.recording import SCHEDULE_BYTES, schedule_of
from coadjoint.methods.forced import check_steps
from coadjoint.runs.loops.loops import Loops
from coadjoint.runs.loops.member_batches import raise_reason
from coadjoint.runs.plan_and_state import Plan, State
from coadjoint.runs.results.memory_solution import solution_of_numbers
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import Run
from coadjoint.runs.start import Start, momenta_of, start_without_groups, vector_size
from coadjoint.runs.times import Times, is_same_span, is_unchangeable, span_of, times_between
from coadjoint.validation import FLOAT64

if TYPE_CHECKING:
    from coadjoint.runs.prepared_run import PreparedRun

ENDS_ONLY = 2**53
"""A `save_every` that saves only the start and the end."""
MAX_CACHED_NUMBERS = 2**16
"""Largest number of entries cached between calls; for larger runs allocation is negligible."""
NO_SPAN = object()
"""In place of the last span, which no argument is."""


class FinalStateRun:
    """Reusable arrays for successive calls of a `PreparedRun`; concurrent calls need separate objects."""

    _loops: Loops
    _numbers: NDArray[np.float64]
    _clear: Callable[[float], None] | None
    _momentum: NDArray[np.float64]
    _end: NDArray[np.float64]
    _evaluations: NDArray[Any]
    _layout: Layout

    def __init__(self, prepared: PreparedRun) -> None:
        self._prepared, self._max_evaluations = prepared, prepared.most_evaluations
        self._shape = (vector_size(prepared.system),)
        self._is_bounded = self._max_evaluations < math.inf
        self._span: Any = NO_SPAN
        self._h: float | None = None
        self._whole_run: Callable[[], int] | None = None
        self._advance: Callable[[], int] | None = None

    def end(self, x0: Any, t_span: Any, inputs: Mapping[str, Any]) -> NDArray[np.float64] | None:
        """Return the final state; None if a full run is needed, for instance to raise the error."""
        if t_span is not self._span and not is_same_span(t_span, self._span):
            self._prepare_span(t_span)
        advance = self._advance
        if advance is None:
            return None
        if inputs or self._loops.writable:
            values = self._prepared.values_of(inputs, x0)
            if values is None or values.ndim > 1:
                return None
            advance = self._call_of(self._loops.with_values(values))
        x: NDArray[np.float64] = x0
        if type(x) is not ndarray or x.dtype is not FLOAT64 or x.shape != self._shape:
            momenta, single = momenta_of(self._prepared.system, x0)
            if not single:
                return None
            x = momenta[0]
        if self._clear is not None:
            self._clear(0.0)
        self._momentum[...] = x
        try:
            failed_count = advance()
            if failed_count < 0:
                raise_outcome(failed_count)
        except BaseException as error:
            raise_reason(self._loops.raised, error)
        if failed_count:
            # The full run fails too; it reports the step, and raises the exceptions of user functions.
            self._loops.raised()
            return None
        if self._is_bounded and self._evaluations[0] > self._max_evaluations:
            return None
        return self._end.copy()

    def _prepare_span(self, t_span: Any) -> None:
        self._span, self._advance = NO_SPAN, None
        times = times_between(span_of(t_span), self._prepared.step, ENDS_ONLY)
        check_steps(self._prepared.system, self._prepared.scheme, times.t0, times.h, times.steps)
        if times.h != self._h:
            self._h, self._whole_run = times.h, self._allocated(times)
        if self._whole_run is not None and times.steps:
            self._schedule.raw = schedule_of(*times[:4], False)
            self._advance = self._whole_run
        if is_unchangeable(t_span):
            self._span = t_span

    def _allocated(self, times: Times) -> Callable[[], int] | None:
        """Allocate the arrays for runs of a single vector, and return the call of their loop; None for other runs."""
        prepared = self._prepared
        loops = prepared.loops(times.h)
        # Matrices are projected onto their algebra when they are read.
        if loops.owners is not None or loops.rows:
            return None
        if prepared.system.has_matrices or prepared.representation is not None:
            return None
        layout = loops.layout(1, 2, 0)
        if layout.size > MAX_CACHED_NUMBERS:
            return None
        self._loops, self._numbers = loops, np.zeros(layout.size)
        saved, state = layout.saved_in(self._numbers), layout.state_in(self._numbers)
        # Work integrals follow the coordinates, and start at zero.
        dim = prepared.system.dim
        self._clear = state["momenta"].fill if loops.work_integrals else None
        self._momentum, self._end = state["momenta"][0, :dim], saved["x"][1, 0, :dim]
        self._evaluations = state["evaluations"]
        self._layout, self._schedule = layout, ctypes.create_string_buffer(SCHEDULE_BYTES)
        return self._call_of(loops)

    def _call_of(self, loops: Loops) -> Callable[[], int]:
        ((batch,),) = loops.rounds(1, 1)
        return partial(batch.whole_run(self._layout, self._schedule), ctypes.byref(as_c_double(self._numbers)))


def solution_of_short_run(
    plan: Plan, momenta: NDArray[np.float64], began: float, start: Start | None = None
) -> Solution | None:
    """Return the solution of a run whose plan `is_short`; None if the momenta (members * n,) are not finite."""
    layout = plan.layout
    numbers = np.zeros(layout.size)
    numbers[layout.momenta] = momenta
    start_time, reason = time.perf_counter(), None
    try:
        failed_count = plan.whole_run(ctypes.byref(as_c_double(numbers)))
        if failed_count < 0:
            raise_outcome(failed_count)
    except BaseException as error:
        failed_count, reason = 1, error
    now = time.perf_counter()
    if failed_count:
        # Exceptions of user functions take precedence, and may be interrupts.
        reason = plan.loops.raised() or reason
        if isinstance(reason, KeyboardInterrupt):
            stopped = _run_of(plan, start, momenta, numbers)
            stopped.seconds = now - start_time
            stopped.describe_interrupt(reason, None)
        if reason is not None:
            raise reason
        if not np.isfinite(momenta).all():
            return None
        run = _run_of(plan, start, momenta, numbers, plan.times.steps)
        run.failed_count, run.seconds = failed_count, now - start_time
        return run.solution(None)
    return solution_of_numbers(plan, start, momenta, numbers, now - start_time, now - began)


def _run_of(
    plan: Plan, start: Start | None, momenta: NDArray[np.float64], numbers: NDArray[np.float64], steps: int = 0
) -> Run:
    start = start or start_without_groups(plan.system, momenta[None], True)
    return Run.of_arrays(plan, start, plan.layout.saved_in(numbers), State(plan.layout.state_in(numbers), steps))
