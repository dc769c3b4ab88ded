"""Energies with parameters in runs of JAX: against SciPy, and what they preserve for all parameters."""

import math
import warnings

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import coadjoint as co
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF

jax = pytest.importorskip("jax")
jnp = jax.numpy


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def weights(n, width=4, seed=3, scale=1.0):
    rng = np.random.default_rng(seed)
    return {"in": scale * rng.standard_normal((width, n)) / np.sqrt(n), "out": rng.standard_normal(width) / 2}


def network(x, params):
    return params["out"] @ jnp.tanh(params["in"] @ x) + 0.5 * x @ x


def slopes(x, params, t=0.0):
    """The gradient of `network`, in NumPy."""
    return params["in"].T @ (params["out"] / np.cosh(params["in"] @ x) ** 2) + x


def in_time(x, params, t):
    return jnp.cos(t) * network(x, params)


def directions_of(params):
    return jnp.asarray(params["in"]), {"c": jnp.asarray(params["out"]), "b": 0.3 * jnp.asarray(params["out"])}


def feature(y, w):
    return w["c"] * jnp.log(jnp.cosh(y + w["b"]))


def feature_slopes(x, params, t=0.0):
    a, w = directions_of(params)
    return np.asarray(a).T @ (np.asarray(w["c"]) * np.tanh(np.asarray(a) @ x + np.asarray(w["b"])))


get = co.algebras.get


def kinetic_and_potential(params):
    """A kinetic energy, and a network of the commuting coordinates of e(3)."""
    piece = co.SplitHamiltonian([((3, 4, 5), co.jax.energy(network, params))])
    return co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0]) + piece


def split_slopes(x, params, t=0.0):
    return np.append(np.array([1.0, 0.5, 0.4]) * x[:3], slopes(x[3:], params))


def energy(params):
    return co.jax.energy(network, params)


def timed_energy(params):
    return co.jax.energy(in_time, params)


def features(params):
    return co.jax.features(feature, *directions_of(params))


def twice_features(params):
    return 2 * features(params)


FORMS = {
    "network": (energy, slopes, lambda params: params, 0),
    "in time": (timed_energy, lambda x, params, t: np.cos(t) * slopes(x, params), lambda params: params, 0),
    "potential": (kinetic_and_potential, split_slopes, lambda params: params, 3),
    "features": (features, feature_slopes, directions_of, 0),
    "twice": (twice_features, lambda x, params, t: 2 * feature_slopes(x, params), directions_of, 0),
}
GAUSS, EXPLICIT = co.GaussLegendre(3), co.Splitting(order=6)
PROCESSED = co.Splitting(scheme="blanes_casas_murua6")
CASES = [
    ("in time", "so(3)", GAUSS, -1, (1.5, 0.5), 1.0),
    ("potential", "e(3)", EXPLICIT, -1, (0.0, 1.0), 1.0),
    ("twice", "A3,7", PROCESSED, 1, (1.5, 0.5), 1.0),
]
REPEATED = [
    ("network", "so(3)", GAUSS, 1, (0.0, 1.0), 1.0),
    ("features", "A3,7", EXPLICIT, 1, (1.5, 0.5), 1.0),
    ("twice", "e(3)", PROCESSED, 1, (0.0, 1.0), 1.0),
    ("network", "A4,10", GAUSS, -1, (0.0, 1.0), 1.0),
    ("in time", "heisenberg(2)", co.GaussLegendre(4), 1, (2.0, 3.0), 1.0),
    ("features", "su(3)", EXPLICIT, 1, (0.0, 1.0), 1.0),
    ("features", "so(3)", co.Composition(co.Splitting(order=4), (1.0,)), -1, (0.0, 1.0), 1.0),
    ("features", "sl(2)", co.Splitting(order=8), -1, (0.0, 1.0), 1.0),
    ("features", "so(3)", EXPLICIT, -1, (0.0, 1.0), 1e30),
    ("network", "so(3)", GAUSS, -1, (0.0, 1.0), 1e-7),
    ("potential", "e(3)", co.GaussLegendre(4), 1, (1.0, 0.0), 1.0),
]


