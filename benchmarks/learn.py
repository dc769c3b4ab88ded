"""Learned energies: value and gradient by all weights, beside a midpoint rule written by hand in `lax.scan`.

The energy is a network of three layers on so(3), or features with as many weights. Each row has the processor time of
the loss and its gradient, the ratio to the midpoint written by hand in the same rounds, and the error of the states
against a run of twice as many steps by `GaussLegendre(4)`. The iterations of the midpoint by hand are unrolled, as
users write them; those of the library stop at round-off.

python benchmarks/learn.py [--members N] [--steps N] [--rounds R]
"""

from __future__ import annotations

import argparse
import time
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import coadjoint as co

WIDTH, FEATURES, SPAN = 32, 8, 10.0


def network(x: Any, weights: Any) -> Any:
    """Return the energy of a network with three hidden layers."""
    for matrix, offset in weights[:-1]:
        x = jnp.tanh(x @ matrix + offset)
    return x @ weights[-1]


def draw_network(rng: np.random.Generator) -> Any:
    """Return weights of the network."""
    sizes = [3, WIDTH, WIDTH, WIDTH]
    pairs = [(rng.standard_normal(pair) / np.sqrt(pair[0]), np.zeros(pair[1])) for pair in pairwise(sizes)]
    return jax.tree.map(jnp.asarray, [*pairs, rng.standard_normal(WIDTH) / np.sqrt(WIDTH)])


def ridge(y: Any, weights: Any) -> Any:
    """Return one feature, a function of one linear combination."""
    return weights["size"] * jnp.log(jnp.cosh(weights["slope"] * y + weights["offset"]))


def draw_features(rng: np.random.Generator) -> Any:
    """Return directions and weights of features."""
    names = {"size": 0.3, "slope": 1.0, "offset": 1.0}
    weights = {name: jnp.asarray(scale * rng.standard_normal(FEATURES)) for name, scale in names.items()}
    return jnp.asarray(rng.standard_normal((FEATURES, 3)) / np.sqrt(3.0)), weights


def midpoint(x0: Any, weights: Any, steps: int, iterations: int) -> Any:
    """Return the states (steps, members, 3) by the implicit midpoint rule, written by hand."""
    h = SPAN / steps

    def field(x: Any) -> Any:
        return jnp.cross(x, jax.grad(network)(x, weights))

    def step(x: Any, _: Any) -> Any:
        middle = x
        for _ in range(iterations):
            middle = x + 0.5 * h * field(middle)
        return 2.0 * middle - x, 2.0 * middle - x

    return jax.vmap(lambda x: jax.lax.scan(step, x, None, length=steps)[1], out_axes=1)(x0)


def contenders(x0: Any, steps: int) -> dict[str, tuple[Any, Any, Any]]:
    """Return, by name: states after t = 0 as a function of weights, weights, and the energy for the reference."""
    rng = np.random.default_rng(1)
    weights, features = draw_network(rng), draw_features(rng)

    def of(energy: Any, method: Any, count: int) -> Any:
        system = co.LiePoissonSystem(co.algebras.so(3), energy, sign=-1)
        run = co.jax.solution(system, (0.0, SPAN), method=method, step=SPAN / count)
        return lambda given: run(x0, params=given)[1:]

    H, explicit = co.jax.energy(network, weights), co.jax.features(ridge, *features)
    found: dict[str, tuple[Any, Any, Any]] = {
        f"midpoint by hand, {k} iterations": (lambda given, k=k: midpoint(x0, given, steps, k), weights, H)
        for k in (8, 14)
    }
    for count, method in ((steps, co.GaussLegendre(1)), (steps // 4, co.GaussLegendre(2))):
        found[f"network, {method}, {count} steps"] = of(H, method, count), weights, H
    for count, method in ((steps, co.Splitting(order=2)), (steps // 4, co.Splitting(order=4))):
        found[f"{FEATURES} features, {method}, {count} steps"] = of(explicit, method, count), features, explicit
    return found


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--members", type=int, default=256)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    x0 = jnp.asarray(np.random.default_rng(2).standard_normal((arguments.members, 3)))
    given, rows, references = contenders(x0, arguments.steps), {}, {}
    for name, (states, weights, H) in given.items():
        if id(H) not in references:
            system = co.LiePoissonSystem(co.algebras.so(3), H, sign=-1)
            step = SPAN / (2 * arguments.steps)
            exact = co.jax.solution(system, (0.0, SPAN), 2 * arguments.steps, method=co.GaussLegendre(4), step=step)
            references[id(H)] = exact(x0)[-1]

        def loss(weights: Any, states: Any = states) -> Any:
            x = states(weights)
            return jnp.mean(x**2), x[-1]

        gradient = jax.jit(jax.value_and_grad(loss, has_aux=True))
        start = time.process_time()
        (_, last), _ = jax.block_until_ready(gradient(weights))
        compiling = time.process_time() - start
        rows[name] = gradient, weights, compiling, float(jnp.max(jnp.abs(last - references[id(H)])))
    seconds = {name: np.inf for name in rows}
    for _ in range(arguments.rounds):
        for name, (gradient, weights, *_) in rows.items():
            start = time.process_time()
            jax.block_until_ready(gradient(weights))
            seconds[name] = min(seconds[name], time.process_time() - start)
    base = seconds[next(iter(seconds))]
    print(f"{arguments.members} trajectories of {arguments.steps} steps; processor time of value and gradient\n")
    print(f"{'':58}{'seconds':>9}{'ratio':>8}{'compiling':>11}{'error':>10}")
    for name, (_, _, compiling, error) in rows.items():
        print(f"{name:58}{seconds[name]:9.3f}{seconds[name] / base:8.2f}{compiling:11.1f}{error:10.1e}")


if __name__ == "__main__":
    main()
