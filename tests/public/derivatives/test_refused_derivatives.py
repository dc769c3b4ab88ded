"""Wrong directions and cotangents, runs without derivatives, and derivatives that overflow."""

import pickle

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

pytestmark = pytest.mark.thinned(1)

H, SPAN = 0.125, (0.0, 1.0)
BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.3, 1.0, 0.2])
MANY = np.tile(X, (4, 1))
READY = co.prepare(BODY, co.Splitting(), H, observe={"first": lambda x: x[0]})
TURNING = co.prepare(BODY, co.Splitting(), H, attitude=True)
STEERED = co.prepare(BODY, co.Splitting(), H, inputs={"rates": (0, 2)})
BATCH = co.prepare(co.batch([BODY] * 4), co.Splitting(), H, attitude=True)
SPHERE = co.systems.sphere_euler(4, rotation=0.3)
W = SPHERE.random(1)


@pytest.mark.parametrize(
    ("ready", "x0", "directions", "error", "named"),
    [
        (READY, X, {"inertai": X}, ValueError, ("inertai", "inertia")),
        (READY, X, {"attitude0": np.eye(3)}, ValueError, ("attitude0",)),
        (READY, X, {"M": X}, ValueError, ("'M'",)),
        (READY, X, {"x0": np.ones((2, 3))}, ValueError, ("x0", "(2, 3)")),
        (READY, MANY, {"x0": X}, ValueError, ("x0", "(3,)", "(4, 3)")),
        (READY, X, {"inertia": 1.0}, ValueError, ("inertia", "()")),
        (TURNING, X, {"attitude0": np.eye(2)}, ValueError, ("attitude0", "(2, 2)", "(3, 3)")),
        (TURNING, MANY, {"attitude0": np.eye(3)}, ValueError, ("attitude0", "(3, 3)", "(4, 3, 3)")),
        (BATCH, MANY, {"inertia": np.ones(3)}, ValueError, ("inertia", "(3,)", "(4, 3)")),
        (READY, X, {"x0": [1.0, np.nan, 0.0]}, ValueError, ("x0", "NaN")),
        (READY, X, {"inertia": [np.inf, 0.0, 0.0]}, ValueError, ("inertia", "infinity")),
        (READY, X, {"x0": "up"}, TypeError, ("x0", "up")),
        (READY, X, {}, ValueError, ("x0", "inertia")),
        (TURNING, X, {}, ValueError, ("x0", "attitude0", "inertia")),
        (READY, X, [X], TypeError, ("directions", "mapping")),
        (READY, X, None, TypeError, ("directions", "None")),
        (READY, X, {"x0": np.ones((3, 2)), "inertia": np.ones((3, 4))}, ValueError, ("directions", "number")),
        (READY, X, {"x0": np.ones((3, 0))}, ValueError, ("directions", "empty")),
        (STEERED, X, {"inputs": [1.0, 2.0]}, TypeError, ("inputs", "[1.0, 2.0]")),
        (STEERED, X, {"inputs": {"rate": [1.0, 2.0]}}, ValueError, ("'rate'", "'rates'")),
        (STEERED, X, {"inputs": {"rates": [1.0]}}, ValueError, ("inputs.rates", "(1,)", "(2,)")),
        (STEERED, X, {"rates": [1.0, 2.0]}, ValueError, ("'rates'",)),
        (STEERED, X, {"inputs": {}}, ValueError, ("x0", "inertia", "inputs")),
        (STEERED, X, {"inputs": {"rates": np.ones((2, 3))}, "x0": X}, ValueError, ("directions", "number")),
        (co.prepare(SPHERE, None, H), W, {"x0": np.eye(4)}, ValueError, ("x0", "su(4)", "skew-Hermitian")),
        (co.prepare(SPHERE, None, H), W, {"x0": np.ones(32)}, ValueError, ("x0", "(32,)", "(4, 4)")),
    ],
)
def test_wrong_directions_are_refused(ready, x0, directions, error, named):
    given = {"rates": [0.1, 0.2]} if ready is STEERED else {}
    with refused(error, *named) as caught:
        ready.jvp(x0, SPAN, directions, **given)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("ready", "x0", "cotangents", "error", "named"),
    [
        (READY, X, {"x": X}, ValueError, ("x ", "(3,)", "(9, 3)")),
        (READY, X, {"x": np.full((9, 3), np.nan)}, ValueError, ("x ", "NaN")),
        (READY, X, {"x": "up"}, TypeError, ("x ", "up")),
        (READY, X, {"energy": np.ones(8)}, ValueError, ("energy", "(8,)")),
        (READY, X, {"energy": np.full(9, np.inf)}, ValueError, ("energy", "infinity")),
        (READY, X, {"attitude": np.ones((9, 3, 3))}, ValueError, ("attitude=True",)),
        (TURNING, X, {"attitude": np.eye(3)}, ValueError, ("attitude", "(3, 3)")),
        (READY, X, {"observed": {"first": np.ones(8)}}, ValueError, ("first", "(8,)")),
        (READY, X, {"observed": {"frist": np.ones(9)}}, ValueError, ("frist", "first")),
        (TURNING, X, {"observed": {"first": np.ones(9)}}, ValueError, ("observed", "first")),
        (READY, X, {"events": {"t": []}}, ValueError, ("events", "vjp")),
        (co.prepare(SPHERE, None, H), W, {"x": W}, ValueError, ("x ", "(4, 4)")),
    ],
)
def test_wrong_cotangents_are_refused(ready, x0, cotangents, error, named):
    _, pullback = ready.vjp(x0, SPAN)
    with refused(error, *named) as caught:
        pullback(**cotangents)
    assert "\n" not in str(caught.value)


