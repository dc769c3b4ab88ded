"""Splittings and compositions of higher order keep their order with forces, and refuse forces that act forward only."""

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from drawn_matrices import full
from matrix.forces import first_fitting
from refusals import refused

SPAN = (0.5, 2.5)
TOP = np.array([1.0, 0.5, 0.3, 0.2, 0.3, 0.9])
SPINS = np.array([0.6, 0.0, 0.8, 0.0, -0.6, 0.8, 0.8, 0.6, 0.0])
DAMPING = co.forces.LinearDamping(np.array([0.1, 0.2, 0.15, 0.0, 0.0, 0.0]))
GAUSS = co.GaussLegendre(1)


def of_time(t):
    """Return a torque of time."""
    return np.array([np.sin(t), 0.0, np.cos(2.0 * t), 0.0, 0.0, 0.0])


def of_state(x):
    """Return a torque of the state."""
    return np.array([0.2 * x[4] - 0.1 * x[0], -0.2 * x[1] * x[2], 0.1 * np.sin(x[3]), 0.0, 0.0, 0.0])


def of_both(x, t):
    """Return a torque of state and time, for every system."""
    y = 0.2 * np.cos(x + t)
    y[0] -= 0.3 * x[1] * x[2]
    return y


def of_momenta(x, t):
    """Return a torque of state and time, on a top."""
    y = 0.2 * np.cos(x + t)
    y[0] -= 0.3 * x[1] * x[2]
    y[3:] = 0.0
    return y


def of_attitude(x, A, t):
    """Return a torque of state, attitude and time."""
    return np.array([0.4 * A[2, 1] - 0.2 * x[0], np.sin(t) * A[0, 2], -0.3 * x[2] * A[1, 0]])


def of_matrix(W, t):
    """Return a torque on a skew matrix."""
    return 0.3 * np.cos(t) * W + 0.2 * W @ W @ W


def on(algebra, seed):
    """Return a system with a full quadratic energy and a linear one, and a state."""
    n = algebra.dim
    energy = co.Quadratic(full(n, seed), linear=np.linspace(-0.3, 0.4, n))
    return co.LiePoissonSystem(algebra, energy), np.linspace(0.7, -0.5, n)


def body_in_space():
    """Return a body with an attitude in its state, and a state."""
    body = co.systems.body((1.0, 2.0, 2.5)).with_forces(co.forces.Torque(of_attitude))
    return body, body.state((0.6, 0.0, 0.0, 0.8), angular_velocity=(0.6, -0.4, 0.5))


def top(*forces):
    """Return a heavy top with forces, and a state."""
    return co.systems.heavy_top().with_forces(*forces), TOP


def forced(system, *forces):
    """Return a system with forces, and the state."""
    return system[0].with_forces(*forces), system[1]


def splittings(*orders):
    """Return splittings of these orders."""
    return [co.Splitting(order=order) for order in orders]


CHAIN = co.systems.spin_lattice("chain", 3), SPINS
CASES = {
    "damped and pushed": (*top(DAMPING, co.forces.Torque((0.3, 0, -0.2, 0, 0, 0))), splittings(4, 6, 8, 10)),
    "driven": (*top(co.forces.LinearDamping(0.1), co.forces.Torque(of_time)), splittings(4, 6, 8, 10)),
    "torque of the state": (*top(co.forces.Torque(of_state), DAMPING), splittings(4, 6, 8, 10)),
    "so(4)": (*forced(on(co.algebras.so(4), 1), co.forces.Torque(of_both)), splittings(4, 6, 8)),
    "A3,7": (*forced(on(co.algebras.A3_7(0.7), 2), co.forces.Torque(of_both), co.forces.LinearDamping(0.3)),
        splittings(4, 6)),
    "su(3)": (*forced(on(co.algebras.su(3), 3), co.forces.Torque(of_both)), splittings(4, 6)),
    "spins": (*forced(CHAIN, co.forces.DoubleBracketDamping(0.1)), splittings(4, 6, 8)),
    "midpoints": (*forced(CHAIN, co.forces.DoubleBracketDamping(0.1)), [
        co.methods.even_order(co.SphericalMidpoint(), 4, "suzuki")]),
    "body in space": (*body_in_space(), splittings(4, 6, 8)),
    "other splittings": (*top(co.forces.Torque(of_state), co.forces.Torque(of_time)), [
        co.Splitting(scheme="yoshida4"), co.Splitting(order=6, parts="free_body"),
        co.Splitting(order=6, compensated=True)]),
    "stages": (*forced(on(co.algebras.so(4), 4), co.forces.Torque(of_both), co.forces.LinearDamping(0.1)), [
        co.methods.even_order(GAUSS, 4, "suzuki"), co.methods.even_order(GAUSS, 6, "suzuki")]),
}  # fmt: skip
EACH = [(name, method) for name, (*_, methods) in CASES.items() for method in methods]


