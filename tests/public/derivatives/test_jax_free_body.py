"""The step of a free body as a function of JAX against 60 digits, its derivatives and transformations."""

import numpy as np
import pytest
from mpmath import mp

import coadjoint as co
from exact_body import exact_motion
from long import long_beyond
from rounding import UNIT_ROUNDOFF

jax = pytest.importorskip("jax")
jnp = jax.numpy

UNITS = {np.float64: UNIT_ROUNDOFF, np.float32: 2.0**-24}
# Inverse moments and momentum.
SHAPES = {
    "ball": ((1.0, 1.0, 1.0), (0.3, 0.7, -0.5)),
    "near the axis of symmetry": ((1.43875547, 0.55939662, 0.58660169), (-3.83793, 0.28704, 0.74043)),
    "separatrix": ((1.0, 2.0, 3.0), (1.0, 0.0, 1.0)),
    "rod": ((1.0, 1.0, 0.0), (0.6, 0.8, 0.0)),
    "plate": ((2 / 3, 1.0, 0.4), (0.3, 0.7, -0.5)),
    "symmetric top": ((1.0, 0.3, 1.0), (0.3, 0.7, -0.5)),
    "nearly a ball": ((1.0, 1 + 1e-12, 1 - 2e-12), (0.3, 0.7, -0.5)),
    "middle axis": ((1.0, 2.0, 3.0), (1e-9, 1.0, -1e-8)),
    "axis": ((2.0, 1.0, 3.0), (0.0, 0.0, -1.3)),
    "at rest": ((2.0, 1.0, 3.0), (0.0, 0.0, 0.0)),
}
AXES = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]


@pytest.fixture(autouse=True, params=[np.float64, np.float32])
def kind(request):
    jax.config.update("jax_enable_x64", request.param == np.float64)
    yield request.param
    jax.config.update("jax_enable_x64", False)


def inertia_of(m, kind):
    """Return the moments, zero for an inverse moment of zero, rounded."""
    m = np.array(m)
    return np.where(m == 0.0, 0.0, 1.0 / np.where(m == 0.0, 1.0, m)).astype(kind)


def exact(inertia, x, h):
    """Return momentum and rotation of the inertia as it was rounded."""
    with mp.workdps(40):
        m = [mp.mpf(0) if v == 0 else 1 / mp.mpf(float(v)) for v in inertia]
        end, R = exact_motion(m, [float(v) for v in x], float(h))
        return np.array(end, dtype=float), np.array(R.tolist(), dtype=float)


@jax.jit
def step_and_derivatives(x, A, inertia, h):
    """Return the step, and its derivatives by the momentum and the moments: one program for each precision."""

    def twice(x, inertia):
        end = co.jax.free_body(x, A, inertia, h)
        return end, end

    derivatives, end = jax.jacfwd(twice, (0, 1), has_aux=True)(x, inertia)
    return end, derivatives


def step_of(x, inertia, h):
    """Return the step of a body with the unit attitude."""
    return step_and_derivatives(x, np.eye(3, dtype=x.dtype), inertia, h)[0]


