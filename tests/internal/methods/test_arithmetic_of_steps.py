"""Rational rotations in compiled loops, and tolerances of finer series."""

import ctypes

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.kernels.library import kernels
from coadjoint.kernels.tables.compiled import address
from rounding import UNIT_ROUNDOFF as U


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


@pytest.mark.parametrize("tolerance", [1e-3, 3e-17, 1e-18])
def test_a_finer_series_has_a_tolerance_that_exists(tolerance):
    found = co.Taylor(12, tolerance=tolerance).finer(20, 1.5)
    assert found.method.tolerance == max(tolerance / 48.0, 1e-18) and found.method.order == 14
    assert found.left == min(0.5, found.method.tolerance / tolerance)
    assert co.Taylor(64, tolerance=tolerance).finer(20, 1.5).method.order == 64
