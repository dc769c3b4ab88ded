"""Functions of the user on XLA: idioms of NumPy, functions that are traced as others, and their starts and scales."""

from functools import partial

import numpy as np
import pytest

import coadjoint as co
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF

jax = pytest.importorskip("jax")
numba = pytest.importorskip("numba")
jitable = pytest.importorskip("numba.extending").register_jitable


@pytest.fixture(autouse=True)
def double_precision():
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@jitable
def turned(a):
    a -= 2 * np.pi * np.floor(a / (2 * np.pi))
    return a


@jitable
def doubled(y):
    y *= 2.0
    return y


def names_of_a_number(x, t):
    s, u = x[0], t
    old = s
    s += 1.0
    u *= 2
    return old + 0.1 * t


def running_total(x, t):
    total = 0 * x[0]
    last = total
    for i in range(3):
        last = total
        total += x[i] ** 2
    return last


def number_of_a_caller(x, t):
    a = 9.0 * x[0]
    return 0.1 * (a - turned(a))


def array_of_a_caller(x, t):
    y = x[:3].copy()
    doubled(y)
    return y[0]


def reshaped(x, t):
    y = x[:6].copy()
    y.reshape(2, 3)[1, 0] = x[0] * x[1]
    y.ravel()[4] += t
    return y[3] - y[4]


def transposed(x, t):
    A = np.outer(x[:2], x[:3])
    A.T[2, 1] = x[0]
    return A[1, 2] + A[0, 1]


def pieces(x, t):
    y = x[:3].copy()
    first, rest = np.split(y, [1])
    rest[0] = 0.7 * x[0]
    first += rest[1]
    return y[0] * y[1]


def rows(x, t):
    A = np.outer(x[:3], x[:3])
    for row in A:
        row -= row.sum() / 3
    A[1][:2][0] += x[0]
    return A[1, 0] - A[2, 2]


def sorted_in_place(x, t):
    y = x[:3].copy()
    y.sort()
    return y[0] - 0.5 * y[2]


def strided(x, t):
    y = x[:5].copy()
    y[::2][1] += x[0]
    y[1:4][2] *= 3.0
    return y[2] + y[3] - y[0]


def lengths(x, t):
    return np.linalg.norm(x[:3]) - np.sqrt(np.sum(x[3:6] ** 2))


IDIOMS = [names_of_a_number, running_total, number_of_a_caller, array_of_a_caller, reshaped, transposed]
IDIOMS += [pieces, rows, sorted_in_place, strided, lengths]
CALLED = [jitable(one) for one in IDIOMS]
a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, a10 = CALLED


def all_idioms(x, t):
    y = 0.0 * x
    y[0], y[1], y[2], y[3] = a0(x, t), a1(x, t), a2(x, t), a3(x, t)
    y[4], y[5], y[6], y[7] = a4(x, t), a5(x, t), a6(x, t), a7(x, t)
    y[8], y[9], y[10], y[11] = a8(x, t), a9(x, t), a10(x, t), x[0]
    return y


# Spherical bodies, whose momenta only torques change.
SO3_4 = co.algebras.direct_sum(*[co.algebras.so(3)] * 4)
SPHERES = co.LiePoissonSystem(SO3_4, co.Quadratic(np.ones(12)))
SPHERE = co.systems.rigid_body((1.0, 1.0, 1.0))


def runge_kutta(f, x, t, tau):
    """The flow of a torque of the state."""
    k1 = f(x, t)
    k2 = f(x + 0.5 * tau * k1, t + 0.5 * tau)
    k3 = f(x + 0.5 * tau * k2, t + 0.5 * tau)
    return x + tau * (k1 + 2 * k2 + 2 * k3 + f(x + tau * k3, t + tau)) / 6


def test_idioms_of_numpy_are_those_of_numpy_and_of_the_compiled_run():
    """Each in a component of the torque; flows of NumPy are the absolute reference."""
    ready = co.prepare(SPHERES.with_forces(co.forces.Torque(all_idioms)), co.Splitting(), 0.1)
    x = x0 = 0.8 * np.cos(1.0 + np.arange(12))
    found = co.jax.solution(ready, (0.2, 0.5), backend="xla")(x0)
    for t in (0.2, 0.3, 0.4):
        for begin in (t, t + 0.05):
            x = runge_kutta(all_idioms, x, begin, 0.05)
    # Six flows of four evaluations of some twenty operations.
    for wanted in (x, ready.run(x0, (0.2, 0.5)).x[-1]):
        np.testing.assert_allclose(found[-1], wanted, rtol=0, atol=6 * 4 * 20 * UNIT_ROUNDOFF * np.abs(x).max())


SLOPE = 0.3


@numba.njit
def squared(a):
    z = np.zeros(3)
    z[1] = a * a
    return z


def created(x, t):
    """Arrays that the function makes, also in functions that it calls, are assigned numbers of JAX."""
    y, empty, ones, M = np.zeros(12), np.empty(3), np.ones(3), np.zeros((3, 3))
    for i in range(3):
        empty[i] = x[i] * (i + 1)
        M[i, i] = x[i + 1]
    M[0][1] = t
    ones += x[:3]
    like = np.zeros_like(ones)
    like[2] = SLOPE * x[4]
    listed, full, unit = np.array([0.0, 1.0]), np.full(2, 0.5), np.eye(2)
    listed[1], full[0], unit[0, 1] = x[5], x[6], x[7]
    y[:3] = -0.5 * empty + like
    y[3:6] += M @ ones
    y[6:8] = unit @ (listed * full)
    if x[8] > 0.0:
        y[8] = x[9]
    y[9:] = squared(x[10])
    return 0.1 * y


