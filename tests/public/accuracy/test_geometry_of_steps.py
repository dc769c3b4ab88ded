"""Geometry of steps: group elements of every scheme, and Gauss methods, Poisson maps where all brackets are central."""

import numpy as np
import pytest

import coadjoint as co
from matrix.references import poisson_defect

pytestmark = pytest.mark.thinned(6)


def nilpotent_and_other_algebras():
    """Return algebras whose brackets are all central, and others, by name."""
    brackets, named = co.LieAlgebra.from_brackets, co.algebras.get
    return {
        "abelian": brackets(3, {}),
        "heisenberg": named("heisenberg(n)", n=2),
        "three generators": brackets(6, {(0, 1): {3: 1.0}, (0, 2): {4: 1.0}, (1, 2): {5: 1.0, 3: -0.5}}),
        "affine": brackets(6, {(0, 1): {1: 1.0}}),
        "affine and heisenberg": brackets(6, {(0, 1): {1: 1.0}, (2, 3): {4: 1.0}}),
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
        work = co.integrate(system, x, (0.0, 0.25), 0.25, method).stats.evaluations
        defect, bound = poisson_defect(co.stepper(system, method, 0.25), x, work)
        assert method.properties(system).poisson == central
        # The defect is h^3 or h^5 times a derivative of size one.
        assert defect <= bound if central else defect > 1000 * bound
