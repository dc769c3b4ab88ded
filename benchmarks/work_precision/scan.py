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
LONG_ENOUGH = 0.02  # seconds: a measurement repeats all states so long, or the caches of the solver before would count


@dataclass
class Run:
    """One solver at one setting; error and drifts are the worst over its states.

    cpu, wall: seconds for one trajectory; call: the same for a thousandth of the span; setup: until the first call.
    """

    solver: str
    setting: str
    states: int
    setup: float
    error: float = 0.0
    energy: float = 0.0
    casimirs: float = 0.0
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
    found, passes = np.zeros_like(states), 0
    cpu, wall = time.process_time(), time.perf_counter()
    while passes == 0 or time.process_time() - cpu < LONG_ENOUGH:
        found = np.array([solve(x, problem.span) for x in states])
        passes += 1
    run.cpu.append((time.process_time() - cpu) / (passes * len(states)))
    run.wall.append((time.perf_counter() - wall) / (passes * len(states)))
    short = time.process_time()
    for _ in range(passes):
        for x in states:
            solve(x, problem.span / 1000.0)
    run.call.append((time.process_time() - short) / (passes * len(states)))
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


def once(problem: Problem, solver: Solver, exact: np.ndarray, failed: list[str]) -> list[tuple[Run, Solve]]:
    """Run a solver from loose to tight until a run is too slow; what it refuses or breaks off is noted in `failed`."""
    runs: list[tuple[Run, Solve]] = []
    states = problem.states[: solver.states]
    for setting in solver.settings:
        begun = time.process_time()
        try:
            solve = solver.prepare(problem, setting)
            setup = (time.process_time() - begun) / (len(states) if solver.prepares_each_state else 1)
            run = Run(solver.name, repr(setting), len(states), setup)
            found = ends(solve, problem, run)
        except Failed as reason:
            failed.append(f"{solver.name}, {setting!r}: {reason}")
            continue
        run.error = float(relative_errors(found, exact[: solver.states]).max())
        run.energy = drift(Energy(problem), states, found)
        run.casimirs = max((drift(C, states, found) for C in problem.system.casimirs.values()), default=0.0)
        runs.append((run, solve))
        if run.cpu[0] * len(states) > LIMIT:
            break
    return runs


def measure(problem: Problem, solvers: Sequence[Solver], rounds: int) -> dict[str, Any]:
    """Run every solver once at all settings, then repeat all fast runs in turns."""
    exact = reference(problem)
    failed: list[str] = []
    runs = [pair for solver in solvers for pair in once(problem, solver, exact, failed)]
    fast = [(run, solve) for run, solve in runs if run.cpu[0] * run.states < REPEATED]
    for run, _ in fast:
        for seconds in (run.cpu, run.wall, run.call):
            seconds.clear()
    for _ in range(rounds):
        for run, solve in fast:
            ends(solve, problem, run)
    measured = [run.measured() for run, _ in runs]
    return {"span": problem.span, "dim": problem.system.dim, "runs": measured, "failed": failed}
