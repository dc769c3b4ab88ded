"""Fields and flows of forces in Python against formulas and another solver; metrics of damping and heat baths."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import coadjoint as co
from metrics import SEMIDEFINITE, block
from refusals import refused

BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
X = np.array([0.7, -0.4, 1.1])
RATE = np.array([[0.5, 0.25, 0.0], [-1.0, 0.75, 0.125], [0.0, 0.5, 2.0]])
U = 2.0**-53


@pytest.mark.thinned(1)
@pytest.mark.parametrize("tau", [0.75, -0.5, 3.0])
@pytest.mark.parametrize("toward", [0.0, 0.25, (0.5, -1.0, 2.0)])
@pytest.mark.parametrize("rate", [0.4, -0.3, (0.5, 0.0, -0.25), RATE, np.zeros((3, 3))], ids=str)
def test_linear_damping(rate, toward, tau):
    dense = np.asarray(rate) if np.ndim(rate) == 2 else np.diag(np.broadcast_to(rate, 3))
    aim, force = np.broadcast_to(toward, 3), co.forces.LinearDamping(rate, toward)
    wanted = aim + expm(-tau * dense) @ (X - aim)
    # Exponentials of matrices of norm 8 at most, which the Pade approximant scales and squares.
    np.testing.assert_allclose(
        force.flow(BODY, X, 0.3, tau), wanted, rtol=0, atol=256 * U * max(1, np.abs(wanted).max())
    )
    np.testing.assert_allclose(force.field(BODY, X, 0.3), -dense @ (X - aim), rtol=0, atol=16 * U)


@pytest.mark.parametrize("tau", [0.75, -1.25])
def test_torques(tau):
    wind, t = np.array([0.5, -1.0, 2.0]), 0.7
    constant = co.forces.Torque(wind)
    np.testing.assert_array_equal(constant.field(BODY, X, t), wind)
    np.testing.assert_allclose(constant.flow(BODY, X, t, tau), X + tau * wind, rtol=0, atol=8 * U)
    # Five points of Gauss and Legendre integrate polynomials of degree nine exactly, and no others.
    for degree in range(11):
        power = co.forces.Torque(lambda t, degree=degree: wind * t**degree)
        exact = X + wind * ((t + tau) ** (degree + 1) - t ** (degree + 1)) / (degree + 1)
        error = np.abs(power.flow(BODY, X, t, tau) - exact).max()
        assert (error < 64 * U * 2.0**degree) == (degree <= 9), (degree, error)


@pytest.mark.parametrize("way", [1, -1])
def test_torques_of_the_state_are_a_step_of_the_fourth_order(way):
    of_state = co.forces.Torque(lambda x: np.array([x[1] * x[2], -x[0], np.sin(x[0]) - x[2]]))
    of_both = co.forces.Torque(lambda x, t: np.array([x[1] * np.cos(3 * t), t * x[2], -x[0] * x[2]]))
    for force in (of_state, of_both):
        errors = []
        for tau in (way / 8, way / 16, way / 32):
            exact = solve_ivp(
                lambda s, y, f=force: f.field(BODY, y, s), (0.7, 0.7 + tau), X, "DOP853", rtol=1e-13, atol=1e-15
            )
            errors.append(np.abs(force.flow(BODY, X, 0.7, tau) - exact.y[:, -1]).max())
        assert np.all(np.abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 5) < 0.5), errors


def test_the_field_of_a_flow_of_ones_own():
    """x' = -x |x| / (1 + t) about the time t, where the flow of the time t alone counts."""

    def flow(x, t, tau):
        return x / (1 + tau * np.abs(x) / (1 + t))

    force = co.forces.OwnForce(flow, name="drag")
    for t in (0.0, 0.7, 3.0):
        # Differences of order four, of steps 2^-12, whose rounding is u times 2^12.
        np.testing.assert_allclose(force.field(BODY, X, t), -X * np.abs(X) / (1 + t), rtol=0, atol=2.0**-38)
        np.testing.assert_array_equal(force.flow(BODY, X, t, -0.25), flow(X, t, -0.25))

    def only_forward(x, t, tau):
        if tau < 0.0:
            raise ValueError("a time before the present")
        return x / (1 + tau * np.abs(x) / (1 + t))

    forward = BODY.with_forces(co.forces.OwnForce(only_forward, name="drag", backward=False))
    np.testing.assert_allclose(forward.vector_field(X) - BODY.vector_field(X), -X * np.abs(X), rtol=0, atol=2.0**-36)
    assert co.integrate(forward, X, (0, 1), 0.125).plot().axes
    with refused(ValueError, "shift", "tau = 0"):
        BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x + 0.1, name="shift"))
    with refused(ValueError, "turn", "complex128", "real numbers"):
        BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: x * np.exp(1j * tau), name="turn"))

    def failing(*arguments):
        raise ValueError("no table")

    with refused(ValueError, "lost", "no table"):
        BODY.with_forces(co.forces.OwnForce(lambda x, t, tau: failing(), name="lost"))
    with refused(ValueError, "torque", "no table"):
        BODY.with_forces(co.forces.Torque(lambda x: failing()))


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("metric", [0.7, (0.5, 0.0, 2.0), RATE @ RATE.T], ids=["number", "diagonal", "matrix"])
def test_the_flow_of_a_double_bracket(metric, way):
    """A symmetric step of order two on the orbit, of an energy that depends on the time."""
    H = co.Hamiltonian(lambda x, t: 0.5 * (x[0] ** 2 + 2 * x[1] ** 2) + np.cos(t) * x[2])
    system, force = co.LiePoissonSystem(co.algebras.so(3), H), co.forces.DoubleBracketDamping(0.3, metric)
    errors = []
    for tau in (way / 8, way / 16, way / 32):
        found = force.flow(system, X, 0.7, tau)
        exact = solve_ivp(lambda s, y: force.field(system, y, s), (0.7, 0.7 + tau), X, "DOP853", rtol=1e-13, atol=1e-15)
        errors.append(np.abs(found - exact.y[:, -1]).max())
        assert found @ found == pytest.approx(X @ X, rel=64 * U)
        np.testing.assert_allclose(force.flow(system, found, 0.7 + tau, -tau), X, rtol=0, atol=2.0**-40)
    assert np.all(np.abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 3) < 0.3), errors


