"""Single steps as functions: group elements, derivatives and threads."""

import dataclasses
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import coadjoint as co
from digests.schemes_under_test import COMPOSED, EXAMPLES, serves
from drawn_matrices import wide
from energies import pulsed
from own_schemes import OwnKahan
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(3)


def driven():
    a = (lambda y, t: 0.5 * y * y * (2 + math.sin(t)), lambda y, t: y * (2 + math.sin(t)), lambda y, t: 2 + math.sin(t))
    return co.SplitHamiltonian(
        [((0,), co.Separable({0: a})), ((1, 4), co.Quadratic([1.0, 0.5])), ((2,), co.Quadratic(0.7))]
    )


SYSTEMS = {
    "e(3)": (co.algebras.e(3), co.Quadratic(wide(6, 1), linear=np.arange(6) / 5)),
    "so(4)": (co.algebras.so(4), co.Quadratic(np.linspace(0.5, 1.5, 6))),
    "sl(2)": (co.algebras.sl(2), co.Quadratic(wide(3, 2))),
    "A3,7": (co.algebras.get("A3,7", a=1.75), co.Quadratic([1.0, 2.0, 0.25])),
    "Heisenberg": (co.algebras.heisenberg(2), co.Quadratic(wide(5, 3))),
    "driven so(4)": (co.algebras.so(4), driven()),
}


def setup(name, sign=-1):
    s = co.LiePoissonSystem(*SYSTEMS[name], sign=sign, casimirs={})
    return s, np.linspace(-0.5, 0.75, s.dim)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", ["e(3)", "so(4)", "sl(2)", "A3,7", "driven so(4)"])
def test_group_element_of_a_step(name):
    s, x = setup(name)
    step = co.stepper(s, co.Splitting(order=2), 0.25)
    K, y = step.group(x, attitude="coadjoint"), step(x)
    assert np.abs(K @ y - x).max() <= 64 * s.dim * U * np.linalg.norm(K) * np.linalg.norm(y)
    g = step.group(x)
    assert g.shape == s.representation.shape[1:]
    assert np.array_equal(g, step.group(x, attitude=True))
    for i, rho in enumerate(s.representation):  # the representation of K: g rho(Ad) = rho g
        moved = np.einsum("k,kab->ab", K[i], s.representation)
        assert np.abs(g @ moved - rho @ g).max() <= 256 * U * np.linalg.norm(K) * np.linalg.norm(g)


def test_blow_up_is_an_error():
    s = co.LiePoissonSystem(
        co.algebras.get("A3,7", a=2.0), co.Quadratic([[1.0, 0.3, 0], [0.3, -2.0, 0.1], [0, 0.1, 0.5]])
    )
    with pytest.raises(co.IntegrationError) as failure:
        co.stepper(s, co.Splitting(), 1e3)(np.array([1.0, 2.0, 3.0]))
    assert failure.value.step == 1


STEERED = co.systems.rigid_body(inertia=(1, 2, 2.5)), {"rotors": (2, 0)}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", ["tangent", "tangent_by_inputs"])
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.Taylor(order=4)])
def test_derivatives_belong_to_the_caller(method, name):
    """Later calls do not change those of earlier ones, and these may be written to."""
    step = co.stepper(STEERED[0], method, 0.1, inputs=STEERED[1])
    derivative, states = getattr(step, name), np.array([[1.0, 0.2, 0.5], [0.3, -1.0, 0.4]])
    first = derivative(states[0], rotors=(0.1, -0.2))
    kept = first.copy()
    assert not np.array_equal(derivative(states[1], rotors=(0.5, 0.3)), kept)
    assert np.array_equal(first, kept)
    first[:] = 7.0
    assert np.array_equal(derivative(states[0], rotors=(0.1, -0.2)), kept)


def fading(x, t, tau):
    """A damping that depends on time."""
    return x * np.exp(-tau - np.sin(t + tau) + np.sin(t))


@pytest.mark.thinned(1)
@pytest.mark.parametrize("method", [co.Splitting(order=4), co.Taylor(order=4)])
def test_derivatives_of_a_step_are_those_at_its_time(method):
    damped = STEERED[0].with_forces(co.forces.OwnForce(fading))
    x, u, e = np.array([1.0, 0.2, 0.5]), np.array([0.1, -0.2]), 2.0**-7
    for t, system, h in ((0.0, damped, 0.25), (2.0, damped, 0.25), (-3.0, damped, -0.25), (1.0, STEERED[0], -0.25)):
        step = co.stepper(system, method, h, inputs=STEERED[1])

        def difference(after):
            """Of order 4, with an error of some e^4 and U / e."""
            return (8 * (after(e) - after(-e)) - (after(2 * e) - after(-2 * e))) / (12 * e)

        by_x = [difference(lambda by, v=v, t=t, step=step: step(x + by * v, t, rotors=u)) for v in np.eye(3)]
        by_u = [difference(lambda by, v=v, t=t, step=step: step(x, t, rotors=u + by * v)) for v in np.eye(2)]
        np.testing.assert_allclose(step.tangent(x, t, rotors=u), np.transpose(by_x), rtol=0, atol=8 * e**4)
        np.testing.assert_allclose(step.tangent_by_inputs(x, t, rotors=u), np.transpose(by_u), rtol=0, atol=8 * e**4)


