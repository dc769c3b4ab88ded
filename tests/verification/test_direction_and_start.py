"""Backward runs, and runs that do not start at time 0.

A backward run equals the forward run of the mirrored system, with the other sign and H(x, t0 - t).
"""

import dataclasses
import math
from functools import cache

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.datasets.export import dataset_of, rebuild, solution_inputs

from .schemes_under_test import schemes, serves

pytestmark = pytest.mark.thinned(6)

H, STEPS = 0.0625, 12
SCHEMES = sorted(
    set(schemes()) - {"Splitting 2 coordinates", "Taylor 1", "Taylor 2", "Iterated 1", "Modified 1 structure"}
)


def solvable(name, **parameters):
    algebra = co.algebras.get(name, **parameters)
    return algebra, co.Quadratic(np.linspace(0.5, 1.5, algebra.dim), linear=np.linspace(0.3, -0.2, algebra.dim))


# x decays or grows like exp(t), in spirals, or by powers of t.
GROWING = {
    "A2,1": solvable("A2,1"),
    "A3,2": solvable("A3,2"),
    "A3,5": solvable("A3,5", a=0.5),
    "A3,7": solvable("A3,7", a=0.75),
    "A4,7": solvable("A4,7"),
    "A5,3": solvable("A5,3"),
    "e(3)": solvable("e(3)"),
}
SHIFTED = {
    "so(3)": (co.algebras.so(3), co.Quadratic((1.0, 0.5, 0.25))),
    "so(4)": (co.algebras.so(4), co.Quadratic(np.linspace(0.5, 1.5, 6))),
    "su(3)": (co.algebras.su(3), co.Quadratic(np.linspace(0.5, 1.5, 8))),
}


def start_of(algebra):
    return np.linspace(0.7, -0.4, algebra.dim)


def kind_of(method, system):
    return False if method.properties(system).attitude == "none" else "coadjoint"


def same_motion(one, other):
    """Compare all arrays except the times."""
    assert np.array_equal(one.x, other.x) and np.array_equal(one.energy, other.energy)
    for name in one.casimirs:
        assert np.array_equal(one.casimirs[name], other.casimirs[name])
    drifts = one.drift(), other.drift()
    for name in drifts[0]:
        assert np.array_equal(drifts[0][name].tenths, drifts[1][name].tenths)
    assert (one.attitude is None) == (other.attitude is None)
    assert one.attitude is None or np.array_equal(one.attitude, other.attitude)
    assert (one.stats.steps, one.stats.evaluations) == (other.stats.steps, other.stats.evaluations)


@pytest.mark.thinned(40)
@pytest.mark.parametrize("name", [*GROWING, *SHIFTED])
@pytest.mark.parametrize("scheme", SCHEMES)
def test_backward_equals_forward_in_the_mirrored_system(scheme, name):
    algebra, hamiltonian = (GROWING | SHIFTED)[name]
    method, x0 = schemes()[scheme], start_of(algebra)
    system, mirrored = (co.LiePoissonSystem(algebra, hamiltonian, sign=sign) for sign in (1, -1))
    if not serves(method, system):
        return
    how = {"save_every": 5, "attitude": kind_of(method, system)}
    for x in (x0, np.array([x0, 0.5 * x0, -x0])):
        back = co.integrate(system, x, (2.5, 2.5 - STEPS * H), H, method, **how)
        same_motion(back, co.integrate(mirrored, x, (0.0, STEPS * H), H, method, **how))
        assert back.t.tolist() == [2.5 - H * k for k in (0, 5, 10, 12)]
        assert (back.t_span, back.step) == ((2.5, 2.5 - STEPS * H), H)


@pytest.mark.parametrize("time", [20.0, -20.0])
@pytest.mark.parametrize("sign", [1, -1])
def test_growth_and_decay_over_many_orders_of_magnitude(sign, time):
    """H = x3 on A3,3, [e1, e3] = e1 and [e2, e3] = e2: x1 and x2 are proportional to exp(sign t)."""
    system = co.LiePoissonSystem(co.algebras.get("A3,3"), co.Quadratic(0.0 * np.eye(3), linear=[0, 0, 1.0]), sign=sign)
    x0 = np.array([0.75, -0.5, 0.25])
    expected = x0 * np.array([math.exp(sign * time)] * 2 + [1.0])
    for start in (0.0, 1e3):
        sol = co.integrate(system, x0, (start, start + time), 0.25, attitude="coadjoint", save_every=80)
        # A relative rounding or two in each of 80 steps.
        np.testing.assert_allclose(sol.x[-1], expected, rtol=80 * 4 * 2.0**-53)
        np.testing.assert_allclose(sol.attitude[-1] @ sol.x[-1], x0, rtol=80 * 8 * 2.0**-53)


