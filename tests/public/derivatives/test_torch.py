"""Runs as functions of PyTorch: values, derivatives and refused arguments; `make torch` installs it."""

import itertools
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import coadjoint as co
from refusals import refused

torch = pytest.importorskip("torch")

PAGE = Path(__file__).parents[3] / "docs" / "derivatives.md"
SPAN, EVERY = (0, 10), 50
X0 = np.array([1.0, 0.2, 0.5])
MANY = np.array([X0, 2.0 * X0, X0[::-1]])
INERTIA = np.array([1.1, 2.0, 2.4])
WEIGHTS = np.cos(np.arange(15.0)).reshape(5, 3)


def prepared(inertia=(1.0, 2.0, 2.5), **options):
    return co.prepare(co.systems.rigid_body(inertia=inertia), co.Splitting(order=4), 0.05, **options)


@pytest.fixture
def g():
    return co.torch.solution(prepared(), SPAN, EVERY)


def variable(values):
    return torch.tensor(values, dtype=torch.float64, requires_grad=True)


def test_values_have_the_bits_of_the_run(g):
    assert np.array_equal(g(X0), prepared().run(X0, SPAN, EVERY).x)
    other = prepared(INERTIA).run(MANY, SPAN, EVERY).x
    assert np.array_equal(g(torch.tensor(MANY), inertia=torch.tensor(INERTIA)), other)
    assert np.array_equal(g((1, 0, 1)), g(torch.tensor([1, 0, 1])))  # whole numbers
    batch = co.batch([prepared().system, co.systems.rigid_body(INERTIA)])
    of_batch = co.torch.solution(batch, SPAN, EVERY, method=co.Splitting(order=4), step=0.05)(MANY[:2])
    assert np.array_equal(of_batch[:, 1], prepared(INERTIA).run(MANY[1], SPAN, EVERY).x)
    x = g(X0)
    x.zero_()
    assert np.array_equal(g(X0), prepared().run(X0, SPAN, EVERY).x)


def test_batches_with_forces_have_the_gradients_of_each_member():
    bodies = [co.systems.rigid_body(one) for one in ((1.0, 2.0, 2.5), INERTIA)]
    systems = [body.with_forces(co.forces.LinearDamping(0.1 * m)) for m, body in enumerate(bodies, 1)]
    g = co.torch.solution(co.batch(systems), SPAN, EVERY, method=co.Splitting(), step=0.05)
    x0, rates = variable(MANY[:2]), variable([0.15, 0.3])
    (g(x0, **{"LinearDamping.rate": rates}) ** 2).sum().backward()
    for m, body in enumerate(bodies):
        damped = body.with_forces(co.forces.LinearDamping(rates[m].item()))
        sol, pullback = co.prepare(damped, co.Splitting(), 0.05).vjp(MANY[m], SPAN, EVERY)
        gradient = pullback(2 * sol.x)
        assert np.array_equal(x0.grad[m], gradient["x0"]) and rates.grad[m] == gradient["LinearDamping.rate"]


def test_gradient_is_that_of_the_pullback(g):
    wanted = prepared(INERTIA).vjp(X0, SPAN, EVERY)[1](WEIGHTS)
    x0, inertia = variable(X0), variable(INERTIA)
    (torch.tensor(WEIGHTS) * g(x0, inertia=inertia)).sum().backward()
    assert np.array_equal(x0.grad, wanted["x0"]) and np.array_equal(inertia.grad, wanted["inertia"])
    of_inertia = torch.func.grad(lambda inertia: (torch.tensor(WEIGHTS) * g(X0, inertia=inertia)).sum())
    assert np.array_equal(of_inertia(inertia.detach()), wanted["inertia"])


def test_jvp_is_that_of_the_prepared_run(g):
    wanted = prepared(INERTIA).jvp(X0, SPAN, {"inertia": X0}, EVERY)[1].x
    values, along = torch.tensor(INERTIA), torch.tensor(X0)
    assert np.array_equal(torch.func.jvp(lambda inertia: g(X0, inertia=inertia), (values,), (along,))[1], wanted)


@pytest.mark.parametrize("x0", [X0, MANY], ids=["one", "ensemble"])
def test_derivatives_agree_with_differences(x0):
    g = co.torch.solution(prepared(attitude=True), (0, 1), 20)
    arguments = variable(x0), variable(INERTIA)
    assert torch.autograd.gradcheck(lambda x0, inertia: g(x0, inertia=inertia), arguments, check_forward_ad=True)


