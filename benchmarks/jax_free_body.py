"""`co.jax.free_body` beside the usual integrators of rigid bodies in JAX: errors after 100 turns, and time of a step.

The others are plain formulas. MuJoCo XLA's `implicitfast`, which leaves out the derivative of the gyroscopic term, and
Brax are semi-implicit Euler for a free body; one Newton iteration for an implicit term is that of game engines.

python benchmarks/jax_free_body.py [--bodies N] [--steps N] [--rounds R]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import coadjoint as co

INERTIA, START = (1.0, 1.5, 2.5), (0.6, 1.4, 0.5)
TURNS, STEPS_PER_TURN = 100, (60, 10)


def after(q: Any, p: Any) -> Any:
    """Return the product of quaternions."""
    (a, b, c, d), (e, f, g, h) = q, p
    return jnp.array(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g + c * e + d * f - b * h,
            a * h + d * e + b * g - c * f,
        ]
    )


def rotated(q: Any, w: Any, h: Any) -> Any:
    """Return the attitude after a rotation with an angular velocity in the frame of the body."""
    angle = jnp.sqrt((w * w).sum()) * h
    q = after(q, jnp.append(jnp.cos(angle / 2), w * (h / 2) * jnp.sinc(angle / (2 * np.pi))))
    return q / jnp.sqrt((q * q).sum())


def semi_implicit(w: Any, q: Any, inertia: Any, h: Any) -> tuple[Any, Any]:
    """Semi-implicit Euler with an explicit gyroscopic term."""
    w = w - h * jnp.cross(w, inertia * w) / inertia
    return w, rotated(q, w, h)


def implicit(w: Any, q: Any, inertia: Any, h: Any) -> tuple[Any, Any]:
    """The same with one Newton iteration for an implicit gyroscopic term."""
    hat = lambda v: jnp.cross(jnp.eye(3, dtype=v.dtype), v)  # noqa: E731
    jacobian = jnp.diag(inertia) + h * (hat(w) * inertia - hat(inertia * w))
    w = w - jnp.linalg.solve(jacobian, h * jnp.cross(w, inertia * w))
    return w, rotated(q, w, h)


def runge_kutta(w: Any, q: Any, inertia: Any, h: Any) -> tuple[Any, Any]:
    """The classical method of order four, with a normalized quaternion."""

    def field(w: Any, q: Any) -> tuple[Any, Any]:
        return -jnp.cross(w, inertia * w) / inertia, 0.5 * after(q, jnp.append(0.0, w))

    def moved(c: Any, k: Any) -> tuple[Any, Any]:
        return w + c * k[0], q + c * k[1]

    k1 = field(w, q)
    k2 = field(*moved(h / 2, k1))
    k3 = field(*moved(h / 2, k2))
    k4 = field(*moved(h, k3))
    w, q = (y + h / 6 * (a + 2 * b + 2 * c + d) for y, a, b, c, d in zip((w, q), k1, k2, k3, k4, strict=True))
    return w, q / jnp.sqrt((q * q).sum())


def exact(w: Any, A: Any, inertia: Any, h: Any) -> tuple[Any, Any]:
    """The step of the library."""
    x, A = co.jax.free_body(inertia * w, A, inertia, h)
    return x / inertia, A


METHODS: dict[str, Callable[..., Any]] = {
    "`co.jax.free_body`": exact,
    "semi-implicit Euler (MJX, Brax)": semi_implicit,
    "semi-implicit Euler, implicit gyroscopic term": implicit,
    "Runge-Kutta of order 4": runge_kutta,
}


def matrix(q: Any) -> Any:
    """Return the rotation of a quaternion, or a matrix as it is."""
    if q.ndim == 2:
        return q
    w, x, y, z = np.asarray(q, dtype=float)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * K + 2.0 * K @ K


def run_of(step: Callable[..., Any], steps: int) -> Callable[..., Any]:
    """Return a compiled function of many steps."""

    def run(w: Any, attitude: Any, inertia: Any, h: Any) -> Any:
        return jax.lax.scan(lambda state, _: (step(*state, inertia, h), None), (w, attitude), None, length=steps)[0]

    return jax.jit(run)


def errors_of(step: Callable[..., Any], kind: Any) -> str:
    """Return the errors of the momentum over its length, and of the attitude in radians."""
    inertia, w = np.array(INERTIA), np.array(START) / np.array(INERTIA)
    turn, texts = 2.0 * np.pi / np.linalg.norm(w), []
    body = co.systems.rigid_body(INERTIA)
    for count in STEPS_PER_TURN:
        h = float(np.float32(turn / count))
        attitude = np.eye(3) if step is exact else np.eye(4)[0]
        given = (jnp.asarray(one, kind) for one in (w, attitude, inertia, h))
        end, q = run_of(step, TURNS * count)(*given)
        x, A = body.exact(np.array(START), TURNS * count * h, attitude=True)
        of_momentum = np.linalg.norm(np.asarray(end, dtype=float) * inertia - x) / np.linalg.norm(x)
        sine = np.linalg.norm(A - matrix(np.asarray(q, dtype=float))) / np.sqrt(8.0)
        if not np.isfinite(of_momentum):
            texts.append("diverged")
            continue
        texts.append(f"{of_momentum:.1e}, {2.0 * np.arcsin(min(1.0, sine)):.1e} rad")
    return " | ".join(texts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bodies", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=7)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    many, rng = options.bodies, np.random.default_rng(1)
    turn = 2.0 * np.pi / np.linalg.norm(np.array(START) / np.array(INERTIA))
    for kind in (jnp.float32, jnp.float64):
        runs: dict[str, Any] = {}
        for name, step in METHODS.items():
            attitude = np.eye(3) if step is exact else np.eye(4)[0]
            states = [rng.standard_normal((many, 3)), np.tile(attitude, (many, *[1] * attitude.ndim))]
            given = [jnp.asarray(one, kind) for one in (*states, np.array(INERTIA), turn / STEPS_PER_TURN[0])]
            run = jax.jit(jax.vmap(run_of(step, options.steps), (0, 0, None, None))).lower(*given).compile()
            runs[name] = (run, given)
        best = dict.fromkeys(runs, np.inf)
        for _ in range(options.rounds):  # in turns; processor time, of all threads
            for name, (run, given) in runs.items():
                start = time.process_time()
                jax.block_until_ready(run(*given))
                best[name] = min(best[name], time.process_time() - start)
        first = best[next(iter(best))]
        heads = [f"errors after {TURNS} turns, {count} steps a turn: momentum, attitude" for count in STEPS_PER_TURN]
        print(f"| {kind.__name__}, {many} bodies | ns a step | ratio | {' | '.join(heads)} |")
        print("|---|---|---|---|---|")
        for name, seconds in best.items():
            nanoseconds = 1e9 * seconds / (options.steps * many)
            print(f"| {name} | {nanoseconds:.0f} | {seconds / first:.2f} | {errors_of(METHODS[name], kind)} |")
        print()


if __name__ == "__main__":
    main()
