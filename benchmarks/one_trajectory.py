"""One trajectory: nanoseconds a step of coadjoint and of hand-written C that takes the same steps.

python benchmarks/one_trajectory.py [--steps N] [--rounds R] [--only a b c d e f g]
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from c_programs import build, run
from cases import METHOD, Case, cases

import coadjoint as co

UNIT_ROUNDOFF = 2.0**-53
CHECKED_STEPS = 1000


class Row(NamedTuple):
    """Nanoseconds a step, the least of all rounds, and the ratios of the least and the median of the rounds' ratios."""

    title: str
    reference: float
    measured: float
    ratio: float
    median: float


def check_same_steps(case: Case, program: Path) -> None:
    """Compare the final states of a short run; both may differ by what round-off can have grown to.

    Each elementary flow (at most 2 parts - 1 a step) rounds a component some 8 times in either program; every such
    error is taken to grow as a change of the start grows over the whole run, measured in the C program, coordinate by
    coordinate.
    """
    _, expected = run(program, case.c_arguments(CHECKED_STEPS))
    found = case.end(case.integrate(CHECKED_STEPS))
    growth = 1.0
    for i, value in enumerate(case.x0):
        moved = list(case.x0)
        moved[i] = value + 2.0**-26 * max(abs(value), 1.0)
        _, other = run(program, replace(case, x0=tuple(moved)).c_arguments(CHECKED_STEPS))
        growth = max(growth, float(np.max(np.abs(other - expected))) / (moved[i] - value))
    flows = CHECKED_STEPS * (2 * len(case.x0) - 1)
    tolerance = 16 * UNIT_ROUNDOFF * flows * growth * max(1.0, float(np.max(np.abs(expected))))
    difference = float(np.max(np.abs(found - expected)))
    if not difference <= tolerance:
        raise SystemExit(
            f"{case.title}: after {CHECKED_STEPS} steps coadjoint and C differ by {difference:.2g}, "
            f"but round-off explains only {tolerance:.2g}; they do not take the same steps"
        )


def compare(title: str, reference: list[float], measured: list[float]) -> Row:
    ratios = [ours / theirs for ours, theirs in zip(measured, reference, strict=True)]
    least = min(reference), min(measured)
    return Row(title, *least, least[1] / least[0], statistics.median(ratios))


def nanoseconds(case: Case, steps: int, watch: bool = False, method: Any = METHOD) -> float:
    return 1e9 * case.integrate(steps, watch, method).stats.seconds / steps


def in_turns(title: str, rounds: int, reference: Callable[[], float], ours: Callable[[], float]) -> Row:
    """Measure both in every round, the reference first."""
    pairs = [(reference(), ours()) for _ in range(rounds)]
    return compare(title, *map(list, zip(*pairs, strict=True)))


def against_c(title: str, case: Case, steps: int, rounds: int, method: Any = METHOD) -> Row:
    program = build(case.flow_table)
    nanoseconds(case, max(1, steps // 10), method=method)
    theirs = partial(run, program, case.c_arguments(steps))
    return in_turns(title, rounds, lambda: theirs()[0], lambda: nanoseconds(case, steps, method=method))


def price_of_watching(case: Case, steps: int, rounds: int) -> Row:
    nanoseconds(case, max(1, steps // 10), watch=True)
    title = f"{case.title}, watched against not"
    plain, watched = partial(nanoseconds, case, steps), partial(nanoseconds, case, steps, True)
    return in_turns(title, rounds, plain, watched)


def measure(steps: int, rounds: int, only: list[str]) -> list[tuple[str, Row]]:
    found = []
    for key, case in cases().items():
        if key in only:
            check_same_steps(case, build(case.flow_table))
            found.append((key, against_c(case.title, case, steps, rounds)))
    body, carried = cases()["a"], cases()["b"]
    if "e" in only:
        found += [("e", price_of_watching(cases()[key], steps, rounds)) for key in "acd"]
    if "f" in only:
        title = "rigid body, default parts, against the four rotations in C"
        found.append(("f", against_c(title, body, steps, rounds, co.Splitting(order=2))))
    if "g" in only:
        title = "rigid body, with attitude against without"
        without, with_it = partial(nanoseconds, body, steps), partial(nanoseconds, carried, steps)
        found.append(("g", in_turns(title, rounds, without, with_it)))
    return found


def table(rows: list[tuple[str, Row]]) -> str:
    lines = [
        "| | order 2, one trajectory | reference, ns/step | coadjoint, ns/step | ratio | median of the rounds |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {key} | {row.title} | {row.reference:.1f} | {row.measured:.1f} | {row.ratio:.2f} | {row.median:.2f} |"
        for key, row in rows
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="nanoseconds a step of coadjoint and of hand-written C")
    parser.add_argument("--steps", type=int, default=10_000_000)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--only", nargs="+", choices=list("abcdefg"), default=list("abcdefg"))
    given = parser.parse_args()
    print(table(measure(given.steps, given.rounds, given.only)))


if __name__ == "__main__":
    main()
