"""The compiled Runge-Kutta loop: against the plain reading, group elements, large systems, failures."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest

import coadjoint as co
from served import serves

U = 2.0**-53
SCHEMES = (
    co.GaussLegendre(1),
    co.GaussLegendre(2),
    co.GaussLegendre(5),
    co.IteratedGaussLegendre(2),
    co.IteratedGaussLegendre(3, iterations=2),
    co.ExplicitRungeKutta("runge2"),
    co.ExplicitRungeKutta("rk4"),
    co.ModifiedGaussLegendre(1),
    co.ModifiedGaussLegendre(3, iterations=4),
    co.ModifiedGaussLegendre(1, freeze="gradient"),
    co.ModifiedGaussLegendre(3, iterations=4, freeze="gradient"),
)


def full(n, seed=0):
    B = np.random.default_rng(seed).uniform(-0.2, 0.2, (n, n))
    return np.diag(np.linspace(0.5, 1.5, n)) + (B + B.T)


def nonlinear_structure(x):
    a, b, c = x[1] * x[2], x[0] * x[2], x[0] * x[1] + 2.0 * x[2]
    return np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])


def driven(x, t):
    return 0.5 * x[0] * x[0] * (1.0 + math.sin(t)) + x[1] * x[2] + math.cos(2.0 * t) * x[1] * x[1]


def driven_gradient(x, t):
    return np.array([x[0] * (1.0 + math.sin(t)), x[2] + 2.0 * math.cos(2.0 * t) * x[1], x[1]])


def heavy_top():
    """A top without symmetry: not integrable."""
    H = co.Quadratic([1.0, 0.5, 0.4, 0.0, 0.0, 0.0], linear=[0.0, 0.0, 0.0, 0.75, 0.5, 1.0])
    return co.LiePoissonSystem(co.algebras.e(3), H, sign=-1), np.array([1.0, -0.5, 1.5, 0.6, 0.0, 0.8])


def systems():
    so4, e3 = co.algebras.so(4), co.algebras.e(3)
    quartic = co.Polynomial(
        {(2, 0, 0, 0, 0, 0): 0.5, (0, 1, 0, 0, 1, 0): 0.25, (0, 0, 0, 1, 1, 1): 1.0, (0, 0, 4, 0, 0, 0): 0.5}
    )
    six = np.array([1.0, 0.5, -0.25, 0.75, -1.0, 0.375])
    return {
        "top": heavy_top(),
        "so(4)": (co.LiePoissonSystem(so4, co.Quadratic(full(6))), six),
        "A3,7": (co.LiePoissonSystem(co.algebras.A3_7(1.5), co.Quadratic(full(3))), np.array([0.75, 0.5, 0.625])),
        "sl(2)": (co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 2.0, 3.0])), np.array([1.0, 0.5, -0.25])),
        "quartic": (co.LiePoissonSystem(e3, quartic, sign=-1), six),
        "driven": (
            co.LiePoissonSystem(co.algebras.sl(2), co.Hamiltonian(driven, driven_gradient)),
            np.array([1.0, 0.5, -0.25]),
        ),
        "nonlinear J": (
            co.PoissonSystem(nonlinear_structure, co.Quadratic([1.0, 0.5, 0.25]), sign=-1),
            np.array([0.75, 0.5, -0.625]),
        ),
    }


@pytest.mark.thinned(8)
@pytest.mark.parametrize("name", list(systems()))
@pytest.mark.parametrize("method", SCHEMES, ids=repr)
def test_compiled_step_is_the_plain_reading(name, method):
    """Both round each of at most E evaluations of n products, times h |f'|, here below 1."""
    system, x = systems()[name]
    if not serves(method, system):
        with pytest.raises(ValueError, match="take"):
            co.stepper(system, method, 0.125)
        return
    for h in (0.125, -0.125) if method == co.GaussLegendre(2) else (0.125,):
        found, expected = co.stepper(system, method, h)(x, 0.75), method.step(system, x, 0.75, h)
        assert np.max(np.abs(found - expected)) <= 4 * len(x) * method.order * U * np.max(np.abs(x))
        assert np.max(np.abs(found - x)) > 1e-3