def test_attitude_is_returned_and_differentiated():
    ready = prepared(attitude=True)
    g = co.torch.solution(ready, SPAN, EVERY)
    turned = co.integrate(co.systems.rigid_body(inertia=INERTIA), X0, (0, 1), 0.1, attitude=True).attitude[-1]
    sol, pullback = ready.vjp(X0, SPAN, EVERY, attitude=turned)
    A0 = variable(turned)
    x, A = g(X0, attitude0=A0)
    assert np.array_equal(x.detach(), sol.x) and np.array_equal(A.detach(), sol.attitude)
    A[-1, 0, 1].backward()
    weights = np.zeros(sol.attitude.shape)
    weights[-1, 0, 1] = 1.0
    assert np.array_equal(A0.grad, pullback(attitude=weights)["attitude0"])
    # Members share an attitude of shape (d, d).
    A0.grad = None
    g(MANY, attitude0=A0)[1][-1, :, 0, 1].sum().backward()
    assert A0.grad.shape == (3, 3)


@pytest.mark.parametrize(
    ("x0", "values", "error", "named"),
    [
        (X0.astype(np.float32), {}, TypeError, ("x0", "float32", "float64")),
        ("a", {}, TypeError, ("x0", "'a'")),
        (X0[:2], {}, ValueError, ("x0", "(2,)", "(3,)")),
        (X0, {"inertai": INERTIA}, ValueError, ("inertai", "inertia")),
        (X0, {"inertia": -INERTIA}, ValueError, ("inertia",)),
    ],
)
def test_wrong_arguments_are_refused(g, x0, values, error, named):
    with refused(error, *named):
        g(x0, **values)


def test_parameters_by_position_are_refused(g):
    with refused(TypeError, "co.torch.solution", "2 arguments", "x0 alone", "inertia="):
        g(X0, INERTIA)


def test_second_derivatives_are_refused(g):
    x0 = variable(X0)
    (gradient,) = torch.autograd.grad(g(x0)[-1, 0], x0, create_graph=True)
    with refused(NotImplementedError, "first derivatives"):
        gradient.sum().backward()


def test_vmap_makes_one_ensemble_and_takes_derivatives_in_turn(g):
    """Over initial states, parameters, gradients and tangents; with attitudes."""
    many, inertias = torch.tensor(MANY), torch.tensor(np.array([INERTIA, 1.1 * INERTIA]))
    assert np.array_equal(torch.func.vmap(g, out_dims=1)(many), g(many))
    by_inertia = torch.func.vmap(lambda inertia: g(X0, inertia=inertia))(inertias)
    assert np.array_equal(by_inertia[1], g(X0, inertia=inertias[1]))

    def end(x0, inertia):
        return g(x0, inertia=inertia)[-1, 0]

    slopes = torch.func.vmap(torch.func.grad(end, (0, 1)), (0, None))(many, inertias[0])
    for k, x0 in enumerate(many):
        for found, wanted in zip(slopes, torch.func.grad(end, (0, 1))(x0, inertias[0]), strict=True):
            assert np.array_equal(found[k], wanted)
    jacobian = torch.func.jacfwd(lambda x0: g(x0)[-1])(many[0])
    np.testing.assert_allclose(jacobian, torch.func.jacrev(lambda x0: g(x0)[-1])(many[0]), rtol=0, atol=1e-12)
    turned = co.torch.solution(prepared(attitude=True), (0, 1), 20)
    for found, wanted in zip(torch.func.vmap(turned, out_dims=(1, 1))(many), turned(many), strict=True):
        assert np.array_equal(found, wanted)


# Energies with params.


def weights(n):
    rng = np.random.default_rng(3)
    return {"in": rng.standard_normal((4, n)) / np.sqrt(n), "out": rng.standard_normal(4) / 2}


def network(x, params):
    return params["out"] @ torch.tanh(params["in"] @ x) + 0.5 * x @ x


def in_time(x, params, t):
    return torch.cos(t) * network(x, params)


def slopes(x, params, t=0.0):
    """The gradient of `network`, in NumPy."""
    return params["in"].T @ (params["out"] / np.cosh(params["in"] @ x) ** 2) + x


