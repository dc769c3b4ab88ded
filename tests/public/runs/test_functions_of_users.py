"""Functions of the user: what is called, compiled again when it changes, refused, and fails."""

import ctypes
import dataclasses
import math
import subprocess
import sys
import types
import warnings

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

numba = pytest.importorskip("numba.extending")
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
NOTHING = co.methods.Properties(poisson=False, energy=False, casimirs="none", attitude="none")


def times(a):
    return lambda y: a * np.cosh(y), lambda y: a * np.sinh(y)


def spins(functions):
    count = len(functions)
    pairs = {3 * k: pair for k, pair in enumerate(functions)}
    return co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), count), co.Separable(pairs))


def test_one_text_at_many_sites():
    """Each spin turns about its axis, by a cosh(y)-slope that it keeps."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        system = spins([times(0.7251)] * 40 + [times(0.7251) for _ in range(40)])
        sol = co.integrate(system, np.tile([0.3, 0.4, -0.2], 80), (0.0, 0.5), 0.05, co.Splitting())
    angle = 0.5 * 0.7251 * np.sinh(0.3)
    sign = np.sign(system.vector_field(sol.x0)[1]) / np.sign(0.2)
    c, d = np.cos(angle), sign * np.sin(angle)
    turned = np.array([0.3, 0.4 * c + 0.2 * d, -0.2 * c + 0.4 * d])
    np.testing.assert_allclose(sol.x[-1].reshape(80, 3), np.tile(turned, (80, 1)), rtol=0, atol=1e-14)


STALE = """
import numpy as np, numba
K, A = 2.0, np.ones(20_000)
@numba.njit
def deepest(y): return K * y
@numba.njit
def helper(y): return deepest(y) * A[0]
def value(y): return 0.5 * helper(y) * y
def slope(y): return helper(y)
"""


@pytest.mark.parametrize("decorator", ["@numba.njit", ""])
def test_machine_code_follows_every_edit_also_of_the_same_system(decorator):
    """Of functions that the user has compiled, and of plain ones that are compiled with what calls them."""
    module = types.ModuleType("user_functions_of_a_test")
    exec(STALE.replace("@numba.njit", decorator), vars(module))
    system = co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (module.value, module.slope)}))

    def angle():
        end = co.integrate(system, [0.3, 1.0, 0.0], (0.0, 0.5), 0.5, co.Splitting()).x[-1]
        return abs(math.atan2(end[2], end[1]))

    def rate():
        return module.K * module.A[0] * 0.3 * 0.5

    assert module.helper(1.0) == 2.0  # has machine code of its own
    ready = co.prepare(system, co.Splitting(), 0.5)
    first = ready.run([0.3, 1.0, 0.0], (0.0, 0.5)).x[-1]
    for edit in (
        lambda: None,
        lambda: module.A.__setitem__(0, 3.0),
        lambda: setattr(module, "K", 1.0),
        lambda: exec(f"import numba\n{decorator}\ndef deepest(y): return 0.5 * K * y", vars(module)),
    ):
        edit()
        expected = rate() * (0.5 if getattr(module.deepest, "py_func", module.deepest)(1.0) != module.K else 1.0)
        assert angle() == pytest.approx(expected, rel=1e-14)
    np.testing.assert_array_equal(ready.run([0.3, 1.0, 0.0], (0.0, 0.5)).x[-1], first)


def described(y):
    return 2.0 * y if str(y) else 0.0


def doubled(y):
    return lambda y: 2.0 * y


def test_a_function_that_numba_knows_by_another_one_is_not_compiled_itself():
    """Numba does not compile `described`, and is given another function for it after other functions were compiled."""
    other = co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (lambda y: y**2 + 0.7, lambda y: 2.0 * y)}))
    co.integrate(other, [0.3, 1.0, 0.0], (0.0, 0.1), 0.1)
    numba.overload(described)(doubled)
    system = co.LiePoissonSystem(co.algebras.so(3), co.Separable({0: (lambda y: y**2, described)}))
    end = co.integrate(system, [0.3, 1.0, 0.0], (0.0, 0.5), 0.5, co.Splitting()).x[-1]
    assert abs(math.atan2(end[2], end[1])) == pytest.approx(0.3, rel=1e-14)


def test_what_cannot_be_followed_is_compiled_again_with_a_warning():
    library = ctypes.CDLL(None)
    library.labs.restype, library.labs.argtypes = ctypes.c_long, [ctypes.c_long]
    absolute = library.labs
    system = co.LiePoissonSystem(
        co.algebras.so(3), co.Separable({0: (lambda y: y * absolute(-1), lambda y: 1.0 * absolute(-1))})
    )
    with pytest.warns(UserWarning, match="compiled again"):
        co.prepare(system, co.Splitting(), 0.1)


def squares(x):
    return 0.5 * np.sum(np.arange(1.0, len(x) + 1.0) * x**2)


def slopes(x):
    return np.arange(1.0, len(x) + 1.0) * x


@pytest.mark.parametrize("order", [1, -1])
def test_one_function_serves_systems_of_several_dimensions(order):
    """As Hamiltonian, as invariant and as what is observed; the first use compiles it for one dimension alone."""
    algebras = [co.algebras.so(3), co.algebras.e(3), co.algebras.so(5)][::order]
    for g in algebras:
        x0 = np.linspace(0.1, 0.9, g.dim)
        plain = co.LiePoissonSystem(g, co.Quadratic(np.arange(1.0, g.dim + 1)))
        own = co.LiePoissonSystem(g, co.Hamiltonian(squares, slopes))
        wanted = co.integrate(plain, x0, (0, 1), 0.125, co.GaussLegendre(2))
        found = co.integrate(own, x0, (0, 1), 0.125, co.GaussLegendre(2), observe={"squares": squares})
        np.testing.assert_allclose(found.x, wanted.x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(found.observed["squares"], wanted.energy, rtol=1e-12)


def test_the_refusal_of_a_run_names_the_function():
    body = co.systems.rigid_body((1, 2, 3))
    with refused(TypeError, "height", "Numba"):
        co.integrate(body, (1, 0, 0.5), (0, 1), 0.5, observe={"height": lambda x: open(str(x[0]))})


WITHOUT_FUNCTIONS = """
import sys
import coadjoint as co
body = co.systems.rigid_body((1, 2, 3))
for method in (co.Splitting(), co.GaussLegendre(2), co.RadauEnergy(2)):
    co.integrate(body, (0.8, 0.5, 0.6), (0, 0.5), 0.1, method)
