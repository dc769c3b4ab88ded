"""Spin models on crystals: exchange, anisotropies, fields and dipoles, declared bond by bond and site by site."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import Force, forces_text, read_seed
from coadjoint.systems.lattices.bonds import Bond, antisymmetric
from coadjoint.systems.lattices.couplings import Blocks, coupled_spins, driving_field, is_uniform
from coadjoint.systems.lattices.crystals import Crystal, label_of
from coadjoint.systems.lattices.declared_spins import (
    UNITS,
    Anisotropy,
    Biquadratic,
    Coupling,
    Declaration,
    ExchangeTable,
    Substitution,
    cells_text,
    check_joined_once,
    check_sizes,
    merged_bonds,
)
from coadjoint.systems.lattices.dipoles import DipolarCells, dipolar_energy
from coadjoint.systems.lattices.geometry import BYTES_PER_EDGE, edges_of_bonds
from coadjoint.systems.lattices.space_groups import product
from coadjoint.systems.lattices.spin_lattice import (
    MAX_STORED_VALUES,
    on_spins,
    precession,
    total_spins,
)
from coadjoint.systems.lattices.spin_polynomials import polynomial_of_spins, propagated, read_stevens
from coadjoint.systems.lattices.twists import Twist, windings
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import KnownInvariants
from coadjoint.validation import as_tuples, read_finite, read_number, read_positive, set_fields

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]


class SpinModel(LiePoissonSystem):
    """Spins on the sites of a crystal, to which exchange, anisotropies, fields and dipoles are added.

    `co.systems.spins` makes models without energy. Each method returns a new model, and leaves the old one as it was;
    the forces of a model are kept. A model is a system as `spin_lattice` returns it: runs, `co.thermal_states`,
    `co.equilibrium`, archives and batches take it. ``print`` shows its terms with their signs.

    Attributes
    ----------
    crystal : Crystal
        The crystal; bonds and sites of the terms are its own.
    size : tuple of int
        Cells along the three lattice vectors.
    periodic : tuple of bool
        Whether the lattice is periodic along each.
    twist : tuple of float
        Angles by which the spins are turned beyond the ends; zeros without a twist.
    units : str
        ``"natural"`` or ``"meV"``.
    spin, moments : (sites,) array
        Length S of each spin, and its moment g mu_B S in units of mu_B, in the order of the state.
    positions : (sites, 3) array
        Cartesian positions, in the unit of the crystal.
    cells, sites : (sites, 3) and (sites,) arrays of int
        Cell of each spin, and number of its site in the cell.
    boltzmann : float
        Energy of a unit of temperature: 0.0862 meV for units of meV, else 1.
    """

    def __init__(self, declared: Declaration) -> None:
        set_fields(self, _declared=declared)
        units, cell = UNITS[declared.units], len(declared.crystal.labels)
        sites = cell * math.prod(declared.size)
        check_available_memory(200 * sites, f"{short(sites)} spins")
        edges, blocks, field, driven = self._edges(sites)
        occupied = declared.occupied
        count = sites if occupied is None else len(occupied)
        if declared.twist is not None:
            self._check_invariant(declared.twist)
        matrices = np.zeros((cell, 3, 3))
        quartic = bool(declared.biquadratics) or any(one.polynomials for one in declared.anisotropies)
        for anisotropy in declared.anisotropies:
            matrices[anisotropy.sites] += anisotropy.matrices
        on_site = self._scaled_by_lengths(Blocks(matrices, self.sites), (np.arange(count),))
        if not np.any(matrices):
            on_site = Blocks(np.zeros((1, 3, 3)), np.broadcast_to(np.int64(0), count))
        H: Any = coupled_spins(count, edges, blocks, Blocks(2.0 * on_site.distinct, on_site.number), -field)
        if quartic:
            H = H + self._polynomial(count)
        uniform = None
        if driven is not None:
            driving, uniform = driving_field(driven, count)
            H = H + driving
        if declared.dipolar:
            moments = declared.g * declared.spin
            factors = self.moments / moments[self.sites] if declared.substitutions else None
            cells = DipolarCells(
                declared.crystal.lattice,
                declared.crystal.positions @ declared.crystal.lattice,
                declared.size,
                declared.periodic,
                moments,
                occupied,
                factors,
            )
            H = H + dipolar_energy(cells, units.dipole)
        mu = units.hbar * (self.spin if np.ptp(declared.spin) or declared.substitutions else declared.spin[0])
        plain = driven is None and not declared.dipolar and not quartic
        J, T, K = np.array(-1.0), blocks.distinct, -on_site.distinct
        exact = precession(count, edges, J, T if len(edges) else np.zeros((3, 3)), K, field, mu) if plain else None
        # A function of z alone leaves the rotations about it, as its square does.
        exponents = [key for one in declared.anisotropies for *_, terms in one.polynomials for key in terms]
        axial = np.diag([0.0, 0.0, float(bool(exponents))])
        known = not declared.dipolar and not any(key[0] or key[1] for key in exponents)
        total = partial(total_spins, count, T, np.zeros(3), np.concatenate([K, axial[None]]), field, uniform, mu)
        integrals = KnownInvariants(total()) if known else {}
        super().__init__(
            hamiltonian=H,
            **on_spins(count, mu),
            parameters=_parameters(count, edges, blocks, on_site, field, mu) if plain else None,
            exact=exact,
            integrals=integrals,
            layout={"lattice": "graph"},
        )
        set_fields(self, boltzmann=units.k_B)

    def _edges(self, sites: int) -> tuple[Integers, Blocks, Floats, Callable[..., Any] | None]:
        """Return edges, their matrices, the energies of spins in a constant field, and a function for another."""
        declared = self._declared
        bonds, distinct, kinds = merged_bonds(declared)
        check_available_memory(BYTES_PER_EDGE * len(bonds) * math.prod(declared.size), f"bonds of {short(sites)} spins")
        cell = len(declared.crystal.labels)
        by_bond = edges_of_bonds(cell, [(i, j, tuple(n)) for i, j, *n in bonds], declared.size, declared.periodic)
        numbers = np.repeat(np.array(kinds, dtype=np.int64), [len(part) for part in by_bond])
        if declared.twist is not None:
            turns, turn = self._turns(bonds)
            distinct = product(distinct[:, None], turns).reshape(-1, 3, 3)
            numbers = numbers * len(turns) + turn
        edges = np.concatenate([np.zeros((0, 2), dtype=np.int64), *by_bond])
        if declared.occupied is not None:
            new = np.full(sites, -1)
            new[declared.occupied] = np.arange(len(declared.occupied))
            edges = new[edges]
            both = np.all(edges >= 0, axis=1)
            edges, numbers = edges[both], numbers[both]
        blocks = self._scaled_by_lengths(Blocks(distinct, numbers), (edges[:, 0], edges[:, 1]))
        alike = not (np.ptp(declared.g * declared.spin) or declared.substitutions)
        moments = UNITS[declared.units].mu_B * (self._moments_of_states[:1] if alike else self._moments_of_states)
        field = declared.field
        if field is None:
            field = np.zeros(3)
        if callable(field):
            return edges, blocks, np.zeros(3), _scaled(field, moments, len(self.sites))
        field = moments[:, None] * field
        return edges, blocks, field[0] if len(field) == 1 else field, None

    def _turns(self, bonds: Sequence[tuple[int, ...]]) -> tuple[Floats, Integers]:
        """Return the distinct rotations of second spins of bonds of a cell, and the number of that of each edge."""
        declared = self._declared
        crossed = [windings(tuple(n), declared.size, declared.periodic) for _, _, *n in bonds]
        joined = np.concatenate([np.zeros((0, 3), dtype=np.int64), *crossed])
        if declared.twist is None or not len(joined):
            return np.eye(3)[None], np.zeros(len(joined), dtype=np.int64)
        return declared.twist.matrices(joined)

    def _check_invariant(self, twist: Twist) -> None:
        """Raise ValueError for terms that rotations about the axis of a twist change."""
        declared = self._declared
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

    def _polynomial(self, count: int) -> Any:
        """Return the terms of degree four and six."""
        declared = self._declared
        sites = len(declared.crystal.labels) * math.prod(declared.size)
        ratios = np.zeros(sites)
        ratios[self._numbers] = self.spin / declared.spin[self.sites]
        new = np.full(sites, -1)
        new[self._numbers] = np.arange(count)
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
        turns, turn = self._turns([bond for one in declared.biquadratics for bond in map(tuple, one.bonds.tolist())])
        present = np.all(new[joined] >= 0, axis=1)
        on_sites = []
        for anisotropy in declared.anisotropies:
            for site, degree, polynomial in anisotropy.polynomials:
                numbers = np.flatnonzero(self.sites == site)
                on_sites.append((numbers, ratios[self._numbers[numbers]] ** degree, polynomial))
        return polynomial_of_spins(count, new[joined[present]], scaled[present], (turns, turn[present]), on_sites)

    def _scaled_by_lengths(self, blocks: Blocks, ends: tuple[Integers, ...]) -> Blocks:
        """Return matrices of edges (two ends) or sites (one) times the ratios of the lengths of substituted spins."""
        if not self._declared.substitutions:
            return blocks
        ratios, classes = np.unique(self.spin / self._declared.spin[self.sites], return_inverse=True)
        first, last = classes[ends[0]], classes[ends[-1]]
        count = len(ratios)
        distinct = blocks.distinct[:, None, None] * (ratios[:, None] * ratios)[:, :, None, None]
        return Blocks(distinct.reshape(-1, 3, 3), (blocks.number * count + first) * count + last)

    @property
    def crystal(self) -> Crystal:
        """The crystal."""
        return self._declared.crystal

    @property
    def size(self) -> tuple[int, int, int]:
        """Cells along the three lattice vectors."""
        return self._declared.size

    @property
    def periodic(self) -> tuple[bool, bool, bool]:
        """Whether the lattice is periodic along each lattice vector."""
        return self._declared.periodic

    @property
    def twist(self) -> tuple[float, float, float]:
        """Angles by which spins are turned beyond the ends along the lattice vectors; zeros without a twist."""
        return self._declared.twist.angles if self._declared.twist else (0.0, 0.0, 0.0)

    @property
    def units(self) -> str:
        """``"natural"`` or ``"meV"``."""
        return self._declared.units

    @property
    def _numbers(self) -> Integers:
        """Numbers of the occupied sites among all."""
        declared = self._declared
        if declared.occupied is not None:
            return declared.occupied
        return np.arange(len(declared.crystal.labels) * math.prod(declared.size))

    @property
    def sites(self) -> Integers:
        """Number of the site of each spin in its cell, (sites,)."""
        return self._numbers % len(self.crystal.labels)

    @property
    def cells(self) -> Integers:
        """Cell of each spin, (sites, 3)."""
        return np.stack(np.unravel_index(self._numbers // len(self.crystal.labels), self.size), axis=-1)

    @property
    def spin(self) -> Floats:
        """Length S of each spin, (sites,)."""
        return self._with_substituted(self._declared.spin, lambda ion: ion.spin)

    @property
    def moments(self) -> Floats:
        """Moment g S of each spin in units of mu_B, (sites,)."""
        return self._with_substituted(self._declared.g * self._declared.spin, lambda ion: ion.g * ion.spin)

    @property
    def _moments_of_states(self) -> Floats:
        """Moment of a state of length 1 of each spin, in units of mu_B."""
        return self.moments

    def _with_substituted(self, of_cell: Floats, of_ion: Callable[[Substitution], float]) -> Floats:
        """Return numbers of the spins, from those of the sites of a cell, and of ions that are in their place."""
        found, numbers = of_cell[self.sites], self._numbers
        for ion in self._declared.substitutions:
            found[np.searchsorted(numbers, ion.numbers[np.isin(ion.numbers, numbers)])] = of_ion(ion)
        return found

    @property
    def positions(self) -> Floats:
        """Cartesian position of each spin, (sites, 3)."""
        return (self.cells + self.crystal.positions[self.sites]) @ self.crystal.lattice

    def exchange(self, bond: Bond | ExchangeTable, J: Any = None) -> Self:
        """Return the model with the energy ``S_i . J S_j`` of a bond and all equivalent ones; each bond counts once.

        J > 0 is antiferromagnetic, as for SpinW and Sunny, and opposite to ``exchange=`` of `spin_lattice`.

        Parameters
        ----------
        bond : Bond or ExchangeTable
            One of ``crystal.bonds(max_distance)``; or the bonds of a file, with their matrices, from
            `co.spins.read_exchange`.
        J : float or (3, 3) array_like
            Exchange of the representative in the Cartesian frame of the lattice, an energy for spins of the lengths S:
            the energy of parallel unit vectors is ``J S_i S_j``. Its antisymmetric part is a Dzyaloshinskii-Moriya
            coupling.

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError, TypeError
            A bond of another crystal, or one that has exchange already; a matrix that symmetry forbids, with the
            allowed form; cells that join two sites twice.

        Examples
        --------
        >>> import coadjoint as co
        >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)})
        >>> model = co.systems.spins(chain, (4, 1, 1)).exchange(chain.bonds(1)["1"], 0.5)
        >>> model.energy([0, 0, 1, 0, 0, -1] * 2)                       # antiparallel neighbours
        -2.0
        """
        if isinstance(bond, ExchangeTable):
            return self._with_table(bond, J)
        self._check_bond(bond, "exchange")
        return self._coupled("exchange", bond, bond.exchange(J), _described(np.asarray(J, dtype=np.float64)))

    def dzyaloshinskii_moriya(self, bond: Bond, D: Any) -> Self:
        """Return the model with the energy ``D . (S_i x S_j)`` of a bond and all equivalent ones.

        Parameters
        ----------
        bond : Bond
            One of ``crystal.bonds(max_distance)``; i is its first site.
        D : (3,) array_like
            The vector of the representative, in the Cartesian frame of the lattice (energy for spins of lengths S).

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError, TypeError
            As for `exchange`; a vector that symmetry forbids.

        Examples
        --------
        >>> import coadjoint as co
        >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P 1")
        >>> model = co.systems.spins(chain, (4, 1, 1)).dzyaloshinskii_moriya(chain.bonds(1)["1"], (0, 0, 0.5))
        >>> model.energy([1, 0, 0, 0, 1, 0, -1, 0, 0, 0, -1, 0])        # a spiral of four spins
        2.0
        """
        self._check_bond(bond, "dzyaloshinskii_moriya")
        vector = read_finite(D, "D")
        if vector.shape != (3,):
            raise ValueError(f"D has shape {vector.shape}; give a vector (3,)")
        return self._coupled(
            "dzyaloshinskii_moriya", bond, bond.exchange(antisymmetric(vector)), f"D = {vector.tolist()}"
        )

    def biquadratic(self, bond: Bond, K: float) -> Self:
        """Return the model with the energy ``K (S_i . S_j)^2`` of a bond and all equivalent ones.

        It is that of classical spins of the lengths S, as of Sunny's mode `:dipole_uncorrected`. In operators of
        quantum spins, and in its mode `:dipole`, K is ``K (1 - 1/(2 S))^2 (S_i . S_j)^2 - K S_i . S_j / 2``.

        Parameters
        ----------
        bond : Bond
            One of ``crystal.bonds(max_distance)``.
        K : float
            An energy for spins of lengths S: K < 0 prefers parallel and antiparallel spins, K > 0 perpendicular ones.

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError, TypeError
            As for `exchange`.

        Examples
        --------
        >>> import coadjoint as co
        >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)})
        >>> model = co.systems.spins(chain, (4, 1, 1)).biquadratic(chain.bonds(1)["1"], -0.1)
        >>> round(model.energy([0, 0, 1, 0, 0, -1] * 2), 12)            # antiparallel neighbours
        -0.4
        """
        self._check_bond(bond, "biquadratic")
        if any(one.bond == bond.name for one in self._declared.biquadratics):
            raise ValueError(f"bond {bond.name} has biquadratic in this model; give the sum of both once")
        value, lengths = read_number(K, "K"), self._declared.spin[bond.sites]
        strengths = value * np.prod(lengths**2, axis=1)
        check_sizes(strengths, "the biquadratic coupling")
        bonds = np.column_stack([bond.sites, bond.offsets])
        added = Biquadratic(bond.name, bonds, strengths, f"K = {value!r}")
        return self._with(biquadratics=(*self._declared.biquadratics, added))

    def single_ion(self, site: str | int, matrix: Any) -> Self:
        """Return the model with the energy ``S_i . A S_i`` of a site and all equivalent ones, or Stevens functions.

        Parameters
        ----------
        site : str or int
            A label, the element of one label only, or the number of a site of the cell, as for ``crystal.site``, whose
            ``print`` shows the allowed matrices.
        matrix : (3, 3) array_like or mapping
            A, symmetric, in the Cartesian frame of the lattice (energy for spins of length S). An easy axis has a
            negative entry: ``np.diag([0, 0, -D])``. Or Stevens coefficients by name, of degree l = 2, 4, 6 and m from
            -l to l: ``{"B20": -0.1, "B43": 0.02, "B4-3": 0.01}`` (see Notes).

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError, TypeError
            An unknown site, or one that has a matrix or coefficients already; a matrix or coefficients that symmetry
            forbids, with the allowed form; an unknown coefficient.

        Notes
        -----
        The Stevens functions are classical: ``sum B_lm O_lm(S)`` with ``O_20 = 3 z^2 - r^2``, ``O_22 = x^2 - y^2``,
        ``O_40 = 35 z^4 - 30 z^2 r^2 + 3 r^4``, ``O_43 = z (x^3 - 3 x y^2)``, ``O_44 = x^4 - 6 x^2 y^2 + y^4``, ..., for
        m < 0 with ``Im (x + iy)^-m`` in place of ``Re (x + iy)^m``, of a vector S of length r = S, in the Cartesian
        frame of the lattice, z along its third axis. Coefficients of quantum spins, as of a crystal field, have in a
        coherent state the factor ``(1 - 1/(2 S)) (1 - 2/(2 S)) ... (1 - (l - 1)/(2 S))``, which Sunny's mode `:dipole`
        applies and `:dipole_uncorrected` does not: multiply by it to compare with the former.

        References
        ----------
        K. W. H. Stevens, Proc. Phys. Soc. A 65, 209 (1952); C. Rudowicz, C. Y. Chung, J. Phys.: Condens. Matter 16,
        5825 (2004), all functions; D. Dahlbom et al., arXiv:2304.03874, the factors.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> tetragonal = co.spins.crystal(lattice=(1, 1, 2, 90, 90, 90), sites={"Mn": (0, 0, 0)})
        >>> model = co.systems.spins(tetragonal, (1, 1, 1), spin=2).single_ion("Mn", np.diag([0, 0, -0.1]))
        >>> model.energy([0, 0, 1])
        -0.4
        >>> model = co.systems.spins(tetragonal, (1, 1, 1), spin=2).single_ion("Mn", {"B40": 0.01, "B44": 0.05})
        >>> round(model.energy([1, 0, 0]), 12)                          # 16 (3 B40 + B44)
        1.28
        """
        chosen = self.crystal.site(site)
        lengths = self._declared.spin[chosen.sites]
        what = "Stevens coefficients" if isinstance(matrix, Mapping) else "a single-ion matrix"
        for known in self._declared.anisotropies:
            if known.what == what and set(known.sites.tolist()) & set(chosen.sites.tolist()):
                raise ValueError(f"site {chosen.label} {chosen.number} has {what}; give the sum of both once")
        if isinstance(matrix, Mapping):
            named = dict(matrix)
            matrix, by_degree = read_stevens(named, float(lengths[0]))
            check_sizes(
                np.array([c for terms in by_degree.values() for c in terms.values()]), "the Stevens coefficients"
            )
            polynomials = tuple(
                (int(number), degree, polynomial)
                for degree, terms in by_degree.items()
                for number, polynomial in zip(chosen.sites, propagated(chosen, terms), strict=True)
            )
            matrices, text = (
                chosen.single_ion(matrix),
                ", ".join(f"{name} = {value!r}" for name, value in named.items()),
            )
        else:
            matrices, polynomials = chosen.single_ion(matrix) * (lengths**2)[:, None, None], ()
            text = f"A = {np.asarray(matrix).tolist()}"
        matrices = 0.5 * (matrices + matrices.swapaxes(1, 2))  # of which the two triangles differ by rounding
        check_sizes(matrices, "the single-ion matrix")
        added = Anisotropy(what, chosen.sites, matrices, polynomials, f"site {chosen.label} {chosen.number}: {text}")
        return self._with(anisotropies=(*self._declared.anisotropies, added))

    def field(self, B: Any) -> Self:
        """Return the model in a magnetic field, with the energy ``-g mu_B B . S_i`` of each spin.

        Positive moments g align with the field. Spins are angular momenta, and those of electrons are opposite to their
        moments: with ``g=-2`` states are these spins, as in SpinW and Sunny, with the handedness of their precession.

        Parameters
        ----------
        B : (3,), (sites, 3), or function of the time that returns one of them
            The field in the Cartesian frame: in tesla for units of meV, else an energy over the moment g S. It replaces
            a field that the model has. Numba compiles the function.

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError, TypeError
            Another shape, or numbers that are not finite.

        Examples
        --------
        >>> import coadjoint as co
        >>> ion = co.spins.crystal(lattice=(3, 3, 3, 90, 90, 90), sites={"Mn": (0, 0, 0)})
        >>> round(co.systems.spins(ion, (1, 1, 1), spin=2.5, units="meV").field((0, 0, 1.0)).energy([0, 0, 1]), 4)
        -0.2894
        """
        if not callable(B):
            B = read_finite(B, "B")
            if B.shape not in ((3,), (len(self.sites), 3)):
                raise ValueError(
                    f"B has shape {B.shape}; give (3,), or ({len(self.sites)}, 3) with one row for each spin"
                )
            check_sizes(B, "B")
        return self._with(field=B)

    def dipolar(self) -> Self:
        """Return the model with the dipolar energy of its moments, by FFT on cells.

        Open lattices have the sum over all pairs of sites, and lattices that are periodic along all three axes Ewald's
        sum over all their images, of a sample in a surrounding conductor: it has no demagnetization field, and parallel
        moments on a cubic lattice have the field mu0 M/3. For a shape with demagnetization tensor N add
        ``mu0 V (M . N M) / 2``. Lattices that are periodic along two axes are films, with the sum over all images in
        their plane and no film above or below: a thick one has the demagnetization field -mu0 M across it. Splittings
        do not support dipoles; `GaussLegendre(1)` conserves the energy.

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError
            A lattice that is periodic along one axis only, or twisted; a model with dipoles.

        References
        ----------
        S. W. de Leeuw, J. W. Perram, E. R. Smith, Proc. R. Soc. Lond. A 373, 27 (1980); D. E. Parry, Surf. Sci. 49, 433
        (1975), films.

        Examples
        --------
        The energy of one dipole in a periodic cube is -mu0 mu^2/(6 V), in natural units -2 pi/3:

        >>> import numpy as np, coadjoint as co
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> energy = co.systems.spins(cube, (1, 1, 1), g=1).dipolar().energy([0, 0, 1])
        >>> bool(abs(energy + 2 * np.pi / 3) < 1e-13)
        True
        """
        if self._declared.dipolar:
            raise ValueError("the model has dipoles; call dipolar once")
        if sum(self.periodic) == 1:
            raise ValueError(
                f"dipolar is given for a lattice with periodic={self.periodic}; dipoles are summed over open lattices, "
                "films that are periodic along two axes, and lattices that are along all three"
            )
        return self._with(dipolar=True)

    def vacancies(self, fraction: Any, seed: int) -> Self:
        """Return the model without a random part of its spins; states have the occupied sites only.

        Parameters
        ----------
        fraction : float or mapping
            Removed fraction of all sites, or label -> fraction of its sites, from 0 to less than 1; the number of
            vacancies is rounded. The element of one label only stands for it.
        seed : int
            Seed of the choice, from 0 to 2^62.

        Returns
        -------
        SpinModel
            Without the bonds to vacancies. ``cells`` and ``sites`` say where its spins are.

        Raises
        ------
        ValueError, TypeError
            A fraction out of range, an unknown label, one that is given twice, a model that has vacancies or a field
            for each spin, or no spin that remains.

        Examples
        --------
        >>> import coadjoint as co
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> co.systems.spins(cube, (4, 4, 4)).vacancies(0.25, seed=1).dim
        144
        """
        declared = self._declared
        if declared.occupied is not None:
            raise ValueError("the model has vacancies; give all of them in one call")
        if not callable(declared.field) and np.ndim(declared.field) == 2:
            raise ValueError(
                "the model has a field for each spin; remove spins first, then give the field of the others"
            )
        given: dict[str | None, Any] = {None: fraction}
        if isinstance(fraction, Mapping):
            given = {label_of(self.crystal, label, "label"): value for label, value in fraction.items()}
            if len(given) < len(fraction):
                raise ValueError(f"fraction is {short(dict(fraction))}, which has a label and its element; give one")
        generator = np.random.default_rng(read_seed(seed, "seed"))
        removed = [self._chosen(generator, label, value) for label, value in given.items()]
        occupied = np.setdiff1d(self._numbers, np.concatenate([self._numbers[:0], *removed]))
        if not len(occupied):
            raise ValueError(f"fraction is {short(fraction)}, which leaves no spin; give a smaller one")
        return self._with(occupied=occupied)

    def substitute(self, label: str, fraction: float, seed: int, *, spin: float, g: float | None = None) -> Self:
        """Return the model with other ions at a random part of the sites of a label.

        Choose it for alloys. The couplings of spins S are the same: exchange, Dzyaloshinskii-Moriya and single-ion
        matrices multiply the lengths of the new spins, and the dipoles have their moments. Matrices of directions, as
        of TB2J, are multiplied by the ratios of the lengths.

        Parameters
        ----------
        label : str
            Label of the sites, or the element of one label only.
        fraction : float
            Part of the spins of this label, from 0 to less than 1; their number is rounded.
        seed : int
            Seed of the choice, from 0 to 2^62.
        spin : float
            Length S of the new ions.
        g : float, optional
            Their g-factor; by default that of the sites.

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError, TypeError
            An unknown label, or a number out of range.

        Examples
        --------
        >>> import coadjoint as co
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Mn": (0, 0, 0)})
        >>> alloy = co.systems.spins(cube, (4, 4, 4), spin=5 / 2).substitute("Mn", 0.25, seed=1, spin=1)
        >>> float(alloy.spin.sum())
        136.0
        """
        length, label = read_positive(spin, "spin"), label_of(self.crystal, label, "label")
        numbers = self._chosen(np.random.default_rng(read_seed(seed, "seed")), label, fraction)
        own = float(self._declared.g[self.crystal.labels.index(label)])
        factor = own if g is None else read_number(g, "g")
        if factor == 0.0:
            raise ValueError("g is 0; give another number")
        check_sizes(np.array([length, 1.0 / length, factor]), "spin, or g,")
        text = f"{len(numbers)} of {label}: S = {length:.6g}, moment {factor * length:.6g} mu_B"
        return self._with(substitutions=(*self._declared.substitutions, Substitution(numbers, length, factor, text)))

    def _chosen(self, generator: np.random.Generator, label: str | None, fraction: Any) -> Integers:
        """Return the numbers of a random part of the spins of a label, or of all, in order."""
        part, numbers = read_number(fraction, "fraction"), self._numbers
        if not 0.0 <= part < 1.0:
            raise ValueError(f"fraction is {part!r}; give a number from 0 to less than 1")
        if label is not None:
            numbers = numbers[np.array([one == label for one in self.crystal.labels])[self.sites]]
        return np.sort(generator.permutation(numbers)[: round(part * len(numbers))])

    def with_forces(self, *forces: Force) -> Self:
        """Return the model with damping, torques or noise, see `System.with_forces`.

        Parameters
        ----------
        *forces : Force
            One or more of ``co.forces``. A ``temperature`` is in the unit of the model, kelvin for units of meV; the
            forces of the new model have Boltzmann's constant times it, an energy, and are taken as they are by other
            models.

        Returns
        -------
        SpinModel
        """
        return super().with_forces(*(_in_energies(force, self.boltzmann) for force in forces))

    def _with(self, **changes: Any) -> Self:
        changed = type(self)(replace(self._declared, **changes))
        return changed._with_acting(self.forces) if self.forces else changed

    def _check_bond(self, bond: Any, what: str) -> None:
        if not isinstance(bond, Bond):
            raise TypeError(f'bond is {short(bond)}; give one of crystal.bonds(max_distance), such as bonds["1"]')
        crystal = self.crystal
        known = max(bond.first, bond.second) < len(crystal.labels)
        ends = (crystal.labels[bond.first], crystal.labels[bond.second]) if known else ()
        if ends == bond.kinds:
            step = crystal.positions[bond.second] + bond.offset - crystal.positions[bond.first]
            known = bool(np.abs(step @ crystal.lattice - bond.vector).max() <= 1e-9 * bond.distance)
        if ends != bond.kinds or not known:
            raise ValueError(f"{bond!r} is of another crystal than {crystal!r}; take one of model.crystal.bonds")
        if any(one.what == what and one.bond == bond.name for one in self._declared.couplings):
            raise ValueError(f"bond {bond.name} has {what} in this model; give the sum of both once")

    def _coupled(self, what: str, bond: Bond, matrices: Floats, text: str) -> Self:
        listed = next((one.bonds for one in self._declared.couplings if one.bond == "file"), np.zeros((0, 5)))
        key = (bond.first, bond.second, *bond.offset)
        if what == "exchange" and {key, (key[1], key[0], *(-n for n in key[2:]))} & set(map(tuple, listed.tolist())):
            raise ValueError(f"bond {bond.name} is in the file of this model; give it once")
        matrices = self._for_states(matrices, bond.sites)
        return self._with_coupling(what, bond.name, np.column_stack([bond.sites, bond.offsets]), matrices, text)

    def _for_states(self, matrices: Floats, sites: Integers, of_directions: bool = False) -> Floats:
        """Return the matrices of bonds that act on states, from those that act on spins, or on directions."""
        lengths = np.ones(2) if of_directions else self._declared.spin[sites]
        return np.asarray(matrices * (lengths[..., 0] * lengths[..., 1])[..., None, None])

    def _with_table(self, table: ExchangeTable, J: Any) -> Self:
        if J is not None:
            raise ValueError(f"J is {short(J)}, and {table!r} has its own matrices; give exchange(table)")
        if table.units != self.units:
            raise ValueError(f"{table!r} has the units {table.units}, and the model {self.units}; give equal ones")
        if table.sites.max(initial=0) >= len(self.crystal.labels):
            raise ValueError(
                f"{table!r} has site {table.sites.max()}, and {self.crystal!r} fewer; read it for this crystal"
            )
        if any(one.what == "exchange" for one in self._declared.couplings):
            raise ValueError("the model has exchange; add a table first, and bonds that it does not have afterwards")
        matrices = self._for_states(table.matrices, table.sites, table.of_directions)
        bonds = np.column_stack([table.sites, table.offsets])
        return self._with_coupling(
            "exchange", "file", bonds, matrices, f"{len(bonds)} matrices of {short(table.source)}"
        )

    def _with_coupling(self, what: str, bond: str, bonds: Integers, matrices: Floats, text: str) -> Self:
        check_sizes(matrices, "the coupling")
        return self._with(couplings=(*self._declared.couplings, Coupling(what, bond, bonds, matrices, text)))

    def _text(self) -> str:
        names = [f"{one.what} on {one.bond}" for one in self._declared.couplings]
        names += [f"biquadratic on {one.bond}" for one in self._declared.biquadratics]
        names += [f"single_ion on {one.text.partition(':')[0]}" for one in self._declared.anisotropies]
        names += ["field"] * (self._declared.field is not None) + ["dipolar"] * self._declared.dipolar
        terms = ", ".join(names) if names else "no energy"
        return (
            f"<{len(self.sites)} spins on {self.crystal!r}, {cells_text(self.size)} cells: {short(terms, 120)[1:-1]}>"
        )

    def __str__(self) -> str:
        declared, units = self._declared, UNITS[self.units]
        energy, tesla = units.names[:2]
        kinds = dict.fromkeys(
            f"{label}: S = {S:.6g}, moment {g * S:.6g} mu_B"
            for label, S, g in zip(self.crystal.labels, declared.spin.tolist(), declared.g.tolist(), strict=True)
        )
        lines = [
            f"{len(self.sites)} spins, {cells_text(self.size)} cells, periodic={self.periodic}, units {self.units}",
            "H = sum of S_i . J S_j + D . (S_i x S_j) + K (S_i . S_j)^2 over bonds + S_i . A S_i + B_lm O_lm(S_i)"
            " - g mu_B B . S_i over sites",
            *([] if (twist := declared.twist) is None else [f"twist {twist.angles} rad about {twist.axis}"]),
            *kinds,
            *(ion.text for ion in declared.substitutions),
        ]
        for one in declared.couplings:
            lines.append(f"bond {one.bond}: {one.text}{energy}")
        lines += [f"bond {one.bond}: {one.text}{energy}" for one in declared.biquadratics]
        lines += [one.text + energy for one in declared.anisotropies]
        if declared.field is not None:
            shown = "a function of the time" if callable(declared.field) else short(declared.field.tolist(), 60)
            lines.append(f"field B = {shown}{tesla}")
        lines += ["dipoles"] * declared.dipolar + [f"forces: {forces_text(self.forces)}"] * bool(self.forces)
        return "\n".join(lines)

    _declared: Declaration


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


def _in_energies(force: Any, boltzmann: float) -> Any:
    """Return a force with energies in place of temperatures, marked so that it is not done twice."""
    if boltzmann == 1.0 or not hasattr(force, "temperature") or getattr(force, "_in_energies", False):
        return force
    converted = replace(force, temperature=as_tuples(boltzmann * np.asarray(force.temperature)))
    set_fields(converted, _in_energies=True)
    return converted


def _described(J: Floats) -> str:
    """Return an exchange matrix as text, with the order that its isotropic part prefers."""
    value = float(J if J.ndim == 0 else J.trace() / 3.0)
    sense = "antiferromagnetic" if value > 0.0 else "ferromagnetic" if value < 0.0 else "anisotropic"
    return f"J = {J.tolist()} ({sense})"
