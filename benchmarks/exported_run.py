"""Exported runs in C beside the loops of the library, and beside the classical Runge-Kutta method in C.

python benchmarks/exported_run.py [--steps N] [--rounds R]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from c_programs import build, run

import coadjoint as co

RK4 = co.ExplicitRungeKutta()
CASES = {
    "rigid body, order 2": (co.systems.rigid_body((1, 2, 3)), co.Splitting(), 0.05),
    "heavy top, order 4": (co.systems.heavy_top(), co.Splitting(order=4), 0.05),
    "heavy top as a free body, order 4": (co.systems.heavy_top(), co.Splitting(order=4, parts="free_body"), 0.05),
    "ring of 64 spins, bonds, order 2": (co.systems.spin_lattice("ring", 64), co.Splitting(parts="bonds"), 0.05),
    "Lorenz' triad, order 2": (co.systems.lorenz_1960(), co.Splitting(), 0.05),
}


class Row(NamedTuple):
    """Nanoseconds of a step: in one run, by single calls, of the library, and of Runge-Kutta steps in C."""

    title: str
    run: float
    steps: float
    by_integers: float
    library: float
    runge_kutta: float


def compiled(system: Any, scheme: Any, step: float, name: str, *flags: str) -> Path:
    """Export and compile a run."""
    with tempfile.TemporaryDirectory() as folder:
        co.export_c(co.prepare(system, scheme, step=step), f"{folder}/run.h")
        return build("exported_run", f"-I{folder}", *flags, target=f"exported_{name}")


def measure(steps: int, rounds: int) -> list[Row]:
    """Return the rows; the programs take turns, and the least time of all rounds counts."""
    rows = []
    for number, (title, (system, scheme, step)) in enumerate(CASES.items()):
        count = max(100, steps // system.dim)
        own = compiled(system, scheme, step, f"{number}")
        by_integers = compiled(system, scheme, step, f"{number}_integers", "-mno-fma", "-mno-avx512f")
        other = compiled(system, RK4, step, f"{number}_rk4")
        prepared = co.prepare(system, scheme, step=step, threads=1)
        x0 = np.random.default_rng(1).standard_normal(system.dim)
        numbers = [repr(step), *(repr(float(v)) for v in x0)]
        best = np.full(5, np.inf)
        for _ in range(rounds):
            found = [
                run(program, [mode, str(count), *numbers])
                for program, mode in ((own, "0"), (own, "1"), (by_integers, "0"), (other, "0"))
            ]
            sol = prepared.run(x0, (0.0, count * step), save_every=count)
            assert np.array_equal(found[0][1], sol.x[-1]) and np.array_equal(found[2][1], sol.x[-1])
            times = [nanoseconds for nanoseconds, _ in found]
            best = np.minimum(best, [*times[:3], 1e9 * sol.stats.seconds / count, times[3]])
        rows.append(Row(title, *best.tolist()))
    return rows


def table(rows: list[Row]) -> str:
    """Return the rows as a table in Markdown."""
    heads = ("", "`run`", "`step`", "`run` without fused products", "the library", "Runge-Kutta of order 4 in C")
    lines = ["| " + " | ".join(heads) + " |", "|---" * len(heads) + "|"]
    return "\n".join([*lines, *(f"| {row.title} | " + " | ".join(f"{v:.0f}" for v in row[1:]) + " |" for row in rows)])


def main() -> None:
    """Measure and print nanoseconds a step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=200_000, help="times the number of coordinates")
    parser.add_argument("--rounds", type=int, default=20)
    given = parser.parse_args()
    print(table(measure(given.steps, given.rounds)))


if __name__ == "__main__":
    main()
