"""The first run of one large lattice of spins: seconds and the most memory, each lattice in a process of its own.

python benchmarks/first_run_of_a_lattice.py [--spins N ...] [--only cubic disordered DM]
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time

import numpy as np

import coadjoint as co

STEP = 0.05
KINDS = {"cubic": (10**6, 10**7), "disordered": (10**6,), "DM": (10**4,)}


def lattice(kind: str, spins: int) -> tuple[int, dict[str, object]]:
    """Return the number of spins, and the arguments of `spin_lattice`."""
    if kind == "DM":
        side = round(spins**0.5)
        return side**2, {"lattice": "square", "shape": (side, side), "periodic": True, "dm": (0.1, 0.2, 0.3)}
    side = round(spins ** (1 / 3))
    arguments: dict[str, object] = {"lattice": "cubic", "shape": (side,) * 3, "periodic": True}
    if kind == "disordered":
        arguments["exchange"] = 1.0 + 0.5 * np.sin(np.arange(3 * side**3))
    return side**3, arguments


def most_memory() -> int:
    """Return the largest resident memory of this process so far, in bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def first_run(kind: str, spins: int) -> str:
    """Return a line of the table: of a system, its state and a run of two steps with the check of their size."""
    sites, arguments = lattice(kind, spins)
    before, begun = most_memory(), time.perf_counter()
    system = co.systems.spin_lattice(**arguments)
    made = time.perf_counter()
    x0 = np.random.default_rng(1).standard_normal((sites, 3))
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    drawn = time.perf_counter()
    co.integrate(system, x0.ravel(), (0.0, 2 * STEP), STEP, co.Splitting(order=2), watch=False)
    ended = time.perf_counter()
    taken = most_memory() - before
    times = f"{made - begun:.2f} | {ended - drawn:.2f}"
    return f"| {kind} | {sites} | {times} | {taken / 1e9:.2f} | {taken / sites:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="seconds and memory of the first run of a lattice of spins")
    parser.add_argument("--spins", type=int, nargs="+")
    parser.add_argument("--only", nargs="+", choices=KINDS)
    parser.add_argument("--alone", action="store_true", help="run the one lattice in this process")
    given = parser.parse_args()
    if given.alone:
        print(first_run(given.only[0], given.spins[0]))
        return
    print("| lattice | spins | system, s | first run, s | most memory, GB | bytes a spin |\n|---|---|---|---|---|---|")
    for kind in given.only or KINDS:
        for spins in given.spins or KINDS[kind]:
            command = [sys.executable, __file__, "--alone", "--only", kind, "--spins", str(spins)]
            print(subprocess.run(command, capture_output=True, text=True, check=True).stdout, end="", flush=True)


if __name__ == "__main__":
    main()