@pytest.mark.thinned(24)
@pytest.mark.parametrize("turns", [0.03, -0.3, *long_beyond(1, (3.0, 1e-8))])
@pytest.mark.parametrize("shape", SHAPES)
def test_motion_in_60_digits(shape, turns, kind):
    """A piece adds 3 u |x| and 10 u (1 + angle), and the motion carries errors of the momentum on.

    Inverse moments are rounded, and their products with the time: 3 u of the derivatives by them.
    """
    m, x = SHAPES[shape]
    inertia, x, u = inertia_of(m, kind), np.array(x, kind), UNITS[kind]
    rate = max(1e-300, np.linalg.norm(np.array(m) * x))
    h = kind(turns * 2 * np.pi / rate if x.any() else turns)
    # At rest the step makes the axes orthonormal in this precision.
    A = np.asarray(step_and_derivatives(x * 0, np.asarray(AXES, kind), inertia, h)[0][1])
    (end, A1), ((of_x, of_inertia), turned) = step_and_derivatives(x, A, inertia, h)
    assert end.dtype == A1.dtype == kind
    wanted, R = exact(inertia, x, h)
    size, angle = np.linalg.norm(x), max(m) * np.linalg.norm(x) * abs(float(h))
    pieces = 1 + (max(m) - min(m)) * size * abs(float(h)) / (0.15 if kind == np.float64 else 0.4)
    carried = max(1.0, np.linalg.norm(of_x)) * size
    rounded = np.linalg.norm(of_inertia * inertia)
    assert np.linalg.norm(end - wanted) <= u * (3 * pieces * carried + 3 * rounded)
    carried = 3 * pieces * size * np.linalg.norm(turned[0]) + 3 * np.linalg.norm(turned[1] * inertia)
    assert np.linalg.norm(A1 - A.astype(float) @ R) <= u * (10 * (pieces + angle) + carried + 8)
    assert np.abs(A1.T @ A1 - np.eye(3)).max() <= 8 * u


@pytest.mark.parametrize("sign", [1, -1])
def test_a_long_step_is_the_closed_form(sign, kind):
    """The rounding of the rates, of the period and of the rotation over it is some u of the angle."""
    x, inertia, h = np.ones(3), np.array((1.0, 2.0, 3.0)), sign * (1e6 if kind == np.float64 else 1e4)
    wanted = co.systems.rigid_body(inertia).exact(x, h, attitude=True)
    found = step_of(x.astype(kind), inertia.astype(kind), kind(h))
    bound = 20 * UNITS[kind] * (1 + np.linalg.norm(x / inertia) * abs(h))
    for one, other in zip(found, wanted, strict=True):
        assert np.abs(one - other).max() <= bound


@pytest.mark.thinned(2)
def test_a_tensor_is_that_of_the_rotated_body(kind):
    u, x, I, h = UNITS[kind], np.array((0.3, 0.7, -0.5), kind), np.array((1.0, 1.5, 2.5)), 2.5
    end, A = step_of(x, I.astype(kind), kind(h))
    tensor = (AXES @ np.diag(I) @ AXES.T).astype(kind)
    for skew in (0.0, [[0.0, 0.5, -0.25], [-0.5, 0.0, 0.125], [0.25, -0.125, 0.0]]):  # which does not count
        inertia = tensor + np.array(skew, kind)
        turned, B = co.jax.free_body((AXES @ x).astype(kind), np.eye(3, dtype=kind), inertia, kind(h))
        assert np.abs(AXES @ end - turned).max() <= 100 * u
        assert np.abs(AXES @ A @ AXES.T - B).max() <= 100 * u


def differences(function, values, along):
    """Return the derivative along a direction, by central differences of order six."""
    h = 2.0**-10
    ends = [np.asarray(function(*(v + k * h * d for v, d in zip(values, along, strict=True)))) for k in range(-3, 4)]
    weights = np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * h)
    return sum(w * end for w, end in zip(weights, ends, strict=True))


CASES = [(x, np.diag(1 / np.array(m)) if full else 1 / np.array(m), h) for full in (False, True)
    for name, h in (("axis", 0.3), ("ball", 0.7), ("symmetric top", 6.0), ("plate", 0.0), ("at rest", 0.5))
    for m, x in [SHAPES[name]]]  # fmt: skip


def step(x, inertia, h):
    x, A = co.jax.free_body(x, AXES, inertia, h)
    return jnp.append(x, A)


def both_modes(values, along, weights):
    _, forward = jax.jvp(step, values, along)
    return forward, jax.grad(lambda *v: weights @ step(*v), (0, 1, 2))(*values)


