"""Forces of many bodies, which threads share: sums of those of fewer, and the same bits on any number of threads."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import coadjoint as co

S = co.systems
LEAST_SHARED = 57  # bodies of 18 coordinates from which on threads share a member of more than 1024
WATER_AND_ROD = {
    "sites": [[(0.0, 0.0, 0.0), (0.06, 0.08, 0.0), (0.06, -0.08, 0.0)], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.11)]],
    "charges": [(-0.8, 0.45, 0.35), (-0.4, 0.4)],
    "lj": [[(0.6, 0.3), (0.0, 0.1), (0.0, 0.1)], [(0.3, 0.25), (0.2, 0.2)]],
    "masses": [(16.0, 1.0, 1.0), (14.0, 12.0)],
}


def molecules(numbers, **options):
    """Return the molecules of these numbers, of which two of three are water, and the others rods."""
    water = [n for n in numbers if n % 3]
    return S.rigid_molecules(**WATER_AND_ROD, count=(len(water), len(numbers) - len(water)), **options)


def in_a_box(numbers):
    return molecules(numbers, box=2.0, cutoff=0.9, dielectric=78.0)


def asteroids(numbers):
    moments = [(1.0 + 0.01 * n, 2.0, 2.5 - 0.01 * n) for n in numbers]
    return S.gravitating_bodies(moments, [1.0 + 0.1 * (n % 7) for n in numbers], order=4)


MAKERS = {"droplet": molecules, "box": in_a_box, "asteroids": asteroids}


def order_of(numbers, maker):
    """Return the numbers in the order of the bodies of a system: water before rods."""
    return list(numbers) if maker is asteroids else [n for n in numbers if n % 3] + [n for n in numbers if n % 3 == 0]


def state(system, numbers, maker):
    """Return bodies near a grid, turned and moving, each in the same way in every system that has it."""
    count, size = 81, 9.0 if maker is asteroids else 0.4
    rng = np.random.default_rng(7)
    grid = size * (np.array(list(np.ndindex(5, 5, 5)))[:count] + 0.1 * rng.standard_normal((count, 3)))
    turned = Rotation.random(count, random_state=rng).as_matrix()
    speeds, spins = rng.standard_normal((2, count, 3))
    spins[:, 2] *= maker is asteroids  # rods do not turn about their axes
    chosen = order_of(numbers, maker)
    return system.state(grid[chosen], 0.1 * speeds[chosen], turned[chosen], 0.1 * spins[chosen])


def potential(numbers, maker):
    """Return the potential energy of some bodies, and the forces and torques on each, by number."""
    system = maker(numbers)
    x = state(system, numbers, maker)
    free = S.bodies([inertia.tensor for inertia in system.inertias], system.masses)
    slope = system.hamiltonian.gradient(x) - free.hamiltonian.gradient(x)
    count, found = len(numbers), np.zeros((81, 12))
    rows = slope[: 12 * count].reshape(count, 12)[:, 3:], slope[15 * count : 18 * count].reshape(count, 3)
    found[order_of(numbers, maker)] = np.concatenate(rows, axis=1)
    return system.hamiltonian.value(x) - free.hamiltonian.value(x), found


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.thinned(3)
def test_forces_of_many_bodies_are_sums_over_fewer(name):
    """V of three groups is the sum over pairs of groups less that over groups, each too small to be shared."""
    maker, groups = MAKERS[name], (range(25), range(25, 50), range(50, 81))
    whole = potential(range(81), maker)
    signed = [(1, (*a, *b)) for a, b in ((groups[0], groups[1]), (groups[0], groups[2]), (groups[1], groups[2]))]
    parts = [(sign, potential(some, maker)) for sign, some in (*signed, *((-1, tuple(g)) for g in groups))]
    energy, slopes = (sum(sign * found[i] for sign, found in parts) for i in range(2))
    # Sums of some thousand terms, which cancel to a tenth of the largest at most.
    assert whole[0] == pytest.approx(energy, rel=1e-11)
    np.testing.assert_allclose(whole[1], slopes, rtol=0, atol=1e-11 * np.abs(slopes).max())


@pytest.mark.thinned(6)
@pytest.mark.parametrize("count", [LEAST_SHARED, 81, LEAST_SHARED - 1])
@pytest.mark.parametrize("name", MAKERS)
def test_the_same_bits_on_any_number_of_threads(name, count):
    """Of steps that are taken without and with the team, and of recorded energies."""
    maker = MAKERS[name]
    system = maker(range(count))
    x0, h, method = state(system, range(count), maker), 1e-3, co.Splitting(order=2)
    one, *others = (co.integrate(system, x0, (0.0, 10 * h), h, method, threads=threads) for threads in (1, 2, 3))
    assert np.isfinite(one.x).all() and not np.array_equal(one.x[0], one.x[-1])
    for other in others:
        assert other.x.tobytes() == one.x.tobytes() and other.energy.tobytes() == one.energy.tobytes()
    np.testing.assert_allclose(one.energy, [system.hamiltonian.value(x) for x in one.x], rtol=1e-12)


def test_a_multiple_is_shared_too():
    system = molecules(range(60))
    x = state(system, range(60), molecules)
    doubled = system.hamiltonian.times(2)
    assert doubled.value(x) == 2 * system.hamiltonian.value(x)
    np.testing.assert_array_equal(doubled.gradient(x), 2 * system.hamiltonian.gradient(x))
