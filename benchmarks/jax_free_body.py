"""`co.jax.free_body` beside the usual integrators of rigid bodies in JAX: errors after 100 turns, and time of a step.

Three others are plain formulas; one Newton iteration for an implicit term is that of game engines. If `mujoco-mjx` and
`brax` are installed, their own integrators follow: whole steps of a scene of one free body, without contacts.

python benchmarks/jax_free_body.py [--bodies N] [--steps N] [--rounds R] [--types float32 float64]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any, NamedTuple

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


FORMULAS: dict[str, Callable[..., Any]] = {
    "semi-implicit Euler": semi_implicit,
    "semi-implicit Euler, implicit gyroscopic term": implicit,
    "Runge-Kutta of order 4": runge_kutta,
}
SCENE = """
<mujoco>
  <option timestep="{h}" gravity="0 0 0" integrator="{integrator}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body>
      <freejoint/>
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia}"/>
      <geom size="0.1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>"""


class Integrator(NamedTuple):
    """A step of one body, the state of an angular velocity at rest orientation, and how a state is read."""

    begin: Callable[[Any], Any]
    step: Callable[[Any], Any]
    end: Callable[[Any], tuple[Any, Any]]


def of_formula(formula: Callable[..., Any], kind: Any, h: float) -> Integrator:
    """Return the integrator of a formula."""
    inertia, length, attitude = (jnp.asarray(one, kind) for one in (INERTIA, h, np.eye(4)[0]))
    return Integrator(lambda w: (w, attitude), lambda state: formula(*state, inertia, length), lambda state: state)


def exact(kind: Any, h: float) -> Integrator:
    """Return the step of the library."""
    inertia, length, attitude = (jnp.asarray(one, kind) for one in (INERTIA, h, np.eye(3)))
    return Integrator(
        lambda w: (inertia * w, attitude),
        lambda state: co.jax.free_body(*state, inertia, length),
        lambda state: (state[0] / inertia, state[1]),
    )


def scene(integrator: str, h: float) -> str:
    return SCENE.format(h=h, integrator=integrator, inertia=" ".join(map(str, INERTIA)))


def of_mjx(integrator: str, kind: Any, h: float) -> Integrator:
    """Return an integrator of MuJoCo XLA."""
    import mujoco
    from mujoco import mjx

    model = mjx.put_model(mujoco.MjModel.from_xml_string(scene(integrator, h)))
    data = mjx.make_data(model)
    return Integrator(
        lambda w: data.replace(qvel=jnp.concatenate([jnp.zeros(3, kind), w])),
        lambda state: mjx.step(model, state),
        lambda state: (state.qvel[3:], state.qpos[3:]),
    )


def of_brax(pipeline: str, kind: Any, h: float) -> Integrator:
    """Return a pipeline of Brax."""
    from importlib import import_module

    from brax.io import mjcf

    system, steps = mjcf.loads(scene("Euler", h)), import_module(f"brax.{pipeline}.pipeline")
    return Integrator(
        lambda w: steps.init(system, system.init_q, jnp.concatenate([jnp.zeros(3, kind), w])),
        lambda state: steps.step(system, state, jnp.zeros(0, kind)),
        lambda state: (state.qd[3:], state.q[3:]),
    )


def methods() -> dict[str, Callable[..., Integrator]]:
    """Return the integrators by name, as functions of the type of numbers and of the step."""
    found: dict[str, Callable[..., Integrator]] = {"`co.jax.free_body`": exact}
    found |= {name: partial(of_formula, one) for name, one in FORMULAS.items()}
    if find_spec("mujoco") is not None and find_spec("mujoco.mjx") is not None:
        found |= {f"MJX, `{name}`": partial(of_mjx, name) for name in ("Euler", "implicitfast", "RK4")}
    if find_spec("brax") is not None:
        found |= {f"Brax, `{name}`": partial(of_brax, name) for name in ("generalized", "spring", "positional")}
    return found


def matrix(q: Any) -> Any:
    """Return the rotation of a quaternion, or a matrix as it is."""
    if q.ndim == 2:
        return q
    w, x, y, z = np.asarray(q, dtype=float)
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + 2.0 * w * K + 2.0 * K @ K


def run_of(integrator: Integrator, steps: int) -> Callable[..., Any]:
    """Return the function of many steps from an angular velocity."""

    def run(w: Any) -> Any:
        state = integrator.begin(w)
        return integrator.end(jax.lax.scan(lambda one, _: (integrator.step(one), None), state, None, length=steps)[0])

    return run


def errors_of(method: Callable[..., Integrator], kind: Any) -> str:
    """Return the errors of the momentum over its length, and of the attitude in radians."""
    inertia, w = np.array(INERTIA), np.array(START) / np.array(INERTIA)
    turn, texts = 2.0 * np.pi / np.linalg.norm(w), []
    body = co.systems.rigid_body(INERTIA)
    for count in STEPS_PER_TURN:
        h = float(np.float32(turn / count))
        end, q = jax.jit(run_of(method(kind, h), TURNS * count))(jnp.asarray(w, kind))
        x, A = body.exact(np.array(START), TURNS * count * h, attitude=True)
        of_momentum = np.linalg.norm(np.asarray(end, dtype=float) * inertia - x) / np.linalg.norm(x)
        sine = np.linalg.norm(A - matrix(np.asarray(q, dtype=float))) / np.sqrt(8.0)
        if not np.isfinite(of_momentum):
            texts.append("diverged")
            continue
        texts.append(f"{of_momentum:.1e}, {2.0 * np.arcsin(min(1.0, sine)):.1e} rad")
    return "; ".join(texts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bodies", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--types", nargs="+", choices=("float32", "float64"), default=["float32", "float64"])
    options = parser.parse_args()
    many = options.bodies
    h = float(2.0 * np.pi / np.linalg.norm(np.array(START) / np.array(INERTIA))) / STEPS_PER_TURN[0]
    for kind in map(jnp.dtype, options.types):
        jax.config.update("jax_enable_x64", kind == jnp.float64)
        start = jnp.asarray(np.random.default_rng(1).standard_normal((many, 3)), kind)
        runs = {
            name: jax.jit(jax.vmap(run_of(method(kind, h), options.steps))).lower(start).compile()
            for name, method in methods().items()
        }
        best = dict.fromkeys(runs, np.inf)
        for _ in range(options.rounds):  # in turns; processor time, of all threads
            for name, run in runs.items():
                begun = time.process_time()
                jax.block_until_ready(run(start))
                best[name] = min(best[name], time.process_time() - begun)
        first = best[next(iter(best))]
        counts = "; ".join(map(str, STEPS_PER_TURN))
        head = f"errors of momentum and attitude after {TURNS} turns, {counts} steps a turn"
        print(f"| {kind.name}, {many} bodies | ns a step | ratio | {head} |")
        print("|---|---|---|---|")
        for name, seconds in best.items():
            nanoseconds = 1e9 * seconds / (options.steps * many)
            print(
                f"| {name} | {nanoseconds:.0f} | {seconds / first:.2f} | {errors_of(methods()[name], kind)} |",
                flush=True,
            )
        print()


if __name__ == "__main__":
    main()
