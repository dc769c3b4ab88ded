"""Runs agree with steps of `Method.step` in 40 digits."""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from digests.schemes_under_test import schemes, witnesses
from rounding import UNIT_ROUNDOFF


@pytest.mark.thinned(4)
@pytest.mark.parametrize("scheme", list(schemes()))
def test_runs_agree_with_steps_in_forty_digits(scheme):
    """On systems without Python functions, which can be evaluated in multiprecision; of matrices steps are floats."""
    method = schemes()[scheme]
    for system, x0, _ in witnesses(method, "A3,7, full", "e(3), heavy top"):
        if isinstance(system, co.MatrixSystem):
            continue
        with mpmath.workdps(40):
            x, h = np.array([mpmath.mpf(v) for v in x0], dtype=object), mpmath.mpf(0.125)
            exact = method.step(system, method.step(system, x, mpmath.mpf(0), h), h, h).astype(float)
        run = co.integrate(system, x0, (0.0, 0.25), 0.125, method)
        bound = 4 * len(x0) * UNIT_ROUNDOFF * (run.stats.evaluations + 3) * np.max(np.abs(run.x))
        assert np.max(np.abs(exact - run.x[-1])) <= bound, system.name