def modules(n=3):
    """A module whose energy is that of `network`, without the square."""
    made = torch.nn.Sequential(torch.nn.Linear(n, 4, bias=False), torch.nn.Tanh(), torch.nn.Linear(4, 1, bias=False))
    made = made.double()
    with torch.no_grad():
        made[0].weight.copy_(torch.tensor(weights(n)["in"]))
        made[2].weight.copy_(torch.tensor(weights(n)["out"][None]))
    return made


INVERSE = np.array([1.0, 0.5, 0.4])


def potential(params):
    piece = co.SplitHamiltonian([((3, 4, 5), co.torch.energy(network, params))])
    return co.Quadratic([*INVERSE, 0.0, 0.0, 0.0]) + piece


def split_slopes(x, params, t=0.0):
    return np.append(INVERSE * x[:3], slopes(x[3:], params))


SOLVED = {
    "function": ("so(3)", lambda params: co.torch.energy(network, params), slopes, 0, (0.0, 1.0), 1.0),
    "in time": (
        "A4,10", lambda params: 2 * co.torch.energy(in_time, params),
        lambda x, params, t: 2 * np.cos(t) * slopes(x, params), 0, (1.5, 0.5), 1.0,
    ),
    "potential": ("e(3)", potential, split_slopes, 3, (1.0, 2.0), 1.0),
    "small": ("so(3)", lambda params: scaled(params, 1e-7), slopes, 0, (0.0, 1.0), 1e-7),
    "large": ("so(3)", lambda params: scaled(params, 1e30), slopes, 0, (0.0, 1.0), 1e30),
}  # fmt: skip


def scaled(params, unit):
    return co.torch.energy(lambda x, params: unit * network(x / unit, params), params)


@pytest.mark.parametrize("name", SOLVED)
def test_states_and_gradients_of_learned_energies_are_those_of_scipy(name):
    """A direction of all parameters and of x0, by differences; both signs, backward, from other times, other units."""
    algebra, make, slopes_of, missing, ends, unit = SOLVED[name]
    algebra, sign = co.algebras.get(algebra), -1 if missing else 1
    n, rng = algebra.dim, np.random.default_rng(11)
    params, along = weights(n - missing), {key: 0.3 * np.cos(one) for key, one in weights(n - missing).items()}
    x0, v = rng.uniform(0.3, 0.8, n), rng.standard_normal(n)
    J, c = sign * np.array([algebra.structure_matrix(e) for e in np.eye(n)]), np.cos(np.arange(n))

    def end(s):
        moved = {key: params[key] + s * along[key] for key in params}

        def field(t, x):
            return np.einsum("kij,k,j->i", J, x, slopes_of(x, moved, t))

        return solve_ivp(field, ends, x0 + s * v, method="DOP853", rtol=3e-14, atol=1e-16).y[:, -1]

    system = co.LiePoissonSystem(algebra, make(params), sign=sign)
    run = co.torch.solution(system, ends, 100, method=co.GaussLegendre(3), step=0.05)

    def weighted(s):
        moved = {key: torch.tensor(params[key]) + s * torch.tensor(along[key]) for key in params}
        x = run(unit * (torch.tensor(x0) + s * torch.tensor(v)), params=moved)[-1] / unit
        return torch.tensor(c) @ x, x

    slope, x = torch.func.grad(weighted, has_aux=True)(torch.tensor(0.0, dtype=torch.float64))
    np.testing.assert_allclose(x, end(0.0), rtol=0, atol=2e-9)
    h = 3e-5
    wanted = c @ (end(h) - end(-h)) / (2 * h)
    assert abs(slope - wanted) < 1e-6 * max(1.0, abs(wanted))


def feature(y, params):
    return params["size"] * torch.cosh(y + params["shift"])


def feature_params(n, count=4):
    rng = np.random.default_rng(5)
    own = {"size": rng.uniform(-0.5, 0.5, count), "shift": rng.uniform(-1.0, 1.0, count)}
    return rng.uniform(-1.0, 1.0, (count, n)), own


