"""Runs as functions of JAX: values, derivatives and transformations."""

import os
from functools import partial
from itertools import product

import numpy as np
import pytest

import coadjoint as co
from core_only import run_python
from refusals import refused

jax = pytest.importorskip("jax")
jnp = jax.numpy

SPAN, EVERY = (0, 10), 50
X0 = np.array([1.0, 0.2, 0.5])
MANY = np.array([X0, 2.0 * X0, X0[::-1], 0.5 * X0])
INERTIA = np.array([1.1, 2.0, 2.4])
WEIGHTS = np.cos(np.arange(15.0)).reshape(5, 3)
ALONG = np.array([0.3, -1.0, 0.5])
# 200 steps of 15 flows, each of which rounds a few times, with derivatives below 16.
ROUNDING = 200 * 15 * 4 * 16 * 2.0**-53


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def prepared(inertia=(1.0, 2.0, 2.5), **options):
    return co.prepare(co.systems.rigid_body(inertia=inertia), co.Splitting(order=4), 0.05, **options)


@pytest.fixture(scope="module")
def ready():
    return prepared()


@pytest.fixture(scope="module")
def f(ready):
    return co.jax.solution(ready, SPAN, EVERY)


@pytest.fixture
def number(f):
    return lambda x0, inertia: (WEIGHTS * f(x0, inertia=inertia)).sum()


@pytest.mark.parametrize("wrapped", [lambda f: f, jax.jit], ids=["at once", "jit"])
def test_values_have_the_bits_of_the_run(ready, f, wrapped):
    other = prepared(INERTIA)
    assert np.array_equal(wrapped(f)(X0), ready.run(X0, SPAN, EVERY).x)
    assert np.array_equal(wrapped(f)(MANY, inertia=INERTIA), other.run(MANY, SPAN, EVERY).x)
    assert np.array_equal(wrapped(f)((1, 0, 1)), f(np.array([1.0, 0.0, 1.0])))  # whole numbers
    backward = co.jax.solution(ready, (10, 0), t_eval=[10.0, 3.123, 0.0])
    assert np.array_equal(wrapped(backward)(X0), ready.run(X0, (10, 0), t_eval=[10.0, 3.123, 0.0]).x)


@pytest.mark.parametrize("wrapped", [lambda f: f, jax.jit], ids=["at once", "jit"])
@pytest.mark.parametrize("inertia", [(1.0, 2.0, 2.5), INERTIA], ids=["as prepared", "other"])
def test_gradient_is_that_of_the_pullback(number, wrapped, inertia):
    _, pullback = prepared(inertia).vjp(X0, SPAN, EVERY)
    wanted = pullback(WEIGHTS)
    value, (of_x0, of_inertia) = wrapped(jax.value_and_grad(number, (0, 1)))(X0, np.array(inertia))
    assert abs(value - number(X0, np.array(inertia))) < ROUNDING  # a compiled sum has another order
    assert np.array_equal(of_x0, wanted["x0"])
    assert np.array_equal(of_inertia, wanted["inertia"])
    assert np.array_equal(wrapped(jax.grad(number, 1))(X0, np.array(inertia)), wanted["inertia"])


def test_jvp_is_that_of_the_prepared_run(f):
    other = prepared(INERTIA)
    _, wanted = other.jvp(X0, SPAN, {"x0": ALONG, "inertia": X0}, EVERY)
    x, along = jax.jvp(lambda x0, inertia: f(x0, inertia=inertia), (X0, INERTIA), (ALONG, X0))
    assert np.array_equal(x, f(X0, inertia=INERTIA)) and np.array_equal(along, wanted.x)
    _, linear = jax.linearize(lambda x0: f(x0, inertia=INERTIA), X0)
    assert np.array_equal(linear(ALONG), other.jvp(X0, SPAN, {"x0": ALONG}, EVERY)[1].x)


SEVERAL = np.array([MANY, 1.5 * MANY])
INERTIAS = INERTIA + 0.1 * np.arange(4.0)[:, None]


def along_x0(f, v, x0):
    return jax.jvp(lambda x: f(x, inertia=INERTIA), (x0,), (v,))[1]


def along_inertia(f, x0, i):
    return jax.jvp(lambda i: f(x0, inertia=i), (i,), (X0,))[1]


