"""One trajectory of a large system: time a step of coadjoint and of hand-written C that takes the same steps.

python benchmarks/large_trajectories.py [--spins N] [--rounds R]
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sparse
from c_programs import build, run

import coadjoint as co

STEP = 0.05
CHECKED_STEPS = 5
COUPLINGS = (1.0, 0.8, 0.6)


@dataclass(frozen=True)
class Large:
    """A system, its parts, and the C program of the same steps; `shown` picks what that program prints."""

    title: str
    program: str
    size: int
    system: Any
    parts: Any
    x0: np.ndarray
    steps: int
    arguments: tuple[float, ...]
    shown: Callable[[np.ndarray], np.ndarray]


def rotor(n: int) -> Large:
    i, j = np.triu_indices(n, 1)
    system = co.LiePoissonSystem(co.algebras.so(n), co.Quadratic(1 + 1 / (1 + i + 2 * j)), sign=-1, casimirs={})
    x0 = np.sin(1.0 + i + 3 * j)
    return Large(f"so({n})", "so_n", n, system, "coordinates", x0, 10**9 // n**4, (), lambda x: x)


def chain(spins: int) -> Large:
    """Open chain of spins with nearest-neighbour couplings; all x, then all y, then all z commute."""
    links = sparse.diags_array([np.ones(spins - 1)] * 2, offsets=[-1, 1])
    M = sparse.kron(links, np.diag(COUPLINGS), format="csr")
    system = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), spins), co.Quadratic(M), casimirs={})
    k = np.arange(spins)
    x0 = np.column_stack([np.sin(1.0 + k), np.cos(2.0 * k), np.sin(3.0 * k)]).ravel()
    parts = [tuple(range(first, 3 * spins, 3)) for first in range(3)]

    def shown(x: np.ndarray) -> np.ndarray:
        s = x.reshape(-1, 3)
        return np.concatenate([s.sum(axis=0), s[0], s[-1]])

    return Large(
        f"chain of {spins} spins", "spin_chain", spins, system, parts, x0, max(3, 10**7 // spins), COUPLINGS, shown
    )


def solve(case: Large, steps: int) -> Any:
    method = co.Splitting(order=2, parts=case.parts)
    return co.integrate(case.system, case.x0, (0.0, steps * STEP), STEP, method, save_every=steps, watch=False)


def arguments(case: Large, steps: int) -> list[str]:
    return [str(steps), repr(STEP), str(case.size), *map(repr, case.arguments)]


def check_same_steps(case: Large, program: Path) -> None:
    """Compare the states after few steps: each of its flows rounds a component some 8 times in either program."""
    _, expected = run(program, arguments(case, CHECKED_STEPS))
    found = case.shown(solve(case, CHECKED_STEPS).x[-1])
    flows = CHECKED_STEPS * 2 * (len(case.x0) if case.parts == "coordinates" else len(case.parts))
    tolerance = 16 * 2.0**-53 * flows * len(case.x0)
    if not np.max(np.abs(found - expected)) <= tolerance:
        raise SystemExit(f"{case.title}: coadjoint and C differ by {np.max(np.abs(found - expected)):.2g}")


def compare(case: Large, rounds: int) -> str:
    program = build(case.flow_table)
    check_same_steps(case, program)
    theirs, ours = [], []
    for _ in range(rounds):
        theirs.append(1e-9 * run(program, arguments(case, case.steps))[0])
        ours.append(solve(case, case.steps).stats.seconds / case.steps)
    ratio = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    least = min(theirs), min(ours)
    return f"| {case.title} | {1e6 * least[0]:.4g} | {1e6 * least[1]:.4g} | {least[1] / least[0]:.2f} | {ratio:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="large systems: coadjoint and hand-written C")
    parser.add_argument("--spins", type=int, default=1_000_000)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    print("| one trajectory | C, us/step | coadjoint, us/step | ratio | median of the rounds |\n|---|---|---|---|---|")
    for case in (rotor(10), rotor(20), rotor(50), chain(given.spins)):
        print(compare(case, given.rounds), flush=True)


if __name__ == "__main__":
    main()
