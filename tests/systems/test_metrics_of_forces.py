"""Metrics of damping and heat baths: roots of every semidefinite one, and refusal of every other."""

import itertools

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.forces.rates import apply_metric, metric_root

ORDERS = list(itertools.permutations(range(3)))


def block(*rows):
    return np.array(rows, dtype=float)


SEMIDEFINITE = {
    "zero": np.zeros((3, 3)),
    "one direction": np.outer([1.0, -2.0, 0.5], [1.0, -2.0, 0.5]),
    "a coordinate left out": block([0, 0, 0], [0, 2, 1], [0, 1, 1]),
    "two equal rows": block([1, 1, 0], [1, 1, 0], [0, 0, 3]),
    "definite": block([2, -1, 0.5], [-1, 3, 0.25], [0.5, 0.25, 1]),
}
INDEFINITE = {
    "zeros on the diagonal": block([0, 1, 0], [1, 0, 0], [0, 0, 1]),
    "a zero on the diagonal": block([0, 1, 0], [1, 5, 0], [0, 0, 1]),
    "a negative number": block([1, 0, 0], [0, -1, 0], [0, 0, 1]),
    "a small negative number": block([1, 0, 0], [0, 1, 0], [0, 0, -1e-10]),
    "a negative eigenvalue": block([1, 2, 0], [2, 1, 0], [0, 0, 1]),
    "a negative eigenvalue of all": block([1, 0.75, 0.75], [0.75, 1, -0.75], [0.75, -0.75, 1]),
    "a pivot that vanishes with entries below": block([1, 1, 0], [1, 1, 0.5], [0, 0.5, 1]),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("scale", [1.0, 2.0**-200, 2.0**200])
@pytest.mark.parametrize("name", SEMIDEFINITE)
def test_the_root_times_its_transpose_is_the_metric(name, scale, order):
    P = scale * SEMIDEFINITE[name][np.ix_(order, order)]
    L = metric_root(tuple(map(tuple, P.tolist())), "metric")
    assert not np.triu(L, 1).any()
    # A pivot below 64 n u of the largest entry is taken as zero.
    assert np.abs(L @ L.T - P).max() <= 64 * 3 * 3 * 2.0**-53 * np.abs(P).max()
    co.forces.DoubleBracketDamping(0.1, P)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("scale", [1.0, 2.0**-200, 2.0**200])
@pytest.mark.parametrize("name", INDEFINITE)
def test_a_metric_that_feeds_energy_in_is_refused(name, scale, order):
    P = scale * INDEFINITE[name][np.ix_(order, order)]
    assert np.linalg.eigvalsh(P)[0] < -1e-11 * np.abs(P).max()
    for make in (co.forces.DoubleBracketDamping, lambda *given: co.forces.HeatBath(*given, temperature=1.0, seed=1)):
        with pytest.raises(ValueError, match="is not positive semidefinite; damping would feed energy in"):
            make(0.1, P)


@pytest.mark.parametrize("order", ORDERS)
def test_diagonal_metrics_and_matrices_that_are_not_symmetric(order):
    with pytest.raises(ValueError, match=r"has the negative entry -0\.5"):
        co.forces.DoubleBracketDamping(0.1, np.array([1.0, -0.5, 2.0])[list(order)])
    with pytest.raises(ValueError, match="has the negative entry -2"):
        co.forces.DoubleBracketDamping(0.1, -2.0)
    P = SEMIDEFINITE["definite"][np.ix_(order, order)].copy()
    P[order[0], order[1]] += 1e-9
    with pytest.raises(ValueError, match="is not symmetric"):
        co.forces.DoubleBracketDamping(0.1, P)
    diagonal = np.array([4.0, 0.0, 0.25])[list(order)]
    np.testing.assert_array_equal(metric_root(tuple(diagonal.tolist()), "metric"), np.sqrt(diagonal))
    y = np.array([1.0, -2.0, 3.0])
    for metric, dense in ((2.0, 2.0 * np.eye(3)), (diagonal, np.diag(diagonal)), (P, P)):
        np.testing.assert_array_equal(apply_metric(metric, y), dense @ y)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", SEMIDEFINITE)
def test_damping_by_the_dense_formula(name, sign):
    """x' = alpha J P J grad H; its power is minus alpha f . P f, of the field f without it."""
    P, x, alpha = SEMIDEFINITE[name], np.array([0.7, -0.4, 1.1]), 0.3
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 2.0, 3.5], linear=[0.1, 0.0, -0.2]), sign=sign)
    J, slope = system.structure_matrix(x), np.array([1.0, 2.0, 3.5]) * x + [0.1, 0.0, -0.2]
    damped = system.with_forces(co.forces.DoubleBracketDamping(alpha, P))
    found = damped.vector_field(x) - system.vector_field(x)
    np.testing.assert_allclose(found, alpha * J @ P @ J @ slope, rtol=0, atol=2.0**-48)
    f = J @ slope
    assert damped.power(x)["DoubleBracketDamping"] == pytest.approx(-alpha * f @ P @ f, rel=1e-13, abs=1e-15)
