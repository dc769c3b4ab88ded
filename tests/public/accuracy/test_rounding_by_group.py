"""Errors by group of coordinates, and the warning of rounding, at many ratios of sizes."""

import functools
import re
import warnings

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import coadjoint as co
from long import long_beyond
from refusals import refused
from rounding import UNIT_ROUNDOFF

STEPS, STEP, ANGLE = 96, 2 * np.pi / 48, 0.2
METHOD = co.Splitting(order=4)


@functools.cache
def body(moments, mass, gravity):
    """A satellite whose potential is one function of a user: its torque is what is left of the central force."""
    a, b, c = moments

    def value(r):
        square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
        if square == 0.0:  # with a comparison, a function is not recorded and taken apart
            return -np.inf
        along = (a * r[0] ** 2 + b * r[1] ** 2 + c * r[2] ** 2) / square
        return -gravity * (mass + (a + b + c - 3 * along) / (2 * square)) * square**-0.5

    def gradient(r):
        square = r[0] ** 2 + r[1] ** 2 + r[2] ** 2
        along = (a * r[0] ** 2 + b * r[1] ** 2 + c * r[2] ** 2) / square
        factor = mass + (3 * (a + b + c) - 15 * along) / (2 * square)
        strength = gravity * square**-1.5
        result = 0 * r
        result[0] = strength * (factor + 3 * a / square) * r[0]
        result[1] = strength * (factor + 3 * b / square) * r[1]
        result[2] = strength * (factor + 3 * c / square) * r[2]
        return result

    parts = [((i,), co.Quadratic(1 / moment)) for i, moment in enumerate((a, b, c))]
    parts += [((3, 4, 5), co.Quadratic(1 / mass)), ((6, 7, 8), co.Hamiltonian(value, gradient))]
    return co.LiePoissonSystem(co.systems.satellite().algebra, co.SplitHamiltonian(parts), sign=-1, name="small body")


def satellite(ratio):
    """Mass, radius and gravity are 1, and the moments of inertia are 1, 2 and 2.5 divided by the ratio."""
    return body((1.0 / ratio, 2.0 / ratio, 2.5 / ratio), 1.0, 1.0)


def start(ratio):
    """A circular orbit, the body turned from the radius in its plane."""
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    return np.array([0.0, 0.0, 2.5 / ratio, -s, c, 0.0, c, s, 0.0, 1.0])


GROUPS = {"L": slice(0, 3), "p": slice(3, 6), "r": slice(6, 9), "z": slice(9, 10)}


@functools.cache
def exact(ratio):
    """The states of the same scheme in 50 digits, after every twelfth step."""
    with mpmath.workdps(50):
        states = [np.array([mpmath.mpf(float(v)) for v in start(ratio)], dtype=object)]
        for _ in range(STEPS):
            states.append(METHOD.step(satellite(ratio), states[-1], 0, mpmath.mpf(STEP)))
        return np.array(states[::12], dtype=float)


