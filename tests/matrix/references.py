"""Motions by SciPy, and bounds on what rounding alone could cause."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import coadjoint as co

U = 2.0**-53
ENDS: dict[tuple, tuple[Any, np.ndarray]] = {}


def exact_end(system: Any, states: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return the final states of some motions to about 1e-12; those asked for are remembered."""
    key = (id(system), states.tobytes(), start, end)
    if key in ENDS:
        return ENDS[key][1]

    def slope(t: float, flat: np.ndarray) -> np.ndarray:
        return np.ravel(field(system, flat.reshape(states.shape), t))

    ends = solve_ivp(slope, (start, end), np.ravel(states), "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    ENDS[key] = system, ends.reshape(states.shape)  # with the system, so that its id is not given to another one
    return ENDS[key][1]


def blows_up(system: Any, states: np.ndarray, start: float, end: float) -> bool:
    """Return whether a motion leaves all bounds before its end."""
    x0 = np.ravel(states)
    with np.errstate(all="ignore"):
        found = solve_ivp(lambda t, x: field(system, x, t), (start, end), x0, "DOP853", rtol=1e-10, atol=1e-12)
    return bool(found.status != 0 or np.abs(found.y).max() > 1e9 * (1.0 + np.abs(x0).max()))


def field(system: Any, x: np.ndarray, t: float) -> np.ndarray:
    """Return x'; states of matrices, which rounding may move out of their algebra, are projected on it."""
    plain = system.unforced
    if not plain.has_matrices:
        return system.vector_field(x, t)
    given = () if plain is system else (t,)
    return np.stack([system.vector_field(W, *given) for W in plain.algebra.projected(x)])


def run_of(system: Any, method: Any, states: np.ndarray, start: float, end: float, n: int, **given: Any) -> co.Solution:
    """Return a run of n steps, without a warning of large steps."""
    return co.prepare(system, method, abs(end - start) / n, watch=False, **given).run(states, (start, end), n)


def order_and_doubt(counts: Any, errors: Any, power: int, noise: float) -> tuple[float, float]:
    """Return the order that errors show with numbers of steps in a geometric sequence, and its uncertainty.

    With error = C h^p (1 + a h^q + ...) the slope between two step sizes differs from p by a multiple of h^q, so that
    the range of the slopes gives the deviation of the last one; terms beyond are taken to be at most as large again.
    `noise`, the relative error of each error, changes a slope by twice that over the logarithm of the ratio. The same
    holds for differences of successive solutions: they are C (1 - r^-p) h^p (1 + a' h^q + ...).
    """
    ratio, slopes = counts[-1] / counts[-2], -np.diff(np.log(errors)) / np.diff(np.log(counts))
    shrunk = (counts[-2] / counts[0]) ** power - 1.0
    return float(slopes[-1]), float(2.0 * np.ptp(slopes) / shrunk + 2.0 * noise / np.log(ratio))


def convergence(system: Any, method: Any, states: np.ndarray, span: Any, order: int, power: int) -> tuple:
    """Return the order that errors against SciPy show, at most the declared one, that one, and the allowance.

    Errors below 1e-10 are small at once, and too small for a slope: the reference has errors of 1e-12. Those above a
    tenth of the end do not fall yet. The allowance is a quarter, since orders are whole numbers. It is infinite if few
    errors are between, or if the doubt, which is that of the term after the first one alone, is not below a quarter.
    """
    exact, size = exact_end(system, states, *span), float(np.linalg.norm(states))
    finest, ratio = (256, 2.0) if order <= 2 else (96, 2**0.5) if order < 7 else (48, 2**0.25)
    counts, errors = [], []
    for n in sorted({round(finest / ratio**k) for k in range(12) if finest / ratio**k >= 3}, reverse=True):
        try:
            error = float(np.linalg.norm(run_of(system, method, states, *span, n).x[-1] - exact))
        except co.IntegrationError:
            break  # the step is too large
        if not error < 0.1 * np.linalg.norm(exact):
            break
        if error > 1e-10 * size:
            counts, errors = [n, *counts], [error, *errors]
        if len(counts) == 5:
            break
    if len(counts) < 5:
        return order, order, np.inf
    shown, doubt = order_and_doubt(counts, errors, power, 1e-12 * size / errors[-1])
    return min(order, shown), order, _allowance(doubt)


def _allowance(doubt: float) -> float:
    return 0.25 if doubt < 0.25 else np.inf


def convergence_of_attitude(
    system: Any, method: Any, x: np.ndarray, span: Any, order: int, power: int, g: Any
) -> tuple:
    """Return the same for differences of group elements of successive runs."""
    counts = np.array([6, 12, 24, 48, 96])
    ends = [run_of(system, method, x, *span, n, attitude=g).attitude[-1] for n in counts]
    changes = np.linalg.norm(np.diff(ends, axis=0).reshape(len(ends) - 1, -1), axis=1)
    if not changes[0] < 0.1 * np.linalg.norm(ends[-1]):
        return order, order, np.inf
    noise = 4 * len(ends[-1]) * U * counts[-1] * np.linalg.norm(ends[-1]) / changes[-1] if changes[-1] else np.inf
    shown, doubt = order_and_doubt(counts[:-1], np.maximum(changes, U), power, noise)
    return min(order, shown), order, _allowance(doubt)


def gradient_of(invariant: Any, x: np.ndarray) -> np.ndarray:
    """Return the gradient; where it is not known by differences, over about the cube root of u."""
    if hasattr(invariant, "gradient"):
        return np.asarray(invariant.gradient(x), dtype=float)
    d = 1e-5 * max(1.0, float(np.abs(x).max()))
    return np.array([(invariant(x + d * unit) - invariant(x - d * unit)) / (2 * d) for unit in np.eye(len(x))])


def measured(sol: co.Solution) -> int:
    """Return how many states from the start on are at most a thousand times as large as the first."""
    with np.errstate(over="ignore"):
        sizes = np.linalg.norm(sol.x.reshape(len(sol.x), -1), axis=1)
    return int(np.argmax(np.append(~(sizes <= 1e3 * sizes[0]), True)))


def largest_changes(sol: co.Solution) -> dict[str, float]:
    """Return the largest change of each invariant along a run."""
    along = {"energy": sol.energy, **sol.casimirs}
    return {name: float(np.abs(values - values[0])[: measured(sol)].max()) for name, values in along.items()}


def rounding_of(sol: co.Solution) -> dict[str, float]:
    """Return, for each invariant, the most that rounding could move it if every rounding went the same way.

    Each of the `evaluations` of the run moves a state by at most 4 n roundings of relative size u, and a move of size d
    changes an invariant by at most |gradient| d; the largest |gradient| |x| of some states is taken. Evaluating the
    invariant itself is one more.
    """
    plain = getattr(sol.system, "system", sol.system)
    vectors = plain.in_numbers
    states = sol.x[: measured(sol)]
    states = states[:: max(1, len(states) // 8)]
    if vectors is not plain:
        states = np.stack([plain.to_vector(x) for x in states[:: max(1, len(states) // 2)]])
    invariants = {"energy": vectors.energy if vectors is not plain else vectors.hamiltonian, **vectors.casimirs}
    work = 4 * vectors.dim * U * (sol.stats.evaluations + sol.stats.steps + 1)
    return {
        name: work * max(float(np.linalg.norm(gradient_of(what, x)) * np.linalg.norm(x)) for x in states)
        for name, what in invariants.items()
    }


def rounding_of_group(sol: co.Solution, size: float) -> float:
    """Return the most that rounding could move a product with the group element of this size."""
    return 4 * sol.attitude.shape[-1] * U * (sol.stats.evaluations + sol.stats.steps + 1) * size


def preserved(system: Any, properties: co.methods.Properties) -> list[str]:
    """Return the names of the invariants that a scheme declares to preserve."""
    plain = system.unforced
    casimirs = plain.in_numbers.casimirs

    def kept(casimir: Any) -> bool:
        polynomial = isinstance(casimir, co.Polynomial)
        return {
            "all": True,
            "polynomial": polynomial,
            "quadratic": polynomial and casimir.degree <= 2,
            "none": False,
        }[properties.casimirs]

    names = [name for name, casimir in casimirs.items() if kept(casimir)]
    return (["energy"] if properties.energy else []) + names


def poisson_defect(step: Any, x: np.ndarray, evaluations: float) -> tuple[float, float]:
    """Return |P J(x) P^T - J(step(x))| with the tangent P, and 64 u times the operations times |P|^2 |J|."""
    system = step.system
    P, J = step.tangent(x), system.structure_matrix(x)
    defect = P @ J @ P.T - system.structure_matrix(step(x))
    operations = (evaluations + 4) * len(x)
    return float(np.linalg.norm(defect)), 64 * U * operations * float(np.linalg.norm(P) ** 2 * np.linalg.norm(J))


def misplaced(system: Any, events: Any, own: Any, along: co.Solution, end: float) -> dict[str, float]:
    """Return what is wrong with crossings `own` of one member: values, directions, and changes of sign without one.

    `along` is a run without events, saved at every step; `end` is where the run ends. Times are exact to rounding, so
    that the value of g is the rounding of a step, relative to the size of the state and to what g changes by in the
    last digit of the time. Within a step, directions alternate from the sign at its start.
    """
    way, h = np.sign(along.t[-1] - along.t[0]), abs(along.t[1] - along.t[0])
    there = [k for k, t in enumerate(along.t) if way * (t - end) <= 0]
    wrong = {"values": 0.0, "directions": 0.0, "missing": 0.0}
    for e, event in enumerate(events):

        def g(x: np.ndarray, t: float, event: Any = event) -> float:
            return float(event.g(x, t) if event.name == "wave" else event.g(x))

        signs = np.sign([g(along.x[k], along.t[k]) for k in there])
        rising, falling = (int(np.sum((signs[:-1] == -s) & (signs[1:] == s))) for s in (1, -1))
        wanted = {0: rising + falling, 1: rising, -1: falling}[event.direction]
        wrong["missing"] += max(0, wanted - np.sum(own.which == e))
        mine = own.which == e
        for t, x in zip(own.t[mine], own.x[mine], strict=True):
            slope, d = system.vector_field(x, t), 1e-6 * h
            rate = (g(x + d * slope, t + d) - g(x - d * slope, t - d)) / (2 * d)
            wrong["values"] = max(wrong["values"], abs(g(x, t)) / (1.0 + np.linalg.norm(x) + abs(rate * t)))
        steps = np.searchsorted(way * along.t, way * own.t[mine]) - 1
        for k in np.unique(steps[steps >= 0]):
            found = own.direction[mine][steps == k]
            expected = event.direction or -signs[k] * (-1.0) ** np.arange(len(found))
            wrong["directions"] += signs[k] != 0 and np.any(found != expected)
    return wrong
