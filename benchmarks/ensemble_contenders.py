"""The same step of many rigid bodies in C, NumPy, JAX and coadjoint, and heyoka's adaptive Taylor series in batches.

Each contender takes the initial states (members, 3) and a number of steps, and returns the CPU seconds, the elapsed
seconds and the states at the end. x' = (M x) cross x, parts 1 2 3, outer flows of consecutive steps merged.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from c_programs import HERE, build

import coadjoint as co

M = (1.0, 0.5, 0.25)
H = 0.1
HEYOKA_BATCH = 16  # of 4, 8, 16, 32 the fastest, or within 5 % of it

Result = tuple[float, float, np.ndarray]
Contender = Callable[[np.ndarray, int], Result]

VECTOR_FLAGS = ("-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")


def timed(end: Callable[[], np.ndarray]) -> Result:
    cpu, wall = time.process_time(), time.perf_counter()
    found = end()
    return time.process_time() - cpu, time.perf_counter() - wall, found


def in_c(x0: np.ndarray, steps: int, libmvec: bool) -> Result:
    """Run c/ensemble.c; it is built on the first call."""
    program = c_program(libmvec)
    start, end = HERE / "build" / "ensemble-start", HERE / "build" / "ensemble-end"
    np.ascontiguousarray(x0.T).tofile(start)
    arguments = [steps, H, *M, len(x0), start, end]
    done = subprocess.run([program, *map(str, arguments)], check=True, capture_output=True, text=True)
    seconds = 1e-9 * float(done.stdout) * steps * len(x0)
    return seconds, seconds, np.fromfile(end).reshape(3, -1).T


@cache
def c_program(libmvec: bool) -> str:
    if libmvec:
        return str(build("ensemble", *VECTOR_FLAGS, "-DLIBMVEC", "-lmvec", target="ensemble_libmvec"))
    return str(build("ensemble", *VECTOR_FLAGS))


def by_numpy(x0: np.ndarray, steps: int) -> Result:
    """What a person writes: one array for each coordinate."""

    def rotate(angle: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s, c = np.sin(angle), np.cos(angle)
        return c * a - s * b, s * a + c * b

    def end() -> np.ndarray:
        a, b, c = x0.T.copy()
        b, c = rotate(0.5 * H * M[0] * a, b, c)
        for k in range(steps):
            c, a = rotate(0.5 * H * M[1] * b, c, a)
            a, b = rotate(H * M[2] * c, a, b)
            c, a = rotate(0.5 * H * M[1] * b, c, a)
            b, c = rotate((H if k < steps - 1 else 0.5 * H) * M[0] * a, b, c)
        return np.stack([a, b, c], axis=1)

    return timed(end)


@cache
def jax_program() -> Any:
    """Compile the step of one body, mapped over the members by vmap, the loop inside."""
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)

    def rotate(angle: Any, a: Any, b: Any) -> tuple[Any, Any]:
        s, c = jnp.sin(angle), jnp.cos(angle)
        return c * a - s * b, s * a + c * b

    def one(a: Any, b: Any, c: Any, steps: Any) -> tuple[Any, Any, Any]:
        def step(_: Any, x: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
            a, b, c = x
            c, a = rotate(0.5 * H * M[1] * b, c, a)
            a, b = rotate(H * M[2] * c, a, b)
            c, a = rotate(0.5 * H * M[1] * b, c, a)
            b, c = rotate(H * M[0] * a, b, c)
            return a, b, c

        b, c = rotate(0.5 * H * M[0] * a, b, c)
        a, b, c = jax.lax.fori_loop(0, steps, step, (a, b, c))
        return a, *rotate(-0.5 * H * M[0] * a, b, c)

    return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, None)))


def by_jax(x0: np.ndarray, steps: int) -> Result:
    program = jax_program()
    coordinates = tuple(x0.T.copy())
    program(*coordinates, 1)  # compiled for this number of members

    def end() -> np.ndarray:
        return np.stack([np.asarray(values) for values in program(*coordinates, steps)], axis=1)

    return timed(end)


@cache
def taylor_batch(tolerance: float) -> Any:
    import heyoka as hy

    x, y, z = hy.make_vars("x", "y", "z")
    equations = [(x, (M[1] - M[2]) * y * z), (y, (M[2] - M[0]) * z * x), (z, (M[0] - M[1]) * x * y)]
    return hy.taylor_adaptive_batch(equations, np.ones((3, HEYOKA_BATCH)), tol=tolerance)


def by_heyoka(x0: np.ndarray, steps: int, tolerance: float) -> Result:
    """Integrate over the span of the steps with its own; batches of members in turn."""
    taylor = taylor_batch(tolerance)

    def end() -> np.ndarray:
        found = np.empty_like(x0)
        for first in range(0, len(x0), HEYOKA_BATCH):
            taylor.set_time(0.0)
            taylor.state[:] = x0[first : first + HEYOKA_BATCH].T
            taylor.propagate_until(steps * H)
            found[first : first + HEYOKA_BATCH] = taylor.state.T
        return found

    return timed(end)


def by_coadjoint(x0: np.ndarray, steps: int, threads: int, parts: str) -> Result:
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(list(M)), name="rigid body")
    method = co.Splitting(order=2, parts=parts)

    def end() -> np.ndarray:
        span = (0.0, steps * H)
        done = co.integrate(system, x0, span, H, method, save_every=steps, watch=False, threads=threads)
        return done.x[-1]

    return timed(end)


def splittings() -> dict[str, tuple[Contender, str]]:
    """Return those that take the same steps, each with the package without which it cannot run ("" for none)."""
    return {
        "coadjoint": (partial(by_coadjoint, threads=1, parts="coordinates"), ""),
        "coadjoint, 2 threads": (partial(by_coadjoint, threads=2, parts="coordinates"), ""),
        "C, own sine": (partial(in_c, libmvec=False), ""),
        "C, libmvec": (partial(in_c, libmvec=True), ""),
        "JAX, vmap": (by_jax, "jax"),
        "NumPy": (by_numpy, ""),
    }


def others(as_accurate: float) -> dict[str, tuple[Contender, str]]:
    """Return those that reach the same time by other steps; `as_accurate`: the tolerance for heyoka."""
    return {
        "coadjoint, default parts": (partial(by_coadjoint, threads=1, parts="auto"), ""),
        f"heyoka, batches of {HEYOKA_BATCH}, tolerance {as_accurate:g}": (
            partial(by_heyoka, tolerance=as_accurate),
            "heyoka",
        ),
        f"heyoka, batches of {HEYOKA_BATCH}, to round-off": (partial(by_heyoka, tolerance=2.0**-52), "heyoka"),
    }
