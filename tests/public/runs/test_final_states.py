"""`PreparedRun.end`: the final state alone, with the bits, refusals and failures of a run."""

import numpy as np
import pytest
from interrupting import Failing, Interruptible

import coadjoint as co

pytestmark = pytest.mark.filterwarnings("ignore:the steps of:RuntimeWarning")
BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.1, 1.0, 0.2])


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.GaussLegendre(3), co.Taylor(6), Interruptible()], ids=str)
def test_calls_are_independent(method):
    """Compensation, stage guesses and initial invariants are those of the call."""
    ready = co.prepare(BODY, method, 0.1)
    calls = [(x, span) for x in (X, 2.0 * X, -X) for span in ((0.0, 1.0), (1.0, 0.0), (0, 0.1), (2.0, 3.0), (0.0, 1.0))]
    expected = [ready.run(*call).x[-1] for call in calls]
    found = [ready.end(*call) for call in calls]
    assert all(np.array_equal(*pair) for pair in zip(found, expected, strict=True))
    # Arrays that were returned are not written to again.
    assert len({each.ctypes.data for each in found}) == len(calls)


def test_states_in_any_form():
    ready = co.prepare(BODY, None, 0.1)
    expected = ready.end(X, (0, 1))
    for x0 in ([0.1, 1.0, 0.2], (0.1, 1.0, 0.2), np.array([0.1, 9.0, 1.0, 9.0, 0.2])[::2], X.astype(">f8")):
        assert np.array_equal(ready.end(x0, [0, 1]), expected)
    assert np.array_equal(ready.end([0, 1, 0], (0, 1)), ready.end(np.array([0.0, 1.0, 0.0]), (0, 1)))
    assert np.array_equal(ready.end(X, (1.5, 1.5)), X)
    assert np.array_equal(ready.end([X, 2 * X], (0, 1))[0], expected)


def test_spans_changed_in_place_are_read_again():
    ready = co.prepare(BODY, None, 0.1)
    expected = [ready.run(X, (0.0, end)).x[-1] for end in (1.0, 2.0)]
    span, ends = [0.0, 1.0], (np.array(0.0), np.array(1.0))
    for given, end in ((span, span), (ends, ends[1])):
        assert np.array_equal(ready.end(X, given), expected[0])
        end[-1 if end is span else ()] = 2.0
        assert np.array_equal(ready.end(X, given), expected[1])


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


def test_exceptions_of_user_functions_propagate():
    ready = co.prepare(BODY, Failing(0.5), 0.1)
    for _ in range(2):
        assert np.array_equal(ready.end(X, (0, 0.3)), ready.run(X, (0, 0.3)).x[-1])
        with pytest.raises(LookupError, match=r"0\.6"):
            ready.end(X, (0, 1))
