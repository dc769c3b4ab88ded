"""What the attitude costs in a short call: runs made ready, a state that is new in each call, with and without it.

python benchmarks/attitude.py [--rounds R] [--calls C] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co
from coadjoint.program.parts.decompose import decompose

# Values for the parameters of the low-dimensional algebras that have some.
PARAMETERS = {"a": 0.5, "b": 0.75, "c": 0.5, "p": 0.5, "q": 0.25, "s": 0.5, "eps": 1.0}
STEP, POINTS = 0.01, 100


class Row(NamedTuple):
    """Microseconds of a call without an attitude, and over them those with it: carried, and looked at as well."""

    title: str
    rows: int
    shifted: bool
    alone: float
    carried: float
    seen: float


def algebras() -> dict[str, co.LieAlgebra]:
    """Return every algebra of the catalogue, the families in a few sizes."""
    g = co.algebras
    found = {
        "so(4)": g.so(4), "so(5)": g.so(5), "so(6)": g.so(6),
        "su(2)": g.su(2), "su(3)": g.su(3), "su(4)": g.su(4),
        "sl(3)": g.sl(3), "e(2)": g.e(2), "e(4)": g.e(4),
        "u(2)": g.get("u(n)", n=2), "gl(2)": g.get("gl(n)", n=2), "sp(4)": g.get("sp(2n)", n=2),
        "so(2,1)": g.get("so(p,q)", p=2, q=1), "so(3,1)": g.get("so(p,q)", p=3, q=1), "se(3)": g.get("se(n)", n=3),
        "heisenberg(2)": g.heisenberg(2), "three so(3)": g.copies(g.so(3), 3), "two su(3)": g.copies(g.su(3), 2),
    }  # fmt: skip
    for name in g.names():
        if not name.endswith(("(n)", "(p,q)", "(2n)")):
            found[name] = with_parameters(name)
    return found


def with_parameters(name: str) -> co.LieAlgebra:
    """Return an algebra by its name, with values for the parameters that it asks for."""
    given: dict[str, float] = {}
    while True:
        try:
            return co.algebras.get(name, **given)
        except ValueError as refusal:
            asked = next(p for p in PARAMETERS if f"parameter {p!r}" in str(refusal) and p not in given)
            given[asked] = PARAMETERS[asked]


def microseconds(calls: dict[str, Callable[[int], Any]], rounds: int, repeats: int) -> dict[str, float]:
    """Return the least processor time of each, the calls taking turns."""
    best = dict.fromkeys(calls, float("inf"))
    for _ in range(rounds):
        for name, call in calls.items():
            begun = time.process_time()
            for number in range(repeats):
                call(number)
            best[name] = min(best[name], 1e6 * (time.process_time() - begun) / repeats)
    return best


def measure(title: str, algebra: co.LieAlgebra, attitude: Any, steps: int, rounds: int, repeats: int) -> Row:
    """Time the calls of one algebra; each with another state, and its momenta looked at."""
    rng = np.random.default_rng(1993)
    system = co.LiePoissonSystem(algebra, co.Quadratic(rng.uniform(0.5, 2.0, algebra.dim)))
    states, span = 0.5 * rng.standard_normal((256, algebra.dim)), (0.0, steps * STEP)
    alone = co.prepare(system, co.Splitting(order=2), STEP)
    carrying = co.prepare(system, co.Splitting(order=2), STEP, attitude=attitude)

    def seen(number: int) -> Any:
        solution = carrying.run(states[number % 256], span)
        return solution.x, solution.attitude

    calls = {
        "alone": lambda number: alone.run(states[number % 256], span).x,
        "carried": lambda number: carrying.run(states[number % 256], span).x,
        "seen": seen,
    }
    best = microseconds(calls, rounds, repeats)
    rows = algebra.dim if isinstance(attitude, str) else system.representation.shape[1]
    shifted = bool(decompose(system, "auto").shift)
    ratios = (best[name] / best["alone"] for name in ("carried", "seen"))
    return Row(title, rows, shifted, best["alone"], *ratios)


def table(found: list[tuple[Row, Row]]) -> str:
    lines = [
        f"| | rows | shifted | one step, us | carried | and seen | {POINTS} steps, us | carried | and seen |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for one, many in found:
        shifted = "yes" if one.shifted else ""
        numbers = " | ".join(f"{row.alone:.1f} | {row.carried:.2f} | {row.seen:.2f}" for row in (one, many))
        lines.append(f"| {one.title} | {one.rows} | {shifted} | {numbers} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="the attitude of short calls: times over those without it")
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--calls", type=int, default=40)
    parser.add_argument("--only", nargs="+")
    given = parser.parse_args()
    found = []
    for title, algebra in algebras().items():
        if given.only and title not in given.only:
            continue
        has_own = co.LiePoissonSystem(algebra, co.Quadratic(np.ones(algebra.dim))).representation is not None
        for attitude in (True, "coadjoint") if has_own else ("coadjoint",):
            what = title if attitude is True else f"{title}, coadjoint"
            pair = [measure(what, algebra, attitude, n, given.rounds, given.calls) for n in (1, POINTS)]
            found.append((pair[0], pair[1]))
    print(table(found))


if __name__ == "__main__":
    main()