def reference(system, x0, span):
    """Return the end of the motion to some 1e-13."""
    found = solve_ivp(lambda t, x: system.vector_field(x, t), span, x0, method="DOP853", rtol=1e-13, atol=1e-15)
    return found.y[:, -1]


def ends(system, x0, span, method, steps):
    """Return the last states of runs of these steps."""
    return [co.integrate(system, x0, span, h, method).x[-1] for h in steps]


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("name", "method"), EACH, ids=[f"{name}, {method}" for name, method in EACH])
@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.filterwarnings("ignore::coadjoint.LargeStepWarning")
def test_orders_against_another_solver(name, method, backward):
    """The error falls by 2^order when the step is halved, less half an order for higher terms."""
    system, x0, _ = CASES[name]
    span = SPAN[::-1] if backward else SPAN
    assert co.prepare(system, method, step=0.125).scheme.order == method.order
    steps = (0.25, 0.125, 0.0625) if method.order < 8 else (0.5, 0.25, 0.125)
    errors = np.abs(np.array(ends(system, x0, span, method, steps)) - reference(system, x0, span)).max(axis=1)
    # The reference has an error of some 1e-13; above it there must be a pair of steps.
    above = errors[1:] > 2e-12
    assert errors[-1] < 1e-3 and (errors[1] < 2e-12 or above.any())
    assert np.all(np.log2(errors[:-1] / errors[1:])[above][-1:] > method.order - 0.5)


OPTIONS = [{"parts": "coordinates"}, {"parts": "free_body"}, {"parts": "coordinates", "rotation": "rational"},
    {"parts": [[2], [0], [1]]}, {"compensated": True}]  # fmt: skip


@pytest.mark.parametrize("h", [0.25, -0.25])
@pytest.mark.parametrize("which", [{"order": 4}, {"scheme": "yoshida4"}], ids=str)
@pytest.mark.parametrize("option", OPTIONS, ids=str)
def test_steps_between_forces_have_the_options_of_the_splitting(option, which, h):
    system = co.systems.rigid_body(inertia=(1, 2, 2.5)).with_forces(co.forces.Torque(of_both))
    x, t, method = np.array([0.6, -0.4, 0.5]), 0.5, co.Splitting(**which, **option)
    outer = 1.0 / (4.0 - 4.0 ** (1 / 3)) if "order" in which else 1.0 / (2.0 - 2.0 ** (1 / 3))
    sides = [outer] * (2 if "order" in which else 1)
    wanted, time = x, t
    for fraction in (*sides, 1.0 - 2.0 * sum(sides), *sides):
        step = co.stepper(system, co.Splitting(order=2, **option), fraction * h)
        wanted, time = step(wanted, time), time + fraction * h
    np.testing.assert_allclose(co.stepper(system, method, h)(x, t), wanted, rtol=0, atol=1e-14)
    assert co.prepare(system, method, step=0.25).scheme.inner == co.Splitting(order=2, **option)


@pytest.mark.parametrize("order", [4, 6])
def test_torques_on_matrices_keep_the_order(order):
    body = co.systems.matrix_body((1.0, 2.0, 3.0)).with_forces(co.forces.Torque(of_matrix))
    W, method = np.array([[0.0, 0.7, -0.5], [-0.7, 0.0, 0.6], [0.5, -0.6, 0.0]]), co.IsospectralGauss(1)
    wanted = solve_ivp(
        lambda t, x: np.ravel(body.vector_field(x.reshape(3, 3), t)),
        SPAN, W.ravel(), method="DOP853", rtol=1e-13, atol=1e-15,
    ).y[:, -1].reshape(3, 3)  # fmt: skip
    found = ends(body, W, SPAN, co.methods.even_order(method, order, "suzuki"), (0.5, 0.25))
    errors = [np.abs(end - wanted).max() for end in found]
    assert errors[0] < 1e-3 and np.log2(errors[0] / errors[1]) > order - 0.5


