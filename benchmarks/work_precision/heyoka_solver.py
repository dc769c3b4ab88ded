"""heyoka: adaptive Taylor series, the whole step compiled by LLVM for one system and one tolerance."""

from __future__ import annotations

import heyoka as hy
import numpy as np

from work_precision.problems import Problem
from work_precision.solver import Failed, Solve, Solver, decades

ROUND_OFF = 2.0**-52
hy.llvm_state.set_diskcache_enabled(False)  # set-up is compiling, not reading what an earlier run compiled


def prepare(problem: Problem, setting: tuple[float, bool]) -> Solve:
    """Compile; the default mode is 1.5 to 2.9 times as fast as the compact one, on Toda's ring at 1e-13 as fast."""
    tolerance, high_accuracy = setting
    variables = hy.make_vars(*(f"x{i}" for i in range(problem.system.dim)))
    equations = list(zip(variables, problem.field(variables), strict=True))
    taylor = hy.taylor_adaptive(equations, problem.states[0], tol=tolerance, high_accuracy=high_accuracy)

    def solve(x0: np.ndarray, span: float) -> np.ndarray:
        taylor.time = 0.0
        taylor.state[:] = x0
        outcome = taylor.propagate_until(span)[0]
        if outcome != hy.taylor_outcome.time_limit:
            raise Failed(str(outcome))
        return taylor.state.copy()

    return solve


def solvers() -> list[Solver]:
    plain = tuple((tolerance, False) for tolerance in (*decades(3, 15), ROUND_OFF))
    return [Solver("heyoka", "heyoka", (*plain, (ROUND_OFF, True), (1e-18, True)), prepare)]
