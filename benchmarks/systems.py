"""The ready-made systems: the error of every scheme that fits, at equal time.

python benchmarks/systems.py [--only rigid_body toda ...] [--rounds R]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co
from coadjoint.systems.registry import gallery_entry_of, ready_made_systems

SAMPLED_PARTS = 8
SPAN_STEPS = 800  # of the step that the system itself suggests
BUDGETS = (1.0, 4.0)  # times the time of SPAN_STEPS steps of the splitting of order 2, or of Gauss's two stages
COARSEST, FINEST = 3, 15  # powers of two: steps that are tried
FLOOR = 1e-14

Curve = list[tuple[float, float]]


class Problem(NamedTuple):
    """A system with a state and a span, and where the motion really goes."""

    system: Any
    x0: np.ndarray
    span: float
    exact: np.ndarray


def schemes() -> dict[str, Any]:
    """Return one scheme of every registered class, and the orders of those that have many."""
    found = {
        "Splitting 2": co.Splitting(order=2),
        "Splitting 4": co.Splitting(order=4),
        "Splitting 6": co.Splitting(order=6),
        "Splitting 8": co.Splitting(order=8),
        "Gauss 1": co.GaussLegendre(1),
        "Gauss 3": co.GaussLegendre(3),
        "Gauss 6": co.GaussLegendre(6),
        "Modified Gauss 2": co.ModifiedGaussLegendre(2, freeze="gradient"),
        "Iterated Gauss 2": co.IteratedGaussLegendre(2),
        "Runge-Kutta 4": co.ExplicitRungeKutta("rk4"),
        "Radau, energy 2": co.RadauEnergy(2),
        "Taylor 16": co.Taylor(order=16),
        "Composition of Gauss 1": co.Composition(co.GaussLegendre(1), TRIPLE_JUMP),
    }
    taken = {type(method) for method in found.values()}
    for name in co.methods.names():
        others = co.methods.registry.scheme(name)
        if others not in taken:
            found |= {str(method).replace("order=", ""): method for method in others.examples()[-1:]}
    return found


OUTER = 1 / (2 - 2 ** (1 / 3))
TRIPLE_JUMP = (OUTER, 1 - 2 * OUTER, OUTER)


def problem_of(make: Callable[..., Any], told: Any) -> Problem:
    """Return the motion that the system itself tells, over a short span, by Gauss's eight stages."""
    system = make(**told.parameters)
    start = told.start() if hasattr(told, "start") else told.x0
    x0 = np.asarray(start() if callable(start) else start, dtype=np.float64)
    x0 = x0 if x0.ndim == 1 else x0[0]
    span, count = SPAN_STEPS * told.step, SPAN_STEPS
    before = np.full((SAMPLED_PARTS, x0.size), np.inf)
    while count <= 16 * SPAN_STEPS:
        found = co.integrate(
            system, x0, (0.0, span), span / count, co.GaussLegendre(8), save_every=count // SAMPLED_PARTS
        )
        if np.abs(found.x[1:] - before).max() < 100 * FLOOR * np.abs(found.x).max():
            return Problem(system, x0, span, found.x[1:])
        before, count = found.x[1:], 2 * count
    raise SystemExit(f"{make.__name__}: no reference that agrees with that of half as many steps")


def measured(problem: Problem, method: Any, steps: int, rounds: int) -> tuple[float, float] | None:
    """Return the seconds of a run and its error, the largest over the looks; None where the run fails."""
    try:
        ready = co.prepare(problem.system, method, problem.span / steps, watch=False)
        runs = [ready.run(problem.x0, (0.0, problem.span), save_every=steps // SAMPLED_PARTS) for _ in range(rounds)]
    except co.IntegrationError:
        return None
    error = np.abs(runs[0].x[1:] - problem.exact).max() / np.abs(problem.exact).max()
    return min(run.stats.seconds for run in runs), float(max(error, FLOOR))


def curve(problem: Problem, method: Any, longest: float, rounds: int) -> Curve:
    """Return seconds and errors of more and more steps, until a run takes longer than what is asked."""
    found: Curve = []
    for power in range(COARSEST, FINEST + 1):
        point = measured(problem, method, 2**power, rounds)
        if point is not None:
            found.append(point)
            if point[0] > longest:
                break
    return found


def error_at(found: Curve, seconds: float) -> float:
    """Return the error at a time, between the two runs that bracket it, linear in the logarithms."""
    below = [point for point in found if point[0] <= seconds]
    above = [point for point in found if point[0] > seconds]
    if not below:
        return math.nan
    (t0, e0), (t1, e1) = below[-1], above[0] if above else below[-1]
    if t1 == t0:
        return e0
    share = math.log(seconds / t0) / math.log(t1 / t0)
    return math.exp((1 - share) * math.log(e0) + share * math.log(e1))


def serves(method: Any, system: Any) -> bool:
    try:
        method.properties(system)
    except (TypeError, ValueError):
        return False
    return True


def errors(problem: Problem, rounds: int) -> dict[str, tuple[float, ...]]:
    """Return the errors of every scheme that fits, one for each budget."""
    fitting = {name: method for name, method in schemes().items() if serves(method, problem.system)}
    yardstick = fitting.get("Splitting 2", co.GaussLegendre(2))
    first = measured(problem, yardstick, SPAN_STEPS, 5 * rounds)
    if first is None:
        raise SystemExit(f"{problem.system.name}: {yardstick} fails at the suggested step")
    budgets = [budget * first[0] for budget in BUDGETS]
    curves = {name: curve(problem, method, budgets[-1], rounds) for name, method in fitting.items()}
    return {name: tuple(error_at(found, budget) for budget in budgets) for name, found in curves.items()}


def written(value: float, best: bool) -> str:
    if not math.isfinite(value):
        return "-"
    text = f"{value:.0e}".replace("e-0", "e-")
    return f"**{text}**" if best else text


def table(rows: dict[str, dict[str, tuple[float, ...]]]) -> str:
    names = [name for name in schemes() if any(name in row for row in rows.values())]
    lines = [
        f"Relative error, the largest at {SAMPLED_PARTS} times over {SPAN_STEPS} steps that the system suggests; left "
        f"in the time that the splitting of order 2 takes for those (where it does not fit, Gauss's two stages), "
        f"right in {BUDGETS[1]:g} times that. A scheme whose coarsest run takes longer, or fails, has a dash.\n",
        "| | " + " | ".join(names) + " |",
        "|---" * (len(names) + 1) + "|",
    ]
    for system, row in rows.items():
        best = [np.nanmin([values[k] for values in row.values()]) for k in range(len(BUDGETS))]
        cells = (
            " / ".join(written(value, value == least) for value, least in zip(row[name], best, strict=True))
            if name in row
            else ""
            for name in names
        )
        lines.append(f"| {system} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description="the ready-made systems by every scheme that fits, at equal time")
    parser.add_argument("--only", nargs="+", choices=co.systems.names())
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    rows = {}
    for name, make in sorted(ready_made_systems().items()):
        told = gallery_entry_of(name)
        if told is not None and (not given.only or name in given.only):
            rows[name] = errors(problem_of(make, told), given.rounds)
    print(table(rows))


if __name__ == "__main__":
    main()
