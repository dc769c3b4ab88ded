"""Runs as operations of JAX: agreement with the compiled loops, transformations, devices and memory."""

import warnings

import numpy as np
import pytest

import coadjoint as co
from core_only import run_python
from digests.schemes_under_test import EXAMPLES
from energies import pulsed
from long import long_beyond, long_where
from refusals import refused
from rounding import UNIT_ROUNDOFF

jax = pytest.importorskip("jax")
jnp = jax.numpy

RNG = np.random.default_rng(41)
X0 = np.array([1.0, 0.2, 0.5])
INERTIA = np.array([1.1, 2.0, 2.4])
C1 = 1 / (2 - 2 ** (1 / 3))


@pytest.fixture(autouse=True)
def double_precision_and_same_draws():
    RNG.bit_generator.state = np.random.default_rng(41).bit_generator.state  # alone and after other tests
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def full(n):
    half = 0.2 * RNG.standard_normal((n, n))
    return co.Quadratic(half @ half.T + np.diag(RNG.uniform(0.3, 1.0, n)), 0.2 * RNG.standard_normal(n))


def polynomial(n):
    """A cubic energy of the last coordinates, and squares."""
    squares = {tuple(2 * int(k == i) for k in range(n)): 0.2 + 0.1 * i for i in range(n)}
    return co.Polynomial(squares | {tuple(3 * int(k == n - 1) for k in range(n)): 0.1})


def of_algebra(algebra):
    return co.LiePoissonSystem(algebra, full(algebra.dim), sign=-1)


BODY = co.systems.rigid_body((1.0, 2.0, 2.5))
DIAGONAL = co.LiePoissonSystem(co.algebras.get("A3,2"), co.Quadratic([0.9, 0.5, 0.7], [0.1, 0.2, 0.3]))
FREE = co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(np.linspace(0.3, 1.0, 8)))
IN_TIME = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.1, 0.2, 0.3]) + co.Separable({0: pulsed(6.0)}))
get = co.algebras.get
SYSTEMS = {
    "body, 1": lambda: (BODY, co.Splitting(order=1)),
    "body, adjoint": lambda: (BODY, co.Splitting(order=1, adjoint=True)),
    "body, 8": lambda: (BODY, co.Splitting(order=8)),
    "body, processed": lambda: (BODY, co.Splitting(scheme="blanes_casas_murua6")),
    "body, composition": lambda: (BODY, co.Composition(co.Splitting(order=2), (C1, 1 - 2 * C1, C1))),
    "body, rational": lambda: (BODY, co.Splitting(scheme="blanes_casas_murua6", rotation="rational")),
    "body, Gauss": lambda: (BODY, co.GaussLegendre(3)),
    "so(3), cubic": lambda: (co.LiePoissonSystem(co.algebras.so(3), polynomial(3)), co.Splitting(order=4)),
    "e(3), cubic": lambda: (co.LiePoissonSystem(co.algebras.e(3), polynomial(6)), co.Splitting()),
    "A3,2": lambda: (DIAGONAL, co.Splitting(order=4)),
    "top": lambda: (co.systems.heavy_top(), co.Splitting(order=4)),
    "top, free body": lambda: (co.systems.heavy_top(), co.Splitting(parts="free_body")),
    "su(3), free body": lambda: (FREE, co.Splitting(parts="free_body")),
    "full free body": lambda: (of_algebra(co.algebras.so(3)), co.Splitting(parts="free_body")),
    "bonds": lambda: (co.systems.spin_lattice("chain", 3, field=(0.1, 0.2, 0.3)), co.Splitting(parts="bonds")),
    "30 spins": lambda: (co.systems.spin_lattice(shape=30, periodic=True), co.Splitting(order=1)),
    "in time": lambda: (IN_TIME, co.Splitting(order=4)),
    "in time, processed": lambda: (IN_TIME, co.Splitting(scheme="blanes_casas_murua6")),
    "Toda": lambda: (co.systems.toda(sites=4), co.Splitting(order=4)),
}
FULL = {"so(5)": 2, "su(3)": 2, "sl(2)": 4, "A3,7": 1, "A4,7": 2, "A4,10": 4, "heisenberg(2)": 4}
SYSTEMS |= {
    name: lambda name=name, order=order: (
        of_algebra(get(name, a=0.5) if name == "A3,7" else get(name)), co.Splitting(order=order)
    )
    for name, order in FULL.items()
}  # fmt: skip
SPANS = {
    "forward": ((0.0, 2.0), {"save_every": 1}),
    "late": ((1.5, 4.5), {"save_every": 7}),
    "backward": ((3.0, 1.0), {"save_every": 20}),
    "times": ((1.0, 3.0), {"t_eval": [1.0, 1.234, 1.25, 2.6, 2.96]}),
    "backward times": ((3.0, 1.0), {"t_eval": [2.95, 2.3, 1.02]}),
    "times on steps": ((1.0, 4.0), {"t_eval": [1.0, 1.5, 1.7, 3.0]}),
    "prime": ((0.0, 6.7), {"save_every": 67}),  # one that no segments of equal length have
}
# A3,7 has blocks by series.
CASES = [("body, Gauss", "times"), ("A3,7", "late"), ("in time, processed", "backward times")]
REPEATED = [(name, list(SPANS)[k % 3]) for k, name in enumerate(SYSTEMS)]
REPEATED += [("body, Gauss", "backward times"), ("top, free body", "times"), ("body, 1", "prime")]
REPEATED += [
    ("body, rational", "times"),
    ("body, rational", "backward times"),
    ("e(3), cubic", "backward times"),
    ("body, 1", "times on steps"),
]


