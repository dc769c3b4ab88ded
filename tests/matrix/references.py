"""Motions by SciPy, and bounds on what rounding alone could cause."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import coadjoint as co

U = 2.0**-53
LAST: dict[str, Any] = {}


def exact_end(system: Any, states: np.ndarray, start: float, end: float) -> np.ndarray:
    """Return the final states of some motions to about 1e-12; the last ones asked for are remembered."""
    key = (states.tobytes(), start, end)
    if LAST.get("system") is system and LAST["key"] == key:
        return LAST["ends"]

    def slope(t: float, flat: np.ndarray) -> np.ndarray:
        return np.ravel(field(system, flat.reshape(states.shape), t))

    ends = solve_ivp(slope, (start, end), np.ravel(states), "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    LAST.update(system=system, key=key, ends=ends.reshape(states.shape))
    return LAST["ends"]


def field(system: Any, x: np.ndarray, t: float) -> np.ndarray:
    """Return x'; states of matrices, which rounding may move out of their algebra, are projected on it."""
    plain = getattr(system, "system", system)
    if not hasattr(plain, "in_numbers"):
        return system.vector_field(x, t)
    given = () if plain is system else (t,)
    return np.stack([system.vector_field(W, *given) for W in plain.algebra.projected(x)])


def errors_of(system: Any, method: Any, states: np.ndarray, start: float, end: float, counts: Any) -> list[float]:
    """Return the errors at the end with these numbers of steps, of all states together."""
    exact, found = exact_end(system, states, start, end), []
    for n in counts:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", co.LargeStepWarning)
            sol = co.integrate(system, states, (start, end), abs(end - start) / n, method, save_every=n, watch=False)
        found.append(float(np.linalg.norm(sol.x[-1] - exact)))
    return found


def slope_of(counts: Any, errors: Any) -> float:
    """Return the order that errors show at the three largest of the numbers of steps."""
    return float(-np.polyfit(np.log(np.array(counts[-3:])), np.log(np.array(errors[-3:])), 1)[0])


def gradient_of(invariant: Any, x: np.ndarray) -> np.ndarray:
    """Return the gradient, by differences where it is not known."""
    if hasattr(invariant, "gradient"):
        return np.asarray(invariant.gradient(x), dtype=float)
    d = 1e-5 * max(1.0, float(np.abs(x).max()))
    return np.array([(invariant(x + d * unit) - invariant(x - d * unit)) / (2 * d) for unit in np.eye(len(x))])


def largest_changes(sol: co.Solution) -> dict[str, float]:
    """Return the largest change of each invariant along a run."""
    along = {"energy": sol.energy, **sol.casimirs}
    return {name: float(np.abs(values - values[0]).max()) for name, values in along.items()}


def rounding_of(sol: co.Solution) -> dict[str, float]:
    """Return, for each invariant, the most that rounding could move it if every rounding went the same way.

    Each of the `evaluations` of the run moves a state by at most 4 n roundings of relative size u, and a move of size d
    changes an invariant by at most |gradient| d; the largest |gradient| |x| of some states is taken. Evaluating the
    invariant itself is one more.
    """
    plain = getattr(sol.system, "system", sol.system)
    vectors = getattr(plain, "in_numbers", plain)
    states = sol.x[:: max(1, len(sol.x) // 8)]
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
    plain = getattr(system, "system", system)
    casimirs = getattr(plain, "in_numbers", plain).casimirs

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
