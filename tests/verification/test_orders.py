"""Every scheme has its declared order on every kind of system, at the steps and between them."""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_where

from .measures import five_errors, measured_order, order_of, step_counts
from .schemes_under_test import concrete_schemes, pairs, schemes, schemes_in_steps
from .systems_under_test import all_cases

pytestmark = pytest.mark.thinned(6)

DECLARED = {
    "Splitting 1": 1,
    "Splitting 1 adjoint": 1,
    "Splitting 2": 2,
    "Splitting 2 coordinates": 2,
    "Splitting 2 compensated": 2,
    "Splitting 4": 4,
    "Splitting yoshida4": 4,
    "Splitting suzuki4": 4,
    "Composition of Splitting": 4,
    "Composition of GaussLegendre": 4,
    "runge2": 2,
    "rk4": 4,
    **{f"GaussLegendre {s}": 2 * s for s in (1, 2, 3, 4)},
    **{f"Modified {s} {freeze}": 2 * s for s in (1, 2, 3) for freeze in ("structure", "gradient")},
    **{f"Iterated {s}": 2 * s for s in (1, 2, 3)},
    **{f"RadauEnergy {s}": 2 * s - 1 for s in (1, 2, 3)},
    **{f"Taylor {p}": p for p in (1, 2, 3, 5, 6)},
    **{f"Taylor {p} alone": p for p in (2, 5)},
}


def test_all_schemes_are_measured():
    # The order of variable steps is measured in the tests of these schemes.
    expected = concrete_schemes() - {"ReversibleSteps"} | schemes_in_steps()
    assert {type(method).__name__ for method in schemes().values()} >= expected


@pytest.mark.parametrize("name", DECLARED)
def test_declared_order_matches_the_literature(name):
    assert schemes()[name].order == DECLARED[name]


# A free body alone is solved exactly.
EXACT = {(f"Splitting {order} free body", case) for order in (2, 4) for case in all_cases() if case.startswith("so(3)")}


@pytest.mark.thinned(182)
@pytest.mark.parametrize(("scheme", "case"), [pair for pair in pairs(all_cases()) if pair not in EXACT])
def test_measured_order_is_the_declared_one(scheme, case):
    found = measured_order(schemes()[scheme], case)
    # New schemes are compared with their own declaration.
    assert found.agrees_with(DECLARED.get(scheme, schemes()[scheme].order)), found


CASES = ("A3,7, full", "e(3), heavy top", "so(4), full, another basis", "sl(2), driven", "torus")
SOME = pairs({name: all_cases()[name] for name in CASES})
# Matrices take longest: one scheme of each kind stays.
ONLY = ("IsospectralGauss(stages=2)", "LineSplitting(order=2)")
LONGER = [pair for pair in SOME if pair[1] == "torus" and pair[0] not in ONLY]
COUNT = 1000


@cache
def exact(name):
    """Return times, and the states there from the best scheme; those of vectors are confirmed by DOP853."""
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


@pytest.mark.thinned(68)
@pytest.mark.parametrize(("scheme", "name"), long_where(LONGER, SOME))
def test_order_between_the_steps(scheme, name):
    method, case, (times, states) = schemes()[scheme], all_cases()[name], exact(name)
    size = float(np.sqrt(np.mean(np.abs(states) ** 2)))
    counts = step_counts(method.order)
    # A partial step adds an odd power to the error, even of symmetric schemes.
    found = order_of(*five_errors(case.time, counts, size, lambda n: distance(method, case, n, times, states)), 1)
    assert found.agrees_with(method.order), found
