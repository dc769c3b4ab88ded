"""Measured orders, defects and drifts, and bounds on what round-off alone could cause."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

import coadjoint as co

from .systems_under_test import Case, all_cases

U = 2.0**-53


def states_around(x0: np.ndarray, members: int = 4) -> np.ndarray:
    """Return x0 and states near it: errors averaged over them have no accidental zeros."""
    return np.array([x0 * (1.0 - 0.08 * k) + 0.05 * k * np.roll(x0, k) for k in range(members)])


def ensemble_of(case: Case) -> np.ndarray:
    """Return states near that of a case; of matrices those in their algebra."""
    ensemble = states_around(case.x0)
    return case.system.read(ensemble) if isinstance(case.system, co.MatrixSystem) else ensemble


def final_states(method: Any, case: Case, steps: int) -> np.ndarray:
    """Return the final states of several motions of a case, shape (members, n)."""
    span = (0.0, case.time)
    ensemble = ensemble_of(case)
    return co.integrate(
        case.system, ensemble, span, case.time / steps, method, save_every=steps, watch=False, threads=1
    ).x[-1]


@cache
def reference_states(name: str) -> np.ndarray:
    """Return the exact final states of a case to about 1e-15, confirmed by DOP853."""
    case = all_cases()[name]
    best = co.IsospectralGauss(8) if isinstance(case.system, co.MatrixSystem) else co.GaussLegendre(8)
    found = final_states(best, case, 48)
    for state, start in zip(found, ensemble_of(case), strict=True):
        other = solve_ivp(
            lambda t, x: case.system.vector_field(x, t),
            (0.0, case.time),
            start,
            method="DOP853",
            rtol=1e-13,
            atol=1e-14,
        )
        # DOP853 keeps its error per step below 1e-13, in some ten steps.
        assert np.max(np.abs(state - other.y[:, -1])) < 1e-11 * np.max(np.abs(found))
    return found


class MeasuredOrder(NamedTuple):
    """A slope, with the uncertainty from its change between large and small steps."""

    slope: float
    tolerance: float
    errors: list[float]

    def agrees_with(self, order: int) -> bool:
        """Return whether the slope is this order; a slope too uncertain to tell it from its neighbours is not."""
        return self.tolerance <= 0.4 and abs(self.slope - order) <= self.tolerance


def order_of(steps: list[float], errors: list[float], next_power: int) -> MeasuredOrder:
    """Return the slope at the three smallest of five steps.

    With error = C h^p (1 + a h^q + ...), q = `next_power` (2 for a symmetric scheme, else 1), the slope is p + O(h^q).
    From the three largest steps to the three smallest h falls by a ratio r, so that the remaining deviation is the
    change over (r^q - 1). Added are 0.05 for round-off (at most 1/32 of each error: log2(1 + 1/32) over a factor of 2
    in h) and half of that again for the terms after h^q.
    """
    h, e = np.log(np.array(steps)), np.log(np.array(errors))
    large, small = np.polyfit(h[:3], e[:3], 1)[0], np.polyfit(h[-3:], e[-3:], 1)[0]
    ratio = math.exp(h[1] - h[-2])
    return MeasuredOrder(float(small), 0.075 + abs(small - large) / (ratio**next_power - 1.0), errors)


def step_counts(order: int, coarsest: int = 2) -> list[int]:
    """Return numbers of steps for a scheme of this order, largest first."""
    # Quarter powers of 2 for order 8 and above, where half powers leave too few points above round-off.
    density, finest = (4 if order >= 7 else 2), (9 if order <= 2 else 8)
    powers = range(density * coarsest, density * finest + 1)
    return sorted({round(2 ** (k / density)) for k in powers}, reverse=True)


def five_errors(time: float, counts: list[int], size: float, error_of: Any) -> tuple[list[float], list[float]]:
    """Return the five smallest steps whose errors are above round-off, in ascending order, and these errors."""
    steps: list[float] = []
    errors: list[float] = []
    for count in counts:
        error = float(error_of(count))
        # Round-off of the run, an unbiased walk of some u of size for each step, and that of the reference.
        if error > 32 * U * size * (8 + 2 * math.sqrt(count)):
            steps.insert(0, time / count)
            errors.insert(0, error)
        if len(errors) == 5:
            return steps, errors
    raise AssertionError(f"only {len(errors)} errors above round-off")


def measured_order(method: Any, name: str, symmetric: bool | None = None) -> MeasuredOrder:
    """Measure the order of a scheme on a case."""
    case, exact = all_cases()[name], reference_states(name)
    size = float(np.linalg.norm(exact))
    counts = step_counts(method.order)
    steps, errors = five_errors(
        case.time, counts, size, lambda n: np.linalg.norm(final_states(method, case, n) - exact)
    )
    return order_of(steps, errors, 2 if (method.symmetric if symmetric is None else symmetric) else 1)


class Defect(NamedTuple):
    """A defect, and the bound on what round-off alone could cause."""

    value: float
    bound: float


def poisson_defect(step: Any, x: np.ndarray) -> Defect:
    """Return |P J(x) P^T - J(step(x))| with the exact tangent P, and 64 u times the operations times |P|^2 |J|.

    An entry of P goes through n operations for each elementary flow or evaluation of the field, and 4 n for the
    products of the defect.
    """
    system = step.system
    P, J = step.tangent(x), system.structure_matrix(x)
    defect = P @ J @ P.T - system.structure_matrix(step(x))
    flows = co.integrate(system, x, (0.0, step.h), abs(step.h), step.method, watch=False).stats.evaluations
    operations = (flows + 4) * len(x)
    return Defect(
        float(np.linalg.norm(defect)), 64 * U * operations * float(np.linalg.norm(P) ** 2 * np.linalg.norm(J))
    )


def gradient_of(invariant: Any, x: np.ndarray) -> np.ndarray:
    """Return the gradient, by differences where it is not known."""
    if hasattr(invariant, "gradient"):
        return np.asarray(invariant.gradient(x), dtype=float)
    d = 1e-5 * max(1.0, float(np.abs(x).max()))
    return np.array([(invariant(x + d * unit) - invariant(x - d * unit)) / (2 * d) for unit in np.eye(len(x))])


def drift_bounds(run: co.Solution) -> dict[str, float]:
    """Return, for each invariant, the most that rounding could move it if every rounding went the same way.

    Each of the `evaluations` of the run moves a state by at most 4 n roundings of relative size u, and a move of size d
    changes an invariant by at most |gradient| d; the largest |gradient| |x| along the run is taken. Evaluating the
    invariant itself is one more.
    """
    system = run.system
    n, work = system.dim, run.stats.evaluations + run.stats.steps + 1
    invariants = {"energy": system.hamiltonian, **system.casimirs}
    states = run.x.reshape(-1, n)
    sizes = {
        name: max(float(np.linalg.norm(gradient_of(what, x)) * np.linalg.norm(x)) for x in states)
        for name, what in invariants.items()
    }
    return {name: 4 * n * U * work * size for name, size in sizes.items()}