def test_backward_shifted_attitude_matches_closed_form():
    body, x0 = co.systems.rigid_body((1.0, 2.0, 3.0)), np.array([0.3, 1.0, -0.5])
    given = body.exact((1.0, 0.2, 0.4), 1.7, attitude=True)[1]
    sol = co.integrate(body, x0, (3, -7), 1 / 512, co.Splitting(order=4), attitude=given, save_every=640)
    x, A = body.exact(x0, sol.t - 3, attitude=given)
    assert np.abs(sol.attitude - A).max() < 1e-10 and np.abs(sol.x - x).max() < 1e-10


# Time-dependent Hamiltonians.

RATE = 1.5


def driven(begin, direction):
    """Return a term that is driven by a clock of this start and direction."""
    return (
        lambda y, t: 0.5 * y * y + math.sin(RATE * (begin + direction * t)) * y,
        lambda y, t: y + math.sin(RATE * (begin + direction * t)),
        lambda y, t: 1.0 + 0.0 * y * t,
    )


CLOCKS = {"plain": driven(0.0, 1.0), "7.25 later": driven(7.25, 1.0), "mirrored about 7.25": driven(7.25, -1.0)}


@cache
def driven_system(name, clock, sign=1):
    """Return a system with sin(t) in H, with a shifted or mirrored clock."""
    algebra = GROWING[name][0] if name in GROWING else co.algebras.get(name)
    H = co.Separable({0: CLOCKS[clock], 2: CLOCKS[clock]}) if algebra.dim > 2 else co.Separable({0: CLOCKS[clock]})
    return co.LiePoissonSystem(algebra, H, sign=sign)


def in_given_order(method):
    """Return the scheme with fixed parts: automatic ones depend on H at time 0."""
    if isinstance(method, co.Composition):
        return dataclasses.replace(method, base=in_given_order(method.base))
    if not isinstance(method, co.methods.FlowMethod):
        return method
    if "parts" in {field.name for field in dataclasses.fields(method)}:
        return dataclasses.replace(method, parts="coordinates")
    copy = object.__new__(type(type(method).__name__, (type(method),), {"parts": "coordinates"}))
    vars(copy).update(vars(method))
    return copy


DRIVEN = ("so(3)", "A3,5", "A3,7", "sl(2)")
CLOCKED = [(s, name) for name in DRIVEN for s in SCHEMES if serves(schemes()[s], driven_system(name, "plain"))]


