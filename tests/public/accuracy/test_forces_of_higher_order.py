"""Splittings of higher order with forces keep their order, and their derivatives are those of the computed map."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co

TOP = np.array([1.0, 0.5, 0.3, 0.2, 0.3, 0.9])
SPINS = np.array([0.6, 0.0, 0.8, 0.0, -0.6, 0.8, 0.8, 0.6, 0.0])
SPAN = (0.5, 2.5)


def turning(t):
    """Return a torque that depends on time."""
    return np.array([np.sin(t), 0.0, np.cos(2.0 * t), 0.0, 0.0, 0.0])


def of_state(x):
    """Return a torque that depends on the vertical."""
    return np.array([0.2 * x[4] - 0.1 * x[0], -0.2 * x[1], 0.1 * x[3], 0.0, 0.0, 0.0])


def spins():
    """Return a lattice of coupled spins with a damping on the orbit."""
    return co.systems.spin_lattice("chain", 3).with_forces(co.forces.DoubleBracketDamping(0.1))


def so4():
    """Return a body on so(4) with a damping of another rate in each coordinate."""
    body = co.LiePoissonSystem(co.algebras.so(4), co.Quadratic([1.0, 0.5, 0.7, 0.3, 0.9, 0.2]))
    return body.with_forces(co.forces.LinearDamping(np.linspace(0.1, 0.3, 6)))


def fluid():
    """Return a body in an ideal fluid with a linear drag."""
    return co.systems.kirchhoff_body().with_forces(co.forces.LinearDamping(0.1))


def top(*forces):
    """Return a heavy top with forces."""
    return co.systems.heavy_top().with_forces(*forces)


# Torques of the state move by the method of Runge and Kutta, of order 4.
CASES = {
    "damped top": (top(co.forces.LinearDamping(np.array([0.1, 0.2, 0.15, 0.0, 0.0, 0.0]))), TOP, (2, 4, 6, 8)),
    "driven top": (top(co.forces.LinearDamping(0.1), co.forces.Torque(turning)), TOP, (2, 4, 6, 8)),
    "torque of the state": (top(co.forces.Torque(of_state)), TOP, (2, 4)),
    "spins": (spins(), SPINS, (2, 4, 6)),
    "so(4)": (so4(), TOP, (2, 4, 6, 8)),
    "fluid": (fluid(), TOP, (2, 4, 6)),
}


@pytest.mark.parametrize(("name", "order"), [(name, order) for name, case in CASES.items() for order in case[2]])
@pytest.mark.parametrize("backward", [False, True])
def test_orders_against_another_solver(name, order, backward):
    """The error falls by 2^order when the step is halved, less half an order for higher terms."""
    system, x0, _ = CASES[name]
    span = SPAN[::-1] if backward else SPAN
    ref = solve_ivp(lambda t, x: system.vector_field(x, t), span, x0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    method = co.Splitting(order=order)
    errors = [np.abs(co.integrate(system, x0, span, h, method).x[-1] - ref).max() for h in (0.25, 0.125)]
    # DOP853 has an error of some 1e-12.
    assert errors[1] < 2e-12 or np.log2(errors[0] / errors[1]) > order - 0.5


@pytest.mark.parametrize("name", CASES)
def test_ensembles_steppers_and_derivatives(name):
    """Members have the bits of runs alone; tangents are differences; cotangents are transposed tangents."""
    system, x0, _ = CASES[name]
    ready = co.prepare(system, co.Splitting(order=4), step=0.125)
    members = np.array([x0, 0.5 * x0, -x0])
    together = ready.run(members, SPAN)
    for m, x in enumerate(members):
        np.testing.assert_array_equal(np.asarray(together.x)[:, m], ready.run(x, SPAN).x)
    v = np.linspace(-1.0, 1.0, len(x0))
    sol, tangents = ready.jvp(x0, SPAN, {"x0": v}, save_every=16)
    np.testing.assert_array_equal(sol.x, ready.run(x0, SPAN, save_every=16).x)
    shift = 1e-4
    ends = [ready.run(x0 + s * shift * v, SPAN).x[-1] for s in (1, -1)]
    change = np.asarray(tangents.x)[-1].reshape(-1)
    # Differences have errors of shift^2 and u / shift, a few 1e-9 with third derivatives of size one.
    np.testing.assert_allclose(change, (ends[0] - ends[1]) / (2 * shift), atol=1e-7)
    sol, pullback = ready.vjp(x0, SPAN, save_every=16)
    weights = np.zeros(sol.x.shape)
    weights[-1] = v[::-1]
    assert abs(pullback(weights)["x0"] @ v - weights[-1] @ change) < 1e-8


def test_noise_stays_at_order_two():
    """Forces that do not run backward keep the symmetric splitting: forward steps only."""
    algebra = co.algebras.so(3)
    bath = co.forces.HeatBath(0.5, temperature=0.5, seed=7)
    noisy = co.LiePoissonSystem(algebra, co.Polynomial({(0, 0, 1): -1.0})).with_forces(bath)
    assert co.prepare(noisy, co.Splitting(order=4), step=0.1).scheme.order == 2
    assert co.prepare(so4(), co.Splitting(order=4), step=0.1).scheme.order == 4