@pytest.mark.parametrize(
    ("algebra", "sign", "ends"), [("so(3)", -1, (0.0, 1.0)), ("e(3)", 1, (1.5, 0.5)), ("A4,10", -1, (0.0, 1.0))]
)
def test_explicit_steps_of_features_are_those_of_scipy_with_every_casimir(algebra, sign, ends):
    """States, and a slope along all parameters and x0, of a multiple; both signs, backward, from other times."""
    algebra, rng = co.algebras.get(algebra), np.random.default_rng(11)
    n, (directions, own) = algebra.dim, feature_params(algebra.dim)
    x0, v, along, c = rng.uniform(0.3, 0.8, n), rng.standard_normal(n), np.cos(directions), np.cos(np.arange(n))
    J = sign * np.array([algebra.structure_matrix(e) for e in np.eye(n)])

    def end(s):
        a, sizes = directions + s * along, own["size"] + 0.3 * s

        def field(t, x):
            return 2.0 * np.einsum("kij,k,j->i", J, x, (sizes * np.sinh(a @ x + own["shift"])) @ a)

        return solve_ivp(field, ends, x0 + s * v, method="DOP853", rtol=3e-14, atol=1e-16).y[:, -1]

    system = co.LiePoissonSystem(algebra, 2 * co.torch.features(feature, directions, own), sign=sign)
    run = co.torch.solution(system, ends, 20, method=co.Splitting(order=6), step=0.05)

    def weighted(s):
        params = torch.tensor(directions) + s * torch.tensor(along), {
            "size": torch.tensor(own["size"]) + 0.3 * s, "shift": torch.tensor(own["shift"])
        }  # fmt: skip
        x = run(torch.tensor(x0) + s * torch.tensor(v), params=params)[-1]
        return torch.tensor(c) @ x, x

    slope, x = torch.func.grad(weighted, has_aux=True)(torch.tensor(0.0, dtype=torch.float64))
    np.testing.assert_allclose(x, end(0.0), rtol=0, atol=2e-8)
    h = 3e-5
    wanted = c @ (end(h) - end(-h)) / (2 * h)
    assert abs(slope - wanted) < 1e-6 * max(1.0, abs(wanted))
    for casimir in system.casimirs.values():
        assert abs(casimir(x.numpy()) - casimir(x0)) < 1e-13 * max(1.0, abs(casimir(x0)))


def test_features_have_ensembles_output_times_and_gradients_of_modules():
    """The run of Gauss stages with the same energy; `vmap`, backward by directions, and times between steps."""
    directions, own = feature_params(3)
    system = co.LiePoissonSystem(co.algebras.so(3), co.torch.features(feature, directions, own), sign=-1)
    t_eval = [0.5, 0.73, 1.49]
    run = co.torch.solution(system, (0.5, 1.5), method=co.Splitting(order=6), step=0.05, t_eval=t_eval)
    wanted = co.integrate(system, MANY, (0.5, 1.5), 0.05, co.GaussLegendre(4), t_eval=t_eval).x
    many, a = torch.tensor(MANY), variable(directions)
    np.testing.assert_allclose(run(many), wanted, rtol=0, atol=1e-6)
    np.testing.assert_allclose(torch.func.vmap(run, out_dims=1)(many), run(many), rtol=0, atol=1e-14)
    params = {name: torch.tensor(one) for name, one in own.items()}
    run(many, params=(a, params))[-1].sum().backward()
    each = torch.func.vmap(torch.func.grad(lambda a, x0: run(x0, params=(a, params))[-1].sum()), (None, 0))
    np.testing.assert_allclose(a.grad, each(a.detach(), many).sum(0), rtol=1e-12, atol=1e-12)


def learned_run(**options):
    system = co.LiePoissonSystem(co.algebras.so(3), co.torch.energy(modules()) + co.Quadratic(INVERSE), sign=-1)
    given = {"method": co.GaussLegendre(2), "step": 0.25, "save_every": 2, **options}
    return co.torch.solution(system, (0.5, 1.5), **given), system


