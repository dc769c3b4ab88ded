"""Equilibria of fluids on unitary orbits: extremal energies, gravest modes, linearizations, units, refusals."""

from itertools import permutations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import unitary_group

import coadjoint as co
from refusals import refused
from rounding import UNIT_ROUNDOFF

SPHERE, TORUS = co.systems.sphere_euler(N=4), co.systems.torus_euler(N=5)
TURNING = co.systems.sphere_euler(N=4, rotation=0.7)
FLUIDS = pytest.mark.parametrize("s", [SPHERE, TURNING, TORUS], ids=["sphere", "rotating sphere", "torus"])


def commutator(A, B):
    return A @ B - B @ A


def conjugated(W, seed):
    U = unitary_group.rvs(len(W), random_state=seed)
    return U @ W @ U.conj().T


def start_of(s):
    return s.random(seed=4, degrees=(1, 2), energy=1.0)


def jacobian(s, W):
    """Return the derivative of the vector field, which is quadratic, by exact differences."""
    x = s.to_vector(W)
    units = s.to_vector(s.algebra.projected(s.from_vector(np.eye(s.dim))))
    fields = [[s.to_vector(s.vector_field(s.from_vector(x + side * unit))) for unit in units] for side in (1.0, -1.0)]
    return 0.5 * (np.array(fields[0]) - np.array(fields[1])).T


@FLUIDS
@pytest.mark.parametrize("relax", ["down", "up"])
def test_levels_are_kept_and_the_energy_is_extremal(s, relax):
    W, sign = start_of(s), 1.0 if relax == "up" else -1.0
    found = co.equilibrium(s, W, relax=relax)
    # Some hundred conjugations, each off by the round-off of products of N rows.
    assert np.abs(s.spectrum(found.x) - s.spectrum(W)).max() < 1e3 * UNIT_ROUNDOFF * np.abs(s.spectrum(W)).max()
    assert np.abs(commutator(s.stream_of(found.x), found.x)).max() == found.residual < 1e-12
    assert found.stability != "unstable" and found.energy == s.energy(found.x)
    rng, near = np.random.default_rng(1), []
    for _ in range(40):
        A = s.algebra.projected(rng.standard_normal(s.shape) + 1j * rng.standard_normal(s.shape))
        w, V = np.linalg.eigh(-1e-3j * A)
        U = (V * np.exp(1j * w)) @ V.conj().T
        near.append(s.energy(U @ found.x @ U.conj().T))
    assert np.all(sign * (found.energy - np.array(near)) > -64 * UNIT_ROUNDOFF * abs(found.energy))
    assert sign * (found.energy - s.energy(W)) > 1e-2


@FLUIDS
@pytest.mark.parametrize("relax", ["down", "up"])
def test_the_double_bracket_flow_ends_at_the_same_energy(s, relax):
    """Shepherd's modified dynamics, W' = [[P, W], W] or its reverse, by DOP853."""
    sign = 1.0 if relax == "up" else -1.0

    def modified(t, y):
        W = s.from_vector(y)
        return sign * s.to_vector(commutator(commutator(s.stream_of(W), W), W))

    W0 = start_of(s)
    size = np.abs(W0).max()
    flow = solve_ivp(modified, (0.0, 200.0 / size**2), s.to_vector(W0), method="DOP853", rtol=1e-6, atol=1e-8 * size)
    end = s.from_vector(flow.y[:, -1])
    assert (s.energy(end) > s.energy(W0)) == (relax == "up")
    energy = co.equilibrium(s, W0, relax=relax).energy
    # It has not ended yet, and preserves the levels to its tolerance.
    assert -1e-5 < sign * (energy - s.energy(end)) < 1e-3


@pytest.mark.parametrize("N", [3, 4, 6])
def test_on_a_sphere_at_rest_the_largest_energy_is_that_of_sorted_levels(N):
    s = co.systems.sphere_euler(N=N)
    W = s.random(seed=N, degrees=(1, N - 1), energy=1.0)
    levels = s.spectrum(W)
    orders = permutations(levels) if N < 6 else [np.random.default_rng(k).permutation(levels) for k in range(200)]
    zonal = max(s.energy(1j * np.diag(order)) for order in orders)
    best = s.energy(1j * np.diag(levels))
    found = co.equilibrium(s, W, relax="up")
    assert best >= zonal * (1.0 - 1e-12) and abs(found.energy - best) < 1e-12 * best
    assert all(s.energy(conjugated(W, seed)) < best for seed in range(200))
    assert found.stability == "stable"


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("s", "mode", "eigenvalue"), [(co.systems.sphere_euler(N=6), (1, 0), 2.0), (TORUS, (1, 0), 1.0)]
)
def test_the_orbit_of_a_gravest_mode_ends_at_one(s, mode, eigenvalue, seed):
    W = s.from_modes({mode: 0.7})
    found = co.equilibrium(s, conjugated(W, seed), relax="up")
    assert np.abs(found.x + eigenvalue * s.stream_of(found.x)).max() < 1e-6 * np.abs(W).max()
    assert abs(found.energy - s.energy(W)) < 1e-12 * found.energy and found.stability == "stable"


