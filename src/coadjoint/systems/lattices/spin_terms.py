"""The system of a declared spin model: its Hamiltonian, algebra, parameters, and what is known of its motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.lattices.couplings import Blocks, coupled_spins, driving_field, is_uniform
from coadjoint.systems.lattices.declared_spins import UNITS, Declaration, check_joined_once, merged_bonds
from coadjoint.systems.lattices.dipoles import DipolarCells, dipolar_energy
from coadjoint.systems.lattices.geometry import BYTES_PER_EDGE, edges_of_bonds
from coadjoint.systems.lattices.space_groups import product
from coadjoint.systems.lattices.spin_lattice import MAX_STORED_VALUES, on_spins, precession, total_spins
from coadjoint.systems.lattices.spin_polynomials import polynomial_of_spins
from coadjoint.systems.lattices.twists import Twist, windings
from coadjoint.systems.system_checks import KnownInvariants
from coadjoint.validation import as_tuples

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


def system_of(declared: Declaration) -> dict[str, Any]:
    """Return the arguments of the `LiePoissonSystem` of a declared model."""
    units, cell = UNITS[declared.units], len(declared.crystal.labels)
    check_available_memory(200 * declared.count, f"{short(declared.count)} spins")
    if declared.twist is not None:
        _check_invariant(declared, declared.twist)
    edges, blocks, field, driven = edges_of(declared, declared.moments)
    count = len(declared.numbers)
    matrices = np.zeros((cell, 3, 3))
    quartic = bool(declared.biquadratics) or any(one.polynomials for one in declared.anisotropies)
    for anisotropy in declared.anisotropies:
        matrices[anisotropy.sites] += anisotropy.matrices
    on_site = _scaled_by_lengths(declared, Blocks(matrices, declared.sites), (np.arange(count),))
    if not np.any(matrices):
        on_site = Blocks(np.zeros((1, 3, 3)), np.broadcast_to(np.int64(0), count))
    H: Any = coupled_spins(count, edges, blocks, Blocks(2.0 * on_site.distinct, on_site.number), -field)
    if quartic:
        H = H + _polynomial(declared, count)
    uniform = None
    if driven is not None:
        driving, uniform = driving_field(driven, count)
        H = H + driving
    if declared.dipolar:
        moments = declared.g * declared.spin
        factors = declared.moments / moments[declared.sites] if declared.substitutions else None
        H = H + dipolar_energy(cells_of(declared, moments, factors), units.dipole)
    mu = units.hbar * (declared.lengths if np.ptp(declared.spin) or declared.substitutions else declared.spin[0])
    plain = driven is None and not declared.dipolar and not quartic
    J, T, K = np.array(-1.0), blocks.distinct, -on_site.distinct
    exact = precession(count, edges, J, T if len(edges) else np.zeros((3, 3)), K, field, mu) if plain else None
    axes = _axes_of_symmetry(declared)
    known = axes is not None and not declared.dipolar
    squares = K if axes is None else np.concatenate([K, axes])
    parameters = _parameters(count, edges, blocks, on_site, field, mu) if plain else None
    return {
        "hamiltonian": H,
        **on_spins(count, mu),
        **({"name": "spins"} if parameters is None else {}),  # others are stored as the `spin_lattice` that they are
        "parameters": parameters,
        "exact": exact,
        "integrals": KnownInvariants(total_spins(count, T, np.zeros(3), squares, field, uniform, mu)) if known else {},
        "layout": {"lattice": "graph"},
    }


def cells_of(declared: Declaration, moments: Floats, factors: Floats | None = None) -> DipolarCells:
    """Return the cells of the dipoles of a declared model, with the moments of the sites of a cell."""
    lattice, positions = declared.crystal.lattice, declared.crystal.positions @ declared.crystal.lattice
    return DipolarCells(lattice, positions, declared.size, declared.periodic, moments, declared.occupied, factors)


def _axes_of_symmetry(declared: Declaration) -> Floats | None:
    """Return matrices (k, 3, 3) as invariant as twists and Stevens functions; None if no rotation leaves these."""
    exponents = [key for one in declared.anisotropies for *_, terms in one.polynomials for key in terms]
    if any(key[0] or key[1] for key in exponents):
        return None
    found = [np.diag([0.0, 0.0, 1.0])] * bool(exponents)  # functions of z alone
    if declared.twist is not None:
        found.append(np.multiply.outer(declared.twist.axis, declared.twist.axis))
    return np.array(found).reshape(-1, 3, 3)


def edges_of(declared: Declaration, moments: Floats) -> tuple[Integers, Blocks, Floats, Callable[..., Any] | None]:
    """Return edges, their matrices, the energies of spins in a constant field, and a function for another.

    `moments`, in units of mu_B, are those of states of length one.
    """
    bonds, distinct, kinds = merged_bonds(declared)
    check_available_memory(
        BYTES_PER_EDGE * len(bonds) * math.prod(declared.size), f"bonds of {short(declared.count)} spins"
    )
    cell = len(declared.crystal.labels)
    by_bond = edges_of_bonds(cell, [(i, j, tuple(n)) for i, j, *n in bonds], declared.size, declared.periodic)
    numbers = np.repeat(np.array(kinds, dtype=np.int64), [len(part) for part in by_bond])
    if declared.twist is not None:
        turns, turn = _turns(declared, bonds)
        distinct = product(distinct[:, None], turns).reshape(-1, 3, 3)
        numbers = numbers * len(turns) + turn
    edges = np.concatenate([np.zeros((0, 2), dtype=np.int64), *by_bond])
    if declared.occupied is not None:
        new = np.full(declared.count, -1)
        new[declared.occupied] = np.arange(len(declared.occupied))
        edges = new[edges]
        both = np.all(edges >= 0, axis=1)
        edges, numbers = edges[both], numbers[both]
    blocks = _scaled_by_lengths(declared, Blocks(distinct, numbers), (edges[:, 0], edges[:, 1]))
    alike = not (np.ptp(declared.g * declared.spin) or declared.substitutions)
    moments = UNITS[declared.units].mu_B * (moments[:1] if alike else moments)
    field = declared.field
    if field is None:
        field = np.zeros(3)
    if callable(field):
        return edges, blocks, np.zeros(3), _scaled(field, moments, len(declared.sites))
    field = moments[:, None] * field
    return edges, blocks, field[0] if len(field) == 1 else field, None


def _turns(declared: Declaration, bonds: Sequence[tuple[int, ...]]) -> tuple[Floats, Integers]:
    """Return the distinct rotations of second spins of bonds of a cell, and the number of that of each edge."""
    crossed = [windings(tuple(n), declared.size, declared.periodic) for _, _, *n in bonds]
    joined = np.concatenate([np.zeros((0, 3), dtype=np.int64), *crossed])
    if declared.twist is None or not len(joined):
        return np.eye(3)[None], np.zeros(len(joined), dtype=np.int64)
    return declared.twist.matrices(joined)


def _check_invariant(declared: Declaration, twist: Twist) -> None:
    """Raise ValueError for terms that rotations about the axis of a twist change."""
    for coupling in declared.couplings:
        twist.check_matrices(coupling.matrices, f"{coupling.what} on bond {coupling.bond}")
    for anisotropy in declared.anisotropies:
        what = f"single_ion on {anisotropy.text.partition(':')[0]}"
        twist.check_matrices(anisotropy.matrices, what)
        for *_, polynomial in anisotropy.polynomials:
            twist.check_polynomial(polynomial, what)
    if declared.field is not None:
        twist.check_field(declared.field)
    if declared.dipolar:
        raise ValueError("dipolar is given for a twisted lattice, whose rotations change it; give no twist")


def _polynomial(declared: Declaration, count: int) -> Any:
    """Return the terms of degree four and six."""
    ratios = np.zeros(declared.count)
    ratios[declared.numbers] = declared.lengths / declared.spin[declared.sites]
    new = np.full(declared.count, -1)
    new[declared.numbers] = np.arange(count)
    edges, strengths, owner = [np.zeros((0, 2), dtype=np.int64)], [np.zeros(0)], dict[tuple[int, ...], str]()
    for one in declared.biquadratics:
        bonds = [(i, j, tuple(n)) for i, j, *n in one.bonds.tolist()]
        owner |= {(i, j, *n): one.bond for i, j, n in bonds}
        by_bond = edges_of_bonds(len(declared.crystal.labels), bonds, declared.size, declared.periodic)
        edges += by_bond
        strengths += [np.full(len(part), K) for part, K in zip(by_bond, one.strengths.tolist(), strict=True)]
    check_joined_once(declared, owner)
    joined = np.concatenate(edges)
    scaled = np.concatenate(strengths) * np.prod(ratios[joined] ** 2, axis=1)
    turns, turn = _turns(declared, [bond for one in declared.biquadratics for bond in map(tuple, one.bonds.tolist())])
    present = np.all(new[joined] >= 0, axis=1)
    on_sites = []
    for anisotropy in declared.anisotropies:
        for site, degree, polynomial in anisotropy.polynomials:
            numbers = np.flatnonzero(declared.sites == site)
            on_sites.append((numbers, ratios[declared.numbers[numbers]] ** degree, polynomial))
    return polynomial_of_spins(count, new[joined[present]], scaled[present], (turns, turn[present]), on_sites)


def _scaled_by_lengths(declared: Declaration, blocks: Blocks, ends: tuple[Integers, ...]) -> Blocks:
    """Return matrices of edges (two ends) or sites (one) times the ratios of the lengths of substituted spins."""
    if not declared.substitutions:
        return blocks
    ratios, classes = np.unique(declared.lengths / declared.spin[declared.sites], return_inverse=True)
    first, last = classes[ends[0]], classes[ends[-1]]
    count = len(ratios)
    distinct = blocks.distinct[:, None, None] * (ratios[:, None] * ratios)[:, :, None, None]
    return Blocks(distinct.reshape(-1, 3, 3), (blocks.number * count + first) * count + last)


def _parameters(
    count: int, edges: Integers, blocks: Blocks, on_site: Blocks, field: Floats, mu: Any
) -> dict[str, Any] | None:
    """Return the parameters with which `spin_lattice` makes the system; None if they are too many."""
    if 11 * len(edges) + 13 * count > MAX_STORED_VALUES:
        return None
    found: dict[str, Any] = {"lattice": as_tuples(edges), "shape": count, "periodic": False, "exchange": -1.0}
    found["tensor"] = as_tuples(blocks.distinct[blocks.number]) if len(edges) else (1.0, 1.0, 1.0)
    found["dm"] = (0.0, 0.0, 0.0)
    found["field"] = as_tuples(field)
    found["on_site"] = as_tuples(-on_site.distinct[on_site.number]) if np.any(on_site.distinct) else (0.0, 0.0, 0.0)
    if np.ndim(mu) or mu != 1.0:
        found["moments"] = as_tuples(np.asarray(mu))
    return found


def _scaled(field: Callable[..., Any], moments: Floats, count: int) -> Callable[..., Any]:
    """Return the function of the time that is moments times the field of a function."""
    if is_uniform(field, count) and len(moments) == 1:
        moment = float(moments[0])

        def uniform(t: Any) -> Any:
            B = field(t)
            return moment * B[0], moment * B[1], moment * B[2]

        return uniform
    each = np.broadcast_to(moments, count).copy()

    def of_each(t: Any) -> Any:
        return each.reshape(-1, 1) * np.asarray(field(t))

    return of_each
