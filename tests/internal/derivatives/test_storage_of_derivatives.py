"""How derivatives store the run: stretches, checkpoints, blocks of exponentials, caches, and operations of JAX."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.runs.derivatives import differentiable_run, stretches
from coadjoint.runs.loops import shifted_attitude
from rounding import UNIT_ROUNDOFF

H, X6 = 0.125, np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])
BODY = co.systems.rigid_body((1, 2, 3))
TOP = co.systems.heavy_top(inertia=(1.0, 2.0, 2.5), lever=(0.1, 0.2, 1.0))


@pytest.mark.parametrize(
    "method", [co.Splitting(order=4), co.Splitting(compensated=True), co.GaussLegendre(2)], ids=str
)
@pytest.mark.parametrize("members", [None, 3])
def test_gradients_do_not_depend_on_stretches(method, members, monkeypatch):
    """Up to round-off: joined flows are separate where the added part is between them."""
    ready = co.prepare(TOP, method, H, attitude="coadjoint")
    x0 = X6 if members is None else X6 * np.linspace(1.0, 0.7, members)[:, None]
    found = []
    for numbers in (2**15, 42, 3 * 42):
        monkeypatch.setattr(differentiable_run, "STEPS_OF_STRETCH", 1)
        monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", numbers)
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
        monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", numbers)
        sol, pullback = large.vjp(x1, (0.0, 0.01 * steps), save_every=steps)
        lengths = [one.k1 - one.k0 for one in pullback._gradient.args[1].stretches]
        assert lengths == ([40] if numbers > 1 else [16, 16, 8])
        gradients[numbers] = pullback(np.ones(sol.x.shape))["x0"]
    assert np.array_equal(gradients[1], gradients[2**15])
    monkeypatch.setattr(differentiable_run, "STEPS_OF_STRETCH", 1)
    monkeypatch.setattr(differentiable_run, "NUMBERS_OF_STRETCH", 3)
    for size, count in ((2**25, 1000), (4800, 100)):
        monkeypatch.setattr(differentiable_run, "BYTES_OF_CHECKPOINTS", size)
        assert len(ready.vjp(x0, (0.0, 1000 * H), 1000)[1]._gradient.args[1].stretches) == count
    # A thousand steps of their own lengths store about a kilobyte each.
    ready = co.prepare(BODY, co.ReversibleSteps(co.Splitting(), 0.1), 300.0, attitude=True)
    assert len(ready.vjp(x0, (0.0, 300.0))[1]._gradient.args[1].stretches) > 1024


@pytest.mark.parametrize("count", [1, 9])
def test_exponentials_in_blocks_are_those_one_by_one(monkeypatch, count):
    """The unshifted element is the unit one; with many directions those of a basis are combined."""
    ready = co.prepare(BODY, co.Splitting(), H, attitude=True)
    x0, rng, found = np.array([0.3, 1.0, 0.2]), np.random.default_rng(1), []
    directions = {"x0": rng.standard_normal((3, count)), "inertia": rng.standard_normal((3, count))}
    for largest in (2, 3):
        monkeypatch.setattr(shifted_attitude, "LARGEST_BLOCK", largest)
        found.append(ready.jvp(x0, (0.0, 1.0), directions)[1].attitude)
    each = [ready.jvp(x0, (0.0, 1.0), {name: v[:, k] for name, v in directions.items()})[1] for k in range(count)]
    for other in (found[1], np.stack([one.attitude for one in each], axis=-1)):
        np.testing.assert_allclose(found[0], other, rtol=0, atol=2**6 * UNIT_ROUNDOFF * np.abs(found[0]).max())


@pytest.mark.parametrize("system", [BODY, BODY.with_forces(co.forces.LinearDamping(0.1))], ids=["alone", "forced"])
def test_equations_of_derivatives_that_are_not_solved_raise_integration_errors(system, monkeypatch):
    """At the time of the stretch, or of the step with forces."""
    monkeypatch.setattr(stretches, "advance_tables", lambda *_: False)
    x0 = np.array([0.3, 1.0, 0.2])
    ready = co.prepare(system, co.GaussLegendre(2), 0.125)
    _, pullback = ready.vjp(x0, (1.0, 1.25))
    # Backward the last step is the first one whose equations are solved.
    calls = ((lambda: ready.jvp(x0, (1.0, 1.25), {"x0": x0}), 1.0), (lambda: pullback(np.ones((3, 3))), 1.125))
    for call, time in calls:
        with pytest.raises(co.IntegrationError, match=r"smaller step than 0\.125") as raised:
            call()
        assert raised.value.time == (1.25 if system is BODY else time)


def test_gradients_of_heat_baths_need_no_matrices(monkeypatch):
    """Neither the dense derivative of a flow nor a flow of a moved system is computed for a lattice with a bath."""
    lattice = co.systems.spin_lattice("square", (4, 4), field=(0.0, 0.0, 0.3))
    bath = lattice.with_forces(co.forces.HeatBath(0.1, temperature=0.2, seed=1))
    for name in ("flow", "tangent"):
        monkeypatch.setattr(co.forces.HeatBath, name, lambda *_: pytest.fail("a dense flow"))
    sol, pull = co.prepare(bath, co.Splitting(), step=0.125).vjp(np.tile([0.6, 0.0, 0.8], 16), (0, 1), 8)
    gradient = pull(np.ones_like(sol.x))
    assert np.isfinite(gradient["HeatBath.temperature"]) and np.isfinite(gradient["field"]).all()


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
    prepared, real = [], parametrized_run.with_parameters
    monkeypatch.setattr(
        parametrized_run, "with_parameters", lambda system, values: prepared.append(values) or real(system, values)
    )
    jax.jit(jax.value_and_grad(number, (0, 1)))(x0, inertia * 1.01)
    assert len(prepared) == 1
    run, moved = kind(ready, (0, 10), 50, None, "a test"), inertia.copy()
    run.solve({"x0": x0, "inertia": moved}, True)
    moved[:] = 7.0
    (found,) = run.gradients({"x0": x0, "inertia": inertia}, [weights[None]], ["inertia"])
    other = co.prepare(co.systems.rigid_body(inertia), co.Splitting(order=4), 0.05)
    assert np.array_equal(found[0], other.vjp(x0, (0, 10), 50)[1](weights)["inertia"])


@pytest.mark.parametrize("most_dense", [0, 2**12])
def test_sparse_products_are_those_of_the_matrix(jax, monkeypatch, most_dense):
    """Rows of different lengths, an empty one and entries in any order."""
    from coadjoint.jax import stage_steps

    monkeypatch.setattr(stage_steps, "MOST_DENSE", most_dense)
    rng = np.random.default_rng(3)
    dense = rng.standard_normal((5, 7)) * (rng.random((5, 7)) < 0.5)
    dense[2], dense[4, [0, 6]] = 0.0, (1.0, 2.0)
    rows, columns = np.nonzero(dense)
    order, x = rng.permutation(len(rows)), rng.standard_normal(7)
    rows, columns = rows[order], columns[order]
    matrix = stage_steps.sparse(rows, columns, jax.numpy.array(dense[rows, columns]), dense.shape)
    assert (matrix.columns is None) == (most_dense > 0)
    np.testing.assert_allclose(matrix.times(jax.numpy.array(x)), dense @ x, rtol=0, atol=16 * UNIT_ROUNDOFF)


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
