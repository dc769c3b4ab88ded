"""What does a step in Python cost beside the built-in scheme of the same arithmetic? Runs in turns, in one process.

python benchmarks/own_schemes.py [--rounds R]
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from typing import Any

import numpy as np

import coadjoint as co

STEPS = 20_000


@dataclasses.dataclass(frozen=True)
class Classical(co.methods.StepMethod):
    """The classical Runge-Kutta method, as one would write it down."""

    order, explicit, symmetric = 4, True, False

    def properties(self, system: Any) -> co.methods.Properties:
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")

    def step(self, system: Any, x: Any, t: Any, h: Any) -> Any:
        k1 = system.vector_field(x, t)
        k2 = system.vector_field(x + h / 2 * k1, t + h / 2)
        k3 = system.vector_field(x + h / 2 * k2, t + h / 2)
        k4 = system.vector_field(x + h * k3, t + h)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def nanoseconds(system: co.LiePoissonSystem, rounds: int) -> list[float]:
    """Return the least time of a step, built in and in Python."""
    x0 = 0.3 * np.cos(np.arange(system.dim) + 1.0)
    ready = [co.prepare(system, method, 1e-3, watch=False) for method in (co.ExplicitRungeKutta("rk4"), Classical())]
    best = [float("inf")] * 2
    for _ in range(rounds):
        for k, run in enumerate(ready):
            begun = time.perf_counter()
            run.run(x0, (0.0, STEPS * 1e-3), STEPS)
            best[k] = min(best[k], 1e9 * (time.perf_counter() - begun) / STEPS)
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description="a step in Python, compiled by Numba, over the built-in one")
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    rng = np.random.default_rng(1993)
    print("| system | built in, ns a step | in Python, compiled | ratio |\n|---|---|---|---|")
    for algebra in (co.algebras.so(3), co.algebras.e(3), co.algebras.get("A5,7", a=-0.5, b=-0.25, c=0.5),
                    co.algebras.so(5), co.algebras.su(4)):  # fmt: skip
        half = rng.standard_normal((algebra.dim, algebra.dim)) / algebra.dim
        for name, M in (("diagonal", rng.uniform(0.5, 2.0, algebra.dim)), ("full", half @ half.T)):
            built_in, own = nanoseconds(co.LiePoissonSystem(algebra, co.Quadratic(M)), rounds)
            print(f"| {algebra.name}, {name} M | {built_in:.0f} | {own:.0f} | {own / built_in:.2f} |")


if __name__ == "__main__":
    main()
