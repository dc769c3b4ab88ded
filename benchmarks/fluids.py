"""Milliseconds a step of the isospectral midpoint rule on the quantized sphere, beside quflow's where that is at hand.

python benchmarks/fluids.py [--sizes N ...] [--steps S] [--rounds R] [--threads T] [--quflow FOLDER]

FOLDER holds the package `quflow` (https://github.com/klasmodin/quflow), which also needs h5py, appdirs and ducc0. Both
take the same steps, of the length that quflow recommends, in turns; errors are against steps of a sixteenth of it.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

ROTATION = 0.1 * 3.141592653589793  # of the fastest mode in a step: what quflow's `estimate_stepsize` recommends
REFINED = 16


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256, 512])
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--quflow", help="the folder that holds the package quflow")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


GIVEN = arguments()
for pool in ("OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[pool] = str(GIVEN.threads)

import numpy as np  # noqa: E402, after the number of threads is set

import coadjoint as co  # noqa: E402


def start(system: Any, seed: int) -> np.ndarray:
    """Return a smooth random vorticity of spectral radius one."""
    rng, n = np.random.default_rng(seed), system.algebra.N
    noise = system.algebra.projected(rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n)))
    W = system.stream(noise)
    return W / np.abs(system.spectrum(W)).max()


def product(n: int) -> float:
    """Return the seconds of a product of two matrices."""
    A = np.full((n, n), 1.0 + 1j)
    return min(timed(lambda: A @ A)[1] for _ in range(20))


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    begun = time.perf_counter()
    found = call()
    return found, time.perf_counter() - begun


def contenders(system: Any, step: float, steps: int) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    """Return the solvers by name: from W to W at the end."""
    ready = co.prepare(system, co.IsospectralGauss(stages=1), step, watch=False, threads=1)
    found: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "coadjoint": lambda W: ready.run(W, (0.0, steps * step), save_every=steps).x[-1]
    }
    if GIVEN.quflow:
        sys.path.insert(0, GIVEN.quflow)
        from quflow.geometry import hbar
        from quflow.integrators.isospectral import isomp_fixedpoint

        seconds = step * hbar(system.algebra.N)
        found["quflow"] = lambda W: isomp_fixedpoint(W.copy(), seconds, steps=steps)
        found["quflow, to round-off"] = lambda W: isomp_fixedpoint(W.copy(), seconds, steps=steps, compsum=True)
    return found


def main() -> None:
    """Print a table of Markdown."""
    print("| N | solver | ms a step (median) | coadjoint's share of it | in products of matrices | error at the end |")
    print("|---|---|---|---|---|---|")
    times = []
    for n in GIVEN.sizes:
        system = co.systems.sphere_euler(N=n)
        W = start(system, GIVEN.seed)
        step = ROTATION / np.abs(system.spectrum(system.stream(W))).max()
        solvers = contenders(system, step, GIVEN.steps)
        fine = co.IsospectralGauss(stages=1)
        span, length = (0.0, GIVEN.steps * step), step / REFINED
        exact = co.integrate(system, W, t_span=span, step=length, method=fine, save_every=GIVEN.steps * REFINED).x[-1]
        taken: dict[str, list[float]] = {name: [] for name in solvers}
        ends = {name: solve(W) for name, solve in solvers.items()}
        for _ in range(GIVEN.rounds):
            for name, solve in solvers.items():
                taken[name].append(timed(partial(solve, W))[1] / GIVEN.steps)
        whole = product(n)
        for name, seconds in taken.items():
            share = statistics.median(a / b for a, b in zip(taken["coadjoint"], seconds, strict=True))
            away = np.abs(ends[name] - exact).max() / np.abs(exact).max()
            middle = statistics.median(seconds)
            print(
                f"| {n} | {name} | {1e3 * middle:.3g} | {share:.2f} | {middle / whole:.1f} | {away:.1e} |", flush=True
            )
        times.append(statistics.median(taken["coadjoint"]))
    if len(times) > 1:
        exponent = np.polyfit(np.log(GIVEN.sizes), np.log(times), 1)[0]
        print(f"\nThe time of a step grows as N^{exponent:.2f}; {GIVEN.threads} BLAS thread(s).")


if __name__ == "__main__":
    main()
