"""Gradients of runs beside diffrax (its adjoints), CasADi's integrator and heyoka's variational equations.

    python benchmarks/derivatives_beside.py [--rounds N] [--time T] [--steps N]

The first table: a gradient of the end of a run, by the initial state and the moments of inertia, with a required error.
Of each solver the largest of its steps or tolerances with this error is taken. The second table: the time of one step,
and of one step with its share of a gradient, of loops with given steps. Everything is run in turns, and the best of the
rounds is taken; ratios are to the first row. Packages that are not installed are skipped, and named.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from lyapunov import best

import coadjoint as co

INERTIA, X0 = np.array([1.0, 2.0, 2.5]), np.array([0.3, 1.0, 0.2])
WEIGHTS = np.array([1.0, -0.5, 0.7])
REQUIRED = (1e-4, 1e-8)
POWERS = range(3, 14)

Gradient = Callable[[], np.ndarray]


def body() -> Any:
    """Return the system."""
    return co.systems.rigid_body(inertia=INERTIA)


def by_pullback(method: Any, steps: int, time: float) -> Gradient:
    """Return the gradient by `vjp`, of x0 and inertia in a row."""
    ready = co.prepare(body(), method, time / steps)

    def gradient() -> np.ndarray:
        _, pullback = ready.vjp(X0, (0, time), save_every=steps)
        found = pullback(np.array([0.0 * WEIGHTS, WEIGHTS]))
        return np.concatenate([found["x0"], found["inertia"]])

    return gradient


def by_jax(backend: str, method: Any, steps: int, time: float) -> Gradient:
    """Return the gradient by `co.jax.solution`."""
    import jax

    f = co.jax.solution(co.prepare(body(), method, time / steps), (0, time), steps, backend=backend)
    compiled = jax.jit(jax.grad(lambda x0, inertia: f(x0, inertia=inertia)[-1] @ WEIGHTS, (0, 1)))
    return lambda: np.concatenate(compiled(X0, INERTIA))


def field(x: Any, inertia: Any) -> list[Any]:
    """Return the right-hand side of Euler's equations."""
    w = [x[i] / inertia[i] for i in range(3)]
    return [x[1] * w[2] - x[2] * w[1], x[2] * w[0] - x[0] * w[2], x[0] * w[1] - x[1] * w[0]]


def by_diffrax(adjoint: str, time: float, tolerance: float | None, steps: int = 0) -> Gradient:
    """Return the gradient by an adjoint of diffrax, with this tolerance or number of steps, by Dopri8."""
    import diffrax
    import jax
    import jax.numpy as jnp

    term = diffrax.ODETerm(lambda t, x, inertia: jnp.stack(field(x, inertia)))
    options: dict[str, Any] = {"max_steps": max(4096, 2 * steps), "adjoint": getattr(diffrax, adjoint)()}
    if tolerance is not None:
        options["stepsize_controller"] = diffrax.PIDController(rtol=tolerance, atol=tolerance)

    def number(x0: Any, inertia: Any) -> Any:
        first = time / steps if steps else None
        return diffrax.diffeqsolve(term, diffrax.Dopri8(), 0.0, time, first, x0, inertia, **options).ys[-1] @ WEIGHTS

    compiled = jax.jit(jax.grad(number, (0, 1)))
    return lambda: np.concatenate(compiled(jnp.array(X0), jnp.array(INERTIA)))


def by_casadi(time: float, tolerance: float) -> Gradient:
    """Return the gradient by the adjoint of CVODES in CasADi."""
    import casadi

    x, p = casadi.MX.sym("x", 3), casadi.MX.sym("p", 3)
    equations = {"x": x, "p": p, "ode": casadi.vertcat(*field(x, p))}
    options = {"abstol": tolerance, "reltol": tolerance, "max_num_steps": 10**6}
    end = casadi.integrator("end", "cvodes", equations, 0.0, time, options)(x0=x, p=p)["xf"]
    number = casadi.dot(end, WEIGHTS)
    gradient = casadi.Function("g", [x, p], [casadi.vertcat(*(casadi.gradient(number, one) for one in (x, p)))])
    return lambda: np.array(gradient(X0, INERTIA)).ravel()


def by_heyoka(time: float, tolerance: float) -> Gradient:
    """Return the gradient by variational equations of heyoka."""
    import heyoka

    names = heyoka.make_vars("x", "y", "z")
    moments = [heyoka.par[i] for i in range(3)]
    equations = list(zip(names, field(names, moments), strict=True))
    system = heyoka.var_ode_sys(equations, heyoka.var_args.vars | heyoka.var_args.params)
    integrator = heyoka.taylor_adaptive(system, X0, pars=INERTIA, tol=tolerance, compact_mode=False)
    start = np.array(integrator.state)

    def gradient() -> np.ndarray:
        integrator.time, integrator.state[:] = 0.0, start
        integrator.propagate_until(time)
        # Order one, each component by x, y, z and the three moments.
        return WEIGHTS @ integrator.state[3:].reshape(3, 6)

    return gradient


