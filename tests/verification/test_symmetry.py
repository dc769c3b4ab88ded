"""Schemes declared symmetric are undone by backward steps; others by O(h^(p+1)) or O(h^(p+2))."""

import mpmath
import numpy as np
import pytest

import coadjoint as co

from .measures import U, order_of
from .schemes_under_test import pairs, schemes
from .systems_under_test import all_cases, cases

pytestmark = pytest.mark.thinned(3)

H = 0.125


def there_and_back(method, case, h):
    system, x0 = case.system, case.x0
    middle = co.stepper(system, method, h)(x0)
    return np.max(np.abs(co.stepper(system, method, -h)(middle, h) - x0))


SYMMETRIC = [p for p in pairs(all_cases()) if schemes()[p[0]].symmetric]
LOPSIDED = [s for s, m in schemes().items() if not m.symmetric]


@pytest.mark.thinned(8)
@pytest.mark.parametrize(("scheme", "case"), SYMMETRIC)
def test_symmetric_where_declared(scheme, case):
    method, there = schemes()[scheme], all_cases()[case]
    run = co.integrate(there.system, there.x0, (0.0, H), H, method)
    # Two steps, each of `evaluations` times n roundings, amplified by at most the condition of the step back.
    P = co.stepper(there.system, method, H).tangent(there.x0)
    work = 4 * len(there.x0) * (run.stats.evaluations + 1)
    # Matrices move in their algebra alone.
    moving = there.system.algebra.dim if isinstance(there.system, co.MatrixSystem) else len(P)
    values = np.linalg.svd(P, compute_uv=False)[:moving]
    size = np.linalg.norm(1.0 / values) * np.linalg.norm(P) * np.linalg.norm(there.x0)
    assert there_and_back(method, there, H) <= 2 * work * U * size


def there_and_back_in_forty_digits(method, case, h):
    system = case.system
    with mpmath.workdps(40):
        x0, length = np.array([mpmath.mpf(v) for v in case.x0]), mpmath.mpf(h)
        back = method.step(system, method.step(system, x0, mpmath.mpf(0), length), length, -length)
        return float(max(abs(v) for v in back - x0))


@pytest.mark.thinned(8)
@pytest.mark.parametrize("scheme", LOPSIDED)
@pytest.mark.parametrize("case", ["so(3), diagonal", "e(3), full, axes permuted"])
def test_order_of_the_asymmetry(scheme, case):
    """psi_(-h) psi_h - 1 = O(h^k): k = p + 1, or p + 2 where p is even and the leading term, odd in h, cancels."""
    method = schemes()[scheme]
    # High orders reach round-off in double precision too soon.
    precise = method.order >= 5 and hasattr(method, "step")
    measure = there_and_back_in_forty_digits if precise else there_and_back
    steps = [(0.05 if precise else 0.1) / 2 ** (k / 2) for k in range(5)]
    found = order_of(steps, [float(measure(method, cases()[case], h)) for h in steps], 1)
    expected = method.order + (2 if method.order % 2 == 0 else 1)
    assert found.agrees_with(expected), found


def test_adjoint_of_first_order_splitting_is_its_inverse():
    for case in cases().values():
        forward = co.stepper(case.system, co.Splitting(order=1), 0.2)
        back = co.stepper(case.system, co.Splitting(order=1, adjoint=True), -0.2)
        x = back(forward(case.x0), 0.2)
        assert np.max(np.abs(x - case.x0)) < 200 * len(case.x0) * U * np.max(np.abs(case.x0)) * 4
