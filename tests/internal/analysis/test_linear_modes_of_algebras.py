"""Linear modes of products of su(3), spins 1 with all their multipoles, against bosons of several flavours."""

import numpy as np

import coadjoint as co
from coadjoint.analysis.linear_modes import SitesOfSpins, modes_at, second_variation
from coadjoint.analysis.wave_vectors import lattice_of

R = np.sqrt(0.5)
SPINS = np.array(
    [R * np.eye(3, k=1) + R * np.eye(3, k=-1), -1j * R * np.eye(3, k=1) + 1j * R * np.eye(3, k=-1), np.diag([1, 0, -1])]
)
SU3 = co.algebras.su(3)
_REAL = np.asarray(SU3.representation)  # (A, -B; B, A)
GENERATORS = 1j * _REAL[:, :3, :3] - _REAL[:, 3:, :3]  # Hermitian T, with x = <T> and x' = [x, H] by the bracket
COUPLINGS = {  # X. Bai et al., Nature Physics 17, 467 (2021), in meV; bonds of 4.05 to 9.73 angstroms
    "1": [[-0.236 - 0.161, 0, 0], [0, -0.236 + 0.161, -0.261], [0, -0.261, -0.236]],
    "2": np.diag([0.037, 0.037, -0.036]),
    "3": np.diag([0.026, 0.026, 0.113]),
    "4": np.diag([0.013, 0.013, 0.051]),
    "5": np.diag([0.166, 0.166, 0.211]),
    "6b": np.diag([0.068, 0.068, 0.073]),
}


def coefficients(operator):
    """Return those of the generators; the trace is no part of them."""
    return np.linalg.lstsq(
        GENERATORS.reshape(8, -1).T, (operator - np.eye(3) * np.trace(operator) / 3).ravel(), rcond=None
    )[0].real


def spins_one(crystal, size, couplings, site):
    """Return the system on copies of su(3), its places, its bonds (i, j, J) and the matrix of a site."""
    plain = co.systems.spins(crystal, size)
    bonds = crystal.bonds(9.8)
    for name, J in couplings.items():
        plain = plain.exchange(bonds[name], J)
    count = len(plain.sites)
    joined = [
        (*key, matrix)
        for coupling in plain._declared.couplings
        for key, matrix in zip(coupling.bonds.tolist(), coupling.matrices, strict=True)
    ]
    rows = np.array([coefficients(S) for S in SPINS])
    M, pairs = np.zeros((8 * count, 8 * count)), []
    cell_number = np.arange(count).reshape(size)
    for _, _, *n, J in joined:
        for i, cell in enumerate(plain.cells):
            j = int(cell_number[tuple((cell + n) % size)])
            block = rows.T @ J @ rows
            M[8 * i : 8 * i + 8, 8 * j : 8 * j + 8] += block
            M[8 * j : 8 * j + 8, 8 * i : 8 * i + 8] += block.T
            pairs.append((i, j, J))
    H = co.Quadratic(M, linear=np.tile(coefficients(site), count))
    system = co.LiePoissonSystem(co.algebras.copies(SU3, count), H, sign=+1)
    table = np.array([(i, j, *n) for i, j, *n, _ in joined])
    lattice = lattice_of(plain)
    spins = np.broadcast_to(rows, (count, 3, 8))
    return system, SitesOfSpins(plain.cells, plain.sites, size, (True,) * 3, table, spins, spins[:, 0], lattice), pairs


def relaxed(vectors, pairs, site):
    """Return the product state of lowest energy near vectors, and the matrix of each site in the field of others."""
    neighbours = [[] for _ in vectors]
    for i, j, J in pairs:
        neighbours[i].append((j, J))
        neighbours[j].append((i, J.T))
    others = np.array([[j for j, _ in row] for row in neighbours])
    matrices = np.array([[J for _, J in row] for row in neighbours])
    before = np.zeros((len(vectors), 3))
    for _ in range(300):
        means = np.einsum("im,amn,in->ia", vectors.conj(), SPINS, vectors).real
        fields = site + np.einsum("ikab,ikb,amn->imn", matrices, means[others], SPINS)
        vectors = np.linalg.eigh(fields)[1][:, :, 0]
        if np.abs(means - before).max() < 1e-14:
            return vectors, fields
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


def compared(crystal, size, couplings, site, vectors, wave_vectors, spins_in_cell):
    system, places, pairs = spins_one(crystal, size, couplings, site)
    vectors, fields = relaxed(vectors(places.cells), pairs, site)
    x = np.einsum("im,kmn,in->ik", vectors.conj(), GENERATORS, vectors).real.ravel()
    form = second_variation(system, places, x)
    assert len(form.spins) == spins_in_cell and form.tangents.shape[1:] == (8, 4) and not form.whole
    frequencies, growth, amplitudes, _ = modes_at(form, places, wave_vectors, np.ones((1, len(places.sites))))
    assert not np.any(growth)
    # Bonds with their offsets in space, from the table of the crystal.
    count = len(places.bonds)
    per = len(pairs) // count
    steps = np.repeat(places.bonds[:, 2:], per, axis=0)
    listed = [(i, j, J, n) for (i, j, J), n in zip(pairs, steps, strict=True)]
    stripe = (places.cells[:, 1] - places.cells[:, 2]) % spins_in_cell
    cell = np.argsort(stripe[form.spins])[stripe]
    for k, q in enumerate(wave_vectors):
        energies, intensities = flavour_waves(fields, cell, form.spins, listed, q)
        np.testing.assert_allclose(frequencies[k], energies, rtol=1e-9)
        total = np.sum(np.abs(amplitudes[:, k]) ** 2, axis=0)
        for group in np.split(np.arange(len(energies)), np.flatnonzero(np.diff(energies) > 1e-7) + 1):
            assert np.isclose(total[group].sum(), intensities[group].sum(), rtol=1e-8, atol=1e-12)
    return frequencies


def test_a_large_easy_plane_has_triplets_of_closed_form():
    """E = sqrt(D^2 + 4 D J cos q) of both transitions from S^z = 0 on a chain."""
    crystal = co.spins.crystal(lattice=(1, 8, 9, 90, 90, 90), sites={"Ni": (0, 0, 0)})
    D, J = 2.0, 0.3
    q = np.array([[0.0, 0, 0], [0.13, 0, 0], [0.37, 1, 0], [0.5, 0, 0]])
    site = D * np.diag([1.0, 0, 1.0])

    def lowest(cells):
        return np.tile([0, 1.0 + 0j, 0], (len(cells), 1))

    found = compared(crystal, (4, 1, 1), {"1": J * np.eye(3)}, site, lowest, q, 1)
    np.testing.assert_allclose(found.T, [np.sqrt(D**2 + 4 * D * J * np.cos(2 * np.pi * q[:, 0]))] * 2, rtol=1e-12)


def test_iron_iodide_has_the_modes_of_generalized_spin_waves():
    """Eight bands of the four sublattices of FeI2, with D = 2.165 meV, two of them mostly of Delta S = 2."""
    iron = co.spins.crystal(co.spins.structure("FeI2")).subcrystal("Fe")
    site = np.diag([-2.165, 0, -2.165])
    q = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.11, 0.23, 0.31], [1.0, 0, 0.25]])

    def striped(cells):
        up = (cells[:, 1] - cells[:, 2]) % 4 < 2
        return np.where(up[:, None], [1.0 + 0j, 0.05, 0], [0, 0.05, 1.0 + 0j])

    found = compared(iron, (5, 8, 4), COUPLINGS, site, striped, q, 4)
    assert found.shape == (4, 8) and 1.5 < found.min() < found.max() < 9
