"""Forces with parameters in runs of PyTorch: the numbers of JAX, of the compiled loops, and of SciPy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from refusals import refused

torch = pytest.importorskip("torch")
get = co.algebras.get
X0 = np.array([[0.3, 0.8, 0.5], [0.6, -0.2, 0.4]])


def parameters(n, seed=3):
    rng = np.random.default_rng(seed)
    return {
        "form": rng.uniform(0.3, 1.0, n),
        "root": 0.3 * rng.standard_normal((n, 2)),
        "rate": np.array(0.35),
        "in": rng.standard_normal((n, n)) / np.sqrt(n),
    }


def learned(library, xp, algebra, params, *others):
    """A system whose energy, damping and torque have params; numbers of NumPy are converted by each library."""

    def energy(x, p):
        return (p["form"] * x**2).sum() / 2 + xp.sin(p["in"][0] @ x)

    def root(x, p, t):
        return (1.0 + 0.3 * xp.sin(x[0] + t)) * p["root"]

    def drag(x, p, t):
        return -p["rate"] * xp.cos(t) * x + 0.1 * xp.tanh(p["in"] @ x)

    forces = library.double_bracket(root, params), library.torque(drag, params)
    system = co.LiePoissonSystem(get(algebra), library.energy(energy, params), sign=-1)
    return system.with_forces(*forces, *others)


def in_torch(params):
    return {name: torch.tensor(one) for name, one in params.items()}


ALONG_X = [co.Polynomial({(1, 0, 0): 0.2}), co.Polynomial({(0, 0, 1): 0.1})]
BESIDE = {
    "nothing": (),
    "matrix of rates": (co.forces.LinearDamping(0.2 * np.eye(3) + 0.05, toward=(0.1, 0.0, 0.2)),),
    "closed forms": (
        co.forces.DoubleBracketDamping(0.1), co.forces.Torque((0.1, 0.0, 0.2)), co.forces.LinearDamping(0.1),
        co.forces.Torque(lambda t: np.array([np.cos(t), 0.0, 0.0])),
    ),
    "bath": (co.forces.HeatBath(0.1, temperature=0.2, seed=4),),
    "noise": (co.forces.HamiltonianNoise(ALONG_X, seed=4, levels=1),),
}  # fmt: skip


@pytest.mark.parametrize("order", [1, -1], ids=["given", "reversed"])
@pytest.mark.parametrize("name", BESIDE)
def test_runs_are_those_of_compiled_loops_of_one_and_many_members_by_vmap(name, order):
    """Each force beside each of the others, in both orders, from a time other than zero; backward without noise."""
    system = learned(co.torch, torch, "so(3)", in_torch(parameters(3)), *BESIDE[name])
    system = system.unforced.with_forces(*system.forces[::order])
    spans = [(0.5, 1.5)] if system.has_noise else [(0.5, 1.5), (1.5, 0.5)]
    for span in spans:
        run = co.torch.solution(system, span, 2, method=co.GaussLegendre(2), step=0.25)
        wanted = co.integrate(system, X0, span, 0.25, co.GaussLegendre(2), save_every=2).x
        np.testing.assert_allclose(run(X0), wanted, rtol=0, atol=1e-13)
        by_vmap = torch.func.vmap(run, out_dims=1)(torch.tensor(X0))
        np.testing.assert_allclose(by_vmap, wanted, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    "method", [co.GaussLegendre(2), co.methods.even_order(co.GaussLegendre(1), 6)], ids=["noise", "order 6"]
)
def test_thermal_noise_and_torques_in_time_are_those_of_compiled_loops(method):
    """Beside a kinetic energy, where the method takes noise; of order six the torque is extrapolated."""
    drag = co.torch.torque(lambda x, p, t: -p * torch.cos(3.0 * t) * x, np.array(0.4))
    thermal = co.forces.Langevin((0.1, 0.2, 0.3), temperature=0.2, seed=4)
    system = co.systems.rigid_body((1.0, 2.0, 3.0)).with_forces(*[thermal] * (method.order < 6), drag)
    found = co.torch.solution(system, (0.5, 1.5), method=method, step=0.25)(X0)
    wanted = co.integrate(system, X0, (0.5, 1.5), 0.25, method).x
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("algebra", "name"), [("so(3)", "bath"), ("so(3)", "nothing"), ("A4,10", "nothing")])
def test_states_and_gradients_are_those_of_jax(algebra, name):
    """By params and x0, without a closed form of the exponential too; and at times between steps."""
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    n, params = get(algebra).dim, parameters(get(algebra).dim)
    x0, c = np.random.default_rng(2).uniform(0.3, 0.8, (2, n)), np.cos(np.arange(n))
    given = {"method": co.GaussLegendre(2), "step": 0.25}
    if name != "bath":
        given["t_eval"] = [0.5, 0.9, 1.25]
    of_jax = co.jax.solution(learned(co.jax, jax.numpy, algebra, params, *BESIDE[name]), (0.5, 1.5), **given)
    tensors = in_torch(params)
    run = co.torch.solution(learned(co.torch, torch, algebra, tensors, *BESIDE[name]), (0.5, 1.5), **given)

    def end(x, p):
        return (run(x, params=p)[-1] @ torch.tensor(c)).sum()

    np.testing.assert_allclose(run(x0), of_jax(x0), rtol=0, atol=1e-14)
    found = torch.func.grad(end, (0, 1))(torch.tensor(x0), tensors)
    wanted = jax.grad(lambda x, p: (of_jax(x, params=p)[-1] @ c).sum(), (0, 1))(x0, params)
    jax.config.update("jax_enable_x64", False)
    np.testing.assert_allclose(found[0], wanted[0], rtol=0, atol=1e-13)
    for key in params:
        np.testing.assert_allclose(found[1][key], wanted[1][key], rtol=0, atol=1e-13)
    each = torch.func.vmap(torch.func.grad(end, 1), (0, None))(torch.tensor(x0), tensors)
    if name != "bath":  # whose members have noise of their own, and runs of single states that of the first one
        for key in params:
            np.testing.assert_allclose(each[key].sum(0), found[1][key], rtol=0, atol=1e-13)


def test_the_motion_is_that_of_scipy_and_keeps_its_casimir():
    """By features in explicit steps of order four, and by Gauss methods; gradients in place, of a module."""
    rng = np.random.default_rng(5)
    params = torch.tensor(rng.uniform(-1, 1, (4, 3))), {"size": torch.tensor(rng.uniform(-0.5, 0.5, 4))}
    H = co.torch.features(lambda y, p: p["size"] * torch.cosh(y), *params)
    damping = co.torch.double_bracket(lambda x, p: p[1]["size"].sum() * (1.0 + x**2), params)
    system = co.LiePoissonSystem(get("so(3)"), H, sign=-1).with_forces(damping)
    a, size, x0 = params[0].numpy(), params[1]["size"].numpy(), X0[0]

    def field(t, x):
        f = np.cross(x, (size * np.sinh(a @ x)) @ a)
        return f + np.cross(x, (size.sum() * (1.0 + x**2)) ** 2 * f)

    wanted = solve_ivp(field, (0, 2), x0, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    for method in (co.Splitting(order=4), co.methods.even_order(co.GaussLegendre(1), 4)):
        x = co.torch.solution(system, (0, 2), method=method, step=0.05)(x0)
        np.testing.assert_allclose(x[-1], wanted, rtol=0, atol=1e-5)  # h^4, of substeps that are longer than a step
        np.testing.assert_allclose((x**2).sum(-1), x0 @ x0, rtol=1e-13)
    module = torch.nn.Linear(3, 3, bias=False).double()
    body = co.systems.rigid_body((1.0, 2.0, 3.0)).with_forces(co.torch.torque(module))
    run = co.torch.solution(body, (0, 1), method=co.GaussLegendre(1), step=0.25)
    run(x0, params=dict(module.named_parameters()))[-1, 0].backward()
    sol, pullback = co.prepare(body, co.GaussLegendre(1), 0.25).vjp(x0, (0, 1))
    np.testing.assert_allclose(run(x0).detach(), sol.x, rtol=0, atol=1e-14)
    start = torch.tensor(x0, requires_grad=True)
    run(start)[-1, 0].backward()
    weights = np.zeros(sol.x.shape)
    weights[-1, 0] = 1.0
    np.testing.assert_allclose(start.grad, pullback(weights)["x0"], rtol=0, atol=1e-13)
    h, W = 1e-6, {"weight": module.weight.detach()}
    ends = [run(x0, params={"weight": W["weight"] + s * h * torch.eye(3).double()})[-1, 0] for s in (1, -1)]
    assert abs(torch.trace(module.weight.grad) - (ends[0] - ends[1]) / (2 * h)) < 1e-8


def torque(**options):
    return co.torch.torque(lambda x, p: -p * x, np.array(0.1), **options)


def run_of(*forces, system=None, method=None, **options):
    damped = (system or co.systems.rigid_body((1.0, 2.0, 3.0))).with_forces(*forces)
    return co.torch.solution(damped, (0, 1), method=method or co.GaussLegendre(1), step=0.1, **options)


REFUSED = {
    "no function": (lambda: co.torch.torque(3.0, {}), TypeError, ["co.torch.torque", "N(x, params)"]),
    "no params": (lambda: co.torch.double_bracket(lambda x, p: x), TypeError, ["co.torch.double_bracket", "params"]),
    "shape": (lambda: run_of(co.torch.torque(lambda x, p: x[:2], {})), ValueError, ["(2,)", "(3,)"]),
    "root": (lambda: run_of(co.torch.double_bracket(lambda x, p: x[:2], {})), ValueError, ["(2,)", "(3, k)"]),
    "fails": (lambda: run_of(co.torch.torque(lambda x, p: p @ x, np.ones(2))), TypeError, ["torque", "PyTorch"]),
    "float32": (lambda: run_of(co.torch.torque(lambda x, p: x.float(), {})), TypeError, ["float32", "float64"]),
    "detach": (
        lambda: run_of(co.torch.torque(lambda x, p: -p * x.detach().norm() * x, np.array(0.1))), ValueError,
        ["torque", "contradicts", "detach"],
    ),
    "detached root": (
        lambda: run_of(co.torch.double_bracket(lambda x, p: p * x.detach() + x, np.array(0.1))), ValueError,
        ["root", "contradicts", "detach"],
    ),
    "random": (
        lambda: run_of(co.torch.torque(lambda x, p: -p * x * torch.rand(3).double(), np.array(0.1))), ValueError,
        ["torque", "random"],
    ),
    "axis": (lambda: run_of(torque(), system=co.systems.heavy_top()), ValueError, ["direction"]),
    "matrices": (lambda: run_of(torque(), system=co.systems.sphere_euler(N=4)), TypeError, ["co.torch.torque"]),
    "other params": (
        lambda: run_of(torque(), co.torch.double_bracket(lambda x, p: p, np.array(0.2))), TypeError,
        ["co.torch.torque", "co.torch.double_bracket", "one tree"],
    ),
    "splitting": (lambda: run_of(torque(), method=co.Splitting()), TypeError, ["GaussLegendre", "Splitting"]),
    "function of NumPy": (
        lambda: run_of(torque(), co.forces.Torque(lambda x: -x)), TypeError, ["Torque", "NumPy", "co.torch.torque"]
    ),
    "flow of NumPy": (
        lambda: run_of(torque(), co.forces.OwnForce(lambda x, t, tau: x * np.exp(-tau))), TypeError,
        ["own force", "NumPy", "co.jax"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_used_is_refused(name):
    call, error, named = REFUSED[name]
    with refused(error, *named):
        call()


def test_forces_of_the_other_library_are_refused_by_their_name():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    of_jax = co.jax.torque(lambda x, p: -p * x, np.array(0.1))
    with refused(TypeError, "co.jax.torque", "PyTorch"):
        run_of(torque(), of_jax)
    body = co.systems.rigid_body((1.0, 2.0, 3.0)).with_forces(torque(), of_jax)
    with refused(TypeError, "co.torch.torque", "JAX"):
        co.jax.solution(body, (0, 1), method=co.Splitting(), step=0.1)
    jax.config.update("jax_enable_x64", False)
