"""`PreparedRun.end`: the final state alone, with the bits, refusals and failures of a run."""

import numpy as np
import pytest

import coadjoint as co

pytestmark = pytest.mark.filterwarnings("ignore:the steps of:RuntimeWarning")
BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.1, 1.0, 0.2])


def test_refusals_equal_those_of_a_run():
    ready = co.prepare(BODY, None, 0.1)
    wrong = [
        (X, (0, 0.25)),
        (X, (0, np.nan)),
        (X, (0, 1, 2)),
        (X[:2], (0, 1)),
        (np.array([0.1, np.nan, 0.2]), (0, 1)),
        (np.array([0.1, -np.inf, np.inf]), (0, 1)),
        (np.array([True, False, True]), (0, 1)),
        ("x", (0, 1)),
        (1e300 * X, (0, 1)),
    ]
    for call in wrong:
        with pytest.raises((ValueError, TypeError, co.IntegrationError)) as expected:
            ready.run(*call)
        for _ in range(2):
            with pytest.raises(expected.type) as found:
                ready.end(*call)
            assert str(found.value) == str(expected.value)
        assert np.array_equal(ready.end(X, (0, 1)), ready.run(X, (0, 1)).x[-1])
