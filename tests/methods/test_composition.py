"""Compositions: their order from the order conditions, and what is refused."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.methods.protocol.composed import composition_order

C1 = 1 / (2 - 2 ** (1 / 3))
YOSHIDA = (C1, 1 - 2 * C1, C1)
S = 1 / (4 - 4 ** (1 / 3))
SUZUKI = (S, S, 1 - 4 * S, S, S)
D1 = 1 / (2 - 2 ** (1 / 5))
SIX_FROM_FOUR = (D1, 1 - 2 * D1, D1)


@pytest.mark.parametrize(
    ("coefficients", "base", "order"),
    [
        ((1.0,), 2, 2),
        ((0.5, 0.5), 2, 2),
        ((0.25, 0.75), 2, 2),
        (YOSHIDA, 2, 4),
        (SUZUKI, 2, 4),
        (SIX_FROM_FOUR, 4, 6),
        (YOSHIDA, 4, 4),
        ((YOSHIDA[1], YOSHIDA[0], YOSHIDA[0]), 2, 3),  # not a palindrome: the even condition fails as well
    ],
)
def test_order_from_the_conditions(coefficients, base, order):
    assert composition_order(coefficients, base) == order


def test_coefficients_with_fewer_digits_lose_the_order_that_they_do_not_resolve():
    """The conditions hold to the rounding of doubles, or not at all: 1e-10 away is order 2."""
    assert composition_order(tuple(round(c, 10) for c in YOSHIDA), 2) == 2


def test_order_symmetry_and_explicitness():
    method = co.Composition(co.Splitting(order=2), YOSHIDA)
    assert (method.order, method.symmetric, method.explicit) == (4, True, True)
    assert not co.Composition(co.Splitting(order=2), (0.25, 0.75)).symmetric
    assert not co.Composition(co.GaussLegendre(1), YOSHIDA).explicit


def test_composition_of_a_composition():
    inner = co.Composition(co.Splitting(order=2), YOSHIDA)
    outer = co.Composition(inner, SIX_FROM_FOUR)
    assert (outer.order, outer.symmetric, outer.innermost) == (6, True, co.Splitting(order=2))
    assert len(outer.fractions) == 9
    assert abs(sum(outer.fractions) - 1.0) <= 9 * 2.0**-53 * sum(map(abs, outer.fractions))
    assert composition_order(outer.fractions, 2) == 6
    assert outer.fractions[:3] == tuple(SIX_FROM_FOUR[0] * c for c in YOSHIDA)


@pytest.mark.parametrize(
    ("base", "coefficients", "error", "message"),
    [
        (co.Splitting(order=2), (1.0, 1.0, 1.0), ValueError, "add up to 1, not to 3.0"),
        (co.Splitting(order=2), (0.5, 0.4999999), ValueError, "add up to 1"),
        (co.Splitting(order=2), (), ValueError, "add up to 1"),
        (co.Splitting(order=2), (np.nan, 1.0), ValueError, "finite"),
        (co.Splitting(order=1), (0.5, 0.5), ValueError, r"symmetric base, which .* is not; .*Splitting\(order=2\)"),
        (co.Composition(co.Splitting(order=2), (0.25, 0.75)), (0.5, 0.5), ValueError, "symmetric base"),
        ("strang", (0.5, 0.5), TypeError, "the base of a Composition is a scheme"),
    ],
)
def test_refusals(base, coefficients, error, message):
    with pytest.raises(error, match=message) as refusal:
        co.Composition(base, coefficients)
    assert "\n" not in str(refusal.value)


def test_a_composition_of_splittings_is_the_scheme_of_that_name():
    """Coefficients in floats against those in 50 digits: rounding of 100 steps of 30 rows."""
    s = co.LiePoissonSystem(co.algebras.e(3), co.Quadratic([1.0, 0.5, 0.25, 2.0, 3.0, 4.0]))
    x0 = np.linspace(-0.5, 0.75, 6)
    ends = [
        co.integrate(s, x0, (0, 5), 0.05, method).x[-1]
        for method in (co.Splitting(scheme="yoshida4"), co.Composition(co.Splitting(order=2), YOSHIDA))
    ]
    assert np.abs(ends[0] - ends[1]).max() <= 100 * 30 * 8 * 2.0**-53


def test_substeps_of_compositions_of_compositions_are_counted_together():
    inner = co.Composition(co.Splitting(order=2), (1 / 40,) * 40)
    assert len(co.Composition(inner, (1 / 25,) * 25).fractions) == 1000
    with pytest.raises(ValueError, match="a step of the Composition has 1040 substeps; the limit is 1000"):
        co.Composition(inner, (1 / 26,) * 26)
