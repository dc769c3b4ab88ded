"""Spins 1 with all their multipoles: modes of SU(3) models against bosons of two flavours, and FeI2 in cold runs."""

import functools
import importlib.util

import numpy as np
import pytest

import coadjoint as co

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec(name) is None, reason=f"{name} is not installed")
    for name in ("gemmi", "spglib")
]

R = np.sqrt(0.5)
SPINS = np.array(
    [R * np.eye(3, k=1) + R * np.eye(3, k=-1), -1j * R * np.eye(3, k=1) + 1j * R * np.eye(3, k=-1), np.diag([1, 0, -1])]
)
COUPLINGS = {  # X. Bai et al., Nature Physics 17, 467 (2021), in meV; bonds of 4.05 to 9.73 angstroms
    "1": [[-0.236 - 0.161, 0, 0], [0, -0.236 + 0.161, -0.261], [0, -0.261, -0.236]],
    "2": np.diag([0.037, 0.037, -0.036]),
    "3": np.diag([0.026, 0.026, 0.113]),
    "4": np.diag([0.013, 0.013, 0.051]),
    "5": np.diag([0.166, 0.166, 0.211]),
    "6b": np.diag([0.068, 0.068, 0.073]),
}
WAVES = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.11, 0.23, 0.31], [1.0, 0, 0.25]])


def spins_one(crystal, size, couplings, site, **options):
    """Return a model of SU(3), and its bonds (i, j, J, offset) for the reference."""
    model = co.systems.spins(crystal, size, spin=1, mode="SU(N)", **options).single_ion(crystal.labels[0], site)
    number, pairs = np.arange(len(model.sites)).reshape(size), []
    bonds = crystal.bonds(9.8)
    for name, J in couplings.items():
        bond = bonds[name]
        model = model.exchange(bond, J)
        for matrix, offset in zip(bond.exchange(J), bond.offsets, strict=True):
            pairs += [
                (i, int(number[tuple((cell + offset) % size)]), matrix, offset) for i, cell in enumerate(model.cells)
            ]
    return model, pairs


def relaxed(Z, pairs, site):
    """Return the product state of lowest energy near amplitudes, and the matrix of each site in the field of others."""
    neighbours = [[] for _ in Z]
    for i, j, J, _ in pairs:
        neighbours[i].append((j, J))
        neighbours[j].append((i, J.T))
    others = np.array([[j for j, _ in row] for row in neighbours])
    matrices = np.array([[J for _, J in row] for row in neighbours])
    before = np.zeros((len(Z), 3))
    for _ in range(300):
        means = np.einsum("im,amn,in->ia", Z.conj(), SPINS, Z).real
        mean_field = np.einsum("ikab,ikb->ia", matrices, means[others])
        fields = site + np.einsum("ia,amn->imn", mean_field, SPINS)
        Z = np.linalg.eigh(fields)[1][:, :, 0]
        if np.abs(means - before).max() < 1e-14:
            return Z, fields
        before = means
    raise AssertionError("no self-consistent state")


