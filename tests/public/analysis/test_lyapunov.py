"""Lyapunov exponents: where they are known, their statistics by definition, and the same bits in any company."""

import math
import warnings

import numpy as np
import pytest
from scipy.special import stdtrit

import coadjoint as co
from refusals import refused

UPRIGHT = np.array([1.0, 0.5, -0.75, 0.6, 0.0, 0.8])  # of the chaotic region: its exponent is some 0.12
BODY = co.systems.rigid_body(inertia=(1, 2, 3))


SCHEMES = (
    co.Splitting(order=4),
    co.Splitting(order=2, parts="coordinates"),
    co.Composition(co.Splitting(order=2), (0.75, -0.5, 0.75)),
    co.GaussLegendre(2),
    co.ExplicitRungeKutta("rk4"),
    co.ModifiedGaussLegendre(2),
    co.IteratedGaussLegendre(2),
)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("method", SCHEMES, ids=str)
def test_the_unstable_axis_of_a_body(method):
    """At rest the exponents are the eigenvalues of the linear equation; those of a step of order p differ by O(h^p)."""
    rate = math.sqrt((1 / 1 - 1 / 2) * (1 / 2 - 1 / 3))
    found = [
        co.lyapunov(BODY, (0.0, 1.0, 0.0), (0, 320), h, method, transient=64).exponents - [rate, 0.0, -rate]
        for h in (0.2, 0.1)
    ]
    coarse, fine = (abs(each).max() for each in found)
    assert fine <= 0.1**method.order
    assert fine <= 1.2 * coarse / 2**method.order + 1e-14


@pytest.mark.thinned(5)
@pytest.mark.parametrize(
    "name, parameters", [("sl(2)", {}), ("A3,7", {"a": 0.75}), ("A4,7", {}), ("so(2,2)", {}), ("A5,40", {})]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_linear_hamiltonians(name, parameters, sign):
    """H = l . x moves by exp(t D), whose exponents are the real parts of the eigenvalues: of any sum."""
    algebra = co.algebras.so(2, 2) if name == "so(2,2)" else co.algebras.get(name, **parameters)
    linear = np.random.default_rng(len(name)).uniform(0.25, 0.75, algebra.dim)
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.zeros(algebra.dim), linear=linear), sign=sign, casimirs={})
    wanted = np.sort(np.linalg.eigvals(system.jacobian(np.zeros(algebra.dim))).real)[::-1]
    x0 = np.random.default_rng(1).uniform(0.1, 0.2, algebra.dim) * 1e-30  # so that what grows does not overflow
    for method in (co.Splitting(order=2), co.GaussLegendre(4)):
        found = co.lyapunov(system, x0, (0, 80), 0.05, method, transient=40)
        # Vectors of equal exponents turn into each other: the time is 40, and what they gain on the way is some units.
        assert np.max(np.abs(np.sort(found.exponents)[::-1] - wanted)) <= 0.05, method
        assert abs(found.sum - wanted.sum()) <= 1e-8
        backward = co.lyapunov(system, x0, (80, 0), 0.05, method, transient=40)
        assert np.max(np.abs(np.sort(backward.exponents) + wanted)) <= 0.05
        assert abs(backward.sum + wanted.sum()) <= 1e-8


def test_the_sum_is_the_mean_divergence():
    """A3,7 is not unimodular: volumes grow by the trace of the derivative of the field, averaged along the way."""
    system = co.systems.paper_a37(2.0, (1.0, 1.5, 0.3))
    x0, h, steps = np.array([0.7, 0.5, 0.6]), 1 / 256, 1024
    found = co.lyapunov(system, x0, (0, steps * h), h, co.Splitting(order=4))
    states = co.integrate(system, x0, (0, steps * h), h, co.Splitting(order=4)).x
    trace = np.array([np.trace(system.jacobian(x)) for x in states])
    # Simpson's rule, of the fourth order as the scheme is.
    mean = (trace[0] + trace[-1] + 4 * trace[1::2].sum() + 2 * trace[2:-1:2].sum()) / (3 * steps)
    assert abs(mean) > 0.1 and abs(found.sum - mean) < 1e-8


def bits(result, members=slice(None)):
    return result.stretches[:, members].tobytes()


