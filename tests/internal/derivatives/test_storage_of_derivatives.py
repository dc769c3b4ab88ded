"""How derivatives store the run: segments and checkpoints; and how often JAX runs it."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs.derivatives import differentiable_run, segments
from rounding import UNIT_ROUNDOFF

H, X6 = 0.125, np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])
BODY = co.systems.rigid_body((1, 2, 3))
TOP = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.1, 0.2, 1.0))


@pytest.mark.parametrize(
    "method", [co.Splitting(order=4), co.Splitting(compensated=True), co.GaussLegendre(2)], ids=str
)
@pytest.mark.parametrize("members", [None, 3])
def test_gradients_do_not_depend_on_segments(method, members, monkeypatch):
    """Up to round-off: joined flows are separate where the added part is between them."""
    ready = co.prepare(TOP, method, H, attitude="coadjoint")
    x0 = X6 if members is None else X6 * np.linspace(1.0, 0.7, members)[:, None]
    found = []
    for numbers in (2**15, 42, 3 * 42):
        monkeypatch.setattr(differentiable_run, "STEPS_OF_SEGMENT", 1)
        monkeypatch.setattr(differentiable_run, "NUMBERS_OF_SEGMENT", numbers)
        sol, pullback = ready.vjp(x0, (1.5, 0.5), t_eval=[1.5, 1.4, 1.0, 0.51])
        found.append(pullback(np.ones(sol.x.shape), attitude=np.ones(sol.attitude.shape), energy=sol.energy))
    for name, value in found[0].items():
        for other in found[1:]:
            np.testing.assert_allclose(other[name], value, rtol=0, atol=2.0**10 * UNIT_ROUNDOFF * np.abs(value).max())


def test_number_of_checkpoints_is_bounded(monkeypatch):
    """Of 48 bytes each, for the momentum and what its sums have lost; of large systems each has several steps."""
    ready, x0 = co.prepare(BODY, co.Splitting(), H), [0.3, 1.0, 0.2]
    lattice = co.systems.spin_lattice("chain", 100)
    large, steps, x1 = co.prepare(lattice, co.Splitting(), 0.01), 40, np.random.default_rng(0).standard_normal(300)
    gradients = {}
    for numbers in (2**15, 1):
        monkeypatch.setattr(differentiable_run, "NUMBERS_OF_SEGMENT", numbers)
        sol, pullback = large.vjp(x1, (0.0, 0.01 * steps), save_every=steps)
        lengths = [one.k1 - one.k0 for one in pullback._gradient.args[1].segments]
        assert lengths == ([40] if numbers > 1 else [16, 16, 8])
        gradients[numbers] = pullback(np.ones(sol.x.shape))["x0"]
    assert np.array_equal(gradients[1], gradients[2**15])
    monkeypatch.setattr(differentiable_run, "STEPS_OF_SEGMENT", 1)
    monkeypatch.setattr(differentiable_run, "NUMBERS_OF_SEGMENT", 3)
    for size, count in ((2**25, 1000), (4800, 100)):
        monkeypatch.setattr(differentiable_run, "BYTES_OF_CHECKPOINTS", size)
        assert len(ready.vjp(x0, (0.0, 1000 * H), 1000)[1]._gradient.args[1].segments) == count
    # A thousand steps of their own lengths store about a kilobyte each.
    ready = co.prepare(BODY, co.ReversibleSteps(co.Splitting(), 0.1), 300.0, attitude=True)
    assert len(ready.vjp(x0, (0.0, 300.0))[1]._gradient.args[1].segments) > 1024


@pytest.mark.parametrize("system", [BODY, BODY.with_forces(co.forces.LinearDamping(0.1))], ids=["alone", "forced"])
def test_equations_of_derivatives_that_are_not_solved_raise_integration_errors(system, monkeypatch):
    """At the time of the segment."""
    monkeypatch.setattr(segments, "advance_tables", lambda *_: False)
    x0 = np.array([0.3, 1.0, 0.2])
    ready = co.prepare(system, co.GaussLegendre(2), 0.125)
    _, pullback = ready.vjp(x0, (1.0, 1.25))
    for call in (lambda: ready.jvp(x0, (1.0, 1.25), {"x0": x0}), lambda: pullback(np.ones((3, 3)))):
        with pytest.raises(co.IntegrationError, match=r"smaller step than 0\.125") as raised:
            call()
        assert raised.value.time == 1.25


@pytest.fixture
def jax():
    jax = pytest.importorskip("jax")
    jax.config.update("jax_enable_x64", True)
    yield jax
    jax.config.update("jax_enable_x64", False)


def test_transformations_of_jax_run_once(jax, monkeypatch):
    """Members of vmap are one ensemble; a step of a fit prepares once, and keeps copies of its parameters."""
    from coadjoint.runs.derivatives import parametrized_run

    kind, made = parametrized_run.ParametrizedRun, []
    x0, several, weights = np.array([1.0, 0.2, 0.5]), np.ones((2, 4, 3)), np.cos(np.arange(15.0)).reshape(5, 3)
    inertia = np.array([1.1, 2.0, 2.4])
    ready = co.prepare(BODY, co.Splitting(order=4), 0.05)
    f = co.jax.solution(ready, (0, 10), 50)
    for name in ("solve", "gradients", "tangents"):
        real = getattr(kind, name)
        monkeypatch.setattr(
            kind, name, lambda run, v, *rest, n=name, r=real: made.append((n, v["x0"].shape)) or r(run, v, *rest)
        )
    jax.vmap(f)(several[0])
    jax.vmap(f)(several)
    assert made == [("solve", (4, 3)), ("solve", (8, 3))]
    made.clear()

    def number(x, i):
        return (weights * f(x, inertia=i)).sum()

    jax.jit(jax.vmap(jax.grad(number, (0, 1)), (0, None)))(several[0], inertia)
    assert [one for one in made if one[0] == "gradients"] == [("gradients", (4, 3))]
    made.clear()
    jax.vmap(lambda x: jax.jvp(lambda i: f(x, inertia=i), (inertia,), (x0,))[1])(several)
    assert [one for one in made if one[0] == "tangents"] == [("tangents", (8, 3))]
    prepared, real = [], parametrized_run.with_parameters_of_members
    monkeypatch.setattr(
        parametrized_run,
        "with_parameters_of_members",
        lambda system, values: prepared.append(values) or real(system, values),
    )
    jax.jit(jax.value_and_grad(number, (0, 1)))(x0, inertia * 1.01)
    assert len(prepared) == 1
    run, moved = kind(ready, (0, 10), 50, None, "a test"), inertia.copy()
    run.solve({"x0": x0, "inertia": moved}, True)
    moved[:] = 7.0
    (found,) = run.gradients({"x0": x0, "inertia": inertia}, [weights[None]], ["inertia"])
    other = co.prepare(co.systems.rigid_body(inertia), co.Splitting(order=4), 0.05)
    assert np.array_equal(found[0], other.vjp(x0, (0, 10), 50)[1](weights)["inertia"])


@pytest.mark.parametrize("count", [15, 97, 10007])
def test_segments_of_scans_do_not_change_the_results(jax, count):
    """Prime numbers of steps leave a rest after the segments."""
    from coadjoint.jax import xla_run

    def total(scan, x):
        carry, ys = scan(lambda x, k: (jax.numpy.cos(x + k), x[0] * k), x, 0.001 * jax.numpy.arange(count))
        return carry.sum() + (ys * jax.numpy.arange(count)).sum() / count**2

    x0 = jax.numpy.array([0.1, 0.4])
    scans = (xla_run.scan_in_segments, jax.lax.scan)
    found, wanted = (jax.value_and_grad(lambda x, scan=scan: total(scan, x))(x0) for scan in scans)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-13)