def of_sum(f, x0, i):
    """The value and the gradients of a sum over all members."""
    return jax.value_and_grad(lambda x, i: (f(x, inertia=i) ** 2 * jnp.cos(x)).sum(), (0, 1))(x0, i)


# A function of the run, its arguments, their axes, and that of the result.
MAPPED = {
    "states": (lambda f, x0: f(x0), (MANY,), 0, 0),
    "ensembles": (lambda f, x0: f(x0), (SEVERAL,), 0, 0),
    "parameters": (lambda f, i: f(X0, inertia=i), (INERTIAS,), 0, 0),
    "gradients": (of_sum, (MANY, INERTIA), (0, None), 0),
    "gradients of ensembles": (of_sum, (SEVERAL, INERTIA), (0, None), 0),
    "gradients by both": (of_sum, (MANY, INERTIAS), 0, 0),
    "last axes": (of_sum, (MANY.T, INERTIAS.T), 1, 0),
    "a last axis": (of_sum, (MANY.T, INERTIA), (1, None), 0),
    "tangents": (along_x0, (MANY.T, X0), (1, None), 2),
    "tangents by parameters": (along_inertia, (MANY, INERTIAS), 0, 0),
    "tangents of ensembles": (along_inertia, (SEVERAL, INERTIA), (0, None), 0),
    "twice": (lambda f, x0: jax.vmap(lambda x: of_sum(f, x, INERTIA))(x0), (SEVERAL,), 0, 0),
}


@pytest.mark.parametrize("wrapped", [lambda f: f, jax.jit], ids=["at once", "jit"])
@pytest.mark.parametrize("name", MAPPED)
def test_vmap_agrees_with_a_loop(f, name, wrapped):
    """Runs are those of one ensemble with as many members as the mapped axis has, and have the bits of single runs."""
    function, arguments, axes, out = MAPPED[name]
    found = wrapped(jax.vmap(lambda *given: function(f, *given), axes, out))(*arguments)
    places = axes if isinstance(axes, tuple) else (axes,) * len(arguments)
    count = arguments[0].shape[places[0]]
    rows = [
        function(f, *(a if axis is None else np.take(a, k, axis) for a, axis in zip(arguments, places, strict=True)))
        for k in range(count)
    ]
    for one, *each in zip(*map(jax.tree.leaves, (found, *rows)), strict=True):
        exact = name in ("states", "ensembles", "parameters")
        np.testing.assert_allclose(one, np.stack(each, axis=out), rtol=0, atol=0 if exact else 256 * ROUNDING)


def along_both(f, x0, i, v, w):
    """Return the derivative along a state and parameters."""
    return jax.jvp(lambda x, i: f(x, inertia=i), (x0, i), (v, w))[1]


def pulled_back(f, x0, i, w):
    """Return the gradients for a cotangent of all states."""
    return jax.vjp(lambda x, i: f(x, inertia=i), x0, i)[1](w)


COTANGENTS = np.sin(np.arange(60.0)).reshape(4, 5, 3)
MAPS = [(along_both, axes) for axes in product((0, None), repeat=4)]
MAPS += [(pulled_back, axes) for axes in product((0, None), repeat=3)]


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("function", "axes"), [one for one in MAPS if 0 in one[1]])
def test_any_of_the_arguments_of_derivatives_may_be_mapped(f, function, axes):
    many = (MANY, INERTIAS, MANY[::-1], INERTIAS) if len(axes) == 4 else (MANY, INERTIAS, COTANGENTS)
    given = [one if axis == 0 else one[0] for one, axis in zip(many, axes, strict=True)]
    found = jax.vmap(partial(function, f), axes)(*given)
    rows = [function(f, *(a[k] if axis == 0 else a for a, axis in zip(given, axes, strict=True))) for k in range(4)]
    for one, *each in zip(*map(jax.tree.leaves, (found, *rows)), strict=True):
        np.testing.assert_allclose(one, np.stack(each), rtol=0, atol=256 * ROUNDING)


def test_ensembles_share_parameters(f):
    """The gradient of a sum over members is the sum of those of the members."""
    total = jax.grad(lambda inertia: (f(MANY, inertia=inertia)[-1] @ ALONG).sum())(INERTIA)
    each = [jax.grad(lambda inertia, x0=x0: f(x0, inertia=inertia)[-1] @ ALONG)(INERTIA) for x0 in MANY]
    np.testing.assert_allclose(total, np.sum(each, axis=0), rtol=0, atol=3 * ROUNDING)


