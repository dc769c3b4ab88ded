"""What do derivatives of runs cost? Gradients, tangents and steps, beside the same run or step without them.

    python benchmarks/derivatives.py [--steps N] [--rounds N]
    python benchmarks/derivatives.py --forces [NAME ...] [--steps N] [--rounds N]
    python benchmarks/derivatives.py --matrices [--steps N] [--rounds N]
    python benchmarks/derivatives.py --batches [--steps N] [--rounds N]
    python benchmarks/derivatives.py --lattice 200 [--threads 1 2] [--rounds N]

Each is run in turns with the plain run, and the best of the rounds is taken. A gradient is that of a sum over the end,
by the initial state and all parameters; its time contains the run. With --forces, runs with each registered force, or
those named, by processor time. With --matrices, runs of fluids and a body as matrices, without and with forces, by
processor time. With --batches, 32 unlike bodies with forces beside an ensemble of one of them, by processor time. With
--lattice, those of one square lattice of spins in turns on each number of threads.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import product
from time import process_time

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


def friction(x, t, tau):
    """Return the flow of a force of one's own."""
    return x / (1.0 + 0.1 * tau * x * x)


def systems_with_forces() -> Iterator[tuple[str, str, object, np.ndarray, bool]]:
    """Yield each registered force on a body without and with its attitude, on a satellite with wheels and gyros, and on
    a chain of 16 spins, where it acts: the names, the system, a state, and whether with the attitude.
    """
    own = {"Torque": {"torque": speed_limit, "arguments": {"drag": 0.1}}, "OwnForce": {"function": friction}}
    spins = np.random.default_rng(1).standard_normal((16, 3))
    gyros = np.eye(3)[[(0, 1), (1, 2), (2, 0)]]
    bases = {
        "body": co.systems.rigid_body((1.0, 2.0, 2.5)),
        "satellite": co.systems.body((1.0, 2.0, 2.5), wheels=0.1 * np.eye(3), gyros=gyros),
        "spins": co.systems.spin_lattice("chain", 16),
    }
    for name in co.forces.names():
        kind = getattr(co.forces, name)
        for label, base in bases.items():
            with suppress(TypeError, ValueError):  # forces that do not act on it
                system = base.with_forces(kind(**own.get(name, kind.example)))
                if label == "satellite" and name not in own:
                    yield name, label, system, system.state(angular_velocity=(0.2, -0.1, 0.3)), False
                elif label == "spins":
                    yield name, label, system, (spins / np.linalg.norm(spins, axis=1)[:, None]).ravel(), False
                elif label == "body":
                    yield name, label, system, np.array([0.3, 1.0, 0.2]), False
                    yield name, "body, attitude", system, np.array([0.3, 1.0, 0.2]), True