print("numba" in sys.modules)
"""


@pytest.mark.long
def test_numba_is_loaded_for_functions_of_the_user_alone():
    done = subprocess.run([sys.executable, "-c", WITHOUT_FUNCTIONS], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def refuse_large(y):
    if y > 0.9:
        raise ValueError("outside the domain")
    return y


def test_a_function_that_raises_stops_the_run():
    """What it raised cannot leave the compiled loop; the state must not go on with numbers that nobody computed."""
    H = co.Separable({0: (lambda y: 0.5 * y * y, refuse_large), 1: (lambda y: y * y, lambda y: 2 * y)})
    s = co.LiePoissonSystem(co.algebras.so(3), H)
    free = co.Separable({0: (lambda y: 0.5 * y * y, lambda y: y), 1: (lambda y: y * y, lambda y: 2 * y)})
    reference = co.integrate(co.LiePoissonSystem(co.algebras.so(3), free), (0.8, 0.5, 0.6), (0, 5), 0.1)
    crossing = int(np.argmax(reference.x[:, 0] > 0.9))
    assert crossing > 0
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(s, (0.8, 0.5, 0.6), (0, 5), 0.1)
    assert failure.value.step <= crossing + 1
    assert np.all(np.isfinite(failure.value.partial.x))
    assert np.array_equal(failure.value.partial.x, reference.x[: len(failure.value.partial.x)])


# These functions read the entry max(0, 4 t - 39) of three: 1 at the start, and beyond them from t = 10.5 on.
START, STEP = 10.0, 0.25
BODY = co.systems.rigid_body(inertia=(1, 2, 3))
FACTORS = np.array([1.0, 1.5, 2.0])
FLUID = co.systems.sphere_euler(N=3)
X0 = np.array([0.8, 0.5, 0.6])


@dataclasses.dataclass(frozen=True)
class Beyond(co.methods.StepMethod):
    order, explicit, symmetric = 1, True, False

    def properties(self, system):
        return NOTHING

    def step(self, system, x, t, h):
        return x + h * x[max(0, int(4.0 * t) - 39)] * system.vector_field(x, t)


def with_torque(torque, system=BODY):
    return system.with_forces(co.forces.Torque(torque))


W0 = np.array([[0.5, 0.9, -0.2], [0.1, -0.5, 0.8], [0.3, 0.0, 0.1]])
RUNS = {
    "step": lambda: (BODY, Beyond(), X0),
    "torque of time": lambda: (
        with_torque(lambda t: np.array([0.1, 0.2, 0.3])[max(0, int(4.0 * t) - 39)] * np.ones(3)),
        co.Splitting(order=2),
        X0,
    ),
    "own flow": lambda: (
        BODY.with_forces(
            co.forces.OwnForce(lambda x, t, tau: x * np.exp(-tau * x[max(0, int(4.0 * t) - 39)] ** 2), name="drag")
        ),
        co.Splitting(order=2),
        X0,
    ),
    "torque on matrices": lambda: (
        with_torque(lambda x, t: 0.1 * FACTORS[max(0, int(4.0 * t) - 39)] * x, FLUID),
        co.IsospectralGauss(1),
        FLUID.random(seed=1),
    ),
    "stream": lambda: (
        co.MatrixSystem(
            co.MatrixAlgebra("gl", 3),
            lambda W, t: FACTORS[max(0, int(4.0 * t) - 39)] * W.T,
            energy=lambda W, t: 0.5 * np.sum(W * W),
        ),
        co.IsospectralGauss(1),
        W0,
    ),
    "Hamiltonian": lambda: (
        co.LiePoissonSystem(
            co.algebras.so(3),
            co.Hamiltonian(
                lambda x, t: 0.5 * FACTORS[max(0, int(4.0 * t) - 39)] * (x[0] * x[0] + 2.0 * x[1] * x[1]),
                lambda x, t: FACTORS[max(0, int(4.0 * t) - 39)] * np.array([1.0, 2.0, 0.0]) * x,
            ),
        ),
        co.GaussLegendre(1),
        X0,
    ),
}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", RUNS)
def test_a_run_fails_before_it_uses_what_is_beside_an_array(name):
    """Until then it has the bits of a run that ends earlier; all stages are evaluated within a step."""
    system, method, x0 = RUNS[name]()
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(system, x0, (START, START + 2.0), STEP, method)
    partial = failure.value.partial
    # The first step is whole; the second one may evaluate at its end.
    assert 1 <= failure.value.step <= 3 and np.all(np.isfinite(partial.x))
    early = co.integrate(system, x0, (START, START + STEP), STEP, method)
    assert np.array_equal(partial.x[: len(early.x)], early.x) and not np.array_equal(early.x[0], early.x[-1])