@pytest.mark.parametrize("attitude", [True, "coadjoint"])
def test_attitude_is_returned_and_differentiated(attitude):
    ready = prepared(attitude=attitude)
    g = co.jax.solution(ready, SPAN, EVERY)
    turned = co.integrate(co.systems.rigid_body(inertia=INERTIA), X0, (0, 1), 0.1, attitude=True).attitude[-1]
    weights = np.sin(np.arange(45.0)).reshape(5, 3, 3)
    sol, pullback = ready.vjp(X0, SPAN, EVERY, attitude=turned)
    assert all(map(np.array_equal, g(X0, attitude0=turned), (sol.x, sol.attitude)))
    assert np.array_equal(g(X0)[1], ready.run(X0, SPAN, EVERY).attitude)

    def number(x0, attitude0):
        x, A = g(x0, attitude0=attitude0)
        return (WEIGHTS * x).sum() + (weights * A).sum()

    wanted, found = pullback(WEIGHTS, attitude=weights), jax.jit(jax.grad(number, (0, 1)))(X0, turned)
    assert all(map(np.array_equal, found, (wanted["x0"], wanted["attitude0"])))
    # Members share an attitude of shape (d, d), and its derivative is the sum of theirs.
    of_A0 = jax.jit(jax.grad(lambda A0: (g(MANY, attitude0=A0)[1] * weights[:, None]).sum()))(turned)
    each = jax.jit(jax.vmap(jax.grad(lambda A0, x0: (g(x0, attitude0=A0)[1] * weights).sum()), (None, 0)))(turned, MANY)
    np.testing.assert_allclose(of_A0, each.sum(axis=0), rtol=0, atol=3 * ROUNDING)
    forward, reverse = (jax.jit(by(lambda x0: g(x0, attitude0=turned)[1]))(X0) for by in (jax.jacfwd, jax.jacrev))
    np.testing.assert_allclose(forward, reverse, rtol=0, atol=ROUNDING)


def test_parameters_of_hamiltonians_keep_their_shapes_at_zeros():
    """M becomes diagonal, and `linear` zero; the derivatives by the other entries remain."""
    algebra, full = co.algebras.so(3), np.array([[1.0, 0.2, 0.0], [0.2, 0.5, 0.1], [0.0, 0.1, 0.4]])
    ready = co.prepare(co.LiePoissonSystem(algebra, co.Quadratic(full, [0.1, 0.0, 0.2])), co.Splitting(order=4), 0.05)
    g, diagonal = co.jax.solution(ready, (0, 1), save_every=20), np.diag([1.0, 0.5, 0.4])
    x = g(X0, M=diagonal, linear=np.zeros(3))
    own = co.LiePoissonSystem(algebra, co.Quadratic(diagonal))
    assert np.array_equal(x, co.integrate(own, X0, (0, 1), 0.05, co.Splitting(order=4), save_every=20).x)

    def number(M, linear):
        return g(X0, M=M, linear=linear)[-1] @ ALONG

    found, shift = jax.grad(number, (0, 1))(diagonal, np.zeros(3)), 2.0**-17
    for of, value, k in ((0, diagonal, (0, 1)), (0, diagonal, (2, 2)), (1, np.zeros(3), (1,))):
        unit = np.zeros_like(value)
        unit[k] = shift
        arguments = [diagonal, np.zeros(3)]
        ends = [number(*(a + sign * unit if i == of else a for i, a in enumerate(arguments))) for sign in (1, -1)]
        # The difference has an error of shift^2 and u / shift; an added part one of order 4 of the step, 0.05^4 / 120.
        assert abs((ends[0] - ends[1]) / (2 * shift) - found[of][k]) < 1e-7


def test_equal_values_of_different_parameters_are_not_confused():
    """The runs of the last values are cached."""

    def with_values(M=ALONG, linear=X0):
        system = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear))
        return co.prepare(system, co.Splitting(order=4), 0.05)

    g, names, weights = co.jax.solution(with_values(), (0, 1), 20), ("M", "linear"), np.array([0.0 * ALONG, ALONG])
    runs = {name: with_values(**{name: INERTIA}).vjp(X0, (0, 1), 20) for name in names}
    for name in names:
        assert np.array_equal(g(X0, **{name: INERTIA}), runs[name][0].x)
    for name in names:
        found = jax.grad(lambda value, name=name: (weights * g(X0, **{name: value})).sum())(INERTIA)
        assert np.array_equal(found, runs[name][1](weights)[name])


