"""Parts chosen by machine against the paper's one part for each coordinate: the error at equal cost, order 2.

python benchmarks/automatic_parts.py [--steps N] [--rounds R] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co

# The error is looked at here as well as at the end, since at a single time it may vanish by accident.
SAMPLED_PARTS = 16


@dataclass(frozen=True)
class Problem:
    """A system, where it starts, how long it runs, and the step that ``parts="coordinates"`` takes."""

    title: str
    system: Any
    x0: tuple[float, ...]
    span: float
    step: float

    def methods(self) -> dict[str, co.Splitting]:
        """Return the choices that are compared, by name."""
        return {
            "coordinates": co.Splitting(order=2, parts="coordinates"),
            "auto": co.Splitting(order=2, parts="auto"),
            "tuned": co.Splitting.tuned(self.system, self.x0),
        }

    def run(self, method: Any, steps: int, looks: int = 1) -> Any:
        return co.integrate(
            self.system,
            self.x0,
            (0.0, self.span),
            self.span / steps,
            method,
            save_every=steps // looks,
            watch=False,
            threads=1,
        )


class Row(NamedTuple):
    """One choice of parts at the time that "coordinates" takes.

    Errors are lengths of the difference of x: at the end, and the root mean square of 16 times up to it. The gains are
    the errors of "coordinates" over those of this choice; `elsewhere` has the least, the median and the greatest gain
    (root mean square) of 20 other initial states, and `worse` counts those below 1.
    """

    title: str
    choice: str
    shift: str
    parts: int
    flows: int
    nanoseconds: float
    steps: int
    end: float
    mean: float
    end_gain: float
    mean_gain: float
    elsewhere: tuple[float, float, float]
    worse: int


def spin_chain(sites: int = 8) -> co.LiePoissonSystem:
    """Return an open chain of spins: xx, yy, zz couplings of neighbours, each among coordinates that commute, and an
    anisotropy.
    """
    M = np.zeros((3 * sites, 3 * sites))
    for axis, coupling in enumerate((1.0, 0.8, 0.5)):
        for i in range(axis, 3 * sites - 3, 3):
            M[i, i + 3] = M[i + 3, i] = coupling
    M[range(0, 3 * sites, 3), range(0, 3 * sites, 3)] = 0.3
    M[range(2, 3 * sites, 3), range(2, 3 * sites, 3)] = -0.6
    algebra = co.algebras.copies(co.algebras.get("so(3)"), sites)
    return co.LiePoissonSystem(algebra, co.Quadratic(M), name="spin chain")


def problems() -> dict[str, Problem]:
    e3, so4 = co.algebras.get("e(3)"), co.algebras.get("so(4)")
    top = co.LiePoissonSystem(
        e3, co.Quadratic([1.0, 0.8, 0.5, 0.0, 0.0, 0.0], linear=[0, 0, 0, 0.2, 0.1, 1.0]), name="heavy top"
    )
    body = co.LiePoissonSystem(e3, co.Quadratic([1.0, 0.75, 0.5, 0.9, 0.7, 0.4]), name="Kirchhoff body")
    four = co.LiePoissonSystem(so4, co.Quadratic([1.0, 0.7, 0.5, 0.9, 0.4, 0.3]), name="so(4)")
    spins = np.random.default_rng(8).standard_normal((8, 3))
    spins /= np.sqrt(np.sum(spins**2, axis=1, keepdims=True))
    masses = (1.0, 2.0, 0.5)
    moved = (0.6, -0.4, 1.0, 0.3, 0.8, -0.5)
    return {
        "body": Problem(
            "rigid body, M = (1, 2, 1/2)", co.systems.paper_rigid_body(masses), (1.0, 0.1, 0.5), 20.0, 0.05
        ),
        "paper": Problem("the paper's rigid body", co.systems.paper_rigid_body(), (1.0, 10.0, 1.0), 10.0, 0.01),
        "a37": Problem("A3,7, the paper's", co.systems.paper_a37(), (1.0, 1.0, 1.0), 2.0, 0.01),
        "top": Problem("heavy top, e(3)", top, moved, 20.0, 0.05),
        "kirchhoff": Problem("Kirchhoff body, e(3)", body, moved, 20.0, 0.05),
        "so4": Problem("so(4), M diagonal", four, moved, 20.0, 0.05),
        "spins": Problem("8 spins", spin_chain(), tuple(spins.ravel().tolist()), 5.0, 0.02),
    }


def costs(problem: Problem, steps: int, rounds: int) -> dict[str, float]:
    """Return nanoseconds a step, the least of the rounds in which the choices take turns.

    The many steps divide the same span, since A3,7 does not stay where the error is measured: it runs to an
    equilibrium. What a step costs does not depend on its size.
    """
    methods = problem.methods()
    found: dict[str, list[float]] = {name: [] for name in methods}
    for method in methods.values():
        problem.run(method, max(1, steps // 10))
    for _ in range(rounds):
        for name, method in methods.items():
            found[name].append(1e9 * problem.run(method, steps).stats.seconds / steps)
    return {name: min(values) for name, values in found.items()}


def multiple(steps: float) -> int:
    return SAMPLED_PARTS * max(1, round(steps / SAMPLED_PARTS))


def errors(problem: Problem, cost: dict[str, float]) -> dict[str, tuple[int, np.ndarray]]:
    """Return the steps that each choice takes at equal time, and its errors at all looks.

    The reference is compared with one of half as many steps: it must be known far better than any error.
    """
    taken = multiple(problem.span / problem.step)
    exact, coarser = (problem.run(co.GaussLegendre(8), steps, SAMPLED_PARTS).x[1:] for steps in (2 * taken, taken))
    own = root_mean_square(exact - coarser)
    found = {}
    for name, method in problem.methods().items():
        count = multiple(taken * cost["coordinates"] / cost[name])
        difference = problem.run(method, count, SAMPLED_PARTS).x[1:] - exact
        found[name] = count, np.sqrt(np.sum(difference**2, axis=1))
        if not 100 * own < root_mean_square(found[name][1]):
            raise SystemExit(
                f"{problem.title}: the reference is known to {own:.2g} only, the error of {name} is "
                f"{root_mean_square(found[name][1]):.2g}; take a larger step"
            )
    return found


def root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def other_states(problem: Problem, count: int = 20, seed: int = 5) -> list[Problem]:
    """Return the same problem from random states of the same length: x0 alone may be a lucky one."""
    draw = np.random.default_rng(seed)
    points = draw.standard_normal((count, len(problem.x0)))
    points *= np.linalg.norm(problem.x0) / np.linalg.norm(points, axis=1, keepdims=True)
    return [replace(problem, x0=tuple(point.tolist())) for point in points]


def written(shift: dict[str, float]) -> str:
    """Return what is added to H, many equal multiples in short."""
    factors = set(shift.values())
    if len(shift) > 2 and len(factors) == 1:
        return f"{-factors.pop():+.4g} each of {len(shift)} Casimirs"
    return " ".join(f"{-factor:+.4g} {casimir}" for casimir, factor in shift.items()) or "nothing"


def compare(problem: Problem, steps: int, rounds: int) -> list[Row]:
    cost = costs(problem, steps, rounds)
    found = errors(problem, cost)
    elsewhere = [errors(other, cost) for other in other_states(problem)]
    rows = []
    for name, method in problem.methods().items():
        seen = method.describe(problem.system)
        count, error = found[name]
        plain = found["coordinates"][1]
        gains = [root_mean_square(e["coordinates"][1]) / root_mean_square(e[name][1]) for e in elsewhere]
        row = Row(
            title=problem.title,
            choice=name,
            shift=written(seen.shift),
            parts=len(seen.parts),
            flows=seen.flows,
            nanoseconds=cost[name],
            steps=count,
            end=float(error[-1]),
            mean=root_mean_square(error),
            end_gain=float(plain[-1] / error[-1]),
            mean_gain=root_mean_square(plain) / root_mean_square(error),
            elsewhere=(min(gains), statistics.median(gains), max(gains)),
            worse=sum(gain < 1.0 for gain in gains),
        )
        rows.append(row)
    return rows


def measure(steps: int, rounds: int, only: list[str] | None = None) -> list[Row]:
    chosen = [problem for name, problem in problems().items() if not only or name in only]
    return [row for problem in chosen for row in compare(problem, steps, rounds)]


def gains(rows: list[Row]) -> str:
    """Return the table of automatic parts alone, beside those of one coordinate each."""
    lines = [
        "| order 2, equal time, automatic parts | added to H | parts | flows/step | ns/step | error at the end, times "
        "smaller | the same from 20 other states: least, median, greatest |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        if row.choice == "auto":
            elsewhere = ", ".join(f"{gain:.2f}" for gain in row.elsewhere)
            shift = row.shift.replace("|", "\\|")
            figures = f"{row.parts} | {row.flows} | {row.nanoseconds:.1f} | {row.end_gain:.2f} | {elsewhere}"
            lines.append(f"| {row.title} | {shift} | {figures} |")
    return "\n".join(lines)


def table(rows: list[Row]) -> str:
    lines = [
        "| order 2, equal time | parts chosen by | added to H | parts | flows/step | ns/step | steps "
        "| error at the end | root mean square | end, times smaller | mean, times smaller "
        "| 20 other states: least, median, greatest | worse |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        shift = row.shift.replace("|", "\\|")
        lines.append(
            f"| {row.title} | {row.choice} | {shift} | {row.parts} | {row.flows} | {row.nanoseconds:.1f} | {row.steps} "
            f"| {row.end:.2e} | {row.mean:.2e} | {row.end_gain:.2f} | {row.mean_gain:.2f} "
            f"| {', '.join(f'{gain:.2f}' for gain in row.elsewhere)} | {row.worse} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="parts chosen by machine against one for each coordinate")
    parser.add_argument("--steps", type=int, default=1_000_000, help="steps that are timed")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--only", nargs="+", choices=list(problems()))
    given = parser.parse_args()
    rows = measure(given.steps, given.rounds, given.only)
    print(gains(rows), "<!-- details -->", table(rows), sep="\n\n")


if __name__ == "__main__":
    main()
