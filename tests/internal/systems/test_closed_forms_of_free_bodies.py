"""The closed form of the free body over long times and near its limits, against 24 digits, and its elliptic functions.

Tensors of the reference are those of M, which no public system takes as they are.
"""

import json
from pathlib import Path

import mpmath
import numpy as np
import pytest

from coadjoint.systems.closed_forms.free_rigid_body import across_integral, amplitude, exact_solution

U = 2.0**-53
CASES = json.loads((Path(__file__).parent / "long_rotations_reference.json").read_text())["cases"]


def floats(numbers):
    return np.array(numbers, dtype=object).astype(np.float64)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case['name']} t={case['t']}")
def test_against_24_digits(case):
    """Full tensors and diagonal ones, forwards and backwards; the error is some roundings, whatever the time."""
    m, x0, size = floats(case["m"]), floats(case["x0"]), np.linalg.norm(floats(case["x0"]))
    for sign in (-1, 1):
        x, A = exact_solution(m, sign, x0, -sign * float(case["t"]), True)
        assert np.abs(x - floats(case["x"])).max() <= 2.0**6 * U * size
        assert np.abs(A - floats(case["A"])).max() <= 2.0**6 * U


def test_the_farthest_of_several_times_decides_the_precision():
    x0 = np.array([0.3, -0.4, 1.2])
    for m in (np.array([1.0, 0.5, 0.25]), np.array([0.5, 0.5, 0.8])):
        for far in (-(2.0**150), 2.0**150):
            together = exact_solution(m, -1, x0, [0.5, far, 0.0], True)
            for several, one in zip(together, exact_solution(m, -1, x0, far, True), strict=True):
                np.testing.assert_allclose(several[1], one, rtol=0, atol=2.0**6 * U)


def test_the_limits_of_equal_moments_are_continuous():
    """Moments that differ by e less and less: the motion is that of equal ones, up to e |x| t."""
    x0, t = np.array([0.3, -0.4, 1.2]), np.array([0.5, 900.0])
    for place in range(3):
        equal = np.full(3, 0.5)
        equal[place] = 0.8
        near = equal.copy()
        for e in (2.0**-30, 2.0**-40, 2.0**-50):
            near[(place + 1) % 3] = 0.5 + e
            for one, other in zip(
                exact_solution(equal, -1, x0, t, True), exact_solution(near, -1, x0, t, True), strict=True
            ):
                assert np.abs(one - other).max() <= 2.0 * e * np.linalg.norm(x0) ** 2 * 900.0 + 2.0**6 * U


@pytest.mark.parametrize("complement", [1.0, 0.3, 1e-4, 1e-12, 1e-24])
def test_elliptic_functions_over_many_periods(complement):
    u = np.array([-35.0, -3.0, 1e-3, 0.7, 5.0, 60.0])
    phi = amplitude(u, complement)
    with mpmath.workdps(50):
        k2 = 1 - mpmath.mpf(complement)
        for value, at in zip(phi, u, strict=True):
            sine = mpmath.ellipfun("sn", mpmath.mpf(float(at)), m=k2)
            cosine = mpmath.ellipfun("cn", mpmath.mpf(float(at)), m=k2)
            assert abs(np.sin(value) - sine) <= 8 * U * (1 + abs(at))
            assert abs(np.cos(value) - cosine) <= 8 * U * (1 + abs(at))
            angle, nu = mpmath.mpf(float(value)), mpmath.mpf(-1.5)
            exact = ((1 - nu) * mpmath.ellippi(nu, angle, k2) - mpmath.ellipf(angle, k2)) / -nu
            assert abs(across_integral(-1.5, np.array([value]), complement)[0] - exact) <= 16 * U * (1 + abs(exact))