def test_modules_are_those_of_compiled_runs_and_of_functions():
    """States of `integrate`; gradients in place, by torch.func, by vmap; other modules, members and times of output."""
    run, system = learned_run()
    many = torch.tensor(MANY)
    wanted = co.integrate(system, MANY, (0.5, 1.5), 0.25, co.GaussLegendre(2), save_every=2).x
    np.testing.assert_allclose(run(many), wanted, rtol=0, atol=1e-14)
    np.testing.assert_allclose(torch.func.vmap(run, out_dims=1)(many), wanted, rtol=0, atol=1e-14)
    at, t_eval = learned_run(t_eval=[0.5, 0.73, 1.0, 1.49], save_every=1)[0](X0), [0.5, 0.73, 1.0, 1.49]
    moments = co.integrate(system, X0, (0.5, 1.5), 0.25, co.GaussLegendre(2), t_eval=t_eval).x
    np.testing.assert_allclose(at, moments, rtol=0, atol=1e-14)
    module = modules()
    run(many, params=dict(module.named_parameters()))[-1].sum().backward()
    params = {name: one.detach() for name, one in module.named_parameters()}
    each = torch.func.vmap(torch.func.grad(lambda params, x0: run(x0, params=params)[-1].sum()), (None, 0))(
        params, many
    )
    for name, one in module.named_parameters():
        np.testing.assert_allclose(one.grad, each[name].sum(0), rtol=0, atol=1e-14)


def test_times_between_steps_have_the_moments_of_the_run():
    """An energy that depends on time, in partial steps that begin at other times than the run."""
    system = co.LiePoissonSystem(co.algebras.so(3), co.torch.energy(in_time, weights(3)))
    arguments, t_eval = {"method": co.GaussLegendre(2), "step": 0.25}, [0.5, 0.73, 1.0, 1.49]
    found = co.torch.solution(system, (0.5, 1.5), t_eval=t_eval, **arguments)(X0)
    wanted = co.integrate(system, X0, (0.5, 1.5), t_eval=t_eval, **arguments).x
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-14)


def test_the_parameters_of_a_system_are_a_copy():
    module = modules()
    params = dict(module.named_parameters())
    tensors = {name: one.detach().clone() for name, one in params.items()}
    systems = [
        co.LiePoissonSystem(co.algebras.so(3), H)
        for H in (co.torch.energy(module), co.torch.energy(lambda x, p: module_of(p, x), tensors))
    ]
    before = [system.energy(X0) for system in systems]
    runs = [co.torch.solution(one, (0, 1), method=co.GaussLegendre(1), step=0.25) for one in systems]
    states = [run(X0) for run in runs]
    with torch.no_grad():
        module[0].weight.mul_(2.0)
        tensors["0.weight"].mul_(2.0)
    for run, system, energy, x in zip(runs, systems, before, states, strict=True):
        assert system.energy(X0) == energy and np.array_equal(run(X0), x)
        assert not np.allclose(run(X0, params=params).detach(), x)


def test_the_directions_and_parameters_of_features_are_a_copy():
    directions, size = torch.eye(3, dtype=torch.float64), torch.ones(3, dtype=torch.float64)
    energy = co.torch.features(lambda y, size: size * torch.cos(y), directions, size)
    system, expected = co.LiePoissonSystem(co.algebras.so(3), energy), np.cos(X0).sum()
    directions.mul_(2.0)
    size.mul_(3.0)
    assert abs(system.energy(X0) - expected) < 1e-15 * len(X0)


def test_parameters_given_unchanged_beside_changed_ones_have_gradients():
    """Those of the system with the changed values, prepared."""
    body, method = co.systems.rigid_body((1.0, 2.0, 3.0)), co.Splitting()
    damped = [body.with_forces(co.forces.LinearDamping(rate)) for rate in (0.2, 0.3)]
    given = {"inertia": [1.0, 2.0, 3.0], "LinearDamping.rate": 0.3}
    tensors = {name: torch.tensor(one, dtype=torch.float64, requires_grad=True) for name, one in given.items()}
    co.torch.solution(damped[0], (0, 1), method=method, step=0.1)(X0, **tensors).sum().backward()
    sol, pullback = co.prepare(damped[1], method, 0.1).vjp(X0, (0, 1))
    expected = pullback(x=np.ones_like(sol.x))
    for name, one in tensors.items():
        np.testing.assert_allclose(one.grad, expected[name], rtol=1e-12)


def module_of(params, x):
    """The energy of `modules` as a function of its parameters."""
    return (params["2.weight"] @ torch.tanh(params["0.weight"] @ x)).sum()


