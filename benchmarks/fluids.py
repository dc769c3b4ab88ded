"""Milliseconds a step of the isospectral midpoint rule on the quantized sphere, beside quflow's where that is at hand.

python benchmarks/fluids.py [--sizes N ...] [--steps S] [--rounds R] [--threads T] [--refined K] [--quflow FOLDER]
                            [--xla]

FOLDER holds the package `quflow` (https://github.com/klasmodin/quflow), which also needs h5py, appdirs and ducc0. Both
take the same steps, of the length that quflow recommends, in turns, with T threads: of the run, or of quflow's BLAS.
Errors are against steps of a sixteenth of it, or with K = 0 against the compiled run. Each time is the shortest of the
rounds, and of the processor for one thread, so that other programs change it little. Runs of small matrices are timed
over more steps. The products that a step takes are counted: those of the states' precision, with the inverse as one and
the skew-Hermitian one as its blocks, and those of the lower precision.

With --xla the steps are also taken by JAX, on its default device; for a graphics processor install its wheels of JAX,
such as `pip install "coadjoint[jax]" "jax[cuda12]"`, and run

python benchmarks/fluids.py --xla --sizes 512 1024 2048 4096 --steps 20 --rounds 3 --threads 16 --refined 0
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from functools import cache, partial
from typing import Any

ROTATION = 0.1 * 3.141592653589793  # of the fastest mode in a step: what quflow's `estimate_stepsize` recommends
MANY = 2 * 10**8  # over N^3: timed steps
ENOUGH = 2.0  # seconds of a timed run, which takes fewer steps then


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 128, 256, 512])
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--refined", type=int, default=16, help="steps of the reference in a step; 0: no reference")
    parser.add_argument("--xla", action="store_true", help="also by JAX, on its default device")
    parser.add_argument("--quflow", help="the folder that holds the package quflow")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


GIVEN = arguments()
for pool in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[pool] = str(GIVEN.threads)
os.environ["NUMBA_NUM_THREADS"] = (
    "1"  # two of quflow's loops contend with the BLAS: 81 ms a step instead of 1.9, N = 64
)
if GIVEN.threads == 1:
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

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
    A, calls = np.full((n, n), 1.0 + 1j), max(1, 10**6 // n**3)
    return min(timed(lambda: [A @ A for _ in range(calls)])[1] for _ in range(20)) / calls


@cache
def device() -> str:
    """Return the kind of device on which JAX computes; empty without it."""
    if not GIVEN.xla:
        return ""
    import jax

    jax.config.update("jax_enable_x64", True)
    return str(jax.default_backend())


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    clock = time.process_time if GIVEN.threads == 1 and device() in ("", "cpu") else time.perf_counter
    begun = clock()
    found = call()
    return found, clock() - begun


def contenders(system: Any, step: float) -> dict[str, Callable[[np.ndarray, int], np.ndarray]]:
    """Return the solvers by name: from W to W after a number of steps."""
    ready = co.prepare(system, co.IsospectralGauss(stages=1), step, watch=False, threads=GIVEN.threads)
    found: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
        "coadjoint": lambda W, steps: ready.run(W, (0.0, steps * step), save_every=steps).x[-1]
    }
    if GIVEN.xla:

        @cache
        def run_of(steps: int) -> Callable[[np.ndarray], Any]:
            return co.jax.solution(ready, (0.0, steps * step), steps, backend="xla")

        found[f"coadjoint, XLA on {device()}"] = lambda W, steps: np.asarray(run_of(steps)(W)[-1])
    if GIVEN.quflow:
        sys.path.insert(0, GIVEN.quflow)
        from quflow.geometry import hbar
        from quflow.integrators.isospectral import isomp_fixedpoint

        seconds = step * hbar(system.algebra.N)
        found["quflow"] = lambda W, steps: isomp_fixedpoint(W.copy(), seconds, steps=steps)
        found["quflow, to round-off"] = lambda W, steps: isomp_fixedpoint(W.copy(), seconds, steps=steps, compsum=True)
    return found


def products_of_a_step(system: Any, W: np.ndarray, step: float, steps: int) -> tuple[float, float]:
    """Return the products of a step in the precision of the states, and those in the lower one, on average."""
    stats = co.integrate(system, W, (0.0, steps * step), step, co.IsospectralGauss(stages=1), save_every=steps).stats
    return stats.matrix_products / steps, stats.lower_products / steps


def main() -> None:
    """Print a table of Markdown."""
    counts = []
    print("| N | solver | ms a step | coadjoint's share of it | in products of matrices | error at the end |")
    print("|---|---|---|---|---|---|")
    times = []
    for n in GIVEN.sizes:
        system = co.systems.sphere_euler(N=n)
        W = start(system, GIVEN.seed)
        step = ROTATION / np.abs(system.spectrum(system.stream(W))).max()
        solvers = contenders(system, step)
        taken: dict[str, list[float]] = {name: [] for name in solvers}
        ends = {name: solve(W, GIVEN.steps) for name, solve in solvers.items()}
        exact, span, fine = ends["coadjoint"], (0.0, GIVEN.steps * step), co.IsospectralGauss(stages=1)
        if k := GIVEN.refined:
            exact = co.integrate(system, W, span, step / k, fine, save_every=GIVEN.steps * k).x[-1]
        steps, few = max(GIVEN.steps, MANY // n**3), 5
        firsts = {name: timed(partial(solve, W, few))[1] / few for name, solve in solvers.items()}
        enough = {name: min(steps, max(GIVEN.steps, int(ENOUGH / first))) for name, first in firsts.items()}
        for _ in range(GIVEN.rounds):
            for name, solve in solvers.items():
                taken[name].append(timed(partial(solve, W, enough[name]))[1] / enough[name])
        whole, shortest = product(n), {name: min(seconds) for name, seconds in taken.items()}
        for name, least in shortest.items():
            share, away = shortest["coadjoint"] / least, np.abs(ends[name] - exact).max() / np.abs(exact).max()
            print(f"| {n} | {name} | {1e3 * least:.3g} | {share:.2f} | {least / whole:.1f} | {away:.1e} |", flush=True)
        times.append(shortest["coadjoint"])
        counts.append((n, *products_of_a_step(system, W, step, steps)))
    print("\n| N | products a step | in the lower precision |\n|---|---|---|")
    for n, whole, low in counts:
        print(f"| {n} | {whole:.2f} | {low:.2f} |")
    if len(times) > 1:
        exponent = np.polyfit(np.log(GIVEN.sizes), np.log(times), 1)[0]
        print(f"\nThe time of a step grows as N^{exponent:.2f}; {GIVEN.threads} thread(s).")


if __name__ == "__main__":
    main()