@pytest.mark.parametrize(
    ("form", "algebra", "method", "sign", "ends", "unit"), long_beyond(len(CASES), CASES + REPEATED)
)
def test_states_and_gradients_are_those_of_scipy(form, algebra, method, sign, ends, unit):
    """H(x/unit) unit in states of another unit, and a direction of all parameters and of x0, by differences."""
    make, slopes_of, given, missing = FORMS[form]
    algebra = get(algebra, a=0.5) if algebra == "A3,7" else get(algebra)
    n, rng = algebra.dim, np.random.default_rng(11)
    params, along = weights(n - missing), weights(n - missing, seed=8)
    x0, v = rng.uniform(0.3, 0.8, n), rng.standard_normal(n)
    J = sign * np.array([algebra.structure_matrix(e) for e in np.eye(n)])

    def end(s):
        moved = {name: params[name] + s * along[name] for name in params}

        def field(t, x):
            return np.einsum("kij,k,j->i", J, x, slopes_of(x, moved, t))

        return solve_ivp(field, ends, x0 + s * v, method="DOP853", rtol=3e-14, atol=1e-16).y[:, -1]

    def scaled(H):
        """H of x / unit, times unit: the same motion in another unit."""
        if unit == 1.0:
            return H
        inner = network if form == "network" else None
        if inner is None:
            a, w = directions_of(params)
            return co.jax.features(lambda y, w: unit * feature(y, w), a / unit, w)
        return co.jax.energy(lambda x, params: unit * inner(x / unit, params), params)

    system = co.LiePoissonSystem(algebra, scaled(make(params)), sign=sign)
    run = co.jax.solution(system, ends, 10**6, method=method, step=0.04)
    c = np.cos(np.arange(n))

    def weighted(s):
        moved = given({name: params[name] + s * along[name] for name in params})
        moved = (moved[0] / unit, moved[1]) if form == "features" else moved
        x = run(unit * (x0 + s * v), params=moved)[-1] / unit
        return c @ x, x

    (_, found), slope = jax.jit(jax.value_and_grad(weighted, has_aux=True))(0.0)
    np.testing.assert_allclose(found, end(0.0), rtol=0, atol=2e-9)
    h = 3e-5  # third derivatives are of size a hundred
    wanted = c @ (end(h) - end(-h)) / (2 * h)
    assert abs(slope - wanted) < 1e-6 * max(1.0, abs(wanted))


def defect(algebra, step, x):
    """Return the defect of the bracket relative to its terms, with the exact tangent map."""
    D, y = jax.jacfwd(step)(x), step(x)
    J, after = (algebra.structure_matrix(np.asarray(one)) for one in (x, y))
    return np.max(np.abs(D @ J @ D.T - after)) / np.max(np.abs(D) @ np.abs(J) @ np.abs(D.T))


def invariants(system, x):
    return {name: np.array([float(C(one)) for one in np.atleast_2d(x)]) for name, C in system.casimirs.items()}


@pytest.mark.parametrize(
    "name", long_beyond(1, ["e(3)", "sl(2)", "so(3)", "e(2)", "heisenberg(2)", "A4,10", "A4,1", "A4,7"])
)
def test_coadjoint_motions_are_those_of_scipy(name):
    """Small and large angles of one feature along any direction, and the derivatives by it."""
    algebra, rng = get(name), np.random.default_rng(4)
    n = algebra.dim
    a, da, x = rng.standard_normal((3, n))
    H = co.jax.features(lambda y, w: w * y, a[None], jnp.ones(1))
    run = co.jax.solution(co.LiePoissonSystem(algebra, H, sign=-1), (0, 1), method=co.Splitting(order=1), step=1.0)
    end = jax.jit(lambda a: run(x, params=(a[None], jnp.ones(1)))[-1])
    D, dD = (-np.stack([algebra.structure_matrix(e) @ one for e in np.eye(n)], 1) for one in (a, da))
    for size in (1e-9, 1e-3, 0.1) if name == "A4,7" else (1e-9, 1e-3, 0.5, 1.0, 2.0, 10.0):
        block = expm(size * np.block([[D, dD], [0 * D, D]]))
        found, slope = jax.jvp(end, (size * a,), (size * da,))
        bound = (
            200 * UNIT_ROUNDOFF * max(1.0, size * np.linalg.norm(D, 2)) * np.linalg.norm(block, 2) * np.linalg.norm(x)
        )
        assert np.max(np.abs(found - block[:n, :n] @ x)) < bound
        assert np.max(np.abs(slope - block[:n, n:] @ x)) < bound