def test_derivatives_of_learned_runs_of_every_order_are_differences():
    run, _ = learned_run(step=0.5, save_every=1)
    x0 = torch.tensor(X0)
    assert torch.autograd.gradcheck(run, (variable(X0),), check_forward_ad=True)
    assert torch.autograd.gradgradcheck(lambda x0: run(x0)[-1], (variable(X0),))
    second, forward = (torch.func.jacrev(torch.func.grad(end_of(run))), torch.func.hessian(end_of(run)))
    np.testing.assert_allclose(forward(x0), second(x0), rtol=0, atol=1e-14)
    h, e = 1e-4, torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    difference = (second(x0 + h * e) - second(x0 - h * e)) / (2 * h)
    np.testing.assert_allclose(torch.func.jacrev(second)(x0)[..., 1], difference, rtol=0, atol=1e-7)


def end_of(run):
    return lambda x0: run(x0)[-1, 0]


def test_casimirs_stay_and_steps_without_stages_are_nan():
    run, _ = learned_run()
    np.testing.assert_allclose((run(MANY) ** 2).sum(-1)[-1], (MANY**2).sum(-1), rtol=1e-14)
    many, params = torch.tensor(np.array([X0, X0, 1e4 * X0])), dict(modules().named_parameters())
    with pytest.warns(co.LargeStepWarning, match="of member 2 are NaN from t = 1 on"):
        found = run(many, params=params)
    assert found[-1, :2].isfinite().all() and found[-1, 2].isnan().all()
    by_vmap = torch.func.vmap(lambda x0: run(x0, params=params), out_dims=1)  # whose numbers are not known: no warning
    assert torch.equal(by_vmap(many).isnan(), found.isnan())


def test_first_runs_warn_of_a_large_step():
    """At the params of the system, given or not; not at others, of slow motions and of features."""
    params = torch.tensor([1.0, 0.5, 0.4], dtype=torch.float64)
    system = co.LiePoissonSystem(co.algebras.so(3), co.torch.energy(lambda x, params: x @ (params * x) / 2, params))
    for given in ({}, {"params": params}):
        run, slow = (co.torch.solution(system, (0, 80), method=co.GaussLegendre(1), step=2.0) for _ in range(2))
        with warnings.catch_warnings():
            warnings.simplefilter("error", co.LargeStepWarning)
            run(MANY[:1], params=1.01 * params)
            slow(2.0**-6 * X0)
            with pytest.warns(co.LargeStepWarning, match="the step 2 is too large"):
                run(MANY[:1], **given)
            run(MANY[:1], **given)
    explicit = body(co.torch.features(feature, *feature_params(3)), method=co.Splitting(), step=1.0)
    torch.testing.assert_close((explicit(X0) ** 2).sum(1), torch.full((2,), X0 @ X0, dtype=torch.float64))


def test_stages_of_large_weights_that_cancel_converge_to_their_roundoff():
    """Pairs of units whose outputs differ by one: the states of the compiled run."""
    size, rng = 1e4, np.random.default_rng(2)
    first, turned = rng.standard_normal((2, 2, 3))
    w = {"in": np.concatenate([first, first + turned / size]), "out": size * np.array([1.0, 1.0, -1.0, -1.0])}
    system = co.LiePoissonSystem(co.algebras.so(3), co.torch.energy(network, w), sign=-1)
    arguments = {"method": co.GaussLegendre(2), "step": 0.1}
    found = co.torch.solution(system, (0, 1), **arguments)(MANY)
    # Ten steps of forces of the size of the weights, each of which is rounded some ten times.
    allowed = 100 * size * 2.0**-53
    np.testing.assert_allclose(found, co.integrate(system, MANY, (0, 1), **arguments).x, rtol=0, atol=allowed)


ACTIVATIONS = {
    "tanh": torch.tanh,
    "sin": torch.sin,
    "relu": torch.relu,
    "gelu": torch.nn.functional.gelu,
    "softmax": lambda y: torch.softmax(y, 0),
    "bump": lambda y: torch.exp(-(y**2)),
}


def layer(units, w):
    """An energy and a torque of one layer of units."""

    def energy(x, w):
        return w["out"] @ units(w["in"] @ x + w["shift"])

    def torque(x, w):
        return w["in"].T @ (w["out"] * units(w["in"] @ x + w["shift"]))

    return co.torch.energy(energy, w), co.torch.torque(torque, w)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_right_functions_are_not_refused(name):
    """Slow and fast units, kinks, saturation; small and large outputs; pairs of units that cancel."""
    for size, output in itertools.product([1e-3, 1.0, 1e2, 1e5], [1e-8, 1.0, 1e8]):
        rng = np.random.default_rng(4)
        w = {"in": size * rng.standard_normal((8, 3)), "shift": rng.standard_normal(8)}
        w["out"] = output * rng.standard_normal(8)
        pairs = {"in": np.concatenate([w["in"], w["in"] * (1.0 + 1e-10)]), "shift": np.tile(w["shift"], 2)}
        pairs["out"] = np.concatenate([w["out"], -w["out"]])
        for one in (w, pairs):
            H, torque = layer(ACTIVATIONS[name], one)
            system = co.LiePoissonSystem(co.algebras.so(3), H).with_forces(torque)
            slope = system.hamiltonian.gradient(X0)
            assert np.isfinite(slope).all() and len(system.forces) == 1


