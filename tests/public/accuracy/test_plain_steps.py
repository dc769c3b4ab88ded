"""Steps of `Method.step`, in floats and in 40 digits, agree with those of compiled loops."""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF as U
from verification.schemes_under_test import pairs, schemes, witnesses
from verification.systems_under_test import all_cases

pytestmark = pytest.mark.thinned(6)

STEP = 0.0625


def read_plainly(method, system, x, h, count, number=float):
    """Take steps in any number type."""
    point = np.array([number(v) for v in x], dtype=object if number is not float else float)
    h = number(h)
    t = number(0)
    for _ in range(count):
        point, t = method.step(system, point, t, h), t + h
    return point


@pytest.mark.thinned(52)
@pytest.mark.parametrize(("scheme", "case"), pairs(all_cases()))
def test_plain_steps_agree_with_the_compiled_loop(scheme, case):
    method, (system, x0, _) = schemes()[scheme], all_cases()[case]
    count = 8
    run = co.integrate(system, x0, (0.0, count * STEP), STEP, method, save_every=count)
    plain = read_plainly(method, system, x0, STEP, count)
    # Both round each of `evaluations` n times; the motion of one unit of time amplifies by less than 16.
    bound = 16 * 4 * len(x0) * U * (run.stats.evaluations + count) * np.max(np.abs(run.x))
    assert np.max(np.abs(plain - run.x[-1])) <= bound


@pytest.mark.thinned(38)
@pytest.mark.parametrize("scheme", list(schemes()))
def test_compiled_loop_agrees_with_forty_digits(scheme):
    """On systems without Python functions, which can be evaluated in multiprecision."""
    method = schemes()[scheme]
    for system, x0, _ in witnesses(method, "A3,7, full", "e(3), heavy top"):
        if isinstance(system, co.MatrixSystem):
            continue  # in float64 for matrices
        with mpmath.workdps(40):
            exact = read_plainly(method, system, x0, 0.125, 2, mpmath.mpf)
        run = co.integrate(system, x0, (0.0, 0.25), 0.125, method)
        error = max(abs(float(a - mpmath.mpf(float(b)))) for a, b in zip(exact, run.x[-1], strict=True))
        assert error <= 4 * len(x0) * U * (run.stats.evaluations + 2) * np.max(np.abs(run.x)), (system.name, error)
