"""Splittings of many coordinates: right motions, Casimirs by name, and what is too much is refused at once."""

import numpy as np
import pytest
from scipy.sparse import diags_array

import coadjoint as co
from guards import bounded_work
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

SO3 = co.algebras.so(3)


def symmetric(rng, n):
    M = rng.normal(size=(n, n))
    return M + M.T + np.diag(rng.normal(size=n))


@pytest.mark.long
@pytest.mark.parametrize("order", long_beyond(1, [2, 4]))
def test_many_coupled_coordinates_move_rightly(order):
    algebra, rng = co.algebras.su(9), np.random.default_rng(2)  # 80 coordinates, above every bound of what is small
    system = co.LiePoissonSystem(algebra, co.Quadratic(symmetric(rng, algebra.dim) / 20))
    x = rng.normal(size=algebra.dim) / 3
    expected = co.integrate(system, x, (0.0, 0.25), 1 / 64, co.GaussLegendre(4)).x[-1]
    errors = [
        np.abs(co.integrate(system, x, (0.0, 0.25), h, co.Splitting(order=order)).x[-1] - expected).max()
        for h in (1 / 32, 1 / 64)
    ]
    assert 2 ** (order - 0.7) < errors[0] / errors[1] < 2 ** (order + 0.7)


@pytest.mark.parametrize(
    ("algebra", "count", "method"),
    [("su(32)", 1023, co.Splitting(order=2)), ("so(45)", 990, co.Splitting(order=4, parts="coordinates"))],
)
def test_what_takes_minutes_is_refused_at_once(algebra, count, method):
    g = co.algebras.get(algebra)
    system = co.LiePoissonSystem(g, co.Quadratic(symmetric(np.random.default_rng(7), g.dim)))
    for call in (
        lambda: method.properties(system),
        lambda: co.prepare(system, method, 0.1),
        lambda: co.integrate(system, np.ones(g.dim), (0, 1), 0.1, method),
    ):
        with bounded_work(30.0), refused(ValueError, "Splitting", f"{count} flows", "GaussLegendre"):
            call()
    assert co.GaussLegendre(2).properties(system).energy


@pytest.mark.long
def test_terms_that_would_take_days_are_refused_at_once():
    g = co.algebras.su(9)
    system = co.LiePoissonSystem(g, co.Quadratic(symmetric(np.random.default_rng(1), g.dim)))
    with bounded_work(), refused(ValueError, "products of monomials", "a lower order"):
        co.modified_hamiltonian(system, co.Splitting(order=2), order=4)
    assert list(co.modified_hamiltonian(system, co.Splitting(order=2), order=2).terms) == [0]


def test_casimirs_of_many_copies_are_followed_by_name():
    count = 3000
    bonds = np.tile((0.1, 0.1, 0.2), count)[3:]
    energy = co.Quadratic(diags_array([np.tile((1.0, 0.5, 0.25), count), bonds, bonds], offsets=[0, 3, -3]))
    first = diags_array(np.r_[np.ones(3), np.zeros(3 * count - 3)]).tocsr()
    first.eliminate_zeros()
    algebra, named = co.algebras.copies(SO3, count), {"spin 1": co.Quadratic(first), "all": co.Quadratic(1.0)}
    assert co.LiePoissonSystem(algebra, energy).casimirs == {}
    x0 = np.random.default_rng(0).standard_normal(3 * count)
    system = co.LiePoissonSystem(algebra, energy, casimirs=named)
    sol = co.integrate(system, x0, (0.0, 1.0), 0.1, observe={"half of spin 1": co.Quadratic(0.5 * first)})
    assert sol.casimirs["spin 1"][0] == pytest.approx(0.5 * x0[:3] @ x0[:3], rel=8 * U)
    # Ten steps of five rotations each may change a length by some roundings of each.
    assert sol.drift()["spin 1"] < 200 * U * (x0[:3] @ x0[:3])
    assert sol.drift()["all"] < 200 * U * (x0 @ x0)
    assert np.array_equal(2 * sol.observed["half of spin 1"], sol.casimirs["spin 1"])
    with refused(ValueError, "'x1'", "Casimir"):
        co.LiePoissonSystem(SO3, co.Quadratic(1.0), casimirs={"x1": co.Quadratic([1.0, 0.0, 0.0])})


def test_a_constant_hamiltonian_moves_nothing():
    sol = co.integrate(co.LiePoissonSystem(SO3, co.Quadratic(0.0)), (1.0, 2.0, 3.0), (0, 1), 0.1, attitude=True)
    assert np.array_equal(sol.x, np.tile([1.0, 2.0, 3.0], (11, 1)))
    assert np.array_equal(sol.attitude[-1], np.eye(3))
