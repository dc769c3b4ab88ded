"""Tangent vectors in compiled loops equal products of exact tangents, and do not change the states."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

import coadjoint as co
from catalogue_cases import EXAMPLES, NAMES
from coadjoint.kernels.interface import limit
from coadjoint.kernels.tables.tangents import Frame
from coadjoint.methods.protocol.tangents import tangent_loop
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.runs.start import start_of
from coadjoint.runs.state import RunState
from coadjoint.runs.tangent_stretching import energy_loops
from coadjoint.runs.times import Times
from long import long_between, long_beyond
from started_runs import started

from .random_systems import drawn_bracket
from .schemes_under_test import large_step, schemes, serves, witnesses
from .systems_under_test import all_cases, full_matrix
from .tangent_products import NEVER, finished_vectors, product_of_tangents, run_with, stretches, tolerance

pytestmark = pytest.mark.thinned(6)

STEPS = 4


def wave(y, t):
    return math.cos(y) * (1.0 + 0.25 * t)


def wave_slope(y, t):
    return -math.sin(y) * (1.0 + 0.25 * t)


def wave_curvature(y, t):
    return -math.cos(y) * (1.0 + 0.25 * t)


def check(system, method, x0, h, t0=0.25, steps=STEPS):
    """Compare the vectors with the product of tangents, and the states with a run without vectors."""
    times = Times(t0, h, steps, steps).with_saved_steps([1, steps])
    units = np.eye(system.dim)
    run = run_with(system, method, x0, times, units)
    states, product, size = product_of_tangents(system, method, x0, times)
    found = finished_vectors(run, units)
    assert np.max(np.abs(found - product)) <= tolerance(system, method, times, size)
    assert np.array_equal(run.saved["x"][:, 0], states[[1, steps]])


def has_loop(method):
    return isinstance(method, co.methods.FlowMethod | co.methods.RungeKuttaMethod | co.Composition)


def carrying():
    """Return the pairs of systems and schemes whose loops move tangent vectors."""
    found = []
    for c, case in all_cases().items():
        for s, method in schemes().items():
            if serves(method, case.system) and has_loop(method):
                found.append((s, c))
    return found


@pytest.mark.thinned(112)
@pytest.mark.parametrize(("scheme", "case"), carrying())
def test_tangents_of_every_scheme_and_system(scheme, case):
    method, (system, x0, _) = schemes()[scheme], all_cases()[case]
    h = large_step(method) / 4
    check(system, method, x0, h)
    check(system, method, x0, -h)


def test_schemes_with_tangent_loops():
    for name, method in schemes().items():
        system = witnesses(method, "e(3), heavy top")[0].system
        loop = tangent_loop(method, system, 0.1, Frame(np.eye(system.dim), 1))
        assert (loop is not None) == has_loop(method), name


TRIED = (co.Splitting(order=2), co.Splitting(order=2, parts="coordinates"), co.GaussLegendre(2))


@pytest.mark.thinned(22)
@pytest.mark.parametrize("name", long_between(6, NAMES))
def test_tangents_on_the_catalogue(name):
    """Quadratic, polynomial and driven Hamiltonians, with all kinds of flows up to dimension 5."""
    algebra = co.algebras.get(name, **EXAMPLES.get(name, {}))
    n, rng = algebra.dim, np.random.default_rng(len(name))
    x0 = rng.uniform(0.3, 0.8, n)
    quartic = {
        tuple((k + 3) * (i == j) for j in range(n)): float(rng.uniform(0.1, 0.3)) for i in range(n) for k in range(2)
    }
    hamiltonians = (
        co.Quadratic(full_matrix(n, n), linear=rng.uniform(-0.25, 0.25, n)),
        co.Polynomial(quartic),
        co.Separable(dict.fromkeys(range(n), (wave, wave_slope, wave_curvature))),
    )
    for H, sign in zip(hamiltonians, (-1, 1, -1), strict=True):
        system = co.LiePoissonSystem(algebra, H, sign=sign, casimirs={})
        for method in TRIED:
            check(system, method, x0, -0.05 if sign > 0 else 0.05)


@pytest.mark.long
@pytest.mark.parametrize("sign", long_beyond(1, [1, -1]))
def test_tangents_where_j_is_a_function(sign):
    system, x0 = drawn_bracket(7, sign)
    for method in (co.GaussLegendre(2), co.ExplicitRungeKutta("rk4"), co.ModifiedGaussLegendre(2, freeze="structure")):
        check(system, method, x0, 0.1)


@pytest.mark.parametrize("compensated", [False, True])
def test_tangents_of_rotations_by_large_angles(compensated):
    """Angles of some radians, where d of 2 atan(phi/2) is far from 1."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    for rotation in ("rational", "exact"):
        method = co.Splitting(order=2, parts="coordinates", rotation=rotation, compensated=compensated)
        check(body, method, np.array([3.0, -2.0, 1.0]), 1.5)


