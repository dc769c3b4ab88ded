"""Section 4: Lemmas 4.1 (order, symmetry, Poisson property) and 4.2 (Casimirs) and Example 4.1 (rotations on so(3))."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from digests.systems_under_test import cases
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(3)

DIAGONAL = ("so(3), diagonal", "A3,7, diagonal", "sl(2), diagonal", "so(4), diagonal")


def flow(system, i, t, x):
    """Return the flow of (12): x_i is constant, x(t) = exp(t m_ii x_i D_i) x."""
    unit = np.eye(system.dim)[i]
    rate = system.hamiltonian.gradient(x)[i]
    return expm(t * system.sign * rate * system.algebra.coadjoint(unit)) @ x


@pytest.mark.parametrize("case", DIAGONAL)
def test_steps_are_the_printed_products(case):
    """The first-order sweep, its adjoint, and the step of order 2 that they make."""
    system, x, _ = cases()[case]
    there, back = range(system.dim), range(system.dim)[::-1]
    steps = [
        (co.Splitting(order=1, parts="coordinates"), [(there, 0.1)]),
        (co.Splitting(order=1, adjoint=True, parts="coordinates"), [(back, 0.1)]),
        (co.Splitting(order=2, parts="coordinates"), [(there, 0.05), (back, 0.05)]),
    ]
    for method, sweeps in steps:
        expected = x
        for order, h in sweeps:
            for i in order:
                expected = flow(system, i, h, expected)
        found = co.stepper(system, method, 0.1)(x)
        # Two dozen matrix products of at most 6 dimensions, those of expm included.
        assert np.max(np.abs(found - expected)) <= 24 * 64 * U * np.max(np.abs(x))


MASSES = (1.0, 0.5, 1 / 3)
X = np.array([0.7, -1.2, 0.4])


def rotation(i, angle):
    c, s = np.cos(angle), np.sin(angle)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j], R[j, k], R[k, j], R[k, k] = c, -s, s, c
    return R


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