def flavour_waves(fields, cell, sites_of_cell, pairs, q):
    """Return energies and intensities of the bosons that take a site from its lowest state to others."""
    # H = b* h b + (b* m + m' b) J (b* m + m' b), with bosons of 2 flavours on each site of the magnetic cell.
    levels, vectors = np.linalg.eigh(fields[sites_of_cell])
    up = np.einsum("smk,amn,sn->sak", vectors[:, :, 1:].conj(), SPINS, vectors[:, :, 0])  # <k| S |0>
    m = len(sites_of_cell)
    A, B = np.zeros((2, 2 * m, 2 * m), dtype=complex)
    A[np.diag_indices(2 * m)] = (levels[:, 1:] - levels[:, :1]).ravel()
    C = A.copy()
    chosen = {int(site): number for number, site in enumerate(sites_of_cell)}
    for i, j, J, n in pairs:
        for a, b, matrix, step in ((i, j, J, n), (j, i, J.T, -n)):
            if a not in chosen:
                continue
            s, t = chosen[a], int(cell[b])
            phase = np.exp(2j * np.pi * step @ q)
            S, T = slice(2 * s, 2 * s + 2), slice(2 * t, 2 * t + 2)
            A[S, T] += phase * np.einsum("ak,ab,bl->kl", up[s], matrix, up[t].conj())
            C[S, T] += phase * np.einsum("ak,ab,bl->kl", up[s].conj(), matrix, up[t])
            B[S, T] += phase * np.einsum("ak,ab,bl->kl", up[s], matrix, up[t])
    h = np.block([[A, B], [B.conj().T, C]])
    eta = np.diag([1.0] * (2 * m) + [-1.0] * (2 * m))
    values, T = np.linalg.eig(eta @ h)
    T = T / np.sqrt(np.abs(np.einsum("ik,ij,jk->k", T.conj(), eta, T)))
    kept = np.argsort(values.real)[2 * m :]
    amplitudes = np.einsum("sak,skn->an", up.conj(), T[: 2 * m, kept].reshape(m, 2, -1))
    amplitudes = amplitudes + np.einsum("sak,skn->an", up, T[2 * m :, kept].reshape(m, 2, -1))
    return values[kept].real, np.sum(np.abs(amplitudes) ** 2, axis=0) / m


def striped(cells):
    """Return the amplitudes of the order of FeI2: up, up, down, down along k - l."""
    up = (cells[:, 1] - cells[:, 2]) % 4 < 2
    return np.where(up[:, None], [1.0 + 0j, 0.05, 0], [0, 0.05, 1.0 + 0j])


@functools.cache
def iron_iodide(size):
    iron = co.spins.crystal(co.spins.structure("FeI2")).subcrystal("Fe")
    return spins_one(iron, size, COUPLINGS, np.diag([-2.165, 0, -2.165]), units="meV")


def test_a_large_easy_plane_has_triplets_of_closed_form():
    """E = sqrt(D^2 + 4 D J cos q) of both transitions from S^z = 0 on a chain."""
    crystal = co.spins.crystal(lattice=(1, 8, 9, 90, 90, 90), sites={"Ni": (0, 0, 0)})
    D, J = 2.0, 0.3
    model, _ = spins_one(crystal, (4, 1, 1), {"1": J * np.eye(3)}, D * np.diag([1.0, 0, 1.0]))
    modes = co.spectra.linear_modes(model, model.from_amplitudes([[0, 1, 0]] * 4), [(0, 0, 0), (0.37, 1, 0)], points=11)
    expected = np.sqrt(D**2 + 4 * D * J * np.cos(2 * np.pi * modes.q[:, 0]))
    np.testing.assert_allclose(modes.energies.T, [expected] * 2, rtol=1e-12)


def test_iron_iodide_has_the_modes_of_generalized_spin_waves():
    """Eight bands of the four sublattices of FeI2, with D = 2.165 meV, two of them mostly of Delta S = 2."""
    model, pairs = iron_iodide((5, 8, 4))
    Z, fields = relaxed(striped(model.cells), pairs, np.diag([-2.165, 0, -2.165]))
    x = model.from_amplitudes(Z)
    modes = co.spectra.linear_modes(model, x, WAVES, points=3)
    assert modes.stable and modes.spins_in_cell == 4 and modes.energies.shape[1] == 8
    stripe = (model.cells[:, 1] - model.cells[:, 2]) % 4
    own = np.array([np.flatnonzero(stripe == k)[0] for k in range(4)])
    for q, found, seen in zip(modes.q, modes.energies, modes.intensity, strict=True):
        energies, intensities = flavour_waves(fields, stripe, own, pairs, q)
        np.testing.assert_allclose(found, energies, rtol=1e-9)
        for group in np.split(np.arange(8), np.flatnonzero(np.diff(energies) > 1e-7) + 1):
            assert np.isclose(seen[group].sum(), intensities[group].sum(), rtol=1e-8, atol=1e-12)
    # At Gamma, all above the gap of the literature, and in its window of infrared spectra.
    assert np.all((modes.energies[0] > 2.0) & (modes.energies[0] < 4.5))


