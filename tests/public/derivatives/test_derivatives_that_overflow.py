"""Derivatives that overflow in some members leave those of the others."""

import pickle

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)


# x2' = x2 on the plane: from 1e-300 the motion stays finite, and its derivative grows beyond all numbers.
LINE = co.LiePoissonSystem(co.LieAlgebra([(0, 1, 1, 1.0)], dim=2), co.Quadratic([0, 0], linear=[1.0, 0.0]))
LONG = (0.0, -720.0)


@pytest.mark.parametrize("system", [LINE, co.batch([LINE] * 3)], ids=["ensemble", "batch"])
def test_members_whose_derivatives_overflow_do_not_affect_others(system):
    """The errors contain the derivatives of all members, of which the others have the bits of single runs."""
    together, ready = (co.prepare(one, co.Splitting(order=1), 1.0) for one in (system, LINE))
    x0 = np.array([[1e-300, 1e-300], [1e-300, 0.0], [1e-300, 1e-300]])
    directions = np.array([[1.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    plain = ready.run(x0, LONG, 10)
    assert np.isfinite(plain.x).all() and plain.x.max() > 1.0
    with refused(co.IntegrationError, "x", "-710", "shorter span") as raised:
        together.jvp(x0, LONG, {"x0": directions}, 10)
    found = raised.value.derivatives
    assert (raised.value.step, raised.value.time) == (710, -710.0) and np.array_equal(raised.value.partial.x, plain.x)
    sol, alone = ready.jvp(x0[1], LONG, {"x0": directions[1]}, 10)
    assert np.array_equal(found.x[:, 1], alone.x) and np.isfinite(alone.x).all()
    assert not np.isfinite(found.x[:, 0]).all() and not np.isfinite(found.x[:, 2]).all()
    # The second member has no cotangent along the growing coordinate.
    _, pullback = together.vjp(x0, LONG, 10)
    cotangents = np.ones((len(sol.t), 3, 2))
    cotangents[:, 1] = [1.0, 0.0]
    with refused(co.IntegrationError, "x0", "overflows", "shorter span") as raised:
        pullback(cotangents)
    expected = ready.vjp(x0[1], LONG, 10)[1](cotangents[:, 1])["x0"]
    for error in (raised.value, pickle.loads(pickle.dumps(raised.value))):
        assert np.isfinite(expected).all() and np.array_equal(error.derivatives["x0"][1], expected)
        assert not np.isfinite(error.derivatives["x0"][[0, 2]]).all()
    # Those of earlier points do not overflow.
    gradient = pullback(cotangents * (sol.t >= -700)[:, None, None])["x0"]
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 1e300
