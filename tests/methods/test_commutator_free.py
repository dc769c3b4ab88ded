"""Commutator-free Lie group methods: their coefficients, local orders in 40 digits, exponentials, group elements."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from coadjoint.methods.commutator_free import SCHEMES
from coadjoint.rounding import UNIT_ROUNDOFF
from drawn_matrices import full
from moments import moments

pytestmark = pytest.mark.thinned(3)

RNG = np.random.default_rng(4)


ALGEBRAS = [co.algebras.e(3), co.algebras.sl(3), co.algebras.get("A5,3"), co.algebras.A3_7(0.7), moments()]


def rows_of(scheme):
    """The tableau of the gradients alone: what is left where all exponentials commute."""
    known = [[]]
    for start, combination in scheme.stages:
        base = known[start] + [Fraction(0)] * (len(combination) - len(known[start]))
        known.append([a + b for a, b in zip(base, combination, strict=True)])
    size = len(known)
    out = [sum((row[j] if j < len(row) else 0 for row in scheme.out), Fraction(0)) for j in range(size)]
    return [row + [Fraction(0)] * (size - len(row)) for row in known], out


@pytest.mark.parametrize("order", SCHEMES)
def test_the_conditions_of_runge_and_kutta(order):
    """Where everything commutes it is a Runge-Kutta method, whose trees up to its order have their weights."""
    A, b = rows_of(SCHEMES[order])
    c = SCHEMES[order].nodes
    s = range(len(b))
    assert c == [sum(row) for row in A]
    trees = {1: [(sum(b), 1)], 2: [(sum(b[i] * c[i] for i in s), 2)]}
    inner = [sum(A[i][j] * c[j] for j in s) for i in s]
    trees[3] = [(sum(b[i] * c[i] ** 2 for i in s), 3), (sum(b[i] * inner[i] for i in s), 6)]
    trees[4] = [
        (sum(b[i] * c[i] ** 3 for i in s), 4),
        (sum(b[i] * c[i] * inner[i] for i in s), 8),
        (sum(b[i] * sum(A[i][j] * c[j] ** 2 for j in s) for i in s), 12),
        (sum(b[i] * sum(A[i][j] * inner[j] for j in s) for i in s), 24),
    ]
    for degree in range(1, order + 1):
        for weight, density in trees[degree]:
            assert weight == Fraction(1, density)


@pytest.mark.thinned(24)
@pytest.mark.parametrize("order", SCHEMES)
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


def test_the_group_element_is_that_of_the_motion():
    """In 4 x 4 matrices of SE(3) and of SO(4), beside the rotation of a fine splitting."""
    for algebra in (co.algebras.e(3), co.algebras.so(4)):
        system = co.LiePoissonSystem(algebra, co.Quadratic(full(6, 6)), sign=-1)
        x0 = np.linspace(0.7, -0.5, 6)
        fine = co.integrate(system, x0, (0, 2), 2**-9, co.Splitting(order=4), attitude=True).attitude[-1]
        errors = [
            np.max(np.abs(co.integrate(system, x0, (0, 2), h, co.CommutatorFree(4), attitude=True).attitude[-1] - fine))
            for h in (2**-4, 2**-5)
        ]
        assert 3.6 < np.log2(errors[0] / errors[1]) < 4.6 and errors[1] < 1e-4


def test_what_is_refused():
    with pytest.raises(ValueError, match="order of CommutatorFree"):
        co.CommutatorFree(5)
    plane = co.PoissonSystem(lambda x: np.array([[0.0, 1.0], [-1.0, 0.0]]), co.Quadratic([1.0, 2.0]), dim=2)
    with pytest.raises(ValueError, match=r"CommutatorFree moves along coadjoint orbits.*no Lie algebra"):
        co.integrate(plane, (1, 0), (0, 1), 0.1, co.CommutatorFree())
    body = co.systems.rigid_body((1, 2, 3))
    with pytest.raises(co.IntegrationError, match="is too large for its series"):
        co.integrate(body, (1, 2, 3), (0, 1e5), 1e5, co.CommutatorFree())
    with pytest.raises(co.IntegrationError, match="is too large for its series"):
        co.CommutatorFree().step(body, np.array([1.0, 2, 3]), 0.0, 1e5)
    with pytest.raises(TypeError, match=r"take floats or mpmath\.mpf"):
        co.CommutatorFree().step(body, np.array([Fraction(1)] * 3), Fraction(0), Fraction(1, 10))


def test_it_is_read_as_a_series():
    """The modified field of the scheme of order 4 differs from the field by h^4, and nothing before it."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
    modified = co.modified_field(system, co.CommutatorFree(4), order=5)
    x = np.array([0.3, 1.0, -0.5])
    f = system.vector_field(x)
    off = [np.max(np.abs(modified(x, h) - f)) for h in (0.2, 0.1)]
    assert off[0] / off[1] == pytest.approx(16, rel=1e-6)
