"""Lemma 4.1: the symmetric product of the flows of x_i m_ii J_i(x) is of order 2, symmetric and Lie-Poisson."""

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co

from .measures import U
from .systems_under_test import cases, full_matrix

pytestmark = pytest.mark.thinned(3)

DIAGONAL = ("so(3), diagonal", "A3,7, diagonal", "sl(2), diagonal", "so(4), diagonal")


def flow(system, i, t, x):
    """Return the flow of (12): x_i is constant, x(t) = exp(t m_ii x_i D_i) x."""
    unit = np.eye(system.dim)[i]
    rate = system.hamiltonian.gradient(x)[i]
    return expm(t * system.sign * rate * system.algebra.coadjoint(unit)) @ x


def printed_product(system, h, x):
    for i in [*range(system.dim), *reversed(range(system.dim))]:
        x = flow(system, i, h / 2, x)
    return x


def roundoff(x):
    """Return the rounding of two dozen matrix products of at most 6 dimensions, those of expm included."""
    return 24 * 64 * U * np.max(np.abs(x))


@pytest.mark.parametrize("case", DIAGONAL)
def test_step_is_the_printed_product(case):
    system, x, _ = cases()[case]
    step = co.stepper(system, co.Splitting(order=2, parts="coordinates"), 0.1)
    for _ in range(5):
        new = step(x)
        assert np.max(np.abs(new - printed_product(system, 0.1, x))) <= roundoff(x)
        x = new


@pytest.mark.parametrize("case", DIAGONAL)
def test_first_order_sweep_and_its_adjoint(case):
    system, x, _ = cases()[case]
    sweep = adjoint = x
    for i in range(system.dim):
        sweep, adjoint = flow(system, i, 0.1, sweep), flow(system, system.dim - 1 - i, 0.1, adjoint)
    for given, by_hand in ((False, sweep), (True, adjoint)):
        step = co.stepper(system, co.Splitting(order=1, adjoint=given, parts="coordinates"), 0.1)
        assert np.max(np.abs(step(x) - by_hand)) <= roundoff(x)


# With a time-dependent H the half steps would evaluate it at other times.
@pytest.mark.parametrize("case", [name for name, case in cases().items() if not case.system.hamiltonian.timed])
def test_second_order_composes_first_order_and_adjoint(case):
    system, x, _ = cases()[case]
    half = [co.stepper(system, co.Splitting(order=1, adjoint=back), 0.05) for back in (False, True)]
    whole = co.stepper(system, co.Splitting(order=2), 0.1)
    assert np.max(np.abs(half[1](half[0](x)) - whole(x))) <= roundoff(x)


def test_fourth_order_composition_of_the_paper():
    """2 c1 + c2 = 1, 2 c1^3 + c2^3 = 0, applied step by step."""
    c1 = 1 / (2 - 2 ** (1 / 3))
    c2 = 1 - 2 * c1
    assert abs(2 * c1**3 + c2**3) < 16 * U
    for algebra, n in ((co.algebras.e(3), 6), (co.algebras.A3_7(1.5), 3)):
        system = co.LiePoissonSystem(algebra, co.Quadratic(full_matrix(8, n)))
        x = start = np.linspace(-0.8, 0.9, n)
        for c in (c1, c2, c1):
            x = co.stepper(system, co.Splitting(order=2), 0.1 * c)(x)
        whole = co.stepper(system, co.Splitting(scheme="yoshida4"), 0.1)(start)
        assert np.max(np.abs(whole - x)) <= 3 * roundoff(x)
