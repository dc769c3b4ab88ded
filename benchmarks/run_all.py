"""Every benchmark and the machine as Markdown: printed, and written with its figures to benchmarks/report/.

python benchmarks/run_all.py [--without cost_curves ...]
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time

import numpy
from c_programs import FLAGS, HERE, build

SECTIONS = {
    "one_trajectory": "One trajectory",
    "large_trajectories": "Large systems",
    "spins": "Spins",
    "molecules": "Rigid molecules",
    "first_run_of_a_lattice": "First runs of lattices",
    "fluids": "Fluids",
    "ensembles": "Ensembles",
    "batches": "Batches beside ensembles",
    "members_of_series": "Ensembles by Taylor series",
    "families": "Families of runs",
    "heat_baths": "Heat baths",
    "gauss_legendre": "Gauss-Legendre",
    "round_off": "Round-off",
    "fit_cost_model": "Weights of the cost model",
    "lyapunov": "Tangent vectors",
    "derivatives": "Derivatives of runs",
    "derivatives_beside": "Gradients beside other solvers",
    "two_bodies": "Two asteroids beside Runge-Kutta methods",
    "systems": "The ready-made systems",
    "work_against_precision": "Work against precision",
    "automatic_parts": "Automatic parts",
    "free_body": "Free bodies as parts",
    "exported_body": "The exported header of free bodies",
    "jax_free_body": "Free bodies in JAX",
    "exported_run": "Exported runs",
    "first_result": "The first result",
    "attitude": "The attitude in short calls",
    "short_calls": "Inputs in short calls",
    "cost_curves": "Cost curves",
    "large_algebras": "Large algebras",
}
REPORT = HERE / "report"


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
        ("Python, NumPy", f"{platform.python_version()}, {numpy.__version__}"),
    ]
    return "\n".join(["| machine | |", "|---|---|", *(f"| {what} | {value} |" for what, value in rows)])


def section(name: str) -> tuple[str, bool]:
    """Run one benchmark in a process of its own, so that none warms or slows the next."""
    begun = time.perf_counter()
    done = subprocess.run([sys.executable, str(HERE / f"{name}.py")], capture_output=True, text=True)
    print(f"{name}: {time.perf_counter() - begun:.0f} s", file=sys.stderr, flush=True)
    found = done.stdout.strip() if done.returncode == 0 else f"failed: {done.stderr.strip().splitlines()[-1]}"
    figure = HERE / "build" / f"{name}.png"
    if figure.exists() and figure.stat().st_mtime > time.time() - (time.perf_counter() - begun) - 1:
        (REPORT / figure.name).write_bytes(figure.read_bytes())
        found += f"\n\n![{SECTIONS[name]}]({figure.name})"
    return f"## {SECTIONS[name]}\n\n{found}", done.returncode == 0


def main() -> None:
    parser = argparse.ArgumentParser(description="all benchmarks, as Markdown")
    parser.add_argument("--without", nargs="+", choices=SECTIONS, default=[])
    given = parser.parse_args()
    build("rigid_body")  # no compiler: say so before anything is measured
    REPORT.mkdir(exist_ok=True)
    begun = time.perf_counter()
    found = [section(name) for name in SECTIONS if name not in given.without]
    took = f"Measured in {(time.perf_counter() - begun) / 60:.0f} minutes."
    report = "\n\n".join(["# Benchmarks", machine(), took, *(text for text, _ in found)]) + "\n"
    (REPORT / "report.md").write_text(report)
    print(report)
    if not all(good for _, good in found):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
