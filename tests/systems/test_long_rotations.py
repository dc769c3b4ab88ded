"""The closed form of the free body over long times and near its limits, against 24 digits; the flip of a spun body."""

import itertools
import json
from pathlib import Path

import mpmath
import numpy as np
import pytest

import coadjoint as co
from coadjoint.systems.closed_forms.free_rigid_body import exact_solution

U = 2.0**-53
CASES = json.loads((Path(__file__).parent / "long_rotations_reference.json").read_text())["cases"]
KNOWN = {(case["name"], case["t"]): case for case in CASES}
TIMES = sorted({case["t"] for case in CASES})


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


@pytest.mark.thinned(12)
@pytest.mark.parametrize("case", [c for c in CASES if np.ndim(c["m"]) == 1], ids=lambda c: f"{c['name']} t={c['t']}")
def test_every_order_and_sign_of_the_axes(case):
    """y = P x has y' = det(P) y cross (m' y): the same motion, or the one backwards in time."""
    m, x0, size = floats(case["m"]), floats(case["x0"]), np.linalg.norm(floats(case["x0"]))
    tried = 0
    for order, signs in itertools.product(itertools.permutations(range(3)), itertools.product((1.0, -1.0), repeat=3)):
        P = np.eye(3)[list(order)] * np.array(signs)[:, None]
        other = KNOWN.get((case["name"], round(np.linalg.det(P)) * case["t"]))
        if other is None:
            continue
        x, A = exact_solution(np.abs(P) @ m, -1, P @ x0, float(case["t"]), True)
        assert np.abs(x - P @ floats(other["x"])).max() <= 2.0**6 * U * size
        assert np.abs(A - P @ floats(other["A"]) @ P.T).max() <= 2.0**6 * U
        tried += 1
    assert tried >= 24


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


def period_of(inertia, x0):
    """The period of the momentum, by Landau and Lifshitz, Mechanics, 37: for moments in ascending order."""
    one, two, three = (mpmath.mpf(v) for v in inertia)
    x = [mpmath.mpf(v) for v in x0]
    square, doubled = sum(v * v for v in x), sum(v * v / i for v, i in zip(x, inertia, strict=True))
    if square < doubled * two:
        one, three = three, one
    k2 = (two - one) * (doubled * three - square) / ((three - two) * (square - doubled * one))
    rate = mpmath.sqrt((three - two) * (square - doubled * one) / (one * two * three))
    return float(4 * mpmath.ellipk(k2) / rate)


@pytest.mark.parametrize("x0", [(1e-3, 2.0, 1e-4), (1e-4, 2.0, 1e-3), (1e-8, -2.0, 1e-7)], ids=str)
def test_the_flip_about_the_middle_axis_has_its_period(x0):
    """A body spun about its middle axis turns over every half period, and is back after a whole one."""
    body, inertia = co.systems.rigid_body((1, 2, 3)), (1, 2, 3)
    with mpmath.workdps(30):
        period = period_of(inertia, x0)
    square, doubled = np.dot(x0, x0), np.dot(x0, np.divide(x0, inertia))
    about = 0 if square < 2 * doubled else 2
    turned_over = -np.array(x0)
    turned_over[about] = x0[about]
    # The states on the way are near a saddle: lam = sqrt((m1 - m2) (m2 - m3)) |x|, and a state of size d leaves in
    # log(1/d)/lam. What rounding moves there comes back larger by 1/d.
    least = max(x0[0], x0[2])
    half, whole = body.exact(x0, [period / 2, period])
    assert np.abs(half - turned_over).max() <= 2.0**6 * U
    assert np.abs(whole - x0).max() <= 2.0**6 * U
    run = co.integrate(body, x0, (0.0, period), period / 64, co.Splitting(parts="free_body"), save_every=32)
    assert np.abs(run.x[1] - turned_over).max() <= 2.0**7 * U / least
    assert np.abs(run.x[2] - x0).max() <= 2.0**7 * U / least
    if least > 1e-5:
        errors = []
        for steps in (2**12, 2**13):
            run = co.integrate(body, x0, (0.0, period), period / steps, co.Splitting(), save_every=steps // 2)
            errors.append(np.abs(run.x[1:] - [turned_over, x0]).max())
        assert errors[1] < 0.1
        assert 3.5 < errors[0] / errors[1] < 4.5
