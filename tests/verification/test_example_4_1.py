"""Example 4.1: vector fields, rotations and composition on so(3), orthogonality, and the Poisson condition."""

import numpy as np
import pytest

import coadjoint as co

from .measures import U, poisson_defect

MASSES = (1.0, 0.5, 1 / 3)
X = np.array([0.7, -1.2, 0.4])


def only(i, masses=MASSES):
    """Return the system with H = m_ii x_i^2 / 2."""
    return co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(np.where(np.arange(3) == i, masses, 0.0)))


@pytest.mark.parametrize("i", range(3))
def test_printed_vector_fields(i):
    x, m = X, MASSES
    printed = [
        m[0] * x[0] * np.array([0, -x[2], x[1]]),
        m[1] * x[1] * np.array([x[2], 0, -x[0]]),
        m[2] * x[2] * np.array([-x[1], x[0], 0]),
    ]
    assert np.max(np.abs(only(i).vector_field(x) - printed[i])) <= 4 * U


def rotation(i, angle):
    c, s = np.cos(angle), np.sin(angle)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


@pytest.mark.parametrize("i", range(3))
@pytest.mark.parametrize("t", [0.1, 1.0, 7.0, -2.5])
def test_flows_are_rotations_in_closed_form(i, t):
    closed = rotation(i, t * MASSES[i] * X[i]) @ X
    flow = co.stepper(only(i), co.Splitting(order=1), t)(X)
    assert np.max(np.abs(flow - closed)) <= 16 * U * np.linalg.norm(X)


def test_printed_composition_is_orthogonal():
    h, x, B = 0.1, X, np.eye(3)
    for i, fraction in ((0, 0.5), (1, 0.5), (2, 1.0), (1, 0.5), (0, 0.5)):
        R = rotation(i, fraction * h * MASSES[i] * x[i])
        x, B = R @ x, R @ B
    body = co.systems.paper_rigid_body()
    step = co.stepper(body, co.Splitting(order=2, parts="coordinates"), h)
    assert np.max(np.abs(step(X) - x)) <= 64 * U
    assert np.max(np.abs(B.T @ B - np.eye(3))) <= 64 * U
    # The group element of the step is B^T: A_(k+1) = A_k B^T.
    assert np.max(np.abs(step.group(X) - B.T)) <= 64 * U


def test_orthogonality_does_not_imply_the_poisson_property():
    """The implicit midpoint rule on so(3) is I-orthogonal (Example 3.1), but no Poisson map."""
    step = co.stepper(co.systems.paper_rigid_body(), co.GaussLegendre(1), 0.1)
    assert abs(np.linalg.norm(step(X)) - np.linalg.norm(X)) <= 8 * U
    found = poisson_defect(step, X)
    assert found.value > 1000 * found.bound
