"""Micromagnetic models: fields of mumax3's finite differences, and closed forms of walls, helices and resonances."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

MU_B = 9.2740100657e-24  # J/T, CODATA 2022
GAMMA = 1.7595e11


def field_of_mumax(m, cell, constants):
    """Return the effective field in tesla of moments (nx, ny, nz, 3) with open edges, cell by cell as in mumax3."""
    Msat, A, K, u, D, Db = (constants[name] for name in ("Msat", "Aex", "Ku1", "axis", "Dind", "Dbulk"))
    u = np.array(u) / np.linalg.norm(u)
    B = np.zeros_like(m)
    for index in np.ndindex(m.shape[:3]):
        m0 = m[index]
        B[index] += 2 * K / Msat * (m0 @ u) * u
        for axis in range(3):
            for side in (-1, 1):
                there = np.array(index)
                there[axis] += side
                if not 0 <= there[axis] < m.shape[axis]:
                    continue
                m1, d = m[tuple(there)], cell[axis]
                B[index] += 2 * A / Msat / d**2 * (m1 - m0)
                x, y, z = side * m1 / d / Msat
                if axis == 0:
                    B[index] += D * np.array([z, 0, -x]) + Db * np.array([0, z, -y])
                elif axis == 1:
                    B[index] += D * np.array([0, z, -y]) + Db * np.array([-z, 0, x])
                else:
                    B[index] += Db * np.array([y, -x, 0])
    return B


@pytest.mark.parametrize("off", ["", "Aex", "Ku1", "Dind", "Dbulk"])
def test_moments_move_in_the_fields_of_mumax(off):
    """The torques are those of m' = -gamma m x B, with B by the finite differences of its kernels."""
    cell, size = (2e-9, 3e-9, 1.5e-9), (3, 4, 2)
    given = {"Msat": 6e5, "Aex": 1.2e-11, "Ku1": 4e5, "axis": (1, 2, 3), "Dind": 2.5e-3, "Dbulk": -1.5e-3}
    given |= {off: 0.0} if off else {}
    m = np.random.default_rng(1).normal(size=(*size, 3))
    m /= np.linalg.norm(m, axis=-1, keepdims=True)
    applied = np.array([0.1, -0.3, 0.2])
    B = field_of_mumax(m, cell, given) + applied
    model = co.spins.micromagnetic(size, cell, **given).field(applied)
    found = -model.vector_field(-m.ravel()).reshape(m.shape)
    # B includes -2 A/d^2 m0 of the discrete Laplacian, which exerts no torque.
    np.testing.assert_allclose(found, -GAMMA * 1e-12 * np.cross(m, B), rtol=0, atol=1e-12 * np.abs(found).max())


def test_a_domain_wall_has_its_width_and_energy():
    """tanh(x/delta), delta = sqrt(A/K); energy 4 sqrt(A K) of an area. The lattice changes both by (d/delta)^2/24."""
    A, K, d = 1e-11, 4e5, 0.5e-9
    delta = np.sqrt(A / K)
    n = round(16 * delta / d)
    wall = co.spins.micromagnetic((n, 1, 1), (d, d, d), Msat=8e5, Aex=A, Ku1=K)
    place = (np.arange(n) - (n - 1) / 2) * d / (1.3 * delta)
    start = np.stack([1 / np.cosh(place), 0 * place, np.tanh(place)], axis=1)
    found = co.equilibrium(wall, start.ravel())
    m = -found.x.reshape(n, 3)
    inside = np.abs(m[:, 2]) < 0.95
    slope = np.polyfit(np.arange(n)[inside] * d, np.arctanh(m[inside, 2]), 1)[0]
    assert abs(abs(np.pi / slope) / (np.pi * delta) - 1) < (d / delta) ** 2
    uniform = wall.energy(np.tile((0.0, 0.0, 1.0), n))
    energy = (found.energy - uniform) * 1.602176634e-22 / d**2
    assert abs(energy / (4 * np.sqrt(A * K)) - 1) < (d / delta) ** 2


@pytest.mark.parametrize(("what", "sense"), [("Dbulk", 1), ("Dbulk", -1), ("Dind", 1), ("Dind", -1)])
def test_the_pitch_of_a_helix(what, sense):
    """The lowest of all helices on a ring has the pitch 4 pi A/D; bulk coupling turns about x, interfacial about y."""
    A, D, d = 1e-11, sense * 4e-3, 0.5e-9
    n = round(3 * 4 * np.pi * A / abs(D) / d)
    ring = co.spins.micromagnetic((n, 1, 1), (d, d, d), Msat=8e5, Aex=A, **{what: D}, periodic=(True, False, False))
    energies = {}
    for turns in range(-6, 7):
        angle = 2 * np.pi * turns * np.arange(n) / n
        # Right-handed about x: m = y cos + z sin has m . curl m = -q.
        pair = (np.zeros(n), np.cos(angle), np.sin(angle))
        m = np.stack(pair if what == "Dbulk" else (pair[1], pair[0], pair[2]), axis=1)
        energies[turns] = ring.energy(-m.ravel())
    assert min(energies, key=energies.get) == 3 * sense


def test_kittel_resonance_of_a_hard_axis():
    """gamma sqrt(B (B + 2 |K|/M)) with the field in the plane."""
    B, K, Msat = 0.3, -2e5, 7e5
    disk = co.spins.micromagnetic((2, 2, 1), (2e-9, 2e-9, 1e-9), Msat=Msat, Aex=1e-11, Ku1=K).field((B, 0, 0))
    found = co.equilibrium(disk, np.tile((-1.0, 0.0, 0.0), 4))
    kittel = GAMMA * 1e-12 * np.sqrt(B * (B - 2 * K / Msat))
    assert abs(found.frequencies.min() / kittel - 1) < 1e-9 and found.stability == "stable"


def test_moments_and_ratio_are_those_given():
    cell, Msat = (2e-9, 3e-9, 4e-9), 5e5
    model = co.spins.micromagnetic((2, 1, 1), cell, Msat=Msat, Aex=0.0, gamma=2e11).field((0, 0, 1.0))
    assert np.allclose(model.moments, -Msat * 24e-27 / MU_B, rtol=1e-9)
    assert np.allclose(model.positions[1], [20, 0, 0])
    x = co.integrate(model, (1.0, 0, 0) * 2, (0, 2), 0.1).x[-1]
    assert np.allclose(x[:3], [np.cos(0.4), np.sin(0.4), 0], atol=1e-12)  # 0.2 rad/ps, counterclockwise as moments


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"cell": (4, 4, 1)}, "edges in metres"),
        ({"cell": (4e-9, 4e-9)}, "edges in metres"),
        ({"axis": (0, 0, 0)}, "axis"),
        ({"Msat": -8e5}, "Msat"),
        ({"Msat": 8e11}, "A/m"),
        ({"Aex": 13.0}, "J/m"),
        ({"size": (4, 4)}, "size"),
        ({"size": (2, 4, 1), "periodic": True}, "at least 3 cells along a"),
    ],
)
def test_constants_that_are_refused(given, words):
    good = {"size": (3, 3, 1), "cell": (4e-9, 4e-9, 1e-9), "Msat": 8e5, "Aex": 1e-11}
    with refused((ValueError, TypeError), words):
        co.spins.micromagnetic(**good | given)
