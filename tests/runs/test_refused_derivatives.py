"""Wrong directions and cotangents, runs without derivatives, and derivatives that overflow."""

import pickle
import re

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs import prepared_run
from coadjoint.runs.derivatives import differentiable_run, forced_steps

BODY = co.systems.rigid_body((1, 2, 3))
X = np.array([0.3, 1.0, 0.2])
READY = co.prepare(BODY, co.Splitting(), 0.125, observe={"first": lambda x: x[0]})
TURNING = co.prepare(BODY, co.Splitting(), 0.125, attitude=True)
SPAN = (0.0, 1.0)
MANY = np.tile(X, (4, 1))


@pytest.mark.parametrize(
    ("ready", "x0", "directions", "error", "words"),
    [
        (READY, X, {"inertai": X}, ValueError, "unknown direction of this run 'inertai'; did you mean 'inertia'"),
        (READY, X, {"attitude0": np.eye(3)}, ValueError, "unknown direction of this run 'attitude0'"),
        (READY, X, {"M": X}, ValueError, "unknown direction of this run 'M'"),
        (READY, X, {"x0": X[:2]}, ValueError, r"the direction x0 has the shape (2,); it must be (3,), or with"),
        (READY, X, {"x0": np.ones((2, 3))}, ValueError, "the direction x0 has the shape (2, 3)"),
        (READY, MANY, {"x0": X}, ValueError, "the direction x0 has the shape (3,); it must be (4, 3)"),
        (READY, X, {"inertia": 1.0}, ValueError, "the direction inertia has the shape ()"),
        (TURNING, X, {"attitude0": np.eye(2)}, ValueError, "attitude0 has the shape (2, 2); it must be (3, 3)"),
        (TURNING, MANY, {"attitude0": np.eye(3)}, ValueError, "attitude0 has the shape (3, 3); it must be (4, 3, 3)"),
        (READY, X, {"x0": [1.0, np.nan, 0.0]}, ValueError, "the direction x0 contains NaN or infinity"),
        (READY, X, {"inertia": [np.inf, 0.0, 0.0]}, ValueError, "the direction inertia contains NaN or infinity"),
        (READY, X, {"x0": "up"}, TypeError, "the direction x0 is 'up'"),
        (READY, X, {}, ValueError, "no direction was given; the names are x0, inertia"),
        (TURNING, X, {}, ValueError, "no direction was given; the names are x0, attitude0, inertia"),
        (READY, X, [X], TypeError, "give a mapping from names to arrays"),
        (READY, X, None, TypeError, "directions is None; give a mapping"),
        (READY, X, {"x0": np.ones((3, 2)), "inertia": np.ones((3, 4))}, ValueError, "differ in number"),
        (READY, X, {"x0": np.ones((3, 1)), "inertia": np.ones(3)}, ValueError, "differ in number"),
        (READY, X, {"x0": np.ones((3, 0))}, ValueError, "the last axis of the directions is empty"),
    ],
)
def test_wrong_directions_are_refused(ready, x0, directions, error, words):
    with pytest.raises(error, match=re.escape(words)) as raised:
        ready.jvp(x0, SPAN, directions)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("ready", "x0", "cotangents", "error", "words"),
    [
        (READY, X, {"x": X}, ValueError, "x has the shape (3,); as in the solution it must be (9, 3)"),
        (READY, MANY, {"x": np.ones((9, 3))}, ValueError, "as in the solution it must be (9, 4, 3)"),
        (READY, X, {"x": np.full((9, 3), np.nan)}, ValueError, "x contains NaN or infinity"),
        (READY, X, {"x": "up"}, TypeError, "x is 'up'"),
        (READY, X, {"energy": np.ones(8)}, ValueError, "energy has the shape (8,)"),
        (READY, X, {"energy": np.full(9, np.inf)}, ValueError, "energy contains NaN or infinity"),
        (READY, X, {"attitude": np.ones((9, 3, 3))}, ValueError, "prepare it with attitude=True"),
        (TURNING, X, {"attitude": np.eye(3)}, ValueError, "attitude has the shape (3, 3)"),
        (READY, X, {"observed": {"first": np.ones(8)}}, ValueError, "observed first has the shape (8,)"),
        (READY, X, {"observed": {"frist": np.ones(9)}}, ValueError, "did you mean 'first'"),
        (TURNING, X, {"observed": {"first": np.ones(9)}}, ValueError, "unknown observed quantity of this run 'first'"),
    ],
)
def test_wrong_cotangents_are_refused(ready, x0, cotangents, error, words):
    _, pullback = ready.vjp(x0, SPAN)
    with pytest.raises(error, match=re.escape(words)) as raised:
        pullback(**cotangents)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ({"x0": X[:2]}, ValueError, "x0 has the shape (2,)"),
        ({"t_span": (0.0, 0.3)}, ValueError, "step 0.125 does not divide the time 0.3"),
        ({"save_every": 0}, ValueError, "save_every"),
        ({"save_every": 2, "t_eval": [0.5]}, ValueError, "save_every and t_eval"),
        ({"t_eval": [2.0]}, ValueError, "t_eval[0] is 2; it must lie within t_span"),
        ({"attitude": np.eye(3)}, ValueError, "must be given to `prepare`"),
    ],
)
def test_wrong_runs_are_refused(arguments, error, words):
    given = {"x0": X, "t_span": SPAN} | arguments
    with pytest.raises(error, match=re.escape(words)):
        READY.vjp(**given)
    with pytest.raises(error, match=re.escape(words)):
        READY.jvp(**given, directions={"x0": X})


