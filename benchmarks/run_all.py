"""Every benchmark and the machine as Markdown: printed, and written to benchmarks/report.md.

python benchmarks/run_all.py [--steps N] [--rounds R] [--without automatic_parts large_algebras cost_curves]
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess

import automatic_parts
import cost_curves
import first_result
import large_algebras
import numba
import numpy
import one_trajectory
from c_programs import FLAGS, HERE, build


def first_line(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[0]


def processor() -> str:
    """Return the model name, family and model that lscpu prints."""
    plain = {**os.environ, "LC_ALL": "C"}
    printed = subprocess.run(["lscpu"], check=True, capture_output=True, text=True, env=plain).stdout
    lines = dict(line.split(":", 1) for line in printed.splitlines() if ":" in line)
    name, family, model = (lines[key].strip() for key in ("Model name", "CPU family", "Model"))
    return f"{name} (family {family}, model {model})"


def machine() -> str:
    rows = [
        ("processor", processor()),
        ("cores", str(os.cpu_count())),
        ("compiler", f"{first_line('gcc', '--version')}, {' '.join(FLAGS)}"),
        ("Python, Numba, NumPy", f"{platform.python_version()}, {numba.__version__}, {numpy.__version__}"),
    ]
    return "\n".join(["| machine | |", "|---|---|", *(f"| {what} | {value} |" for what, value in rows)])


def main() -> None:
    parser = argparse.ArgumentParser(description="all benchmarks, as Markdown")
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument(
        "--without", nargs="+", choices=["automatic_parts", "large_algebras", "cost_curves"], default=[]
    )
    given = parser.parse_args()
    build("rigid_body")  # no compiler: say so before anything is measured
    tables = [
        machine(),
        one_trajectory.table(one_trajectory.measure(given.steps, given.rounds, list("abcde"))),
        first_result.table(first_result.measure(given.rounds, cold=True)),
    ]
    if "automatic_parts" not in given.without:
        # errors and steps follow from the ratio of two costs: a tenth of the steps is enough for that
        timed = max(1, given.steps // 10)
        tables.append(automatic_parts.table(automatic_parts.measure(timed, given.rounds)))
    if "large_algebras" not in given.without:
        tables.append(large_algebras.table(large_algebras.measure()))
    if "cost_curves" not in given.without:
        curves = cost_curves.measure()
        cost_curves.draw(curves, HERE / "cost_curves.png")
        tables.append(cost_curves.table(curves))
    report = "# Benchmarks\n\n" + "\n\n".join(tables) + "\n"
    (HERE / "report.md").write_text(report)
    print(report)


if __name__ == "__main__":
    main()