def test_forces_are_applied_in_their_order_and_labelled_by_it():
    some = co.forces
    first, second = some.LinearDamping(0.1), some.Torque((0.0, 0.5, 0.0))
    third, bath = some.LinearDamping(0.3), some.HeatBath(0.2, temperature=0.1, seed=5, stream=2)
    other = some.HeatBath(0.2, temperature=0.1, seed=5, stream=4)
    system = BODY.with_forces(first, second).with_forces(third, bath, other, first)
    assert system.forces == (first, second, third, bath, other, first)
    assert system.labels == ("LinearDamping", "Torque", "LinearDamping 2", "HeatBath", "HeatBath 2", "LinearDamping 3")
    assert system.name == f"rigid_body with {', '.join(system.labels)}"
    assert BODY.with_forces(first, second, third).reversible and not system.reversible
    with refused(ValueError, "seed", "stream"):
        system.with_forces(some.HeatBath(0.7, temperature=0.5, seed=5, stream=4))


@pytest.mark.parametrize("t", [0.0, 0.7, -2.0])
def test_power_energy_and_field_of_a_driven_system_are_those_at_the_time(t):
    H = co.Hamiltonian(lambda x, t: (1 + t**2) * (x[0] ** 2 + 3 * x[1] ** 2) / 2 + np.sin(t) * x[2])
    driven = co.LiePoissonSystem(co.algebras.so(3), H, name="driven")
    some = co.forces
    push = some.Torque(lambda x, t: np.array([t * x[1], np.cos(t), x[0]]))
    drag = some.OwnForce(lambda x, t, tau: x * np.exp(-(1 + t) * tau), name="drag")
    wind = some.Torque(lambda t: np.array([t, 1.0, t**2]))
    system = driven.with_forces(push, drag, wind)
    slope = np.array([(1 + t**2) * X[0], 3 * (1 + t**2) * X[1], np.sin(t)])
    fields = {
        "Torque": np.array([t * X[1], np.cos(t), X[0]]),
        "drag": -(1 + t) * X,
        "Torque 2": np.array([t, 1.0, t**2]),
    }
    # Differences of order four, of steps 2^-12, whose rounding is u times 2^12, times numbers of size 16.
    assert system.power(X, t) == pytest.approx({name: slope @ one for name, one in fields.items()}, abs=2.0**-34)
    assert system.energy(X, t) == pytest.approx((1 + t**2) * (X[0] ** 2 + 3 * X[1] ** 2) / 2 + np.sin(t) * X[2])
    whole = np.cross(slope, X) + sum(fields.values())
    np.testing.assert_allclose(system.vector_field(X, t), whole, rtol=0, atol=2.0**-34)


