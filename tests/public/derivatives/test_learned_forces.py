"""Forces with parameters in runs of JAX: torques and damping on the orbit, against SciPy and the compiled loops."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_beyond
from refusals import refused

jax = pytest.importorskip("jax")
jnp = jax.numpy
get = co.algebras.get


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def parameters(n, seed=3):
    rng = np.random.default_rng(seed)
    return {
        "root": 0.3 * rng.standard_normal((n, 2)),
        "rate": np.array(0.2 + 0.05 * seed),
        "in": rng.standard_normal((n, n)) / np.sqrt(n),
    }


def root(x, params, t):
    return (1.0 + 0.3 * jnp.sin(x[0] + t)) * params["root"]


def diagonal_root(x, params):
    return params["root"][:, 0] * (1.0 + 0.3 * x**2)


def drag(x, params, t):
    return -params["rate"] * jnp.cos(t) * x + 0.1 * jnp.tanh(params["in"] @ x)


def damping_of(f, J, x, params, t):
    L = (1.0 + 0.3 * np.sin(x[0] + t)) * params["root"]
    return J @ (L @ (L.T @ f))


def diagonal_damping_of(f, J, x, params, t):
    return J @ ((params["root"][:, 0] * (1.0 + 0.3 * x**2)) ** 2 * f)


def drag_of(f, J, x, params, t):
    return -params["rate"] * np.cos(t) * x + 0.1 * np.tanh(params["in"] @ x)


FORCES = {
    "damping": (co.jax.double_bracket, root, damping_of),
    "diagonal": (co.jax.double_bracket, diagonal_root, diagonal_damping_of),
    "drag": (co.jax.torque, drag, drag_of),
}
CASES = [
    (("damping", "drag"), "so(3)", (0.5, 1.5), 1.0),
    (("drag", "damping"), "e(3)", (1.5, 0.5), 1.0),
    (("damping",), "A3,7", (0.0, 1.0), 1.0),
    (("diagonal",), "su(3)", (0.0, 0.4), 1.0),
    (("diagonal", "drag"), "so(3)", (0.0, 1.0), 1e30),
    (("damping", "drag"), "so(3)", (0.0, 1.0), 1e-7),
]


@pytest.mark.parametrize(("names", "algebra", "ends", "unit"), long_beyond(1, CASES))
def test_states_and_gradients_are_those_of_scipy(names, algebra, ends, unit):
    """A known energy beside forces, in states of a unit; the derivative along all parameters and x0 by differences."""
    algebra = get(algebra, a=0.5) if algebra == "A3,7" else get(algebra)
    n, rng = algebra.dim, np.random.default_rng(11)
    params, along = parameters(n), parameters(n, seed=8)
    x0, v, c = rng.uniform(0.3, 0.8, n), rng.standard_normal(n), np.cos(np.arange(n))
    J, inverse = -np.array([algebra.structure_matrix(e) for e in np.eye(n)]), np.linspace(0.4, 1.1, n)

    def moved(s):
        return {name: params[name] + s * along[name] for name in params}

    def end(s):
        def field(t, x):
            structure = np.einsum("kij,k->ij", J, x)
            f = structure @ (inverse * x)
            return f + sum(FORCES[name][2](f, structure, x, moved(s), t) for name in names)

        return solve_ivp(field, ends, x0 + s * v, method="DOP853", rtol=3e-14, atol=1e-16).y[:, -1]

    def scaled(name):
        make, function, _ = FORCES[name]
        power = unit if make is co.jax.torque else unit**-0.5
        if function is diagonal_root:
            return make(lambda x, params: power * diagonal_root(x / unit, params), params)
        return make(lambda x, params, t: power * function(x / unit, params, t), params)

    system = co.LiePoissonSystem(algebra, co.Quadratic(inverse / unit), sign=-1).with_forces(*map(scaled, names))
    run = co.jax.solution(system, ends, 10**6, method=co.Splitting(order=2), step=0.01)

    def weighted(s):
        x = run(unit * (x0 + s * v), params=moved(s))[-1] / unit
        return c @ x, x

    (_, found), slope = jax.jit(jax.value_and_grad(weighted, has_aux=True))(0.0)
    np.testing.assert_allclose(found, end(0.0), rtol=0, atol=3e-6)  # h^2 times third derivatives
    h = 3e-5
    wanted = c @ (end(h) - end(-h)) / (2 * h)
    assert abs(slope - wanted) < 3e-5 * max(1.0, abs(wanted))


def test_damping_keeps_casimirs_and_compiled_loops_call_the_same_functions():
    """A learned energy and a learned metric of the same params, at the given and at other params."""
    params = parameters(3)
    H = co.jax.energy(lambda x, params: x @ (jnp.array([1.0, 0.5, 0.4]) * x) / 2 + jnp.sin(params["in"][0] @ x), params)
    system = co.LiePoissonSystem(get("so(3)"), H, sign=-1).with_forces(co.jax.double_bracket(root, params))
    x0 = np.array([0.3, 0.8, 0.5])
    run = co.jax.solution(system, (0.5, 2.5), method=co.GaussLegendre(2), step=0.1)
    sol = co.integrate(system, x0, (0.5, 2.5), 0.1, co.GaussLegendre(2))
    np.testing.assert_allclose(run(x0), sol.x, rtol=0, atol=1e-13)
    assert np.all(np.diff([system.energy(x) for x in sol.x]) < 0.0)
    other = run(x0, params=parameters(3, seed=5))
    assert np.abs(other[-1] - sol.x[-1]).max() > 0.01
    np.testing.assert_allclose((other**2).sum(axis=1), x0 @ x0, rtol=1e-13)
    assert sol.balance()["energy"] < 1e-9 and sol.balance()["|x|^2"] < 1e-13


def test_prepared_runs_with_learned_torques_are_differentiated_as_those_of_the_same_law():
    """From a time other than zero, backward, of members and with another force: JAX has the derivatives."""
    weights, rate = parameters(3)["in"], parameters(3)["rate"]

    def law(x, t, weights):
        return -rate * np.cos(t) * x + 0.1 * np.tanh(weights @ x)

    body, x0 = co.systems.rigid_body((1.0, 2.0, 2.5)), np.array([[0.3, 1.0, 0.2], [0.5, -0.4, 0.1]])
    forces = co.jax.torque(drag, parameters(3)), co.forces.Torque(law, arguments={"weights": weights})
    found = []
    for force in forces:
        system = body.with_forces(force, co.forces.LinearDamping(0.1))
        ready = co.prepare(system, co.Splitting(), 0.0625)
        sol, pullback = ready.vjp(x0, (0.5, -0.5))
        gradient = pullback(sol.x)
        tangents = ready.jvp(x0, (0.5, -0.5), {"x0": x0[::-1], "inertia": np.ones(3)})[1]
        found.append((gradient["x0"], gradient["inertia"], gradient["LinearDamping.rate"], tangents.x))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())


@pytest.mark.long
def test_torques_in_the_frame_of_a_body_are_those_of_compiled_forces():
    body = co.systems.body((1.0, 2.0, 2.5))
    x0 = body.state(angular_velocity=(0.3, 0.5, 0.1))
    learned = body.with_forces(co.jax.torque(lambda x, params: -params * x[:3], np.array(0.3)))
    known = body.with_forces(co.forces.Torque(lambda x, A: -0.3 * x[:3]))
    x = co.jax.solution(learned, (0, 2), method=co.Splitting(order=4), step=0.1)(x0)
    np.testing.assert_allclose(x, co.integrate(known, x0, (0, 2), 0.1, co.Splitting(order=4)).x, rtol=0, atol=1e-13)


@pytest.mark.long
def test_momenta_that_are_not_observed_are_differentiated_through_attitudes():
    """Attitude rows of a body with a learned energy, by the momenta at the start and by the weights."""
    body = co.systems.body((1.0, 2.0, 2.5))
    params = {"form": np.array([1.0, 0.5, 0.4]), "in": np.array([0.3, -0.2, 0.5])}

    def energy(x, params):
        return params["form"] @ x[:3] ** 2 / 2 + jnp.cos(params["in"] @ x[:3]) / 4 + x[5] / 8

    system = co.LiePoissonSystem(body.algebra, co.jax.energy(energy, params), sign=body.sign)
    run = co.jax.solution(system, (0, 1), 5, method=co.GaussLegendre(3), step=0.1)
    rest, observed = np.eye(3).ravel(), np.cos(np.arange(9))
    J = body.sign * np.array([body.algebra.structure_matrix(e) for e in np.eye(12)])

    def loss(momenta, params):
        return observed @ run(jnp.append(momenta, rest), params=params)[-1, 3:]

    def end(momenta, params):
        def field(t, x):
            y = x[:3]
            slopes = params["form"] * y - np.sin(params["in"] @ y) * params["in"] / 4
            return np.einsum("kij,k,j->i", J, x, np.append(slopes, np.eye(9)[2] / 8))

        start = np.append(momenta, rest)
        return observed @ solve_ivp(field, (0, 1), start, method="DOP853", rtol=3e-14, atol=1e-16).y[3:, -1]

    momenta, h = np.array([0.3, 0.8, 0.5]), 1e-5
    assert abs(loss(momenta, params) - end(momenta, params)) < 1e-8
    of_momenta, of_params = jax.grad(loss, (0, 1))(momenta, params)
    for k, e in enumerate(np.eye(3)):
        wanted = (end(momenta + h * e, params) - end(momenta - h * e, params)) / (2 * h)
        assert abs(of_momenta[k] - wanted) < 1e-7
        for name in params:
            ends = [end(momenta, params | {name: params[name] + s * h * e}) for s in (1, -1)]
            assert abs(of_params[name][k] - (ends[0] - ends[1]) / (2 * h)) < 1e-7


@pytest.mark.long
def test_noise_of_a_seed_is_a_fixed_path_of_which_runs_are_differentiated():
    def noise():
        return co.forces.HamiltonianNoise([co.Polynomial({(1, 0, 0): 0.2}), co.Polynomial({(0, 0, 1): 0.1})], seed=4)

    def energy(x, params):
        return x @ (jnp.array([1.0, 0.5, 0.4]) * x) / 2 + params["out"] * jnp.sin(params["in"] @ x)

    params, x0 = {"in": np.array([0.3, -0.2, 0.5]), "out": np.array(0.4)}, np.array([0.3, 0.8, 0.5])

    def system(params):
        return co.LiePoissonSystem(get("so(3)"), co.jax.energy(energy, params), sign=-1).with_forces(noise())

    def end(params):
        return co.integrate(system(params), x0, (0.5, 1.5), 0.1, co.GaussLegendre(2)).x[-1, 1]

    run = co.jax.solution(system(params), (0.5, 1.5), method=co.GaussLegendre(2), step=0.1)
    assert abs(run(x0)[-1, 1] - end(params)) < 1e-12
    slope, h = jax.grad(lambda params: run(x0, params=params)[-1, 1])(params), 1e-5
    ends = [end(params | {"out": params["out"] + s * h}) for s in (1, -1)]
    assert abs(slope["out"] - (ends[0] - ends[1]) / (2 * h)) < 1e-8
    x = run(x0, params=params | {"out": np.array(0.9)})
    np.testing.assert_allclose((x**2).sum(axis=1), x0 @ x0, rtol=1e-13)


def with_force(force, system=None):
    return (system or co.systems.rigid_body((1.0, 2.0, 3.0))).with_forces(force)


def of_other_params():
    H = co.jax.energy(lambda x, params: params * x[0], np.array(1.0))
    system = co.LiePoissonSystem(get("so(3)"), H).with_forces(
        co.jax.torque(lambda x, params: params * x, np.array(2.0))
    )
    return co.jax.solution(system, (0, 1), method=co.GaussLegendre(1), step=0.1)


def matrices():
    return co.systems.sphere_euler(N=4)


half_of_slope = jax.custom_vjp(lambda x: x**2)
half_of_slope.defvjp(lambda x: (x**2, x), lambda x, cotangent: (cotangent * x,))


REFUSED = {
    "no function": (lambda: co.jax.torque(3.0, {}), TypeError, ["co.jax.torque", "N(x, params)"]),
    "params, x": (lambda: co.jax.double_bracket(lambda params, x: x, {}), TypeError, ["(x, params)", "this order"]),
    "text": (lambda: co.jax.torque(lambda x, params: x, {"k": "a"}), TypeError, ["params['k']", "co.jax.torque"]),
    "shape": (lambda: with_force(co.jax.torque(lambda x, p: x[:2], {})), ValueError, ["(2,)", "(3,)"]),
    "root": (lambda: with_force(co.jax.double_bracket(lambda x, p: x[:2], {})), ValueError, ["(2,)", "(3, k)"]),
    "trace": (lambda: with_force(co.jax.torque(lambda x, p: p @ x, np.ones(2))), TypeError, ["torque", "trace"]),
    "float32": (
        lambda: with_force(co.jax.torque(lambda x, p: x.astype("float32"), {})), TypeError, ["float32", "float64"]
    ),
    "stop_gradient": (
        lambda: with_force(co.jax.torque(lambda x, p: -jnp.sum(jax.lax.stop_gradient(x) ** 2) * x, {})), ValueError,
        ["torque", "contradicts", "stop_gradient"],
    ),
    "custom_vjp": (
        lambda: with_force(co.jax.torque(lambda x, p: -p * half_of_slope(x), np.array(0.1))), ValueError,
        ["torque", "contradicts", "incomplete"],
    ),
    "stop_gradient later": (
        lambda: with_force(co.jax.torque(lambda x, p, t: -t * jnp.sum(jax.lax.stop_gradient(x) ** 2) * x, {})),
        ValueError, ["torque", "contradicts", "stop_gradient"],
    ),
    "axis": (
        lambda: with_force(co.jax.torque(lambda x, p: -x, {}), co.systems.heavy_top()), ValueError, ["direction"]
    ),
    "matrices": (lambda: with_force(co.jax.torque(lambda x, p: x, {}), matrices()), TypeError, ["co.jax.torque"]),
    "other params": (of_other_params, TypeError, ["co.jax.energy", "co.jax.torque", "one tree"]),
}  # fmt: skip


def test_a_torque_that_stops_no_part_of_its_slope_is_taken():
    """The shift of exponents in `softmax` is stopped, and its slope vanishes."""
    torque = co.jax.torque(lambda x, params: -params * jax.nn.softmax(1e3 * x) * x, np.array(0.3))
    sol = co.integrate(with_force(torque), np.array([0.3, 0.8, 0.5]), (0, 1), 0.1, co.GaussLegendre(2))
    assert 0.5 < np.linalg.norm(sol.x[-1]) < 0.9 < np.linalg.norm(sol.x[0])


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused(name):
    call, error, named = REFUSED[name]
    with refused(error, *named):
        call()
