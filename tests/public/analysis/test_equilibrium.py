"""Equilibria on coadjoint orbits: axes of a body, the sleeping top, every kind of algebra, spirals.

Weak instabilities are compared with eigenvalues in 40 digits, on both sides of the threshold and of neutral stability.
"""

from contextlib import nullcontext

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF as U

pytestmark = pytest.mark.thinned(1)


@pytest.mark.parametrize(("axis", "stability"), [(0, "stable"), (1, "unstable"), (2, "stable")])
def test_axes_of_a_rigid_body(axis, stability):
    inertia, L = np.array([1.0, 2.0, 3.0]), 1.5
    found = co.equilibrium(co.systems.rigid_body(inertia=inertia), L * np.eye(3)[axis])
    others = [k for k in range(3) if k != axis]
    square = L**2 * np.prod(1.0 / inertia[axis] - 1.0 / inertia[others])
    rate = np.sqrt(abs(square))
    assert found.stability == stability
    expected = (0.0, rate) if stability == "unstable" else (rate, 0.0)
    assert np.allclose((found.frequencies[0], found.growth), expected, rtol=0, atol=1e-14)
    assert np.array_equal(found.x, L * np.eye(3)[axis]) and found.energy == L**2 / (2 * inertia[axis])


@pytest.mark.parametrize("I3", [0.5, 1.0, 2.0])
def test_sleeping_top_is_stable_by_the_condition_of_lagrange(I3):
    """m3^2 > 4 I1 mgl, for every I3, from both sides; frequencies in space are those of the quadratic equation."""
    I1, weight = 1.5, 0.7
    top = co.systems.heavy_top(inertia=(I1, I1, I3), lever=(0.0, 0.0, weight))
    threshold = np.sqrt(4.0 * I1 * weight)
    for m3, stability in ((0.99, "unstable"), (1.01, "stable"), (-1.01, "stable"), (3.0, "stable")):
        m = m3 * threshold
        found = co.equilibrium(top, (0.0, 0.0, m, 0.0, 0.0, 1.0), relax="none")
        assert found.stability == stability
        root = np.sqrt(complex(m**2 - 4 * I1 * weight)) / (2 * I1)
        turning = m / I3 - m / (2 * I1)
        assert np.allclose(found.growth, root.imag, rtol=0, atol=1e-6)
        assert np.allclose(found.frequencies, np.sort(np.abs([turning + root.real, turning - root.real])), atol=1e-6)
    hanging = co.equilibrium(top, (0.1, 0.0, 0.3, 0.1, 0.2, 1.0))
    assert hanging.stability == "stable" and hanging.x[5] < -1.0


def at_rest(algebra, x0, sign):
    """Equilibria at x0, whose energy has one curvature -d along the orbit, and otherwise curvatures of order one."""
    x0, n = np.asarray(x0), algebra.dim
    axes = np.linalg.svd(co.LiePoissonSystem(algebra, co.Quadratic(np.ones(n))).structure_matrix(x0))[0]

    def system(d, speed):
        curvatures = np.linspace(1.0, 1.5, n)
        curvatures[algebra.generic_rank() - 1] = -d
        M = (speed * axes * curvatures) @ axes.T
        return co.LiePoissonSystem(algebra, co.Quadratic(0.5 * (M + M.T), linear=-M @ x0), sign=sign), x0

    return system


def aligned_spins(d, speed):
    """A ring of four along its second-easiest axis, in a field that is too weak by d to hold them there."""
    J = np.array([1.0, 0.6, 0.8])
    bonds = np.roll(np.eye(4), 1, axis=0) + np.roll(np.eye(4), -1, axis=0)
    M, field = -np.kron(bonds, np.diag(J)), np.tile([0.0, 0.0, d - 2.0 * (J[0] - J[2])], 4)
    ring = co.algebras.copies(co.algebras.so(3), 4)
    return co.LiePoissonSystem(ring, co.Quadratic(speed * M, linear=speed * field)), np.tile([0.0, 0.0, 1.0], 4)


def sleeping_top(d, speed):
    """A top whose spin is too slow by d: two frequencies meet, and turn into a growing spiral."""
    I1, weight = 1.5, 0.7
    top = co.systems.heavy_top(inertia=np.array([I1, I1, 0.8]) / speed, lever=(0.0, 0.0, speed * weight))
    return top, np.array([0.0, 0.0, np.sqrt(4.0 * I1 * weight * (1.0 - d)), 0.0, 0.0, 1.0])


SIX = np.linspace(0.9, -0.6, 6)
NEARLY_NEUTRAL = {
    "four spins": aligned_spins,
    "sleeping top": sleeping_top,
    "so(4)": at_rest(co.algebras.so(4), SIX, 1),
    "so(2,2)": at_rest(co.algebras.so(2, 2), SIX, -1),
    "e(3)": at_rest(co.algebras.e(3), [0.3, -0.4, 0.5, 0.2, 0.9, -0.3], -1),
    "su(3)": at_rest(co.algebras.su(3), np.linspace(0.9, -0.6, 8), 1),
    "sl(2) and so(3)": at_rest(
        co.algebras.direct_sum(co.algebras.sl(2), co.algebras.so(3)), [0.3, 0.7, 0.5, 0.2, 0.7, -0.4], 1
    ),
    "A3,7 and so(3)": at_rest(
        co.algebras.direct_sum(co.algebras.A3_7(0.7), co.algebras.so(3)), [0.4, -0.5, 0.3, 0.2, 0.7, -0.4], -1
    ),
}


