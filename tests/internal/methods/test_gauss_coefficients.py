"""The coefficients of collocation methods: order conditions, exactness in floats, any number type."""

import decimal

import mpmath
import numpy as np
import pytest

from coadjoint.methods.gauss_legendre import MAX_STAGES
from coadjoint.methods.numerics.gauss_coefficients import (
    DIGITS,
    MAX_DECIMAL_STAGES,
    _collocation,
    _gauss_roots,
    _radau_roots,
    extrapolation,
    gauss_legendre,
    radau,
)
from guards import bounded_work
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(3)

COUNTS = (1, 2, 3, 4, 5, 8, 13, 20, 32)


@pytest.mark.parametrize("stages", COUNTS)
@pytest.mark.parametrize("family", [gauss_legendre, radau])
def test_float_coefficients_are_the_rounded_multiprecision_ones(family, stages):
    with mpmath.workdps(60):
        exact = family(stages, mpmath.mpf)
        found = family(stages)
        for one, other, bound in zip(found, exact, (U, U, 2 * U), strict=True):  # nodes, weights, mu
            error = np.abs(one - other)
            # Rounded to nearest; mu below 2 on a grid of 2 U, hence one U more than the half of it.
            assert np.max(error) <= bound


@pytest.mark.thinned(6)
@pytest.mark.parametrize("stages", COUNTS)
@pytest.mark.parametrize(("family", "degree"), [(gauss_legendre, 2), (radau, 2)])
def test_simplifying_conditions(family, degree, stages):
    """B(2s) or B(2s - 1), and C(s), to 40 digits."""
    with mpmath.workdps(80):
        c, b, mu = family(stages, mpmath.mpf)
        a = mu * b
        order = 2 * stages - (family is radau)
        for k in range(1, order + 1):
            assert abs(sum(b * c ** (k - 1)) - mpmath.mpf(1) / k) < mpmath.mpf(10) ** -40
        for k in range(1, stages + 1):
            assert np.max(np.abs(a @ c ** (k - 1) - c**k / k)) < mpmath.mpf(10) ** -40
        # The next condition fails: the order is not higher.
        assert abs(sum(b * c**order) - mpmath.mpf(1) / (order + 1)) > mpmath.mpf(10) ** -40


@pytest.mark.parametrize("stages", COUNTS)
def test_gauss_mu_is_exactly_symplectic(stages):
    *_, mu = gauss_legendre(stages)
    assert np.array_equal(mu + mu.T, np.ones((stages, stages)))
    assert np.array_equal(np.diag(mu), np.full(stages, 0.5))


@pytest.mark.parametrize("stages", COUNTS)
def test_radau_ends_with_the_step(stages):
    c, _, mu = radau(stages)
    assert c[-1] == 1.0
    assert np.array_equal(mu[-1], np.ones(stages))


@pytest.mark.parametrize("stages", [1, 2, 3, 5, 9])
@pytest.mark.parametrize("ratio", [1.0, 0.5, -0.25, -1.0, 1.5])
def test_the_polynomial_of_a_step_is_continued_to_the_nodes_of_the_next(stages, ratio):
    """Forward and backward, exact for polynomials of degree s: what is continued is x, from the end of the old step."""
    nodes, weights, _ = gauss_legendre(stages)
    E = extrapolation(stages, ratio)
    draw = np.random.default_rng(stages).uniform(-1.0, 1.0, stages)
    slope = np.polynomial.Polynomial(draw)
    x = slope.integ()
    ahead = 1.0 + ratio * nodes
    found = x(1.0) + E @ (weights * slope(nodes))
    # The Legendre polynomials are about 6^degree at the end of the next step.
    bound = 2.0**6 * 2.0**-53 * 6.0 ** (stages + 1) * np.sum(np.abs(draw))
    np.testing.assert_allclose(found, x(ahead), rtol=0, atol=bound)
    assert np.max(np.abs(found - x(1.0))) > 2.0**-10


@pytest.mark.parametrize("stages", [MAX_DECIMAL_STAGES + 1, 33, 64])
@pytest.mark.parametrize("roots_of", [_gauss_roots, _radau_roots])
def test_sums_in_integers_have_the_bits_of_sums_in_decimals(roots_of, stages):
    with decimal.localcontext(decimal.Context(prec=DIGITS)):
        roots = roots_of(stages, decimal.Decimal)
        pairs = zip(_collocation(roots), _collocation(roots, in_integers=True), strict=True)
        assert all(np.array_equal(*(np.array(one, dtype=np.float64) for one in pair)) for pair in pairs)


@pytest.mark.parametrize("family", [gauss_legendre, radau])
def test_the_most_stages_are_made_in_seconds(family):
    with bounded_work(300.0):  # sums in decimals take a quarter of a minute on a good machine
        c, b, mu = family(MAX_STAGES)
    assert abs(b.sum() - 1.0) <= MAX_STAGES * U and np.max(np.abs((mu * b).sum(axis=1) - c)) <= MAX_STAGES * U
