"""Gradients of runs of JAX whose steps are undone from the saved states, against those from stored states."""

import numpy as np
import pytest

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


def body(unit=1.0):
    return co.systems.rigid_body(unit * np.array([1.0, 2.0, 3.0]))


def learned():
    H = co.jax.features(lambda y, w: w * jnp.log(jnp.cosh(y)), np.cos(np.arange(12.0)).reshape(4, 3), np.ones(4))
    return co.LiePoissonSystem(co.algebras.so(3), H, sign=-1)


def network():
    H = co.jax.energy(
        lambda x, w, t: jnp.cos(t) * (jnp.tanh(w @ x).sum() + x @ x), np.cos(np.arange(12.0)).reshape(4, 3)
    )
    return co.LiePoissonSystem(co.algebras.so(3), H, sign=-1)


def several():
    return co.batch([co.systems.rigid_body((1.0, 2.0, third)) for third in (2.2, 2.9)])


OPTIONS = {"backend": "xla", "reverse": "reversible"}
COORDINATES, PROCESSED = co.Splitting(parts="coordinates"), co.Splitting(scheme="blanes_casas_murua6")
CASES = {
    "features": (learned, PROCESSED, (0.0, 4.0), 7, {}),
    "stages": (network, co.GaussLegendre(2), (1.0, -1.0), 9, {}),
    "attitude": (body, co.Splitting(order=4), (0.5, 20.5), 40, {"attitude": True}),
    "backward": (body, co.Splitting(order=4), (5.0, -5.0), 7, {"attitude": True}),
    "batch": (several, COORDINATES, (0.0, 10.0), 100, {}),
    "top": (co.systems.heavy_top, PROCESSED, (0.0, 10.0), 10, {"attitude": True}),
    "small": (lambda: body(1e-7), co.Splitting(order=2), (0.0, 2.0), 10, {}),
    "large": (lambda: body(1e30), co.Splitting(order=2), (0.0, 2.0), 10, {}),
    "composition": (body, co.Composition(co.Splitting(), (1.0,)), (0.0, 5.0), 10, {}),
    "times": (body, co.Splitting(order=4), (0.0, 5.0), 1, {"t_eval": [0.33, 2.0, 4.99]}),
}


@pytest.mark.parametrize("name", long_beyond(1, CASES))
def test_gradients_are_those_of_stored_states(name):
    make, method, span, every, options = CASES[name]
    options, system = dict(options), make()
    t_eval = options.pop("t_eval", None)
    known = make in (learned, network)
    scheme = {"method": method, "step": 0.1} if known else {}
    ready = system if known else co.prepare(system, method, 0.1, **options)
    size = 1e-7 if name == "small" else 1e30 if name == "large" else 1.0
    shape = (2, 3) if system.is_batch else (system.dim,)
    x0 = size * jnp.asarray(np.random.default_rng(3).uniform(0.3, 0.8, shape))
    given = {"params": system.hamiltonian.terms()[0].value.function.params} if known else {}
    if make is body:
        given["inertia"] = jnp.asarray(ready.parameters["inertia"])

    def gradient(reverse):
        run = co.jax.solution(ready, span, every, t_eval=t_eval, backend="xla", reverse=reverse, **scheme)

        def loss(x0, values):
            outputs = jax.tree.leaves(run(x0, **values))
            return sum((jnp.cos(jnp.arange(1.0 * one.size)).reshape(one.shape) * one).sum() for one in outputs)

        return jax.tree.leaves(jax.jit(jax.grad(loss, (0, 1)))(x0, given))

    # Rounding of each way is amplified by the growth of neighboring motions, of degree two in the number of steps here.
    steps = abs(span[1] - span[0]) / 0.1
    for wanted, found in zip(gradient("exact"), gradient("reversible"), strict=True):
        assert np.max(np.abs(wanted)) > 0.0
        np.testing.assert_allclose(found, wanted, rtol=0, atol=steps**2 * UNIT_ROUNDOFF * np.max(np.abs(wanted)))


def test_memory_is_constant_in_the_number_of_steps():
    def numbers(steps):
        run = co.jax.solution(body(), (0, 0.1 * steps), steps, method=co.Splitting(), step=0.1, **OPTIONS)
        gradient = jax.jit(jax.grad(lambda x0: run(x0)[-1].sum())).lower(jnp.ones(3)).compile()
        return gradient.memory_analysis().temp_size_in_bytes

    assert numbers(10**5) == numbers(10**3) < 2**14


def test_gradients_whose_states_are_lost_are_nan():
    """A chaotic top is not back at its start after 3000 steps."""
    run = co.jax.solution(co.systems.heavy_top(), (0, 300), 3000, method=co.Splitting(), step=0.1, **OPTIONS)
    assert np.isnan(jax.jit(jax.grad(lambda x0: run(x0)[-1, 0]))(jnp.arange(1.0, 7.0) / 3.0)).all()


def test_compiled_runs_are_undone_as_by_vjp():
    ready, weights = co.prepare(body(), co.Splitting(order=4), 0.1), np.cos(np.arange(33.0)).reshape(11, 3)
    run = co.jax.solution(ready, (0, 10), 10, reverse="reversible")
    found = jax.grad(lambda x0: (weights * run(x0)).sum())(jnp.ones(3))
    assert np.array_equal(found, ready.vjp(np.ones(3), (0, 10), 10, reverse="reversible")[1](weights)["x0"])


REFUSED = {
    "word": (body, co.Splitting(), {"reverse": "back"}, ValueError, ["reverse", "'back'", "reversible"]),
    "forces": (
        lambda: body().with_forces(co.forces.LinearDamping(0.1)), co.Splitting(), {"backend": "xla"}, TypeError,
        ["rigid_body", "undoes", 'reverse="exact"'],
    ),
    "stages": (body, co.GaussLegendre(1), {}, TypeError, ["GaussLegendre", 'reverse="exact"']),
    "matrices": (
        lambda: co.systems.sphere_euler(N=4), co.IsospectralGauss(), {"backend": "xla"}, TypeError,
        ["IsospectralGauss", "undoes", 'reverse="exact"'],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_undone_is_refused(name):
    make, method, options, error, named = REFUSED[name]
    with refused(error, *named):
        co.jax.solution(co.prepare(make(), method, 0.1), (0, 1), **{"reverse": "reversible", **options})
