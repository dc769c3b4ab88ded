"""What a person writes in an afternoon: the classical Runge-Kutta method in NumPy with a constant step."""

from __future__ import annotations

import numpy as np

from work_precision.problems import Problem
from work_precision.solver import Solve, Solver
from work_precision.source_text import python_function


def prepare(problem: Problem, angle: float) -> Solve:
    """`angle`: step times the largest frequency."""
    n = problem.system.dim
    # lists of floats inside: faster than indexing arrays in up to some thirty dimensions
    field = python_function(problem, "x", f"x = x.tolist(); dx = [0.0] * {n}", "return np.array(dx)")

    def solve(x0: np.ndarray, span: float) -> np.ndarray:
        steps = max(1, round(problem.rate * span / angle))
        h, x = span / steps, x0
        for _ in range(steps):
            k1 = field(x)
            k2 = field(x + 0.5 * h * k1)
            k3 = field(x + 0.5 * h * k2)
            k4 = field(x + h * k3)
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return x

    return solve


def solvers() -> list[Solver]:
    return [Solver("NumPy RK4", "numpy", tuple(0.4 * 0.5**k for k in range(5)), prepare, states=1)]