@pytest.mark.thinned(28)
@pytest.mark.parametrize(("scheme", "name"), CLOCKED)
def test_shifted_and_mirrored_clocks(scheme, name):
    """From 7.25 as with a clock 7.25 ahead from 0, and backward as mirrored."""
    method, x0 = in_given_order(schemes()[scheme]), np.array([[0.7, -0.4, 0.5], [0.2, 0.3, -0.6]])
    plain = driven_system(name, "plain")
    how = {"save_every": 5, "attitude": kind_of(method, plain)}
    for end, other in (
        (7.25 + STEPS * H, driven_system(name, "7.25 later")),
        (7.25 - STEPS * H, driven_system(name, "mirrored about 7.25", -1)),
    ):
        one = co.integrate(plain, x0, (7.25, end), H, method, **how)
        two = co.integrate(other, x0, (0.0, STEPS * H), H, method, **how)
        # Times near 7 are rounded to 2^-51, and iterations may stop elsewhere: 12 steps, of stages and a few solves.
        close = {"rtol": 1e-11, "atol": 1e-11}
        np.testing.assert_allclose(one.x, two.x, **close)
        np.testing.assert_allclose(one.energy, two.energy, **close)
        np.testing.assert_allclose(one.drift()["energy"].tenths, two.drift()["energy"].tenths, **close)
        if one.attitude is not None:
            np.testing.assert_allclose(one.attitude, two.attitude, **close)
        energies = [[plain.energy(x, t) for x in states] for states, t in zip(one.x, one.t, strict=True)]
        np.testing.assert_allclose(one.energy, energies, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("span", [(7.25, 9.25), (7.25, 5.25), (-3.5, -1.5)], ids=str)
def test_observables_are_evaluated_at_their_time(span):
    system = driven_system("so(3)", "plain")
    observe = {
        "of x": lambda x: x[0] * x[1] - x[2],
        "of x and t": lambda x, t: x[0] * math.cos(t) + t,
        "a polynomial": co.Polynomial({(2, 0, 1): 1.0, (0, 1, 0): -2.0}),
        "a quadratic": co.Quadratic((1.0, 2.0, 3.0)),
    }
    x0 = np.array([[0.7, -0.4, 0.5], [0.2, 0.3, -0.6]])
    batch = co.batch([system, system])
    for what, x in ((system, x0[0]), (system, x0), (batch, x0)):
        sol = co.integrate(what, x, span, H, observe=observe, save_every=3)
        states, times = sol.x.reshape(len(sol.t), -1, 3), sol.t
        direction = math.copysign(H, span[1] - span[0])
        assert times.tolist() == [span[0] + k * direction for k in [*range(0, 32, 3), 32]]
        expected = {
            "of x": lambda y, t: y[0] * y[1] - y[2],
            "of x and t": lambda y, t: y[0] * math.cos(t) + t,
            "a polynomial": lambda y, t: y[0] ** 2 * y[2] - 2 * y[1],
            "a quadratic": lambda y, t: 0.5 * (y[0] ** 2 + 2 * y[1] ** 2 + 3 * y[2] ** 2),
        }
        for name, function in expected.items():
            values = [[function(y, t) for y in row] for row, t in zip(states, times, strict=True)]
            found = np.reshape(sol.observed[name], (len(times), -1))
            np.testing.assert_allclose(found, values, rtol=4e-15, atol=4e-15, err_msg=name)


# Autonomous systems.


@pytest.mark.thinned(15)
@pytest.mark.parametrize("name", [*GROWING, *SHIFTED])
def test_start_time_does_not_change_autonomous_bits(name):
    algebra, hamiltonian = (GROWING | SHIFTED)[name]
    system, x0 = co.LiePoissonSystem(algebra, hamiltonian), np.multiply.outer([1.0, 0.5], start_of(algebra))
    for scheme in ("Splitting 2", "Splitting 4", "GaussLegendre 2", "Taylor 6", "RadauEnergy 2", "rk4"):
        method = schemes()[scheme]
        if not serves(method, system):
            continue
        how = {"save_every": 5, "attitude": kind_of(method, system), "observe": {"first": lambda x: x[0]}}
        for direction in (1.0, -1.0):
            end = direction * STEPS * 0.1
            here = co.integrate(system, x0, (0.0, end), 0.1, method, **how)
            for t0 in (7.25, -1e6):
                there = co.integrate(system, x0, (t0, t0 + end), 0.1, method, **how)
                same_motion(here, there)
                assert np.array_equal(here.observed["first"], there.observed["first"])
                assert there.t.tolist() == [t0 + k * direction * 0.1 for k in (0, 5, 10, 12)]


@pytest.mark.parametrize("span", [(7.25, 8.25), (7.25, 6.25)], ids=str)
@pytest.mark.parametrize("name", ["so(4)", "A5,3", "A2,1"])
def test_dataset_stores_times_and_is_rebuilt(name, span):
    algebra, hamiltonian = (GROWING | SHIFTED)[name]
    system = co.LiePoissonSystem(algebra, hamiltonian)
    sol = co.integrate(system, start_of(algebra), span, H, attitude="coadjoint", save_every=3)
    dataset = dataset_of(sol)
    assert np.array_equal(dataset["time"].values, sol.t) and sol.t[0] == span[0] and sol.t[-1] == span[1]
    assert solution_inputs(dataset)["t_span"] == span
    again = rebuild(dataset)
    same_motion(sol, again)
    assert np.array_equal(again.t, sol.t)


def test_stepper_at_a_time():
    for name in DRIVEN:
        system, x0 = driven_system(name, "plain"), np.array([0.7, -0.4, 0.5])
        for scheme in ("Splitting 2", "GaussLegendre 2", "rk4"):
            for h in (H, -H):
                sol = co.integrate(system, x0, (7.25, 7.25 + h), H, schemes()[scheme])
                assert np.array_equal(co.stepper(system, schemes()[scheme], h)(x0, 7.25), sol.x[-1])


@pytest.mark.parametrize("span", [(7.25, 107.25), (7.25, -92.75)], ids=str)
def test_failure_names_its_time(span):
    """The motion blows up in one direction of each sign."""
    direction = math.copysign(1.0, span[1] - span[0])
    algebra = co.algebras.get("A2,1")
    for sign in (1, -1):
        system = co.LiePoissonSystem(algebra, co.Polynomial({(1, 1): 4.0}), sign=sign)
        x0 = np.array([0.5, 0.5])
        try:
            co.integrate(system, x0, span, 0.25, co.ExplicitRungeKutta("rk4"), save_every=2)
        except co.IntegrationError as failure:
            assert failure.time == 7.25 + direction * (failure.step - 1) * 0.25
            assert f"at t = {failure.time:g}" in str(failure)
            times = failure.partial.t
            assert times[0] == 7.25 and np.all(np.diff(times) * direction > 0)
            assert np.all(np.abs(times - 7.25) <= (failure.step - 1) * 0.25) and np.isfinite(failure.partial.x).all()
            return
    raise AssertionError("neither sign fails")
