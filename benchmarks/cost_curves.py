"""What do a step and its preparation cost as systems grow? Times, memory, and the exponents of their growth.

python benchmarks/cost_curves.py [--largest COPIES] [--figure FILE]
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measurements import DETAILS
from scipy.sparse import diags_array

import coadjoint as co
from coadjoint.program.generators import BasisMatrices
from coadjoint.program.table import FlowTable, build_flow_table

HERE = Path(__file__).parent
LARGEST = 1_000_000
METHOD = co.Splitting(order=2)
STEP = 0.01
# A run takes about this long, in entries of generators applied; the least of so many runs is taken.
WORK, RUNS = 4_000_000, 3
# Below this many seconds a preparation is repeated as often as a run.
SHORT = 0.25


@dataclass(frozen=True)
class Case:
    """A system of one family, by its size: what a fresh call of `make` returns."""

    size: int
    make: Callable[[], co.LiePoissonSystem]
    members: int = 1


@dataclass(frozen=True)
class Family:
    """Systems that grow; `against` says in what, and exponents are fitted from the size `fitted` on."""

    title: str
    against: str
    fitted: int
    cases: list[Case] = field(repr=False)


class Row(NamedTuple):
    """One system: sizes, seconds of the preparation and of a step, and bytes.

    `constants` counts the nonzero structure constants, `entries` the nonzero entries of all generators, which a sweep
    applies once. `peak` is the most that the preparation holds at a time, `tables` what it leaves.
    """

    size: int
    dim: int
    members: int
    constants: int
    entries: int
    parts: int
    building: float
    peak: int
    tables: int
    step: float


def diagonal(n: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(n).uniform(0.5, 2.0, n)


def full(n: int) -> np.ndarray[Any, Any]:
    draw = np.random.default_rng(n).standard_normal((n, n))
    return draw @ draw.T / n + np.eye(n)


def rotations(n: int, matrix: Callable[[int], Any]) -> Callable[[], co.LiePoissonSystem]:
    algebra = co.algebras.so(n)
    return lambda: co.LiePoissonSystem(algebra, co.Quadratic(matrix(algebra.dim)))


def spins(count: int) -> Callable[[], co.LiePoissonSystem]:
    """Return a chain: an anisotropy at every site, XXZ couplings of neighbours."""
    algebra = co.algebras.copies(co.algebras.so(3), count)
    coupling = np.tile([0.1, 0.1, 0.2], count)[3:]
    M = diags_array([np.tile([1.0, 0.5, 0.25], count), coupling, coupling], offsets=[0, 3, -3])
    H = co.Quadratic(M)
    return lambda: co.LiePoissonSystem(algebra, H)


def nilpotent(n: int) -> Callable[[], co.LiePoissonSystem]:
    """Return a sparse random algebra: brackets of the first half of the basis lie in the second, two an element."""
    random, half = np.random.default_rng(n), n // 2
    first, second = np.sort(random.integers(0, half, (2 * n, 2)), axis=1).T
    third = random.integers(half, n, 2 * n)
    rows = np.unique(np.stack([first, second, third], axis=1)[first < second], axis=0)
    algebra = co.LieAlgebra(np.column_stack([rows, random.standard_normal(len(rows))]), dim=n)
    return lambda: co.LiePoissonSystem(algebra, co.Quadratic(diagonal(n)))


def families(largest: int) -> Iterator[Family]:
    decades = [10**k for k in range(7) if 10**k <= largest]
    sizes = [4, 5, 6, 8, 10, 14, 20, 28, 36, 50]
    yield Family("so(n), M diagonal", "n", 14, [Case(n, rotations(n, diagonal)) for n in sizes])
    yield Family("so(n), M full", "n", 5, [Case(n, rotations(n, full)) for n in (4, 5, 6, 7, 8)])
    yield Family("copies of so(3), a chain", "copies", 1000, [Case(k, spins(k)) for k in decades])
    dims = [10**k for k in range(1, 6) if 10**k <= largest]
    yield Family("sparse random nilpotent", "dimension", 1000, [Case(n, nilpotent(n)) for n in dims])
    members = [10**k for k in range(6) if 10**k <= largest]
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    yield Family("rigid body, an ensemble", "members", 100, [Case(1, lambda: body, k) for k in members])


def bytes_of(program: FlowTable) -> int:
    tables = (program.stages, program.parts, program.terms, program.state, (program.share, program.frequency))
    return sum(column.nbytes for table in tables for column in table if isinstance(column, np.ndarray))


def building(case: Case) -> tuple[float, int, FlowTable]:
    """Return the seconds of the preparation, the most memory that it held, and the program."""
    seconds: list[float] = []
    while not seconds or (min(seconds) < SHORT and len(seconds) < RUNS):
        system = case.make()
        begun = time.perf_counter()
        program = build_flow_table(system, METHOD)
        seconds.append(time.perf_counter() - begun)
    del program
    tracemalloc.start()
    program = build_flow_table(case.make(), METHOD)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return min(seconds), peak, program


def measure_case(case: Case) -> Row:
    seconds, peak, program = building(case)
    system = case.make()
    matrices = BasisMatrices.coadjoint(system.algebra)
    entries = sum(len(found.value) for found in matrices.combinations(program.parts.forms, float))
    parts, tables = len(program.parts), bytes_of(program)
    del program, matrices
    x0 = np.random.default_rng(0).standard_normal((case.members, system.dim))
    steps = int(np.clip(WORK // (max(entries, 1) * case.members), 4, 20_000))
    runs = RUNS if steps > 4 else 1
    taken = []
    for _ in range(runs):
        run = co.integrate(system, x0, (0.0, steps * STEP), STEP, METHOD, save_every=steps, watch=False, threads=1)
        taken.append(run.stats.seconds / steps)
    constants = len(system.algebra.triples.c)
    size = case.size if case.members == 1 else case.members
    return Row(size, system.dim, case.members, constants, entries, parts, seconds, peak, tables, min(taken))


def measure(largest: int = LARGEST) -> list[tuple[Family, list[Row]]]:
    """Measure every family; a first run that is not counted loads the loops."""
    co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.1, 0.5), (0.0, 1.0), 0.1, METHOD)
    return [(family, [measure_case(case) for case in family.cases]) for family in families(largest)]


def exponent(x: list[float], y: list[float]) -> float:
    """Return the slope of log y over log x, by least squares."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def exponents(family: Family, rows: list[Row]) -> dict[str, float]:
    """Return the exponents of the upper part against the dimension (or the members), and of a step against entries."""
    upper = [row for row in rows if row.size >= family.fitted]
    if len(upper) < 3:
        return {}
    x = [float(row.dim * row.members) for row in upper]
    work = [float(row.entries * row.members) for row in upper]
    found = {"step": exponent(x, [row.step for row in upper])}
    if family.against != "members":
        found["building"] = exponent(x, [row.building for row in upper])
        found["peak"] = exponent(x, [float(row.peak) for row in upper])
        found["entries"] = exponent(x, work)
    found["step against entries"] = exponent(work, [row.step for row in upper])
    return found


