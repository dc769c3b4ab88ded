"""Taylor series in steps of their own: accuracy, closed forms, and where steps end."""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from drawn_matrices import full
from refusals import refused

pytestmark = pytest.mark.thinned(6)

U = 2.0**-53


def solvable():
    """Return a Lie algebra of dimension four that is no Lie algebra of volume-preserving flows."""
    return co.LieAlgebra.from_brackets(4, {(0, 1): {1: 1.0}, (0, 2): {2: 0.5}, (0, 3): {3: 1.5}, (1, 2): {3: 1.0}})


def systems():
    """One to several vectors of rows, every degree, unimodular and not."""
    so4, e3, so3 = co.algebras.so(4), co.algebras.e(3), co.algebras.so(3)
    cubic = co.Polynomial({(2, 0, 0): 0.5, (0, 2, 0): 1.0, (0, 0, 2): 0.25, (1, 1, 1): 0.25, (0, 3, 0): 0.125})
    squares = {tuple(2 * (k == i) for k in range(6)): 0.25 + 0.1 * i for i in range(6)}
    quartic = co.Polynomial(squares | {(1, 0, 1, 0, 2, 0): 0.2, (0, 1, 0, 0, 0, 1): -0.1})
    return {
        "so(3)": co.LiePoissonSystem(so3, co.Quadratic(full(3, 1, 0.4, (0.5, 1.5)))),
        "so(3), cubic": co.LiePoissonSystem(so3, cubic),
        "e(3)": co.LiePoissonSystem(e3, co.Quadratic([1.0, 0.5, 0.25, 0, 0, 0], linear=[0, 0, 0, 0.75, 0.5, 1.0])),
        "e(3), quartic": co.LiePoissonSystem(e3, quartic, sign=-1),
        "so(4)": co.LiePoissonSystem(so4, co.Quadratic(full(6, 2, 0.4, (0.5, 1.5)))),
        "su(3)": co.LiePoissonSystem(co.algebras.su(3), co.Quadratic(full(8, 3, 0.4, (0.5, 1.5)))),
        "so(5)": co.LiePoissonSystem(co.algebras.so(5), co.Quadratic(full(10, 4, 0.4, (0.5, 1.5)))),
        "solvable": co.LiePoissonSystem(solvable(), co.Quadratic(np.diag([1.0, 0.5, 0.25, 0.75]))),
        "toda": co.systems.toda(5),
    }


def start_for(system, seed=0):
    x = np.random.default_rng(system.dim + 100 * seed).uniform(-1.0, 1.0, system.dim)
    return x / np.linalg.norm(x) * np.sqrt(max(1.0, system.dim / 6))


def end_of(system, method, x, t, points=1):
    return co.integrate(system, x, (0.0, t), abs(t) / points, method, watch=False, save_every=points)


def own_steps(sol):
    return np.ravel(sol.stats.evaluations)[0] // sol.method.order


@pytest.mark.thinned(20)
@pytest.mark.parametrize("name", list(systems()))
@pytest.mark.parametrize("projected", [True, False])
@pytest.mark.parametrize("t", [2.0, -2.0])
def test_the_error_is_that_of_so_many_steps(name, projected, t):
    """Each step errs by the tolerance times the size, in the 1-norm, and errors grow by the condition of the motion."""
    system = systems()[name]
    x = start_for(system)
    exact = co.integrate(system, x, (0.0, t), 1 / 64, co.GaussLegendre(8), watch=False)
    size, states = np.max(np.sum(np.abs(exact.x), axis=1)), []
    condition = np.linalg.norm(co.Taylor(tolerance=1e-5).tangent(system, x, 0.0, t)[1], 2)
    for tolerance in (1e-3, 1e-5, 1e-8, 1e-11, 1e-14):
        method = co.Taylor(tolerance=tolerance, projected=projected)
        sol = end_of(system, method, x, t)
        allowed = own_steps(sol) * max(1.0, condition) * size * (2 * tolerance + 64 * U)
        assert np.linalg.norm(sol.x[-1] - exact.x[-1]) < allowed
        states.append(sol.x[-1])
    assert np.linalg.norm(states[0] - exact.x[-1]) > 1e-9  # the tolerance does something