@pytest.mark.thinned(4)
@pytest.mark.parametrize("name", co.forces.names())
def test_every_force_acts_backward_or_is_refused_by_name(name):
    system = first_fitting(name)
    (force,), base = system.forces, co.IsospectralGauss(1) if system.has_matrices else co.Splitting()
    method = co.methods.even_order(base, 4)
    assert co.prepare(system, base, step=0.125).scheme.order == co.prepare(system, step=0.125).scheme.order == 2
    if force.reversible or force.around_steps:  # whole steps, which are forward
        assert co.prepare(system, method, step=0.125).scheme.order == 4
        if force.reversible:
            return
        with refused(ValueError, force.label, "backward"):
            co.integrate(system, np.zeros(system.shape), (1.0, 0.0), 0.125, base)
        return
    for call in (
        lambda: co.prepare(system, method, step=0.125),
        lambda: co.stepper(system, method, 0.125),
        lambda: co.methods.Forced(method).properties(system),
        lambda: co.prepare(system if system.has_matrices else co.batch([system, system]), method, step=0.125),
    ):
        with refused(ValueError, force.label, "backward", "take", base):
            call()


SPINNING, TURNING = co.systems.torus_euler(N=5), co.systems.sphere_euler(N=5)
# Systems of matrices, with a damping by which a part of the state changes.
MATRICES = [(SPINNING, 0.1), (TURNING, 0.5), (co.systems.matrix_body((1.0, 2.0, 3.0, 4.0)), 30.0)]
RATES, SO4 = full(6, 7), on(co.algebras.so(4), 5)
# The forces whose flows are written twice, in NumPy and for the kernels, each so strong that a step is a large change.
STRONG = {
    "LinearDamping": [(SO4, co.forces.LinearDamping(rate)) for rate in (1.5, np.linspace(-1.0, 4.0, 6), 4.0 * RATES)],
    "DoubleBracketDamping": [
        (SO4, co.forces.DoubleBracketDamping(3.0)),
        (SO4, co.forces.DoubleBracketDamping(3.0, RATES @ RATES)),
        (CHAIN, co.forces.DoubleBracketDamping(1.5)),
        *((flow, co.forces.DoubleBracketDamping(alpha)) for flow, alpha in MATRICES),
    ],
    "HeatBath": [
        (SO4, co.forces.HeatBath(0.5, temperature=2.0, seed=3)),
        (SO4, co.forces.HeatBath(0.5, np.linspace(0.25, 1.5, 6), temperature=2.0, seed=3)),
        (SO4, co.forces.HeatBath(0.5, RATES @ RATES, temperature=2.0, seed=3)),
        (CHAIN, co.forces.HeatBath(1.5, temperature=2.0, seed=3)),
        *((flow, co.forces.HeatBath(0.1, temperature=2.0, seed=3)) for flow, _ in MATRICES),
    ],
    "Gilbert": [
        (CHAIN, co.forces.Gilbert(1.5)),
        (CHAIN, co.forces.Gilbert(np.linspace(0.0, 2.0, CHAIN[0].dim // 3), temperature=2.0, seed=3)),
    ],
    "Langevin": [((co.systems.rigid_body((1.0, 2.0, 2.5)), SPINS[:3]), co.forces.Langevin(4.0, 2.0, seed=3))],
    "Torque": [(SO4, co.forces.Torque(np.arange(6.0)))],
    "Friction": [(flow, co.forces.Friction(2.0)) for flow in (SPINNING, TURNING)],
    "Viscosity": [(flow, co.forces.Viscosity(0.5)) for flow in (SPINNING, TURNING)],
    "BetaPlane": [(SPINNING, co.forces.BetaPlane(3.0))],
    "RandomForcing": [(flow, co.forces.RandomForcing(5.0, (1, 2), seed=3)) for flow in (SPINNING, TURNING)],
    "TransportNoise": [
        (flow, co.forces.TransportNoise((1, 2), 1.5, (1.0, 0.5), seed=3)) for flow in (SPINNING, TURNING)
    ],
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", STRONG)
def test_kernels_have_the_flows_of_strong_forces_in_numpy(name):
    """In a step of half a unit of time, from a late time: changes of the size of the state, and rounding of each."""
    for system, force in STRONG[name]:
        system, x = system if isinstance(system, tuple) else (system, None)
        method = co.Splitting() if x is not None else co.IsospectralGauss(1)
        if x is None:
            rng = np.random.default_rng(1)
            x = system.algebra.projected(rng.normal(size=system.shape) + 1j * rng.normal(size=system.shape))
        forced = system.with_forces(force)
        plain = co.methods.Forced(method).step(forced, x, -3.25, 0.5)
        free = method.step(system, x, -3.25, 0.5)
        assert np.abs(plain - free).max() > 0.1, force
        found = co.stepper(forced, method, 0.5)(x, -3.25)
        np.testing.assert_allclose(found, plain, rtol=0, atol=256 * 2.0**-53 * np.abs(plain).max(), err_msg=repr(force))


@pytest.mark.parametrize("first", [True, False])
def test_forces_that_act_forward_only_are_refused_beside_others(first):
    bath, pair = co.forces.HeatBath(0.1, temperature=0.5, seed=3), [DAMPING]
    pair.insert(0 if first else 1, bath)
    system, _ = top(*pair)
    with refused(ValueError, "HeatBath", "backward", "take", co.Splitting()):
        co.prepare(system, co.Splitting(order=4), step=0.125)


@pytest.mark.parametrize(
    ("method", "named"),
    [
        (co.Splitting(scheme="blanes_moan4"), ("blanes_moan4", "Splitting(order=4)")),
        (co.Splitting(scheme="blanes_casas_murua6"), ("blanes_casas_murua6", "Splitting(order=6)")),
        (co.methods.even_order(co.GaussLegendre(2), 6), ("GaussLegendre(stages=2)", "order two", "even_order")),
    ],
    ids=str,
)
def test_orders_that_hold_without_forces_only_are_refused(method, named):
    system, x0 = top(DAMPING)
    for call in (
        lambda: co.integrate(system, x0, SPAN, 0.125, method),
        lambda: co.stepper(system, method, 0.125),
        lambda: co.methods.Forced(method),
    ):
        with refused(ValueError, *named):
            call()


def test_a_scheme_that_is_not_composed_has_order_two():
    system, x0 = top(DAMPING, co.forces.Torque(of_state))
    for method in (co.GaussLegendre(3), co.Taylor(8), co.Composition(co.Splitting(), (0.25, 0.5, 0.25))):
        assert co.prepare(system, method, step=0.125).scheme.order == 2
        errors = np.array(ends(system, x0, SPAN, method, (0.125, 0.0625))) - reference(system, x0, SPAN)
        assert abs(np.log2(np.abs(errors).max(axis=1)[0] / np.abs(errors).max(axis=1)[1]) - 2.0) < 0.5


@pytest.mark.parametrize("order", [6, 8, 10])
@pytest.mark.thinned(3)
def test_gradients_of_long_steps_are_those_of_the_flows_of_the_order(order):
    """In steps so long that flows of the fourth order would lead to other states, and so to other derivatives."""
    system, x0 = top(co.forces.Torque(of_momenta), DAMPING)
    ready, span = co.prepare(system, co.Splitting(order=order), step=1.0), (0.5, 2.5)
    _, tangents = ready.jvp(x0, span, {"x0": np.eye(len(x0))})
    derivative = np.asarray(tangents.x)[-1]
    _, pullback = ready.vjp(x0, span)
    weights = np.zeros((3, len(x0)))
    weights[-1] = np.cos(np.arange(len(x0)))
    plain = co.methods.Forced(co.Splitting(order=order)).step(system, x0, span[0], 1.0)
    np.testing.assert_allclose(ready.end(x0, (span[0], 1.5)), plain, rtol=0, atol=1e-11)
    # Flows are differentiated by complex steps, and both products have less than 1e5 roundings.
    np.testing.assert_allclose(pullback(weights)["x0"], weights[-1] @ derivative, rtol=0, atol=1e-11)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("order", [5, 6, 7, 8, 10, 12])
def test_flows_of_torques_have_the_order_of_their_scheme(order):
    """x' = x^2 from x is x / (1 - x t) at t, in fifty digits; the error of a flow is of one order more."""
    body, torque = co.systems.rigid_body(), co.forces.Torque(lambda x: x * x)
    with mpmath.workdps(50):
        x = np.array([mpmath.mpf(one) for one in ("0.75", "-0.5", "0.625")])
        errors = []
        for tau in (mpmath.mpf(1) / 2, mpmath.mpf(1) / 4):
            found = torque.flow_of_order(body, x, mpmath.mpf(0), tau, order)
            errors.append(max(abs(found - x / (1 - tau * x))))
        assert mpmath.log(errors[0] / errors[1], 2) > order + 0.9
