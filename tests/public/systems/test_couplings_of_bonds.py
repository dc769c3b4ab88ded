"""Spin lattices whose couplings differ from bond to bond and from site to site, against sums bond by bond."""

import functools

import numpy as np
import pytest
from bonds_and_spins import bonds, by_hand, energy_by_hand, has_closed_form

import coadjoint as co
from rounding import UNIT_ROUNDOFF

spin_lattice = co.systems.spin_lattice

LATTICES = {
    "chain": ("chain", 4, False),
    "ring": ("ring", 5, False),
    "triangular": ("triangular", (3, 3), True),
    "honeycomb": ("honeycomb", (3, 3), True),
    "complete": ("complete", 4, False),
}

bonds_of = functools.cache(bonds)

PATTERNS = {
    "none": np.zeros((3, 3)),
    "isotropic": np.eye(3),
    "axis": np.diag([0.0, 0.0, 1.0]),
    "plane": np.diag([1.0, 1.0, 0.0]),
    "exchange of two axes": np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    "one component": np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
}
SYMMETRIC = [name for name, pattern in PATTERNS.items() if np.array_equal(pattern, pattern.T)]


def drawn(rng, count, patterns, first):
    """Matrices of the given patterns in a random order, the first of which is given, times numbers from 1/2 to 2."""
    names = [first, *rng.choice(patterns, count - 1)]
    return np.array([PATTERNS[name] * rng.uniform(0.5, 2.0) for name in names])


def couplings(seed, lattice):
    """Couplings of which the first bond, or the first site, has only some entries, and others have others."""
    rng = np.random.default_rng(seed)
    edges = bonds_of(*lattice)
    count, sites = len(edges), edges.max() + 1
    J = rng.integers(-2, 3, count) * 0.5
    T = drawn(rng, count, list(PATTERNS), rng.choice(list(PATTERNS)))
    D = rng.standard_normal((count, 3)) * rng.integers(0, 2, (count, 3))
    K = drawn(rng, sites, SYMMETRIC, rng.choice(SYMMETRIC))
    B = rng.standard_normal((sites, 3)) * rng.integers(0, 2, (sites, 3))
    for values in (J, D, B):
        values[0] *= rng.integers(0, 2)
    return edges, J, T, D, K, B


def system_of(lattice, J, T, D, K, B):
    return spin_lattice(*lattice, exchange=J, tensor=T, dm=D, on_site=K, field=B)


def assert_by_hand(system, seed, edges, J, T, D, K, B):
    x = np.random.default_rng(seed).standard_normal(system.dim)
    largest = np.abs(x).max()
    # A sum of at most 6 neighbours, 4 products each, and of the site itself: 64 roundings of all that is summed.
    seen = np.abs(B).max() + 6 * largest * (np.abs(J).max() * np.abs(T).max() + np.abs(D).max() + np.abs(K).max())
    tolerance = 64 * UNIT_ROUNDOFF * 2 * largest * seen
    np.testing.assert_allclose(system.vector_field(x), by_hand(x, edges, J, T, D, K, B), rtol=0, atol=tolerance)
    energy = energy_by_hand(x, edges, J, T, D, K, B)
    assert abs(system.energy(x) - energy) <= system.dim * tolerance


@pytest.mark.thinned(3)
@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("seed", range(4))
def test_entries_that_the_first_bond_lacks(lattice, seed):
    """Also if couplings of one kind alone differ from bond to bond, or from site to site."""
    edges, *values = couplings(seed, LATTICES[lattice])
    assert_by_hand(system_of(LATTICES[lattice], *values), seed, edges, *values)
    nothing = [np.ones_like(values[0]), *(np.zeros_like(each) for each in values[1:])]
    for kind in range(1, len(values)):
        alone = [*nothing[:kind], values[kind], *nothing[kind + 1 :]]
        assert_by_hand(system_of(LATTICES[lattice], *alone), seed, edges, *alone)


@pytest.mark.parametrize("first", PATTERNS)
@pytest.mark.parametrize("other", PATTERNS)
def test_every_pattern_after_every_other(first, other):
    """Both bonds of a chain and both tensors of sites in each order."""
    tensors, sites = np.array([PATTERNS[first], PATTERNS[other]]), np.zeros((3, 3, 3))
    if {first, other} <= {*SYMMETRIC}:
        sites[[0, 2]] = 0.5 * tensors
    values = (np.array([1.0, -1.5]), tensors, np.zeros((2, 3)), sites, np.zeros((3, 3)))
    assert_by_hand(system_of(("chain", 3, False), *values), 1, bonds_of("chain", 3, False), *values)


@pytest.mark.thinned(4)
@pytest.mark.parametrize("lattice", LATTICES)
@pytest.mark.parametrize("kind", ["none", "J", "T", "D", "K", "B"])
@pytest.mark.parametrize("place", ["first", "last"])
def test_integrals_and_closed_forms_take_every_bond_and_site_into_account(lattice, kind, place):
    """Exchange is isotropic but for one bond or one site: constant components are the kernel of the total torque.

    Only spins that are all coupled equally have a closed form; its slope is the motion by hand.
    """
    chosen = 0 if place == "first" else -1
    edges = bonds_of(*LATTICES[lattice])
    sites = edges.max() + 1
    J, T = np.ones(len(edges)), np.tile(np.eye(3), (len(edges), 1, 1))
    D, K, B = np.zeros((len(edges), 3)), np.zeros((sites, 3, 3)), np.zeros((sites, 3))
    values = {"J": J, "T": T, "D": D, "K": K, "B": B}
    axis = np.array([0.5, 0.0, 1.0])
    if kind != "none":
        values[kind][chosen] += 0.5 if kind == "J" else axis if kind in "DB" else np.outer(axis, axis)
    system = system_of(LATTICES[lattice], *values.values())
    assert has_closed_form(system) == (kind == "none" and lattice == "complete")
    states = np.random.default_rng(3).standard_normal((6, system.dim))
    rates = np.array([by_hand(x, edges, *values.values()) for x in states])
    torques = rates.reshape(6, sites, 3).sum(axis=1)
    # Torques are of size one, or round-off.
    assert len(system.integrals) == 3 - np.linalg.matrix_rank(torques, tol=1e-10)
    for x, rate in zip(states, rates, strict=True):
        for F in system.integrals.values():
            assert abs(F.gradient(x) @ rate) < 1e-12
        if has_closed_form(system):
            h = 2.0**-12
            slope = (system.exact(x, h) - system.exact(x, -h)) / (2 * h)
            # Rotations at a rate below 10 about fixed axes: the third derivative of a spin is below 10^3 |S|.
            np.testing.assert_allclose(slope, rate, rtol=0, atol=h * h / 6 * 1e3 * np.abs(x).max())
