"""Reversible steps that follow the speed of the motion: the map, what it preserves, where it gives up."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

TOP = co.LiePoissonSystem(
    co.algebras.e(3), co.Quadratic([1.0, 0.75, 0.5, 0, 0, 0], linear=[0, 0, 0, 0.25, 0, 1.0]), sign=-1, name="top"
)
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
SOLVABLE = co.LiePoissonSystem(
    co.algebras.get("A4,7"), co.Quadratic([0.5, 1.0, 0.75, 0.25], linear=[0.1, 0.2, 0.0, 0.3]), name="solvable"
)
CURVED = co.PoissonSystem(
    lambda x: np.array([[0.0, x[2] * x[2], -x[1]], [-x[2] * x[2], 0.0, x[0]], [x[1], -x[0], 0.0]]),
    co.Quadratic([1.0, 2.0, 3.0]),
    name="curved",
)
POSITIVE = co.Polynomial({(0, 0, 0): 0.5, (2, 0, 0): 1.0, (0, 2, 0): 0.75})
JUMP = (1.3512071919596578, -1.7024143839193155, 1.3512071919596578)
CASES = {
    "flows of a top": (TOP, co.Splitting(order=2), None),
    "flows of order 4": (TOP, co.Splitting(order=4), None),
    "stages of a body, a speed given": (BODY, co.GaussLegendre(2), POSITIVE),
    "stages on a solvable algebra": (SOLVABLE, co.GaussLegendre(3), None),
    "rational steps": (BODY, co.Kahan(), None),
    "a composition, a quadratic speed": (
        BODY,
        co.Composition(co.GaussLegendre(1), JUMP),
        co.Quadratic([2.0, 1.0, 1.0]),
    ),
    "no Lie algebra": (CURVED, co.GaussLegendre(2), POSITIVE),
}


def start_of(system):
    return np.random.default_rng(8).uniform(0.3, 1.0, 6)[: system.dim]


def speed_of(system, speed, x):
    """Return the speed Q at a state and its rate of change Q' / Q; by default Q is |D| / sqrt(n), x' = D x."""
    f = system.vector_field(x)
    if isinstance(speed, co.Polynomial):
        return speed(x), speed.gradient(x) @ f / speed(x)
    if speed is not None:
        Q = 0.5 * x @ np.diag([2.0, 1.0, 1.0]) @ x
        return Q, (np.array([2.0, 1.0, 1.0]) * x) @ f / Q

    def generator(u):
        return np.stack([system.structure_matrix(e) @ u for e in np.eye(system.dim)], axis=1)

    D = generator(system.hamiltonian.gradient(x))
    change = generator(system.hamiltonian.hessian(x) @ f)
    return np.linalg.norm(D) / np.sqrt(system.dim), np.sum(D * change) / np.sum(D * D)


def walked(system, method, x, steps, direction=1.0, rho=None):
    """Return the states between the steps, the lengths, and rho after the last."""
    states, lengths = [np.array(x)], []
    for _ in range(steps):
        Q, rate = speed_of(system, method.speed, states[-1])
        rho = Q + 0.5 * method.stride * direction * rate if rho is None else rho + method.stride * direction * rate
        lengths.append(direction * method.stride / rho)
        states.append(np.asarray(method.base.step(system, states[-1], 0.0, lengths[-1])))
    return np.array(states), np.array(lengths), rho


@pytest.mark.thinned(7)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_steps_can_be_taken_back(name, direction):
    """From the end with the rho of the last step: the same lengths and states in reverse."""
    system, base, speed = CASES[name]
    method = co.ReversibleSteps(base, 0.1, speed)
    forth, lengths, rho = walked(system, method, start_of(system), 60, direction)
    # The first step back has the rho of the last one forth, before what the state at the end adds.
    _, rate = speed_of(system, speed, forth[-1])
    back, returned, _ = walked(system, method, forth[-1], 60, -direction, rho + direction * method.stride * rate)
    # Each step rounds some ten numbers, and errors of a regular motion grow like time.
    assert np.abs(back[::-1] - forth).max() < 60 * 200 * UNIT_ROUNDOFF * np.abs(forth).max()
    assert np.abs(returned[::-1] + lengths).max() < 60 * 200 * UNIT_ROUNDOFF * np.abs(lengths).max()
    assert np.ptp(np.abs(lengths)) > 0.01 * np.abs(lengths).max()


@pytest.mark.thinned(7)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("end", [3.0, -3.0])
def test_a_run_takes_the_steps_of_the_definition(name, end):
    """To each output point by a part of a step, which does not affect the motion."""
    system, base, speed = CASES[name]
    method, x0 = co.ReversibleSteps(base, 0.125, speed), start_of(system)
    sol = co.integrate(system, x0, (0.0, end), 0.25, method)
    states, lengths, _ = walked(system, method, x0, 200, np.sign(end))
    times = np.concatenate([[0.0], np.cumsum(lengths)])
    for k in (1, 5, 12):
        n = np.flatnonzero(np.abs(times) <= abs(sol.t[k]))[-1]
        expected = base.step(system, states[n], 0.0, sol.t[k] - times[n])
        for found in (sol.x[k], method.step(system, x0, 0.0, sol.t[k])):
            assert np.abs(found - expected).max() < 1e4 * UNIT_ROUNDOFF * np.abs(sol.x).max()
    assert np.array_equal(co.integrate(system, x0, (0.0, end), 1.5, method, watch=False).x, sol.x[::6])


@pytest.mark.parametrize("name", CASES)
def test_the_order_is_that_of_the_base_in_the_stride(name):
    system, base, speed = CASES[name]
    x0, errors = start_of(system), []
    exact = co.integrate(system, x0, (0.0, 4.0), 0.015625, co.GaussLegendre(6)).x[-1]
    for stride in (0.1, 0.05) if base.order < 5 else (0.4, 0.2):
        found = co.integrate(system, x0, (0.0, 4.0), 4.0, co.ReversibleSteps(base, stride, speed)).x[-1]
        errors.append(np.linalg.norm(found - exact))
    # What the last, shorter, step takes off the sum of the local errors is a step of some forty.
    assert abs(np.log2(errors[0] / errors[1]) - base.order) < 0.35


def test_casimirs_to_rounding_and_energy_without_drift():
    """A symmetric top whose axis starts near the vertical and falls."""
    system = co.LiePoissonSystem(
        co.algebras.e(3), co.Quadratic([1.0, 1.0, 0.25, 0, 0, 0], linear=[0, 0, 0, 0, 0, 4.0]), sign=-1, name="falling"
    )
    x0 = np.array([1e-3, 0.0, 1.0, 0.02, 0.0, 1.0])
    sol = co.integrate(system, x0, (0.0, 2000.0), 1.0, co.ReversibleSteps(co.Splitting(order=2), 0.05))
    steps = sol.stats.evaluations
    assert steps > 5e4
    for name in sol.casimirs:
        # Each flow rounds, without a preferred sign.
        assert sol.drift()[name] < 64 * UNIT_ROUNDOFF * np.sqrt(steps) * np.abs(sol.x).max() ** 2
    energy = sol.drift()["energy"]
    assert energy < 0.02 and energy.growth < 1.5
    coarser = co.integrate(system, x0, (0.0, 2000.0), 1.0, co.ReversibleSteps(co.Splitting(order=2), 0.1))
    assert 2.5 < coarser.drift()["energy"] / energy < 6.0


def test_a_speed_that_vanishes_is_a_failure():
    ending = co.Polynomial({(0, 0, 0): 0.05, (0, 0, 1): 1.0})
    with refused(co.IntegrationError, "speed"):
        co.integrate(BODY, (1.0, 0.2, 0.3), (0.0, 40.0), 1.0, co.ReversibleSteps(co.Splitting(), 0.1, ending))


@pytest.mark.long
def test_steps_without_end_are_a_failure():
    """Of 1e-9 each more than 2^24 lie in one step of the run; shorter steps of the run have fewer."""
    method = co.ReversibleSteps(co.Splitting(order=2), 1e-9)
    with refused(co.IntegrationError, "2^24 of its own steps"):
        co.integrate(BODY, (1.0, 0.2, 0.3), (0, 1), 1.0, method)
    shorter = co.integrate(BODY, (1.0, 0.2, 0.3), (0, 2e-3), 1e-3, method)
    assert np.abs(shorter.x[-1] - BODY.exact((1.0, 0.2, 0.3), 2e-3)).max() < 1e-8


LINE = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
STRIDE = 0.25
EXPONENTIAL, HYPERBOLIC = co.Polynomial({(1, 0): 1.0}), co.Polynomial({(1, 1): 1.0})


def growing(hamiltonian, end, power):
    """Return the number of own steps, as a power of two, of a run from (0, 1) over one step, and whether it ended.

    The speed of the steps is x2^power. Forward x2 grows: by `hamiltonian` x1 as exp(t), by x1 x2 as 1 / (1 - t).
    """
    system = co.LiePoissonSystem(LINE, hamiltonian)
    x0 = (0.0, 1.0)
    forward = float(np.sign(system.vector_field(np.array(x0))[1]))

    def taken(end, speed, stride=STRIDE):
        method = co.ReversibleSteps(co.Splitting(order=2), stride, co.Polynomial(speed))
        try:
            return co.integrate(system, x0, (0.0, end), abs(end), method).stats.evaluations, True
        except co.IntegrationError as error:
            assert error.step == 1 and "2^24 of its own steps would lie in one step" in str(error)
            return error.partial.stats.evaluations, False

    of_one_step = round(taken(forward * 0.5, {(0, 0): 1.0}, 2.0**-6)[0] / 32)
    evaluations, ended = taken(forward * end, {(0, power): 1.0})
    return np.log2(evaluations / of_one_step), ended


@pytest.mark.parametrize(("end", "power"), [(1.25, 2), (2.0, 2), (1e6, 2), (1.25, 3)])
def test_a_motion_to_infinity_is_given_up_early(end, power):
    """Steps of the length (1 - t)^power: each doubling brings a fixed part of what the doubling before has brought."""
    steps, ended = growing(HYPERBOLIC, end, power)
    assert not ended and steps == pytest.approx(15.0, abs=0.01)


def test_exponential_growth_is_followed_as_far_as_the_steps_reach():
    """Each doubling brings log 2: given up at 2^k where four times what is left is not enough, on both sides."""
    doubling = np.log(2.0)
    for k in (15, 16):
        enough = np.log(2.0**k * STRIDE) + 4.0 * (24 - k) * doubling
        for end, power in ((enough + 0.3, k), (enough - 0.3, k + 1)):
            steps, ended = growing(EXPONENTIAL, end, 1)
            assert not ended and steps == pytest.approx(power, abs=0.01)
    steps, ended = growing(EXPONENTIAL, np.log(2.0**17 * STRIDE), 1)
    assert ended and steps == pytest.approx(17.0, abs=0.05)


def test_base_stride_and_speed_are_given_by_name():
    """As in a configuration file."""
    given = {"stride": 0.2, "speed": [[0.5, [0, 0, 0]], [1.0, [2, 0, 0]]], "base": {"name": "Splitting", "order": 4}}
    speed = co.Polynomial({(0, 0, 0): 0.5, (2, 0, 0): 1.0})
    assert co.methods.get("ReversibleSteps", **given) == co.ReversibleSteps(co.Splitting(order=4), 0.2, speed)
    assert co.methods.get("ReversibleSteps", base={"name": "Kahan"}) == co.ReversibleSteps(co.Kahan())