@pytest.mark.parametrize("system", [BODY, BODY.with_forces(co.forces.LinearDamping(0.1))], ids=["alone", "forced"])
def test_equations_of_derivatives_that_are_not_solved_raise_integration_errors(system, monkeypatch):
    """At the time of the stretch, or of the step with forces."""
    for module in (differentiable_run, forced_steps):
        monkeypatch.setattr(module, "advance_tables", lambda *_: False)
    ready = co.prepare(system, co.GaussLegendre(2), 0.125)
    _, pullback = ready.vjp(X, (1.0, 1.25))
    # Backward the last step is the first one whose equations are solved.
    for call, time in ((lambda: ready.jvp(X, (1.0, 1.25), {"x0": X}), 1.0), (lambda: pullback(np.ones((3, 3))), 1.125)):
        with pytest.raises(co.IntegrationError, match=r"take a smaller step than 0\.125") as raised:
            call()
        assert raised.value.time == (1.25 if system is BODY else time)


WAVES = co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (np.cos, lambda y: -np.sin(y))}))


@pytest.mark.parametrize(
    ("system", "method", "options", "words"),
    [
        (BODY.with_forces(co.forces.Torque((0, 0, 1.0))), co.Taylor(8, tolerance=1e-9), {}, "chooses its own steps"),
        (WAVES, co.Splitting(), {}, "give hessian="),
        (WAVES.with_forces(co.forces.LinearDamping(0.1)), co.Splitting(), {}, "give hessian="),
    ],
)
def test_runs_without_derivatives_are_refused_before_they_start(system, method, options, words, monkeypatch):
    ready = co.prepare(system, method, 0.125, **options)
    x0 = np.ones(getattr(system, "shape", (system.dim,)))
    monkeypatch.setattr(prepared_run, "Run", None)
    for call in (lambda: ready.vjp(x0, SPAN), lambda: ready.jvp(x0, SPAN, {"x0": x0})):
        with pytest.raises(TypeError, match=re.escape(words)) as raised:
            call()
        assert "\n" not in str(raised.value)


def test_a_system_of_matrices_without_numbers_has_no_parameters():
    assert not co.prepare(co.systems.torus_euler(5), None, 0.125).parameters


