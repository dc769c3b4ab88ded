"""Steps of a driven system from any time and in both directions; derivatives of steps in Python."""

import dataclasses
import math

import numpy as np
import pytest

import coadjoint as co
from methods.own_schemes import Plain

U = 2.0**-53
JUMP = 1 / (2 - 2 ** (1 / 3))
UNEVEN = (JUMP, 1 - 2 * JUMP, JUMP)


def splitting(order, adjoint=False):
    """The parts in the order of the coordinates: the automatic order depends on the Hamiltonian at the time zero."""
    return co.Splitting(order=order, parts="coordinates", adjoint=adjoint)


METHODS = {
    "splitting": splitting(2),
    "first order": splitting(1),
    "adjoint": splitting(1, adjoint=True),
    "suzuki": splitting(4),
    "flows at three fractions": co.Composition(splitting(2), UNEVEN),
    "flows in flows": co.Composition(co.Composition(splitting(2), (0.25, 0.5, 0.25)), UNEVEN),
    "a sweep and its adjoint": co.methods.even_order(splitting(1), 4),
    "stages": co.GaussLegendre(2),
    "stages at three fractions": co.Composition(co.GaussLegendre(1), UNEVEN),
    "a tableau and its adjoint": co.methods.even_order(co.ExplicitRungeKutta("runge2"), 2),
    "Runge-Kutta": co.ExplicitRungeKutta("rk4"),
    "midpoint on the orbit": co.CommutatorFree(2),
    "third order on the orbit": co.CommutatorFree(3),
    "fourth order on the orbit": co.CommutatorFree(4),
}
X0 = np.array([0.4, -0.7, 0.5])


def driven(earlier=0.0, sign=-1):
    """A body in a varying field, with a varying moment; at the time t as another one at t + earlier."""

    def field(y, t):
        return 0.5 * y * y + math.sin(2.0 * (t + earlier)) * y, y + math.sin(2.0 * (t + earlier)), 1.0 + 0.0 * y * t

    def moment(y, t):
        rate = 1.0 + 0.5 * math.cos(3.0 * (t + earlier))
        return 0.5 * rate * y * y, rate * y, rate + 0.0 * y

    terms = {
        0: tuple((lambda y, t, k=k: field(y, t)[k]) for k in range(3)),
        1: tuple((lambda y, t, k=k: moment(y, t)[k]) for k in range(3)),
        2: (lambda y: 0.75 * y * y, lambda y: 1.5 * y, lambda y: 1.5 + 0.0 * y),
    }
    # [e1, e2] = -e3 and a scaled axis, so that no constant is one
    algebra = co.algebras.change_of_basis(co.algebras.so(3), np.diag([-1.0, 2.0, 0.5]))
    return co.LiePoissonSystem(algebra, co.Separable(terms), sign=sign)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("name", METHODS)
def test_a_step_depends_on_the_time_of_the_system_alone(name):
    method, h = METHODS[name], -0.125  # sums of times are exact
    here, there = method.step(driven(), X0, 1.25, h), method.step(driven(1.5), X0, -0.25, h)
    # Each of at most some hundreds of flows evaluates functions whose arguments are equal up to rounding.
    assert np.abs(here - there).max() <= 512 * U


@dataclasses.dataclass(frozen=True)
class Given(Plain):
    """A step of given components."""

    components: tuple

    order, explicit, symmetric, compiles = 1, True, False, False

    def step(self, system, x, t, h):
        return np.array([component(x) for component in self.components])


def test_differences_are_taken_at_the_state_zero_too():
    """The functions of math reject complex numbers."""
    method = Given((lambda x: math.sin(x[0]) + 2.0 * x[1], lambda x: x[0] * x[1] - x[1]))
    plane = co.LiePoissonSystem(co.algebras.get("A2,1"), co.Quadratic([1.0, 1.0]))
    step = co.stepper(plane, method, 0.1)
    assert step.tangent_by(np.zeros(2)) == "differences"
    # Central differences at the distance 2^-17: h^2/6 by the third derivative.
    assert np.abs(step.tangent(np.zeros(2)) - [[1.0, 2.0], [0.0, -1.0]]).max() <= 2.0**-34


def test_a_component_that_is_not_analytic_is_found_among_others():
    """Complex steps give 0, or half of the slope, for the components that depend on x.real or the conjugate."""
    x = np.array([0.6, -1.25, 1.75])
    analytic = [
        (lambda x: np.sin(x[0]) * x[1], [np.cos(x[0]) * x[1], np.sin(x[0]), 0.0]),
        (lambda x: x[0] * x[1] * x[2], [x[1] * x[2], x[0] * x[2], x[0] * x[1]]),
        (lambda x: x[2] ** 2 - x[1], [0.0, -1.0, 2.0 * x[2]]),
    ]
    others = [
        (lambda x: np.abs(x[1]) + x[2], [0.0, -1.0, 1.0]),
        (lambda x: np.real(x[0]) ** 2 * x[2], [2.0 * x[0] * x[2], 0.0, x[0] ** 2]),
        (lambda x: np.conj(x[2]) * x[2] + 0.0 * x[0], [0.0, 0.0, 2.0 * x[2]]),
        (lambda x: np.linalg.norm(x) * x[0], np.linalg.norm(x) * np.eye(3)[0] + x[0] * x / np.linalg.norm(x)),
    ]
    body = co.systems.rigid_body((1.0, 2.0, 3.0))

    def derivative(parts):
        step = co.stepper(body, Given(tuple(function for function, _ in parts)), 0.1)
        return step.tangent_by(x), np.abs(step.tangent(x) - [slope for _, slope in parts]).max()

    by, error = derivative(analytic)
    assert by == "complex step" and error <= 8 * U
    for place in range(3):
        for other in others:
            by, error = derivative([*analytic[:place], other, *analytic[place + 1 :]])
            # Central differences at the distance 2^-17: h^2/6 by the third derivative, and rounding by h.
            assert by == "differences" and error <= 2.0**-31, (place, others.index(other))
