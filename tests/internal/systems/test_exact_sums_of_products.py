"""Sums of products of mpmath numbers by integers, against their own arithmetic and exact fractions."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.evaluation import lossless_coefficients, scatter
from coadjoint.systems.product_sums import MAX_BITS, ProductSums

mpmath = pytest.importorskip("mpmath")
mp = mpmath.mp


def drawn(rng, n, spread=20):
    """Return numbers of all digits and of different sizes, one of them zero."""
    values = [mp.mpf(int(rng.integers(-9, 9))) / 7 * mp.mpf(2) ** int(rng.integers(-spread, spread)) for _ in range(n)]
    result = np.empty(n, dtype=object)
    result[:] = [mp.mpf(0), *values[1:]]
    return result


def exact(value):
    sign, mantissa, exponent, _ = value._mpf_
    return Fraction((-1) ** sign * int(mantissa)) * Fraction(2) ** exponent


@pytest.mark.parametrize("digits", [15, 60, 300])
@pytest.mark.parametrize("seed", range(4))
def test_sums_are_the_exact_ones_rounded_once(seed, digits):
    rng, n, count = np.random.default_rng(seed), 7, 40
    rows, first, second = rng.integers(0, n - 1, (3, count))
    for coefficients in (rng.normal(size=count), np.array([Fraction(int(k), 21) for k in rng.integers(-9, 9, count)])):
        with mpmath.workdps(digits):
            x, u = drawn(rng, n), drawn(rng, n)
            sums = ProductSums(rows, coefficients, n).by_integers((x, first), (u, second))
            terms = [
                Fraction(c) * exact(x[i]) * exact(u[j]) for c, i, j in zip(coefficients, first, second, strict=True)
            ]
            for row in range(n):
                total = sum((term for term, r in zip(terms, rows, strict=True) if r == row), Fraction(0))
                assert abs(exact(sums[row]) - total) <= abs(total) * Fraction(2) ** -mp.prec
            plain = scatter(rows, lossless_coefficients(coefficients, x) * x[first] * u[second], n)
            size = scatter(rows, abs(lossless_coefficients(coefficients, x) * x[first] * u[second]), n)
            assert all(abs(a - b) <= count * mp.eps * s for a, b, s in zip(sums, plain, size, strict=True))


def test_other_numbers_are_not_taken():
    sums = ProductSums(np.array([0, 1]), np.array([1.0, 2.0]), 2)
    index = np.arange(2)
    accepted = np.array([mp.mpf(1), mp.ldexp(1, MAX_BITS)], dtype=object)
    assert sums.by_integers((accepted, index)).tolist() == [1, mp.ldexp(1, MAX_BITS + 1)]
    mixed = np.array([mp.mpf(1), 1.0], dtype=object)
    spread = np.array([mp.mpf(1), mp.ldexp(1, MAX_BITS + 1)], dtype=object)
    cases = [[mp.mpf(1), mp.inf], [mp.nan, mp.mpf(1)], [Fraction(1), Fraction(2)], [mp.mpc(1), mp.mpc(2)]]
    for values in [mixed, spread, *(np.array(case, dtype=object) for case in cases)]:
        assert sums.by_integers((values, index)) is None
    assert (
        ProductSums(np.array([0]), np.array([mp.mpf(1) / 3], dtype=object), 1).by_integers((mixed[:1], index[:1]))
        is None
    )


@pytest.mark.parametrize("algebra", ["so(4)", "su(3)", "A3,2", "e(3)"])
def test_fields_agree_with_those_of_fractions(algebra):
    rng = np.random.default_rng(5)
    g = co.algebras.get(algebra)
    half = rng.normal(size=(g.dim, g.dim))
    system = co.LiePoissonSystem(g, co.Quadratic(half + half.T, linear=rng.normal(size=g.dim)), sign=-1)
    values = rng.normal(size=g.dim)
    expected = system.vector_field(np.array([Fraction(v) for v in values], dtype=object))
    with mpmath.workdps(80):
        field = system.vector_field(np.array([mp.mpf(v) for v in values], dtype=object))
        size = max(map(abs, expected))
        assert all(abs(exact(a) - b) <= Fraction(10) ** -76 * size for a, b in zip(field, expected, strict=True))
    infinite = np.array([mp.inf, *map(mp.mpf, values[1:])], dtype=object)
    assert not all(map(mp.isfinite, system.vector_field(infinite)))