def told(call):
    """Return the result of a call and its warnings."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = call()
    return result, [one for one in found if one.category in (co.RoundingWarning, co.LargeStepWarning)]


def run(ratio, method=METHOD):
    return told(lambda: co.integrate(satellite(ratio), start(ratio), (0, STEPS * STEP), STEP, method))


def following(ratio, times):
    """The motion by DOP853, with the torque 3 r cross I r / |r|^5 in place of r cross dV/dr."""
    moments = np.array([1.0, 2.0, 2.5]) / ratio

    def field(t, x):
        L, p, r = x[:3], x[3:6], x[6:]
        spin, square = L / moments, r @ r
        along = (moments * r) @ r / square
        factor = 1 + (3 * moments.sum() - 15 * along) / (2 * square) + 3 * moments / square
        torque = 3 * square**-2.5 * np.cross(r, moments * r)
        turned = [np.cross(L, spin) + torque, np.cross(p, spin) - square**-1.5 * factor * r, np.cross(r, spin) + p]
        return np.concatenate(turned)

    tolerance = np.repeat([1e-13 / ratio, 1e-13, 1e-13], 3)
    x0 = start(ratio)[:9]
    return solve_ivp(field, (0, times[-1]), x0, method="DOP853", rtol=1e-12, atol=tolerance, t_eval=times).y.T


@pytest.mark.parametrize("ratio", [1e2, 1e8, 1e14, 1e15])
def test_errors_at_the_end_are_those_of_the_groups(ratio):
    """By truncation at small ratios, and by rounding at large ones."""
    sol, _ = run(ratio)
    motion, estimate = following(ratio, sol.t), sol.error_estimate(by_group=True)
    for name in ("L", "p", "r"):
        part = GROUPS[name]
        size = np.linalg.norm(motion[:, part], axis=1).max()
        error = np.linalg.norm(sol.x[-1, part] - motion[-1, part]) / size
        assert error / 10 < estimate[name] < 10 * error
    assert list(estimate) == list(GROUPS) and estimate["z"] == UNIT_ROUNDOFF
    assert sol.error_estimate() == max(estimate.values())


@pytest.mark.parametrize(("ratio", "warned"), long_beyond(2, [(1e14, False), (2e15, True), (1e8, False)]))
def test_the_warning_of_rounding_states_its_size(ratio, warned):
    """Above 2 per cent of a group there is one, and below half a per cent none; the error is that of 50 digits."""
    sol, found = run(ratio)
    off, size = (  # at every twelfth step
        np.array([np.linalg.norm(states[:, part], axis=1).max() for part in GROUPS.values()])
        for states in (sol.x[::12] - exact(ratio), exact(ratio))
    )
    worst = max(off / size)
    assert worst > 0.02 if warned else worst < 0.006
    assert [one.category for one in found] == [co.RoundingWarning] * warned
    if warned:
        message = re.fullmatch("rounding changes (.) in this motion by about (.*) of its size.*", str(found[0].message))
        assert message[1] == "L" and worst / 4 < float(message[2]) < 4 * worst
        assert "nearly cancel" in message[0] and "radians" not in message[0]
        assert found[0].filename == __file__
        (again,) = [one for one in run(ratio)[1]]
        assert str(again.message) == str(found[0].message)


@pytest.mark.parametrize("size", [1e12, 1e15, 1e20])
def test_the_warning_names_an_angle_without_digits(size):
    """A symmetric body precesses at (1/2 - 1) x3: its steps are exact, but for the rounding of their angle."""
    body, x0 = co.systems.rigid_body((1, 1, 2)), np.array([1.0, 0.2, 0.5]) * size
    _, found = told(lambda: co.integrate(body, x0, (0, 10), 0.1))
    assert [one.category for one in found] == [co.RoundingWarning] * (size > 1e14)
    for message in (str(one.message) for one in found):
        angle = float(re.search("turns it by about (.*) radians", message)[1])
        wanted = 0.1 * 0.5 * x0[2] * np.hypot(*x0[:2]) / np.linalg.norm(x0)
        assert "cancel" not in message and "shorter span" in message and 2 / 3 < angle / wanted < 3 / 2


@pytest.mark.parametrize("method", [co.ExplicitRungeKutta("rk4"), co.Splitting(order=2), co.Splitting(order=6)])
def test_the_warning_comes_for_any_scheme_and_shorter_steps_do_not_help(method):
    for steps in (4 * STEPS, 16 * STEPS):
        step = STEPS * STEP / steps
        _, found = told(lambda step=step: co.integrate(satellite(1e17), start(1e17), (0, STEPS * STEP), step, method))
        assert co.RoundingWarning in [one.category for one in found]


def test_of_ensembles_a_member_is_named_alone_in_a_batch_and_prepared():
    """The small body is also the last of a batch; others keep their digits."""
    states = np.array([start(1e4), start(1e4), start(2e15)])
    systems = [satellite(1e4), satellite(1e4), satellite(2e15)]
    sol, found = told(lambda: co.integrate(co.batch(systems), states, (0, STEPS * STEP), STEP, METHOD))
    (message,) = [str(one.message) for one in found if one.category is co.RoundingWarning]
    assert " L " in message and "member 2" in message
    alone, found = run(2e15)
    np.testing.assert_array_equal(sol.x[:, 2], alone.x)
    errors = sol.error_estimate(by_group=True)["L"]
    assert errors.shape == (3,) and errors[2] == alone.error_estimate(by_group=True)["L"] > 1e3 * errors[0]
    prepared = co.prepare(satellite(2e15), METHOD, STEP)
    with pytest.warns(co.RoundingWarning) as first:
        prepared.run(start(2e15), (0, STEPS * STEP))
    assert str(first[0].message) == str(found[0].message)


def spins(ratio, rate=1.0):
    """Two spins, the second smaller by the ratio, that turn about each other's directions at comparable rates."""
    H = np.diag([1.0, 2.0, 3.0, *(rate * ratio * np.array([1.0, 2.0, 3.0]))])
    H[0, 3] = H[3, 0] = 0.3
    return co.LiePoissonSystem(co.algebras.direct_sum(co.algebras.so(3), co.algebras.so(3)), co.Quadratic(H))


