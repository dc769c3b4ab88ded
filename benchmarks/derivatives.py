"""What do derivatives of runs cost? Gradients, tangents and steps, beside the same run or step without them.

    python benchmarks/derivatives.py [--steps N] [--rounds N]
    python benchmarks/derivatives.py --forces [--steps N] [--rounds N]
    python benchmarks/derivatives.py --lattice 200 [--threads 1 2] [--rounds N]

Each is run in turns with the plain run, and the best of the rounds is taken. A gradient is that of a sum over the end,
by the initial state and all parameters; its time contains the run. With --forces, runs with forces and attitudes, one
and an ensemble. With --lattice, those of one square lattice of spins in turns on each number of threads.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from lyapunov import best

import coadjoint as co

DIRECTIONS = 8


def cases() -> dict[str, tuple[object, np.ndarray, list[object], bool]]:
    """Return systems with a state, schemes, and whether with the attitude, by name."""
    rng = np.random.default_rng(7)
    spins = rng.standard_normal((100, 3))
    spins /= np.linalg.norm(spins, axis=1)[:, None]
    full = rng.standard_normal((3, 3))
    top = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5))
    body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5))
    state = np.array([0.3, 1.0, 0.2])
    splittings = [co.Splitting(order=2), co.Splitting(order=4)]
    gauss = [co.GaussLegendre(1), co.GaussLegendre(2), co.GaussLegendre(4), co.ExplicitRungeKutta("rk4")]
    return {
        "body": (body, state, [*splittings, *gauss], False),
        "body, attitude": (body, state, [*splittings, co.GaussLegendre(2)], True),
        "body, full M": (
            co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(full @ full.T / 4), sign=-1),
            state,
            splittings,
            False,
        ),
        "heavy top": (top, np.array([0.3, 1.0, 0.2, 0.1, 0.4, 0.9]), [*splittings, *gauss], False),
        "Toda, 8 sites": (co.systems.toda(sites=8), 0.3 * rng.standard_normal(15), splittings, False),
        "100 spins": (
            co.systems.spin_lattice(shape=100, periodic=True),
            spins.ravel(),
            [co.Splitting(order=2), co.GaussLegendre(2)],
            False,
        ),
        "1000 bodies": (body, rng.standard_normal((1000, 3)), [co.Splitting(order=4), co.GaussLegendre(2)], False),
    }


def speed_limit(x, t, drag):
    """Return a torque as a function of the state, with a parameter."""
    return -drag * x * (x @ x)


def of_forces(steps: int, rounds: int) -> None:
    """Print the times of derivatives of runs with forces and attitudes in those of the runs, of one and 256 members."""
    F = co.forces
    forces = {
        "none": (),
        "damping": (F.LinearDamping(0.1),),
        "constant torque": (F.Torque((0.1, 0.2, 0.3)),),
        "function of time": (F.Torque(lambda t: np.array([np.sin(t), np.cos(t), 0.0])),),
        "function of the state": (F.Torque(speed_limit, arguments={"drag": 0.1}),),
        "double bracket": (F.DoubleBracketDamping(0.1),),
        "heat bath": (F.HeatBath(0.1, temperature=0.5, seed=7),),
    }
    body, x0 = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5)), np.array([0.3, 1.0, 0.2])
    print(f"{'forces':24s}members  us/step  tangent  {DIRECTIONS} tangents  gradient")
    for name, own in forces.items():
        ready = co.prepare(body.with_forces(*own) if own else body, co.Splitting(), 0.01, attitude=True, threads=1)
        for members in (1, 256):
            count = max(50, steps // (10 * members))
            start = x0 if members == 1 else np.outer(np.linspace(0.5, 1.5, members), x0)
            span = (0.0, 0.01 * count)

            def run(ready=ready, start=start, span=span, count=count):
                ready.run(start, span, save_every=count)

            def tangents(directions, ready=ready, start=start, span=span, count=count):
                ready.jvp(start, span, {"x0": np.ones((*start.shape, directions))}, save_every=count)

            def gradient(ready=ready, start=start, span=span, count=count):
                sol, pullback = ready.vjp(start, span, save_every=count)
                pullback(x=np.ones(sol.x.shape), attitude=np.ones(sol.attitude.shape))

            times = best(rounds, run, partial(tangents, 1), partial(tangents, DIRECTIONS), gradient)
            row = f"{name:24s}{members:7d}{1e6 * times[0] / (count * members):9.2f}"
            ratios = zip(times[1:], (9, 12, 10), strict=True)
            print(row + "".join(f"{one / times[0]:{width}.1f}" for one, width in ratios), flush=True)


def of_lattice(side: int, threads: list[int], rounds: int) -> None:
    """Print times of runs, tangents along one direction and gradients of lattices of equal and of unequal couplings."""
    rng = np.random.default_rng(1)
    x0 = rng.standard_normal((side * side, 3))
    x0 = (x0 / np.linalg.norm(x0, axis=1)[:, None]).ravel()
    unequal = rng.uniform(0.5, 1.5, 2 * side * (side - 1))
    lattices = {
        "equal": co.systems.spin_lattice("square", (side, side), periodic=True, field=(0, 0, 0.5)),
        "unequal": co.systems.spin_lattice("square", (side, side), exchange=unequal, field=(0, 0, 0.5)),
    }
    print(f"{side} x {side} spins\n{'couplings':11s}{'scheme':28s}threads  ms/step: run  tangent  gradient")
    for (name, system), (method, h, steps) in [
        (lattice, scheme)
        for lattice in lattices.items()
        for scheme in ((co.Splitting(order=2), 0.02, 64), (co.GaussLegendre(2), 0.05, 16))
    ]:
        span, calls = (0.0, h * steps), []
        for number in threads:
            ready = co.prepare(system, method, h, threads=number, watch=False)

            def run(ready=ready, span=span, steps=steps):
                ready.run(x0, span, save_every=steps)

            def tangent(ready=ready, span=span, steps=steps):
                ready.jvp(x0, span, {"x0": np.ones(x0.shape)}, save_every=steps)

            def gradient(ready=ready, span=span, steps=steps):
                sol, pullback = ready.vjp(x0, span, save_every=steps)
                pullback(x=np.ones(sol.x.shape))

            calls += [run, tangent, gradient]
        times = iter(best(rounds, *calls))
        for number in threads:
            row = "".join(f"{1e3 * next(times) / steps:9.2f}" for _ in range(3))
            print(f"{name:11s}{method!s:28s}{number:7d}      {row}", flush=True)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--forces", action="store_true", help="runs with forces and attitudes")
    parser.add_argument("--lattice", type=int, metavar="SIDE", help="spins on a side of a square lattice")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="with --lattice")
    given = parser.parse_args()
    if given.lattice:
        of_lattice(given.lattice, given.threads, given.rounds)
        return
    if given.forces:
        of_forces(given.steps, given.rounds)
        return
    print(f"{'system':16s}{'scheme':30s}{'ns/step':>9s}  gradient  {DIRECTIONS} tangents  step (us)  tangent of it")
    for name, (system, x0, methods, attitude) in cases().items():
        for method in methods:
            steps = max(50, int(given.steps * 9 / x0.size**1.3))
            ready = co.prepare(system, method, 0.01, attitude=attitude, threads=1)
            span = (0.0, 0.01 * steps)
            directions = {"x0": np.ones((*x0.shape, DIRECTIONS))}

            def run(ready=ready, x0=x0, span=span, steps=steps):
                ready.run(x0, span, save_every=steps)

            def gradient(ready=ready, x0=x0, span=span, steps=steps):
                sol, pullback = ready.vjp(x0, span, save_every=steps)
                pullback(x=np.ones(sol.x.shape), attitude=None if sol.attitude is None else np.ones(sol.attitude.shape))

            def tangents(ready=ready, x0=x0, span=span, steps=steps, directions=directions):
                ready.jvp(x0, span, directions, save_every=steps)

            plain, by_gradient, by_tangents = best(given.rounds, run, gradient, tangents)
            row = f"{name:16s}{method!s:30s}{1e9 * plain / steps / max(1, x0.size // system.dim):9.0f}"
            row += f"{by_gradient / plain:10.1f}{by_tangents / plain:12.1f}"
            if x0.ndim == 1 and not attitude:
                step = co.stepper(system, method, 0.01)

                def calls(step=step, x0=x0):
                    for _ in range(100):
                        step(x0)

                def derivatives(step=step, x0=x0):
                    for _ in range(100):
                        step.tangent(x0)

                one, of_one = best(given.rounds, calls, derivatives)
                row += f"{1e4 * one:11.1f}{of_one / one:15.1f}"
            print(row, flush=True)


if __name__ == "__main__":
    main()