WAVES = co.Separable(dict.fromkeys((0, 2), pulsed(3.0)))
PUSHED = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.4]) + WAVES)


def pushing(x, t):
    """Return a torque of state and time."""
    return 0.5 * np.cos(x + t) * x[1]


# Neither commutes with the other, so that their order counts.
FORCES = (
    co.forces.LinearDamping(np.array([[0.3, 0.2, -0.1], [-0.4, 0.2, 0.3], [0.1, 0.5, 0.4]]), toward=(0.2, -0.1, 0.3)),
    co.forces.Torque(pushing),
)


@pytest.mark.thinned(6)
@pytest.mark.parametrize("forces", [(), FORCES], ids=["alone", "forced"])
@pytest.mark.parametrize("scheme", [one for one in EXAMPLES + COMPOSED if serves(one, PUSHED)], ids=str)
def test_tangents_of_every_scheme_are_those_at_their_time(scheme, forces):
    """For an energy of the time, in compositions also in each substep; the reference are differences of steps."""
    x, e = np.array([0.3, 1.0, 0.2]), 2.0**-7
    for t, h in ((-3.0, 0.25), (2.0, -0.25)):
        step = co.stepper(PUSHED.with_forces(*forces) if forces else PUSHED, scheme, h)
        # Of order 4, with an error of some e^4 and U / e.
        differences = [
            (8 * (step(x + by, t) - step(x - by, t)) - (step(x + 2 * by, t) - step(x - 2 * by, t))) / (12 * e)
            for by in e * np.eye(3)
        ]
        np.testing.assert_allclose(step.tangent(x, t), np.transpose(differences), rtol=0, atol=8 * e**4)


def real(x):
    """Return numbers that cannot be complex."""
    return np.array([float(one) for one in x])


@dataclasses.dataclass(frozen=True)
class RealMidpoint(OwnKahan):
    """The implicit midpoint rule for floats alone."""

    compiles = False

    def step(self, system, x, t, h):
        return co.GaussLegendre(1).step(system, real(x), t, h)


BY = ("formula", "complex step", "differences")  # from the most accurate one
HALVES = (0.5, 0.5)
SCHEMES_BY = [
    *((one, BY[0]) for one in EXAMPLES if not one.own_steps and serves(one, PUSHED)),
    *((around(OwnKahan()), BY[1]) for around in (co.Projected, co.ReversibleSteps, lambda one: one)),
    *((around(RealMidpoint()), BY[2]) for around in (co.Projected, co.ReversibleSteps, lambda one: one)),
    (co.Composition(OwnKahan(), HALVES), BY[1]),
    (co.Composition(RealMidpoint(), HALVES), BY[2]),
    (co.ReversibleSteps(co.Kahan()), BY[1]),
    (co.ReversibleSteps(co.Splitting()), BY[2]),
]
FORCES_BY = [(FORCES[:1], BY[0]), (FORCES, BY[1]), ((co.forces.Torque(lambda x: 0.1 * real(x)), *FORCES), BY[2])]
FACTORS = [(*one, (), BY[0]) for one in SCHEMES_BY] + [(*one, *two) for one in SCHEMES_BY[-7::2] for two in FORCES_BY]


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("scheme", "of_scheme", "forces", "of_forces"), FACTORS)
def test_tangents_are_computed_as_their_least_accurate_factor(scheme, of_scheme, forces, of_forces):
    body = co.systems.rigid_body(inertia=(1, 2, 2.5))
    step = co.stepper(body.with_forces(*forces) if forces else body, scheme, 0.25)
    assert step.tangent_by(np.array([0.3, 1.0, 0.2]), 0.5) == max(of_scheme, of_forces, key=BY.index)


def test_steppers_are_safe_in_threads_and_after_failures():
    step = co.stepper(co.systems.rigid_body(), co.Splitting(), 0.1)
    states = np.random.default_rng(0).standard_normal((400, 3))
    alone = [step(x) for x in states]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(step, states))
    assert all(np.array_equal(a, b) for a, b in zip(alone, together, strict=True))
    step, x = co.stepper(setup("driven so(4)")[0], co.GaussLegendre(3), 0.5), np.linspace(-0.5, 0.75, 6)
    before = step(0.1 * x)
    with pytest.raises(co.IntegrationError):
        step(1e4 * x)
    assert np.array_equal(step(0.1 * x), before)
