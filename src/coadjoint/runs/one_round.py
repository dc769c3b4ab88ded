"""Short way of a run that is one round of calls of a loop: its record is made of the arrays, without a `Run`."""

from __future__ import annotations

import time
from typing import Any

from coadjoint.kernels.arrays import NamedArrays
from coadjoint.methods.protocol.method import Method
from coadjoint.runs.loops.execution import run_in_threads
from coadjoint.runs.results.memory_record import record_of_arrays
from coadjoint.runs.results.solution import Solution
from coadjoint.runs.run import Run
from coadjoint.runs.run_setup import RunSetup
from coadjoint.runs.start import Start
from coadjoint.runs.state import RunState


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
    return Solution(record_of_arrays(setup, method, system, start, saved, state, seconds))