def linearization_in_40_digits(system, x0):
    """Return the largest real part and the largest size of eigenvalues of D(J(x) grad H)(x0), H quadratic."""
    n, c = system.dim, mpmath.mpf
    with mpmath.workdps(40):
        M = mpmath.matrix(system.hamiltonian.hessian(x0, 0.0).tolist())
        u = M * mpmath.matrix(x0.tolist()) + mpmath.matrix(system.hamiltonian.gradient(np.zeros(n), 0.0).tolist())
        J, L = mpmath.zeros(n), mpmath.zeros(n)
        constants = np.array([[system.algebra.bracket(a, b) for b in np.eye(n)] for a in np.eye(n)])
        for i, j, k in np.argwhere(constants).tolist():
            value = c(float(constants[i, j, k]))
            J[i, j] += value * c(float(x0[k]))
            L[i, k] += value * u[j]
        eigenvalues = mpmath.eig(int(system.sign) * (L + J * M), left=False, right=False)
        return float(max(map(mpmath.re, eigenvalues))), float(max(map(abs, eigenvalues)))


@pytest.mark.parametrize("name", NEARLY_NEUTRAL)
def test_weak_instabilities_are_found_at_any_speed(name):
    """Growth above 1e-6 of the largest eigenvalue is an instability, below it is round-off, in any unit of time."""
    family, trial = NEARLY_NEUTRAL[name], 1e-4
    growth, largest = linearization_in_40_digits(*family(trial, 1.0))
    for wanted in (0.5e-6, 2e-6, 1e-5, 1e-4, 1e-2):
        d = trial * (wanted * largest / growth) ** 2
        exact, size = linearization_in_40_digits(*family(d, 1.0))
        assert exact == pytest.approx(wanted * size, rel=0.05)
        for speed in (1e-6, 1.0, 1e6):
            found = co.equilibrium(*family(d, speed), relax="none")
            assert found.stability == ("undecided" if wanted < 1e-6 else "unstable"), (wanted, speed)
            # Round-off moves the square of an eigenvalue that is nearly double; scaled inertia moves d as well.
            allowed = 100 * U * size**2
            assert abs((found.growth / speed) ** 2 - exact**2) < (allowed if found.growth else 1e-12 * size**2)


@pytest.mark.parametrize("name", NEARLY_NEUTRAL)
def test_neutral_equilibria_are_undecided_and_stable_ones_beyond(name):
    for d, stability in ((0.0, "undecided"), (-1e-10, "undecided"), (-1e-4, "stable"), (-1e-2, "stable")):
        for speed in (1e-6, 1.0, 1e6):
            found = co.equilibrium(*NEARLY_NEUTRAL[name](d, speed), relax="none")
            assert (found.stability, found.growth) == (stability, 0.0), (d, speed)


CASES = {
    "so(4)": (co.algebras.so(4), np.linspace(0.9, -0.6, 6)),
    "e(3)": (co.algebras.e(3), np.array([0.3, -0.4, 0.5, 0.2, 0.9, -0.3])),
    "sl(2)": (co.algebras.sl(2), np.array([0.3, 0.7, 0.5])),
    "A3,7": (co.algebras.A3_7(0.7), np.array([0.4, -0.5, 0.3])),
    "A3,7 and so(3)": (co.algebras.direct_sum(co.algebras.A3_7(0.7), co.algebras.so(3)), np.linspace(-0.5, 0.8, 6)),
}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", CASES)
def test_minimum_on_an_orbit_of_any_algebra(name, sign):
    algebra, x0 = CASES[name]
    n = algebra.dim
    B = np.random.default_rng(2).uniform(-0.2, 0.2, (n, n))
    M = np.diag(np.linspace(0.6, 1.4, n)) + B + B.T
    # Some orbits of A3,7 end in singular ones; the energy is lowest near x0.
    linear = -M @ x0 + 0.05 * np.cos(np.arange(n)) if "A3,7" in name else np.zeros(n)
    system = co.LiePoissonSystem(algebra, co.Quadratic(M, linear=linear), sign=sign)
    found = co.equilibrium(system, x0)
    assert found.stability == "stable" and found.growth == 0.0
    assert found.residual < 1e-14
    for casimir in system.casimirs.values():
        assert abs(casimir(found.x) - casimir(x0)) < 1e-13
    # The nonzero eigenvalues of the whole linearization, and energies around the point.
    eigenvalues = np.linalg.eigvals(system.jacobian(found.x))
    moving = np.sort(np.abs(eigenvalues.imag))[::-1][: 2 * len(found.frequencies)]
    assert np.allclose(np.repeat(found.frequencies, 2), moving[::-1], rtol=0, atol=1e-9)
    assert len(found.frequencies) == algebra.generic_rank() // 2
    near = [expm(algebra.coadjoint(v)) @ found.x for v in np.random.default_rng(3).normal(scale=0.1, size=(50, n))]
    assert min(map(system.energy, near)) >= found.energy - 1e-14
    assert np.allclose(co.equilibrium(system, found.x).x, found.x, rtol=0, atol=1e-14)


