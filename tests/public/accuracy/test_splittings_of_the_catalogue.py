"""Splittings on all 62 algebras of dimension 2 to 5, with a full positive M, which keeps every orbit bounded."""

import math
from functools import cache

import numpy as np
import pytest

import coadjoint as co
from catalogue_cases import EXAMPLES, NAMES
from digests.systems_under_test import Case, full_matrix
from matrix.references import rounding_of

pytestmark = pytest.mark.thinned(3)

STEPS, STEP = 2_000, 2.0**-10
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


def test_all_algebras_are_there():
    assert len(NAMES) == 62 and set(EXAMPLES) <= set(NAMES)


@pytest.mark.thinned(8)
@pytest.mark.parametrize("name", NAMES)
def test_invariants_of_two_thousand_steps(name):
    """To rounding; an explicit scheme of the same order loses all invariants but those that every scheme keeps."""
    system, x0, _ = case_of(name)
    for key, casimir in system.casimirs.items():
        assert math.isfinite(casimir(x0)) and np.all(np.isfinite(casimir.gradient(x0))), f"{key} is undefined at x0"
    assert len(system.casimirs) == system.dim - system.algebra.generic_rank()
    run, control = (
        co.integrate(system, x0, (0.0, STEPS * STEP), STEP, method, save_every=STEPS // 100)
        for method in (co.Splitting(order=2), co.ExplicitRungeKutta("runge2"))
    )
    assert all(np.all(np.isfinite(values)) for values in run.casimirs.values())
    bounds = rounding_of(run)
    for key, casimir in system.casimirs.items():
        assert run.drift()[key] <= bounds[key], key
        kept = (isinstance(casimir, co.Polynomial) and casimir.degree == 1) or (name, key) in PRESERVED_BY_ALL
        assert (control.drift()[key] > 100 * run.drift()[key] + 1e-10) != kept, key