def weights(x):
    return np.cos(np.arange(x.size)).reshape(x.shape)


def compiled(ready, x0, ends, **options):
    """Return the states and the gradient by x0 of their sum with weights."""
    sol, pullback = ready.vjp(x0, ends, **options)
    return sol.x, pullback(weights(sol.x))["x0"]


def gradients(ready, ends, backend="xla", **options):
    """Return a function of x0 and parameters: the sum and the states, and its gradients."""
    f = co.jax.solution(ready, ends, backend=backend, **options)

    def weighted(x0, values):
        x = f(x0, **values)
        return (weights(x) * x).sum(), x

    return jax.jit(jax.value_and_grad(weighted, (0, 1), has_aux=True))


@pytest.mark.parametrize(("name", "span"), long_beyond(len(CASES), CASES + REPEATED))
@pytest.mark.thinned(27)
def test_values_and_gradients_agree_with_the_compiled_run(name, span):
    system, method = SYSTEMS[name]()
    ready, (ends, options) = co.prepare(system, method, 0.1), SPANS[span]
    x0 = 0.7 * RNG.standard_normal(system.dim)
    wanted, gradient = compiled(ready, x0, ends, **options)
    (_, found), (of_x0, _) = gradients(ready, ends, **options)(x0, {})
    # At most 1000 flows, which round a few times each.
    largest = max(1.0, np.max(np.abs(wanted)))
    tolerance = 1000 * 8 * UNIT_ROUNDOFF * largest
    assert np.max(np.abs(found - wanted)) < tolerance
    assert np.max(np.abs(of_x0 - gradient)) < 32 * largest * wanted.size * tolerance


@pytest.mark.long
def test_free_bodies_that_turn_far_in_a_step():
    """By several turns: the other coordinates of su(3) turn by half of the angle, which is known up to whole turns."""
    ready, x0 = co.prepare(FREE, co.Splitting(parts="free_body"), 1.0), 3.0 * RNG.standard_normal((6, 8))
    found, wanted = co.jax.solution(ready, (0, 4), backend="xla")(x0), ready.run(x0, (0, 4)).x
    assert np.max(np.abs(found - wanted)) < 1e-9


def prepared(inertia=(1.0, 2.0, 2.5), method=None, **options):
    return co.prepare(co.systems.rigid_body(inertia=inertia), method or co.Splitting(order=4), 0.05, **options)


@pytest.fixture
def f():
    return co.jax.solution(prepared(), (0, 5), 25, backend="xla")


E3, M, LINEAR = co.algebras.e(3), np.array([1.0, 0.6, 0.3, 0.2, 0.4, 0.1]), np.array([0.1, -0.2, 0.3, 0.3, 0.1, 0.2])
PARAMETRIZED = {
    "inertia": lambda: (BODY, co.Splitting(order=4)),
    "equatorial, axial, lever": lambda: (co.systems.lagrange_top(), co.Splitting(order=1)),
    "M, linear": lambda: (co.LiePoissonSystem(E3, co.Quadratic(M, linear=LINEAR)), co.Splitting(parts="coordinates")),
    "M, Gauss": lambda: (co.LiePoissonSystem(co.algebras.so(3), full(3)), co.GaussLegendre(2)),
    "coefficients": lambda: (co.LiePoissonSystem(co.algebras.se(2), polynomial(3)), co.Splitting()),
    "inertia, rational": lambda: (BODY, co.Splitting(parts="coordinates", rotation="rational")),
    "inertia, Gauss": lambda: (BODY, co.GaussLegendre(2)),
    "exchange": lambda: (co.systems.spin_lattice(shape=8, periodic=True), co.Splitting()),
}


@pytest.mark.parametrize("name", long_beyond(3, PARAMETRIZED))
@pytest.mark.thinned(6)
def test_parameters_agree_with_the_compiled_backend(name):
    system, method = PARAMETRIZED[name]()
    ready, draw = co.prepare(system, method, 0.05), np.random.default_rng(7)
    values = {key: value * draw.uniform(0.97, 1.03, value.shape) for key, value in ready.parameters.items()}
    values = {key: value for key, value in values.items() if key in name.split(", ")}
    x0 = 0.7 * RNG.standard_normal(system.dim)
    found = [gradients(ready, (1, 2.8), backend, save_every=9)(x0, values) for backend in ("compiled", "xla")]
    # As above. The derivative of the coefficients has the rounding of the interpolation, twelve digits and more.
    for wanted, one in zip(*map(jax.tree.leaves, found), strict=True):
        assert np.max(np.abs(one - wanted)) < 1e-10 * max(1.0, np.max(np.abs(wanted)))
    assert np.abs(found[0][0][1] - ready.run(x0, (1, 2.8), 9).x).max() > 1e-5


