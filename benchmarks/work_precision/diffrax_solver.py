"""diffrax: Dopri8 with a PID controller, the whole solution compiled by XLA, in double precision."""

from __future__ import annotations

from functools import cache
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

from work_precision.problems import Problem
from work_precision.solver import Failed, Solve, Solver, decades

jax.config.update("jax_enable_x64", True)
MAX_STEPS = 10**6


@cache
def compiled(problem: Problem) -> Any:
    """Compile once for all tolerances; ForwardMode is the adjoint whose loop is the fastest forwards."""

    def moved(t: Any, x: Any, arguments: Any) -> Any:
        return jnp.stack(problem.field([x[i] for i in range(problem.system.dim)]))

    @jax.jit
    def solve(x0: Any, span: Any, tolerance: Any) -> Any:
        done = diffrax.diffeqsolve(
            diffrax.ODETerm(moved),
            diffrax.Dopri8(),
            0.0,
            span,
            None,
            x0,
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            max_steps=MAX_STEPS,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        return done.ys[-1], done.result == diffrax.RESULTS.successful

    solve(problem.states[0], 0.1, 1e-3)[0].block_until_ready()
    return solve


def prepare(problem: Problem, tolerance: float) -> Solve:
    whole = compiled(problem)

    def solve(x0: np.ndarray, span: float) -> np.ndarray:
        end, success = whole(x0, span, tolerance)
        if not success:
            raise Failed(f"more than {MAX_STEPS} steps at tolerance {tolerance:g}")
        return np.asarray(end)

    return solve


def solvers() -> list[Solver]:
    return [Solver("diffrax Dopri8", "diffrax", (*decades(3, 13), 1e-14, 3e-15), prepare)]
