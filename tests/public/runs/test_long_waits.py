"""Warnings of long calls: one after some seconds, with their name, the remaining time and the line of the caller."""

import itertools
import time
import warnings

import pytest

import coadjoint as co

BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), (0.3, 1.0, 0.2)
SO4 = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 2.0, 3.0, 4.0, 5.0, 7.0]))
Y0 = [0.3, 1.0, 0.2, 0.1, -0.4, 0.5]
CALLS = {
    "certify": lambda: co.certify(BODY, co.Splitting(), X0, 0.1, steps=8),
    "choose": lambda: co.choose(BODY, X0, (0, 1), 1e-6),
    "integrate": lambda: co.integrate(SO4, Y0, (0, 1), 0.1, co.Splitting()),
    "prepare": lambda: co.prepare(co.LiePoissonSystem(co.algebras.so(4), SO4.hamiltonian), co.Splitting(), 0.1),
    "lyapunov": lambda: co.lyapunov(BODY, X0, (0, 1), 0.1),
    "Splitting.tuned": lambda: co.Splitting.tuned(SO4, Y0),
    "tangent": lambda: co.stepper(BODY, co.Taylor(4), 0.1).tangent(X0),
}


@pytest.fixture
def clock(monkeypatch):
    """Return a list with the seconds that pass at each look at the clock."""
    passed, looks = [0.0], itertools.count()
    monkeypatch.setattr(time, "monotonic", lambda: passed[0] * next(looks))
    return passed


def warnings_of(action):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        action()
    assert all(one.category is co.LongWait for one in found)
    return found


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", CALLS)
def test_long_calls_warn_once_by_their_name(name, clock):
    """Only the outermost operation warns, by the line of its caller."""
    clock[0] = 9.0
    (found,) = warnings_of(CALLS[name])
    message = str(found.message)
    assert message.startswith(f"{name} has taken ") and message.endswith("; Ctrl-C ends it")
    assert found.filename == __file__


@pytest.mark.parametrize("name", CALLS)
def test_short_calls_do_not_warn(name, clock):
    clock[0] = 1e-4
    assert warnings_of(CALLS[name]) == []