ALGEBRAS = ["A3,7", "so(3)", "e(3)", "su(3)", "so(5)", "A4,10", "heisenberg(2)"]


@pytest.mark.parametrize("name", long_beyond(1, ALGEBRAS))
def test_maps_and_features_have_the_bracket_and_the_casimirs_before_and_after_training(name):
    """Twenty steps of descent toward the samples of a motion, with the time step learned too; another seed is a map."""
    algebra = get(name, a=0.5) if name == "A3,7" else get(name)
    n, rng = algebra.dim, np.random.default_rng(2)
    layers = co.jax.PoissonMap(algebra, depth=5, widths=(6, 5), sign=-1)
    x = jnp.asarray(rng.uniform(0.2, 0.9, (6, n)))
    body = co.LiePoissonSystem(algebra, co.Quadratic(np.linspace(0.3, 0.9, n)), sign=-1)
    y = co.integrate(body, np.asarray(x), (0, 0.2), 0.1, co.GaussLegendre(3)).x[-1]
    learned = {"map": layers.init(3), "h": jnp.asarray(0.3)}

    @jax.jit
    @jax.value_and_grad
    def loss(learned):
        return jnp.mean((layers(x, learned["map"], learned["h"]) - y) ** 2)

    first, _ = loss(learned)
    assert defect(algebra, lambda x: layers(x, learned["map"], learned["h"]), x[0]) < 1e-14
    for _ in range(40):
        now, slope = loss(learned)
        learned = jax.tree.map(lambda one, by: one - 0.5 * by, learned, slope)
    assert now < 0.9 * first and learned["h"] != 0.3
    assert defect(algebra, lambda x: layers(x, learned["map"], learned["h"]), x[0]) < 1e-14
    moved = layers(x, learned["map"], learned["h"])
    system = co.LiePoissonSystem(algebra, layers.energy(learned["map"]), sign=-1)
    before, after = invariants(system, x), invariants(system, moved)
    for C in before:
        np.testing.assert_allclose(after[C], before[C], rtol=1e-13, atol=1e-13)
    back = layers.inverse(moved, learned["map"], learned["h"])
    np.testing.assert_allclose(back, x, rtol=0, atol=1e-13)
    # The map is a step of order one of its energy, as the sweep of the splitting into the same features.
    run = co.jax.solution(system, (0, 0.3), method=co.Splitting(order=1), step=0.3)
    np.testing.assert_allclose(run(x)[-1], layers(x, learned["map"], 0.3), rtol=0, atol=1e-13)


def test_a_processed_run_is_continued_where_it_ended():
    """The processor is undone at the start of a run, to round-off."""
    system = co.LiePoissonSystem(get("so(3)"), features(weights(3)), sign=-1)
    run = co.jax.solution(system, (0, 2), 4, method=PROCESSED, step=0.25)
    _, middle, end = run(jnp.array([0.3, 0.8, 0.5]))
    again = co.jax.solution(system, (0, 1), 4, method=PROCESSED, step=0.25)(middle)[-1]
    np.testing.assert_allclose(again, end, rtol=0, atol=1e-13)


def turning(x, params):
    return x @ (params * x) / 2


