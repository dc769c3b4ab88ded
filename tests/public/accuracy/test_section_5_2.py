"""Section 5.2: rigid body and attitude, M = diag(1, 1/2, 1/3), x(0) = (1, 10, 1), A(0) = 1, h = 0.1."""

import numpy as np
import pytest

import coadjoint as co

MASSES = (1.0, 0.5, 1 / 3)
X0, H = np.array([1.0, 10.0, 1.0]), 0.1
BODY = co.systems.paper_rigid_body(MASSES)
TIMES = (1.0, 2.0, 5.0, 10.0, 20.0)


def angle_between(A, B):
    R = A.T @ B
    axial = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(axial) / 2, (np.trace(R) - 1) / 2))


def carried(method, t, h=H, x0=X0, system=BODY):
    return co.integrate(system, x0, (0.0, t), h, method, attitude=True)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("method", "errors"),
    [
        (co.GaussLegendre(1), (0.152, 0.280, 0.678, 1.39, 2.73)),
        (co.ModifiedGaussLegendre(1, freeze="gradient"), (0.092, 0.189, 1.58, 2.40, 2.67)),
        (co.Splitting(order=2, parts="coordinates"), (0.020, 0.008, 0.107, 0.198, 0.146)),
    ],
)
def test_attitude_errors_match_the_paper(method, errors):
    run = carried(method, 20.0)
    for t, printed in zip(TIMES, errors, strict=True):
        exact = BODY.exact(X0, t, attitude=True)[1]
        found = angle_between(exact, run.attitude[round(t / H)])
        # Half a unit of the last digit printed, or 2 per cent.
        half_digit = 0.5e-3 if printed < 1 else 0.5e-2
        assert abs(found - printed) <= max(half_digit, 0.02 * printed), (t, found, printed)


def test_first_entry_of_the_attitude_for_both_signs():
    for system, printed in (
        (BODY, 0.0720212720707),
        (co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(MASSES), sign=-1), -0.404281810695),
    ):
        run = carried(co.GaussLegendre(4), 10.0, 0.01, system=system)
        # Half a unit of the last digit printed, and 4 s = 8th order at h = 0.01 below that.
        assert run.attitude[-1, 0, 0] == pytest.approx(printed, abs=1e-12)


GENTLE, FINE = np.array([1.0, 2.0, 0.5]), 0.05


@pytest.mark.parametrize(
    ("method", "errors"),
    [
        (co.GaussLegendre(1), (0.0038, 0.038, 0.38)),
        (co.Splitting(order=2, parts="coordinates"), (0.00023, 0.0019, 0.019)),
    ],
)
def test_phase_error_of_the_attitude_grows_linearly(method, errors):
    """For splitting about twenty times more slowly."""
    run = co.integrate(BODY, GENTLE, (0.0, 500.0), FINE, method, save_every=100, attitude=True)
    for t, printed in zip((5.0, 50.0, 500.0), errors, strict=True):
        exact = BODY.exact(GENTLE, t, attitude=True)[1]
        found = angle_between(exact, run.attitude[round(t / (100 * FINE))])
        # Two digits printed: half a unit of the second.
        assert abs(found - printed) <= 0.5 * 10 ** (np.floor(np.log10(printed)) - 1), (t, found)


def test_order_of_the_parts_changes_the_error_tenfold():
    printed = {
        (1, 2, 3): 1.1e-3,
        (1, 3, 2): 2.3e-3,
        (2, 3, 1): 2.3e-3,
        (3, 1, 2): 2.6e-3,
        (3, 2, 1): 5.7e-3,
        (2, 1, 3): 1.1e-2,
    }
    exact = BODY.exact(GENTLE, 20.0, attitude=True)[1]
    for order, error in printed.items():
        parts = tuple((i - 1,) for i in order)
        method = co.Splitting(order=2, parts=parts)
        run = co.integrate(BODY, GENTLE, (0.0, 20.0), FINE, method, save_every=400, attitude=True)
        # Two digits printed: within 5 per cent.
        assert angle_between(run.attitude[-1], exact) == pytest.approx(error, rel=0.05), order