def test_tangents_of_many_rotations_and_series():
    """so(6) has runs of eight angles and more; a full M on sl(3) has flows that are series."""
    rng = np.random.default_rng(3)
    for algebra, H in (
        (co.algebras.so(6), co.Quadratic(rng.uniform(0.5, 1.5, 15))),
        (co.algebras.sl(3), co.Quadratic(0.3 * full_matrix(8, 8))),
        (co.algebras.heisenberg(3), co.Quadratic(full_matrix(9, 7))),
    ):
        system = co.LiePoissonSystem(algebra, H, casimirs={})
        for method in TRIED:
            check(system, method, rng.uniform(-0.5, 0.5, algebra.dim), 0.1)


def test_tangents_of_large_states():
    """Beyond the largest dimension of lanes the loop takes one member at a time."""
    spins = limit("WIDEST") // 3 + 2
    algebra = co.algebras.copies(co.algebras.so(3), spins)
    n = algebra.dim
    system = co.LiePoissonSystem(algebra, co.Quadratic(np.tile([1.0, 0.5, 0.25], spins)), casimirs={})
    x0 = np.random.default_rng(8).uniform(-1.0, 1.0, n)
    method = co.Splitting(order=2, parts="coordinates")
    times, vectors = Times(0.0, 0.1, 3, 3).with_saved_steps([3]), np.eye(n)[[0, 1, n - 1]]
    run = run_with(system, method, x0, times, vectors)
    assert np.array_equal(run.saved["x"][0, 0], co.integrate(system, x0, (0, 0.3), 0.1, method, watch=False).x[-1])
    one = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25]))
    _, product, size = product_of_tangents(one, method, x0[:3], times)
    first = finished_vectors(run, vectors)
    bound = tolerance(one, method, times, size)
    assert np.max(np.abs(first[:3, :2] - product[:, :2])) <= bound and not first[3:, :2].any()


TOGETHER = (
    "Splitting 1",
    "Splitting 2",
    "Splitting 2 compensated",
    "Composition of Splitting",
    "GaussLegendre 1",
    "rk4",
)


@pytest.mark.thinned(18)
@pytest.mark.parametrize("case", all_cases())
def test_members_in_lanes_have_the_bits_of_single_runs(case):
    """Also with more vectors than lanes, and a member at rest."""
    system, x0, _ = all_cases()[case]
    ensemble = x0 * np.array([1.0, 0.9, 0.0, -0.8, 0.7])[:, None]
    for scheme in TOGETHER:
        method = schemes()[scheme]
        if not serves(method, system):
            continue
        given = {"t_span": (0.5, -0.5), "step": 0.0625, "method": method, "renormalize_every": 3, "save_every": 4}
        whole = co.lyapunov(system, ensemble, **given)
        for m, start in enumerate(ensemble):
            assert (
                np.ascontiguousarray(whole.stretches[:, m]).tobytes()
                == co.lyapunov(system, start, **given).stretches.tobytes()
            ), (scheme, m)


def test_leading_stretches_do_not_depend_on_vector_count():
    system = co.LiePoissonSystem(co.algebras.so(8), co.Quadratic(np.linspace(0.5, 1.5, 28)), casimirs={})
    ensemble = np.random.default_rng(9).uniform(-0.3, 0.3, (4, 28))
    every, few = (co.lyapunov(system, ensemble, (0, 2), 0.125, exponents=k) for k in (28, 2))
    assert np.ascontiguousarray(every.stretches[:, :, :2]).tobytes() == few.stretches.tobytes()