@pytest.mark.parametrize("forced", [False, True])
def test_first_runs_warn_of_a_large_step(forced):
    """At the params of the system, given or not, also in a gradient; not at others, of slow motions and of features."""
    x0, params = np.array([0.3, 1.0, 0.2]), np.array([1.0, 0.5, 0.4])
    given = {"params": params} if forced else {}
    system = co.LiePoissonSystem(get("so(3)"), co.jax.energy(turning, params), sign=-1)
    if forced:
        system = system.with_forces(co.jax.torque(lambda x, params: -1e-3 * params[0] * x, params))
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        run = co.jax.solution(system, (1, 81), method=co.GaussLegendre(1), step=2.0)
        run(np.tile(x0, (9, 1)), params=1.01 * params)
        with pytest.warns(co.LargeStepWarning, match="the step 2 is too large"):
            jax.grad(lambda x: run(x, **given)[-1].sum())(np.tile(x0, (9, 1)))
        run(x0, **given)
        slow = co.jax.solution(system, (81, 1), method=co.GaussLegendre(1), step=2.0)
        assert np.isfinite(slow(2.0**-6 * x0, **given)).all()
    explicit = co.LiePoissonSystem(get("so(3)"), features(weights(3)), sign=-1)
    run = co.jax.solution(explicit, (0, 80), method=co.Splitting(), step=2.0)
    np.testing.assert_allclose((run(x0) ** 2).sum(axis=1), x0 @ x0, rtol=1e-12)


@pytest.mark.long
def test_certify_takes_a_map():
    algebra = get("so(3)")
    layers = co.jax.PoissonMap(algebra, depth=6)
    params = layers.init(0)
    system = co.LiePoissonSystem(algebra, layers.energy(params))
    claims = co.methods.Properties(poisson=True, energy=False, casimirs="all", attitude="none")

    def step(x, h):
        return layers(x, params, h)

    assert co.certify(system, step, (0.3, 1.0, 0.2), 0.1, steps=20, order=1, properties=claims).passed
    wrong = co.certify(
        system, lambda x, h: 1.001 * step(x, h), (0.3, 1.0, 0.2), 0.1, steps=20, order=1, properties=claims
    )
    assert not wrong.passed


def test_ensembles_forces_and_transformations_are_those_of_single_runs():
    """Damping beside a learned energy; members of x0 and of params by vmap."""
    params = weights(3)
    system = co.LiePoissonSystem(get("so(3)"), energy(params), sign=-1).with_forces(co.forces.LinearDamping(0.2))
    run = co.jax.solution(system, (0.5, 1.5), 5, method=co.GaussLegendre(2), step=0.1)
    x0 = jnp.asarray(np.random.default_rng(1).uniform(0.3, 0.9, (3, 3)))
    together, single = run(x0), jnp.stack([run(one) for one in x0], 1)
    np.testing.assert_allclose(together, single, rtol=0, atol=1e-14)
    many = jax.tree.map(lambda one: jnp.stack([one, 1.1 * one]), params)
    by_params = jax.vmap(lambda own: run(x0[0], params=own))(many)
    np.testing.assert_allclose(by_params[0], single[:, 0], rtol=0, atol=1e-14)
    wanted = co.integrate(system, np.asarray(x0[0]), (0.5, 1.5), 0.1, co.GaussLegendre(2), save_every=5)
    np.testing.assert_allclose(single[:, 0], wanted.x, rtol=0, atol=1e-13)


@pytest.mark.long
def test_second_derivatives_by_params_are_differences():
    params, x0 = weights(3), jnp.array([0.3, 0.8, 0.5])
    run = run_of()

    def end(out):
        return run(x0, params={**params, "out": out})[-1, 0]

    H, h = jax.jacfwd(jax.grad(end))(params["out"]), 1e-5
    gradient = jax.jit(jax.grad(end))
    for k, e in enumerate(np.eye(4)):
        difference = (gradient(params["out"] + h * e) - gradient(params["out"] - h * e)) / (2 * h)
        np.testing.assert_allclose(H[k], difference, rtol=0, atol=1e-8)


@pytest.mark.parametrize("method", long_beyond(1, [co.Splitting(order=4), co.GaussLegendre(1)]))
def test_a_hundred_thousand_steps_are_differentiated_in_little_memory(method):
    form = features if method.explicit else energy
    system = co.LiePoissonSystem(get("so(3)"), form(weights(3)), sign=-1)
    run = co.jax.solution(system, (0, 1e4), 10**6, method=method, step=0.1)
    params = directions_of(weights(3)) if method.explicit else weights(3)
    gradient = jax.jit(jax.grad(lambda params: run(jnp.ones(3), params=params)[-1].sum())).lower(params).compile()
    assert gradient.memory_analysis().temp_size_in_bytes < 2**20


