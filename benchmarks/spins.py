"""Spins per second: lattices in coadjoint, and in hand-written C that takes the same steps on the same neighbour list.

python benchmarks/spins.py [--spins N ...] [--steps S] [--rounds R] [--threads T ...] [--only chain cubic disordered]
"""

from __future__ import annotations

import argparse
import resource
import statistics
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from c_programs import HERE, build, run

import coadjoint as co
from coadjoint.systems.lattices.geometry import graph

STEP = 0.05
CHECKED_STEPS = 5
TENSOR = (1.0, 0.8, 0.6)
KINDS = {"couplings read": 0, "one coupling": 1}


class Lattice(NamedTuple):
    """A system, its state, and the file that the C program reads; `kind` is what that program does with couplings."""

    title: str
    kind: str
    sites: int
    system: Any
    x0: np.ndarray
    file: Path
    ready: float  # seconds


def made(name: str, spins: int) -> Lattice:
    """Return the lattice of about so many spins, with couplings of its own or one for all."""
    if name == "chain":
        lattice, shape, periodic = "chain", spins, False
    else:
        lattice, shape, periodic = "cubic", (round(spins ** (1 / 3)),) * 3, True
    sites, edges = graph(lattice, shape, periodic)
    exchange: Any = -1.0
    if name == "disordered":
        exchange = -1.0 - 0.5 * np.sin(np.arange(len(edges)))
    k = np.arange(sites)
    x0 = np.column_stack([np.sin(1.0 + k), np.cos(2.0 * k), np.sin(3.0 * k)]).ravel()
    begun = time.perf_counter()
    system = co.systems.spin_lattice(lattice, shape, periodic, exchange=exchange, tensor=TENSOR)
    prepared(system, 1)
    ready = time.perf_counter() - begun
    file = HERE / "build" / f"{name}_{sites}.list"
    file.parent.mkdir(exist_ok=True)
    write(file, sites, edges, np.broadcast_to(-np.asarray(exchange, dtype=np.float64), len(edges)))
    title = f"{name} of {sites} spins, {2 * len(edges) / sites:.0f} neighbours"
    return Lattice(title, "couplings read" if name == "disordered" else "one coupling", sites, system, x0, file, ready)


def prepared(system: Any, threads: int) -> Any:
    return co.prepare(system, co.Splitting(order=2), STEP, watch=False, threads=threads)


def write(file: Path, sites: int, edges: np.ndarray, couplings: np.ndarray) -> None:
    """Write the neighbours of each site, ascending, and the coupling to each of them."""
    site, other = np.concatenate([edges, edges[:, ::-1]]).T
    order = np.lexsort((other, site))
    starts = np.concatenate([[0], np.cumsum(np.bincount(site, minlength=sites))])
    with file.open("wb") as out:
        out.write(starts.astype(np.uint32).tobytes())
        out.write(other[order].astype(np.uint32).tobytes())
        out.write(np.concatenate([couplings, couplings])[order].tobytes())


def solve(lattice: Lattice, run: Any, steps: int) -> Any:
    """Take the steps in coadjoint; only the end is saved."""
    return run.run(lattice.x0, (0.0, steps * STEP), save_every=steps)


def arguments(lattice: Lattice, steps: int, kind: str) -> list[str]:
    numbers = [str(steps), repr(STEP), str(lattice.sites), *map(repr, TENSOR)]
    return [*numbers, str(lattice.file), str(KINDS[kind])]


def check_same_steps(lattice: Lattice, program: Path) -> None:
    """Compare the states after few steps: each of its flows rounds a component some 8 times in either program."""
    s = solve(lattice, prepared(lattice.system, 1), CHECKED_STEPS).x[-1].reshape(-1, 3)
    found = np.concatenate([s.sum(axis=0), s[0], s[-1]])
    tolerance = 16 * 2.0**-53 * CHECKED_STEPS * 6 * lattice.x0.size
    for kind in {lattice.kind, "couplings read"}:
        _, expected = run(program, arguments(lattice, CHECKED_STEPS, kind))
        if not np.max(np.abs(found - expected)) <= tolerance:
            raise SystemExit(f"{lattice.title}: coadjoint and C differ by {np.max(np.abs(found - expected)):.2g}")


def compare(name: str, spins: int, steps: int, rounds: int, threads: list[int]) -> list[str]:
    """Time both programs in turn; gains are over the first number of threads."""
    program, lattice = build("spin_lattice", "-fopenmp"), made(name, spins)
    check_same_steps(lattice, program)
    kinds = list(dict.fromkeys([lattice.kind, "couplings read"]))
    runs = {count: prepared(lattice.system, count) for count in threads}
    theirs: dict[tuple[str, int], list[float]] = {(kind, count): [] for kind in kinds for count in threads}
    ours: dict[int, list[float]] = {count: [] for count in threads}
    for _ in range(rounds):
        for count in threads:
            ours[count].append(1e9 * solve(lattice, runs[count], steps).stats.seconds / steps)
            for kind in kinds:
                theirs[kind, count].append(run(program, arguments(lattice, steps, kind), count)[0])
    lines = []
    for kind in kinds:
        for count in threads:
            ratio = statistics.median(a / b for a, b in zip(ours[count], theirs[kind, count], strict=True))
            best = min(ours[count]), min(theirs[kind, count])
            speeds = [1e3 * lattice.sites / t for t in best[::-1]]  # nanoseconds to millions a second
            gains = min(theirs[kind, threads[0]]) / best[1], min(ours[threads[0]]) / best[0]
            lines.append(
                f"| {lattice.title} | {kind} | {count} | {speeds[0]:.1f} | {speeds[1]:.1f} | {best[0] / best[1]:.2f} | "
                f"{ratio:.2f} | {gains[0]:.2f} | {gains[1]:.2f} | {lattice.ready:.1f} |"
            )
    return lines


def table(rows: list[str]) -> str:
    head = (
        "| lattice | C | threads | C, 10^6 spins/s | coadjoint, 10^6 spins/s | ratio | median of the rounds | "
        "gain of C | gain of coadjoint | ready after s |"
    )
    return "\n".join([head, "|---|---|---|---|---|---|---|---|---|---|", *rows])


def main() -> None:
    parser = argparse.ArgumentParser(description="lattices of spins: coadjoint and hand-written C")
    parser.add_argument("--spins", type=int, nargs="+", default=[1_000_000])
    parser.add_argument("--steps", type=int, help="by default 3 10^7 updates of spins", default=None)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--only", nargs="+", choices=["chain", "cubic", "disordered"])
    given = parser.parse_args()
    rows = []
    for name in given.only or ["chain", "cubic", "disordered"]:
        for spins in given.spins:
            steps = given.steps or max(3, 3 * 10**7 // spins)
            rows += compare(name, spins, steps, given.rounds, given.threads)
    print(table(rows))
    print(f"most memory: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GB")


if __name__ == "__main__":
    main()
