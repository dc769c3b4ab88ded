"""numbalsoda: the C++ and Fortran LSODA and DOP853 without Python between the steps."""

from __future__ import annotations

from functools import cache
from typing import Any

import numba
import numpy as np
from numbalsoda import dop853, lsoda, lsoda_sig

from work_precision.problems import Problem
from work_precision.solver import Failed, Solve, Solver, decades
from work_precision.source_text import python_function

MAX_STEPS = 10**8
METHODS = {"dop853": dop853, "lsoda": lsoda}


@cache
def compiled(problem: Problem, name: str) -> Any:
    """Compile the right-hand side, once for all tolerances of a method."""
    return numba.cfunc(lsoda_sig)(python_function(problem, "t, x, dx, parameters"))


def prepare(problem: Problem, setting: tuple[str, float]) -> Solve:
    name, tolerance = setting
    method = METHODS[name]
    field = compiled(problem, name)

    def solve(x0: np.ndarray, span: float) -> np.ndarray:
        times = np.array([0.0, span])
        states, success = method(field.address, x0, times, rtol=tolerance, atol=tolerance, mxstep=MAX_STEPS)
        if not success:
            raise Failed(f"stopped at tolerance {tolerance:g}")
        return states[-1]

    solve(problem.states[0], 0.1)  # Numba compiles the driver
    return solve


def solvers() -> list[Solver]:
    tightest = {"dop853": (1e-14, 3e-15), "lsoda": (2.5e-14,)}  # below, they refuse or stop
    return [
        Solver(
            f"numbalsoda {name}",
            "numbalsoda",
            tuple((name, tol) for tol in (*decades(3, 13), *tightest[name])),
            prepare,
        )
        for name in METHODS
    ]
