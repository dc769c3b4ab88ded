"""SciPy: DOP853 and LSODA, the right-hand side compiled by Numba."""

from __future__ import annotations

from functools import cache
from typing import Any

import numba
import numpy as np
from scipy.integrate import solve_ivp

from work_precision.problems import Problem
from work_precision.solver import Failed, Solve, Solver, decades
from work_precision.source_text import python_function


@cache
def compiled(problem: Problem, method: str) -> Any:
    """Compile the right-hand side, once for all tolerances of a method."""
    field = numba.njit(python_function(problem, "t, x", f"dx = np.empty({problem.system.dim})", "return dx"))
    field(0.0, problem.states[0])
    return field


def prepare(problem: Problem, setting: tuple[str, float]) -> Solve:
    method, tolerance = setting
    field = compiled(problem, method)

    def solve(x0: np.ndarray, span: float) -> np.ndarray:
        done = solve_ivp(field, (0.0, span), x0, method, [span], rtol=tolerance, atol=tolerance)
        if not done.success:
            raise Failed(done.message)
        return done.y[:, -1]

    return solve


def solvers() -> list[Solver]:
    tolerances = decades(4, 13, 3)
    return [
        Solver(f"SciPy {method}", "scipy", tuple((method, tolerance) for tolerance in tolerances), prepare, states=2)
        for method in ("DOP853", "LSODA")
    ]
