"""Isospectral runs of matrices as operations of JAX: agreement with the compiled loops, derivatives, refusals."""

from functools import cache
from itertools import product

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF

jax = pytest.importorskip("jax")
jnp = jax.numpy

C1 = 1 / (2 - 2 ** (1 / 3))
COMPOSED = co.Composition(co.IsospectralGauss(), (C1, 1 - 2 * C1, C1))
STEPS = 100


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@cache
def made(name, **parameters):
    sizes = {} if name == "matrix_body" else {"N": 5}
    return co.systems.get(name, **sizes, **parameters)


def start_of(system, seed=1, members=()):
    """Return random states of the algebra of size one."""
    rng, shape = np.random.default_rng(seed), (*members, *system.matrix_shape)
    x = rng.standard_normal(shape) + (1j * rng.standard_normal(shape) if system.complex else 0.0)
    return system.algebra.projected(x) / np.sqrt(system.algebra.N)


def step_of(system):
    """Return a step that turns the fastest mode by about a third."""
    P = np.asarray(system.stream_of(start_of(system))).reshape(-1, *system.algebra.shape)
    return 0.15 / np.linalg.norm(P, 2, axis=(-2, -1)).max()


def tolerance(system, steps=STEPS):
    """Return the difference of runs that round products of N terms in each step, of states of size one."""
    return steps * 8 * np.sqrt(system.algebra.N) * UNIT_ROUNDOFF


TAKEN = {name: system for name in co.systems.names() if (system := co.systems.get(name)).has_matrices}
EVERY = [name for name, system in TAKEN.items() if not system.independent_layers]  # which are refused by name
VARIANTS = {
    "rotating": lambda: made("sphere_euler", rotation=2.0),
    "with topography": lambda: made("sphere_qg", lamb=3.0, rotation=1.0, topography=((2, 1, 0.3, 0.0),)),
    "with gamma": lambda: made("torus_qg", gamma=2.0, topography=((1, 2, 0.3, 0.0),)),
    "surface of the torus": lambda: made("surface_qg", surface="torus"),
    "magnetic torus": lambda: made("reduced_mhd", surface="torus"),
    "warm planet": lambda: made(
        "thermal_qg", gamma=2.0, rotation=1.0, topography=((2, 1, 0.3, 0.0),), bathymetry=((2, 1, 0.5, 0.0),)
    ),
    "even": lambda: co.systems.surface_qg(N=6),
}
SYSTEMS = {name: lambda name=name: made(name) for name in EVERY} | VARIANTS
RUNS = {
    "forward": (co.IsospectralGauss(), 0.0, 1, {"save_every": 10}),
    "two stages, backward": (co.IsospectralGauss(2), 0.7, -1, {"save_every": 33}),
    "composed, late": (COMPOSED, 1.5, 1, {"save_every": 100}),
}
FIRST = [("rotating", "two stages, backward"), ("reduced_mhd", "composed, late"), ("torus_qg", "forward")]
REPEATED = [(name, list(RUNS)[k % 3]) for k, name in enumerate(SYSTEMS)]
REPEATED = [case for case in REPEATED if case not in FIRST]


def both(system, method, h, span, x0, **options):
    """Return the states of a run by JAX, and of the compiled one."""
    ready = co.prepare(system, method, h)
    return np.asarray(co.jax.solution(ready, span, backend="xla", **options)(x0)), ready.run(x0, span, **options).x


@pytest.mark.parametrize(("name", "run"), long_beyond(len(FIRST), FIRST + REPEATED))
@pytest.mark.thinned(1)
def test_runs_agree_with_the_compiled_ones_and_keep_the_spectrum(name, run):
    system, (method, t0, way, options) = SYSTEMS[name](), RUNS[run]
    h, x0 = step_of(system), start_of(system)
    found, wanted = both(system, method, h, (t0, t0 + way * STEPS * h), x0, **options)
    assert np.abs(found - wanted).max() < tolerance(system)
    spectra = np.array([system.spectrum(x) for x in found])
    assert np.abs(spectra - spectra[0]).max() < 1e-13 * np.abs(spectra[0]).max()