BOTH_MODES = jax.jit(both_modes)


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("x", "inertia", "h"), long_beyond(3, CASES[::-1]))
@pytest.mark.long
def test_derivatives_are_differences_in_both_modes(x, inertia, h, kind):
    """By all arguments, at equal moments, on axes and at rest; the error is h^6/140 of the seventh derivative."""
    if kind == np.float32:
        pytest.skip("differences need float64")
    rng = np.random.default_rng(1)
    values = (np.array(x), inertia, np.array(h))
    along = tuple(rng.standard_normal(v.shape) for v in values)
    weights = rng.standard_normal(12)
    forward, gradient = BOTH_MODES(values, along, weights)
    np.testing.assert_allclose(forward, differences(step, values, along), rtol=0, atol=1e-11)
    backward = sum((g * d).sum() for g, d in zip(gradient, along, strict=True))
    np.testing.assert_allclose(backward, weights @ forward, rtol=1e-12)
    if inertia.ndim == 1:  # by the time at the end: the field
        of_h = BOTH_MODES(values, (0 * along[0], 0 * along[1], np.array(1.0)), weights)[0]
        end, A = step(*values)[:3], step(*values)[3:].reshape(3, 3)
        np.testing.assert_allclose(of_h[:3], np.cross(end, end / inertia), rtol=0, atol=1e-13)
        np.testing.assert_allclose(of_h[3:].reshape(3, 3), A @ np.cross(np.eye(3), end / inertia), rtol=0, atol=1e-13)


@pytest.mark.long
def test_second_derivatives_and_attitudes(kind):
    if kind == np.float32:
        pytest.skip("differences need float64")
    x, inertia, h = np.array((0.3, 1.0, 0.2)), np.array((1.0, 1.5, 2.5)), 0.4
    u, v = np.array((0.5, -1.0, 0.3)), np.array((0.2, 0.4, 1.0))
    weights = np.random.default_rng(2).standard_normal(12)
    gradient = jax.grad(lambda x: weights @ step(x, inertia, h))
    both = jax.jit(lambda x, v: jax.jvp(gradient, (x,), (v,)))
    for start in (x, np.zeros(3)):
        product = both(start, v)[1]
        np.testing.assert_allclose(u @ product, v @ both(start, u)[1], rtol=0, atol=1e-14)
        np.testing.assert_allclose(product, differences(lambda x: both(x, v)[0], [start], [v]), rtol=0, atol=1e-11)
    # A rotation of space turns the attitude, and does nothing else.
    turn = np.array([[0.0, -0.3, 0.2], [0.3, 0.0, -0.1], [-0.2, 0.1, 0.0]])
    (_, A), (dx, dA) = jax.jvp(lambda A: co.jax.free_body(x, A, inertia, h), (np.eye(3),), (turn,))
    np.testing.assert_allclose(dA, turn @ A, rtol=0, atol=1e-14)
    assert not dx.any()


@pytest.mark.thinned(2)
def test_momenta_of_any_size_and_ensembles(kind):
    x, inertia, h = np.array((0.3, 1.0, 0.2), kind), np.array((1.0, 1.5, 2.5), kind), kind(4.0)
    wanted, A = step_of(x, inertia, h)
    for k in (-900, -64, 1, 900) if kind == np.float64 else (-100, -20, 1, 100):
        power = kind(2.0) ** k
        found, B = step_of(x * power, inertia, h / power)
        assert (found == wanted * power).all() and (A == B).all()
    many = jax.vmap(co.jax.free_body, (0, None, 0, None))
    times = [1.0, 0.01, 3.0]
    each = [step_of(x * kind(s), inertia / kind(s), h) for s in times]
    found = many(np.array([x * kind(s) for s in times]), np.eye(3, dtype=kind),
                 np.array([inertia / kind(s) for s in times]), h)  # fmt: skip
    for k in (0, 1):
        np.testing.assert_allclose(found[k], np.array([one[k] for one in each]), rtol=0, atol=200 * UNITS[kind])
