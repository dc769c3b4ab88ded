"""Errors in a scheme or a Hamiltonian of a user are refused before the first step, by name."""

import dataclasses

import numpy as np
import pytest

import coadjoint as co
from own_schemes import Classical
from refusals import refused

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X0 = (1.0, 0.2, 0.5)
NO_ALGEBRA = co.PoissonSystem(
    lambda x: np.array([[0.0, x[2], -x[1]], [-x[2], 0.0, x[0]], [x[1], -x[0], 0.0]]), co.Quadratic([1.0, 2, 3])
)


def run(scheme, system=BODY, **options):
    return co.integrate(system, X0, (0, 1), 0.1, scheme, **options)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("given", "named"),
    [
        ((False, False, "quadratics", "none"), ("Casimirs", "'quadratics'")),
        ((False, False, "all", "every"), ("attitude", "'every'")),
        ((1, False, "all", "none"), ("poisson", "1")),
    ],
)
def test_properties(given, named):
    with refused((TypeError, ValueError), *named):
        co.methods.Properties(*given)


@pytest.mark.parametrize("attitude", [False, True])
def test_properties_that_say_nothing(attitude):
    class Silent(Classical):
        def properties(self, system):
            return None

    with refused(TypeError, "properties", "Silent", "None"):
        run(Silent(), attitude=attitude)


@pytest.mark.long
def test_an_attitude_that_nobody_carries():
    class Boasting(Classical):
        def properties(self, system):
            return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="coadjoint")

    with refused(ValueError, 'attitude="coadjoint"', "group element"):
        run(Boasting(), attitude=True)
    assert run(Boasting()).x.shape == (11, 3)


@dataclasses.dataclass(frozen=True)
class Midpoint(co.methods.RungeKuttaMethod):
    """Runge's method, with something wrong."""

    wrong: str = ""

    order, explicit, symmetric = 2, True, False

    @property
    def solver(self):
        return "explict" if self.wrong == "solver" else "explicit"

    def properties(self, system):
        return co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="integrated")

    def coefficients(self, number=float):
        tableau = {
            "node": np.array([0.0, 0.5]),
            "scale": np.ones(2),
            "mix": np.array([[0.0, 0], [0.5, 0]]),
            "out": np.array([0.0, 1.0]),
        }
        changes = {
            "shape": {"mix": np.zeros((2, 1))},
            "none": {name: np.zeros((0, 0) if name == "mix" else 0) for name in tableau},
            "finite": {"out": np.array([0.0, np.nan])},
            "full": {"mix": np.array([[0.0, 0], [0.25, 0.25]])},
        }
        if self.wrong == "list":
            return [1, 2]
        return co.methods.Coefficients(**(tableau | changes.get(self.wrong, {})))

    def forecast(self, ratio):
        return np.zeros(2 if self.wrong == "forecast" else (2, 2))


@pytest.mark.thinned(1)
@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ("solver", ("solver", "'explict'")),
        ("shape", ("mix of Midpoint", "(2, 1)", "(2, 2)")),
        ("none", ("node of Midpoint", "(0,)")),
        ("finite", ("out of Midpoint", "NaN")),
        ("full", ("mix[1, 1] of Midpoint", "0.25")),
        ("forecast", ("forecast of Midpoint", "(2,)", "(2, 2)")),
        ("list", ("coefficients of Midpoint", "coadjoint.methods.Coefficients")),
    ],
)
def test_tableaux(wrong, named):
    with refused((TypeError, ValueError), *named):
        run(Midpoint(wrong))


def test_the_same_tableau_with_nothing_wrong():
    known = run(co.ExplicitRungeKutta("runge2"), attitude=True)
    own = run(Midpoint(), attitude=True)
    assert np.array_equal(own.x, known.x) and np.array_equal(own.attitude, known.attitude)


@dataclasses.dataclass(frozen=True)
class Swept(co.methods.FlowMethod):
    """The second-order splitting, over a fraction of the step."""

    whole: float = 1.0

    order, explicit, symmetric = 2, True, True

    def properties(self, system):
        return co.methods.Properties(poisson=True, energy=False, casimirs="all", attitude="every representation")

    def sweeps(self, number=float):
        half = number(self.whole) / 2
        return [co.methods.Sweep(True, half, number(0)), co.methods.Sweep(False, half, number(1), turn=True)]


def test_flows_need_their_sweeps_alone():
    own, known = run(Swept(), attitude=True), run(co.Splitting(order=2), attitude=True)
    assert np.array_equal(own.x, known.x) and np.array_equal(own.attitude, known.attitude)


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("off", "accepted"), [(2.0**-41, True), (-(2.0**-41), True), (2.0**-39, False), (-0.5, False)])
def test_sweeps_must_cover_the_step(off, accepted):
    """Coefficients of twelve digits add up to one."""
    if accepted:
        assert run(Swept(1.0 + off)).x.shape == (11, 3)
    else:
        with refused(ValueError, "sweeps", f"Swept(whole={1.0 + off})"):
            run(Swept(1.0 + off))


def test_flows_where_there_is_no_algebra():
    with refused(ValueError, "Swept", "Lie algebra", "Poisson system"):
        run(Swept(), NO_ALGEBRA)
