"""Families of runs: every system with every state in one call, beside one run for each system; and `coadjoint run`.

python benchmarks/families.py [--states K] [--systems P] [--rounds R]
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import coadjoint as co

SPAN, STEP, SAVE_EVERY = (0.0, 10.0), 0.1, 100
SWEEP = """
[system]
name = "rigid_body"
parameters = {{ inertia = [1.0, 2.0, 3.0] }}
[initial]
x = [0.0, 1.0, 0.0]
[sweep]
samples = {states}
seed = 1993
[sweep.over]
"system.parameters.inertia[2]" = {{ linear = [2.25, 3.0], count = {systems} }}
"initial.x" = {{ sphere = 1.0 }}
[run]
t_span = [0.0, 10.0]
step = 0.1
save_every = 100
{workers}
"""


def body(third: float) -> co.LiePoissonSystem:
    return co.systems.rigid_body(inertia=(1.0, 2.0, third))


def seconds(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def calls(thirds: list[float], states: np.ndarray) -> dict[str, Callable[[], object]]:
    """Return the ways to compute a family, by name; the first one is the unit of the others."""

    def one_by_one() -> list[np.ndarray]:
        return [co.integrate(body(third), states, SPAN, STEP, save_every=SAVE_EVERY).x for third in thirds]

    def listed() -> object:
        bodies = [body(third) for third in thirds]
        batch = co.batch([one for one in bodies for _ in states])
        return co.integrate(batch, np.tile(states, (len(thirds), 1)), SPAN, STEP, save_every=SAVE_EVERY)

    def family() -> object:
        return co.integrate(co.batch(body, third=thirds), states, SPAN, STEP, save_every=SAVE_EVERY)

    def dataset() -> object:
        return co.integrate(co.batch(body, third=thirds), states, SPAN, STEP, save_every=SAVE_EVERY).to_xarray()

    def archived() -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "run.zarr")
            co.integrate_ensemble(co.batch(body, third=thirds), states, SPAN, STEP, save_every=SAVE_EVERY, archive=path)

    return {
        "one run for each system": one_by_one,
        "a batch of repeated systems": listed,
        "a batch with a named axis": family,
        "with its dataset": dataset,
        "in blocks into an archive": archived,
    }


def command(states: int, systems: int, workers: int, folder: str) -> tuple[float, str]:
    """Return the wall time of `coadjoint run` with a sweep, and the line in which it reports its time."""
    lines = SWEEP.format(states=states, systems=systems, workers=f"workers = {workers}" if workers else "")
    Path(folder, "run.toml").write_text(lines)
    output = ["--archive", f"{folder}/{workers}.zarr"] if workers else ["--out", f"{folder}/run.nc"]
    began = time.perf_counter()
    run = subprocess.run(
        [sys.executable, "-m", "coadjoint", "run", f"{folder}/run.toml", *output],
        check=True,
        capture_output=True,
        text=True,
    )
    return time.perf_counter() - began, run.stdout.splitlines()[0].rpartition("; ")[2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--states", type=int, default=10_000)
    parser.add_argument("--systems", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    states = np.random.default_rng(1).standard_normal((options.states, 3))
    ways = calls(np.linspace(2.25, 3.0, options.systems).tolist(), states)
    times: dict[str, list[float]] = {name: [] for name in ways}
    for call in ways.values():
        call()  # the first calls import and compile
    for _ in range(options.rounds):
        for name, call in ways.items():
            times[name].append(seconds(call))
    unit = statistics.median(next(iter(times.values())))
    print(f"{options.systems} rigid bodies x {options.states} states, 100 steps; medians of {options.rounds} rounds\n")
    print("| | seconds | ratio |\n|---|---|---|")
    for name, taken in times.items():
        print(f"| {name} | {statistics.median(taken):.3f} | {statistics.median(taken) / unit:.2f} |")
    print("\n| `coadjoint run` of a sweep | seconds of the process | reported |\n|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for workers in (0, 2):
            taken_of_process, line = command(options.states, options.systems, workers, folder)
            print(f"| {f'{workers} workers' if workers else 'threads'} | {taken_of_process:.1f} | {line} |")


if __name__ == "__main__":
    main()