SECOND = {
    "body": (BODY, co.Splitting(), [X0]),
    "body by stages": (BODY, co.GaussLegendre(2), [X0]),
    # The rotation about a sum that is zero has no axis, but derivatives; that by 1.7 is beyond the series.
    "bond": (co.systems.spin_lattice("chain", 2, field=(0.1, 0.2, 0.3)), co.Splitting(order=1, parts="bonds"),
        [[0.5, 0.1, 0.2, -0.5, -0.1, -0.2], [8.0, 1.0, 2.0, 8.0, -1.0, 3.0]]),
    "body at rest": (co.systems.heavy_top(), co.Splitting(parts="free_body"), [[0.0, 0.0, 0.0, 0.3, 0.1, 0.9]]),
}  # fmt: skip


@pytest.mark.parametrize(("system", "method", "states"), long_beyond(1, SECOND.values()), ids=SECOND)
def test_second_derivatives_are_differences_of_the_compiled_gradient(system, method, states):
    ready, span, h = co.prepare(system, method, 0.1), {"ends": (0, 1), "save_every": 10}, 2.0**-17
    of, v = gradients(ready, **span), RNG.standard_normal(system.dim)
    both = jax.jit(lambda x0, v: jax.jvp(lambda x: of(x, {}), (x0,), (v,)))
    for x0 in map(np.array, states):
        ((_, x), (gradient, _)), ((along, _), (second, _)) = both(x0, v)
        wanted, first = compiled(ready, x0, **span)
        size = max(1.0, np.abs(x0).max())
        for found, expected in ((x, wanted), (gradient, first), (along, first @ v)):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * size)
        ends = [compiled(ready, x0 + by * v, **span)[1] for by in (h, -h)]
        # The error is h^2 times the fourth derivative, and the rounding divided by h.
        np.testing.assert_allclose(second, (ends[0] - ends[1]) / (2 * h), rtol=0, atol=1e-8 * size)


@pytest.mark.long
def test_second_derivatives_by_parameters_of_ready_made_systems():
    """By the axial moment of a symmetric body, whose momentum turns about its axis, and by pairs of moments."""
    a, c, t, x0 = 1.0, 1.6, 0.8, np.array([1.0, 0.2, 0.5])
    ready = prepared((a, a, c), co.Splitting(order=8, parts="coordinates"))
    f = co.jax.solution(ready, (0, t), 16, backend="xla")
    moments = np.array([a, a, c])
    hessian = jax.jit(jax.hessian(lambda inertia: f(x0, inertia=inertia)[-1, 0]))(moments)
    # x1 = r cos(phi), phi = phi0 + t x3 (1/a - 1/c), of which dphi/dc = t x3/c^2.
    r, phi = np.hypot(*x0[:2]), np.arctan2(x0[1], x0[0]) + t * x0[2] * (1 / a - 1 / c)
    first, second = t * x0[2] / c**2, -2 * t * x0[2] / c**3
    # The differences have twelve digits, of derivatives below one; steps err by 1e-12.
    assert abs(hessian[2, 2] + r * (np.cos(phi) * first**2 + np.sin(phi) * second)) < 1e-10
    gradient = gradients_by_inertia(ready, x0, t)
    h = 2.0**-12
    for k in range(3):
        ends = [gradient(moments + by * h * np.eye(3)[k]) for by in (1, -1)]
        np.testing.assert_allclose(hessian[k], (ends[0] - ends[1]) / (2 * h), rtol=0, atol=h**2)


def gradients_by_inertia(ready, x0, t):
    """The gradient of the first component at the end by the moments, of the compiled run."""

    def gradient(moments):
        other = prepared(tuple(moments), ready.method)
        sol, pullback = other.vjp(x0, (0, t), save_every=16)
        return pullback(np.array([[0.0] * 3] * (len(sol.t) - 1) + [[1.0, 0.0, 0.0]]))["inertia"]

    return gradient


UNITS = ["bodies", "satellite", "decorated_particles", "gravitating_bodies"]


@pytest.mark.parametrize("backend", ["compiled", "xla"])
@pytest.mark.parametrize("name", long_where(UNITS[:1] + UNITS[2:], UNITS))
def test_starts_that_are_no_states_are_refused_by_every_backend(name, backend):
    """A coordinate that must be 1, and numbers that are not finite."""
    system = co.systems.get(name)
    f = co.jax.solution(co.prepare(system, co.Splitting(), 0.05), (0, 0.05), backend=backend)
    x0 = 0.4 * np.cos(1.0 + np.arange(system.dim))
    central = int(np.argmax(np.abs(system.casimirs["z"].gradient(x0))))
    x0[central] = 1.3
    with refused(ValueError, "x0", "1.3", "must be 1"):
        f(x0)
    with refused(ValueError, "x0", "NaN"):
        f(np.full(system.dim, np.nan))
    with refused(ValueError, "must be 1"):
        jax.grad(lambda x0: f(x0)[-1].sum())(x0)
    if name == "satellite":  # traced
        if backend == "xla":
            assert np.isnan(jax.jit(f)(x0)[-1]).all()
        else:
            with refused(jax.errors.JaxRuntimeError, "must be 1"):
                jax.jit(f)(x0)
    x0[central] = 1.0
    assert np.isfinite(f(x0)).all()


