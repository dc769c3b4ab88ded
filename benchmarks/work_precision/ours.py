"""coadjoint through its public interface.

"coadjoint": `co.choose` chooses scheme and step; the settings are accuracies, and the time of the choice is set-up.
"coadjoint, not projected": Taylor series of the same steps that restore neither energy nor Casimirs.
"coadjoint, scanned": many schemes and steps, so that one sees what the choice gives away. The tables are set up
before (`co.prepare`), as other solvers compile before.
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
    *((co.Taylor(order=8), angle) for angle in (1.4, 1.0, 0.7, 0.5)),
    *((co.Taylor(order=12), angle) for angle in (2.0, 1.4, 1.0, 0.7, 0.5)),
    *((co.Taylor(order=16), angle) for angle in (2.0, 1.4, 1.0, 0.7, 0.5)),
    *((co.Taylor(order=24), angle) for angle in (2.8, 2.0, 1.4, 1.0, 0.7)),
    *((co.GaussLegendre(stages=4), angle) for angle in (4.0, 2.0, 1.0)),
    *((co.GaussLegendre(stages=6), angle) for angle in (4.0, 2.8, 2.0, 1.4, 1.0)),
    *((co.GaussLegendre(stages=8), angle) for angle in (4.0, 2.8, 2.0, 1.4, 1.0)),
)


class Ready:
    """A run made ready, for calls over any whole number of its steps."""

    def __init__(self, problem: Problem, step: float, method: Any) -> None:
        self.steps = max(1, round(problem.span / step))
        self.step = problem.span / self.steps
        self.span, self.times = problem.span, (0.0, self.steps * self.step)
        self.end = co.prepare(problem.system, method, self.step, watch=False, threads=1).end

    def __call__(self, x0: np.ndarray, span: float) -> np.ndarray:
        times = self.times if span == self.span else (0.0, max(1, round(span / self.step)) * self.step)
        try:
            return self.end(x0, times)
        except co.IntegrationError as reason:
            raise Failed(str(reason)) from reason


def scanned(problem: Problem, setting: tuple[Any, float]) -> Solve:
    method, angle = setting  # angle: step times the largest frequency
    return Ready(problem, angle / problem.rate, method)


def chosen(problem: Problem, accuracy: float, projected: bool = True) -> Solve:
    ready = {}
    for x in problem.states:
        try:
            choice = co.choose(problem.system, x, (0.0, problem.span), accuracy)
        except ValueError as reason:  # no scheme reaches it in double precision
            raise Failed(str(reason)) from reason
        method = choice.method
        if isinstance(method, co.Taylor) and not projected:
            method = replace(method, projected=False)
        ready[x.tobytes()] = Ready(problem, choice.step, method)
    return lambda x0, span: ready[x0.tobytes()](x0, span)


def not_projected(problem: Problem, accuracy: float) -> Solve:
    return chosen(problem, accuracy, projected=False)


def solvers() -> list[Solver]:
    return [
        Solver("coadjoint", "coadjoint", decades(2, 12), chosen, prepares_each_state=True),
        Solver("coadjoint, not projected", "coadjoint", decades(2, 12), not_projected, prepares_each_state=True),
        Solver("coadjoint, scanned", "coadjoint", SCANNED, scanned),
    ]
