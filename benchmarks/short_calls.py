"""Overhead of short calls of prepared runs: with or without attitude and inputs, of one member or many.

python benchmarks/short_calls.py [--rounds R] [--calls C] [--steps N ...] [--only NAME ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from attitude import microseconds

import coadjoint as co

STEP, MEMBERS = 0.01, 64


def chain(spins: int) -> co.LiePoissonSystem:
    """Return spins on a line, coupled to their neighbours and not to themselves."""
    bonds = [(3 * s + k, 3 * s + 3 + k) for s in range(spins - 1) for k in range(3)]
    M = np.zeros((3 * spins, 3 * spins))
    for i, j in bonds:
        M[i, j] = M[j, i] = -1.0
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), spins), co.Quadratic(M))


def full(n: int) -> np.ndarray:
    """Return a symmetric matrix without zeros."""
    A = np.random.default_rng(n).uniform(-0.3, 0.3, (n, n))
    return np.diag(np.linspace(1.0, 2.0, n)) + A + A.T


CASES: dict[str, tuple[co.LiePoissonSystem, co.methods.base.Method]] = {
    "rigid body": (co.systems.rigid_body(inertia=(1, 2, 3)), co.Splitting(order=2)),
    "Toda ring, Taylor": (co.systems.get("toda"), co.Taylor(16)),
    "gyrostat": (co.systems.gyrostat(), co.Splitting(order=2)),
    "gyrostat, Gauss": (co.systems.gyrostat(), co.GaussLegendre(2)),
    "gyrostat, Taylor": (co.systems.gyrostat(), co.Taylor(12)),
    "so(3), full M": (co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(full(3)), -1), co.Splitting(order=2)),
    "e(3), full M": (co.LiePoissonSystem(co.algebras.e(3), co.Quadratic(full(6)), -1), co.Splitting(order=2)),
    "8 spins": (chain(8), co.Splitting(order=2)),
    "64 spins": (chain(64), co.Splitting(order=2)),
}


def calls_of(system: co.LiePoissonSystem, method: Any, steps: int) -> dict[str, Callable[[int], Any]]:
    """Return the calls that are compared, each with another state and another linear term."""
    rng, span = np.random.default_rng(1993), (0.0, steps * STEP)
    spans = [(first * STEP, (first + steps) * STEP) for first in range(256)]
    states, linear = 0.5 * rng.standard_normal((256, system.dim)), 0.2 * rng.standard_normal((256, system.dim))
    # The same parts in all of them.
    steered = co.prepare(system, method, STEP, inputs=True)
    present = steered.run(states[0], span, linear=linear[0]).system
    alone = co.prepare(present, steered.method, STEP)
    many = co.prepare(present, steered.method, STEP, threads=1)
    steered_many = co.prepare(present, steered.method, STEP, inputs=True, threads=1)
    ensemble = 0.5 * rng.standard_normal((MEMBERS, system.dim))
    calls: dict[str, Callable[[int], Any]] = {
        "alone": lambda k: alone.run(states[k % 256], span, steps).x,
        "unread": lambda k: alone.run(states[k % 256], span, steps),
        "new span": lambda k: alone.run(states[k % 256], spans[k % 256], steps).x,
        "end": lambda k: alone.end(states[k % 256], span),
        "inputs": lambda k: steered.run(states[k % 256], span, steps, linear=linear[k % 256]).x,
        "ensemble": lambda k: many.run(ensemble, span, steps).x,
        "ensemble, one input": lambda k: steered_many.run(ensemble, span, steps, linear=linear[k % 256]).x,
        "ensemble, an input each": lambda k: steered_many.run(ensemble, span, steps, linear=linear[:MEMBERS]).x,
    }
    if method.properties(system).attitude != "none":
        kind: Any = True if system.representation is not None and isinstance(method, co.Splitting) else "coadjoint"
        carrying = co.prepare(present, steered.method, STEP, attitude=kind)
        size = carrying.run(states[0], span, steps).attitude.shape[-1]
        elements = carrying.run(states[0], (0.0, 256 * STEP)).attitude[:256]
        assert elements.shape == (256, size, size)
        calls["attitude"] = lambda k: carrying.run(states[k % 256], span, steps).attitude
        calls["attitude from g"] = lambda k: (
            carrying.run(states[k % 256], span, steps, attitude=elements[k % 256]).attitude
        )
    return calls


def main() -> None:
    """Print microseconds of processor time of the call alone, and what the others take over it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--calls", type=int, default=256)
    parser.add_argument("--steps", nargs="*", type=int, default=[1, 4, 100])
    parser.add_argument("--only", nargs="*", default=list(CASES))
    given = parser.parse_args()
    columns = ["end", "unread", "new span", "inputs", "attitude", "attitude from g"]
    ensembles = ["ensemble", "ensemble, one input", "ensemble, an input each"]
    print(f"| system | steps | alone, us | {' | '.join(f'+ {c}' for c in columns)} | {' | '.join(ensembles)} |")
    print(f"|---|---|---|{'---|' * len(columns + ensembles)}")
    for name in given.only:
        system, method = CASES[name]
        for steps in given.steps:
            best = microseconds(calls_of(system, method, steps), given.rounds, given.calls)
            more = [f"{best[c] - best['alone']:+.1f}" if c in best else "" for c in columns]
            cells = [name, str(steps), f"{best['alone']:.1f}", *more, *(f"{best[c]:.0f}" for c in ensembles)]
            print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
