"""Number types: conversion rounds at most once, and the unit round-off is that of the type."""

from fractions import Fraction

import mpmath
import numpy as np
import pytest

from coadjoint.program.numbers import array_of, convert, roundoff


def test_roundoff_is_half_the_gap_above_one():
    assert roundoff(float) == 2.0**-53
    assert roundoff(Fraction) == 0
    with mpmath.workdps(40):
        assert roundoff(mpmath.mpf) == mpmath.mpf(2) ** -mpmath.mp.prec


@pytest.mark.parametrize("value", [0.1, 3, Fraction(1, 3), np.float64(0.1), np.int64(7)])
def test_values_reach_the_number_type_without_a_detour(value):
    with mpmath.workdps(40):
        exact = Fraction(value.item() if isinstance(value, np.generic) else value)
        got = convert(mpmath.mpf, value)
        assert abs(got - mpmath.mpf(exact.numerator) / exact.denominator) <= abs(got) * roundoff(mpmath.mpf)
        assert convert(mpmath.mpf, "0.1") != mpmath.mpf(0.1)
    assert convert(float, value) == float(exact)


def test_arrays_are_float64_or_objects():
    assert array_of(float, [Fraction(1, 4), 2]).dtype == np.float64
    exact = array_of(Fraction, np.array([0.5, 2.0]))
    assert exact.dtype == object and list(exact) == [Fraction(1, 2), Fraction(2)]
