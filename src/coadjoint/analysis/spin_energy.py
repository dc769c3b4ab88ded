"""Energies of spins that are at most quadratic: local fields, on-site forms, and sublattices without coupling."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra import catalogue
from coadjoint.systems.lattices.couplings import DipolarFunction
from coadjoint.systems.system_checks import check_system

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SpinEnergy:
    """``H = S . W S / 2 + sum_i S_i . A_i S_i / 2 + linear . S + constant`` of spins; W is sparse."""

    coupling: Any
    on_site: Floats
    linear: Floats
    constant: float

    @property
    def sites(self) -> int:
        return len(self.on_site)

    @cached_property
    def strengths(self) -> Any:
        """Frobenius norms of the coupling of each pair of sites, sparse (sites, sites), without zeros."""
        import scipy.sparse

        blocks = self.coupling.tocoo()
        place = (blocks.row // 3, blocks.col // 3)
        squares = scipy.sparse.coo_matrix((blocks.data**2, place), shape=(self.sites, self.sites)).tocsr()
        squares.eliminate_zeros()
        squares.data = np.sqrt(squares.data)
        return squares

    @cached_property
    def sublattices(self) -> tuple[Sublattice, ...]:
        """Sets of sites that are not coupled to each other, by first fit."""
        colours = _colours(self.strengths)
        on_site = self.on_site if np.any(self.on_site) else None
        sets = []
        for colour in range(int(colours.max()) + 1):
            sites = np.flatnonzero(colours == colour)
            rows = (3 * sites[:, None] + np.arange(3)).ravel()
            form = None if on_site is None else on_site[sites]
            sets.append(Sublattice(sites, self.coupling[rows], self.linear[rows].reshape(-1, 3, 1), form))
        return tuple(sets)

    def energy(self, S: Floats) -> Floats:
        rows = S.reshape(3 * self.sites, -1)
        density = rows * (0.5 * product(self.coupling, rows) + self.linear[:, None])
        # Each member is summed on its own, in an order that does not depend on their number.
        local = np.sum(np.ascontiguousarray(on_site_energy(self.on_site, S).T), axis=1)
        return np.asarray(self.constant + local + np.sum(np.ascontiguousarray(density.T), axis=1))


@dataclass(frozen=True, eq=False)
class Sublattice:
    """Sites not coupled to each other: rows of the coupling, fields and on-site forms (None if zero).

    In a simulation also `beta` (members,), and lengths and rotation angles of spins (sites, members).
    """

    sites: Integers
    coupling: Any
    linear: Floats
    on_site: Floats | None
    beta: Any = None
    lengths: Any = None
    sizes: Any = None

    def at_temperature(self, beta: Floats, lengths: Floats, sizes: Floats) -> Sublattice:
        """Return the set in a simulation, with lengths and sizes of all spins."""
        return replace(self, beta=beta, lengths=lengths[self.sites], sizes=sizes[self.sites])

    def field(self, S: Floats) -> Floats:
        """Return ``-dH/dS_i`` without the on-site part, (sites of this set, 3, members), of all spins S."""
        products = product(self.coupling, S.reshape(-1, S.shape[2]))
        return np.asarray(-products.reshape(-1, 3, S.shape[2]) - self.linear)

    def on_site_energy(self, S: Floats) -> Any:
        """Return ``S_i . A_i S_i / 2`` of the spins of this set, (sites of this set, members)."""
        if self.on_site is None:
            return 0.0
        return on_site_energy(self.on_site, S)


def on_site_energy(A: Floats, S: Floats) -> Floats:
    """Return ``S_i . A_i S_i / 2``, (sites, members)."""
    return np.asarray(0.5 * np.sum(S * np.sum(A[:, :, :, None] * S[:, None], axis=2), axis=1))


def product(matrix: Any, rows: Floats) -> Floats:
    """Return a sparse product; one column takes the same operations as several."""
    wide = rows if rows.shape[1] > 1 else np.repeat(rows, 2, axis=1)
    return np.asarray((matrix @ wide)[:, : rows.shape[1]])


def _colours(neighbours: Any) -> Integers:
    """Return the smallest colours, in the order of sites, that differ between neighbours."""
    colours = np.full(neighbours.shape[0], -1, dtype=np.int64)
    bounds, others = neighbours.indptr.tolist(), neighbours.indices
    for site in range(len(colours)):
        used = set(colours[others[bounds[site] : bounds[site + 1]]].tolist())
        colours[site] = next(colour for colour in range(len(used) + 1) if colour not in used)
    return colours


def spin_energy(system: Any, asking: str) -> SpinEnergy:
    """Return the energy of a system of spins; TypeError or ValueError, in the name of `asking`, for any other."""
    import scipy.sparse

    check_system(system)
    if system.is_batch:
        raise TypeError(f"{system.name} is a batch; call {asking} for each of its systems")
    if system.forces:
        raise TypeError(f"{system.name} has forces; {asking} takes the Hamiltonian part, system.unforced")
    if not are_spins(system):
        raise TypeError(f"{system.name} is not made of spins; {asking} needs copies of so(3), as spin_lattice has")
    if system.hamiltonian.timed:
        raise TypeError(f"the Hamiltonian of {system.name} depends on time, so that it has no thermal equilibrium")
    n = system.dim
    parts = [_matrix_and_linear(term, n) for term in system.hamiltonian.terms()]
    if any(part is None for part in parts):
        raise TypeError(
            f"the Hamiltonian of {system.name} is not given as a quadratic form; {asking} needs couplings of pairs of "
            "spins, anisotropies and fields, as spin_lattice has"
        )
    matrix = sum((part[0] for part in parts if part), start=scipy.sparse.csr_matrix((n, n))).tocoo()
    on_site, same = np.zeros((n // 3, 3, 3)), matrix.row // 3 == matrix.col // 3
    on_site[matrix.row[same] // 3, matrix.row[same] % 3, matrix.col[same] % 3] = matrix.data[same]
    entries = (matrix.data[~same], (matrix.row[~same], matrix.col[~same]))
    coupling = scipy.sparse.coo_matrix(entries, shape=(n, n)).tocsr()
    linear = np.sum([part[1] for part in parts if part], axis=0)
    return SpinEnergy(coupling, on_site, linear, sum(part[2] for part in parts if part))


def _matrix_and_linear(term: Any, n: int) -> tuple[Any, Floats, float] | None:
    """Return a term as a sparse matrix, linear part and constant; None if it is not known to be quadratic."""
    import scipy.sparse

    form, function = term.form, getattr(term, "value", None)
    if form is not None:
        rows = (form.values, form.indices, form.indptr)
        return scipy.sparse.csr_matrix(rows, shape=(n, n)), form.linear, form.constant
    if isinstance(function, DipolarFunction):
        return scipy.sparse.csr_matrix(function.matrix()), np.zeros(n), 0.0
    return None


def are_spins(system: Any) -> bool:
    """Return whether the algebra of a system consists of copies of so(3), in any order of the brackets."""
    if not system.has_structure_constants or system.dim % 3:
        return False
    found, one = system.algebra.triples, catalogue.so(3).triples
    first = 3 * np.arange(system.dim // 3)[:, None]
    if len(found.c) != system.dim:
        return False
    order = np.lexsort((found.j, found.i))
    columns = [np.asarray(column)[order] for column in (found.i, found.j, found.k)]
    same = np.lexsort((one.j, one.i))
    wanted = [(first + np.asarray(column)[same]).ravel() for column in (one.i, one.j, one.k)]
    constants = np.tile(np.asarray(one.c)[same], system.dim // 3)
    return all(map(np.array_equal, columns, wanted)) and np.array_equal(np.asarray(found.c)[order], constants)