def test_wrong_cotangents_of_events_and_of_real_matrices_are_refused():
    for x0, wrong in ((X, 7), (MANY[:2], 9)):
        _, pullback = READY.vjp(x0, (0.0, 20.0), events=co.Event("x2", terminal=True))
        with refused(ValueError, "t of events", f"({wrong},)"):
            pullback(events={"t": np.ones(wrong)})
        with refused(ValueError, "events", "'time'"):
            pullback(events={"time": [1.0]})
    body = co.systems.matrix_body((1.0, 2.0, 3.0))
    _, pullback = co.prepare(body, co.IsospectralGauss(1), H).vjp(np.zeros((3, 3)), (0.0, H))
    with refused(TypeError, "real"):
        pullback(1j * np.ones((2, 3, 3)))


@pytest.mark.parametrize(
    ("ready", "arguments", "error", "named"),
    [
        (READY, {"x0": X[:2]}, ValueError, ("x0", "(2,)")),
        (READY, {"t_span": (0.0, 0.3)}, ValueError, ("step", "0.125", "0.3")),
        (READY, {"save_every": 2, "t_eval": [0.5]}, ValueError, ("save_every", "t_eval")),
        (READY, {"t_eval": [2.0]}, ValueError, ("t_eval[0]", "2")),
        (READY, {"attitude": np.eye(3)}, ValueError, ("attitude", "prepare")),
        (STEERED, {"rates": [0.1]}, ValueError, ("rates", "(1,)")),
        (STEERED, {"rotor": [0.1]}, ValueError, ("rotor",)),
        (READY, {"rates": [0.1, 0.2]}, TypeError, ("inputs",)),
    ],
)
def test_wrong_runs_are_refused(ready, arguments, error, named):
    given = {"x0": X, "t_span": SPAN} | arguments
    for call in (ready.vjp, lambda **given: ready.jvp(directions={"x0": X}, **given)):
        with refused(error, *named):
            call(**given)


DAMPED = BODY.with_forces(co.forces.LinearDamping(0.1))
WAVES = co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (np.cos, lambda y: -np.sin(y))}))
OWN = co.ReversibleSteps(co.Splitting(), 0.1)