def contenders(time: float) -> Iterator[tuple[str, list[Callable[[], Gradient]]]]:
    """Yield names, and ways to make their gradients with ever smaller errors."""
    counts = [round(time * 2.0**k / 2) for k in range(0, 10)]
    for method in (co.Splitting(order=4), co.Splitting(order=8), co.GaussLegendre(4)):
        yield f"coadjoint, {method}", [partial(by_pullback, method, steps, time) for steps in counts]
    if installed("jax"):
        for backend in ("compiled", "xla"):
            method = co.Splitting(order=8)
            yield f"coadjoint, JAX, {backend}, {method}", [partial(by_jax, backend, method, n, time) for n in counts]
    if installed("diffrax"):
        for adjoint in ("RecursiveCheckpointAdjoint", "BacksolveAdjoint"):
            makers = [partial(by_diffrax, adjoint, time, 10.0**-k) for k in POWERS]
            yield f"diffrax, Dopri8, {adjoint}", makers
    if installed("casadi"):
        yield "CasADi, CVODES, adjoint", [partial(by_casadi, time, 10.0**-k) for k in POWERS]
    if installed("heyoka"):
        yield "heyoka, variational equations", [partial(by_heyoka, time, 10.0**-k) for k in range(1, 17)]


def installed(package: str) -> bool:
    """Return whether a package is installed."""
    return importlib.util.find_spec(package) is not None


def reference(time: float) -> np.ndarray:
    """Return the gradient to rounding: two schemes agree."""
    first, second = (by_pullback(co.GaussLegendre(s), round(20 * time), time)() for s in (5, 6))
    if not np.max(np.abs(first - second)) < 1e-3 * REQUIRED[-1]:
        raise SystemExit(f"the reference gradients differ by {np.max(np.abs(first - second)):.2g}")
    return second


def by_required_error(time: float, rounds: int) -> None:
    """Print the table of gradients with a required error."""
    exact = reference(time)
    size = np.max(np.abs(exact))
    for required in REQUIRED:
        found: dict[str, tuple[Gradient, float]] = {}
        for name, makers in contenders(time):
            for make in makers:
                gradient = make()
                error = float(np.max(np.abs(gradient() - exact)) / size)
                if error <= required:
                    found[name] = gradient, error
                    break
            else:
                print(f"{name} does not reach {required:g}")
        times = best(rounds, *(gradient for gradient, _ in found.values()))
        print(f"\ngradient of the body's state at t = {time:g}, relative error at most {required:g}")
        print(f"{'solver':64s}{'us':>9s}{'ratio':>8s}{'error':>10s}")
        for (name, (_, error)), seconds in zip(found.items(), times, strict=True):
            print(f"{name:64s}{1e6 * seconds:9.0f}{seconds / times[0]:8.1f}{error:10.1g}", flush=True)


def by_step(steps: int, rounds: int) -> None:
    """Print the table of the time of a step."""
    if not installed("jax"):
        return
    import jax
    import jax.numpy as jnp

    time, method = 0.05 * steps, co.Splitting(order=4)
    ready = co.prepare(body(), method, 0.05, threads=1)
    runs: dict[str, tuple[Any, Gradient]] = {
        "coadjoint, compiled": (lambda: ready.end(X0, (0.0, time)), by_pullback(method, steps, time))
    }
    f = jax.jit(lambda x0: co.jax.solution(ready, (0, time), steps, backend="xla")(x0))
    runs["coadjoint, xla"] = (lambda: f(X0).block_until_ready(), by_jax("xla", method, steps, time))
    if installed("diffrax"):
        import diffrax

        term = diffrax.ODETerm(lambda t, x, args: jnp.stack(field(x, INERTIA)))

        def end(x0: Any) -> Any:
            return diffrax.diffeqsolve(term, diffrax.Dopri8(), 0.0, time, 0.05, x0, max_steps=2 * steps).ys

        compiled = jax.jit(end)
        gradient = by_diffrax("RecursiveCheckpointAdjoint", time, None, steps)
        runs["diffrax, Dopri8"] = (lambda: compiled(jnp.array(X0)).block_until_ready(), gradient)
    calls = [call for pair in runs.values() for call in pair]
    for call in calls:
        call()
    times = best(rounds, *calls)
    print(f"\n{steps} steps of 0.05, times of a step")
    print(f"{'solver':24s}{'run (us)':>10s}{'ratio':>8s}{'gradient (us)':>15s}{'ratio':>8s}")
    for name, run, whole in zip(runs, times[::2], times[1::2], strict=True):
        row = f"{name:24s}{1e6 * run / steps:10.3f}{run / times[0]:8.1f}"
        print(f"{row}{1e6 * whole / steps:15.3f}{whole / times[1]:8.1f}", flush=True)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--time", type=float, default=20.0)
    parser.add_argument("--steps", type=int, default=4000)
    given = parser.parse_args()
    if installed("jax"):
        import jax

        jax.config.update("jax_enable_x64", True)
    for package in ("jax", "diffrax", "casadi", "heyoka"):
        if not installed(package):
            print(f"{package} is not installed, and skipped")
    by_required_error(given.time, given.rounds)
    by_step(given.steps, given.rounds)


if __name__ == "__main__":
    main()