@pytest.mark.parametrize("backend", ["compiled", "xla"])
def test_attitudes_that_are_no_rotations_are_refused_by_every_backend(backend):
    """Given in a call, traced, for members, and prepared."""
    sheared = np.eye(3) + 0.3 * np.eye(3, k=1)
    f = co.jax.solution(prepared(method=co.Splitting(), attitude=True), (0, 0.05), backend=backend)
    for called in (f, lambda x0, attitude0: f(np.array([x0, x0]), attitude0=np.array([np.eye(3), attitude0]))):
        with refused(ValueError, "attitude", "not orthogonal"):
            called(X0, attitude0=sheared)
    of_attitude, turned = jax.jit(jax.value_and_grad(lambda A: f(X0, attitude0=A)[1][-1, 0, 0])), np.diag((1.0, -1, -1))
    with refused(jax.errors.JaxRuntimeError, "not orthogonal"):
        of_attitude(sheared)
    value, gradient = of_attitude(turned)  # turned in space
    assert value == gradient[0, 0] and not gradient[1:].any()
    with refused(ValueError, "attitude", "not orthogonal"):
        co.jax.solution(prepared(method=co.Splitting(), attitude=sheared), (0, 0.05), backend=backend)(X0)


FIRST = {
    "xla": lambda ready, x0: co.jax.solution(ready, (0, 10), backend="xla")(x0),
    "xla, inertia and members": lambda ready, x0: co.jax.solution(ready, (0, 10), backend="xla")(
        np.tile(x0, (70, 1)), inertia=INERTIA
    ),
    "xla, gradient": lambda ready, x0: jax.grad(lambda x: co.jax.solution(ready, (0, 10), backend="xla")(x)[-1].sum())(
        x0
    ),
    "jvp": lambda ready, x0: ready.jvp(x0, (0, 10), {"x0": X0}),
    "vjp": lambda ready, x0: ready.vjp(x0, (0, 10)),
    "vjp to a crossing": lambda ready, x0: ready.vjp(x0, (0, 10), events=co.Event("x2")),
    "gradient": lambda ready, x0: jax.grad(lambda x: co.jax.solution(ready, (0, 10))(x)[-1].sum())(x0),
}


@pytest.mark.parametrize("name", long_where(["xla, gradient", "xla, inertia and members"], FIRST))
def test_first_runs_warn_of_a_large_step_however_they_are_made(name):
    """Once, and not of slow motions."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", co.LargeStepWarning)
        FIRST[name](co.prepare(BODY, co.Splitting(), 2.0), 2.0**-6 * X0)
        ready = co.prepare(BODY, co.Splitting(), 2.0)
        with pytest.warns(co.LargeStepWarning, match="the step 2 is too large"):
            FIRST[name](ready, 3.0 * X0)
        FIRST[name](ready, 3.0 * X0)


@pytest.mark.parametrize("every", [1_000_000, pytest.param(1000, marks=pytest.mark.long)])
def test_a_million_steps_are_differentiated_in_little_memory(every):
    f = co.jax.solution(prepared(), (0, 50_000), every, backend="xla")
    gradient = jax.jit(jax.grad(lambda x0: f(x0)[-1].sum())).lower(X0).compile()
    assert gradient.memory_analysis().temp_size_in_bytes < 2**22


def hamiltonian(x):
    return 0.5 * (x[0] ** 2 + 0.5 * x[1] ** 2 + 0.4 * x[2] ** 2) + 0.1 * jnp.sin(x[0] * x[2])


def timed(x, t):
    return hamiltonian(x) * (1.0 + 0.3 * jnp.cos(t))


@pytest.mark.parametrize(("H", "ends"), long_beyond(1, [(timed, (4.5, 0.5)), (hamiltonian, (0.5, 4.5))]))
def test_functions_of_jax_are_stepped_by_gauss(H, ends):
    """At multiples of seven steps, and at the last one, which is none."""
    ready = co.prepare(co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(H)), co.GaussLegendre(2), 0.1)
    wanted, first = compiled(ready, X0, ends, save_every=7)
    (_, x), (gradient, _) = gradients(ready, ends, save_every=7)(X0, {})
    # The compiled iteration stops at rounding.
    np.testing.assert_allclose(x, wanted, rtol=0, atol=1e-13)
    np.testing.assert_allclose(gradient, first, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["energy", "torque"])
def test_times_between_steps_have_the_moments_of_the_run(name):
    """What depends on the time has it in the partial steps too, of runs that do not start at zero."""
    system, method = {
        "energy": (co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(timed)), co.GaussLegendre(2)),
        "torque": (BODY.with_forces(co.forces.Torque(lambda t: np.array([np.cos(t), 0.0, t]))), co.Splitting()),
    }[name]
    ready, ends, t_eval = co.prepare(system, method, 0.1), (4.5, 3.0), [4.47, 4.0, 3.72, 3.01]
    found = co.jax.solution(ready, ends, t_eval=t_eval, backend="xla")(X0)
    np.testing.assert_allclose(found, ready.run(X0, ends, t_eval=t_eval).x, rtol=0, atol=1e-13)


def test_stages_that_do_not_converge_are_nan():
    ready = prepared(method=co.GaussLegendre(2))
    f = co.jax.solution(ready, (0, 0.05), backend="xla")
    assert np.isfinite(f(X0)).all()
    with pytest.warns(co.LargeStepWarning, match=r"states are NaN from t = 0\.05 on"):
        assert np.isnan(f(1e3 * X0)[-1]).all()
    with pytest.warns(co.LargeStepWarning, match="states of member 1 are NaN"):
        jax.grad(lambda x0: f(x0).sum())(np.array([X0, 1e3 * X0]))
    assert np.isnan(jax.jit(f)(1e3 * X0)[-1]).all()  # whose numbers are not known: no warning
    # Also where the iteration is only too slow: every number that is returned is that of the converged stages.
    scales = 2.0 ** np.arange(0.0, 8.0, 0.25)
    ends = [f(scale * X0)[-1] for scale in scales]
    converged = [bool(np.isfinite(x).all()) for x in ends]
    assert converged == sorted(converged, reverse=True) and 8 < sum(converged) < 30
    for scale, x in zip(scales[converged], ends, strict=False):
        np.testing.assert_allclose(x, ready.run(scale * X0, (0, 0.05)).x[-1], rtol=1e-9)


SHARDED = """
import os
os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=4"
import numpy as np, jax, coadjoint as co
from jax.sharding import Mesh, NamedSharding, PartitionSpec

