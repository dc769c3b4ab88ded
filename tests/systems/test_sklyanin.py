"""Sklyanin's bracket: quadratic, of Poisson, and a free body with its own clock."""

import mpmath as mp
import numpy as np
import pytest
from two_steps import assert_bounded_by_order, assert_order

import coadjoint as co

J, M = (1.0, 2.5, 4.0), (1.0, 0.5, 2.0, 1.5)
X0 = np.array([0.9, 0.7, -1.1, 0.4])


def by_hand(x, J=J, M=M):
    a, b, c, d = x
    j = (J[1] - J[2], J[2] - J[0], J[0] - J[1])
    g = [m * y for m, y in zip(M, x, strict=True)]
    return [
        -j[0] * c * d * g[1] - j[1] * d * b * g[2] - j[2] * b * c * g[3],
        j[0] * c * d * g[0] - a * d * g[2] + a * c * g[3],
        j[1] * d * b * g[0] - a * b * g[3] + a * d * g[1],
        j[2] * b * c * g[0] - a * c * g[1] + a * b * g[2],
    ]


def test_field_and_derivative():
    system = co.systems.sklyanin(J, M)
    np.testing.assert_allclose(system.vector_field(X0), by_hand(X0), rtol=0, atol=2e-15)
    h = 1e-6
    shifts = [(np.array(by_hand(X0 + h * e)) - by_hand(X0 - h * e)) / (2 * h) for e in np.eye(4)]
    np.testing.assert_allclose(system.jacobian(X0), np.transpose(shifts), rtol=0, atol=1e-9)  # u / h and h^2


def test_jacobi_identity_and_casimirs_as_polynomials():
    """In whole numbers, as polynomials: the bracket of every three coordinates, and of the Casimirs with each."""
    x = [co.Polynomial.variable(i, 4) for i in range(4)]
    j = (-3, 6, -3)  # of J = (2, 5, 8)
    table = {(1, 0): j[0] * (x[2] * x[3]), (2, 0): j[1] * (x[3] * x[1]), (3, 0): j[2] * (x[1] * x[2])}
    table |= {(1, 2): -(x[0] * x[3]), (2, 3): -(x[0] * x[1]), (3, 1): -(x[0] * x[2])}
    table |= {(k, i): -p for (i, k), p in table.items()}
    zero = co.Polynomial({}, dim=4)
    system = co.systems.sklyanin((2.0, 5.0, 8.0), M)
    matrix = system.structure_matrix(X0)
    for i in range(4):
        for k in range(4):
            assert matrix[i, k] == pytest.approx(table[i, k](X0) if i != k else 0.0, abs=1e-15)

    def bracket(f, g):
        total = zero
        for (i, k), p in table.items():
            total = total + f.derivative(i) * p * g.derivative(k)
        return total

    for a in range(4):
        for b in range(4):
            for c in range(4):
                sums = [bracket(x[p], bracket(x[q], x[r])) for p, q, r in ((a, b, c), (b, c, a), (c, a, b))]
                assert sums[0] + sums[1] + sums[2] == zero
    for casimir in system.casimirs.values():
        assert all(bracket(casimir, one) == zero for one in x)


def test_energy_orders_and_wandering_casimirs():
    system = co.systems.sklyanin(J, M)
    with mp.workdps(20):
        motion = mp.odefun(lambda t, x: by_hand(x), 0, [mp.mpf(v) for v in X0])
        wanted = np.array([float(v) for v in motion(1)])
    for method in (co.GaussLegendre(stages=1), co.GaussLegendre(stages=2)):
        assert_order(system, X0, 1.0, 0.1, method, wanted)
    run = co.integrate(system, X0, (0.0, 50.0), 0.1, co.GaussLegendre(stages=1))
    # quadratic invariants: of the energy and of both Casimirs rounding alone is left, 500 steps of it
    assert set(run.drift()) == {"energy", "x1^2 + x2^2 + x3^2", "x0^2 + J.x^2"}
    assert all(value < 500 * 1e-15 for value in run.drift().values())
    frozen = co.ModifiedGaussLegendre(stages=1, iterations=2, freeze="structure")
    assert co.integrate(system, X0, (0.0, 50.0), 0.1, frozen).drift()["energy"] < 500 * 1e-15
    for casimir in system.casimirs.values():
        assert_bounded_by_order(casimir, system, X0, 2.0, 0.05, frozen)
    with pytest.raises(ValueError, match="Lie algebra"):
        co.integrate(system, X0, (0.0, 1.0), 0.1, co.Splitting(order=2))


@pytest.mark.parametrize("masses", [(1.0, 0.0, 0.0, 0.0), (0.3, 2.0, 2.0, 2.0), (-1.0, 1.5, 3.0, 4.5)])
def test_closed_form_where_the_clock_is_constant(masses):
    system = co.systems.sklyanin(J, masses)
    with mp.workdps(20):
        motion = mp.odefun(lambda t, x: by_hand(x, M=masses), 0, [mp.mpf(v) for v in X0])
        wanted = np.array([float(v) for v in motion(1)])
    np.testing.assert_allclose(system.exact(X0, 1.0), wanted, rtol=0, atol=4e-15)
    np.testing.assert_allclose(system.exact([0.0, *X0[1:]], 5.0), [0.0, *X0[1:]], rtol=0, atol=1e-15)


def test_no_closed_form_and_wrong_values():
    with pytest.raises(TypeError, match="no closed form is known for sklyanin"):
        co.systems.sklyanin(J, M).exact(X0, 1.0)
    with pytest.raises(ValueError, match="leave the range of float64"):
        co.systems.sklyanin((1e308, -1e308, 0.0))
    with pytest.raises(ValueError, match="leave the range of float64"):
        co.systems.sklyanin((1e308, 0.0, 0.0), (1e10, 1.0, 1.0, 1.0))