def test_round_off_of_gauss_8_has_no_bias():
    """At t = 20000 a random walk: with plainly rounded coefficients the energy is off by 3e-13, with one sign."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    run = co.integrate(body, (1.0, 2.0, 0.5), (0.0, 20000.0), 0.25, co.GaussLegendre(8), save_every=10**6)
    assert run.drift()["energy"] < 2 * U * run.energy[0] * math.sqrt(run.stats.steps)


@pytest.mark.parametrize("method", [co.GaussLegendre(2), co.ModifiedGaussLegendre(1, freeze="gradient")], ids=repr)
@pytest.mark.parametrize("name", ["top", "so(4)", "A3,7", "sl(2)"])
def test_coadjoint_matrix_keeps_the_spatial_momentum(name, method):
    system, x0 = systems()[name]
    run = co.integrate(system, x0, (0.0, 4.0), 0.1, method, attitude="coadjoint")
    spatial = np.einsum("kab,kb->ka", run.attitude, run.x)
    # each of 40 steps rounds products of n terms of the size of K x
    size = max(np.max(np.abs(run.attitude)) * np.max(np.abs(run.x)), 1.0)
    assert np.max(np.abs(spatial - x0)) < 40 * 4 * len(x0) * U * size
    assert np.max(np.abs(run.attitude[-1] - np.eye(len(x0)))) > 0.1
    plain = co.integrate(system, x0, (0.0, 4.0), 0.1, method)
    assert np.array_equal(plain.x, run.x)


@pytest.mark.parametrize("freeze", ["structure", "gradient"])
def test_large_systems_are_solved_without_a_matrix(freeze):
    """A chain of 60 spins, 180 unknowns: iterated; 12 spins, 36 unknowns: by factors. Both keep their invariant."""
    for spins, direct in ((60, False), (12, True)):
        system, x0 = spin_chain(spins)
        method = co.ModifiedGaussLegendre(1, freeze=freeze)
        from coadjoint.kernels.tables.runge_kutta import runge_kutta_tables

        assert runge_kutta_tables(system, method).tables.direct == direct
        found = co.stepper(system, method, 0.1)(x0)
        assert np.max(np.abs(found - method.step(system, x0, 0.0, 0.1))) < 64 * U
        run = co.integrate(system, x0, (0.0, 10.0), 0.1, method, save_every=100)
        size = 3 * spins
        kept = "energy" if freeze == "structure" else "S"
        lost = "S" if freeze == "structure" else "energy"
        assert run.drift()[kept] < 6 * 4 * size * U * math.sqrt(100)
        assert run.drift()[lost] > 1e-6


def spin_chain(spins):
    rows = [
        (3 * i + a, 3 * i + b, 3 * i + c, 1.0) for i in range(spins) for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    ]
    algebra = co.LieAlgebra(rows, dim=3 * spins)
    M = np.zeros((3 * spins, 3 * spins))
    for i in range(spins):
        j = (i + 1) % spins
        for a, coupling in enumerate((1.0, 0.5, 0.25)):
            M[3 * i + a, 3 * j + a] += coupling
            M[3 * j + a, 3 * i + a] += coupling
    S = co.Polynomial({tuple(2 * (k == i) for k in range(3 * spins)): 1 for i in range(3 * spins)})
    x0 = np.random.default_rng(5).standard_normal((spins, 3))
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    return co.LiePoissonSystem(algebra, co.Quadratic(M), casimirs={"S": S}), x0.ravel()


def test_no_convergence_is_reported_with_step_time_and_residual():
    """The equation of the midpoint has no solution here: Newton's method does not find one either."""
    system, x0 = systems()["sl(2)"]
    with pytest.raises(co.IntegrationError, match="did not converge") as caught:
        co.integrate(system, x0, (0.0, 40.0), 4.0, co.GaussLegendre(1))
    error = caught.value
    assert (error.step, error.time) == (1, 0.0)
    assert error.residual > 1e-3
    assert np.array_equal(error.partial.x, x0[None])


def test_overflow_is_reported():
    system = co.LiePoissonSystem(co.algebras.sl(2), co.Polynomial({(4, 0, 0): 1.0, (0, 3, 1): 1.0}))
    with pytest.raises(co.IntegrationError, match="overflow"):
        co.integrate(system, (1e4, 1e4, 1e4), (0.0, 100.0), 1.0, co.ExplicitRungeKutta("rk4"))


def test_an_equilibrium_stays():
    """All corrections vanish at once: no iteration is left hanging, and no step is lost."""
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    for x0 in ((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)):
        run = co.integrate(body, x0, (0.0, 1.0), 0.1, co.GaussLegendre(3))
        assert np.array_equal(run.x[-1], x0)
        assert run.stats.iterations == 10


def test_components_of_different_size_are_all_converged():
    """|x1| = 1e6 against 1e-3: the small component is as accurate, relatively, as where it stands alone."""
    rows = [(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0), (3, 4, 5, 1.0), (4, 5, 3, 1.0), (5, 3, 4, 1.0)]
    system = co.LiePoissonSystem(co.LieAlgebra(rows, dim=6), co.Quadratic([1e-6, 2e-6, 3e-6, 1e3, 2e3, 3e3]))
    large, small = np.array([1.0, 0.5, -0.75]) * 1e6, np.array([0.5, 1.0, -0.25]) * 1e-3
    found = co.stepper(system, co.GaussLegendre(4), 0.5)(np.concatenate([large, small]))
    with mpmath.workdps(40):
        x = np.array([mpmath.mpf(v) for v in np.concatenate([large, small])], dtype=object)
        exact = co.GaussLegendre(4).step(system, x, 0, 0.5)
    error = np.array([float(v) for v in exact - found])
    assert np.max(np.abs(error[:3])) < 32 * U * 1e6
    assert np.max(np.abs(error[3:])) < 32 * U * 1e-3
