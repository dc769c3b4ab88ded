"""Three learned motions: by regression, by a network as energy, by a neural ODE, and by a Lie-Poisson network.

The motions are those of a generalized body on SO(3), of Kirchhoff's body in a fluid on SE(3), and of three vehicles
under optimal control on SE(2)^3. If H is a polynomial, `co.identify` finds it. If not, three models learn the same
samples in the same processor time by the same least squares (Levenberg-Marquardt):

- energy: a quadratic form and one hidden layer, as `co.jax.energy`, from the equations of the motion in integral form;
  its units start as those that reduce the residuals most, of functions of one or two coordinates;
- neural ODE: x' = one hidden layer, in the same form, run by RK4;
- LPNet: a map of one step, composed of coadjoint motions about the axes of the algebra by learned angles (2308.15349).

Rows have the mean square of runs from the initial states of the samples over their times, the error of H (root mean
square, and largest, in the range of the samples) after what Casimirs may add, the largest errors of states and
Casimirs in a run ten times longer, from initial states that were not learned.

python benchmarks/learned_energies.py [--seconds S] [--only NAME] [--seed K]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import cho_factor, cho_solve, solve_triangular

import coadjoint as co

SPAN, STEP, LONGER = 1.0, 0.1, 10
UNITS = 24
"""Hidden units of the energy."""
SMALL = 1e-5
"""Factor of the parameters as residuals, which fixes those that move nothing."""
DAMPINGS, SMALLEST_DIAGONAL = 12, 1e-10
"""Most dampings that are tried in an iteration, and the smallest number on the diagonal they multiply, relative."""
INDEPENDENT = 1e-8
"""Part of the square of a column that must remain beside columns that were chosen before."""


def sphere(rng: Any, *shape: int) -> Any:
    """Return unit vectors."""
    p = rng.standard_normal(shape)
    return p / np.linalg.norm(p, axis=-1, keepdims=True)


def body_states(rng: Any, count: int) -> Any:
    """Return momenta of unit length."""
    return sphere(rng, count, 3)


def kirchhoff_states(rng: Any, count: int) -> Any:
    """Return angular momenta in a cube, and linear momenta of unit length."""
    return np.append(rng.uniform(-1, 1, (count, 3)), sphere(rng, count, 3), axis=1)


def vehicle_states(rng: Any, count: int) -> Any:
    """Return the angular momentum of each vehicle, and its linear momentum of unit length."""
    each = np.append(rng.uniform(-1, 1, (count, 3, 1)), sphere(rng, count, 3, 2), axis=2)
    return each.reshape(count, 9)


class Problem(NamedTuple):
    """An algebra with two energies as text, initial states, and the number of trajectories."""

    algebra: Any
    polynomial: str
    energy: str
    states: Callable[[Any, int], Any]
    members: int


QUADRATIC = "x1^2/2 + x2^2/4 + x3^2/5 + x1*x4/10 + x2*x5/8 + x4^2/2 + x5^2/3 + x6^2/4"
SPEEDS, COUPLING = "x2 + x5 + x8", "x1*x4/4 + x4*x7/4"
PROBLEMS = {
    "body on SO(3)": Problem(
        co.algebras.so(3),
        "x1^2/2 + x2^2/4 + x3^2/6 + x1*x2/5 + x3/4 + x1^4/8 + x2^2*x3^2/8",
        "x1^2/2 + x2^2/4 + cos(2*x3)/4 + exp(x1*x3)/8",
        body_states,
        40,
    ),
    "Kirchhoff's body on SE(3)": Problem(
        co.algebras.e(3), QUADRATIC, f"{QUADRATIC} + exp(x4)/4 + cos(2*x6)/8", kirchhoff_states, 100
    ),
    "three vehicles on SE(2)^3": Problem(
        co.algebras.copies(co.algebras.e(2), 3),
        f"{SPEEDS} + x1^2/2 + x4^2/2 + x7^2/2 + {COUPLING}",
        f"{SPEEDS} + sqrt(1 + x1^2) + sqrt(1 + x4^2) + sqrt(1 + x7^2) + {COUPLING}",
        vehicle_states,
        100,
    ),
}


def integrals(count: int) -> Any:
    """Return the integrals from the first of equidistant samples to each other one, of the polynomial through all."""
    z = np.linspace(-1.0, 1.0, count)
    legendre = np.polynomial.legendre
    of_basis = [legendre.legval(z, legendre.legint(one, lbnd=-1)) for one in np.eye(count)]
    return 0.5 * SPAN * np.stack(of_basis, 1)[1:] @ np.linalg.inv(legendre.legvander(z, count - 1))


def least_squares(residuals: Any, jacobian: Any, start: Any, seconds: float) -> tuple[Any, Any]:
    """Return the parameters of least squares after a processor time (Levenberg-Marquardt), and what comes with them.

    ``residuals(v)`` returns numbers and anything else, which is the second argument of ``jacobian``.
    """

    @jax.jit
    def at(v: Any) -> tuple[Any, Any, Any]:
        r, others = residuals(v)
        return r, others, jnp.vdot(r, r) + SMALL**2 * v @ v

    @jax.jit
    def normal_equations(v: Any, r: Any, others: Any) -> tuple[Any, Any]:
        J = jacobian(v, others).reshape(-1, len(v))
        return J.T @ J + SMALL**2 * jnp.eye(len(v)), J.T @ r.ravel() + SMALL**2 * v

    @jax.jit
    def moved(v: Any, matrix: Any, slope: Any, damping: float) -> Any:
        sizes = jnp.diag(matrix)
        sizes = jnp.maximum(sizes, SMALLEST_DIAGONAL * jnp.max(sizes))
        return v - cho_solve(cho_factor(matrix + damping * jnp.diag(sizes)), slope)

    v, began, damping = jnp.asarray(start), time.process_time(), 1e-2
    r, others, loss = at(v)
    while time.process_time() - began < seconds:
        equations = normal_equations(v, r, others)
        for _ in range(DAMPINGS):
            there = moved(v, *equations, damping)
            found = at(there)
            if found[2] < loss:
                break
            damping *= 4.0
        else:
            break
        v, (r, others, loss), damping = there, found, 0.25 * damping
    return v, others


def fitted_units(unit: Any, known: Any, target: Any, start: Any, seconds: float) -> tuple[Any, Any, Any]:
    """Return units, the coefficients of known columns, and the outputs of units, whose sum is nearest to a target.

    The target is (residuals, outputs); ``unit(one)`` returns the column of a unit. Coefficients are solved for at each
    value of the units (variable projection), and each column depends on its own unit only.
    """
    flat, unravel = ravel_pytree(start)
    count, fixed = known.shape

    def residuals(v: Any) -> tuple[Any, Any]:
        A = jnp.concatenate([known, jax.vmap(unit, out_axes=1)(unravel(v))], axis=1)
        A = jnp.concatenate([A, SMALL * jnp.eye(A.shape[1])])
        Q, R = jnp.linalg.qr(A)
        C = solve_triangular(R, Q[:count].T @ target)
        return (A @ C).at[:count].add(-target), (Q, C)

    def jacobian(v: Any, others: Any) -> Any:
        Q, C = others
        slopes = jax.tree.leaves(jax.vmap(jax.jacfwd(unit))(unravel(v)))
        each = [jnp.einsum("urj,uo->rouj", one.reshape(len(one), count, -1), C[fixed:]) for one in slopes]
        J = jnp.concatenate([one.reshape(*one.shape[:2], -1) for one in each], axis=2)
        projected = jnp.einsum("aq,qoj->aoj", Q, jnp.einsum("rq,roj->qoj", Q[:count], J))
        return (-projected).at[:count].add(J)

    v, (_, C) = least_squares(residuals, jacobian, flat, seconds)
    return unravel(v), C[:fixed], C[fixed:]


def best_units(unit: Any, known: Any, target: Any, start: Any, count: int) -> list[int]:
    """Return the units, one after the other, whose outputs reduce the residuals most (orthogonal least squares)."""
    outputs, r, chosen = np.asarray(jax.jit(jax.vmap(unit, out_axes=1))(start)), target[:, 0], list[int]()
    Q = np.linalg.qr(np.append(known, SMALL * np.eye(known.shape[1]), axis=0))[0][: len(r)]
    r, outputs, sizes = r - Q @ (Q.T @ r), outputs - Q @ (Q.T @ outputs), np.sum(outputs**2, axis=0)
    for _ in range(count):
        rest = np.sum(outputs**2, axis=0)
        independent = rest > INDEPENDENT * sizes
        chosen.append(int(np.argmax(np.where(independent, (r @ outputs) ** 2 / np.where(independent, rest, 1.0), 0.0))))
        q = outputs[:, chosen[-1]] / np.sqrt(rest[chosen[-1]])
        r, outputs = r - q * (q @ r), outputs - np.outer(q, q @ outputs)
    return chosen


def learned_energy(problem: Problem, data: Any, _: Any, seconds: float) -> tuple[Any, Any]:
    """Return a function of x0 and the number of steps that returns states, and the learned energy."""
    n, began = problem.algebra.dim, time.process_time()
    rows, columns = np.triu_indices(n)
    J = -np.array([problem.algebra.structure_matrix(e) for e in np.eye(n)])

    def energy(x: Any, w: Any) -> Any:
        hidden = jnp.log(jnp.cosh(w["in"] @ x + w["shift"]))
        return w["out"] @ hidden + w["linear"] @ x + w["form"] @ (x[rows] * x[columns])

    weights, target = integrals(len(data)), (data - data[0])[1:].reshape(-1, 1)
    structure = np.einsum("kij,tmk->tmij", J, data)
    quadratic = structure[..., rows] * data[..., None, columns] + structure[..., columns] * data[..., None, rows]
    known = np.einsum("kt,tmij->kmij", weights, np.concatenate([structure, quadratic], axis=3)).reshape(len(target), -1)

    def unit(one: Any) -> Any:
        """Return J(x) times the gradient of a hidden unit, in integral form."""
        fields = jnp.tanh(data @ one["in"] + one["shift"])[..., None] * (structure @ one["in"])
        return jnp.einsum("kt,tmi->kmi", weights, fields).ravel()

    e, shifts = np.eye(n), np.linspace(-1.0, 1.0, 3)
    directions = np.array([*e, *(e[i] + sign * e[j] for i, j in combinations(range(n), 2) for sign in (1, -1))])
    start = {
        "in": np.repeat(directions, len(shifts), axis=0),
        "shift": np.tile(shifts, len(directions)),
    }
    units = best_units(unit, known, target, start, UNITS)
    start = {name: one[units] for name, one in start.items()}
    w, fixed, out = fitted_units(unit, known, target, start, seconds - (time.process_time() - began))
    w |= {"out": out[:, 0], "linear": fixed[:n, 0], "form": fixed[n:, 0]}
    system = co.LiePoissonSystem(problem.algebra, co.jax.energy(energy, w), sign=-1)

    def run(x0: Any, steps: int) -> Any:
        return co.jax.solution(system, (0.0, steps * STEP), method=co.GaussLegendre(3), step=STEP)(x0)

    return run, lambda x: np.asarray(jax.vmap(lambda x: energy(x, w))(x))


def neural_ode(problem: Problem, data: Any, rng: Any, seconds: float) -> tuple[Any, None]:
    """Return the same of a neural ODE, by RK4 with four substeps."""
    n, width, substeps = problem.algebra.dim, 24, 4

    def field(x: Any, w: Any) -> Any:
        return w["out"] @ jnp.tanh(w["in"] @ x + w["shift"]) + w["linear"] @ x

    start = {"in": 0.7 * rng.standard_normal((width, n)), "shift": rng.uniform(-1, 1, width)}
    weights, target = integrals(len(data)), (data - data[0])[1:].reshape(-1, n)
    known = np.einsum("kt,tmi->kmi", weights, data).reshape(-1, n)

    def unit(one: Any) -> Any:
        return (weights @ jnp.tanh(data @ one["in"] + one["shift"])).ravel()

    w, linear, out = fitted_units(unit, known, target, start, seconds)
    w |= {"out": out.T, "linear": linear.T}
    h = STEP / substeps

    def step(x: Any, _: Any) -> Any:
        for _ in range(substeps):
            k1 = field(x, w)
            k2 = field(x + 0.5 * h * k1, w)
            k3 = field(x + 0.5 * h * k2, w)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + field(x + h * k3, w))
        return x, x

    return of_steps(step), None


def lie_poisson_network(problem: Problem, data: Any, rng: Any, seconds: float) -> tuple[Any, None]:
    """Return the same of a composition of coadjoint motions by angles that are functions of the fixed coordinate."""
    n, sweeps, units = problem.algebra.dim, 3, 4
    D = -np.array([problem.algebra.coadjoint(e) for e in np.eye(n)], dtype=np.float64)
    turns = np.array([np.any(one @ one) for one in D])  # D^3 = -D, otherwise D^2 = 0
    axes = np.tile(np.arange(n), sweeps)

    def layer(x: Any, given: Any) -> Any:
        axis, w = given
        angle = w["size"] @ jnp.tanh(w["slope"] * x[axis] + w["shift"]) + w["linear"] * x[axis]
        once = jnp.asarray(D)[axis] @ x
        moved = jnp.where(jnp.asarray(turns)[axis], jnp.sin(angle), angle) * once
        return x + moved + 2.0 * jnp.sin(0.5 * angle) ** 2 * (jnp.asarray(D)[axis] @ once), None

    def step(x: Any, w: Any) -> Any:
        return lax.scan(layer, x, (axes, w))[0]

    start = {name: rng.uniform(-1, 1, (n * sweeps, units)) for name in ("slope", "shift")}
    start |= {"size": 0.01 * rng.standard_normal((n * sweeps, units)), "linear": np.zeros(n * sweeps)}
    before, after = data[:-1].reshape(-1, n), data[1:].reshape(-1, n)
    flat, unravel = ravel_pytree(start)

    def residuals(v: Any) -> Any:
        return (jax.vmap(lambda x: step(x, unravel(v)))(before) - after).ravel()

    v, _ = least_squares(lambda v: (residuals(v), ()), lambda v, _: jax.jacfwd(residuals)(v), flat, seconds)
    w = unravel(v)

    def one(x: Any, _: Any) -> Any:
        moved = step(x, w)
        return moved, moved

    return of_steps(one), None


def of_steps(step: Any) -> Callable[[Any, int], Any]:
    """Return the states (steps + 1, members, n) of a step of one state."""

    def run(x0: Any, steps: int) -> Any:
        x0 = jnp.asarray(x0)
        states = jax.vmap(lambda x: lax.scan(step, x, None, length=steps)[1], out_axes=1)(x0)
        return jnp.concatenate([x0[None], states])

    return run


MODELS = {"energy": learned_energy, "neural ODE": neural_ode, "LPNet": lie_poisson_network}


def regression(problem: Problem, rng: Any) -> str:
    """Return the time, and the errors, of the polynomial by `co.identify`."""
    truth = co.LiePoissonSystem(problem.algebra, problem.polynomial, sign=-1)
    degree = max(map(sum, truth.hamiltonian.to_polynomial().monomials))
    sol = co.integrate(truth, problem.states(rng, 12), (0, 5), 0.05, co.GaussLegendre(4))
    began = time.process_time()
    found = co.identify(problem.algebra, sol.t, sol.x, degree=degree, sign=-1)
    seconds = time.process_time() - began
    coefficients = np.array([found.hamiltonian.monomials.get(tuple(e), 0.0) for e in found.exponents])
    error = np.abs(coefficients - found.coefficients_of(truth.hamiltonian.to_polynomial())).max()
    return f"regression: {seconds:.2f} s, error of the coefficients {error:.1e}, of a run {found.run_error:.1e}"


def on_orbits(problem: Problem, states: Any, rng: Any) -> Any:
    """Return points (motions, members, n) on the orbits of states: linear energies turn momenta, as in the samples."""
    n, points = problem.algebra.dim, []
    moving = np.array([np.any(D @ D) for D in map(problem.algebra.coadjoint, np.eye(n))])
    for _ in range(12):
        slopes = np.where(moving, rng.uniform(-1.5, 1.5, n), 0.0)
        linear = co.Polynomial({tuple(map(int, e)): a for e, a in zip(np.eye(n), slopes, strict=True) if a})
        turned = co.LiePoissonSystem(problem.algebra, linear, sign=-1)
        points.append(co.integrate(turned, states, (0, 1), 0.125, co.GaussLegendre(4)).x[-1])
    return np.array(points)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--only", default="")
    parser.add_argument("--seed", type=int, default=0, help="of initial states and of the start of weights")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    for name, problem in PROBLEMS.items():
        if arguments.only not in name:
            continue
        rng = np.random.default_rng(5 + arguments.seed)
        print(f"{name}\n{regression(problem, rng)}")
        truth = co.LiePoissonSystem(problem.algebra, problem.energy, sign=-1)
        data = co.integrate(truth, problem.states(rng, problem.members), (0, SPAN), STEP, co.GaussLegendre(4)).x
        fresh = problem.states(rng, 20)
        exact = co.integrate(truth, fresh, (0, LONGER * SPAN), STEP, co.GaussLegendre(5)).x
        points = on_orbits(problem, problem.states(rng, 60), rng)
        energies = np.array([[truth.energy(x) for x in one] for one in points])
        print(f"{len(data)} times, {problem.members} trajectories; {arguments.seconds:.0f} s of processor time each\n")
        print(f"{'':12}{'seconds':>9}{'loss':>10}{'ratio':>10}{'H':>10}{'largest':>10}{'rollout':>10}{'Casimirs':>10}")
        losses: list[float] = []
        for model, learn in MODELS.items():
            began = time.process_time()
            run, energy = learn(problem, data, np.random.default_rng(1 + arguments.seed), arguments.seconds)
            seconds = time.process_time() - began
            losses.append(float(np.mean((np.asarray(run(data[0], len(data) - 1)) - data) ** 2)))
            x = np.asarray(run(fresh, len(exact) - 1))
            casimirs = np.max([np.abs(C(x) - C(fresh)).max() for C in truth.casimirs.values()])
            errors = ["", ""]
            if energy is not None:
                difference = np.array([energy(one) for one in points]) - energies
                difference -= difference.mean(axis=0)
                errors = [f"{np.sqrt(np.mean(difference**2)):.1e}", f"{np.abs(difference).max():.1e}"]
            row = f"{model:12}{seconds:9.1f}{losses[-1]:10.1e}{losses[-1] / losses[0]:10.1e}"
            rollout = np.abs(x - exact).max()
            print(f"{row}{errors[0]:>10}{errors[1]:>10}{rollout:10.1e}{casimirs:10.1e}", flush=True)
        print()


if __name__ == "__main__":
    main()