# x2' = x2 on the plane: from 1e-300 the motion stays finite, and its derivative grows beyond all numbers.
LINE = co.LiePoissonSystem(co.LieAlgebra([(0, 1, 1, 1.0)], dim=2), co.Quadratic([0, 0], linear=[1.0, 0.0]))
SMALL = np.array([1e-300, 1e-300])
OVERFLOWING = (0.0, -720.0)


@pytest.mark.parametrize("members", [None, 3])
def test_derivatives_that_overflow_raise_integration_errors(members):
    ready = co.prepare(LINE, co.Splitting(order=1), 1.0)
    x0 = SMALL if members is None else np.tile(SMALL, (members, 1))
    sol = ready.run(x0, OVERFLOWING, 10)
    assert np.isfinite(sol.x).all() and sol.x.max() > 1.0
    message = "derivative of x overflows at t = -710: .* take a shorter span"
    with pytest.raises(co.IntegrationError, match=message) as raised:
        ready.jvp(x0, OVERFLOWING, {"x0": np.ones(x0.shape)}, 10)
    assert (raised.value.step, raised.value.time) == (710, -710.0)
    assert np.array_equal(raised.value.partial.x, sol.x)
    _, pullback = ready.vjp(x0, OVERFLOWING, 10)
    with pytest.raises(co.IntegrationError, match=r"derivative by x0 overflows: .* take a shorter span") as raised:
        pullback(np.ones(sol.x.shape))
    assert np.array_equal(raised.value.partial.x, sol.x)
    assert np.isnan(raised.value.derivatives["x0"]).any() or np.isinf(raised.value.derivatives["x0"]).any()
    # Those of earlier points do not overflow.
    cotangents = np.zeros(sol.x.shape)
    cotangents[sol.t >= -700] = 1.0
    gradient = pullback(cotangents)
    assert np.isfinite(gradient["x0"]).all() and np.abs(gradient["x0"]).max() > 1e300


@pytest.mark.parametrize("system", [LINE, co.batch([LINE] * 3)], ids=["ensemble", "batch"])
def test_members_whose_derivatives_overflow_do_not_affect_others(system):
    """The errors contain the derivatives of all members, of which the others have the bits of single runs."""
    together, ready = (co.prepare(one, co.Splitting(order=1), 1.0) for one in (system, LINE))
    x0, span = np.array([[1e-300, 1e-300], [1e-300, 0.0], [1e-300, 1e-300]]), (0.0, -720.0)
    directions = {"x0": np.array([[1.0, 1.0], [1.0, 0.0], [1.0, 1.0]])}
    with pytest.raises(co.IntegrationError, match="derivative of x overflows") as raised:
        together.jvp(x0, span, directions, 10)
    found = raised.value.derivatives
    assert raised.value.time == -710.0 and raised.value.partial.x.shape == found.x.shape
    sol, alone = ready.jvp(x0[1], span, {"x0": directions["x0"][1]}, 10)
    assert np.array_equal(found.x[:, 1], alone.x) and np.isfinite(alone.x).all()
    assert not np.isfinite(found.x[:, 0]).all() and not np.isfinite(found.x[:, 2]).all()
    # The second member has no cotangent along the growing coordinate.
    _, pullback = together.vjp(x0, span, 10)
    cotangents = np.ones((len(sol.t), 3, 2))
    cotangents[:, 1] = [1.0, 0.0]
    with pytest.raises(co.IntegrationError, match="derivative by x0 overflows") as raised:
        pullback(cotangents)
    _, single = ready.vjp(x0[1], span, 10)
    expected = single(cotangents[:, 1])["x0"]
    assert np.isfinite(expected).all() and np.array_equal(raised.value.derivatives["x0"][1], expected)
    assert not np.isfinite(raised.value.derivatives["x0"][[0, 2]]).all()
    restored = pickle.loads(pickle.dumps(raised.value))
    assert np.array_equal(restored.derivatives["x0"][1], expected)