@pytest.mark.parametrize("order", [1, 2, 3, 4, 7, 8, 9, 12, 16, 17, 24, 25, 30, 64])
def test_every_order_reaches_the_tolerance(order):
    system, x = systems()["so(4)"], start_for(systems()["so(4)"])
    tolerance = 1e-3 if order < 3 else 1e-6 if order < 8 else 1e-12
    exact = co.integrate(system, x, (0.0, 1.0), 1 / 64, co.GaussLegendre(8), watch=False).x[-1]
    sol = end_of(system, co.Taylor(order, tolerance=tolerance), x, 1.0)
    assert np.linalg.norm(sol.x[-1] - exact) < own_steps(sol) * 16 * tolerance
    assert sol.stats.evaluations % order == 0


@pytest.mark.long
def test_plain_steps_in_fifty_digits():
    body = co.systems.rigid_body(inertia=(1, 2, 2.5))
    with mpmath.workdps(50):
        x = np.array([mpmath.mpf(v) for v in (0.6, 0.3, 0.8)], dtype=object)
        ends = [co.Taylor(p, tolerance=1e-18).step(body, x, 0, mpmath.mpf(4)) for p in (24, 32)]
        assert 1e-24 < max(abs(ends[0] - ends[1])) < 1e-16
        assert abs(body.energy(ends[0]) - body.energy(x)) < 1e-48
    exact = body.exact((0.6, 0.3, 0.8), 4.0)
    assert np.max(np.abs(ends[1].astype(float) - exact)) < 64 * U


def test_steps_become_long_where_the_motion_calms_down():
    """The particles of a chain fly apart, and nothing turns any more."""
    chain = co.systems.toda(5)
    x0, method = np.concatenate([np.zeros(5), np.full(4, 0.5)]), co.Taylor(tolerance=1e-12)
    counts = [own_steps(end_of(chain, method, x0, t)) for t in (10.0, 1000.0, 1e5)]
    assert counts[0] >= 5 and counts[2] < 200
    sol = co.integrate(chain, x0, (0.0, 200.0), 0.5, method)
    exact = np.array([chain.exact(x0, t) for t in sol.t])
    assert np.max(np.abs(sol.x - exact)) < own_steps(sol) * 4 * 1e-12


@pytest.mark.thinned(1)
@pytest.mark.parametrize("projected", [True, False])
@pytest.mark.parametrize("rate", [0.7, -0.7, 70.0, 1e6, 1e-7])
def test_growth_and_decay_by_thirty_orders_of_magnitude(projected, rate):
    """x' = rate x: errors are relative to the largest size so far, where it grows to that of then."""
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    system = co.LiePoissonSystem(line, co.Quadratic(0.0, linear=[rate, 0.0]))
    slope = system.vector_field(np.array([0.0, 1.0]))[1]
    t = 69.0 / abs(rate)
    for tolerance in (1e-4, 1e-8, 1e-12):
        for start in (1.0, 1e-30, 1e100):
            for end in (t, -t):
                sol = end_of(system, co.Taylor(tolerance=tolerance, projected=projected), (0.0, start), end)
                exact = start * np.exp(slope * end)
                allowed = own_steps(sol) * (2 * tolerance + 256 * U) * max(start, exact)
                assert abs(sol.x[-1, 1] - exact) < allowed
                assert own_steps(sol) < 400


def test_a_motion_that_ends_is_refused_by_its_time():
    """x' = x^2 from one blows up at t = 1, wherever one looks."""
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    system = co.LiePoissonSystem(line, co.Polynomial({(1, 1): 1.0}))
    sign = np.sign(system.vector_field(np.array([0.0, 1.0]))[1])
    method = co.Taylor(tolerance=1e-9)
    for save_every, watch in ((1, True), (3, False), (20, True)):
        with refused(co.IntegrationError, "blows up") as failure:
            co.integrate(system, (0.0, 1.0), (0.0, 5.0 * sign), 0.25, method, save_every=save_every, watch=watch)
        assert failure.value.step == 5 and failure.value.time == sign
    with refused(co.IntegrationError, "blows up"):
        co.Taylor(tolerance=1e-9).step(system, np.array([0.0, 1.0]), 0.0, 2.0 * sign)
    ensemble = np.array([[0.0, 0.01], [0.0, 1.0], [0.0, 0.02]])
    with refused(co.IntegrationError, "1 of 3 members") as failure:
        co.integrate(system, ensemble, (0.0, 5.0 * sign), 0.25, co.Taylor(tolerance=1e-9))
    exact = ensemble[::2, 1] / (1.0 - 5.0 * ensemble[::2, 1])
    assert np.max(np.abs(failure.value.partial.x[-1, ::2, 1] - exact)) < 1e-9