@pytest.mark.parametrize(
    ("ready", "named"),
    [
        (co.prepare(DAMPED, co.Taylor(8, tolerance=1e-9), H), ("Taylor", "steps", "forces")),
        (co.prepare(DAMPED, OWN, H), ("ReversibleSteps", "steps", "forces")),
        (co.prepare(WAVES, co.Splitting(), H), ("hessian=",)),
        (co.prepare(WAVES.with_forces(co.forces.LinearDamping(0.1)), co.Splitting(), H), ("hessian=",)),
        (co.prepare(BODY, accuracy=1e-6, x0=X, t_span=(0.0, 10.0)), ("accuracy", "step=")),
    ],
)
def test_runs_without_derivatives_are_refused(ready, named):
    for call in (lambda: ready.vjp(X, SPAN), lambda: ready.jvp(X, SPAN, {"x0": X})):
        with refused(TypeError, *named) as caught:
            call()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("system", "method", "error", "reverse", "named"),
    [
        (BODY, co.GaussLegendre(2), TypeError, "reversible", ("GaussLegendre", "reverse")),
        (BODY, OWN, TypeError, "reversible", ("ReversibleSteps", "undone")),
        (DAMPED, co.Splitting(), TypeError, "reversible", ("undone",)),
        (BODY, co.Splitting(), ValueError, "backward", ("reverse", "backward")),
    ],
)
def test_steps_that_cannot_be_undone_are_refused(system, method, error, reverse, named):
    with refused(error, *named):
        co.prepare(system, method, H).vjp(X, SPAN, reverse=reverse)


def test_derivatives_of_steps_by_inputs_need_inputs():
    with refused(TypeError, "inputs"):
        co.stepper(BODY, co.Splitting(), 0.1).tangent_by_inputs(X)


# x2' = x2 on the plane: from 1e-300 the motion stays finite, and its derivative grows beyond all numbers.
LINE = co.LiePoissonSystem(co.LieAlgebra([(0, 1, 1, 1.0)], dim=2), co.Quadratic([0, 0], linear=[1.0, 0.0]))
LONG = (0.0, -720.0)


@pytest.mark.parametrize("system", [LINE, co.batch([LINE] * 3)], ids=["ensemble", "batch"])
def test_members_whose_derivatives_overflow_do_not_affect_others(system):
    """The errors contain the derivatives of all members, of which the others have the bits of single runs."""
    together, ready = (co.prepare(one, co.Splitting(order=1), 1.0) for one in (system, LINE))
    x0 = np.array([[1e-300, 1e-300], [1e-300, 0.0], [1e-300, 1e-300]])
    directions = np.array([[1.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    plain = ready.run(x0, LONG, 10)
    assert np.isfinite(plain.x).all() and plain.x.max() > 1.0
    with refused(co.IntegrationError, "x", "-710", "shorter span") as raised:
        together.jvp(x0, LONG, {"x0": directions}, 10)
    found = raised.value.derivatives
    assert (raised.value.step, raised.value.time) == (710, -710.0) and np.array_equal(raised.value.partial.x, plain.x)
    sol, alone = ready.jvp(x0[1], LONG, {"x0": directions[1]}, 10)
    assert np.array_equal(found.x[:, 1], alone.x) and np.isfinite(alone.x).all()
    assert not np.isfinite(found.x[:, 0]).all() and not np.isfinite(found.x[:, 2]).all()
    # The second member has no cotangent along the growing coordinate.
    _, pullback = together.vjp(x0, LONG, 10)
    cotangents = np.ones((len(sol.t), 3, 2))
    cotangents[:, 1] = [1.0, 0.0]
    with refused(co.IntegrationError, "x0", "overflows", "shorter span") as raised:
        pullback(cotangents)
    expected = ready.vjp(x0[1], LONG, 10)[1](cotangents[:, 1])["x0"]
    for error in (raised.value, pickle.loads(pickle.dumps(raised.value))):
        assert np.isfinite(expected).all() and np.array_equal(error.derivatives["x0"][1], expected)
        assert not np.isfinite(error.derivatives["x0"][[0, 2]]).all()
    # Those of earlier points do not overflow.
    gradient = pullback(cotangents * (sol.t >= -700)[:, None, None])["x0"]
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 1e300