def test_saturated_units_have_the_motion_of_their_slopes():
    """The slopes of saturated units, 1 - tanh^2, have few digits, and so do differences of them."""
    w = {"in": np.ones((4, 3)), "out": np.ones(4)}
    system = co.LiePoissonSystem(co.algebras.so(3), co.torch.energy(lambda x, p: p["out"] @ torch.tanh(p["in"] @ x), w))
    x0 = np.array([0.3, -0.2, 0.1])
    rate = 4.0 / np.cosh(x0.sum()) ** 2  # a turn about (1, 1, 1), of the angle rate * sqrt(3) in a unit of time
    x = co.torch.solution(system, (0, 1), method=co.GaussLegendre(4), step=0.025)(x0)[-1]
    axis = np.cross(np.ones(3), np.eye(3)).T * rate
    np.testing.assert_allclose(x, expm(axis) @ x0, rtol=0, atol=1e-12)


def body(H, **options):
    return co.torch.solution(
        co.LiePoissonSystem(co.algebras.so(3), H), (0, 1), **{"method": co.GaussLegendre(1), "step": 0.1, **options}
    )


def root(x, params):
    return params @ x.abs() ** 0.5


def partly_without_grad(x, params):
    with torch.no_grad():
        size = torch.linalg.norm(x)
    return params @ x + size


def with_dropout():
    """A module as it is made: in training."""
    return torch.nn.Sequential(torch.nn.Linear(3, 8), torch.nn.Dropout(0.5), torch.nn.Linear(8, 1)).double()


def test_modules_keep_the_mode_they_had():
    """Dropout that was off stays off after train(), in runs of PyTorch and compiled ones; one part is used twice."""
    net = with_dropout().eval()
    module = torch.nn.Sequential(net[0], net[1], net[2], torch.nn.Linear(1, 3), net).double()
    system = co.LiePoissonSystem(co.algebras.so(3), co.torch.energy(module))
    run, params = (
        co.torch.solution(system, (0, 0.5), method=co.GaussLegendre(1), step=0.1),
        dict(module.named_parameters()),
    )
    before = run(X0, params=params), co.integrate(system, X0, (0, 0.5), 0.1, co.GaussLegendre(1)).x
    module.train()
    after = run(X0, params=params), co.integrate(system, X0, (0, 0.5), 0.1, co.GaussLegendre(1)).x
    assert module.training and net[1].training and torch.equal(before[0], after[0])
    np.testing.assert_array_equal(before[1], after[1])
    after[0][-1, 0].backward()
    assert all(one.grad is not None for one in module.parameters())


