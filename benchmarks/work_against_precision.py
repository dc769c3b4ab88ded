"""Work against precision: coadjoint, SciPy, heyoka, numbalsoda, diffrax, and NumPy by hand.

python benchmarks/work_against_precision.py [--rounds R] [--only body top chain separatrix ...]

Written to build/: work_precision.json, work_against_precision.png; the tables are printed.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import sys
import time
from collections.abc import Sequence
from typing import Any

from c_programs import HERE
from work_precision import figure, report, scan
from work_precision.further_problems import further_problems
from work_precision.problems import problems


def measure(rounds: int, only: Sequence[str]) -> dict[str, Any]:
    """Measure, write build/work_precision.json and .png, and return what was written."""
    solvers, missing = scan.available()
    known = {**problems(), **further_problems()}
    unknown = set(only) - set(known)
    if unknown:
        raise SystemExit(f"--only {min(unknown)}: the problems are {', '.join(known)}")
    chosen = [problem for name, problem in known.items() if not only or name in only]
    measured: dict[str, Any] = {
        "rounds": rounds,
        "versions": {solver.package: importlib.metadata.version(solver.package) for solver in solvers},
        "missing": missing,
        "problems": {},
    }
    for problem in chosen:
        begun = time.perf_counter()
        measured["problems"][problem.name] = scan.measure(problem, solvers, rounds)
        print(f"{problem.name}: {time.perf_counter() - begun:.0f} s", file=sys.stderr)
    (HERE / "build" / "work_precision.json").write_text(json.dumps(measured, indent=1))
    figure.draw(measured, HERE / "build" / "work_against_precision.png")
    return measured


def table(measured: dict[str, Any]) -> str:
    return report.tables(measured)


def main() -> None:
    parser = argparse.ArgumentParser(description="time against accuracy, beside other integrators")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--only", nargs="+", default=[])
    given = parser.parse_args()
    print(table(measure(given.rounds, given.only)))


if __name__ == "__main__":
    main()