def test_a_motion_that_is_too_fast_is_given_up_early():
    """After 2^k of its steps, k from 12 on, where 2^(k + 3 (24 - k)) would not be enough: probed on both sides."""
    plane = co.LieAlgebra.from_brackets(3, {(2, 0): {1: 1.0}, (2, 1): {0: -1.0}})
    turning = co.LiePoissonSystem(plane, co.Quadratic(0.0, linear=[0.0, 0.0, 1.0]))
    method, x0 = co.Taylor(tolerance=1e-3), (1.0, 0.0, 0.0)
    length = 200.0 / own_steps(end_of(turning, method, x0, 200.0))
    for steps_needed, power in ((2.0**48.5, 12), (2.0**47.5, 13), (2.0**46.5, 13), (2.0**45.5, 14)):
        for end in (length * steps_needed, -length * steps_needed):
            with refused(co.IntegrationError, "2^24 of its own steps") as failure:
                co.integrate(turning, x0, (0.0, end), abs(end), method)
            assert failure.value.step == 1 and abs(own_steps(failure.value.partial) - 2**power) <= 2
    # Thousands of steps are taken, and so is a fast beginning of a motion that slows down.
    assert own_steps(end_of(turning, method, x0, length * 2**14)) > 2**13
    line = co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}})
    decaying = co.LiePoissonSystem(line, co.Polynomial({(1, 1): 1.0}))
    way = -np.sign(decaying.vector_field(np.array([0.0, 1.0]))[1])
    for start in (1e10, 1e30, 1e60):
        sol = end_of(decaying, co.Taylor(tolerance=1e-9), (0.0, start), way)
        assert 0.5 < sol.x[-1, 1] < 2.0 and own_steps(sol) < 2000  # errors are relative to the start


def test_rest_and_motions_that_are_polynomials():
    body = co.systems.rigid_body(inertia=(1, 2, 2.5))
    for x0 in ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)):
        sol = co.integrate(body, x0, (0.0, 1e6), 1e5, co.Taylor(tolerance=1e-6))
        assert np.array_equal(sol.x, np.tile(x0, (11, 1)))
    plane = co.LiePoissonSystem(co.algebras.heisenberg(), co.Quadratic([0.5, 0.5, 0.0]))
    free = co.LiePoissonSystem(co.algebras.heisenberg(), co.Quadratic([0.5, 0.0, 0.0]))
    sol = co.integrate(free, (1.0, 0.5, 2.0), (0.0, 1000.0), 250.0, co.Taylor(tolerance=1e-6))
    slope = free.vector_field(np.array([1.0, 0.5, 2.0]))
    assert np.max(np.abs(sol.x - (sol.x[0] + sol.t[:, None] * slope))) < 1e4 * U
    assert own_steps(sol) <= 2
    assert own_steps(co.integrate(plane, (1.0, 0.5, 2.0), (0.0, 100.0), 1.0, co.Taylor(tolerance=1e-6))) > 10


@pytest.mark.long
def test_declarations():
    method, body = co.Taylor(tolerance=1e-9), co.systems.rigid_body(inertia=(1, 2, 2.5))
    assert method.own_steps and not co.Taylor(9).own_steps and not co.Splitting().own_steps
    assert co.Taylor().order == 16 and co.Taylor() == co.Taylor(16)
    orders = [co.Taylor(tolerance=tolerance).order for tolerance in (0.1, 1e-3, 1e-6, 1e-9, 1e-12, 1e-18)]
    assert orders == sorted(orders) and orders[0] >= 3 and orders[-1] <= 30
    assert method.properties(body) == co.Taylor(9).properties(body)
    found = co.certify(body, method, (0.3, 1.0, 0.2), 0.5, steps=100)
    assert found.passed
    assert found["reference"].verdict == "holds" and found["reference"].value < 20 * found["reference"].bound
    with refused(ValueError, "Taylor", "symmetric"):
        co.Composition(method, (0.5, 0.5))
    with refused(TypeError, "Taylor", "exact flows"):
        co.modified_hamiltonian(body, method)


def test_time_is_summed_exactly():
    """After 10^5 turns a body is where it was, but for the rounding of its motion: the time adds none."""
    body, x0, t = co.systems.rigid_body(inertia=(1, 2, 2.5)), np.array([0.6, 0.3, 0.8]), 2.0**20
    sol = end_of(body, co.Taylor(tolerance=1e-16), x0, t)
    error = np.max(np.abs(sol.x[-1] - body.exact(x0, t)))
    # A plain sum of a million steps would be off by up to 1e6 u t, and by about the root of that at random.
    assert error < 2e-9
