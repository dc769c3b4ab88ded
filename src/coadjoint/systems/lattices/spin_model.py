"""Spin models on crystals: exchange, anisotropies, fields and dipoles, declared bond by bond and site by site."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.forces.base import Force, forces_text, read_seed
from coadjoint.systems.lattices.bonds import LETTERS, Bond, Site, antisymmetric
from coadjoint.systems.lattices.crystals import Crystal, check_bond, label_of
from coadjoint.systems.lattices.declared_spins import (
    UNITS,
    Anisotropy,
    Biquadratic,
    Coupling,
    Declaration,
    ExchangeTable,
    Substitution,
    cells_text,
    check_sizes,
)
from coadjoint.systems.lattices.space_groups import product
from coadjoint.systems.lattices.spin_constants import constants_of, read_name, with_constants
from coadjoint.systems.lattices.spin_polynomials import not_empty, propagated, read_stevens
from coadjoint.systems.lattices.spin_terms import system_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.validation import read_finite, read_number, read_positive, set_fields

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
        super().__init__(**system_of(declared))
        set_fields(self, boltzmann=UNITS[declared.units].k_B, _constants=constants_of(self))

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
    def sites(self) -> Integers:
        """Number of the site of each spin in its cell, (sites,)."""
        return self._declared.sites

    @property
    def cells(self) -> Integers:
        """Cell of each spin, (sites, 3)."""
        return np.stack(np.unravel_index(self._declared.numbers // len(self.crystal.labels), self.size), axis=-1)

    @property
    def spin(self) -> Floats:
        """Length S of each spin, (sites,)."""
        return self._declared.lengths

    @property
    def moments(self) -> Floats:
        """Moment g S of each spin in units of mu_B, (sites,)."""
        return self._declared.moments

    @property
    def positions(self) -> Floats:
        """Cartesian position of each spin, (sites, 3)."""
        return (self.cells + self.crystal.positions[self.sites]) @ self.crystal.lattice

    def exchange(self, bond: Bond | ExchangeTable, J: Any = None, *, name: str | None = None) -> Self:
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
        name : str, optional
            Name of J as a parameter, by default ``"exchange"`` and the name of the bond. Of a matrix it is followed by
            A, B, ..., the free entries of ``print(bond)``. Bonds of one name have one J, which derivatives and fits
            move together.

        Returns
        -------
        SpinModel

        Raises
        ------
        ValueError, TypeError
            A bond of another crystal, or one that has exchange already; a matrix that symmetry forbids, with the
            allowed form; cells that join two sites twice; a name that has another value, or of another parameter.

        Examples
        --------
        >>> import coadjoint as co
        >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Cu": (0, 0, 0)})
        >>> model = co.systems.spins(chain, (4, 1, 1)).exchange(chain.bonds(1)["1"], 0.5)
        >>> model.energy([0, 0, 1, 0, 0, -1] * 2)                       # antiparallel neighbours
        -2.0
        """
        if isinstance(bond, ExchangeTable):
            if name is not None:
                raise ValueError(f"name is {short(name)}, and matrices of a file have no names; give exchange(table)")
            return self._with_table(bond, J)
        self._check_bond(bond, "exchange")
        matrices, given = bond.exchange(J), np.asarray(J, dtype=np.float64)
        constants = bond._entries(matrices[0]) if given.ndim else {"": float(given)}
        known, symbol = read_name(name, f"exchange {bond.name}", "J")
        return self._coupled("exchange", bond, matrices, constants, known, _described(given, symbol))

    def dzyaloshinskii_moriya(self, bond: Bond, D: Any, *, name: str | None = None) -> Self:
        """Return the model with the energy ``D . (S_i x S_j)`` of a bond and all equivalent ones.

        Parameters
        ----------
        bond : Bond
            One of ``crystal.bonds(max_distance)``; i is its first site.
        D : (3,) array_like
            The vector of the representative, in the Cartesian frame of the lattice (energy for spins of lengths S).
        name : str, optional
            As for `exchange`, by default ``"dzyaloshinskii_moriya"`` and the name of the bond, followed by the letters
            of the vector in ``print(bond)``.

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
        matrices = bond.exchange(antisymmetric(vector))
        odd = {key for key, one in zip(LETTERS, bond.basis, strict=False) if not np.array_equal(one, one.T)}
        constants = {key: value for key, value in bond._entries(matrices[0]).items() if key in odd}
        known, symbol = read_name(name, f"dzyaloshinskii_moriya {bond.name}", "D")
        text = f"{symbol} = {vector.tolist()}"
        return self._coupled("dzyaloshinskii_moriya", bond, matrices, constants, known, text)

    def biquadratic(self, bond: Bond, K: float, *, name: str | None = None) -> Self:
        """Return the model with the energy ``K (S_i . S_j)^2`` of a bond and all equivalent ones.

        It is that of classical spins of the lengths S, as of Sunny's mode `:dipole_uncorrected`. In operators of
        quantum spins, and in its mode `:dipole`, K is ``K (1 - 1/(2 S))^2 (S_i . S_j)^2 - K S_i . S_j / 2``.

        Parameters
        ----------
        bond : Bond
            One of ``crystal.bonds(max_distance)``.
        K : float
            An energy for spins of lengths S: K < 0 prefers parallel and antiparallel spins, K > 0 perpendicular ones.
        name : str, optional
            Name of K as a parameter, as for `exchange`; by default ``"biquadratic"`` and the name of the bond.

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
        value, lengths = read_number(K, "K"), self._declared.spin[bond.sites]
        strengths = value * np.prod(lengths**2, axis=1)
        check_sizes(strengths, "the biquadratic coupling")
        bonds = np.column_stack([bond.sites, bond.offsets])
        known, symbol = read_name(name, f"biquadratic {bond.name}", "K")
        text = f"{symbol} = {value!r}"
        added = Biquadratic("biquadratic", bond.name, bonds, strengths, text, bond, {"": value}, known)
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
        if isinstance(matrix, Mapping):
            return self._with_stevens(chosen, not_empty(matrix))
        lengths = self._declared.spin[chosen.sites]
        matrices = _symmetric(chosen.single_ion(matrix) * (lengths**2)[:, None, None])
        return self._with_anisotropy(
            Anisotropy("a single-ion matrix", chosen.sites, matrices, (), f"A = {np.asarray(matrix).tolist()}", chosen)
        )

    def _with_stevens(self, site: Site, given: Mapping[str, Any], checked: bool = True) -> Self:
        """Return the model with Stevens coefficients by name, of a site and all equivalent ones."""
        matrix, by_degree = read_stevens(given, float(self._declared.spin[site.sites[0]]))
        check_sizes(np.array([c for terms in by_degree.values() for c in terms.values()]), "the Stevens coefficients")
        polynomials = tuple(
            (int(number), degree, polynomial)
            for degree, terms in by_degree.items()
            for number, polynomial in zip(site.sites, propagated(site, terms, checked), strict=True)
        )
        R = site._rotations
        matrices = _symmetric(site.single_ion(matrix) if checked else product(product(R, matrix), R.swapaxes(1, 2)))
        text = ", ".join(f"{name} = {value!r}" for name, value in given.items())
        return self._with_anisotropy(
            Anisotropy("Stevens coefficients", site.sites, matrices, polynomials, text, site, given)
        )

    def _with_anisotropy(self, added: Anisotropy) -> Self:
        where = f"{added.source.label} {added.source.number}"
        for known in self._declared.anisotropies:
            if known.what == added.what and set(known.sites.tolist()) & set(added.sites.tolist()):
                raise ValueError(f"site {where} has {added.what}; give the sum of both once")
        check_sizes(added.matrices, added.what)
        added = added._replace(text=f"site {where}: {added.text}")
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
        do not support dipoles; `GaussLegendre(1)` conserves the energy. States of SU(N) stay pure by `CommutatorFree`.

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
        occupied = np.setdiff1d(self._declared.numbers, np.concatenate([self._declared.numbers[:0], *removed]))
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
        part, numbers = read_number(fraction, "fraction"), self._declared.numbers
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
            forces of the new model have its Boltzmann's constant, and are taken as they are by other models.

        Returns
        -------
        SpinModel
        """
        return super().with_forces(*(_in_units(force, self.boltzmann) for force in forces))

    def _check_directions(self, caller: str) -> None:
        """Raise TypeError if states are no directions of spins, which `caller` takes."""

    def _with_constants(self, values: Mapping[str, float]) -> Self:
        found: Self = with_constants(self, values)
        return found

    def _with(self, **changes: Any) -> Self:
        if self._constants is None:  # the energy is another one than the declared one
            raise ValueError(
                f"{self.name} has other coefficients than it was declared with, such as fitted ones, which a changed "
                "model would not have; declare the model again, with these coefficients"
            )
        changed = type(self)(replace(self._declared, **changes))
        return changed._with_acting(self.forces) if self.forces else changed

    def _check_bond(self, bond: Any, what: str) -> None:
        check_bond(self.crystal, bond)
        declared = self._declared
        given: tuple[Coupling | Biquadratic, ...] = (*declared.couplings, *declared.biquadratics)
        if any((one.what, one.bond) == (what, bond.name) for one in given):
            raise ValueError(f"bond {bond.name} has {what} in this model; give the sum of both once")

    def _coupled(
        self, what: str, bond: Bond, matrices: Floats, constants: Mapping[str, float], name: str, text: str
    ) -> Self:
        listed = next((one.bonds for one in self._declared.couplings if one.bond == "file"), np.zeros((0, 5)))
        key = (bond.first, bond.second, *bond.offset)
        if what == "exchange" and {key, (key[1], key[0], *(-n for n in key[2:]))} & set(map(tuple, listed.tolist())):
            raise ValueError(f"bond {bond.name} is in the file of this model; give it once")
        matrices = self._for_states(matrices, bond.sites)
        bonds = np.column_stack([bond.sites, bond.offsets])
        return self._with_coupling(Coupling(what, bond.name, bonds, matrices, text, bond, constants, name))

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
        text = f"{len(bonds)} matrices of {short(table.source)}"
        return self._with_coupling(Coupling("exchange", "file", bonds, matrices, text))

    def _with_coupling(self, added: Coupling) -> Self:
        check_sizes(added.matrices, "the coupling")
        return self._with(couplings=(*self._declared.couplings, added))

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
            *(["declared as follows, with coefficients that changed since:"] * (self._constants is None)),
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


def _in_units(force: Any, boltzmann: float) -> Any:
    """Return a force whose temperatures are in the unit of the model, unless it has its own."""
    if boltzmann == 1.0 or getattr(force, "boltzmann", 1.0) is not None:
        return force
    return replace(force, boltzmann=boltzmann)


def _symmetric(matrices: Floats) -> Floats:
    """Return symmetric matrices (k, 3, 3) whose triangles differ by rounding with equal ones."""
    return np.asarray(0.5 * (matrices + matrices.swapaxes(1, 2)))


def _described(J: Floats, symbol: str) -> str:
    """Return an exchange matrix as text, with the order that its isotropic part prefers."""
    value = float(J if J.ndim == 0 else J.trace() / 3.0)
    sense = "antiferromagnetic" if value > 0.0 else "ferromagnetic" if value < 0.0 else "anisotropic"
    return f"{symbol} = {J.tolist()} ({sense})"
