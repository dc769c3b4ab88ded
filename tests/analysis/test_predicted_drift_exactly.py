"""Predicted drifts of fields that differ from the exact one by a known clock, or by a turn about the momentum."""

import numpy as np
import pytest

from coadjoint.analysis import periods
from coadjoint.analysis.predicted_drift import predicted_drift
from coadjoint.systems.bodies.rigid_body import so3_body

TENSOR = np.array([[3.0, 0.2, -0.1], [0.2, 1.0, 0.15], [-0.1, 0.15, 0.3]])  # of quick nutation: few steps make a period


@pytest.mark.parametrize(("sign", "x0"), [(-1, (0.3, 0.4, -2.0)), (1, (-20.0, 4.0, 7.0))])
def test_a_clock_and_a_turn_about_the_momentum(monkeypatch, sign, x0):
    """x' = s J(x) u, and g' = -s g D(u): the gradient u + c x moves x as before, and turns g by c |x| more.

    A clock that is fast by e takes the attitude along by e times its mean speed about the momentum, 2T/|x|.
    """
    monkeypatch.setattr(periods, "RELATIVE_TOLERANCE", 1e-10)
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


@pytest.mark.thinned(18)
@pytest.mark.parametrize("turn", [3.0, -3.0])
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("seed", range(3))
def test_less_than_half_a_turn_per_period_has_its_size_and_sense(monkeypatch, seed, sign, turn):
    """The gradient (1 + e) u + c x turns the attitude by c |x| + e x.u/|x| more, whatever the turn of one period is.

    Here c |x| is 3 radians in a period: with one of both signs the angles of the exact and the computed motion lie on
    either side of half a turn, unless the exact one is within 0.14 of whole turns.
    """
    monkeypatch.setattr(periods, "RELATIVE_TOLERANCE", 1e-10)
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    body = so3_body(axes @ np.diag([3.0, 1.0, 0.3]) @ axes.T, sign=sign, name="body", parameters={})
    # Near the first or the last axis, where no separatrix is near.
    start = rng.uniform(0.5, 2.0) * axes @ np.array([(1.0, 0.3, 0.2), (0.2, 0.3, -1.0)][seed % 2])
    gradient, size, e = body.hamiltonian.gradient, np.linalg.norm(start), 1e-3
    own = periods.period(body.vector_field, start).time
    ahead = e * (start @ gradient(start)) / size
    c = (turn * (1.0 + e) / own) / size
    found = predicted_drift(body, start, gradient=lambda x: (1.0 + e) * gradient(x) + c * x, attitude=True)
    # Periods and angles are known to some 1e-8 of a turn.
    assert found.slope == pytest.approx(e, abs=1e-7)
    assert found.precession == pytest.approx(-sign * (c * size + ahead), abs=1e-6 / own)