def of_forces(steps: int, rounds: int, wanted: list[str]) -> None:
    """Print processor times of derivatives of runs with each force in those of the runs, and, for 256 members, the time
    of a gradient for each member in that of one.
    """
    print(f"{'force':22s}{'system':16s}us/step  tangent  {DIRECTIONS} tangents  gradient  member of 256 : one")
    for name, label, system, x0, attitude in systems_with_forces():
        if wanted and name not in wanted:
            continue
        ready = co.prepare(system, co.Splitting(), 2.0**-6, attitude=attitude, threads=1)

        def run(start, count, ready=ready):
            ready.run(start, (0.0, count * 2.0**-6), save_every=count)

        def tangents(start, count, directions, ready=ready):
            along = {"x0": np.ones((*start.shape, directions))}
            ready.jvp(start, (0.0, count * 2.0**-6), along, save_every=count)

        def gradient(start, count, ready=ready):
            sol, pullback = ready.vjp(start, (0.0, count * 2.0**-6), save_every=count)
            pullback(x=np.ones(sol.x.shape), attitude=None if sol.attitude is None else np.ones(sol.attitude.shape))

        gradient(x0, 8)
        (few,) = best(1, partial(gradient, x0, 16), clock=process_time)
        count = int(min(steps, max(8, 16 * 0.1 / few)))
        many, fewer = np.tile(x0, (256, 1)), max(8, count // 64)
        calls = [partial(run, x0, count), partial(tangents, x0, count, 1), partial(tangents, x0, count, DIRECTIONS)]
        plain, one, several, by_gradient = best(rounds, *calls, partial(gradient, x0, count), clock=process_time)
        (together,) = (
            best(min(rounds, 2), partial(gradient, many, fewer), clock=process_time) if few < 0.1 else (np.nan,)
        )
        ratio = together / (256 * fewer) / (by_gradient / count)
        row = f"{name:22s}{label:16s}{1e6 * plain / count:7.2f}{one / plain:9.1f}{several / plain:12.1f}"
        print(row + f"{by_gradient / plain:10.1f}{ratio:15.2f}", flush=True)


def of_matrices(steps: int, rounds: int) -> None:
    """Print processor times of runs of matrices, and of derivatives in these: along one direction, and gradients."""
    from coadjoint import forces as F
    from coadjoint import systems as S

    sphere, shallow = S.sphere_euler(N=32), S.sphere_qg(N=32, lamb=2.0, gamma=0.5, rotation=0.5)
    one, two, three = (co.IsospectralGauss(s) for s in (1, 2, 3))
    rows = {
        "sphere, N = 16": (S.sphere_euler(N=16), one),
        "sphere, N = 32": (sphere, one),
        "sphere, N = 64": (S.sphere_euler(N=64), one),
        "sphere, N = 32, two stages": (sphere, two),
        "sphere, N = 32, three stages": (sphere, three),
        "shallow fluid, N = 32": (shallow, one),
        "magnetic field, N = 32": (S.reduced_mhd(N=32), one),
        "body, N = 16": (S.matrix_body(tuple(np.linspace(1.0, 3.0, 16).tolist())), one),
        "Friction, N = 32": (sphere.with_forces(F.Friction(0.1)), one),
        "Viscosity, N = 32": (sphere.with_forces(F.Viscosity(0.01)), one),
        "SelectiveDecay, N = 32": (sphere.with_forces(F.SelectiveDecay(0.1)), one),
        **{
            f"{type(force).__name__}, N = {N}": (S.sphere_euler(N=N).with_forces(force), one)
            for force in (F.DoubleBracketDamping(0.1), F.HeatBath(0.1, temperature=0.01, seed=3))
            for N in (8, 16, 32)
        },
        "DoubleBracketDamping, shallow": (
            S.sphere_qg(N=16, lamb=2.0, gamma=0.5, rotation=0.5).with_forces(F.DoubleBracketDamping(0.1)),
            one,
        ),
        "DoubleBracketDamping, magnetic": (S.reduced_mhd(N=16).with_forces(F.DoubleBracketDamping(0.1)), one),
    }
    for base, N in product((S.sphere_euler, S.reduced_mhd), (16, 32)):
        system, rng = base(N=N), np.random.default_rng(2)
        entries = rng.standard_normal((2, N, N)) + 1j * rng.standard_normal((2, N, N))
        matrices = tuple(0.2 * system.algebra.projected(entries) / np.sqrt(N))
        for noise in (F.HamiltonianNoise(matrices, (0.5, 0.4), seed=5), F.TransportNoise((2, 3), 0.3, seed=7)):
            rows[f"{type(noise).__name__}, {base.__name__}, N = {N}"] = (system.with_forces(noise), one)
    print(f"{'matrices':44s} us/step  tangent  gradient")
    for name, (system, method) in rows.items():
        entries = np.random.default_rng(1).standard_normal((2, *system.shape))
        x0 = system.unforced.algebra.projected(entries[0] + (1j * entries[1] if system.complex else 0.0))
        x0 /= np.linalg.norm(x0[0] if x0.ndim == 3 else x0, 2)
        ready, span = co.prepare(system, method, 0.05, threads=1), (0.0, 0.05 * steps)

        def run(ready=ready, x0=x0, span=span):
            ready.run(x0, span, save_every=steps)

        def tangent(ready=ready, x0=x0, span=span):
            ready.jvp(x0, span, {"x0": x0}, save_every=steps)

        def gradient(ready=ready, x0=x0, span=span):
            _, pullback = ready.vjp(x0, span, save_every=steps)
            pullback(x=np.array([np.zeros_like(x0), x0]))

        gradient()
        plain, one_tangent, by_gradient = best(rounds, run, tangent, gradient, clock=process_time)
        print(f"{name:44s}{1e6 * plain / steps:8.1f}{one_tangent / plain:9.1f}{by_gradient / plain:10.1f}", flush=True)


def of_batches(steps: int, rounds: int) -> None:
    """Print processor times of tangents and gradients of ensembles, and those of unlike members relative to them."""
    F, rng, factors = co.forces, np.random.default_rng(1), np.linspace(1.0, 1.1, 32)
    forces = {
        "LinearDamping": lambda f: F.LinearDamping(0.1 * f),
        "Torque": lambda f: F.Torque(lambda x, gain: -gain * x * (x @ x), arguments={"gain": 0.1 * f}),
        "DoubleBracketDamping": lambda f: F.DoubleBracketDamping(0.1 * f),
        "HeatBath": lambda f: F.HeatBath(0.1 * f, temperature=0.1, seed=3),
    }
    x0, span = rng.uniform(0.2, 0.9, (32, 3)), (0.0, 0.05 * steps)
    print(f"{'32 bodies':22s} moments of inertia  ms: tangent  gradient  of unlike ones: tangent  gradient")
    for (name, force), spread in product(forces.items(), (0.1, 1.0)):
        acting = [force(f) for f in factors]
        moments = [(1.0, 2.0 + 0.2 * spread * (f - 0.9), 2.5) for f in factors]
        bodies = [co.systems.rigid_body(one).with_forces(own) for one, own in zip(moments, acting, strict=True)]
        calls = []
        for system in (bodies[0], co.batch(bodies)):
            ready = co.prepare(system, co.Splitting(), 0.05, threads=1)

            def tangent(ready=ready):
                ready.jvp(x0, span, {"x0": x0}, save_every=steps)

            def gradient(ready=ready):
                sol, pullback = ready.vjp(x0, span, save_every=steps)
                pullback(x=sol.x)

            gradient()
            tangent()
            calls += [tangent, gradient]
        by_one, of_one, by_each, of_each = best(rounds, *calls, clock=process_time)
        row = f"{name:22s} {f'2 to {moments[-1][1]:.4g}':20s}{1e3 * by_one:10.2f}{1e3 * of_one:10.2f}"
        print(f"{row}{by_each / by_one:27.2f}{of_each / of_one:10.2f}", flush=True)


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
    parser.add_argument("--forces", nargs="*", metavar="NAME", help="runs with each force, or those named")
    parser.add_argument("--matrices", action="store_true", help="runs of matrices")
    parser.add_argument("--batches", action="store_true", help="unlike members with forces")
    parser.add_argument("--lattice", type=int, metavar="SIDE", help="spins on a side of a square lattice")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="with --lattice")
    given = parser.parse_args()
    if given.lattice:
        of_lattice(given.lattice, given.threads, given.rounds)
        return
    if given.matrices:
        of_matrices(min(given.steps, 200), given.rounds)
        return
    if given.batches:
        of_batches(min(given.steps, 1000), given.rounds)
        return
    if given.forces is not None:
        of_forces(min(given.steps, 5000), given.rounds, given.forces)
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
