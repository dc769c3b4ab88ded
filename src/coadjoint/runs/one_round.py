"""Short ways of runs that are one round of calls of a loop: their solutions are made of the arrays, without a `Run`."""

from __future__ import annotations

import ctypes
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import NamedArrays, as_c_double
from coadjoint.kernels.loop import raise_outcome
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.execution import run_in_threads
from coadjoint.runs.results.memory_solution import solution_of_arrays, solution_of_numbers
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import Run
from coadjoint.runs.run_setup import RunSetup
from coadjoint.runs.start import Start, start_of_vector
from coadjoint.runs.state import RunState


def solution_of_short_run(
    system: Any, method: Method, setup: RunSetup, momenta: NDArray[np.float64], began: float
) -> Solution | None:
    """Return the solution of a run of one vector without a group element that `is_one_round`, from its momenta.

    The setup is that of many calls; the run began at `began`. None: the momenta are not finite.
    """
    layout = setup.plan.layout
    numbers = np.zeros(layout.size)
    numbers[layout.momenta] = momenta
    start_time = time.perf_counter()
    try:
        failed_count = setup.whole_run(ctypes.byref(as_c_double(numbers)))
        if failed_count < 0:
            raise_outcome(failed_count)
    except BaseException as error:
        raised = setup.loops.raised()
        reason = error if raised is None else raised
        if isinstance(reason, KeyboardInterrupt):
            _run_of(system, method, setup, momenta, numbers).describe_interrupt(reason, None)
        if raised is not None:
            raise raised from None
        raise
    now = time.perf_counter()
    if failed_count:
        if (raised := setup.loops.raised()) is not None:
            raise raised
        if not np.isfinite(momenta).all():
            return None
        run = _run_of(system, method, setup, momenta, numbers, setup.times.steps)
        run.failed_count, run.seconds = failed_count, now - start_time
        return run.solution(None)
    return solution_of_numbers(setup, method, system, momenta, numbers, now - start_time, now - began)


def _run_of(
    system: Any,
    method: Method,
    setup: RunSetup,
    momenta: NDArray[np.float64],
    numbers: NDArray[np.float64],
    steps: int = 0,
) -> Run:
    """Return the run of a vector whose arrays are in one allocation."""
    layout, start = setup.plan.layout, start_of_vector(system, momenta)
    state = RunState(layout.state_in(numbers), steps)
    return Run.of_arrays(system, method, setup, start, layout.saved_in(numbers), state)


def solution_of_one_round(system: Any, method: Method, setup: RunSetup, start: Start) -> Solution:
    """Return the solution of a run that `is_one_round`; failures and interrupts are those of `Run`."""
    layout = setup.plan.layout
    saved, state = NamedArrays(layout.saved), NamedArrays(layout.state)
    state.numbers[layout.state.slices["momenta"]] = start.momenta.ravel()
    arguments = layout, setup.schedule, saved, state, 0, setup.times.steps
    start_time = time.perf_counter()
    try:
        failed_count = run_in_threads(setup.plan.rounds[0], arguments, setup.loops)
    except KeyboardInterrupt as stopped:
        run = Run.of_arrays(system, method, setup, start, saved, RunState(state))
        run.describe_interrupt(stopped, None)
        raise
    seconds = time.perf_counter() - start_time
    if failed_count:
        run = Run.of_arrays(system, method, setup, start, saved, RunState(state, setup.times.steps))
        run.failed_count, run.seconds = failed_count, seconds
        return run.solution(None)
    return solution_of_arrays(setup, method, system, start, saved, state, seconds)
