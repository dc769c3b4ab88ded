"""Wrong arguments of runs: refused in one line that names them; energies and functions without a value."""

import math

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
BARE = co.LiePoissonSystem(
    co.LieAlgebra.from_brackets(3, {(0, 2): {0: 2.0, 1: -1.0}, (1, 2): {0: 1.0, 1: 2.0}}),
    co.Quadratic(1.0),
    name="bare spiral",
)
PLANE = co.PoissonSystem(lambda x: np.array([[0.0, 1.0], [-1.0, 0.0]]), co.Quadratic([1.0, 2.0]), name="plane")


@pytest.mark.parametrize(
    ("change", "error", "named"),
    [
        ({"step": 0.3}, ValueError, ("0.3", "1.0", "0.25", "0.333")),
        ({"t_span": (1e17, 1e17 + 1024), "step": 1.0}, ValueError, ("too small", "times")),
        ({"system": "rigid_body"}, TypeError, ("system", "rigid_body", "LiePoissonSystem")),
        ({"system": co.algebras.so(3)}, TypeError, ("system", "LiePoissonSystem", "PoissonSystem")),
        ({"x0": "abc"}, TypeError, ("x0", "abc", "real numbers")),
        ({"x0": (1j, 2, 3)}, TypeError, ("x0", "real numbers")),
        ({"x0": (1.0, math.nan, 0.0)}, ValueError, ("x0", "NaN")),
        ({"x0": (1.0, 2.0)}, ValueError, ("x0", "(2,)", "(members, 3)")),
        ({"x0": np.zeros((2, 2, 3))}, ValueError, ("x0", "(2, 2, 3)")),
        ({"x0": np.zeros((0, 3))}, ValueError, ("x0", "one member")),
        ({"save_every": 0}, ValueError, ("save_every", "0")),
        ({"save_every": 2.5}, ValueError, ("save_every", "2.5")),
        ({"step": 0.0}, ValueError, ("step", "0.0", "positive")),
        ({"step": "0.1"}, TypeError, ("step", "'0.1'")),
        ({"t_span": (0, math.inf)}, ValueError, ("t_span", "inf")),
        ({"t_span": 1.0}, ValueError, ("t_span", "1.0", "two numbers")),
        ({"t_span": (0, "1")}, TypeError, ("t_span", "'1'")),
        ({"threads": 0}, ValueError, ("threads", "0")),
        ({"watch": "no"}, TypeError, ("watch", "'no'")),
        ({"method": "strang"}, ValueError, ("'strang'", "CommutatorFree", "Taylor")),
        ({"method": 2}, TypeError, ("method", "2", "Splitting")),
        ({"method": co.Splitting}, TypeError, ("class Splitting", "Splitting()")),
        ({"attitude": "quaternion"}, ValueError, ("attitude", "'quaternion'", "'coadjoint'")),
        ({"attitude": np.eye(2)}, ValueError, ("attitude", "(2, 2)", "(3, 3)")),
        ({"attitude": np.full((3, 3), math.nan)}, ValueError, ("attitude", "NaN")),
        ({"attitude": np.ones((3, 3))}, ValueError, ("attitude", "singular")),
        ({"attitude": True, "system": BARE}, ValueError, ("bare spiral", "representation", "'coadjoint'")),
        (
            {"attitude": True, "system": PLANE, "x0": (1.0, 0.0), "method": co.GaussLegendre(1)},
            ValueError,
            ("plane", "Lie algebra"),
        ),
        ({"system": PLANE, "x0": (1.0, 0.0), "method": co.Splitting()}, ValueError, ("Splitting", "plane")),
        ({"observe": {"e": 3.0}}, TypeError, ("observe['e']", "3.0")),
        ({"observe": {1: lambda x: x[0]}}, TypeError, ("observe",)),
        ({"observe": {"a": lambda x: x}}, TypeError, ("one real number",)),
    ],
)
def test_wrong_arguments_are_refused(change, error, named):
    given = {"system": BODY, "x0": (1.0, 0.0, 0.5), "t_span": (0.0, 1.0), "step": 0.25, **change}
    with refused(error, *named) as refusal:
        co.integrate(**given)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("span", "step"), [((0.0, 1.0), 0.3), ((5.0, 1.0), 0.7), ((0.0, 1.0), 3.0)])
def test_two_nearest_steps_are_suggested(span, step):
    with refused(ValueError, step) as refusal:
        co.integrate(BODY, (1.0, 0.0, 0.5), span, step)
    words = str(refusal.value).partition("nearest")[2].replace(",", " ").split()
    names = []
    for word in words:
        try:
            names.append(float(word.rstrip(".;)")))
        except ValueError:
            continue
    below = max(1, math.floor(abs(span[1] - span[0]) / step))
    counts = [co.integrate(BODY, (1.0, 0.0, 0.5), span, name).stats.steps for name in names]
    assert counts == [below + 1, below]