LEARNED = {
    "no params": (lambda: co.torch.energy(network), TypeError, ["without params"]),
    "params, x": (lambda: co.torch.energy(lambda params, x: x[0], {}), TypeError, ["(x, params)", "this order"]),
    "float32": (lambda: co.torch.energy(torch.nn.Linear(3, 1)), TypeError, ["weight", "float32", "module.double()"]),
    "text": (lambda: co.torch.energy(network, {"in": "abc"}), TypeError, ["params['in']", "abc"]),
    "vector": (lambda: body(co.torch.energy(lambda x, params: x, {})), ValueError, ["(3,)", "one number"]),
    "detach": (
        lambda: body(co.torch.energy(lambda x, p: x[0] ** 2 + p @ x * x.detach()[1], X0)), ValueError,
        ["gradient contradicts value", "detach"],
    ),
    "no_grad": (lambda: body(co.torch.energy(partly_without_grad, X0)), ValueError, ["contradicts", "no_grad"]),
    "detached feature": (
        lambda: body(co.torch.features(lambda y, p: p["size"] * y * y.detach(), *feature_params(3))), ValueError,
        ["contradicts", "detach"],
    ),
    "dropout": (lambda: body(co.torch.energy(with_dropout())), ValueError, ["random", "eval()", "dropout"]),
    "module": (lambda: body(torch.nn.Linear(3, 1)), TypeError, ["module of PyTorch", "co.torch.energy"]),
    "plain": (lambda: body(lambda x: torch.as_tensor(x).sum()), TypeError, ["co.torch.energy"]),
    "shape": (lambda: learned_run()[0](X0[:2]), ValueError, ["(2,)", "(3,)"]),
    "module as params": (
        lambda: learned_run()[0](X0, params=modules()), TypeError, ["is a module", "dict(module.named_parameters())"]
    ),
    "other shape": (
        lambda: learned_run()[0](X0, params=dict(modules(4).named_parameters())), ValueError,
        ["params['0.weight']", "(4, 4)", "(4, 3)"],
    ),
    "structure": (
        lambda: learned_run()[0](X0, params=modules().state_dict()), ValueError,
        ["structure", "0.weight", "dict(module.named_parameters())"],
    ),
    "position": (lambda: learned_run()[0](X0, {}), TypeError, ["2 arguments", "params="]),
    "no energy": (lambda: co.torch.solution(prepared(), (0, 1))(X0, params={}), ValueError, ["co.torch.energy"]),
    "no step": (lambda: body(co.torch.energy(modules()), step=None), TypeError, ["step="]),
    "own step": (lambda: co.torch.solution(prepared(), (0, 1), step=0.1), TypeError, ["prepared run", "omit"]),
    "own method": (
        lambda: co.torch.solution(prepared(), (0, 1), method=co.Splitting()), TypeError, ["prepared run", "omit"]
    ),
    "parts": (lambda: body(co.torch.energy(modules()), method=co.Splitting()), TypeError, ["take", "GaussLegendre"]),
    "directions": (lambda: co.torch.features(feature, X0, {}), ValueError, ["(3,)", "(features, n)"]),
    "axis": (lambda: co.torch.features(feature, np.eye(3), {"size": X0[:2]}), ValueError, ["['size']", "3 features"]),
    "coordinates": (lambda: body(co.torch.features(feature, *feature_params(4))), ValueError, ["4 coordinates", "3"]),
    "two numbers": (
        lambda: body(co.torch.features(lambda y, p: torch.stack([y, y]), np.eye(3), {})), ValueError, ["(2,)", "number"]
    ),
    "module of features": (
        lambda: co.torch.features(torch.nn.Linear(1, 1), np.eye(3), {}), TypeError, ["Linear", "f(y, params)"]
    ),
    "energy of JAX": (
        lambda: co.torch.solution(co.systems.rigid_body(INERTIA), (0, 1), method=co.Splitting(), step=0.1)(
            X0, params={}
        ), ValueError, ["params of PyTorch", "co.torch.energy"],
    ),
    "compensated": (
        lambda: body(
            co.torch.features(feature, *feature_params(3)), method=co.Splitting(order=4, compensated=True)
        ), TypeError, ["compensated=False"],
    ),
    "attitude": (
        lambda: co.torch.solution(co.prepare(learned_run()[1], co.GaussLegendre(1), 0.1, attitude=True), (0, 1)),
        TypeError, ["attitudes", "batches"],
    ),
    "kink": (
        lambda: body(co.torch.energy(root, np.ones(3)))([[0.1, 0.2, 0.3], [0.0, 0.5, 1.0]]), ValueError,
        ["x0[1]", "[0.0, 0.5, 1.0]", "gradient", "co.torch.energy"],
    ),
    "integrate": (
        lambda: torch.func.vmap(lambda x0: co.integrate(prepared().system, x0, (0, 1), 0.1).x)(torch.tensor(MANY)),
        TypeError, ["x0", "co.torch"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LEARNED)
def test_energies_that_cannot_be_used_are_refused(name):
    call, error, named = LEARNED[name]
    with refused(error, *named):
        call()


def test_examples_of_the_page_run():
    section = PAGE.read_text(encoding="utf-8").partition("## PyTorch\n")[2].partition("\n## ")[0]
    names = {"co": co}
    for example in re.findall(r"```python\n(.*?)```", section, re.DOTALL):
        exec(example, names)
    assert names["loss"] > 0.0
