"""Arithmetic of steps: truncated series, derivatives carried along, lengths of steps, exact elimination, rotations."""

import ctypes
from fractions import Fraction

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import address
from coadjoint.methods.numerics.projection import independent
from coadjoint.methods.numerics.solvers import linear_solve
from coadjoint.methods.numerics.taylor_series import Dual, PowerSeries, logarithm_of_step, near_log2, near_power_of_two
from rounding import UNIT_ROUNDOFF as U


def test_series_and_duals():
    t = PowerSeries([Fraction(1), Fraction(1), Fraction(0)])
    assert (t * t - 3 * t + 2).coefficients == [0, -1, 1]
    assert (1 - t / 2).coefficients == [Fraction(1, 2), Fraction(-1, 2), 0]
    assert (t**3).coefficients == [1, 3, 3] and t**0 == 1
    assert (-t).coefficients == [-1, -1, 0]
    product = Dual(2.0, np.array([1.0, 0.0])) * Dual(3.0, np.array([0.0, 1.0])) / 2 + 1.0
    assert product.value == 4.0 and product.derivative.tolist() == [1.5, 1.0]


def test_independent_rows():
    rows = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 2.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 3.0]])
    assert independent(rows) == [0, 1, 4]


def test_lengths_of_steps():
    """Terms that vanish by chance are no sign of a long step; at most half the radius of convergence."""
    for sizes in ([0.0, 1.0] * 8, [0.0, 0.0, 0.0, 1.0] * 4, [1.0, 0.0, 0.0, 0.0] * 4):
        assert -1.0 <= logarithm_of_step(sizes, 1.0, 1e-3) <= -0.6
    assert abs(logarithm_of_step([1e-20] * 16, 1.0, 1e-3) - np.log2(0.5)) < 1e-4
    assert logarithm_of_step([0.0] * 16, 1.0, 1e-3) == 900.0


def test_logarithms_and_powers():
    values = np.concatenate([np.linspace(0.5, 4.0, 999), 10.0 ** np.linspace(-300, 300, 601)])
    assert max(abs(near_log2(v) - np.log2(v)) for v in values) < 2e-5
    assert max(abs(near_power_of_two(a) / 2.0**a - 1.0) for a in np.linspace(-900, 900, 1801)) < 4e-6
    assert near_log2(0.0) == -1022.0


@pytest.mark.parametrize("tolerance", [1e-3, 3e-17, 1e-18])
def test_a_finer_series_has_a_tolerance_that_exists(tolerance):
    found = co.Taylor(12, tolerance=tolerance).finer(20, 1.5)
    assert found.method.tolerance == max(tolerance / 48.0, 1e-18) and found.method.order == 14
    assert found.left == min(0.5, found.method.tolerance / tolerance)
    assert co.Taylor(64, tolerance=tolerance).finer(20, 1.5).method.order == 64


@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_linear_systems_are_solved_exactly_in_fractions(size):
    """Random ones, and ones whose pivots are zero until rows are exchanged."""
    rng = np.random.default_rng(size)
    for trial in range(12):
        lower = np.tril(rng.integers(-3, 4, (size, size)), -1) + np.eye(size, dtype=int)
        upper = np.triu(rng.integers(-3, 4, (size, size)), 1) + np.diag(rng.choice([-2, -1, 1, 3], size))
        order = rng.permutation(size) if trial % 2 else np.arange(size)[::-1]
        A = np.vectorize(Fraction, otypes=[object])((upper if trial % 3 == 0 else lower @ upper)[order])
        X = np.vectorize(Fraction, otypes=[object])(rng.integers(-5, 6, (size, 2)))
        assert np.array_equal(linear_solve(A, A @ X), X)


def compiled_rotations(angles, out):
    pairs = np.empty((angles.size, 2))
    kernels().probe_pairs(ctypes.c_int64(2), address(angles), ctypes.c_int64(angles.size), address(pairs))
    out[:, :2] = pairs
    angle, short = kernels().probe_rational_angle, kernels().probe_shortfall
    angle.restype = short.restype = ctypes.c_double
    for k, (sine, lowered) in enumerate(pairs.tolist()):
        out[k, 2] = angle(ctypes.c_double(angles[k]), ctypes.c_double(1.5))
        out[k, 3] = short(*(ctypes.c_double(number) for number in (sine, -lowered, 1.0)))


def test_rational_rotations():
    """Sine and cosine minus one of 2 atan(phi/2) within 4 u, and what the rounded pair lacks in length."""
    rng = np.random.default_rng(2)
    angles = rng.choice([-1.0, 1.0], 500) * 10 ** rng.uniform(-8, 1, 500)
    out = np.empty((angles.size, 4))
    compiled_rotations(angles, out)
    with mpmath.workdps(50):
        for phi, (sine, lowered, angle, short) in zip(angles.tolist(), out.tolist(), strict=True):
            half = mpmath.mpf(phi) / 2
            assert abs(sine - 2 * half / (1 + half**2)) <= 4 * U * abs(sine)
            assert abs(lowered + 2 * half**2 / (1 + half**2)) <= 4 * U * abs(lowered)
            assert abs(angle - mpmath.atan(half * 1.5) * 2 / 1.5) <= 4 * U * abs(angle)
            s, c = mpmath.mpf(sine), -mpmath.mpf(lowered)
            missing = (s**2 - 2 * c + c**2) / 2
            assert abs(missing) <= 8 * U * abs(lowered)
            assert abs(short - missing) <= 2 * U * lowered**2
