"""Batches beside ensembles: systems that differ in one parameter, and as many states of one of them.

python benchmarks/batches.py [--members M ...] [--rounds R] [--steps N] [--cases WORD ...]

Processor times of `batch`, `prepare` and the first run together, from systems, and of a later gradient by the initial
states and all parameters, if there is one. Batch and ensemble run in turns; the median of the ratios counts. `Taylor`
projects to the level sets of all invariants.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np

import coadjoint as co

STEP = 0.05


def tops(first: float, count: int) -> list[co.LiePoissonSystem]:
    """Return heavy tops whose second moment differs."""
    return [co.systems.heavy_top((1.0, second, 2.0)) for second in np.linspace(first, first + 0.25, count)]


def polynomials(first: float, count: int) -> list[co.LiePoissonSystem]:
    """Return systems on so(3) with an energy of degree four, whose first coefficient differs."""
    energies = ({(2, 0, 0): c, (0, 2, 0): 0.5, (0, 0, 4): 0.1} for c in np.linspace(first, first + 0.25, count))
    return [co.LiePoissonSystem(co.algebras.so(3), co.Polynomial(energy)) for energy in energies]


CASES: dict[str, tuple[Callable[[float, int], list[co.LiePoissonSystem]], Any]] = {
    "heavy top, Splitting(4)": (tops, co.Splitting(order=4)),
    "heavy top, GaussLegendre(2)": (tops, co.GaussLegendre(2)),
    "degree four, Splitting(4)": (polynomials, co.Splitting(order=4)),
    "heavy top, Taylor(12)": (tops, co.Taylor(12)),
    "degree four, Taylor(12)": (polynomials, co.Taylor(12)),
    "heavy top, own steps": (tops, co.Taylor(tolerance=1e-9)),
}


def seconds(system: Any, method: Any, states: np.ndarray, span: tuple[float, float]) -> tuple[float, float, float]:
    """Return processor times of `prepare`, with `batch` of a list, of a first run, and of a second gradient or 0."""
    gc.collect()
    began = time.process_time()
    prepared = co.prepare(co.batch(system) if isinstance(system, list) else system, method, STEP, threads=1)
    ready = time.process_time()
    prepared.run(states, span)
    ran = time.process_time()
    gradient = 0.0
    for _ in range(2 if prepared.scheme.differentiates(prepared.system.of_member(0)) else 0):
        again = time.process_time()
        solution, pullback = prepared.vjp(states, span)
        pullback(solution.x)
        gradient = time.process_time() - again
    return ready - began, ran - ready, gradient


def bytes_for_each(systems: co.Batch, method: Any) -> float:
    """Return the memory that a prepared batch holds for each member."""
    tracemalloc.start()
    prepared = co.prepare(systems, method, STEP, threads=1)
    used = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    return used / len(prepared.system)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, nargs="+", default=[10, 400, 10_000])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--cases", nargs="+", default=[""], help="only those whose names contain one of these")
    options = parser.parse_args()
    span = (0.0, options.steps * STEP)
    print(f"{options.steps} steps, all saved; medians of {options.rounds} rounds\n")
    columns = ["", "members", "batch: prepare, run (us for each member)", "ensemble", "ratio"]
    print(f"| {' | '.join([*columns, 'gradients: batch, ensemble, ratio', 'bytes for each member'])} |")
    print("|---|---|---|---|---|---|---|")
    chosen = {name: case for name, case in CASES.items() if any(word in name for word in options.cases)}
    for name, (systems_of, method) in chosen.items():
        for members in options.members:
            found = []
            for k in range(options.rounds + 1):
                first = 1.5 + 1e-6 * k  # new systems, of which nothing is cached
                systems = systems_of(first, members)
                states = 0.5 * np.random.default_rng(k).standard_normal((members, systems[0].dim))
                one = systems_of(first + 1e-7, 1)[0]
                found.append((seconds(one, method, states, span), seconds(systems, method, states, span)))
            found = found[1:]  # the first calls import, and touch the memory
            ratio = statistics.median(sum(own[:2]) / sum(whole[:2]) for whole, own in found)
            of_gradient = statistics.median(own[2] / whole[2] for whole, own in found)
            prepare, run, whole, gradient, of_ensemble = (
                statistics.median(times) / members * 1e6
                for times in (
                    [own[0] for _, own in found],
                    [own[1] for _, own in found],
                    [sum(ensemble[:2]) for ensemble, _ in found],
                    [own[2] for _, own in found],
                    [ensemble[2] for ensemble, _ in found],
                )
            )
            held = bytes_for_each(co.batch(systems_of(2.0, members)), method)
            gradients = f"{gradient:.1f}, {of_ensemble:.1f}, {of_gradient:.2f}" if gradient else "-"
            print(
                f"| {name} | {members} | {prepare:.1f}, {run:.1f} | {whole:.1f} | {ratio:.2f} "
                f"| {gradients} | {held:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