def test_states_near_equilibrium_and_flows_that_turn_too_far():
    """Where the field is round-off of its terms, stages have converged; an angle beyond the series is NaN."""
    params = {"in": jnp.zeros((4, 3)), "out": jnp.ones(4)}  # H = |x|^2/2, at rest everywhere
    system = co.LiePoissonSystem(get("so(3)"), energy(params), sign=-1)
    run = co.jax.solution(system, (0, 1), method=co.GaussLegendre(2), step=0.1)
    x0 = np.array([0.3, 1e-9, 0.7])
    np.testing.assert_allclose(run(x0, params={**params, "in": 1e-17 * jnp.ones((4, 3))})[-1], x0, rtol=0, atol=1e-15)

    def turned(algebra, angle):
        n = get(algebra).dim
        H = co.jax.features(lambda y, w: w * y, jnp.eye(1, n), jnp.ones(1))
        turn = co.jax.solution(co.LiePoissonSystem(get(algebra), H), (0, 1), method=co.Splitting(), step=1.0)
        return turn(jnp.ones(n), params=(jnp.eye(1, n), jnp.array([angle])))[-1]

    found = turned("so(3)", 3.9)
    np.testing.assert_allclose(found, [1, np.cos(3.9) - np.sin(3.9), np.cos(3.9) + np.sin(3.9)], rtol=0, atol=1e-14)
    assert np.isfinite(turned("so(5)", 3.9)).all() and np.isnan(turned("so(5)", 4.1)).all()


@pytest.mark.parametrize("size", [1e2, 1e4])
def test_stages_of_large_weights_that_cancel_converge_to_their_roundoff(size):
    """Pairs of units whose outputs differ by one: states of the compiled run, a gradient, NaN without limit."""
    rng = np.random.default_rng(2)
    first, turned = rng.standard_normal((2, 2, 3))
    w = {"in": np.concatenate([first, first + turned / size]), "out": size * np.array([1.0, 1.0, -1.0, -1.0])}
    system = co.LiePoissonSystem(get("so(3)"), energy(w), sign=-1)
    arguments = {"method": co.GaussLegendre(2), "step": 0.1}
    run, x0 = co.jax.solution(system, (0, 1), **arguments), np.array([[1.0, 0.2, 0.5], [0.1, -0.4, 0.3]])
    # Ten steps of forces of the size of the weights, each of which is rounded some ten times.
    allowed = 100 * size * UNIT_ROUNDOFF
    np.testing.assert_allclose(run(x0), co.integrate(system, x0, (0, 1), **arguments).x, rtol=0, atol=allowed)
    h, along = 1e-4, np.array([0.3, -0.2, 0.1])
    slope = along @ jax.grad(lambda x: run(x)[-1, 0])(x0[0])
    difference = (run(x0[0] + h * along)[-1, 0] - run(x0[0] - h * along)[-1, 0]) / (2 * h)
    assert abs(slope - difference) < 1e-6 + allowed / h
    assert np.isnan(co.jax.solution(system, (0, 50), method=co.GaussLegendre(2), step=50.0)(x0)[-1]).all()