def test_highest_and_nearest_equilibria():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    for relax, axis in (("up", 0), ("down", 2), ("none", 1)):
        found = co.equilibrium(body, (0.05, 2.0, 0.06), relax)
        assert abs(abs(found.x[axis]) - np.sqrt(4.0061)) < 1e-13


def test_spiral_of_a_ring_with_dzyaloshinskii_moriya_coupling():
    """D = J tan(2 pi/6): the angle between neighbours is 60 degrees, the energy of each -sqrt(J^2 + D^2)."""
    sites, D = 12, np.tan(np.pi / 3)
    ring = co.systems.spin_lattice("ring", sites, dm=(0.0, 0.0, -D), on_site=(0.0, 0.0, -0.1))
    for turn in (1.0, -1.0):
        angle = turn * np.pi / 3 * np.arange(sites) + 0.05 * np.sin(np.arange(sites) ** 2)
        x0 = np.stack([np.cos(angle), np.sin(angle), np.zeros(sites)], axis=1).ravel()
        found = co.equilibrium(ring, x0)
        lowest = -sites * np.sqrt(1 + D**2)
        if turn == 1.0:
            assert abs(found.energy - lowest) < 1e-12
            assert found.stability == "undecided"  # all spirals turned about the third axis have the same energy
            assert found.frequencies[0] < 1e-6 < found.frequencies[1] and found.growth == 0.0
        else:
            assert found.energy > lowest + 1e-3


@pytest.mark.parametrize(("d", "stability"), [(-0.5e-8, "undecided"), (-2e-8, "stable")])
def test_the_threshold_of_the_second_variation(d, stability):
    """Definite variations have no eigenvalue below 1e-8.

    A body about an axis of inverse inertia 1, beside 1 + d and 0; and another one with the frequency 1.
    """
    two = co.algebras.copies(co.algebras.so(3), 2)
    bodies = co.LiePoissonSystem(two, co.Quadratic([1.0 + d, 1.0, 0.0, 3.0, 2.0, 2.0]), sign=-1)
    assert co.equilibrium(bodies, (0.0, 1.0, 0.0, 1.0, 0.0, 0.0), relax="none").stability == stability


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-6, 0.8, 2.4, np.pi])
def test_integrals_count_where_they_are_critical_but_for_rounding(turn):
    """A spin in a field, and a free one, of which a component is kept: it is critical along its own axis."""
    stability = "stable" if abs(np.sin(turn)) < 1e-10 else "undecided"
    kept = {"x of the second": co.Polynomial.variable(3, 6)}
    field = co.Quadratic(0.0, linear=[0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    spins = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), field, integrals=kept)
    x0 = [0.0, 0.0, -1.0, np.cos(turn), np.sin(turn), 0.0]
    for relax in ("none", "down"):
        found = co.equilibrium(spins, x0, relax)
        assert (found.stability, found.growth) == (stability, 0.0) and np.allclose(found.x, x0, rtol=0, atol=1e-15)


@pytest.mark.parametrize(("size", "counts"), [(0.5e-10, False), (2e-10, True)])
def test_a_small_spin_counts_from_its_threshold(size, counts):
    two = co.LiePoissonSystem(co.algebras.copies(co.algebras.so(3), 2), co.Quadratic([1.0, 2.0, 3.0] * 2))
    with nullcontext() if counts else refused(ValueError, "singular"):
        co.equilibrium(two, (1.0, 0.0, 0.0, size, 0.0, 0.0))


def test_lattices_of_many_spins_descend_before_they_take_eigenvalues(monkeypatch):
    """Eigenvalues of large second variations take longer than hundreds of descents; from random spins a few suffice."""
    counted, eigh = [], np.linalg.eigh
    monkeypatch.setattr(np.linalg, "eigh", lambda matrix: counted.append(len(matrix)) or eigh(matrix))
    bonds = np.repeat([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], 256, axis=0)
    lattice = co.systems.spin_lattice("square", (16, 16), periodic=True, dm=-0.8 * bonds, field=(0, 0, 0.7))
    x0 = np.random.default_rng(1).standard_normal((256, 3))
    x0 /= np.linalg.norm(x0, axis=1, keepdims=True)
    found = co.equilibrium(lattice, x0.ravel())
    assert found.stability == "stable" and found.residual < 1e-12
    np.testing.assert_allclose(np.linalg.norm(found.x.reshape(-1, 3), axis=1), 1.0, rtol=1e-13)
    assert len(counted) < 12  # 22 by descents along the gradient alone
