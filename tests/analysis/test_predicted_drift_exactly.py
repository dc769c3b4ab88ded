"""Predicted drifts of fields that differ from the exact one by a known clock, or by a turn about the momentum."""

import numpy as np
import pytest

from coadjoint.analysis import periods
from coadjoint.analysis.predicted_drift import predicted_drift
from coadjoint.systems.rigid_body import so3_body

TENSOR = np.array([[3.0, 0.2, -0.1], [0.2, 1.0, 0.15], [-0.1, 0.15, 0.3]])  # of quick nutation: few steps make a period


@pytest.mark.parametrize(("sign", "x0"), [(-1, (0.3, 0.4, -2.0)), (1, (-20.0, 4.0, 7.0))])
def test_a_clock_and_a_turn_about_the_momentum(monkeypatch, sign, x0):
    """x' = s J(x) u, and g' = -s g D(u): the gradient u + c x moves x as before, and turns g by c |x| more.

    A clock that is fast by e takes the attitude along by e times its mean speed about the momentum, 2T/|x|.
    """
    monkeypatch.setattr(periods, "RELATIVE", 1e-10)
    body = so3_body(TENSOR, sign=sign, name="body", parameters={})
    start, gradient = np.array(x0), body.hamiltonian.gradient
    size, c, e = np.linalg.norm(start), 0.02, 0.01
    turned = predicted_drift(body, x0, gradient=lambda x: gradient(x) + c * x, attitude=True)
    # With this tolerance periods and angles are known to some 1e-8; the speeds are of the size of |x|.
    assert turned.slope == pytest.approx(0.0, abs=1e-7)
    assert turned.precession == pytest.approx(-sign * c * size, abs=1e-7 * size)
    fast = predicted_drift(body, x0, gradient=lambda x: (1.0 + e) * gradient(x), attitude=True)
    assert fast.slope == pytest.approx(e, abs=1e-7)
    assert fast.precession == pytest.approx(-sign * e * (start @ gradient(start)) / size, abs=1e-7 * size)
    assert fast.period == pytest.approx((1.0 + e) * fast.modified_period, rel=1e-7)
    assert fast.period == pytest.approx(turned.period, rel=1e-7) == turned.modified_period
