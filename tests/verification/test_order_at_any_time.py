"""Between the steps a run has the order that it has at them: at 1000 random times, for every scheme."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_where

from .measures import U, order_of
from .schemes_under_test import pairs, schemes
from .systems_under_test import all_cases

pytestmark = pytest.mark.thinned(6)

CASES = ("A3,7, full", "e(3), heavy top", "so(4), full, another basis", "sl(2), driven", "torus")
SOME = pairs({name: all_cases()[name] for name in CASES})
# Matrices take longest: one scheme of each kind that serves nothing else stays.
ONLY = ("IsospectralGauss(stages=2)", "LineSplitting(order=2)")
LONGER = [pair for pair in SOME if pair[1] == "torus" and pair[0] not in ONLY]
COUNT = 1000


@cache
def exact(name):
    """Times, and the states there: by the best scheme, confirmed by an independent code where states are vectors."""
    case = all_cases()[name]
    times = np.sort(np.random.default_rng(11).uniform(0.0, case.time, COUNT))
    matrices = isinstance(case.system, co.MatrixSystem)
    best = co.IsospectralGauss(8) if matrices else co.GaussLegendre(8)
    found = co.integrate(case.system, case.x0, (0.0, case.time), case.time / 48, best, t_eval=times).x
    if not matrices:
        field = lambda t, x: case.system.vector_field(x, t)  # noqa: E731
        span, rtol = (0.0, case.time), 1e-13
        other = solve_ivp(field, span, case.x0, method="DOP853", t_eval=times, rtol=rtol, atol=1e-14, max_step=0.02)
        # Its interpolant is of order seven: (0.02)^7 is 1e-12.
        assert np.max(np.abs(found - other.y.T)) < 1e-10 * np.max(np.abs(found))
    return times, found


def distance(method, case, count, times, states):
    found = co.integrate(case.system, case.x0, (0.0, case.time), case.time / count, method, t_eval=times).x
    return float(np.sqrt(np.mean(np.abs(found - states) ** 2)))


@pytest.mark.thinned(34)
@pytest.mark.parametrize(("scheme", "name"), long_where(LONGER, SOME))
def test_order_at_random_times(scheme, name):
    method, case, (times, states) = schemes()[scheme], all_cases()[name], exact(name)
    size = float(np.sqrt(np.mean(np.abs(states) ** 2)))
    density, finest = (4 if method.order >= 7 else 2), (9 if method.order <= 2 else 8)
    counts = sorted({round(2 ** (k / density)) for k in range(density * 2, density * finest + 1)}, reverse=True)
    steps, errors = [], []
    for count in counts:
        error = distance(method, case, count, times, states)
        if error > 32 * U * size * (8 + 2 * np.sqrt(count)):
            steps.insert(0, case.time / count)
            errors.insert(0, error)
        if len(errors) == 5:
            break
    assert len(errors) == 5
    # A part of a step adds an odd power to the error, whatever the symmetry of the scheme.
    found = order_of(steps, errors, 1)
    assert found.agrees_with(method.order), found
