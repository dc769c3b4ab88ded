"""What do tangent vectors cost? The time of a run that carries k of them, beside that of the run without them.

    python benchmarks/lyapunov.py [--steps N]

The two are run in alternation and the best of some rounds is taken; on a busy machine the ratios still wander by some
ten percent.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import coadjoint as co


def systems() -> dict[str, tuple[co.LiePoissonSystem, np.ndarray]]:
    """Return systems of dimension 3 to 28, by name, with a state."""
    rng = np.random.default_rng(5)
    eight = co.algebras.so(8)
    top = co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0, 0, 0, 0.75, 0.5, 1.0])
    return {
        "so(3), body": (co.systems.rigid_body(inertia=(1, 2, 3)), np.array([0.1, 1.0, 0.1])),
        "e(3), heavy top": (
            co.LiePoissonSystem(co.algebras.e(3), top, sign=-1),
            np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8]),
        ),
        "so(8), body": (
            co.LiePoissonSystem(eight, co.Quadratic(rng.uniform(0.5, 1.5, 28)), casimirs={}),
            rng.uniform(-0.2, 0.2, 28),
        ),
    }


def best(rounds: int, *runs: object, clock: object = time.perf_counter) -> list[float]:
    """Return the best time of each of some runs, which go in turns."""
    found = [np.inf] * len(runs)
    for _ in range(rounds):
        for place, run in enumerate(runs):
            began = clock()  # type: ignore[operator]
            run()  # type: ignore[operator]
            found[place] = min(found[place], clock() - began)  # type: ignore[operator]
    return found


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=20_000)
    steps = parser.parse_args().steps
    print(f"{'system':18s}{'scheme':30s}{'members':>8s}{'ns/step':>9s}  ratio for k = 1, n/2, n")
    for name, (system, x0) in systems().items():
        for method in (co.Splitting(order=2), co.Splitting(order=4), co.GaussLegendre(2), co.ExplicitRungeKutta("rk4")):
            for members in (1, 16):
                start = x0 if members == 1 else x0 * np.linspace(1.0, 1.1, members)[:, None]
                count = max(100, int(steps * 12 / system.dim**1.5 / members**0.5))
                span, n = (0.0, 0.01 * count), system.dim

                def plain(system=system, start=start, span=span, method=method, count=count):
                    co.integrate(system, start, span, 0.01, method, watch=False, save_every=count, threads=1)

                def carrying(k, system=system, start=start, span=span, method=method, count=count):
                    co.lyapunov(system, start, span, 0.01, method, exponents=k, save_every=count, threads=1)

                counts = (1, max(1, n // 2), n)
                alone, *with_vectors = best(5, plain, *(lambda k=k: carrying(k) for k in counts))
                ratios = "  ".join(f"{taken / alone:6.1f}" for taken in with_vectors)
                print(f"{name:18s}{method!s:30s}{members:8d}{1e9 * alone / count / members:9.0f}  {ratios}")


if __name__ == "__main__":
    main()
