"""Commutator-free Lie group methods: orders, exponentials, group elements."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from moments import moments
from rounding import UNIT_ROUNDOFF

pytestmark = pytest.mark.thinned(3)

RNG = np.random.default_rng(4)


ALGEBRAS = [co.algebras.e(3), co.algebras.sl(3), co.algebras.get("A5,3"), co.algebras.A3_7(0.7), moments()]


@pytest.mark.thinned(24)
@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("algebra", ALGEBRAS, ids=str)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_linear_hamiltonian_is_one_exponential(order, algebra, sign):
    """The motion of H = u . x is exp(sign t D_u) x, however far the step turns; and so is the group element."""
    u = np.linspace(-1.0, 1.5, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.zeros(algebra.dim), linear=u), sign=sign)
    x0 = RNG.uniform(-1, 1, algebra.dim)
    for h in (3.0, -3.0):
        D = sign * h * algebra.coadjoint(u)
        step, E = co.stepper(system, co.CommutatorFree(order), h), expm(D)
        # Growth within the substeps, and back, is rounding too.
        size = 64 * algebra.dim * UNIT_ROUNDOFF * np.max(expm(np.abs(D)))
        assert np.max(np.abs(step(x0) - E @ x0)) < size
        assert np.max(np.abs(step.tangent(x0) - E)) < size
        K = co.integrate(system, x0, (0, h), abs(h), co.CommutatorFree(order), attitude="coadjoint").attitude[-1]
        assert np.max(np.abs(K - expm(-D))) < size


@pytest.mark.parametrize("span", [20.0, 60.0, 200.0])
@pytest.mark.parametrize("algebra", [co.algebras.so(4), co.algebras.su(3)], ids=str)
def test_exponentials_of_many_substeps(algebra, span):
    """By squares from 65 substeps on; members of an ensemble as alone. On a compact algebra only round-off grows."""
    u = np.linspace(-1.0, 1.5, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.zeros(algebra.dim), linear=u))
    members = RNG.uniform(-1, 1, (5, algebra.dim))
    run = co.integrate(system, members, (0, span), span, co.CommutatorFree(4), attitude="coadjoint")
    alone = co.integrate(system, members[3], (0, span), span, co.CommutatorFree(4), attitude="coadjoint")
    assert np.array_equal(run.x[:, 3], alone.x) and np.array_equal(run.attitude[:, 3], alone.attitude)
    D = span * algebra.coadjoint(u)
    size = 64 * algebra.dim * UNIT_ROUNDOFF * np.abs(D).sum(axis=0).max()
    E, inverse = (np.linalg.matrix_power(expm(sign * D / 64), 64) for sign in (1, -1))
    assert np.abs(alone.x[-1] - E @ members[3]).max() < size
    assert np.abs(alone.attitude[-1] - inverse).max() < size


@pytest.mark.parametrize("order", [2, 3, 4])
@pytest.mark.parametrize("algebra", [co.algebras.so(3), co.algebras.A3_7(Fraction(1, 2))], ids=str)
def test_the_modified_field_begins_at_the_order(algebra, order):
    """In exact numbers: all conditions of the order hold, and the field of the error is not zero."""
    system = co.LiePoissonSystem(algebra, co.Quadratic([[1.0, 0.25, 0.125], [0.25, 0.5, -0.25], [0.125, -0.25, 2.0]]))
    modified = co.modified_field(system, co.CommutatorFree(order), order=order + 1)
    assert modified.exact and modified.first_error == order
    x = np.array([0.3, 1.0, -0.5])
    off = [np.max(np.abs(modified(x, h) - system.vector_field(x))) for h in (0.2, 0.1)]
    assert off[0] / off[1] == pytest.approx(2**order, rel=1e-6)
