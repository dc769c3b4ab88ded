"""Warnings of long calls: one after some seconds, with their name, the remaining time and the line of the caller."""

import itertools
import time
import warnings

import numpy as np
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


def with_own_torque(k):
    return BODY.with_forces(co.forces.Torque(lambda x: -k * x))


def with_braking(k):
    return BODY.with_forces(co.forces.Torque(lambda x: -k * x * np.abs(x)))


def own_energy(k):
    return co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(lambda x: k * x @ x, lambda x: 2 * k * x))


COMPILED = {
    "a torque": lambda k: co.integrate(with_own_torque(k), X0, (0, 1), 0.5, co.Splitting()),
    "a Hamiltonian": lambda k: co.prepare(own_energy(k), co.GaussLegendre(1), 0.5),
    "members": lambda k: co.prepare(
        co.batch([with_braking(k), with_braking(2 * k)]), co.Splitting(parts=((0,), (1,), (2,))), 0.5
    ),
}


@pytest.mark.parametrize("name", COMPILED)
def test_waits_for_numba_are_announced_as_such(name, clock):
    """For each function that is compiled first; machine code that is there takes no time."""
    pytest.importorskip("numba")
    clock[0], k = 9.0, 0.1 + 0.01 * list(COMPILED).index(name)
    (found,) = warnings_of(lambda: COMPILED[name](k))
    assert "machine code of " in str(found.message) and "Numba" in str(found.message)
    assert all("machine code" not in str(one.message) for one in warnings_of(lambda: COMPILED[name](k)))


def test_the_estimate_of_a_batch_is_what_its_systems_have_taken(clock):
    """The first look at the clock after the start is before the second system of three: 9 s for one."""
    systems = [co.LiePoissonSystem(co.algebras.get("A3,7", a=a), co.Quadratic([1, 2, 0.5])) for a in (0.5, 1, 2)]
    clock[0] = 9.0
    (found,) = warnings_of(lambda: co.integrate(co.batch(systems), X0, (0, 1), 0.05, co.Splitting()))
    assert "9 s so far, and about 18 s are left" in str(found.message) and "system 2 of 3" in str(found.message)


def test_one_step_is_in_the_singular(clock):
    clock[0] = 9.0
    (found,) = warnings_of(lambda: co.choose(SO4, Y0, (0, 1), 1e-6))
    assert "1 steps" not in str(found.message)


@pytest.mark.parametrize("name", CALLS)
def test_short_calls_do_not_warn(name, clock):
    clock[0] = 1e-4
    assert warnings_of(CALLS[name]) == []
