"""Steps of the Runge-Kutta schemes in exact and multiprecision numbers: invariants, tangents."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

GAUSS, ITERATED, MODIFIED, EXPLICIT = (
    co.GaussLegendre,
    co.IteratedGaussLegendre,
    co.ModifiedGaussLegendre,
    co.ExplicitRungeKutta,
)
FULL = np.diag([1.0, 0.5, 1.25, 0.75, 1.5, 0.25]) + 0.125 * (np.ones((6, 6)) - np.eye(6))
BODY4 = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic(FULL))
X4 = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
SL2 = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 2.0, 3.0]))
THIRDS, TENTH = np.array([Fraction(1), Fraction(1, 2), Fraction(-1, 3)], dtype=object), Fraction(1, 10)


def test_exact_fractions():
    """Explicit steps are rational; so is the linear system of one stage, which keeps the energy exactly."""
    middle = THIRDS + TENTH / 2 * SL2.vector_field(THIRDS)
    assert list(EXPLICIT("runge2").step(SL2, THIRDS, 0, TENTH)) == list(THIRDS + TENTH * SL2.vector_field(middle))
    new = MODIFIED(1).step(SL2, THIRDS, 0, TENTH)
    assert all(isinstance(v, Fraction) for v in new) and SL2.energy(new) == SL2.energy(THIRDS)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    "method",
    [EXPLICIT("runge2"), EXPLICIT("rk4"), GAUSS(2), ITERATED(2), MODIFIED(2, freeze="gradient"), co.RadauEnergy(2)],
    ids=str,
)
def test_each_stage_takes_the_derivative_at_its_own_place(method):
    """Central differences in 50 digits with e = 1e-15 are exact to 1e-28; the tangent itself rounds like the step."""
    t = 0.25
    new, P = method.tangent(BODY4, X4, t, 0.125)
    with mpmath.workdps(50):
        e, x = mpmath.mpf(10) ** -15, np.array([mpmath.mpf(v) for v in X4], dtype=object)
        direction = np.random.default_rng(3).uniform(-1.0, 1.0, 6)
        ends = [method.step(BODY4, x + sign * e * direction, t, 0.125) for sign in (1, -1)]
        slope = ((ends[0] - ends[1]) / (2 * e)).astype(float)
    # s n unknowns at most 18, condition numbers below 20, some 10 evaluations of n products: 1e4 roundings.
    assert np.max(np.abs(P @ direction - slope)) < 6e4 * UNIT_ROUNDOFF * np.max(np.abs(P))
    assert np.max(np.abs(new - method.step(BODY4, X4, t, 0.125))) <= 64 * UNIT_ROUNDOFF
    assert np.max(np.abs(P - np.eye(6))) > 1e-2


def test_stages_that_do_not_converge_are_a_failure():
    with refused(co.IntegrationError, "converge") as failure:
        GAUSS(2).step(BODY4, X4, 0.0, 10.0)
    assert failure.value.residual > 1.0