def closure(rate):
    def torque(x):
        y = np.zeros(3)
        y[0] = rate * x[0]
        return y + squared(x[1])

    return torque


def created_slope(x):
    M, slope = np.zeros((3, 3)), np.empty(3)
    for i in range(3):
        M[i, i] = 2.0 * x[i]
    slope[:] = M @ np.ones(3)
    slope[0] = np.sinh(x[0])
    return slope


def test_entries_of_new_arrays_are_assigned():
    """Of forces by the flow of NumPy, the absolute reference, as above; of a Hamiltonian by the compiled run."""
    own = closure(0.2)
    for system, torque, field, n in ((SPHERES, created, created, 12), (SPHERE, own, lambda x, t: own(x), 3)):
        ready = co.prepare(system.with_forces(co.forces.Torque(torque)), co.Splitting(), 0.1)
        x = x0 = 0.8 * np.cos(1.0 + np.arange(n))
        found = co.jax.solution(ready, (0.2, 0.5), backend="xla")(x0)
        for begin in (0.2, 0.25, 0.3, 0.35, 0.4, 0.45):
            x = runge_kutta(field, x, begin, 0.05)
        np.testing.assert_allclose(found[-1], x, rtol=0, atol=6 * 4 * 20 * UNIT_ROUNDOFF * np.abs(x).max())
    cosh = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(potential, created_slope, curvature))
    ready, x0 = co.prepare(cosh, co.GaussLegendre(2), 0.1), np.array([0.4, 0.3, 0.2])
    found = co.jax.solution(ready, (0, 0.2), backend="xla")(x0)
    np.testing.assert_allclose(found, ready.run(x0, (0, 0.2)).x, rtol=0, atol=1e-13)  # the last corrections of stages


# NumPy returns the array itself, and JAX cannot.
def other_torque(x):
    y = 0.0 * x
    np.asarray(y)[0] = x[1]
    return y


# NumPy and compiled functions refuse an index, and JAX takes the nearest one.
def index_beyond(x):
    y = 0.1 * x
    y[0] = x[np.argmax(x) + 2]
    return y


def other_law(x, A):
    y = -1.5 * x[:3]
    np.asarray(y)[1] = A[0, 1]
    return y


def other_slope(x):
    y = 2.0 * x
    np.asarray(y)[0] = np.sinh(x[0])
    return y


def other_field(t, r):
    y = r * np.cos(t)
    np.asarray(y)[2] += 1.0
    return y


def other_flow(x, t, tau):
    y = x.copy()
    np.asarray(y)[0] += tau * t
    return y


def around(t):
    return np.array([np.cos(t), np.sin(t), 0.0])


def potential(x):
    return np.cosh(x[0]) + x[1] ** 2 + x[2] ** 2


def curvature(x):
    return np.diag(np.array([np.cosh(x[0]), 2.0, 2.0]))


forces, BODY = co.forces, co.systems.body((1.0, 2.0, 2.5))
OTHERS = {
    "Torque": (SPHERE.with_forces(forces.Torque(other_torque)), co.Splitting()),
    "Hamiltonian": (
        co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(potential, other_slope, curvature)),
        co.GaussLegendre(2),
    ),
    "OwnForce": (SPHERE.with_forces(forces.OwnForce(other_flow, name="OwnForce")), co.Splitting()),
    "index, Torque": (SPHERE.with_forces(forces.Torque(index_beyond)), co.Splitting()),
    "attitude, Torque": (BODY.with_forces(forces.Torque(other_law)), co.Splitting()),
    "law, Sampled": (BODY.with_forces(forces.Sampled(forces.Torque(other_law), period=0.2)), co.Splitting()),
    "B, MagneticDipole": (
        BODY.with_forces(forces.MagneticDipole((0, 0, 0.5), B=other_field, position=around)),
        co.Splitting(),
    ),
}


@pytest.mark.parametrize("name", long_beyond(3, OTHERS))
def test_functions_that_are_traced_as_others_are_refused_by_name(name):
    """At the first call, and where the start is not known."""
    system, method = OTHERS[name]
    x0 = system.state(angular_velocity=(0.1, 0.2, 0.3)) if system.has_attitude else np.array([0.4, 0.3, 0.2])
    f = co.jax.solution(co.prepare(system, method, 0.1), (0, 0.2), backend="xla")
    for called in (f, jax.jit(f)):
        with refused(TypeError, name.split()[-1], "another function", "in place of", "compiled"):
            called(x0)


@pytest.mark.parametrize("scale", [1e-7, pytest.param(1e30, marks=pytest.mark.long)])
def test_functions_are_compared_at_the_scale_of_the_start(scale):
    """A torque that is other only for momenta of this size; in other units it is the same to rounding."""

    def torque(x):
        y = -0.1 * x
        np.asarray(y)[0] += 1e-3 * scale * np.exp(-(x[1] ** 2) / scale**2)
        return y

    ready = co.prepare(SPHERE.with_forces(forces.Torque(torque)), co.Splitting(), 0.1)
    f = partial(co.jax.solution, ready, (0, 0.1), backend="xla")
    x0 = np.array([0.4, 0.3, 0.2])
    with refused(TypeError, "Torque", "another function"):
        f()(scale * x0)
    if scale < 1.0:
        wanted = ready.run(1e3 * x0, (0, 0.1)).x
        np.testing.assert_allclose(f()(1e3 * x0), wanted, rtol=4 * UNIT_ROUNDOFF)