OfTorch = type("Tensor", (), {"__module__": "torch", "__call__": lambda self, x: x})
SYSTEM = co.systems.rigid_body((1.0, 2.0, 3.0))
DIRECTIONS = np.eye(2, 3)
REMEDIES = ["no parts; ", "co.jax.features", "SplitHamiltonian", "GaussLegendre"]
LEARNED = {
    "params, x": (lambda: co.jax.energy(lambda params, x: x[0], {}), TypeError, ["(x, params)", "this order"]),
    "compensated": (
        lambda: co.jax.solution(
            co.LiePoissonSystem(get("so(3)"), co.jax.features(lambda y, w: w * y, DIRECTIONS, np.ones(2))),
            (0, 1), method=co.Splitting(order=4, compensated=True), step=0.1,
        ), TypeError, ["compensated=False"],
    ),
    "no function": (lambda: co.jax.energy(3.0, {}), TypeError, ["3.0", "H(x, params)"]),
    "text": (lambda: co.jax.energy(network, {"in": "abc"}), TypeError, ["params['in']", "abc", "arrays"]),
    "function": (lambda: co.jax.energy(network, {"in": [np.tanh]}), TypeError, ["params['in'][0]", "tanh"]),
    "tensor": (lambda: co.jax.energy(network, {"in": OfTorch()}), TypeError, ["params['in']", "PyTorch"]),
    "module": (lambda: co.jax.energy(OfTorch(), {}), TypeError, ["PyTorch", "JAX"]),
    "float32": (lambda: co.jax.energy(network, {"in": jnp.ones(2, "float32")}), TypeError, ["params['in']", "float64"]),
    "vector": (lambda: bound(co.jax.energy(lambda x, params: x, {})), TypeError, ["(3,)", "one number"]),
    "shape": (lambda: bound(energy(weights(4))), TypeError, ["fails at a state of the shape (3,)", "dot"]),
    "directions": (lambda: co.jax.features(feature, np.ones(3), {}), ValueError, ["(3,)", "(features, n)"]),
    "few": (lambda: co.jax.features(feature, DIRECTIONS, {"c": np.ones(3)}), ValueError, ["params['c']", "2 features"]),
    "n": (lambda: bound(co.jax.features(feature, np.eye(2), weights_of(2))), TypeError, ["2 coordinates", "3"]),
    "three": (lambda: co.jax.features(in_time, DIRECTIONS, {}), TypeError, ["(y, params)"]),
    "exchanged": (
        lambda: bound(co.jax.energy(lambda w, x: network(x, w), weights(3))), TypeError,
        ["fails at a state", "before params"],
    ),
    "not traced": (
        lambda: bound(co.jax.energy(lambda x, params: params @ x * math.exp(x[0]), np.ones(3))), TypeError,
        ["cannot trace", "jax.numpy"],
    ),
    "no number": (lambda: bound(co.jax.energy(lambda x, params: params * x, np.ones(3))), TypeError, [
        "is co.jax.energy(<lambda>), and it returns an array of the shape (3,)",
    ]),
    "depth": (lambda: co.jax.PoissonMap(get("so(3)"), 0), ValueError, ["depth", "0"]),
    "widths": (lambda: co.jax.PoissonMap(get("so(3)"), 2, 16), TypeError, ["widths", "16"]),
    "algebra": (lambda: co.jax.PoissonMap(SYSTEM, 2), TypeError, ["algebra", "LieAlgebra"]),
    "two": (lambda: two(), TypeError, ["different params", "one tree"]),
    "no step": (lambda: co.jax.solution(SYSTEM, (0, 1)), TypeError, ["step="]),
    "own step": (lambda: co.jax.solution(ready(), (0, 1), step=0.1), TypeError, ["prepared run", "omit"]),
    "own method": (lambda: co.jax.solution(ready(), (0, 1), method=GAUSS), TypeError, ["prepared run", "omit"]),
    "backend": (lambda: run_of(backend="compiled")(np.ones(3), params=weights(3)), ValueError, ['backend="xla"']),
    "structure": (lambda: run_of()(np.ones(3), params={"in": np.ones(3)}), ValueError, ["structure", "out"]),
    "other shape": (
        lambda: run_of()(np.ones(3), params=weights(3, width=5)), ValueError, ["params['in']", "(5, 3)", "(4, 3)"]
    ),
    "no params": (
        lambda: co.jax.solution(ready(), (0, 1), backend="xla")(np.ones(3), params=1.0), ValueError, ["co.jax.energy"]
    ),
    "position": (lambda: run_of()(np.ones(3), weights(3)), TypeError, ["2 arguments", "x0 alone", "params="]),
    "position of a body": (
        lambda: co.jax.solution(ready(), (0, 1))(np.ones(3), np.ones(3)), TypeError, ["co.jax.solution", "inertia="]
    ),
    "parts": (lambda: run_of(method=co.Splitting()), ValueError, REMEDIES),
    "compiled parts": (lambda: by_splitting(energy(weights(3))), ValueError, REMEDIES),
    "compiled features": (lambda: by_splitting(features(weights(3))), ValueError, REMEDIES),
    "parts of a function": (lambda: by_splitting(lambda x: network(x, weights(3))), ValueError, REMEDIES),
    "map shape": (lambda: map_of()(np.ones(2), map_of().init()), ValueError, ["(2,)", "(..., 3)"]),
    "map params": (lambda: map_of()(np.ones(3), map_of(3).init()), ValueError, ["params[0]", "(3, 3)", "(2, 3)"]),
    "grad": (lambda: jax.grad(end_of_integrate)(jnp.ones(3)), TypeError, ["x0", "co.jax.solution"]),
    "vmap": (lambda: jax.vmap(end_of_integrate)(jnp.ones((2, 3))), TypeError, ["x0", "co.jax.solution"]),
    "inertia": (lambda: jax.grad(end_of_inertia)(1.0), TypeError, ["inertia", "co.jax.solution"]),
    "traced step": (lambda: jax.jit(end_by_step)(0.1), TypeError, ["step", "co.jax.solution"]),
    "kink": (lambda: of_power(0.5)(np.array([[0.1, 0.2, 0.3], [0.0, 0.5, 1.0]])), ValueError, [
        "x0[1]", "[0.0, 0.5, 1.0]", "gradient", "inf", "co.jax.energy",
    ]),
    "second": (
        lambda: jax.grad(lambda w: of_power(1.5)(np.array([0.0, 0.5, 1.0]), params=w)[-1, 0])(jnp.ones(3)), ValueError,
        ["x0", "[0.0, 0.5, 1.0]", "second derivative", "inf"],
    ),
    "tensor x0": (lambda: run_of()(OfTorch()), TypeError, ["x0", "PyTorch", "co.torch"]),
    "stop_gradient": (
        lambda: bound(co.jax.energy(lambda x, p: p @ x**2 * jax.lax.stop_gradient(x)[0], np.ones(3))), ValueError,
        ["gradient contradicts value", "stop_gradient"],
    ),
    "stop_gradient, twice": (
        lambda: bound(2 * co.jax.energy(lambda x, p: p @ x**2 * jax.lax.stop_gradient(x)[0], np.ones(3))), ValueError,
        ["gradient contradicts value", "stop_gradient"],
    ),
    "module H": (lambda: bound(OfTorch()), TypeError, ["PyTorch", "co.torch.energy"]),
}  # fmt: skip


