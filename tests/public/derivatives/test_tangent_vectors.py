"""Tangent vectors of Lyapunov exponents: products of the tangents of single steps."""

import mpmath
import numpy as np
import pytest

import coadjoint as co
from rounding import UNIT_ROUNDOFF

H = 0.1


def wave(y, t):
    return np.cos(y) * (1.0 + 0.25 * t)


def wave_slope(y, t):
    return -np.sin(y) * (1.0 + 0.25 * t)


def wave_curvature(y, t):
    return -np.cos(y) * (1.0 + 0.25 * t)


def full(algebra, sign=-1):
    n = algebra.dim
    B = np.random.default_rng(n).uniform(-0.3, 0.3, (n, n)) / n
    return co.LiePoissonSystem(algebra, co.Quadratic(np.eye(n) + B + B.T, linear=np.linspace(-0.2, 0.3, n)), sign=sign)


G3 = co.algebras.A3_7(0.75)
# All kinds of flows: rotations by eight and more angles, shears, series, functions of the user and of the time.
SYSTEMS = {
    "body": co.systems.rigid_body(inertia=(1.0, 2.0, 2.5)),
    "top": co.systems.heavy_top(),
    "sl(2)": full(co.algebras.sl(2), 1),
    "A4,7": full(co.algebras.get("A4,7")),
    "A5,40": full(co.algebras.get("A5,40"), 1),
    "heisenberg": full(co.algebras.heisenberg(2)),
    "sl(3)": full(co.algebras.sl(3)),
    "so(6)": co.LiePoissonSystem(co.algebras.so(6), co.Quadratic(np.linspace(0.5, 1.5, 15))),
    "powers": co.LiePoissonSystem(G3, co.Polynomial({(3, 0, 0): 0.2, (0, 4, 0): 0.1, (0, 0, 3): 0.3, (1, 0, 0): 0.1})),
    "in time": co.LiePoissonSystem(G3, co.Separable(dict.fromkeys(range(3), (wave, wave_slope, wave_curvature)))),
    "bonds": co.systems.spin_lattice("chain", 3, field=(0.1, 0.2, 0.3)),
}
SCHEMES = {
    "order 2": co.Splitting(order=2),
    "order 1": co.Splitting(order=1),
    "order 4, coordinates": co.Splitting(order=4, parts="coordinates"),
    "compensated": co.Splitting(order=2, compensated=True),
    "rational": co.Splitting(rotation="rational", parts="coordinates"),
    "processed": co.Splitting(scheme="blanes_casas_murua6"),
    "Gauss": co.GaussLegendre(2),
    "rk4": co.ExplicitRungeKutta("rk4"),
    "composed": co.Composition(co.GaussLegendre(1), (0.7, -0.4, 0.7)),
}
COUPLED = {name for name, system in SYSTEMS.items() if name not in ("body", "so(6)", "powers", "in time")}
PAIRS = [
    (system, scheme)
    for k, system in enumerate(SYSTEMS)
    for j, scheme in enumerate(SCHEMES)
    if ((j + k) % 3 == 0 and not (system in COUPLED and "coordinates" in scheme) and scheme != "rational")
    or (system, scheme) == ("body", "rational")
]


def state(system):
    return 0.5 * np.cos(1.0 + np.arange(system.dim))


@pytest.mark.thinned(1)
@pytest.mark.parametrize(("name", "scheme"), PAIRS)
def test_volumes_are_stretched_by_the_products_of_tangents(name, scheme):
    """By the logarithm of their determinants, whatever the number of orthonormalizations, forward and backward."""
    system, method = SYSTEMS[name], SCHEMES[scheme]
    x0, n = state(system), system.dim
    for t0, h in ((0.25, H), (0.5, -H)):
        span = (t0, t0 + 4 * h)
        states = co.integrate(system, x0, span, H, method, watch=False).x
        step = co.stepper(system, method, h)
        tangents = [step.tangent(states[k], t0 + k * h) for k in range(4)]
        wanted = sum(np.linalg.slogdet(tangent)[1] for tangent in tangents)
        conditions = sum(np.linalg.cond(tangent) for tangent in tangents)
        for every in (1, 3, 10):
            found = co.lyapunov(system, x0, span, H, method, renormalize_every=every, save_every=4)
            assert found.by == "compiled"
            assert abs(found.stretches[-1].sum() - wanted) <= 2.0**6 * n * n * UNIT_ROUNDOFF * conditions


@pytest.mark.parametrize("scheme", ["order 2", "compensated", "Gauss", "rk4", "composed"])
def test_stretches_do_not_depend_on_the_orthonormalizations_or_the_other_vectors(scheme):
    system, x0 = SYSTEMS["top"], state(SYSTEMS["top"])
    every = [
        co.lyapunov(system, x0, (0.5, -1.5), H, SCHEMES[scheme], renormalize_every=k, save_every=20) for k in (1, 4, 20)
    ]
    for other in every[1:]:
        np.testing.assert_allclose(other.stretches, every[0].stretches, rtol=0, atol=1e-11)
    few = co.lyapunov(system, x0, (0.5, -1.5), H, SCHEMES[scheme], exponents=2, renormalize_every=4, save_every=20)
    assert np.array_equal(few.stretches, every[1].stretches[:, :2])


@pytest.mark.parametrize("name", ["body", "top", "sl(3)", "in time"])
@pytest.mark.parametrize("scheme", ["order 2", "compensated", "Gauss"])
def test_members_in_lanes_have_the_bits_of_single_runs(name, scheme):
    """Also with more vectors than lanes, and a member at rest."""
    system = SYSTEMS[name]
    ensemble = state(system) * np.array([1.0, 0.9, 0.0, -0.8, 0.7])[:, None]
    given = {"t_span": (0.5, -0.5), "step": 0.0625, "method": SCHEMES[scheme], "renormalize_every": 3, "save_every": 4}
    whole = co.lyapunov(system, ensemble, **given)
    for m, start in enumerate(ensemble):
        assert np.array_equal(whole.stretches[:, m], co.lyapunov(system, start, **given).stretches)


def test_stretches_are_accurate_over_many_steps():
    """x' = x: each step stretches by one float, whose power is computed in 60 digits."""
    line = co.LiePoissonSystem(co.LieAlgebra([(0, 1, 1, 1.0)], dim=2), co.Quadratic([0, 0], linear=[1.0, 0.0]))
    method, h, steps = co.Splitting(order=1), 2.0**-10, 10**6
    factor = co.stepper(line, method, h).tangent([1e-300, 1e-300])[1, 1]
    found = co.lyapunov(line, [1e-300, 1e-300], (0.0, h * steps), h, method, renormalize_every=1, save_every=steps)
    with mpmath.workdps(60):
        wanted = mpmath.log(mpmath.mpf(factor)) * steps
        assert abs(factor - 1.0) >= 0.9 * h
        total = mpmath.fsum(map(float, found.stretches[-1]))
        assert abs(total - wanted) <= 4 * UNIT_ROUNDOFF * abs(wanted)