jax.config.update("jax_enable_x64", True)
assert len(jax.devices()) == 4
over_members = NamedSharding(Mesh(np.array(jax.devices()), ("members",)), PartitionSpec("members"))
ready = co.prepare(co.systems.rigid_body((1, 2, 2.5)), co.Splitting(), 0.05)
f, reference = (co.jax.solution(ready, (0, 0.5), save_every=5, backend=backend) for backend in ("xla", "compiled"))
many = np.random.default_rng(5).standard_normal((8, 3))
x0, inertia = jax.device_put(many, over_members), np.array([1.1, 2.0, 2.4])
compiled = jax.jit(f).lower(x0).compile()
found = compiled(x0)
assert found.sharding.spec[1] == "members" and len(found.sharding.device_set) == 4, found.sharding
assert "all-gather" not in compiled.as_text() and "all-reduce" not in compiled.as_text()
assert np.max(np.abs(found - ready.run(many, (0, 0.5), save_every=5).x)) < 1e-13

def gradients(f):
    return jax.jit(jax.grad(lambda x0, i: (f(x0, inertia=i)[-1] ** 3).sum(), (0, 1)))

of_x0, of_inertia = gradients(f)(x0, inertia)
assert of_x0.sharding.spec[0] == "members"
alone = gradients(reference)(many, inertia)
assert np.max(np.abs(of_x0 - alone[0])) < 1e-12 and np.max(np.abs(of_inertia - alone[1])) < 1e-11
print("sharded")
"""


@pytest.mark.long
def test_ensembles_are_sharded_over_devices():
    done = run_python(SHARDED)
    assert done.stdout == "sharded\n", done.stderr


COSH = co.LiePoissonSystem(
    co.algebras.so(3),
    co.Separable({0: (np.cosh, np.sinh, np.cosh), 1: (np.cos, lambda x: -np.sin(x), lambda x: -np.cos(x))}),
)
SPIN = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([0.1, 0.2, 0.3], [0.0, 0.1, -1.0]))
SPINS = co.systems.spin_lattice("ring", 4, field=(0.1, 0.2, 0.3))


def around(t):
    return np.array([np.cos(t), np.sin(t), 0.0])


def pulled(x, A):
    return -0.5 * np.array([A[2, 1] - A[1, 2], A[0, 2] - A[2, 0], A[1, 0] - A[0, 1]]) - x[:3]


def kicked(x, t):
    y = 0.0 * x
    y[1] += np.cos(t) * x[2]
    y[:2] *= 2.0
    return y if x[0] > 0.0 else -y


WHEELED = co.systems.body((1.0, 2.0, 2.5), wheels=0.1 * np.eye(3))
LAW = co.forces.Pointing(0.5, 1.5, error="quaternion")
forces, PLATES = co.forces, (([2.0, 1.0], [(1, 0, 0), (0, 1, 0)], [(0, 0, 0.5), (0.1, 0.2, 0.3)]))
RATES = ((0.1, 0.2, 0.0), (0.0, 0.3, 0.1), (0.1, 0.0, 0.2))


def filtered(omega, memory):
    rate = memory + 0.4 * (omega - memory)
    return -0.5 * rate, rate


SENSED = {"attitude": 0.05, "angular_velocity": (0.1, 0.2, 0.3)}
FORCED = {
    "damping, torque": (BODY, [forces.LinearDamping((0.1, 0.2, 0.3), (1.0, 0.0, 0.0)), forces.Torque((0.0, 0.3, 1.0))]),
    "energy of the time": (IN_TIME, [forces.DoubleBracketDamping(0.9)]),
    "heat bath": (SPIN, [forces.HeatBath(0.3, temperature=0.5, seed=7)]),
    "Hamiltonian noise": (
        BODY,
        [forces.HamiltonianNoise(np.eye(3) + 0.2, (0.5, 0.2, 0.3), seed=7, stream=3, levels=1)],
    ),
    "order 6": (BODY, [forces.Torque(lambda x, t: 0.3 * np.cos(x + t)), forces.LinearDamping(RATES, (1.0, 0.0, -0.5))]),
    "branches": (BODY, [forces.Torque(kicked)]),
    "sampled": (None, [forces.Sampled(forces.Pointing(0.5, 1.5), period=0.2, max_torque=0.3)]),
    "memory": (None, [forces.Sampled(forces.Torque(filtered), period=0.2, memory={"rate": 3}, delay=1)]),
    "sensors": (
        None,
        [
            forces.Sampled(
                forces.Torque(filtered), 0.2, memory={"rate": 3}, noise=SENSED, bias=SENSED, seed=7, stream=2
            ),
            forces.Magnetorquers(forces.BDot(0.8), period=0.2, B=around, noise={"field": 0.1}, seed=2**40),
        ],
    ),
    "coils": (None, [forces.Magnetorquers(forces.BDot(0.8), period=0.2, B=around, max_moment=0.3)]),
    "full damping": (BODY, [forces.LinearDamping(RATES), forces.LinearDamping(0.2, (0.3, 0.0, -0.5))]),
    "order 4 on the orbit": (SPIN, [forces.DoubleBracketDamping(0.1), forces.Torque((0.0, 0.3, 0.1))]),
    "of time": (BODY, [forces.Torque(lambda t: np.array([np.cos(t), 0.0, t]))]),
    "own flow": (BODY, [forces.OwnForce(lambda x, t, tau: x / (1.0 + np.abs(x) * tau), backward=False)]),
    "double bracket": (SPIN, [forces.DoubleBracketDamping(0.3, np.diag((1.0, 2.0, 3.0)) + 0.1)]),
    "full bath": (SPIN, [forces.HeatBath(0.3, np.diag((1.0, 2.0, 3.0)) + 0.1, temperature=0.5, seed=7, stream=3)]),
    "bath of spins": (SPINS, [forces.HeatBath(0.3, temperature=0.5, seed=2**40)]),
    "field on spins": (SPINS, [forces.RandomField(0.3, seed=2**40)]),
    "random torque": (None, [forces.RandomTorque(0.3, "space", seed=7)]),
    "Gilbert": (SPINS, [forces.Gilbert(0.3, temperature=0.5, seed=2**40)]),
    "Langevin": (BODY, [forces.Langevin((0.3, 0.2, 0.1), temperature=0.5, seed=7, stream=3)]),
    "functions": (COSH, [forces.DoubleBracketDamping(0.1)]),
    "attitude": (None, [forces.Torque(pulled)]),
    "gravity": (None, [forces.GravityGradient(1.0, around, quadrupole=(0.01, 0.02, 0.05))]),
    "magnet": (None, [forces.MagneticDipole((0, 0, 0.5), B=lambda t, r: r * np.cos(t), position=around)]),
    "light, drag": (
        None,
        [forces.SolarPressure(0.1, (1, 0, 0), *PLATES, specular=0.5), forces.Drag(0.1, around, *PLATES)],
    ),
    "quaternion": (None, [forces.Pointing(0.5, 1.5, error="quaternion", max_torque=0.3)]),
    "wheels": (WHEELED, [forces.ReactionWheels(LAW, period=0.2, max_torque=0.3, max_momentum=0.02)]),
    "thrusters": (None, [forces.Thrusters(LAW, period=0.2, max_torque=0.3, min_impulse=0.01)]),
}


@pytest.mark.parametrize("name", long_beyond(3, FORCED))
@pytest.mark.thinned(18)
def test_forces_have_the_flows_and_the_noise_of_the_compiled_run(name):
    """To the bits of the noise; members differ in it. Ten steps round a few times in each of at most 100 operations."""
    system, given = FORCED[name]
    forced = (system or co.systems.body((1.0, 2.0, 2.5))).with_forces(*given)
    x0 = 0.7 * np.cos(1.0 + np.arange(forced.dim))
    if system in (None, WHEELED):
        x0 = forced.state((0.6, 0.0, 0.0, 0.8), angular_velocity=(0.1, 0.2, 0.3))
    order = {"functions": 1, "order 4 on the orbit": 4, "order 6": 6}.get(name, 2)
    ready = co.prepare(forced, co.Splitting(order=order), 0.1)
    states = np.array([x0, x0]) if any(one.random for one in given) else x0
    f = co.jax.solution(ready, (0.2, 1.2), 5, backend="xla")
    wanted = ready.run(states, (0.2, 1.2), 5).x
    np.testing.assert_allclose(f(states), wanted, rtol=0, atol=1000 * 8 * UNIT_ROUNDOFF * np.abs(wanted).max())
    if len(states) == 2:
        assert np.abs(wanted[-1, 0] - wanted[-1, 1]).max() > 1e-3
    exact = "damping, torque", "double bracket", "order 6", "full bath", "Hamiltonian noise", "Gilbert", "Langevin"
    if name in exact:
        of_x0 = jax.grad(lambda x0: (weights(wanted) * f(x0)).sum())(states)
        _, pullback = ready.vjp(states, (0.2, 1.2), save_every=5)
        gradient = pullback(weights(wanted))["x0"]
        np.testing.assert_allclose(of_x0, gradient, rtol=0, atol=1e-10 * np.abs(gradient).max())


def by_rows(x, t, tau):
    y = x.copy().reshape(3, 2)  # momenta are the first row and half of the second
    y[0][1] -= 0.3 * tau * y[2][1]
    row = y[1]
    row[0] *= 1.0 - 0.2 * tau
    y[:, 0][0] += 0.1 * tau
    return y.ravel()


def test_functions_write_into_rows_and_columns_of_their_arrays():
    """As NumPy does, whose rows and columns are views."""
    ready = co.prepare(co.systems.heavy_top().with_forces(forces.OwnForce(by_rows, name="rows")), co.Splitting(), 0.1)
    x0 = 0.7 * np.cos(1.0 + np.arange(6))
    found = co.jax.solution(ready, (0.0, 0.5), backend="xla")(x0)
    np.testing.assert_allclose(found, ready.run(x0, (0.0, 0.5)).x, rtol=0, atol=1000 * UNIT_ROUNDOFF)


ATTITUDES = {
    "body": (BODY, co.Splitting(), True, {}),
    "free body": (co.systems.heavy_top(), co.Splitting(parts="free_body"), True, {"save_every": 4}),
    "members": (BODY, co.Splitting(), True, {"t_eval": [0.12, 0.5]}),
    "forces": (BODY.with_forces(co.forces.LinearDamping(0.1)), co.Splitting(), True, {"t_eval": [0.12, 0.5]}),
    "su(3)": (FREE, co.Splitting(), "coadjoint", {}),
}


@pytest.mark.parametrize("name", long_beyond(1, ATTITUDES))
def test_attitudes_are_those_of_the_compiled_run(name):
    system, method, attitude, options = ATTITUDES[name]
    ready = co.prepare(system, method, 0.1, attitude=attitude)
    x0 = 0.7 * np.cos(1.0 + np.arange(system.dim))
    states = np.array([x0, 2.0 * x0]) if name == "members" else x0
    f, reference = (co.jax.solution(ready, (0, 1), **options, backend=backend) for backend in ("xla", "compiled"))
    if name != "body":
        for found, wanted in zip(f(states), reference(states), strict=True):
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1000 * 8 * UNIT_ROUNDOFF)
        return
    turned, parts = np.diag((1.0, -1.0, -1.0)), []
    for run in (f, reference):

        def weighted(x0, inertia, A, run=run):
            x, A = run(x0, inertia=inertia, attitude0=A)
            return (weights(A) * A).sum(), (x, A)

        of_both = jax.jit(jax.value_and_grad(weighted, (0, 1), has_aux=True))
        parts.append([jax.tree.leaves(of_both(states, INERTIA, A)) for A in (np.eye(3), turned)])
    for found, wanted in zip(*map(jax.tree.leaves, parts), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-10 * max(1.0, np.abs(wanted).max()))
    A, B = (part[2] for part in parts[0])
    np.testing.assert_allclose(B, turned @ A, rtol=0, atol=1e-15)


SCHEMES = {str(one): one for one in EXAMPLES}


@pytest.mark.thinned(8)
@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("attitude", [False, True])
def test_registered_schemes_agree_with_the_compiled_run_or_are_refused(name, attitude):
    """By their name and with another backend."""
    method = SCHEMES[name]
    try:
        ready = co.prepare(BODY, method, 0.1, attitude=attitude)
    except ValueError:
        return  # not for this body, or without its attitude
    try:
        f = co.jax.solution(ready, (0, 1), 5, backend="xla")
    except TypeError as reason:
        assert str(method) in str(reason)
        assert method.own_steps or "compiled" in str(reason) or "compensated=False" in str(reason)
        assert type(method) is not co.Splitting or method.compensates
        return
    found, sol = f(X0), ready.run(X0, (0, 1), 5)
    found, wanted = (found, (sol.x, sol.attitude)) if attitude else ((found,), (sol.x,))
    for one, each in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one, each, rtol=0, atol=1000 * 8 * UNIT_ROUNDOFF)


INPUTS = {
    "all": (co.Splitting(), True),
    "a free body": (co.Splitting(parts="free_body"), {"g": (4, 3)}),
    "stages": (co.GaussLegendre(2), {"g": (4, 3)}),
}


@pytest.mark.parametrize("name", long_where(["a free body"], INPUTS))
@pytest.mark.thinned(2)
def test_inputs_and_gradients_by_them_are_those_of_the_compiled_run(name):
    """Of the linear term, also if they are not given."""
    method, named = INPUTS[name]
    ready = co.prepare(co.systems.heavy_top(), method, 0.05, inputs=named)
    f, x0 = co.jax.solution(ready, (0, 1), 5, backend="xla"), 0.7 * np.cos(1.0 + np.arange(6))
    key, u = ("linear", np.linspace(-0.3, 0.4, 6)) if named is True else ("g", np.array([0.3, -0.2]))
    sol, pullback = ready.vjp(x0, (0, 1), save_every=5, **{key: u})
    gradient = pullback(x=weights(sol.x))["inputs"][key]

    def weighted(u):
        x = f(x0, **{key: u})
        return (weights(sol.x) * x).sum(), x

    (found, x), of_inputs = jax.value_and_grad(weighted, has_aux=True)(u)
    tolerance = 1000 * 8 * UNIT_ROUNDOFF
    np.testing.assert_allclose(x, sol.x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(f(x0), ready.run(x0, (0, 1), 5).x, rtol=0, atol=tolerance)
    assert abs(found - (weights(sol.x) * sol.x).sum()) < sol.x.size * tolerance
    np.testing.assert_allclose(of_inputs, gradient, rtol=0, atol=32 * sol.x.size * tolerance)
    with refused(ValueError, "lever", "without inputs"):
        f(x0, lever=np.array([0.0, 0.0, 1.0]))


BODIES = co.batch([BODY, co.systems.rigid_body((1.0, 2.0, 3.0)), BODY])


@pytest.mark.parametrize(
    "method", long_beyond(1, [co.Splitting(), co.GaussLegendre(2), co.Splitting(parts="free_body")]), ids=str
)
def test_members_of_a_batch_have_their_own_constants(method):
    ready, states = co.prepare(BODIES, method, 0.1), np.array([X0, 2.0 * X0, X0[::-1]])
    f = co.jax.solution(ready, (0, 1), 5, backend="xla")
    sol, pullback = ready.vjp(states, (0, 1), save_every=5)
    tolerance = 1000 * 8 * UNIT_ROUNDOFF

    def weighted(x0):
        x = f(x0)
        return (weights(sol.x) * x).sum(), x

    found, x = jax.grad(weighted, has_aux=True)(states)
    np.testing.assert_allclose(x, sol.x, rtol=0, atol=tolerance)
    np.testing.assert_allclose(found, pullback(weights(sol.x))["x0"], rtol=0, atol=32 * sol.x.size * tolerance)
    with refused(ValueError, "inertia", "batch", "compiled"):
        f(states, inertia=np.ones((3, 3)))
    for backend in ("xla", "compiled"):
        with refused(ValueError, "x0", "(2, 3)", "(3, 3)"):
            co.jax.solution(ready, (0, 1), 5, backend=backend)(states[:2])
        of_batch = co.jax.solution(BODIES, (0, 1), 5, method=method, step=0.1, backend=backend)
        np.testing.assert_allclose(of_batch(states), sol.x, rtol=0, atol=tolerance)
    with refused(TypeError, "batch", "without a step"):
        co.jax.solution(BODIES, (0, 1))


@pytest.mark.parametrize(
    "transformed",
    [
        jax.vmap,
        pytest.param(lambda f: lambda x0: jax.jit(jax.vmap(jax.vmap(f)))(jnp.stack([x0, x0])), marks=pytest.mark.long),
        pytest.param(lambda f: jax.grad(lambda x0: (jax.vmap(f)(x0) ** 3).sum()), marks=pytest.mark.long),
        pytest.param(lambda f: lambda x0: jax.vmap(f)(x0, inertia=INERTIA + 0.1 * x0), marks=pytest.mark.long),
        pytest.param(lambda f: lambda x0: jax.lax.map(f, x0), marks=pytest.mark.long),
    ],
    ids=["vmap", "nested", "gradient", "parameters", "map"],
)
def test_members_that_vmap_makes_have_the_noise_of_the_compiled_run(transformed):
    """An ensemble in each case but the last two, whose runs all have the noise of the first member."""
    ready = co.prepare(BODY.with_forces(forces.HeatBath(0.3, temperature=0.5, seed=7)), co.Splitting(order=1), 0.1)
    f, reference = (co.jax.solution(ready, (0, 0.2), 2, backend=backend) for backend in ("xla", "compiled"))
    states = np.array([X0, X0])
    wanted = np.asarray(transformed(reference)(states))
    # Twenty operations with a matrix exponential each, and the third power.
    np.testing.assert_allclose(transformed(f)(states), wanted, rtol=0, atol=1e-12 * max(1.0, np.abs(wanted).max()))


# The algebra so(2,1) in a basis of a rotation and two boosts.
BOOSTS = co.LieAlgebra([(0, 1, 2, -1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3)


def test_blocks_of_every_kind_have_the_flows_and_derivatives_of_the_compiled_run():
    """Parts that turn, boost, grow, and are nilpotent up to the third degree."""
    algebra, h = co.algebras.direct_sum(BOOSTS, co.algebras.get("A5,2"), co.algebras.get("A3,7", a=0.5)), -0.5
    n = algebra.dim
    energy = co.Quadratic(np.linspace(0.3, 1.0, n), np.linspace(-0.2, 0.3, n))
    ready = co.prepare(co.LiePoissonSystem(algebra, energy, sign=-1), co.Splitting(order=1), abs(h))
    x0 = 0.7 * np.cos(1.0 + np.arange(n))
    wanted, first = compiled(ready, x0, (1.0, 1.0 + 2 * h))
    (_, x), (gradient, _) = gradients(ready, (1.0, 1.0 + 2 * h))(x0, {})
    np.testing.assert_allclose(x, wanted, rtol=0, atol=2.0**8 * UNIT_ROUNDOFF * max(1.0, np.abs(wanted).max()))
    np.testing.assert_allclose(gradient, first, rtol=0, atol=2.0**10 * UNIT_ROUNDOFF * np.abs(first).max())


def test_parameters_that_change_the_parts_are_refused():
    ready = co.prepare(co.LiePoissonSystem(co.algebras.so(3), full(3)), co.Splitting(), 0.1)
    f = co.jax.solution(ready, (0, 1), backend="xla")
    with refused(ValueError, "M ", "parts"):
        f(X0, M=np.eye(3))