def test_gradients_at_other_attitudes_are_not_those_of_the_last_one():
    ready, weights = prepared(attitude=True), np.sin(np.arange(18.0)).reshape(2, 3, 3)
    g, elements = co.jax.solution(ready, (0, 1), 20), ready.run(X0, (0, 2), 20).attitude
    for A0 in (*elements, elements[0], None):
        found = jax.grad(lambda x0, A0=A0: (weights * g(x0, attitude0=A0)[1]).sum())(X0)
        _, pullback = ready.vjp(X0, (0, 1), 20, attitude=A0)
        assert np.array_equal(found, pullback(attitude=weights)["x0"])


def test_gradients_by_parameters_of_forces_are_those_at_the_given_values():
    """Not those at the prepared ones: the flows of the forces depend on their parameters."""

    def with_values(rate, toward, alpha, metric=1.0):
        forces = (co.forces.LinearDamping(rate, toward=toward), co.forces.DoubleBracketDamping(alpha, metric))
        body = co.systems.rigid_body(inertia=(1.0, 2.0, 2.5)).with_forces(*forces)
        return co.prepare(body, co.Splitting(order=4), 0.05)

    ready = with_values(0.1, (0.5, 0.0, 0.25), 0.125)
    g = co.jax.solution(ready, (0, 1), 20)
    values = {name: 1.5 * value + 0.25 for name, value in ready.parameters.items() if "." in name}
    assert len(values) == 4
    moved = with_values(
        **{name.partition(".")[2]: value if value.ndim else float(value) for name, value in values.items()}
    )
    _, pullback = moved.vjp(X0, (0, 1), 20)
    wanted = pullback(np.array([0.0 * ALONG, ALONG]))
    found = jax.grad(lambda given: g(X0, **given)[-1] @ ALONG)(values)
    for name, one in found.items():
        assert np.array_equal(one, wanted[name]) and np.any(wanted[name]), name


@pytest.mark.parametrize(
    ("force", "limit", "parameter"),
    [
        (co.forces.DoubleBracketDamping(0.125), co.forces.DoubleBracketDamping(0.0), "DoubleBracketDamping.alpha"),
        (
            co.forces.HeatBath(0.125, temperature=0.5, seed=3),
            co.forces.HeatBath(0.125, temperature=0.0, seed=3),
            "HeatBath.temperature",
        ),
    ],
    ids=["damping", "noise"],
)
def test_forces_may_be_given_values_at_which_they_have_no_derivative(force, limit, parameter):
    body = co.systems.rigid_body((1.0, 2.0, 2.5))
    f = co.jax.solution(co.prepare(body.with_forces(force), co.Splitting(), 0.125), (0, 2), 4)
    wanted, pullback = co.prepare(body.with_forces(limit), co.Splitting(), 0.125).vjp(X0, (0, 2), 4)
    assert np.array_equal(f(X0, **{parameter: 0.0}), wanted.x)
    by_x0 = jax.grad(lambda x: f(x, **{parameter: 0.0}).sum())(X0)
    assert np.array_equal(by_x0, pullback(np.ones(wanted.x.shape))["x0"])
    with refused(ValueError, parameter, "0.0"):
        jax.grad(lambda value: f(X0, **{parameter: value}).sum())(0.0)


def test_gauss_newton_products_are_linear_with_a_transpose(f):
    def product(v):
        return jax.vjp(f, X0)[1](jax.jvp(f, (X0,), (v,))[1])[0]

    J = jax.jacfwd(f)(X0).reshape(-1, 3)
    for matrix in (jax.jacfwd(product)(ALONG), jax.jacrev(product)(ALONG)):
        np.testing.assert_allclose(matrix, J.T @ J, rtol=0, atol=16 * ROUNDING)


def test_refused_values_and_failed_runs_raise(f):
    with refused(ValueError, "inertia"):
        f(X0, inertia=-INERTIA)
    with refused(jax.errors.JaxRuntimeError, "inertia"):
        jax.jit(lambda inertia: f(X0, inertia=inertia))(-INERTIA)
    with pytest.raises(co.IntegrationError):
        f(1e300 * X0)


