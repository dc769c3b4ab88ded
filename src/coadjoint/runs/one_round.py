"""The short way of a run that is one call of a loop: its solution is made of the arrays, without a `Run`."""

from __future__ import annotations

import ctypes
import time

import numpy as np
from numpy.typing import NDArray

from coadjoint.kernels.arrays import as_c_double
from coadjoint.kernels.loop import raise_outcome
from coadjoint.runs.plan import Plan
from coadjoint.runs.results.memory_solution import solution_of_numbers
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import Run
from coadjoint.runs.start import start_of_vector
from coadjoint.runs.state import State


def solution_of_short_run(plan: Plan, momenta: NDArray[np.float64], began: float) -> Solution | None:
    """Return the solution of a run of one vector whose plan `is_short`, from its momenta; it began at `began`.

    None: the momenta are not finite.
    """
    layout = plan.layout
    numbers = np.zeros(layout.size)
    numbers[layout.momenta] = momenta
    start_time = time.perf_counter()
    try:
        failed_count = plan.whole_run(ctypes.byref(as_c_double(numbers)))
        if failed_count < 0:
            raise_outcome(failed_count)
    except BaseException as error:
        raised = plan.loops.raised()
        reason = error if raised is None else raised
        if isinstance(reason, KeyboardInterrupt):
            _run_of(plan, momenta, numbers).describe_interrupt(reason, None)
        if raised is not None:
            raise raised from None
        raise
    now = time.perf_counter()
    if failed_count:
        if (raised := plan.loops.raised()) is not None:
            raise raised
        if not np.isfinite(momenta).all():
            return None
        run = _run_of(plan, momenta, numbers, plan.times.steps)
        run.failed_count, run.seconds = failed_count, now - start_time
        return run.solution(None)
    return solution_of_numbers(plan, momenta, numbers, now - start_time, now - began)


def _run_of(plan: Plan, momenta: NDArray[np.float64], numbers: NDArray[np.float64], steps: int = 0) -> Run:
    """Return the run of a vector whose arrays are in one allocation."""
    start, state = start_of_vector(plan.base, momenta), State(plan.layout.state_in(numbers), steps)
    return Run.of_arrays(plan, start, plan.layout.saved_in(numbers), state)
