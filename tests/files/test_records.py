"""Records of random systems contain everything on which motion and energy depend."""

import json
from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.records.records import record_of, system_of


def quadratic(rng, n):
    B = rng.uniform(-1.0, 1.0, (n, n))
    return co.Quadratic(B + B.T, linear=rng.uniform(-1.0, 1.0, n), constant=float(rng.uniform(1.0, 2.0)))


def polynomial(rng, n):
    monomials = {tuple(int(e) for e in rng.integers(0, 3, n)): float(rng.uniform(0.5, 1.0)) for _ in range(4)}
    return co.Polynomial({**monomials, (0,) * n: 1.25, (1,) + (0,) * (n - 1): Fraction(1, 3)})


def pieces(rng, n):
    """Return pieces of commuting coordinates in random order: [e_i, e_j] = 0 among the translations of e(3)."""
    own = [((5, 3), quadratic(rng, 2)), ((4,), polynomial(rng, 1))]
    return co.SplitHamiltonian([own[i] for i in rng.permutation(2)] + [((i,), quadratic(rng, 1)) for i in range(3)])


KINDS = {
    "quadratic": quadratic,
    "one number": lambda rng, n: co.Quadratic(float(rng.uniform(0.5, 1.0)), constant=-2.5),
    "polynomial": polynomial,
    "pieces": pieces,
}


@pytest.mark.thinned(8)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("seed", range(3))
def test_random_systems_are_rebuilt(kind, sign, seed):
    rng = np.random.default_rng(seed)
    algebra = co.algebras.e(3)
    n = algebra.dim
    turn = np.eye(4) + np.triu(rng.integers(-2, 3, (4, 4)).astype(float), 1)
    rho = np.linalg.inv(turn).round() @ algebra.representation @ turn
    casimirs = {"p": co.Polynomial({tuple(2 * int(i == k) for i in range(n)): Fraction(1, 3) for k in (3, 4, 5)})}
    # The name of a ready-made system does not make it one.
    name = ("own", "rigid_body", "heavy_top")[seed]
    system = co.LiePoissonSystem(
        algebra, KINDS[kind](rng, n), sign=sign, casimirs=casimirs, representation=rho, name=name
    )
    again = system_of(json.loads(json.dumps(record_of(system))))
    assert (again.sign, again.name, again.dim) == (sign, name, n)
    assert again.algebra == algebra and again.algebra.basis == algebra.basis
    assert np.array_equal(again.representation, rho) and not np.array_equal(rho, rho.transpose(0, 2, 1))
    assert again.casimirs == casimirs
    assert {type(c) for c in again.casimirs["p"].monomials.values()} == {Fraction}
    for x in rng.uniform(-1.0, 1.0, (3, n)):
        assert again.energy(x) == system.energy(x)
        assert np.array_equal(again.vector_field(x), system.vector_field(x))
        assert np.array_equal(again.hamiltonian.hessian(x), system.hamiltonian.hessian(x))
    assert system.energy(np.zeros(n)) != 0.0
    method = co.Splitting() if kind != "polynomial" else co.GaussLegendre(2)
    one, two = (
        co.integrate(s, np.full(n, 0.25), (0.0, 0.5), 0.125, method, attitude="coadjoint") for s in (system, again)
    )
    assert np.array_equal(one.x, two.x) and np.array_equal(one.energy, two.energy)
    assert np.array_equal(one.attitude, two.attitude)
