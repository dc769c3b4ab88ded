"""Free bodies as parts against rotations alone: the error at equal cost, of perturbed bodies from random states.

python benchmarks/free_body.py [--states N] [--rounds R] [--only NAME ...]
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

import coadjoint as co

SPAN = 10.0
SAMPLED_PARTS = 8
# By order: steps that "auto" takes; errors are then well above round-off and in the range of the order.
STEPS = {2: 512, 4: 128, 6: 64}


class Row(NamedTuple):
    """One kind of body at one order.

    `cost` is the time of a step with a free body over that of one with rotations alone, for one trajectory, and
    `cost_in_lanes` for members in lanes. The gains are errors of rotations alone over those with a free body: the
    median at the same step, and at equal cost the median and the quartiles, where the error of the slower choice grows
    as the order says; `equal_cost_in_lanes` is the median for members in lanes.
    """

    title: str
    order: int
    cost: float
    cost_in_lanes: float
    same_step: float
    equal_cost: float
    quartiles: tuple[float, float]
    equal_cost_in_lanes: float


def _direction(rng: np.random.Generator) -> np.ndarray:
    v = rng.standard_normal(3)
    return v / np.linalg.norm(v)


def _top(weight: float) -> Callable[[np.random.Generator], tuple[Any, np.ndarray]]:
    """Return a maker of tops of kinetic energies about 1, whose potential energy is at most this."""

    def make(rng: np.random.Generator) -> tuple[Any, np.ndarray]:
        top = co.systems.heavy_top(rng.uniform(0.5, 2.0, 3), weight * _direction(rng))
        return top, np.concatenate([np.sqrt(2.0) * rng.standard_normal(3), _direction(rng)])

    return make


def _gyrostat(size: float) -> Callable[[np.random.Generator], tuple[Any, np.ndarray]]:
    def make(rng: np.random.Generator) -> tuple[Any, np.ndarray]:
        return co.systems.gyrostat(rng.uniform(0.5, 2.0, 3), size * _direction(rng)), rng.standard_normal(3)

    return make


def _in_a_fluid(rng: np.random.Generator) -> tuple[Any, np.ndarray]:
    M = np.concatenate([1.0 / rng.uniform(0.5, 2.0, 3), 0.1 / rng.uniform(0.5, 2.0, 3)])
    return co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(M), sign=-1), rng.standard_normal(6)


PROBLEMS: Mapping[str, tuple[str, Callable[[np.random.Generator], tuple[Any, np.ndarray]]]] = {
    "top001": ("heavy top, gravity 0.01", _top(0.01)),
    "top01": ("heavy top, gravity 0.1", _top(0.1)),
    "top1": ("heavy top, gravity 1", _top(1.0)),
    "top5": ("heavy top, gravity 5", _top(5.0)),
    "gyrostat001": ("gyrostat, rotors 0.01", _gyrostat(0.01)),
    "gyrostat03": ("gyrostat, rotors 0.3", _gyrostat(0.3)),
    "fluid": ("body in a fluid, weakly coupled", _in_a_fluid),
}


def _error(system: Any, x0: np.ndarray, method: Any, steps: int, reference: np.ndarray) -> float:
    run = co.integrate(system, x0, (0.0, SPAN), SPAN / steps, method, save_every=steps // SAMPLED_PARTS, watch=False)
    return float(np.sqrt(np.mean(np.sum((run.x - reference) ** 2, axis=1))))


def _costs(system: Any, x0: np.ndarray, methods: Mapping[str, Any], rounds: int) -> tuple[float, float]:
    """Return the time of a step with a free body over that with rotations alone: of one trajectory, of many."""
    found = []
    for start, steps in ((x0, 4096), (np.tile(x0, (64, 1)), 1024)):
        best = dict.fromkeys(methods, np.inf)
        ready = {name: co.prepare(system, method, SPAN / 1024, watch=False) for name, method in methods.items()}
        for _ in range(rounds):
            for name, prepared in ready.items():
                begin = time.perf_counter()
                prepared.run(start, (0.0, steps * SPAN / 1024), save_every=steps)
                best[name] = min(best[name], time.perf_counter() - begin)
        found.append(best["free_body"] / best["auto"])
    return found[0], found[1]


def measured(name: str, states: int, rounds: int) -> list[Row]:
    """Return the rows of one problem.

    Parameters
    ----------
    name : str
        Of the problem.
    states : int
        How many bodies and states.
    rounds : int
        How often times are taken; the least counts.

    Returns
    -------
    list of Row
        One for each order.
    """
    title, make = PROBLEMS[name]
    drawn = [make(rng) for rng in np.random.default_rng(11).spawn(states)]
    rows = []
    for order, steps in STEPS.items():
        methods = {parts: co.Splitting(order=order, parts=parts) for parts in ("auto", "free_body")}
        gains = []
        for system, x0 in drawn:
            fine = co.Splitting(order=10, compensated=True)
            reference = co.integrate(system, x0, (0.0, SPAN), SPAN / 1024, fine, save_every=1024 // SAMPLED_PARTS).x
            errors = {parts: _error(system, x0, method, steps, reference) for parts, method in methods.items()}
            gains.append(errors["auto"] / errors["free_body"])
        alone, in_lanes = _costs(*drawn[0], methods, rounds)
        middle = statistics.median(gains)
        low, _, high = statistics.quantiles(gains, n=4)
        rows.append(
            Row(
                title,
                order,
                alone,
                in_lanes,
                middle,
                middle / alone**order,
                (low / alone**order, high / alone**order),
                middle / in_lanes**order,
            )
        )
    return rows


def table(rows: list[Row]) -> str:
    """Return the rows as a table in Markdown."""
    lines = [
        "| | order | cost of a step | in lanes | gain at the same step | at equal cost (quartiles) | in lanes |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.title} | {r.order} | {r.cost:.2f} | {r.cost_in_lanes:.2f} | {r.same_step:.3g} | {r.equal_cost:.3g} "
        f"({r.quartiles[0]:.2g} to {r.quartiles[1]:.2g}) | {r.equal_cost_in_lanes:.3g} |"
        for r in rows
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure what was asked for, and print it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=100)
    parser.add_argument("--only", nargs="+", choices=list(PROBLEMS), default=list(PROBLEMS))
    given = parser.parse_args()
    print(table([row for name in given.only for row in measured(name, given.states, given.rounds)]))


if __name__ == "__main__":
    main()