F = co.forces
PUSH = start_of(made("torus_euler"), 3)
FORCED = {
    "on the torus": (("torus_euler", {}), (F.BetaPlane(0.7), F.Friction(lambda k: 0.1 * k)), {"t_eval": [0.31, 0.4]}),
    "damped planet": (
        ("sphere_euler", {"rotation": 1.0}),
        (F.Viscosity(0.05, rotation=True), F.LinearDamping(0.2)),
        {},
    ),
    "of two layers": (("reduced_mhd", {}), (F.Viscosity(0.05, layer="carried"), F.Friction(0.2)), {"save_every": 7}),
    "of mountains": (("sphere_qg", {"lamb": 2.0, "rotation": 1.0}), (F.Friction(0.3), F.Viscosity(0.02, power=2)), {}),
    "pushed": (("torus_euler", {}), (F.Torque(PUSH), F.Viscosity(0.1)), {}),
}


@pytest.mark.parametrize(("name", "method"), long_beyond(1, product(FORCED, [co.IsospectralGauss(), COMPOSED])))
@pytest.mark.thinned(1)
def test_forces_act_as_in_the_compiled_runs(name, method):
    (system, parameters), forces, options = FORCED[name]
    system = made(system, **parameters)
    x0, forced = start_of(system), system.with_forces(*forces)
    found, wanted = both(forced, method, 0.02, (0.3, 0.6), x0, **options)
    assert np.abs(found - wanted).max() < tolerance(system, 15)
    assert np.abs(found[-1] - without_forces(system, method, 0.02, (0.3, 0.6), x0, **options)[-1]).max() > 1e-3


@pytest.mark.parametrize("layer", ["vorticity", "carried"])
def test_a_force_acts_on_the_field_that_it_names(layer):
    system = made("reduced_mhd")
    x0 = start_of(system)
    forced = system.with_forces(F.Viscosity(0.3, layer=layer))
    found, wanted = both(forced, co.IsospectralGauss(), 0.05, (0.0, 0.2), x0)
    assert np.abs(found - wanted).max() < tolerance(system, 4)
    other = system.with_forces(F.Viscosity(0.3, layer={"vorticity": "carried", "carried": "vorticity"}[layer]))
    assert np.abs(found[-1] - co.integrate(other, x0, (0.0, 0.2), 0.05).x[-1]).max() > 1e-2


def without_forces(system, method, h, span, x0, **options):
    """Return the states of the compiled run without forces."""
    return co.prepare(system, method, h).run(x0, span, **options).x


def test_a_wave_turns_as_its_closed_form():
    """Each mode turns by less than h m in a step, and the scheme has order 6."""
    planet = made("sphere_euler", rotation=2.0)
    x0, h = planet.rossby_haurwitz(4, 3), 0.02
    end = co.jax.solution(co.prepare(planet, co.IsospectralGauss(3), h), (0.0, 2.0), 100, backend="xla")(x0)[-1]
    wanted = planet.exact(x0, 2.0)
    assert np.abs(wanted - x0).max() > 0.3 * np.abs(x0).max()
    assert np.abs(end - wanted).max() < 1e-9 * np.abs(x0).max()


@pytest.mark.long
@pytest.mark.parametrize("unit", [1e30, 1e-7])
def test_units_of_the_state_change_nothing_but_its_scale(unit):
    system = made("sphere_euler")
    x0, h = start_of(system), step_of(system)
    wanted = co.prepare(system, co.IsospectralGauss(), h).run(x0, (0.0, 10 * h), 10).x
    ready = co.prepare(system, co.IsospectralGauss(), h / unit)
    found = co.jax.solution(ready, (0.0, 10 * h / unit), 10, backend="xla")(unit * x0) / unit
    assert np.abs(found - wanted).max() < tolerance(system, 10)


@pytest.fixture(scope="module")
def short_run():
    system = made("torus_euler")
    return system, co.prepare(system, co.IsospectralGauss(), 0.05), start_of(system, members=(3,))


@pytest.mark.parametrize("mapped", [False, pytest.param(True, marks=pytest.mark.long)])
def test_members(short_run, mapped):
    system, ready, states = short_run
    f = co.jax.solution(ready, (0.0, 0.5), 5, backend="xla")
    found = np.asarray(jax.vmap(f, out_axes=1)(states) if mapped else f(states))
    assert found.shape == (3, 3, 5, 5)
    assert np.abs(found - ready.run(states, (0.0, 0.5), 5).x).max() < tolerance(system, 10)