SPINS = np.array([0.3, 1.0, 0.2, 0.5, 0.4, 0.8])


@pytest.mark.parametrize("ratio", [1.0, 1e4, 1e8, 1e12])
def test_small_groups_that_keep_their_digits_do_not_warn(ratio):
    system, x0 = spins(ratio), SPINS / np.repeat([1.0, ratio], 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        sol = co.integrate(system, x0, (0, 20), 0.05, METHOD, save_every=20)
    better = co.integrate(system, x0, (0, 20), 0.05 / 8, METHOD, save_every=160)
    errors = np.linalg.norm((sol.x - better.x).reshape(-1, 2, 3), axis=2)[-1] / np.linalg.norm(x0.reshape(2, 3), axis=1)
    assert list(sol.error_estimate(by_group=True).values()) == pytest.approx(errors, rel=0.5)


@pytest.mark.parametrize("ratio", [1.0, 1e4, 1e8, 1e12])
def test_a_small_spin_that_steps_do_not_follow_is_warned_of(ratio):
    """The second spin turns at 20 times the rate of the first; its size does not matter."""
    x0 = SPINS / np.repeat([1.0, ratio], 3)
    system = co.LiePoissonSystem(
        co.algebras.direct_sum(co.algebras.so(3), co.algebras.so(3)),
        co.Quadratic([1.0, 2.0, 3.0, *(20.0 * ratio * np.array([1.0, 2.0, 3.0]))]),
    )
    with pytest.warns(co.LargeStepWarning):
        sol = co.integrate(system, x0, (0, 10), 0.1)
    assert sol.step_error() > 0.05
    first, second = sol.step_error(by_group=True).values()
    assert second > 0.1 > 0.02 > first
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        co.integrate(system, x0, (0, 10), 0.005)


@pytest.mark.parametrize("start_of_L", [0.0, 1e-17, 1e-300])
def test_groups_that_are_zero_but_for_rounding_do_not_warn(start_of_L):
    """The angular momentum of a body on a Kepler orbit whose moments are equal is fed by rounding alone."""
    ratio = 1e3
    body = co.LiePoissonSystem(
        satellite(ratio).algebra,
        co.SplitHamiltonian(
            [((i,), co.Quadratic(ratio)) for i in range(3)]
            + [((3, 4, 5), co.Quadratic(1.0)), ((6, 7, 8), co.Hamiltonian(lambda r: -((r @ r) ** -0.5)))]
        ),
        sign=-1,
    )
    x0 = start(ratio)
    x0[:3] = 0.0, 0.0, start_of_L
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        sol = co.integrate(body, x0, (0, STEPS * STEP), STEP, METHOD)
    assert sol.error_estimate(by_group=True)["r"] < 1e-3


def test_by_group_is_a_bool():
    sol = co.integrate(co.systems.rigid_body(), (0.3, 1.0, 0.2), (0, 1), 0.1)
    for name in ("error_estimate", "step_error"):
        with refused(TypeError, "by_group", "'L'"):
            getattr(sol, name)(by_group="L")
        assert list(getattr(sol, name)(by_group=True)) == ["x"]
        assert getattr(sol, name)(by_group=True)["x"] == getattr(sol, name)()


def test_groups_in_any_order_of_the_coordinates():
    """A fast and a slow body, of sizes 1 and 1000, with their coordinates one after the other and in turn."""
    brackets, H = co.algebras.copies(co.algebras.so(3), 2), np.array([1.0, 0.5, 0.4, 2e-3, 1e-3, 5e-4])
    x0, order = np.array([0.3, 1.0, 0.2, 500.0, 100.0, 800.0]), np.array([0, 3, 1, 4, 2, 5])
    place, (i, j, k, c) = np.argsort(order), brackets.triples
    mixed = co.LieAlgebra(np.stack([place[i], place[j], place[k], c], axis=1).tolist(), dim=6)
    for quantity in ("error_estimate", "step_error"):
        found = [
            sorted(
                getattr(co.integrate(co.LiePoissonSystem(g, co.Quadratic(M)), x, (0, 4), 0.1), quantity)(
                    by_group=True
                ).values()
            )
            for g, M, x in ((brackets, H, x0), (mixed, H[order], x0[order]))
        ]
        assert found[0][1] > 3 * found[0][0] and found[1] == pytest.approx(found[0], rel=1e-6)


@functools.cache
def pair():
    """Two particles on a line with a spring, in canonical coordinates: momenta are fed by a difference of positions."""
    spring = co.Hamiltonian(lambda q: 0.5 * (q[0] - q[1]) ** 2 + 0.1 * (q[0] - q[1]) ** 4)
    H = co.SplitHamiltonian([((0, 1), spring), ((2, 3), co.Quadratic(1.0))])
    return co.LiePoissonSystem(co.algebras.heisenberg(2), H)


@pytest.mark.parametrize("method", [METHOD, co.GaussLegendre(2), co.ExplicitRungeKutta("rk4")])
@pytest.mark.parametrize(("offset", "warned"), [(1e4, False), (1e8, False), (1e12, None), (1e14, True)])
def test_momenta_beside_large_positions(offset, warned, method):
    """The same motion around the origin is the reference; errors of both by truncation are equal."""
    x0, span = np.array([0.5, -0.5, 0.3, -0.2, 1.0]), (0, 100)
    far = x0 + np.array([offset, offset, 0, 0, 0])
    sol, found = told(lambda: co.integrate(pair(), far, span, 0.05, method))
    assert warned is None or [one.category for one in found] == [co.RoundingWarning] * warned
    near = co.integrate(pair(), x0, span, 0.05, method)
    rounded = np.abs(sol.x - near.x)[:, 2:4].max(axis=0) / np.abs(near.x)[:, 2:4].max(axis=0)
    errors, by_step = sol.error_estimate(by_group=True), near.error_estimate(by_group=True)
    for name, error in zip(("p1", "p2"), rounded, strict=True):
        total = np.hypot(error, by_step[name])
        assert total / 10 < errors[name] < 10 * total
    # A momentum of which each step loses most digits does not count; the other is as wrong.
    assert sol.error_estimate() == pytest.approx(max(errors.values()), rel=0.5)
    assert warned is None or (rounded.max() > 0.02) == warned


@pytest.mark.parametrize("size", [1e-310, 1e-160, 1e160, 1e300])
@pytest.mark.parametrize("group", [0, 1])
def test_groups_whose_squares_are_no_numbers_raise_no_warning(group, size):
    """Beside others of size one."""
    lattice = co.systems.spin_lattice("chain", 2)
    x0 = np.array([0.3, 0.2, 0.8, -0.5, 0.4, 0.1])
    x0[3 * group : 3 * group + 3] *= size
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("default", co.LongWait)  # of a busy machine
        sol = co.integrate(lattice, x0, (0, 1 / max(1.0, size)), 0.1 / max(1.0, size))
        sol.step_error(by_group=True), sol.error_estimate(by_group=True)


def test_rounding_is_restored():
    one, small = np.float64(1.0), np.float64(2.0**-60)
    run(2e15)
    assert one + small == one - small == 1.0
