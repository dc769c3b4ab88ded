"""Steps of spin lattices with a heat bath, beside the same steps without it, and their gradients.

python benchmarks/heat_baths.py [--shape N ...] [--threads T ...] [--steps S] [--rounds R]

Energies are not watched. A gradient is that of a sum over the end, by the initial state and all parameters; its time
contains the run.
"""

from __future__ import annotations

import argparse

import numpy as np
from lyapunov import best

import coadjoint as co

STEP, DAMPING, TEMPERATURE = 0.05, 0.1, 0.3


def measured(side: int, threads: int, steps: int, rounds: int) -> list[str]:
    """Return the rows of a square lattice without and with a heat bath, timed in turns."""
    lattice = co.systems.spin_lattice("square", (side, side), periodic=True, field=(0.0, 0.0, 0.1))
    bath = lattice.with_forces(co.forces.HeatBath(DAMPING, temperature=TEMPERATURE, seed=1))
    x0 = np.random.default_rng(1).standard_normal((side * side, 3))
    x0 = (x0 / np.linalg.norm(x0, axis=1, keepdims=True)).ravel()
    ready = [
        co.prepare(system, co.Splitting(order=2), STEP, threads=threads, watch=False) for system in (lattice, bath)
    ]
    span, long = (0.0, steps * STEP), (0.0, 20 * steps * STEP)

    def run(one: co.PreparedRun) -> None:
        one.run(x0, long, save_every=20 * steps)

    def gradient(one: co.PreparedRun) -> None:
        sol, pullback = one.vjp(x0, span, save_every=steps)
        pullback(x=np.ones(sol.x.shape))

    calls = [lambda call=call, one=one: call(one) for call in (run, gradient) for one in ready]
    taken = (20 * steps, 20 * steps, steps, steps)
    plain, noisy, of_plain, of_noisy = (1e3 * s / count for s, count in zip(best(rounds, *calls), taken, strict=True))
    rows = ("none", plain, of_plain), ("heat bath", noisy, of_noisy)
    head = f"| {side} x {side} | {threads} |"
    return [
        f"{head} {name} | {step:.3f} | {step / plain:.1f} | {of_step:.2f} | {of_step / step:.1f} |"
        for name, step, of_step in rows
    ]


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shape", type=int, nargs="+", default=[16, 32])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--steps", type=int, default=50)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    print("| lattice | threads | force | ms a step | : step without | gradient, ms a step | gradient : run |")
    print("|---|---|---|---|---|---|---|")
    for side in given.shape:
        for threads in given.threads:
            print(*measured(side, threads, given.steps, given.rounds), sep="\n", flush=True)


if __name__ == "__main__":
    main()