def table(results: list[tuple[Family, list[Row]]]) -> str:
    lines = ["| family | fitted from | " + " | ".join(COLUMNS) + " |", "|---" * (2 + len(COLUMNS)) + "|"]
    for family, rows in results:
        found = exponents(family, rows)
        shown = [f"{found[name]:.2f}" if name in found else "" for name in COLUMNS]
        lines.append(f"| {family.title} | {family.fitted} {family.against} | " + " | ".join(shown) + " |")
    lines += [
        "",
        DETAILS,
        "",
        "| family | size | dimension | constants | entries of generators | parts | building, s |",
    ]
    lines[-1] += " its peak, MB | tables, MB | a step, s | ns an entry |"
    lines.append("|---" * 11 + "|")
    for family, rows in results:
        for row in rows:
            each = 1e9 * row.step / max(row.entries * row.members, 1)
            lines.append(
                f"| {family.title} | {row.size} {family.against} | {row.dim} | {row.constants} | {row.entries} "
                f"| {row.parts} | {row.building:.2g} | {row.peak / 1e6:.3g} | {row.tables / 1e6:.2g} "
                f"| {row.step:.2g} | {each:.1f} |"
            )
    return "\n".join(lines)


COLUMNS = ("step", "building", "peak", "entries", "step against entries")


def draw(results: list[tuple[Family, list[Row]]], path: Path) -> None:
    """Draw seconds of a step and of building, and bytes, each against the dimension times members, log-log."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    panels = (("a step, s", "step"), ("building, s", "building"), ("peak of building, MB", "peak"))
    for axes, (label, name) in zip(figure.subplots(1, 3), panels, strict=True):
        for number, (family, rows) in enumerate(results):
            if name != "step" and family.against == "members":
                continue
            x = [row.dim * row.members for row in rows]
            y = [getattr(row, name) / (1e6 if name == "peak" else 1.0) for row in rows]
            slope = exponents(family, rows).get(name)
            shown = family.title + ("" if slope is None else f": {slope:.2f}")
            axes.loglog(x, y, marker="osD^v"[number], markersize=4, color=f"C{number}", label=shown)
        axes.set_xlabel("dimension" if name != "step" else "dimension x members")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        axes.set_ylim(top=50.0 * axes.get_ylim()[1])  # room for the legend
        axes.legend(loc="upper left", fontsize=7, title="exponent of the upper part", title_fontsize=7)
    figure.savefig(path, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(description="cost of steps and of their preparation against size")
    parser.add_argument("--largest", type=int, default=LARGEST, help="no more copies, dimensions or members than this")
    parser.add_argument("--figure", type=Path, default=HERE / "build" / "cost_curves.png")
    given = parser.parse_args()
    results = measure(given.largest)
    draw(results, given.figure)
    print(table(results))


if __name__ == "__main__":
    main()
