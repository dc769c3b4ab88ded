"""Splittings on all 62 algebras of dimension 2 to 5, with a full positive M, which keeps every orbit bounded."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from coadjoint.algebra.families.low_dimensional import entries, parameters_of
from coadjoint.program.parts.decompose import decompose
from coadjoint.program.parts.squares import complete_squares

from .measures import (
    MeasuredOrder,
    U,
    final_states,
    five_errors,
    gradient_of,
    order_of,
    poisson_defect,
    states_around,
    step_counts,
)
from .systems_under_test import Case, full_matrix

pytestmark = pytest.mark.thinned(3)

# Inside the ranges, and exact as floats.
EXAMPLES = {
    "A3_5": {"a": -0.5},
    "A3_7": {"a": 0.75},
    "A4_2": {"a": -0.5},
    "A4_5": {"a": 0.5, "b": -0.25},
    "A4_6": {"a": 0.75, "b": 0.5},
    "A4_9": {"b": 0.5},
    "A4_11": {"a": 0.5},
    "A5_7": {"a": 0.5, "b": -0.25, "c": 0.75},
    "A5_8": {"c": -0.5},
    "A5_9": {"b": 0.5, "c": -0.75},
    "A5_11": {"c": 0.5},
    "A5_13": {"a": 0.5, "p": 0.25, "s": 1.5},
    "A5_14": {"p": 0.25},
    "A5_15": {"a": 0.5},
    "A5_16": {"p": 0.25, "s": 1.5},
    "A5_17": {"p": 0.25, "q": -0.5, "s": 1.5},
    "A5_18": {"p": 0.25},
    "A5_19": {"a": 1.5, "b": 0.5},
    "A5_20": {"a": 1.5},
    "A5_23": {"b": 0.5},
    "A5_24": {"eps": -1},
    "A5_25": {"p": 0.5, "b": 0.75},
    "A5_26": {"p": 0.5, "eps": 1},
    "A5_28": {"a": 1.5},
    "A5_30": {"a": 0.5},
    "A5_32": {"a": 0.5},
    "A5_33": {"a": 0.5, "b": -0.75},
    "A5_34": {"a": 0.5},
    "A5_35": {"a": 0.5, "b": -0.75},
}
NAMES = list(entries())
STEPS, STEP = 10_000, 2.0**-10
# A3,3: x1 and x2 are multiplied by the same factor in every stage. A5,1: x1 and x2 are at rest and the invariant is
# linear in the others.
PRESERVED_BY_ALL = {("A3_3", "x2/x1"), ("A5_1", "-x1*x4 + x2*x3")}


@cache
def case_of(name: str) -> Case:
    """Return a case with the known invariants; x0 has no small coordinate, where logarithms are undefined."""
    seed = NAMES.index(name)
    algebra = co.algebras.get(name, **EXAMPLES.get(name, {}))
    rng = np.random.default_rng(seed)
    x0 = rng.choice([-1.0, 1.0], algebra.dim) * rng.uniform(0.6, 1.2, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(full_matrix(seed, algebra.dim)), sign=1 - 2 * (seed % 2))
    return Case(system, x0, 0.5)


@cache
def quick_case(name: str) -> Case:
    """Return the case with polynomial invariants only, which determine the parts and need no compilation."""
    system, x0, time = case_of(name)
    polynomials = {k: c for k, c in system.casimirs.items() if isinstance(c, co.Polynomial)}
    quick = co.LiePoissonSystem(system.algebra, system.hamiltonian, system.sign, casimirs=polynomials)
    assert decompose(quick, "auto").choice == decompose(system, "auto").choice
    return Case(quick, x0, time)


@cache
def reference(name: str) -> np.ndarray:
    """Return the final states to about 1e-15 in 32 steps of order 16, confirmed by DOP853 on the vector field."""
    case = quick_case(name)
    found = final_states(co.GaussLegendre(8), case, 32)
    start = states_around(case.x0)[0]
    other = solve_ivp(
        lambda t, x: case.system.vector_field(x, t), (0.0, case.time), start, method="DOP853", rtol=1e-12, atol=1e-13
    )
    # Errors per step below 1e-12, in some ten steps.
    assert np.max(np.abs(found[0] - other.y[:, -1])) < 1e-10 * np.max(np.abs(found))
    return found


def order_on(method: co.Splitting, name: str) -> MeasuredOrder:
    case, exact = quick_case(name), reference(name)
    counts = step_counts(method.order, coarsest=1)
    size = float(np.linalg.norm(exact))
    return order_of(
        *five_errors(case.time, counts, size, lambda n: np.linalg.norm(final_states(method, case, n) - exact)), 2
    )


def test_all_algebras_have_parameters():
    assert len(NAMES) == 62
    assert set(EXAMPLES) == {name for name in NAMES if parameters_of(name)}


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", NAMES)
def test_parts_do_not_exceed_the_squares(name):
    system = case_of(name).system
    M = system.hamiltonian.hessian(np.zeros(system.dim))
    squares = complete_squares(M, np.zeros(system.dim))
    assert 1 <= len(decompose(system, "auto").parts) <= len(squares.weights) == system.dim


def test_commuting_forms_share_parts():
    fewer = [name for name in NAMES if len(decompose(case_of(name).system, "auto").parts) < case_of(name).system.dim]
    assert len(fewer) > 40, fewer


@pytest.mark.thinned(18)
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("name", NAMES)
def test_order_of_splittings(name, order):
    found = order_on(co.Splitting(order=order), name)
    assert found.agrees_with(order), found


@pytest.mark.thinned(20)
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("name", NAMES)
def test_splittings_are_poisson_maps(name, order):
    system, x0, _ = quick_case(name)
    step = co.stepper(system, co.Splitting(order=order), 0.1)
    for x in (x0, -0.7 * x0[::-1]):
        found = poisson_defect(step, x)
        assert found.value <= found.bound, found


def watched_run(name: str, method: co.methods.Method) -> co.Solution:
    """Run ten thousand steps; every invariant must be defined along the run."""
    system, x0, _ = case_of(name)
    for key, casimir in system.casimirs.items():
        assert math.isfinite(casimir(x0)) and np.all(np.isfinite(casimir.gradient(x0))), f"{key} is undefined at x0"
    run = co.integrate(system, x0, (0.0, STEPS * STEP), STEP, method, save_every=STEPS // 100)
    assert all(np.all(np.isfinite(values)) for values in run.casimirs.values())
    return run


def bounds_by_component(run: co.Solution) -> dict[str, float]:
    """Return, for each invariant, the most that rounding could move it if every rounding went the same way.

    As `measures.drift_bounds`, but coordinate by coordinate: on many of these algebras an ideal dies out, and then
    |gradient| |x| grows with the inverse of its coordinates, though none of the others flows into them. A flow
    exp(s D) rounds the coordinate j by at most 4 n u (exp(B) |x|)_j, where B >= |s D| has the zeros of all D of the
    step, and exp(B) <= 1 + B + B^2 + ... (The logarithms themselves are rounded once, by u times at most 745.)
    """
    system = run.system
    n, found = system.dim, decompose(system, "auto")
    M = system.hamiltonian.hessian(np.zeros(n)) - sum(c * C.hessian(np.zeros(n)) for C, c in found.shift)
    squares = complete_squares(np.asarray(M, dtype=float), np.zeros(n))
    forms, weights = np.abs(squares.forms.astype(float)), np.abs(squares.weights.astype(float))
    i, j, k, c = system.algebra.triples
    work, sizes = run.stats.evaluations + run.stats.steps + 1, dict.fromkeys(system.casimirs, 0.0)
    for x in run.x:
        speeds = forms.T @ (weights * (forms @ np.abs(x)))
        generator = np.zeros((n, n))
        np.add.at(generator, (i, k), speeds[j] * np.abs(c))
        np.add.at(generator, (j, k), speeds[i] * np.abs(c))
        B, reached = run.step * generator, np.abs(x)
        assert np.linalg.norm(B) < 0.1  # so that 20 terms are all of the sum
        for _ in range(20):
            reached = np.abs(x) + B @ reached
        for key, casimir in system.casimirs.items():
            sizes[key] = max(sizes[key], float(np.abs(gradient_of(casimir, x)) @ reached))
    return {key: 4 * n * U * work * size for key, size in sizes.items()}


@pytest.mark.thinned(8)
@pytest.mark.parametrize("name", NAMES)
def test_invariants_over_ten_thousand_steps(name):
    """Drifts are over every step; an explicit scheme shows that every bound can be exceeded."""
    run = watched_run(name, co.Splitting(order=2))
    bounds, drifts = bounds_by_component(run), run.drift()
    assert len(run.casimirs) == run.system.dim - run.system.algebra.generic_rank()
    for key in run.casimirs:
        assert drifts[key] <= bounds[key], (key, float(drifts[key]), bounds[key])
    # An explicit scheme of the same order and step loses all but what every scheme keeps: linear ones.
    system, x0, _ = case_of(name)
    control = co.integrate(system, x0, run.t_span, STEP, co.ExplicitRungeKutta("runge2"), save_every=STEPS).drift()
    for key, casimir in system.casimirs.items():
        linear = isinstance(casimir, co.Polynomial) and casimir.degree == 1
        assert (control[key] > 5 * bounds[key]) != (linear or (name, key) in PRESERVED_BY_ALL), (
            key,
            float(control[key]),
        )
