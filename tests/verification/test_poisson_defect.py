"""P J(x) P^T = J(step(x)) to round-off, with the exact tangent P, exactly for the schemes that declare it."""

import numpy as np
import pytest

import coadjoint as co

from .measures import poisson_defect
from .schemes_under_test import large_step, pairs, schemes, witnesses
from .systems_under_test import all_cases, cases, matrices

pytestmark = pytest.mark.thinned(6)

STEP = 0.1


def step_on(scheme, case):
    return co.stepper(all_cases()[case].system, schemes()[scheme], STEP)


WHERE = {**cases(), **matrices()}
POISSON = [p for p in pairs(WHERE) if schemes()[p[0]].properties(WHERE[p[1]].system).poisson]
NOT_POISSON = [s for s in schemes() if s not in {scheme for scheme, _ in POISSON}]


def test_splitting_is_declared_poisson_on_every_system():
    assert {case for _, case in POISSON} == set(WHERE)
    everywhere = [s for s in schemes() if all((s, case) in POISSON for case in cases())]
    assert {type(schemes()[s]).__name__ for s in everywhere} == {"Splitting", "Composition"}


@pytest.mark.thinned(14)
@pytest.mark.parametrize(("scheme", "case"), POISSON)
def test_poisson_where_declared(scheme, case):
    x0 = WHERE[case].x0
    for x in (x0, -0.7 * x0[::-1]):
        found = poisson_defect(step_on(scheme, case), x)
        assert found.value <= found.bound, found


@pytest.mark.parametrize("scheme", NOT_POISSON)
def test_not_poisson_where_not_declared(scheme):
    """At a step where even a defect of size h^9 is far above round-off."""
    method = schemes()[scheme]
    witness = witnesses(method, "so(4), diagonal")[0]
    found = poisson_defect(co.stepper(witness.system, method, large_step(method)), 1.5 * witness.x0)
    assert found.value > 1000 * found.bound, found


@pytest.mark.thinned(24)
@pytest.mark.parametrize(("scheme", "case"), [p for p in pairs(all_cases()) if "separable" not in p[1]])
def test_tangent_is_the_derivative_of_the_compiled_step(scheme, case):
    """Central differences with one Richardson extrapolation: error O(d^4) plus round-off u/d."""
    step, x = step_on(scheme, case), all_cases()[case].x0
    d = 2.0**-9
    columns = []
    for unit in np.eye(len(x)):
        near, far = ((step(x + s * d * unit) - step(x - s * d * unit)) / (2 * s * d) for s in (1, 2))
        columns.append((4 * near - far) / 3)
    P = step.tangent(x)
    # d^4 = 1.5e-11 times a fifth derivative over 30, here below 1e3; round-off is 2^-53 / d = 6e-14.
    assert np.max(np.abs(np.array(columns).T - P)) < 1e3 * d**4 / 30 * max(1.0, np.max(np.abs(P)))


def affine(*more):
    """Return [e1, e2] = e2 with further brackets."""
    return co.LieAlgebra.from_brackets(6, {(0, 1): {1: 1.0}, **dict(more)})


def nilpotent_and_other_algebras():
    """Return algebras whose brackets are all central, and others, by name."""
    brackets, named = co.LieAlgebra.from_brackets, co.algebras.get
    return {
        "abelian": brackets(3, {}),
        "heisenberg": named("heisenberg(n)", n=2),
        "three generators": brackets(6, {(0, 1): {3: 1.0}, (0, 2): {4: 1.0}, (1, 2): {5: 1.0, 3: -0.5}}),
        "affine": affine(),
        "affine and heisenberg": affine(((2, 3), {4: 1.0})),
        "three steps": brackets(4, {(0, 1): {2: 1.0}, (0, 2): {3: 1.0}}),
        "oscillator": brackets(4, {(0, 1): {2: 1.0}, (0, 2): {1: -1.0}, (1, 2): {3: 1.0}}),
        "se(2)": named("se(n)", n=2),
        "so(4)": named("so(n)", n=4),
    }


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", list(nilpotent_and_other_algebras()))
def test_gauss_is_poisson_where_brackets_are_central(name, seed):
    """J is constant along all motions if and only if [[a, b], c] = 0."""
    rng, algebra = np.random.default_rng([11, seed]), nilpotent_and_other_algebras()[name]
    n = algebra.dim
    algebra = co.algebras.change_of_basis(algebra, np.eye(n, dtype=int)[rng.permutation(n)])
    B = rng.uniform(-0.2, 0.2, (n, n))
    H = co.Quadratic(np.diag(rng.uniform(0.5, 1.0, n)) + B + B.T, linear=rng.uniform(0.2, 0.5, n))
    system, x = co.LiePoissonSystem(algebra, H, sign=(-1, 1)[seed % 2]), rng.uniform(0.5, 1.0, n)
    constants = np.array([system.structure_matrix(unit) for unit in np.eye(n)])  # (k, i, j)
    central = not np.einsum("kij,mkl->ijlm", constants, constants).any()
    halves = co.Composition(co.GaussLegendre(1), (0.5, 0.5))
    for method in (co.GaussLegendre(1), co.GaussLegendre(2), halves):
        found = poisson_defect(co.stepper(system, method, 0.25), x)
        assert method.properties(system).poisson == central
        # The defect is h^3 or h^5 times a derivative of size one.
        assert found.value <= found.bound if central else found.value > 1000 * found.bound, found