@pytest.mark.parametrize("method", [co.Splitting(order=2), co.GaussLegendre(2), co.ExplicitRungeKutta("rk4")], ids=str)
def test_same_bits_alone_in_an_ensemble_on_threads_and_in_pieces(method):
    system, rng = co.systems.heavy_top(inertia=(1.0, 1.75, 2.5), lever=(0.5, 0.25, 1.0)), np.random.default_rng(2)
    ensemble = UPRIGHT + 0.1 * rng.standard_normal((37, 6))
    given = {"t_span": (0.0, 20.0), "step": 0.1, "method": method, "renormalize_every": 7}
    whole = co.lyapunov(system, ensemble, **given, save_every=20, threads=1)
    assert whole.exponents.shape == (37, 6) and whole.history.shape == (10, 37, 6) and whole.sum.shape == (37,)
    threads = co.lyapunov(system, ensemble, **given, save_every=20, threads=3)
    assert bits(threads) == bits(whole)
    pieces = co.lyapunov(system, ensemble, **given, save_every=1, threads=1)
    assert pieces.stretches[::20].tobytes() == bits(whole)
    for member in (0, 20, 36):
        alone = co.lyapunov(system, ensemble[member], **given, save_every=20)
        assert alone.stretches.tobytes() == bits(whole, member)
        for name in ("exponents", "uncertainty", "sum", "pairing"):
            np.testing.assert_array_equal(getattr(whole, name)[member], getattr(alone, name), err_msg=name)
        np.testing.assert_array_equal(whole.history[:, member], alone.history)
    some = co.lyapunov(system, ensemble[:3], **given, save_every=20, exponents=2)
    assert some.stretches.tobytes() == np.ascontiguousarray(whole.stretches[:, :3, :2]).tobytes()


def test_the_transient_is_taken_off():
    whole = co.lyapunov(BODY, (0.4, 1.0, 0.3), (0, 30), 0.1, save_every=50)
    later = co.lyapunov(BODY, (0.4, 1.0, 0.3), (0, 30), 0.1, save_every=50, transient=10.0)
    every = co.lyapunov(BODY, (0.4, 1.0, 0.3), (0, 30), 0.1, save_every=50, renormalize_every=10)
    assert np.array_equal(every.stretches, whole.stretches)
    assert np.array_equal(later.t, [10.0, 15.0, 20.0, 25.0, 30.0])
    assert np.array_equal(later.stretches, whole.stretches[2:] - whole.stretches[2])
    assert np.array_equal(later.exponents, later.stretches[-1] / 20.0)
    backward = co.lyapunov(BODY, (0.4, 1.0, 0.3), (30, 0), 0.1, save_every=50, transient=10.0)
    assert np.array_equal(backward.exponents, backward.stretches[-1] / 20.0)
    assert np.array_equal(backward.t, [20.0, 15.0, 10.0, 5.0, 0.0])