@pytest.mark.parametrize(("name", "method"), long_beyond(1, [
    ("torus_euler", co.IsospectralGauss()), ("reduced_mhd", co.IsospectralGauss()), ("surface_qg", COMPOSED),
    ("sphere_euler", co.IsospectralGauss(2)), ("matrix_body", co.IsospectralGauss(3)), ("passive_scalar", COMPOSED),
]))  # fmt: skip
@pytest.mark.thinned(1)
def test_gradients_agree_with_the_compiled_ones(name, method):
    """On the algebra, on which starts are projected; JAX returns the conjugate of the gradient by complex numbers."""
    system = made(name)
    h, x0 = step_of(system), start_of(system)
    ready, span = co.prepare(system, method, h), (0.0, 10 * h)
    sol, pullback = ready.vjp(x0, span, save_every=5)
    weights = np.cos(np.arange(sol.x.size)).reshape(sol.x.shape)
    f = co.jax.solution(ready, span, 5, backend="xla")
    found = jax.grad(lambda x: jnp.sum(weights * f(x).real))(jnp.asarray(x0))
    wanted = pullback(weights)["x0"]
    # Of each of 10 steps, with linear equations that are solved to a few roundings.
    assert (
        np.abs(system.algebra.projected(np.conj(found) - wanted)).max()
        < 32 * tolerance(system, 10) * np.abs(wanted).max()
    )


def test_steps_that_do_not_converge_and_other_matrices_are_nan(short_run):
    system, ready, states = short_run
    f = co.jax.solution(co.prepare(system, co.IsospectralGauss(), 50.0), (0.0, 100.0), backend="xla")
    found = np.asarray(f(states[0]))
    assert np.isfinite(found[0]).all() and np.isnan(found[1:]).all()
    g = jax.jit(co.jax.solution(ready, (0.0, 0.1), backend="xla"))
    assert np.isfinite(g(states[0])).all() and np.isnan(g(1j * states[0])).all()


@pytest.mark.parametrize(("refusal", "named"), [
    (lambda f, s: f(1j * start_of(s)), ("not a matrix of su(5)",)),
    (lambda f, s: f(np.full((5, 5), np.nan)), ("NaN",)),
    (lambda f, s: f(start_of(s)[:4, :4]), ("(4, 4)", "(5, 5) or (members, 5, 5)")),
    (lambda f, s: f(start_of(s), mass=1.0), ("mass",)),
    (lambda f, s: f(start_of(s), rotation=1.0), ("rotation", "prepare")),
    (lambda f, s: f(s.relative(start_of(s))), ("relative to the frame",)),
])  # fmt: skip
def test_starts_that_are_refused(refusal, named):
    system = made("sphere_euler", rotation=2.0)
    f = co.jax.solution(co.prepare(system, co.IsospectralGauss(), 0.05), (0.0, 0.1), backend="xla")
    with refused(ValueError, *named):
        refusal(f, system)


def of_function():
    return co.MatrixSystem(co.MatrixAlgebra("su", 3), lambda W: 2.0 * W, name="own fluid")


def of_real_matrices():
    return co.MatrixSystem(co.MatrixAlgebra("gl", 2), co.systems.Weights(np.eye(2)))


@pytest.mark.parametrize(("system", "method", "named"), [
    (of_function, co.IsospectralGauss(), ("own fluid", "function")),
    (lambda: co.systems.torus_euler(N=5), co.LineSplitting(), ("LineSplitting", "IsospectralGauss")),
    (lambda: made("torus_euler").with_forces(F.SelectiveDecay(0.1)), co.IsospectralGauss(), ("SelectiveDecay",)),
    (lambda: made("torus_euler").with_forces(F.RandomForcing(0.1, (1, 2), seed=1)), co.IsospectralGauss(),
     ("RandomForcing",)),
    (lambda: made("torus_euler").in_numbers, co.IsospectralGauss(), ("torus_euler", "matrices")),
    (of_real_matrices, co.IsospectralGauss(), ("gl(2, R)",)),
])  # fmt: skip
def test_systems_that_are_refused(system, method, named):
    with refused(TypeError, *named):
        co.jax.solution(co.prepare(system(), method, 0.1), (0.0, 1.0), backend="xla")
