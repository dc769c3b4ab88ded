"""Sums of products in many digits, random numbers, and the noise on fluids."""

from fractions import Fraction

import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.evaluation import MAX_BITS, ProductSums, lossless_coefficients, scatter
from coadjoint.systems.forces import fluid_forces
from coadjoint.systems.forces.base import normal_deviates

N = 5


def test_normal_deviates():
    """Independent of how many are drawn, different by every argument, and of the normal distribution."""
    many = normal_deviates(7, 3, 0.5, 1, 20_000)
    for count in (1, 2, 3, 4, 5, 9):
        np.testing.assert_array_equal(normal_deviates(7, 3, 0.5, 1, count), many[:count])
    np.testing.assert_array_equal(normal_deviates(7, 3, -0.0, 1, 8), normal_deviates(7, 3, 0.0, 1, 8))
    draws = [many[:8]]
    for other in ((8, 3, 0.5, 1), (7, 4, 0.5, 1), (7, 3, -0.5, 1), (7, 3, 0.5 + 2.0**-53, 1), (7, 3, 0.5, 0)):
        draws.append(normal_deviates(*other, 8))
    assert len({draw.tobytes() for draw in draws}) == len(draws)
    assert np.abs(np.corrcoef(np.array(draws))[~np.eye(6, dtype=bool)]).max() < 0.99
    # Five standard deviations of the means of powers: 1, 2, 15 and 96 are the variances of x, x^2, x^3, x^4.
    for power, mean, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs(np.mean(many**power) - mean) < 5 * np.sqrt(variance / len(many))
    assert abs(np.mean(many[1:] * many[:-1])) < 5 / np.sqrt(len(many))


BANDS = {  # the eigenvalues of all real modes inside, by hand
    "sphere": {(1, 1): [2] * 3, (2, 3): [6] * 5 + [12] * 7, (2.5, 4): [12] * 7 + [20] * 9, (4, 9): [20] * 9},
    "torus": {(1, 1): [1] * 4, (2, 2): [4] * 4, (1.2, 2.3): [2] * 4 + [4] * 4 + [5] * 8, (2.5, 3): [8] * 4},
}


@pytest.mark.parametrize("surface", BANDS)
@pytest.mark.parametrize("layer", ["vorticity", "carried"])
def test_the_noise_feeds_in_its_rate_and_each_mode_has_the_same_share(surface, layer, monkeypatch):
    """The energy is a square: its mean is the sum over the deviates, one at a time."""
    make = {"sphere": co.systems.sphere_euler, "torus": co.systems.torus_euler}[surface]
    fluid, tau, rate = make(N=N), 0.25, 0.6
    s = fluid if layer == "vorticity" else co.systems.reduced_mhd(N, surface)
    x, e = np.zeros(s.dim), fluid.eigenvalues
    for band, eigenvalues in BANDS[surface].items():
        force = co.forces.RandomForcing(rate, band, seed=3, layer=layer)
        asked, squares = [], np.zeros(fluid.degrees.shape)
        monkeypatch.setattr(fluid_forces, "normal_deviates", lambda *a, asked=asked: asked.append(a) or np.zeros(a[-1]))
        np.testing.assert_array_equal(force.flow(s, x, 0.5, tau), x)
        (((seed, stream, moment, part, count)),) = asked
        assert (seed, stream, moment, part) == (3, 0, 0.5, 0)
        for unit in np.eye(count):
            monkeypatch.setattr(fluid_forces, "normal_deviates", lambda *a, unit=unit: unit)
            late = s.from_vector(force.flow(s, x, 0.5, tau))
            if s is not fluid:
                assert not late[1].any()
                late = late[0]
            squares += np.abs(fluid.mode_array(late)) ** 2 * fluid.squares
        weights = squares * (e if layer == "carried" else np.divide(1.0, e, out=0 * e, where=e > 0)) / 2
        assert weights.sum() == pytest.approx(rate * tau, rel=1e-12), band
        for eigenvalue in set(eigenvalues):
            share = weights[np.abs(e - eigenvalue) < 1e-9].sum() / weights.sum()
            assert share == pytest.approx(eigenvalues.count(eigenvalue) / len(eigenvalues), rel=1e-12), band
        assert set(np.rint(e[weights > 1e-20])) == set(eigenvalues)


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