@FLUIDS
def test_frequencies_are_those_of_the_vector_field(s):
    found = co.equilibrium(s, start_of(s), relax="up")
    expected = np.linalg.eigvals(jacobian(s, found.x))
    N = s.algebra.N
    assert len(found.frequencies) == N * (N - 1) // 2
    largest = np.sort(np.abs(expected.imag))[::-2][: len(found.frequencies)]
    # A Jordan block of eigenvalues zero is off by the root of round-off.
    assert np.abs(np.sort(largest) - found.frequencies).max() < 1e-6 * largest.max()
    assert found.growth == 0.0 and np.abs(expected.real).max() < 1e-6 * largest.max()


def test_an_unstable_zonal_flow():
    s = co.systems.sphere_euler(N=8)
    jets = s.from_modes({(5, 0): 1.0, (3, 0): 0.2})
    found = co.equilibrium(s, jets, relax="none")
    assert np.array_equal(found.x, jets) and found.stability == "unstable"
    assert abs(found.growth - np.linalg.eigvals(jacobian(s, jets)).real.max()) < 1e-9


def test_every_state_of_su2_is_steady():
    s = co.systems.sphere_euler(N=2)
    W = s.random(seed=1, degrees=(1, 1))
    found = co.equilibrium(s, W, relax="up")
    assert np.array_equal(found.x, W) and found.growth == 0.0


@FLUIDS
@pytest.mark.parametrize("unit", [2.0**-23, 2.0**100], ids=["1e-7", "1e30"])
def test_in_other_units(s, unit):
    scaled = co.systems.sphere_euler(N=4, rotation=0.7 * unit) if s is TURNING else s
    plain, found = co.equilibrium(s, start_of(s), relax="up"), co.equilibrium(scaled, unit * start_of(s), relax="up")
    assert np.abs(found.x / unit - plain.x).max() < 1e-7 * np.abs(plain.x).max()
    assert abs(found.energy / unit**2 - plain.energy) < 1e-12 * plain.energy
    assert found.stability == plain.stability
    assert np.abs(found.frequencies / unit - plain.frequencies).max() < 1e-6 * plain.frequencies.max()


def test_states_in_numbers():
    s = SPHERE.in_numbers
    found = co.equilibrium(s, s.to_vector(start_of(SPHERE)), relax="up")
    assert found.x.shape == (32,)
    assert np.abs(found.x - SPHERE.to_vector(co.equilibrium(SPHERE, start_of(SPHERE), relax="up").x)).max() < 1e-14


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: co.equilibrium(co.systems.reduced_mhd(5), np.zeros((2, 5, 5))), ("reduced_mhd",)),
        (lambda: co.equilibrium(co.systems.matrix_body((1.0, 2.0, 3.0)), np.zeros((3, 3))), ("matrix_body",)),
        (
            lambda: co.equilibrium(SPHERE.with_forces(co.forces.Viscosity(0.1)), start_of(SPHERE)),
            ("sphere_euler", "forces"),
        ),
        (lambda: co.equilibrium(SPHERE, [start_of(SPHERE)] * 2), ("(2, 4, 4)", "(4, 4)")),
        (lambda: co.equilibrium(SPHERE, np.eye(4)), ("x0", "su")),
        (lambda: co.equilibrium(SPHERE, np.zeros((4, 4))), ("x0", "point")),
        (lambda: co.equilibrium(co.systems.sphere_euler(N=256), np.zeros((256, 256))), ("equilibrium", "256")),
    ],
)
def test_refused(call, named):
    with refused((ValueError, TypeError, MemoryError), *named):
        call()


@pytest.mark.long
@pytest.mark.parametrize("N", [14, 20])
def test_the_flat_minimum_of_the_energy_is_found(N):
    """Its second variation has eigenvalues from 1e-5 of the largest one, of both signs until the end."""
    s = co.systems.sphere_euler(N)
    W = s.random(seed=1)
    found = co.equilibrium(s, W, relax="down")
    assert found.energy < 0.2 * s.energy(W)
    assert found.residual < 1e-12 * np.abs(W).max()
    np.testing.assert_allclose(s.spectrum(found.x), s.spectrum(W), rtol=0, atol=1e-12)
    for seed in range(3):  # no small conjugation lowers it
        v = 1e-2 * s.random(seed=seed, energy=1.0)
        U = np.linalg.solve(np.eye(N) - v / 2, np.eye(N) + v / 2)
        assert s.energy(U @ found.x @ U.conj().T) > found.energy
