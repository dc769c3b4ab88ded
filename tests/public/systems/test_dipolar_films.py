"""Dipoles of films, periodic along two axes: lattice sums in closed form, layers, supercells, axes, and motion."""

import importlib.util

import numpy as np
import pytest
from scipy.special import zeta

import coadjoint as co

pytestmark = pytest.mark.skipif(importlib.util.find_spec("gemmi") is None, reason="gemmi is not installed")

FILM = (True, True, False)
VECTORS = np.array([[1, 0, 0], [1, 1, 0], [0.3, 0.4, 2.3]])
SITES = np.array([[0, 0, 0], [0.2, 0.3, 0.15]])


def crystal(lattice, sites):
    return co.spins.crystal(
        lattice=lattice, sites={"AB"[k]: tuple(site) for k, site in enumerate(sites)}, space_group="P 1"
    )


def film(of, size, periodic=FILM):
    return co.systems.spins(of, size, g=1, periodic=periodic).dipolar()


def test_square_lattice_in_closed_form():
    """The sum of 1/r^3 is 4 zeta(3/2) beta(3/2): across the film half of it a dipole, in the plane -1/4."""
    square = crystal((1.0, 1.0, 3.0, 90, 90, 90), SITES[:1])
    total = 4 * zeta(1.5) * (zeta(1.5, 0.25) - zeta(1.5, 0.75)) / 4**1.5
    for size in ((1, 1, 1), (3, 2, 1)):
        count = int(np.prod(size))
        for direction, factor in (((0, 0, 1), 0.5), ((1, 0, 0), -0.25), ((0.6, 0.8, 0), -0.25)):
            energy = film(square, size).energy(np.tile(np.array(direction, dtype=float), count))
            assert abs(energy - factor * count * total) < 1e-13 * count * total


def between_layers(rho, d):
    """Return the tensor of a dipole above a square lattice of period 1, by waves that fall exponentially."""
    total = np.zeros((3, 3), dtype=complex)
    for h, k in np.indices((25, 25)).reshape(2, -1).T - 12:
        if h or k:
            K = 2 * np.pi * np.array([h, k, 0.0])
            size = np.linalg.norm(K)
            v = 1j * K + np.array([0, 0, -size])
            total -= 2 * np.pi / size * np.exp(-size * d + 1j * K @ rho) * np.outer(v, v)
    return total.real


def test_layers_supercells_axes_and_lengths():
    """Layers interact as by waves; a supercell, other axes, and a unit of length change nothing else."""
    tilted = crystal(VECTORS, SITES)
    small, large = film(tilted, (1, 1, 2)), film(tilted, (3, 2, 2))
    tensors, positions = small.hamiltonian.hessian(np.zeros(12)), small.positions
    for i in range(4):
        for j in range(4):
            step = positions[i] - positions[j]
            if step[2] > 0.3:
                expected = between_layers(step * [1, 1, 0], step[2])
                assert np.abs(tensors[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] - expected).max() < 1e-12
    x = np.random.default_rng(1).standard_normal((2, 2, 3))
    repeated = np.broadcast_to(x, (3, 2, 2, 2, 3))
    energy = small.energy(x.ravel())
    assert abs(large.energy(repeated.ravel()) - 6 * energy) < 1e-12
    assert np.abs(large.hamiltonian.gradient(repeated.ravel())[:12] - tensors @ x.ravel()).max() < 1e-12
    assert abs(energy - 0.5 * x.ravel() @ tensors @ x.ravel()) < 1e-13
    for order in ((2, 0, 1), (1, 2, 0)):
        other = film(
            crystal(VECTORS[list(order)], SITES[:, list(order)]),
            tuple(np.array([3, 2, 2])[list(order)].tolist()),
            tuple(np.array(FILM)[list(order)].tolist()),
        )
        moved = np.moveaxis(np.broadcast_to(x, (3, 2, 2, 2, 3)), (0, 1, 2), np.argsort(order))
        assert abs(other.energy(np.ascontiguousarray(moved).ravel()) - 6 * energy) < 1e-12
    scaled = film(crystal(1e3 * VECTORS, SITES), (1, 1, 2)).energy(x.ravel())
    assert abs(1e9 * scaled - energy) < 1e-12


def test_vacancies_conservation_and_thick_films():
    """A run keeps the energy of a film with vacancies; across many layers the field is 4 pi M less than in the bulk."""
    square = crystal((1.0, 1.0, 1.0, 90, 90, 90), SITES[:1])
    holes = film(square, (3, 3, 2)).vacancies(0.2, seed=1)
    x = np.random.default_rng(2).standard_normal((holes.dim // 3, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    sol = co.integrate(holes, x.ravel(), (0, 1), 0.02, co.GaussLegendre(1))
    assert sol.drift()["energy"] < 1e-12
    thick = film(square, (1, 1, 24))
    up = np.tile([0.0, 0.0, 1.0], 24)
    inside = -thick.hamiltonian.gradient(up).reshape(24, 3)[12]
    bulk = -film(square, (2, 2, 2), True).hamiltonian.gradient(np.tile([0.0, 0.0, 1.0], 8))[:3]
    assert np.abs(bulk - inside - [0, 0, 4 * np.pi]).max() < 1e-12