def lines_of_a_run(size, temperature, time, sweeps):
    """Return S(q, omega) of a run from a thermal state in one domain, and modes at the same wave vectors."""
    small, pairs = iron_iodide((5, 8, 4))
    Z, _ = relaxed(striped(small.cells), pairs, np.diag([-2.165, 0, -2.165]))
    model = small if size == small.size else iron_iodide(size)[0]
    stripe, own = ((one.cells[:, 1] - one.cells[:, 2]) % 4 for one in (small, model))
    x = model.from_amplitudes(Z[[np.flatnonzero(stripe == k)[0] for k in own]])
    members = 1 if model is small else 2
    start = co.thermal_states(model, temperature, members, sweeps=sweeps, seed=4, x0=x).x
    order = float((model.dipoles(start)[..., 2] * np.where(own < 2, 1, -1)).mean())
    sol = co.integrate(model, start, (0, time), 0.1, co.GaussLegendre(2), save_every=2, watch=False)
    S = co.spectra.structure_factor(sol, [(0, 0, 0), (1, 0, 0)])
    modes = co.spectra.linear_modes(small, small.from_amplitudes(Z), [(0, 0, 0), (1, 0, 0)], points=len(S.q) - 1)
    np.testing.assert_allclose(modes.q, S.q, atol=1e-12)
    return S, modes, order


def distances_to_modes(S, modes):
    """Return the distances of the maxima of S from the nearest mode in meV, and those of modes from nearest maxima."""
    to_modes, to_lines = [], []
    for row, energies, seen in zip(S.intensity, modes.energies, modes.intensity, strict=True):
        inner = row[1:-1]
        top = (S.energies[1:-1] > 0.5) & (inner >= row[:-2]) & (inner > row[2:])
        lines = S.energies[1:-1][top & (inner > 0.05 * inner[S.energies[1:-1] > 0.5].max())]
        bright = energies[seen > 0.3 * seen.max()]
        to_modes += np.abs(lines[:, None] - energies).min(axis=1).tolist()
        to_lines += np.abs(bright[:, None] - lines).min(axis=1).tolist()
    return np.array(to_modes), np.array(to_lines)


def test_lines_of_cold_runs_of_iron_iodide_are_its_modes():
    S, modes, order = lines_of_a_run((5, 8, 4), 0.05, 120, 40)
    assert order > 0.9
    to_modes, to_lines = distances_to_modes(S, modes)
    assert to_modes.max() < S.energies[1] - S.energies[0] and np.median(to_lines) < S.energies[1] - S.energies[0]


@pytest.mark.long
@pytest.mark.parametrize(("temperature", "ordered"), [(0.5, True), (3.5, False)])
def test_lines_of_iron_iodide_of_16_16_4_cells(temperature, ordered):
    """In the order the spectrum is that of the modes; classical spins lose the order below 3.5 K, where a peak remains.

    The maxima at 3.5 K lie between half of the gap of the modes and their largest energy.
    """
    S, modes, order = lines_of_a_run((16, 16, 4), temperature, 40, 300)
    S, expected = S.broadened(0.3), modes.spectrum(S.energies, 0.3)
    window = (S.energies > 0.8) & (S.energies < 7)
    weights = expected.intensity[:, window] / S.energies[window]
    found = S.intensity[:, window]
    if ordered:
        assert order > 0.9
        alike = [np.corrcoef(a, b)[0, 1] for a, b in zip(found, weights, strict=True)]
        assert np.mean(alike) > 0.75
    else:
        assert abs(order) < 0.3
        peaks = S.energies[window][found.argmax(axis=1)]
        assert np.all((peaks > 0.5 * modes.energies.min()) & (peaks < modes.energies.max()))
