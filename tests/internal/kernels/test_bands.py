"""The band of the Jacobian of stages, and loops with and without it."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.tables import runge_kutta
from coadjoint.kernels.tables.runge_kutta import MAX_HALF_BANDWIDTH, MAX_MEAN_COUPLINGS, narrow_band

SITES = 40


def chain(seed, across=0):
    """Spins of which each is coupled to its neighbours, in a drawn numbering; with so many other couplings."""
    rng, n = np.random.default_rng(seed), 3 * SITES
    M = np.diag(rng.uniform(0.5, 1.5, n))
    for k in range(n - 3):
        M[k, k + 3] = M[k + 3, k] = rng.uniform(0.1, 0.3)
    for k, l in rng.integers(0, n, (across, 2)):
        M[k, l] = M[l, k] = 0.5
    place = rng.permutation(n)
    i, j, k, c = co.algebras.copies(co.algebras.so(3), SITES).triples
    brackets = {}
    for a, b, to, value in zip(place[i], place[j], place[k], c, strict=True):
        brackets.setdefault((int(a), int(b)), {})[int(to)] = float(value)
    mixed = np.empty_like(M)
    mixed[np.ix_(place, place)] = M
    g = co.LieAlgebra.from_brackets(n, brackets)
    return co.LiePoissonSystem(g, co.Quadratic(mixed, linear=rng.standard_normal(n)), -1, casimirs={})


def jacobians(system, x):
    """Return the matrices of the three solvers, up to signs, from the vector field by its parts."""
    whole, bends = system.jacobian(x), system.sign * system.structure_matrix(x) @ system.hamiltonian.hessian(x)
    return {"implicit": whole, "structure": bends, "gradient": whole - bends}


@pytest.mark.parametrize("seed", [1, 2])
def test_every_entry_lies_in_the_band(seed):
    system = chain(seed)
    x = np.random.default_rng(9).standard_normal(system.dim)
    for solver, matrix in jacobians(system, x).items():
        band, position = narrow_band(system, 2, solver)
        assert sorted(position.tolist()) == list(range(system.dim))
        rows, columns = np.nonzero(np.abs(matrix) > 1e-12)
        apart = np.abs(position[rows].astype(int) - position[columns].astype(int))
        # No wider than the entries need, and as narrow as a chain of triples with neighbours allows.
        assert apart.max() == band and 0 < band <= (2 if solver == "gradient" else 12), solver


def test_wide_patterns_have_no_band():
    assert narrow_band(chain(3, across=200), 2, "implicit")[0] == -1
    # With more stages the same band is too wide.
    system = chain(1)
    band, _ = narrow_band(system, 2, "implicit")
    most = (MAX_HALF_BANDWIDTH + 1) // (band + 1)
    assert narrow_band(system, most, "implicit")[0] == band and narrow_band(system, most + 1, "implicit")[0] == -1
    n = MAX_MEAN_COUPLINGS + 20
    g = co.algebras.copies(co.algebras.heisenberg(1), n // 3)
    full = co.LiePoissonSystem(g, co.Quadratic(np.ones((g.dim, g.dim)) + np.eye(g.dim)), casimirs={})
    assert narrow_band(full, 1, "implicit")[0] == -1


def test_steps_with_a_band_and_without_a_matrix_agree(monkeypatch):
    """At steps of h f' = 6, to what solving the stages amplifies."""
    system, h, method = chain(1), 2.0, co.GaussLegendre(2)
    x0 = np.random.default_rng(9).standard_normal(system.dim)
    banded = co.integrate(system, x0, (0.0, h), h, method)
    monkeypatch.setattr(runge_kutta, "MAX_HALF_BANDWIDTH", 0)
    assert narrow_band(system, 2, "implicit")[0] == -1
    krylov = co.integrate(system, x0, (0.0, h), h, method)
    assert np.abs(banded.x[-1] - krylov.x[-1]).max() < 1e-11 and banded.stats.iterations > 16
