"""coadjoint through its public interface.

"coadjoint": `co.choose` chooses scheme and step; the settings are accuracies, and the time of the choice is set-up.
"coadjoint, scanned": many schemes and steps, so that one sees what the choice gives away. Without `co.choose` the scan
is all there is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import coadjoint as co
from work_precision.problems import Problem
from work_precision.solver import Failed, Solve, Solver, decades

SCANNED = (
    *((co.Splitting(order=2), angle) for angle in (0.4, 0.1)),
    *((co.Splitting(order=4), angle) for angle in (0.8, 0.4, 0.2, 0.1, 0.05)),
    *((co.Splitting(order=6), angle) for angle in (1.4, 1.0, 0.7, 0.5, 0.35, 0.25, 0.15)),
    *((co.Splitting(order=8), angle) for angle in (2.0, 1.4, 1.0, 0.7, 0.5, 0.35)),
    *((co.GaussLegendre(stages=4), angle) for angle in (4.0, 2.0, 1.0)),
    *((co.GaussLegendre(stages=6), angle) for angle in (4.0, 2.8, 2.0, 1.4, 1.0)),
    *((co.GaussLegendre(stages=8), angle) for angle in (4.0, 2.8, 2.0, 1.4, 1.0)),
)


def end(problem: Problem, x0: np.ndarray, span: float, step: float, method: Any) -> np.ndarray:
    """Integrate with the nearest whole number of steps."""
    steps = max(1, round(span / step))
    times, step = (0.0, span), span / steps
    try:
        done = co.integrate(problem.system, x0, times, step, method, save_every=steps, watch=False, threads=1)
    except co.IntegrationError as reason:
        raise Failed(str(reason)) from reason
    return done.x[-1]


def scanned(problem: Problem, setting: tuple[Any, float]) -> Solve:
    method, angle = setting  # angle: step times the largest frequency

    def solve(x0: np.ndarray, span: float) -> np.ndarray:
        return end(problem, x0, span, angle / problem.rate, method)

    solve(problem.states[0], 0.1)
    return solve


def chosen(problem: Problem, accuracy: float) -> Solve:
    span = (0.0, problem.span)
    try:
        choices = {x.tobytes(): co.choose(problem.system, x, span, accuracy) for x in problem.states}
    except ValueError as reason:  # no scheme reaches it in double precision
        raise Failed(str(reason)) from reason

    def solve(x0: np.ndarray, span: float) -> np.ndarray:
        choice = choices[x0.tobytes()]
        return end(problem, x0, span, choice.step, choice.method)

    solve(problem.states[0], 0.1)
    return solve


def solvers() -> list[Solver]:
    scan = Solver("coadjoint, scanned", "coadjoint", SCANNED, scanned)
    if not hasattr(co, "choose"):
        return [replace(scan, name="coadjoint")]
    return [Solver("coadjoint", "coadjoint", decades(2, 12), chosen, prepares_each_state=True), scan]
