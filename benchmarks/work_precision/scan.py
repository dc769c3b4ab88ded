"""Every solver at every setting on one system, measured in turns."""

from __future__ import annotations

import importlib
import statistics
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from work_precision import by_hand, ours
from work_precision.problems import Problem
from work_precision.reference import reference, relative_errors
from work_precision.solver import Failed, Solve, Solver

PEERS = ("heyoka_solver", "numbalsoda_solvers", "diffrax_solver", "scipy_solvers")
LIMIT = 3.0  # seconds of all states together: after a slower run, a solver is not asked for tighter settings
REPEATED = 0.4  # seconds of all states together: slower runs are measured once


@dataclass
class Run:
    """One solver at one setting; error and drifts are the worst over its states.

    cpu, wall: seconds for one trajectory; call: the same for a thousandth of the span; setup: until the first call.
    """

    solver: str
    setting: str
    states: int
    setup: float
    error: float
    energy: float
    casimirs: float
    call: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)

    def measured(self) -> dict[str, Any]:
        return {**asdict(self), **{name: statistics.median(getattr(self, name)) for name in ("cpu", "wall", "call")}}


def available() -> tuple[list[Solver], dict[str, str]]:
    """Return the solvers that can be imported, and for the others the reason why not."""
    found = ours.solvers()
    missing: dict[str, str] = {}
    for name in PEERS:
        try:
            found += importlib.import_module(f"work_precision.{name}").solvers()
        except ImportError as reason:
            missing[name.split("_")[0]] = str(reason)
    return found + by_hand.solvers(), missing


def ends(solve: Solve, problem: Problem, run: Run) -> np.ndarray:
    """Integrate from every state and note the time for one."""
    states = problem.states[: run.states]
    cpu, wall = time.process_time(), time.perf_counter()
    found = np.array([solve(x, problem.span) for x in states])
    run.cpu.append((time.process_time() - cpu) / len(states))
    run.wall.append((time.perf_counter() - wall) / len(states))
    short = time.process_time()
    for x in states:
        solve(x, problem.span / 1000.0)
    run.call.append((time.process_time() - short) / len(states))
    return found


def drift(invariant: Any, start: np.ndarray, end: np.ndarray) -> float:
    """Return the largest change, relative to what the invariant changes by over the length of the state."""
    changes = [abs(float(invariant(y)) - float(invariant(x))) for x, y in zip(start, end, strict=True)]
    scales = [float(np.linalg.norm(invariant.gradient(x)) * np.linalg.norm(x)) for x in start]
    return max(change / scale for change, scale in zip(changes, scales, strict=True))


class Energy:
    """The Hamiltonian as an invariant among the others."""

    def __init__(self, problem: Problem) -> None:
        self.hamiltonian = problem.system.hamiltonian

    def __call__(self, x: np.ndarray) -> float:
        return self.hamiltonian.value(x)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self.hamiltonian.gradient(x)


def measure(problem: Problem, solvers: Sequence[Solver], rounds: int) -> list[dict[str, Any]]:
    """Run every solver from loose to tight, then repeat all fast runs in turns."""
    exact = reference(problem)
    runs: list[tuple[Run, Solve]] = []
    for solver in solvers:
        states = problem.states[: solver.states]
        for setting in solver.settings:
            begun = time.process_time()
            solve = solver.prepare(problem, setting)
            run = Run(solver.name, repr(setting), len(states), time.process_time() - begun, 0.0, 0.0, 0.0)
            try:
                found = ends(solve, problem, run)
            except Failed:
                continue
            run.error = float(relative_errors(found, exact[: solver.states]).max())
            run.energy = drift(Energy(problem), states, found)
            run.casimirs = max(drift(casimir, states, found) for casimir in problem.system.casimirs.values())
            runs.append((run, solve))
            if run.cpu[0] * len(states) > LIMIT:
                break
    fast = [(run, solve) for run, solve in runs if run.cpu[0] * run.states < REPEATED]
    for run, _ in fast:
        for seconds in (run.cpu, run.wall, run.call):
            seconds.clear()
    for _ in range(rounds):
        for run, solve in fast:
            ends(solve, problem, run)
    return [run.measured() for run, _ in runs]
