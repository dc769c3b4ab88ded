"""Systems with any skew J(x): Lotka-Volterra and a nonholonomic example, and what is refused."""

import numpy as np
import pytest

from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.separable import Separable
from coadjoint.systems.poisson import PoissonSystem

A = np.array([[0.0, 1.0, -2.0], [-1.0, 0.0, 0.5], [2.0, -0.5, 0.0]])


def lotka_volterra(x):
    return np.outer(x, x) * A


def lotka_volterra_slope(x):
    e = np.eye(3)
    return A[:, :, None] * (e[:, None, :] * x[None, :, None] + x[:, None, None] * e[None, :, :])


SUM = Separable({i: (lambda y: y - np.log(y), lambda y: 1 - 1 / y, lambda y: 1 / y**2) for i in range(3)})
# J(x) grad C = x_i sum_j A_ij v_j = 0 with A v = 0.
KERNEL = np.array([0.5, 2.0, 1.0])
LOG = Invariant(lambda x: KERNEL @ np.log(x), lambda x: KERNEL / x)


def test_field_energy_and_casimir():
    system = PoissonSystem(lotka_volterra, SUM, dim=3, casimirs={"C": LOG}, sign=-1)
    x = np.array([0.5, 1.5, 2.0])
    np.testing.assert_allclose(system.vector_field(x), -x * (A @ (x - 1)), rtol=1e-14)
    assert system.energy(x) == pytest.approx(np.sum(x - np.log(x)))
    assert system.casimirs["C"] is LOG
    assert system.algebra is None and system.representation is None and system.parameters is None
    assert system.structure_function is lotka_volterra
    with pytest.raises(TypeError, match="derivative="):
        system.jacobian(x)
    with pytest.raises(TypeError, match="no closed form is known for Poisson system"):
        system.exact(x, 1.0)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("seed", range(4))
def test_field_and_jacobian_of_random_brackets(seed, sign):
    """J_ij = x_i x_j B_ij + (Q x)_k, B and J skew, both at random: against its formula, and complex steps of it."""
    rng = np.random.default_rng(seed)
    B, Q = rng.uniform(-1.0, 1.0, (4, 4)), rng.uniform(-1.0, 1.0, (4, 4, 4))
    B, Q = B - B.T, Q - Q.transpose(1, 0, 2)

    def structure(x):
        return np.outer(x, x) * B + Q @ x

    def derivative(x):
        e = np.eye(4)
        return B[:, :, None] * (e[:, None, :] * x[None, :, None] + x[:, None, None] * e[None, :, :]) + Q

    M = rng.uniform(-1.0, 1.0, (4, 4))
    H = Quadratic(M + M.T, linear=rng.uniform(-1.0, 1.0, 4))
    system = PoissonSystem(structure, H, derivative=derivative, sign=sign)
    x = rng.uniform(0.5, 1.5, 4) * rng.choice([-1.0, 1.0], 4)
    np.testing.assert_allclose(system.vector_field(x), sign * (structure(x) @ H.gradient(x)), rtol=1e-13, atol=1e-13)
    jacobian = system.jacobian(x)
    for i in range(4):
        column = np.imag(system.vector_field(x + 1e-30j * np.eye(4)[i])) / 1e-30
        np.testing.assert_allclose(jacobian[:, i], column, rtol=1e-13, atol=1e-13)


def test_missing_dimension_and_time_are_refused():
    with pytest.raises(TypeError, match="give dim="):
        PoissonSystem(lotka_volterra, Quadratic(1.0))
    with pytest.raises(TypeError, match=r"structure_matrix is a function of \(x, t\)"):
        PoissonSystem(lambda x, t: A, Quadratic(1.0), dim=3)