def test_energy_that_is_not_finite_is_an_error():
    H = co.Hamiltonian(lambda x: math.log(x[0]), lambda x: np.array([1 / x[0], 0.0, 0.0]))
    system = co.LiePoissonSystem(BODY.algebra, H)
    with refused(co.IntegrationError, "energy at t = 0 is not") as failure:
        co.integrate(system, (-1.0, 1.0, 1.0), (0, 1), 0.1, co.GaussLegendre(2))
    assert np.all(np.isfinite(failure.value.partial.x))


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_first_point_without_energy_is_named(way):
    """x1 is cos(t - 1), negative from step 13 on, of which step 15 is saved."""
    H = co.Hamiltonian(lambda x: x[2] + 0.0 * math.log(x[0]), lambda x: np.array([0.0, 0.0, 1.0]))
    turning, span = co.LiePoissonSystem(BODY.algebra, H, casimirs={}), (1.0, 1.0 + 2.5 * way)
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(turning, (1.0, 0.0, 0.5), span, 0.125, co.GaussLegendre(2), save_every=3)
    error = failure.value
    assert (error.step, error.time) == (15, 1.0 + way * 15 * 0.125)
    assert f"energy at t = {error.time:g} is not" in str(error)
    assert len(error.partial.t) == 8 and np.isnan(error.partial.energy).tolist() == [False] * 5 + [True] * 3


def raising(x, t):
    if t > 0.7:
        raise ValueError("no table at this time")
    return np.array([0.0, 0.0, 1.0])


def undefined(x, t):
    return np.array([0.0, np.sqrt(0.7 - t), 0.0])


def law(t):
    return np.array([0.0, np.sqrt(0.7 - t), 0.0])


FAILING = {
    "raises": (BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque(raising)), "ValueError", "no table"),
    "nan": (BODY.with_forces(co.forces.Torque(undefined), co.forces.LinearDamping(0.1)), "gives", "nan"),
}


@pytest.mark.parametrize("save_every", [1, 4])
@pytest.mark.parametrize("name", FAILING)
@pytest.mark.filterwarnings("error")
def test_a_torque_that_fails_is_named_with_its_time_and_what_it_gave(name, save_every, capfd):
    system, *said = FAILING[name]
    x0 = np.array([0.1, 0.2, 0.3])
    with refused(co.IntegrationError, "step 6", "0.625", "Torque", *said, "0.7", "correct the function") as caught:
        co.integrate(system, x0, (0, 1), 0.125, save_every=save_every)
    assert caught.value.step == 6 and 0.7 < float(str(caught.value).partition(";")[0].split()[-1]) <= 0.75
    assert "smaller step" not in str(caught.value)
    ready = co.prepare(system, step=0.125)
    for call in (lambda: ready.end(x0, (0, 1)), lambda: co.stepper(system, co.Splitting(), 0.125)(x0, 0.625)):
        with refused(co.IntegrationError, "Torque", *said):
            call()
    with refused(co.IntegrationError, "Torque", *said, "2 of 2 members"):
        ready.run([x0, 2 * x0], (0, 1))
    assert capfd.readouterr() == ("", "")


def energy(x, t):
    return x[0] * x[1] * np.sqrt(0.7 - t)


@pytest.mark.filterwarnings("error")
def test_laws_energies_and_flows_that_fail_are_named(capfd):
    sat = co.systems.body((1.0, 2.0, 2.5)).with_forces(
        co.forces.Torque((0.0, 0.0, 0.1)), co.forces.Sampled(co.forces.Torque(law), 0.25)
    )
    with refused(co.IntegrationError, "the law of Sampled", "nan", "0.75"):
        co.integrate(sat, sat.state(), (0, 1), 0.125)
    own = BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x * np.exp(-tau * np.sqrt(0.7 - t)), name="mine"))
    with refused(co.IntegrationError, "mine", "nan"):
        co.integrate(own, (0.1, 0.2, 0.3), (0, 1), 0.125)
    driven = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(energy), name="driven")
    with refused(co.IntegrationError, "gradient of the energy of driven", "nan", "correct"):
        co.integrate(driven, (0.1, -1.0, 0.4), (0, 1), 0.125)
    assert capfd.readouterr() == ("", "")


def test_a_number_that_overflows_is_no_fault_of_a_function():
    # At the second rate the first flow overflows, before the energy is called: exp(1000).
    for rate, step in ((-200.0, 0.5), (-2000.0, 1.0)):
        growing = BODY.with_forces(co.forces.LinearDamping(rate))
        with refused(co.IntegrationError, "overflowed", "smaller step"):
            co.integrate(growing, (0.1, 0.2, 0.3), (0, 10), step)


def attraction(r, A):
    return -1.0 / np.sqrt(np.sum((r[0] - r[1]) ** 2))


def test_bodies_at_one_place_are_named():
    pair = co.systems.bodies([(1.0, 2.0, 2.5)] * 3, (1.0, 2.0, 3.0), potential=attraction)
    for places in ([(1.0, 0.0, 0.0)] * 2 + [(0.0, 2.0, 0.0)], [(1.0, 0.0, 0.0)] * 3):
        with refused(co.IntegrationError, "bodies 0 and 1", "one place", "t = 2"):
            co.integrate(pair, pair.state(positions=places), (2, 3), 0.125)