@pytest.mark.parametrize("scheme", ["Splitting 2", "Splitting 2 compensated", "GaussLegendre 2", "rk4"])
def test_run_with_tangents_resumes_from_its_state(scheme):
    """Also between two orthonormalizations."""
    method, (system, x0, _) = schemes()[scheme], all_cases()["e(3), heavy top"]
    times, ensemble = Times(0.25, 0.1, 12, 12).with_saved_steps([12]), x0 * np.linspace(0.9, 1.1, 4)[:, None]
    loop = tangent_loop(method, system, 0.1, Frame(np.eye(6)[::-1].copy(), 5))
    loops, start = energy_loops([system], method, 0.1, [loop]), start_of(system, method, ensemble, False)
    whole = started(system, method, loops, times, start, False)
    whole.advance()
    first = started(system, method, loops, times, start, False)
    first.advance(until=7)
    copied = RunState.from_mapping(first.state.to_mapping())
    second = started(system, method, loops, times, start, False, state=copied)
    second.advance()
    assert second.state == whole.state and np.array_equal(second.saved["x"], whole.saved["x"])


STRETCHED = (
    "Splitting 2",
    "Splitting 4",
    "Splitting 2 compensated",
    "GaussLegendre 2",
    "rk4",
    "Composition of GaussLegendre",
)


@pytest.mark.parametrize("scheme", STRETCHED)
def test_stretches_equal_those_of_the_product(scheme):
    """The diagonal of R in P V = Q R, with or without intermediate orthonormalization."""
    method, (system, x0, _) = schemes()[scheme], all_cases()["e(3), heavy top"]
    vectors = np.linalg.qr(np.random.default_rng(4).standard_normal((6, 6)))[0]
    for h in (0.1, -0.1):
        times = Times(0.0, h, 12, 12).with_saved_steps([12])
        _, product, size = product_of_tangents(system, method, x0, times)
        wanted = np.log(np.abs(np.diag(np.linalg.qr(product @ vectors.T)[1])))
        # An error of the product moves each logarithm by itself over the least stretch.
        bound = 6 * tolerance(system, method, times, size) / np.exp(wanted.min())
        for every in (1, 5, NEVER):
            run = run_with(system, method, x0, times, vectors, every)
            assert np.max(np.abs(stretches(run, 6)[0] - wanted)) <= bound
            assert np.array_equal(run.saved["x"][0, 0], co.integrate(system, x0, (0, 12 * h), 0.1, method).x[-1])


def test_stretches_are_accurate_over_many_steps():
    """x' = x: each step stretches by one float, whose power is computed in 60 digits."""
    line = co.LiePoissonSystem(co.LieAlgebra([(0, 1, 1, 1.0)], dim=2), co.Quadratic([0, 0], linear=[1.0, 0.0]))
    method, h = co.Splitting(order=1), 2.0**-10

    def products(steps):
        run = run_with(line, method, [1e-300, 1e-300], Times(0.0, h, steps, steps).with_saved_steps([]), np.eye(2), 1)
        return run.state["memory"][0, 4:10].reshape(2, 3), np.sort(np.abs(stretches(run, 2)[0]))

    (step, exponent), steps = products(1)[0][1][[0, 2]], 10**6
    (still, grown), logarithms = products(steps)
    assert still.tolist() == [0.5, 0.0, 1.0] and abs(math.log(step) + exponent * math.log(2.0)) >= 0.9 * h
    with mpmath.workdps(60):
        wanted = (mpmath.mpf(step) * mpmath.mpf(2) ** exponent) ** steps
        found = (mpmath.mpf(grown[0]) + mpmath.mpf(grown[1])) * mpmath.mpf(2) ** grown[2]
        # The low part of each product is rounded to a float.
        assert abs(found / wanted - 1) <= 4 * steps * UNIT_ROUNDOFF**2
        assert logarithms[0] == 0.0
        assert abs(logarithms[1] - abs(mpmath.log(wanted))) <= 4 * UNIT_ROUNDOFF * logarithms[1]