ONE_CORE = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import jax, numpy as np, coadjoint as co
jax.config.update("jax_enable_x64", True)
f = co.jax.solution(co.prepare(co.systems.rigid_body((1, 2, 2.5)), co.Splitting(), 0.1), (0, 0.5))
print(jax.jit(jax.grad(lambda x: f(2.0 * x).sum()))(np.ones((20000, 3))).shape)
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be bound to one core")
@pytest.mark.parametrize("backend", ["compiled", pytest.param("xla", marks=pytest.mark.long)])
def test_batches_may_be_mapped_over_their_states(backend):
    """One after the other; each has the values and derivatives of the run alone."""
    bodies = co.batch([co.systems.rigid_body((1.0, 2.0, 2.5)), co.systems.rigid_body((1.0, 2.0, 3.0))])
    ready = co.prepare(bodies, co.Splitting(), 0.1)
    g, several = co.jax.solution(ready, (0, 0.3), 3, backend=backend), np.array([MANY[:2], MANY[2:], MANY[1:3]])
    mapped = [
        jax.vmap(g)(several),
        jax.jit(jax.vmap(lambda x0: jax.jvp(g, (x0,), (x0,))[1]))(several),
        jax.vmap(jax.grad(lambda x0: (g(x0) ** 3).sum()))(several),
    ]
    for k, x0 in enumerate(several):
        sol, tangents = ready.jvp(x0, (0, 0.3), {"x0": x0}, 3)
        _, pullback = ready.vjp(x0, (0, 0.3), 3)
        wanted = sol.x, tangents.x, pullback(3 * sol.x**2)["x0"]
        for found, one in zip(mapped, wanted, strict=True):
            # Three steps of five flows with derivatives below 32.
            np.testing.assert_allclose(found[k], one, rtol=0, atol=3 * 5 * 4 * 32 * 2.0**-53)
    with refused(ValueError, "x0", "(3,)", "(2, 3)", "vmap"):
        jax.vmap(g)(MANY[:2])


@pytest.mark.parametrize("forced", [False, True])
def test_batches_take_parameters_of_each_member(forced):
    """The values and gradients are those of a batch prepared for these parameters, and each member's of its run."""
    forces = [co.forces.LinearDamping(0.2 * m, toward=0.1) for m in (1, 2, 3)]
    bodies = [co.systems.rigid_body((1.0, 2.0, third)) for third in (2.5, 2.75, 3.0)]
    systems = [body.with_forces(force) if forced else body for body, force in zip(bodies, forces, strict=True)]
    ready = co.prepare(co.batch(systems), co.Splitting(), 0.1)
    g, given = co.jax.solution(ready, (0.5, 0.8), 3), {name: 1.1 * one for name, one in ready.parameters.items()}
    by_x0, by_given = jax.grad(lambda x0, given: (g(x0, **given) ** 2).sum(), argnums=(0, 1))(MANY[:3], given)
    for m in range(3):
        body = co.systems.rigid_body(given["inertia"][m])
        own = {name.split(".")[1]: one[m] for name, one in given.items() if "." in name}
        single = co.prepare(body.with_forces(co.forces.LinearDamping(**own)) if forced else body, co.Splitting(), 0.1)
        sol, pullback = single.vjp(MANY[m], (0.5, 0.8), 3)
        assert np.array_equal(g(MANY[:3], **given)[:, m], sol.x)
        gradient = pullback(2 * sol.x)
        assert np.array_equal(by_x0[m], gradient["x0"])
        assert all(np.array_equal(by_given[name][m], gradient[name]) for name in given)


def test_large_ensembles_are_called_back_on_one_core():
    assert run_python(ONE_CORE, timeout=100).stdout == "(20000, 3)\n"


def test_the_step_of_many_members_with_attitudes_is_checked():
    """By a run of some of them, each with its attitude."""
    ready = co.prepare(co.systems.rigid_body((1.0, 2.0, 2.5)), co.Splitting(), 2.0, attitude=True)
    x0, attitudes = np.tile([3.0, 0.6, 1.5], (65, 1)), np.tile(np.eye(3), (65, 1, 1))
    with pytest.warns(co.LargeStepWarning, match="the step 2 is too large"):
        x, A = co.jax.solution(ready, (0, 10), backend="xla")(x0, attitude0=attitudes)
    assert x.shape == (6, 65, 3) and A.shape == (6, 65, 3, 3)
