"""Estimated errors of runs are within a factor of 10, or both are at the level of rounding."""

from __future__ import annotations

import numpy as np
import pytest

import coadjoint as co

from .explicit_systems import LONG, many_digits, written_out
from .random_systems import ALGEBRAS, drawn

pytestmark = pytest.mark.thinned(3)

ACCURACIES = (1e-3, 1e-6, 1e-9, 1e-12)
FACTOR = 10.0


def check_estimate(sol: co.Solution, exact: np.ndarray, largest: float) -> None:
    """Compare an estimate with the error; both may lie below the expected rounding."""
    error, estimate = np.linalg.norm(sol.x[-1] - exact) / largest, sol.error_estimate()
    assert error / FACTOR <= estimate <= FACTOR * max(error, sol.choice.roundoff), (
        f"{estimate:.1e} for {error:.1e}: {sol.choice}"
    )


@pytest.mark.thinned(18)
@pytest.mark.parametrize("methods", [None, co.Splitting(order=6), co.GaussLegendre(3)], ids=str)
@pytest.mark.parametrize("name", written_out())
def test_estimate_on_explicit_systems(name, methods):
    case = written_out()[name]
    for x0 in case.starts:
        exact, largest = many_digits(case.field, x0, case.time)
        for accuracy in ACCURACIES[: 3 if methods else 4]:
            check_estimate(
                co.integrate(case.system, x0, (0, case.time), accuracy=accuracy, method=methods), exact, largest
            )


def plain_field(system: co.LiePoissonSystem):
    """Return x' = sign J(x) grad H(x) in any number type, from the structure constants and a quadratic H."""
    n = system.dim
    M = [[LONG(float(v)) for v in row] for row in system.hamiltonian.hessian(np.zeros(n))]
    linear = [LONG(float(v)) for v in system.hamiltonian.gradient(np.zeros(n))]
    rows = [(int(i), int(j), int(k), LONG(float(c))) for i, j, k, c in zip(*system.algebra.triples, strict=True)]

    def field(x):
        u = [sum((m * v for m, v in zip(row, x, strict=True)), start=b) for row, b in zip(M, linear, strict=True)]
        out = [LONG(0.0)] * n
        for i, j, k, c in rows:
            out[i], out[j] = out[i] + c * x[k] * u[j], out[j] - c * x[k] * u[i]
        return system.sign * np.array(out)

    return field


@pytest.mark.thinned(16)
@pytest.mark.parametrize("time", [6.0, -3.0])
@pytest.mark.parametrize("name", ALGEBRAS)
def test_estimate_on_random_systems(name, time):
    """On algebras that are not unimodular, motions grow and decay by some orders of magnitude."""
    for seed in range(2):
        system, x0 = drawn(name, 10 + seed, (-1) ** seed)
        exact, largest = many_digits(plain_field(system), x0, time)
        for accuracy in ACCURACIES:
            check_estimate(co.integrate(system, x0, (0, time), accuracy=accuracy), exact, largest)


@pytest.mark.parametrize("time", [30.0, -12.0])
@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_estimate_on_growing_and_decaying_motions(rate, time):
    """x1' = -rate x1 beside a turn of x2 and x3 that x1 drives, by 13 orders of magnitude up or down."""
    brackets = {(0, 1): {1: rate, 2: 1.0}, (0, 2): {2: rate, 1: -1.0}}
    system = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(3, brackets), co.Quadratic([0.5, 0.1, 0.0], linear=[1.0, 0.0, 0.0])
    )
    x0 = np.array([0.1, 1e-3, 2e-3])
    exact, largest = many_digits(plain_field(system), x0, time)
    for accuracy in (1e-3, 1e-6, 1e-9):
        check_estimate(co.integrate(system, x0, (0, time), accuracy=accuracy), exact, largest)
    # A splitting takes a single step here, of which the error does not follow the order.
    check_estimate(co.integrate(system, x0, (0, time), accuracy=1e-2, method="Splitting"), exact, largest)


@pytest.mark.parametrize("gap", [1e-3, 1e-6])
def test_estimate_near_a_separatrix(gap):
    body, time = co.systems.rigid_body(inertia=(1, 2, 3)), 60.0
    exact, largest = many_digits(plain_field(body), np.array([gap, 1.0, 0.0]), time)
    for accuracy in (1e-3, 1e-6, 1e-8):
        check_estimate(co.integrate(body, (gap, 1.0, 0.0), (0, time), accuracy=accuracy), exact, largest)


def test_estimate_over_thousands_of_turns():
    body, x0, time = co.systems.rigid_body(inertia=(1, 2, 3)), np.array([0.05, 1.0, 0.02]), 20000.0
    for accuracy in (1e-3, 1e-6, 1e-9):
        sol = co.integrate(body, x0, (0, time), accuracy=accuracy, save_every=10**9, watch=False)
        check_estimate(sol, body.exact(x0, time), float(np.linalg.norm(x0)))
