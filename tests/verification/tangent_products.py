"""Tangent vectors of compiled loops, for comparison with products of tangents of single steps."""

from __future__ import annotations

from typing import Any

import numpy as np

import coadjoint as co
from coadjoint.kernels.tables.tangents import Frame, stretch_logarithms, vectors_in
from coadjoint.methods.protocol.flow_method import FlowMethod
from coadjoint.methods.protocol.tangents import tangent_loop
from coadjoint.program.interpreter import Interpreter
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.run import Run
from coadjoint.runs.start import start_of
from coadjoint.runs.tangent_stretching import energy_loops
from coadjoint.runs.times import Times
from started_runs import started

NEVER = 2**40


def run_with(system: Any, method: Any, x0: Any, times: Times, vectors: np.ndarray, every: int = NEVER) -> Run:
    """Run the given number of steps with these tangent vectors (k, n)."""
    loop = tangent_loop(method, system, times.h, Frame(vectors, every))
    run = started(
        system,
        method,
        energy_loops([system], method, times.h, [loop]),
        times,
        start_of(system, method, x0, False),
        False,
    )
    run.advance()
    return run


def finished_vectors(run: Run, vectors: np.ndarray) -> np.ndarray:
    """Return the vectors (n, k) after the last step of a run of one member, completed by the interpreter."""
    count, size = vectors.shape
    found = vectors_in(run.state["memory"], count, size)[0].T.copy()
    method = run.method.expanded if isinstance(run.method, co.Composition) else run.method
    if isinstance(method, FlowMethod):
        read, times = Interpreter(method.program(run.system)), run.times
        rows, last = read.program.rows.section, times.t0 + (times.steps - 1) * times.h
        read._apply_rows(range(rows[2], rows[3]), run.state["momenta"][0].copy(), times.h, last, None, found)
    return found


def stretches(run: Run, count: int) -> np.ndarray:
    return stretch_logarithms(run.state["memory"], count)


def product_of_tangents(system: Any, method: Any, x0: Any, times: Times) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the states, the product of all step tangents, and a bound on its terms."""
    end = times.t0 + times.steps * times.h
    states = co.integrate(system, x0, (times.t0, end), abs(times.h), method, watch=False).x
    step, product, size = co.stepper(system, method, times.h), np.eye(system.dim), np.eye(system.dim)
    for k in range(times.steps):
        tangent = step.tangent(states[k], times.t0 + k * times.h)
        product, size = tangent @ product, np.abs(tangent) @ size
    return states, product, float(np.max(size))


def tolerance(system: Any, method: Any, times: Times, size: float) -> float:
    """Return the bound on round-off: a unit for each multiplication, n of them for each flow or evaluation."""
    end = times.t0 + times.h
    each = co.integrate(system, np.full(system.dim, 0.1), (times.t0, end), abs(times.h), method).stats.evaluations
    return UNIT_ROUNDOFF * times.steps * (each + 4) * system.dim * size