def weights_of(count):
    return {"c": np.ones(count), "b": np.zeros(count)}


def bound(H):
    return co.LiePoissonSystem(get("so(3)"), H)


def two():
    pieces = [((k,), co.jax.energy(network, weights(1, seed=k))) for k in range(2)]
    return co.jax.solution(bound(co.SplitHamiltonian(pieces)), (0, 1), method=co.Splitting(), step=0.1)


def ready():
    return co.prepare(SYSTEM, co.Splitting(), 0.1)


def run_of(**options):
    return co.jax.solution(bound(energy(weights(3))), (0, 1), step=0.1, **{"method": co.GaussLegendre(1), **options})


def by_splitting(H):
    return co.integrate(bound(H), np.ones(3), (0, 1), 0.1, co.Splitting())


def map_of(depth=2):
    return co.jax.PoissonMap(get("so(3)"), depth)


def end_of_integrate(x0):
    return co.integrate(SYSTEM, x0, (0, 1), 0.1).x[-1, 0]


def end_by_step(h):
    return co.integrate(SYSTEM, np.ones(3), (0, 1), h).x[-1, 0]


def of_power(power):
    H = co.jax.energy(lambda x, w: w @ jnp.abs(x) ** power, jnp.ones(3))
    return co.jax.solution(bound(H), (0, 1), method=co.GaussLegendre(1), step=0.1)


def end_of_inertia(first):
    return co.integrate(co.systems.rigid_body((first, 1.0, 2.0)), np.ones(3), (0, 1), 0.1).x[-1, 0]


@pytest.mark.parametrize("name", LEARNED)
def test_what_cannot_be_used_is_refused(name):
    call, error, named = LEARNED[name]
    with refused(error, *named):
        call()