@pytest.mark.parametrize("points", [1, 2, 3, 7, 10, 23, 200])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_statistics_of_members_by_their_definitions(points, sense):
    """Of drawn stretches that are not in order, at times of which the last interval is a short one."""
    rng = np.random.default_rng(points)
    t = 5.0 + sense * np.append(3.0 * np.arange(points), 3.0 * points - 1.0)
    stretches = np.cumsum(rng.normal([0.5, -0.2, 0.9, -2.0], 1.0, (points + 1, 3, 4)), axis=0)
    stretches -= stretches[0]
    found = co.LyapunovExponents(t, stretches, 4, "compiled")
    elapsed = np.abs(t - t[0])
    for m in range(3):
        own = stretches[:, m]
        history = own[1:] / elapsed[1:, None]
        last = history[-1]
        np.testing.assert_allclose(found.history[:, m], history, rtol=1e-14)
        np.testing.assert_allclose(found.exponents[m], last, rtol=1e-14)
        assert found.sum[m] == pytest.approx(own[-1].sum() / elapsed[-1], rel=1e-12)
        low, second, third, high = sorted(last)
        assert found.pairing[m] == pytest.approx(max(abs(low + high), abs(second + third)), rel=1e-12)
        if points < 2:
            assert np.isnan(found.uncertainty[m]).all()
            continue
        rates = [(own[k + 1] - own[k]) / (elapsed[k + 1] - elapsed[k]) for k in range(points)]
        scatter = np.std(rates, axis=0, ddof=1) / np.sqrt(points) * stdtrit(points - 1, 0.97725) / 2
        later = [np.abs(history[k - 1] - last) for k in range(1, points + 1) if k >= points // 2]
        wanted = np.maximum(scatter, np.max(later, axis=0))
        if points < 16:
            np.testing.assert_allclose(found.uncertainty[m], wanted, rtol=1e-4)
        else:  # from a few frequencies of independent rates
            assert np.all(np.max(later, axis=0) <= found.uncertainty[m] * (1 + 1e-12))
            assert np.all((0.25 * wanted < found.uncertainty[m]) & (found.uncertainty[m] < 5 * wanted))
    first = np.max(found.exponents, axis=1)
    assert f"until t = {t[-1]:g}: the largest of each from {first.min():.4g} to {first.max():.4g}>" in repr(found)
    assert np.isnan(co.LyapunovExponents(t, stretches[..., :3], 4, "compiled").pairing).all()


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_saved_times_are_each_so_many_steps_and_the_last(sense):
    given = {"step": 0.1, "renormalize_every": 4}
    for steps, transient, every in ((30, 5, 7), (30, 0, 30), (30, 29, 1), (30, 0, 1000), (25, 4, 7), (450, 250, None)):
        span = (2.0, 2.0 + sense * 0.1 * steps)
        found = co.lyapunov(BODY, (0.4, 1.0, 0.3), span, transient=0.1 * transient, save_every=every, **given)
        wanted = [*range(transient, steps, every or 1), steps]
        np.testing.assert_allclose(found.t, 2.0 + sense * 0.1 * np.array(wanted), rtol=0, atol=1e-12)
        assert np.all(found.stretches[0] == 0.0) and len(found.stretches) == len(wanted)


def test_members_of_a_batch_go_step_by_step_by_their_own_systems():
    bodies = co.batch([co.systems.rigid_body(inertia=(1.0, 2.0, third)) for third in (3.0, 2.25)])
    x0, given = np.array([[0.1, 1.0, 0.1], [0.3, 0.8, 0.2]]), {"renormalize_every": 4, "save_every": 8}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        together = co.lyapunov(bodies, x0, (0, 2), 0.125, co.RadauEnergy(1), **given)
        for m, body in enumerate(bodies):
            alone = co.lyapunov(body, x0[m], (0, 2), 0.125, co.RadauEnergy(1), **given)
            assert together.stretches[:, m].tobytes() == alone.stretches.tobytes()


def test_a_member_that_fails_leaves_the_others_theirs():
    cubic = co.LiePoissonSystem(co.algebras.sl(2), co.Polynomial({(3, 0, 0): 1.0, (0, 3, 0): 1.0, (0, 0, 3): 1.0}))
    starts = np.array([[0.1, 0.05, 0.02], [40.0, 30.0, 20.0], [0.05, 0.1, 0.05]])
    for method in (co.Splitting(order=2), co.ExplicitRungeKutta("rk4")):
        with refused(co.IntegrationError, "1 of 3 members", "member 1") as failure:
            co.lyapunov(cubic, starts, (0, 10), 0.1, method)
        partial = failure.value.partial
        assert np.isfinite(partial.exponents[[0, 2]]).all() and np.isnan(partial.exponents[1]).all()
        alone = co.lyapunov(cubic, starts[2], (0, 10), 0.1, method)
        assert alone.stretches.tobytes() == partial.stretches[:, 2].tobytes()


def test_vectors_that_become_parallel_are_refused():
    """Between two times that they are made orthonormal they part by e^(2 * 0.29 t): beyond 2^26 nothing is left."""
    given = {"x0": (0.0, 1.0, 0.0), "t_span": (0.0, 200.0), "step": 0.1}
    assert np.isfinite(co.lyapunov(BODY, **given, renormalize_every=100).exponents).all()
    with refused(co.IntegrationError, "renormalize_every") as failure:
        co.lyapunov(BODY, **given, renormalize_every=1000)
    assert failure.value.step == 1000
    with refused(ValueError, "renormalize_every than 10000"):
        co.lyapunov(BODY, **given, renormalize_every=10000)
    quick = {"x0": (0.0, 10.0, 0.0), "t_span": (0.0, 10.0), "step": 0.1, "renormalize_every": 50}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for method in (co.GaussLegendre(2), co.RadauEnergy(1)):
            with refused(co.IntegrationError, "renormalize_every") as failure:
                co.lyapunov(BODY, **quick, method=method)
            assert failure.value.step == 50


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"exponents": 4}, ["exponents"]),
        ({"renormalize_every": 0}, ["renormalize_every"]),
        ({"transient": -1.0}, ["transient", "-1.0"]),
        ({"transient": 10.0}, ["transient", "10"]),
        ({"transient": 0.05}, ["step", "0.1", "0.05"]),
        ({"t_span": (0.0, 0.0)}, ["transient", "0"]),
        ({"x0": (1.0, 2.0)}, ["x0", "(2,)"]),
        ({"method": "splitting"}, ["'splitting'", "'Splitting'"]),
    ],
)
def test_wrong_input_is_refused_by_name(changes, named):
    given = {"system": BODY, "x0": (0.4, 1.0, 0.3), "t_span": (0.0, 10.0), "step": 0.1} | changes
    with refused((ValueError, TypeError), *named):
        co.lyapunov(**given)


def test_functions_need_their_second_derivatives():
    so3 = co.algebras.so(3)
    square = (lambda y: 0.5 * y * y, lambda y: y, lambda y: 1.0 + 0.0 * y)
    known = co.LiePoissonSystem(so3, co.Separable(dict.fromkeys(range(3), square)))
    assert co.lyapunov(known, (1.0, 0.5, 0.2), (0, 5), 0.1).exponents.shape == (3,)
    unknown = co.LiePoissonSystem(so3, co.Separable(dict.fromkeys(range(3), square[:2])))
    for method in (co.Splitting(order=2), co.GaussLegendre(1)):
        with refused(TypeError, "second derivatives", "hessian"):
            co.lyapunov(unknown, (1.0, 0.5, 0.2), (0, 5), 0.1, method)
    with refused(TypeError, "member 1 of the batch", "second derivatives"):
        co.lyapunov(co.batch([known, unknown]), (1.0, 0.5, 0.2), (0, 5), 0.1)
    spun = co.PoissonSystem(lambda x: np.array([[0.0, x[0]], [-x[0], 0.0]]), co.Quadratic([1.0, 1.0]))
    with refused(TypeError, "derivative of J", "derivative="):
        co.lyapunov(spun, (1.0, 0.5), (0, 5), 0.1, co.GaussLegendre(1))