@pytest.mark.parametrize("t", [0.0, 0.7])
def test_a_damping_that_does_not_converge_names_the_time(t):
    with refused(co.IntegrationError, "DoubleBracketDamping") as failure:
        co.forces.DoubleBracketDamping(8.0).flow(BODY, X, t, 1.0)
    assert failure.value.time == t and failure.value.step == 1


def test_a_flow_over_an_endless_rotation_is_an_error_at_once():
    """In substeps of norm one it would take days."""
    body = co.systems.rigid_body()
    for force in (co.forces.DoubleBracketDamping(0.5), co.forces.HeatBath(0.5, temperature=1.0, seed=1)):
        with pytest.raises(OverflowError, match="more than 4096 substeps"):
            force.flow(body, np.array([1e12, 2e12, 0.5e12]), 0.0, 1.0)


def test_what_a_force_is_made_of_stays_as_it_is():
    rate, torque = np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0])
    damping, push = co.forces.LinearDamping(rate, torque), co.forces.Torque(torque)
    rate[:], torque[:] = 9.0, 9.0
    np.testing.assert_array_equal(damping.field(BODY, X, 0.0), [0.1, 0.2, 0.3] * ([1.0, 2.0, 3.0] - X))
    np.testing.assert_array_equal(push.field(BODY, X, 0.0), [1.0, 2.0, 3.0])
    complex_state = {"real": [[0.0, 1.0], [-1.0, 0.0]], "imaginary": [[2.0, 3.0], [3.0, -2.0]]}
    assert co.forces.Torque(complex_state).torque == ((2j, 1 + 3j), (-1 + 3j, -2j))


ORDERS = list(itertools.permutations(range(3)))


INDEFINITE = {
    "zeros on the diagonal": block([0, 1, 0], [1, 0, 0], [0, 0, 1]),
    "a zero on the diagonal": block([0, 1, 0], [1, 5, 0], [0, 0, 1]),
    "a negative number": block([1, 0, 0], [0, -1, 0], [0, 0, 1]),
    "a small negative number": block([1, 0, 0], [0, 1, 0], [0, 0, -1e-10]),
    "a negative eigenvalue": block([1, 2, 0], [2, 1, 0], [0, 0, 1]),
    "a negative eigenvalue of all": block([1, 0.75, 0.75], [0.75, 1, -0.75], [0.75, -0.75, 1]),
    "a pivot that vanishes with entries below": block([1, 1, 0], [1, 1, 0.5], [0, 0.5, 1]),
}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", SEMIDEFINITE)
def test_damping_by_the_dense_formula(name, sign):
    """x' = alpha J P J grad H; its power is minus alpha f . P f, of the field f without it."""
    P, x, alpha = SEMIDEFINITE[name], np.array([0.7, -0.4, 1.1]), 0.3
    system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 2.0, 3.5], linear=[0.1, 0.0, -0.2]), sign=sign)
    J, slope = system.structure_matrix(x), np.array([1.0, 2.0, 3.5]) * x + [0.1, 0.0, -0.2]
    damped = system.with_forces(co.forces.DoubleBracketDamping(alpha, P))
    found = damped.vector_field(x) - system.vector_field(x)
    np.testing.assert_allclose(found, alpha * J @ P @ J @ slope, rtol=0, atol=2.0**-48)
    f = J @ slope
    assert damped.power(x)["DoubleBracketDamping"] == pytest.approx(-alpha * f @ P @ f, rel=1e-13, abs=1e-15)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("scale", [1.0, 2.0**-200, 2.0**200])
def test_metrics_are_positive_semidefinite(order, scale):
    for P in SEMIDEFINITE.values():
        co.forces.DoubleBracketDamping(0.1, scale * P[np.ix_(order, order)])
    for P in INDEFINITE.values():
        P = scale * P[np.ix_(order, order)]
        assert np.linalg.eigvalsh(P)[0] < -1e-11 * np.abs(P).max()
        with refused(ValueError, "metric", "semidefinite"):
            co.forces.DoubleBracketDamping(0.1, P)
    with refused(ValueError, "metric", "-0.5"):
        co.forces.DoubleBracketDamping(0.1, np.array([1.0, -0.5, 2.0])[list(order)])
    with refused(ValueError, "metric", "-2"):
        co.forces.DoubleBracketDamping(0.1, -2.0)
    P = SEMIDEFINITE["definite"][np.ix_(order, order)].copy()
    P[order[0], order[1]] += 1e-9
    with refused(ValueError, "metric", "symmetric"):
        co.forces.DoubleBracketDamping(0.1, P)
