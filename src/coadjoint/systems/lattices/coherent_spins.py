"""Spins on crystals as pure quantum states of N levels at each site, the SU(N) generalization of classical spins."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NoReturn, Self

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.forces.base import read_seed
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.lattices.bonds import MATRIX_TOLERANCE, AllowedMatrices, Bond, Site
from coadjoint.systems.lattices.couplings import driving_field
from coadjoint.systems.lattices.declared_spins import UNITS, Anisotropy, Coupling, Declaration, check_sizes
from coadjoint.systems.lattices.dipoles import dipolar_energy
from coadjoint.systems.lattices.space_groups import product
from coadjoint.systems.lattices.spin_constants import constants_of, read_name
from coadjoint.systems.lattices.spin_lattice import axes_orthogonal_to
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.systems.lattices.spin_operators import (
    coefficients_of,
    coherent_amplitudes,
    levels_of,
    operator_text,
    operators,
    pair_coefficients_of,
    ranks,
    rotations_of_operators,
    sites_algebra,
    stevens_coefficients,
    tensor_operators,
)
from coadjoint.systems.lattices.spin_polynomials import not_empty, read_coefficient
from coadjoint.systems.lattices.spin_terms import cells_of, edges_of
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.system_checks import KnownInvariants
from coadjoint.validation import read_bool, read_complex, read_finite, read_integer, read_number, set_fields

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complexfloating[Any, Any]]

HERMITIAN = 1e-12  # largest asymmetry of an operator, relative to its largest entry
NEGLIGIBLE = 1e-13  # coefficients that are round-off, relative to the largest


class CoherentSpinModel(SpinModel):
    """Spins on the sites of a crystal as pure states of N = 2 S + 1 levels, to which energies are added.

    ``co.systems.spins(..., mode="SU(N)")`` makes models without energy. A site has a vector Z of C^N, up to its phase,
    and the energy is the expectation of the Hamilton operator in the product of these states. The dipole of a site, the
    expectation of its spin, may be shorter than S, and quadrupoles and higher multipoles move as well. Choose it for
    single-ion anisotropies as strong as the exchange, and for biquadratic couplings; for S = 1/2 it is the classical
    model of dipoles.

    States are expectations of the operators of a site, N^2 - 1 numbers: Sx, Sy, Sz and multipoles of higher rank, in
    the order of ``model.algebra.basis``, all of the norm of Sz. Their brackets are those of su(N), so that every
    splitting turns the states of sites by exact exponentials, ``rho -> U rho U^+``. `coherent`, `from_amplitudes` and
    `random` make states, `expectation` reads them. `thermal_states`, `equilibrium`, baths, archives and derivatives
    take a model as any other system.

    Besides what follows a model has the attributes and methods of `SpinModel`; `substitute` is refused.
    Archives have no crystal: ``co.load(path, system=model)`` reads one with its model.

    Attributes
    ----------
    levels : int
        N.

    References
    ----------
    H. Zhang, C. D. Batista, Phys. Rev. B 104, 104409 (2021); D. Dahlbom et al., Phys. Rev. B 106, 054423 (2022).
    """

    def __init__(self, declared: Declaration) -> None:
        set_fields(self, _declared=declared)
        if declared.twist is not None:
            raise ValueError(
                'twist is not available in mode="SU(N)"; take a lattice of whole periods, or mode="dipole"'
            )
        units, cell = UNITS[declared.units], len(declared.crystal.labels)
        if np.ptp(declared.spin):
            raise ValueError(
                f"spin is {short(declared.spin.tolist())}, and sites of SU(N) have equal numbers of levels; give "
                'one spin for all, or mode="dipole", which is the same for S = 1/2; there a single-ion D of longer '
                "spins is D (1 - 1 / (2 S))"
            )
        levels = levels_of(declared.spin[0], "spin")
        set_fields(self, levels=levels)
        every, width = cell * math.prod(declared.size), levels**2 - 1
        check_available_memory(200 * every + 16 * every * width, f"{short(every)} sites of SU({levels})")
        edges, blocks, field, driven = edges_of(declared, declared.moments / declared.lengths)  # of dipoles <S>
        count = every if declared.occupied is None else len(declared.occupied)
        of_cell = np.zeros((cell, 1 + width))
        for anisotropy in declared.anisotropies:
            of_cell[anisotropy.sites] += anisotropy.matrices
        on_site = of_cell[self.sites]
        on_site[:, 1:4] -= field
        M = np.zeros((1, 1 + width, 1 + width)) if not declared.couplings else blocks.distinct
        # The unit operator of one end leaves an energy of the other.
        np.add.at(on_site, edges[:, 0], M[blocks.number, :, 0])
        np.add.at(on_site[:, 1:], edges[:, 1], M[blocks.number, 0, 1:])
        ends = [(width * edges[blocks.number == kind], *np.nonzero(matrix[1:, 1:])) for kind, matrix in enumerate(M)]
        first = np.concatenate([(pairs[:, :1] + a).ravel() for pairs, a, _ in ends])
        second = np.concatenate([(pairs[:, 1:] + b).ravel() for pairs, _, b in ends])
        values = np.concatenate(
            [np.tile(matrix[1 + a, 1 + b], len(pairs)) for matrix, (pairs, a, b) in zip(M, ends, strict=True)]
        )
        H: Any = Quadratic.from_entries(
            width * count,
            np.concatenate([first, second]),
            np.concatenate([second, first]),
            np.concatenate([values, values]),
            on_site[:, 1:].ravel(),
            float(on_site[:, 0].sum()),
        )
        if driven is not None:
            driving, _ = driving_field(driven, count, width)
            H = H + driving
        if declared.dipolar:
            H = H + dipolar_energy(cells_of(declared, declared.g), units.dipole, width)
        algebra = sites_algebra(levels, count, units.hbar)
        known = {name: partial(algebra.casimirs_known.__getitem__, name) for name in algebra.casimirs_known}
        whole = {"sum of |x|^2": partial(Quadratic, np.full(width * count, 2.0))}
        LiePoissonSystem.__init__(
            self,
            algebra,
            H,
            casimirs=KnownInvariants(known or whole),
            name=f"spins of SU({levels})",
            integrals=KnownInvariants({} if driven is not None or declared.dipolar else self._total_spins(M, on_site)),
        )
        set_fields(self, boltzmann=units.k_B, _constants=constants_of(self))

    levels: int

    def _check_directions(self, caller: str) -> None:
        raise TypeError(f'{self.name} have no directions; {caller} takes spins of mode="dipole"')

    def _total_spins(self, M: Floats, on_site: Floats) -> dict[str, Callable[[], Quadratic]]:
        """Return the constant components of the total spin, by name as functions that make them."""
        count, width = len(on_site), on_site.shape[1] - 1
        G = np.zeros((3, 1 + width, 1 + width))
        for k, S in enumerate(operators(0.5 * (self.levels - 1))):
            T = tensor_operators(self.levels)
            G[k] = coefficients_of(-1j * (product(S, T) - product(T, S))).T
        turned = [
            product(G, M[:, None]) - product(M[:, None], G),
            (G * np.unique(on_site, axis=0)[:, None, None]).sum(-1),
        ]
        rows = [np.moveaxis(part, 1, -1).reshape(-1, 3) for part in turned]
        sizes = [np.abs(M).max(initial=0.0), np.abs(on_site).max(initial=0.0)]
        rows = [np.where(np.abs(part) > NEGLIGIBLE * size, part, 0.0) for part, size in zip(rows, sizes, strict=True)]
        found: dict[str, Callable[[], Quadratic]] = {}
        constraints = np.concatenate(rows)
        for axis in axes_orthogonal_to(constraints[np.any(constraints, axis=1)]):
            nonzero = np.flatnonzero(axis)
            name = f"S{nonzero[0] + 1}" if len(nonzero) == 1 else f"S along ({', '.join(f'{a:.6g}' for a in axis)})"
            of_site = np.concatenate([axis, np.zeros(width - 3)])
            found[f"total {name}"] = partial(Quadratic, np.zeros(count * width), linear=np.tile(of_site, count))
        return found

    def _for_states(self, matrices: Floats, sites: Any, of_directions: bool = False) -> Floats:
        size = self.levels**2
        found = np.zeros((len(matrices), size, size))
        found[:, 1:4, 1:4] = matrices / (0.5 * (self.levels - 1)) ** 2 if of_directions else matrices
        return found

    def single_ion(self, site: str | int, matrix: Any, *, time_reversal: bool = True) -> Self:
        """Return the model with the energy of a Hermitian operator at a site and all equivalent ones.

        Parameters
        ----------
        site : str or int
            As for `SpinModel.single_ion`.
        matrix : (N, N) array_like, complex or real, or mapping
            The operator, Hermitian, in the basis of Sz from m = S down to -S of `co.spins.operators`, whose axes are
            those of the Cartesian frame of the lattice; an energy. For N = 3 too it is an operator, not the matrix of
            S . A S. Or Stevens coefficients by name, as of vectors, here of operators: ``{"B20": 0.1}`` is
            ``0.1 (3 Sz @ Sz - S (S + 1))``; of degrees below N.
        time_reversal : bool
            Whether it must be even under time reversal, as all crystal fields are. False allows dipoles and octupoles,
            as of the field of neighbours that order.

        Returns
        -------
        CoherentSpinModel

        Raises
        ------
        ValueError, TypeError
            An unknown site, or one that has an operator already; a matrix of another shape, not Hermitian, odd under
            time reversal, or that the symmetry of the site forbids.

        Examples
        --------
        The energy is zero in the state m = 0:

        >>> import coadjoint as co
        >>> Sx, Sy, Sz = co.spins.operators(1)
        >>> tetragonal = co.spins.crystal(lattice=(1, 1, 2, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> model = co.systems.spins(tetragonal, (1, 1, 1), spin=1, mode="SU(N)").single_ion("Fe", 0.3 * Sz @ Sz)
        >>> [round(abs(model.energy(model.from_amplitudes([Z]))), 12) for Z in ((1, 0, 0), (0, 1, 0))]
        [0.3, 0.0]
        """
        chosen = self.crystal.site(site)
        if isinstance(matrix, Mapping):
            return self._with_stevens(chosen, not_empty(matrix))
        where = f"site {chosen.label} {chosen.number}"
        given = self._coefficients(matrix, "the single-ion matrix")
        odd = ranks(self.levels) % 2 == 1
        if (
            read_bool(time_reversal, "time_reversal")
            and np.abs(given[odd]).max() > MATRIX_TOLERANCE * np.abs(given).max()
        ):
            raise ValueError(
                f"the single-ion matrix of {where} is not even under time reversal: it has a dipole or octupole; give "
                "an operator such as D * Sz @ Sz, a field by field(B), or time_reversal=False"
            )
        found = self._equivalent(chosen, given[:, None], f"the single-ion matrix on {where}")[..., 0]
        return self._with_anisotropy(
            Anisotropy("a single-ion operator", chosen.sites, found, (), operator_text(given), chosen)
        )

    def _with_stevens(self, site: Site, given: Mapping[str, Any], checked: bool = True) -> Self:
        total = np.zeros(self.levels**2)
        for name, coefficient in given.items():
            degree, m, value = read_coefficient(name, coefficient)
            if degree >= self.levels:
                raise ValueError(
                    f"{name} is given for {self.levels} levels, in which operators of degree {degree} vanish; give "
                    f"coefficients up to degree {self.levels - 1}"
                )
            total += value * stevens_coefficients(self.levels, degree, m)
        what = f"the sum of Stevens operators on site {site.label} {site.number}"
        found = self._equivalent(site, total[:, None], what, checked)[..., 0]
        text = ", ".join(f"{name} = {value!r}" for name, value in given.items())
        return self._with_anisotropy(Anisotropy("Stevens coefficients", site.sites, found, (), text, site, given))

    def pair_coupling(self, bond: Bond, operator: Any) -> Self:
        """Return the model with the energy of any operator of the two sites of a bond and all equivalent ones.

        Parameters
        ----------
        bond : Bond
            One of ``crystal.bonds(max_distance)``.
        operator : (N^2, N^2) array_like, complex or real
            Hermitian, in the product basis: a sum of ``np.kron(A, B)`` with A at the first site of the representative.

        Returns
        -------
        CoherentSpinModel

        Raises
        ------
        ValueError, TypeError
            As for `exchange`: a bond of another crystal, or one that has a pair coupling; another shape, not Hermitian,
            or forbidden by the symmetry of the bond.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> Q = sum(np.kron(S @ S, S @ S) for S in co.spins.operators(1))
        >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Ni": (0, 0, 0)}, space_group="P 1")
        >>> model = co.systems.spins(chain, (4, 1, 1), spin=1, mode="SU(N)").pair_coupling(chain.bonds(1)["1"], Q)
        >>> round(model.energy(model.coherent((0, 0, 1))), 12)
        6.0
        """
        return self._with_pairs("pair_coupling", bond, operator)

    def biquadratic(self, bond: Bond, K: float, *, name: str | None = None) -> Self:
        """Return the model with the energy ``K (S_i . S_j)^2`` of operators on a bond and all equivalent ones.

        It acts on quadrupoles, and is ``K S^4`` in parallel coherent states, ``K (S^4 + S^2)`` in antiparallel ones.

        Parameters
        ----------
        bond : Bond
            One of ``crystal.bonds(max_distance)``.
        K : float
            Energy.
        name : str, optional
            As for `SpinModel.biquadratic`.

        Returns
        -------
        CoherentSpinModel

        Raises
        ------
        ValueError, TypeError
            As for `exchange`.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> chain = co.spins.crystal(lattice=(1, 2, 2, 90, 90, 90), sites={"Ni": (0, 0, 0)})
        >>> model = co.systems.spins(chain, (4, 1, 1), spin=1, mode="SU(N)").biquadratic(chain.bonds(1)["1"], 0.5)
        >>> n = np.array([[0, 0, 1], [0, 0, -1]] * 2)
        >>> [round(model.energy(model.coherent(directions)), 12) for directions in (n[0], n)]
        [2.0, 4.0]
        """
        strength = read_number(K, "K")
        check_sizes(np.array(strength), "K")
        scalar = np.sum([np.kron(S, S) for S in operators(0.5 * (self.levels - 1))], axis=0)
        known, symbol = read_name(name, f"biquadratic {bond.name}", "K")
        operator, text = strength * product(scalar, scalar), f"{symbol} = {strength!r}"
        return self._with_pairs("biquadratic", bond, operator, text, {"": strength}, known)

    def _with_pairs(
        self,
        what: str,
        bond: Bond,
        operator: Any,
        text: str = "",
        constants: Mapping[str, float] | None = None,
        name: str = "",
    ) -> Self:
        self._check_bond(bond, what)
        given = pair_coefficients_of(self._operator(operator, f"the operator of {what}", self.levels**2))
        matrices = self._equivalent(bond, given, f"the operator on bond {bond.name}")
        bonds = np.column_stack([bond.sites, bond.offsets])
        text = text or operator_text(given)
        return self._with_coupling(Coupling(what, bond.name, bonds, matrices, text, bond, constants, name))

    def _equivalent(self, kind: AllowedMatrices, given: Floats, what: str, checked: bool = True) -> Floats:
        """Return coefficients of operators at all equivalent places, (n, 1) of sites or (n, n) of bonds."""
        pair = given.shape[1] > 1

        def images(rotations: Floats) -> Floats:
            D = rotations_of_operators(self.levels, rotations)
            return product(product(D, given), D.swapaxes(1, 2)) if pair else product(D, given)

        same = images(kind._kept)
        if pair:
            same[kind._reversed] = same[kind._reversed].swapaxes(1, 2)
        size = np.abs(given).max()
        if checked and np.abs(same - given).max() > MATRIX_TOLERANCE * size:
            raise ValueError(
                f"{what} is not allowed by symmetry, whose rotations change it; give one that they leave as it is, or "
                'a crystal with less symmetry, such as space_group="P 1"'
            )
        found = images(kind._rotations)
        found = np.where(np.abs(found) > NEGLIGIBLE * size, found, 0.0)
        equal = np.abs(found - given).max(axis=(1, 2)) <= NEGLIGIBLE * size
        return np.where(equal[:, None, None], given, found)

    def _coefficients(self, matrix: Any, what: str) -> Floats:
        """Validate an operator of a site, and return its coefficients, the unit matrix first."""
        return coefficients_of(self._operator(matrix, what, self.levels))

    def _operator(self, matrix: Any, what: str, size: int) -> Complex:
        """Validate a Hermitian matrix (size, size)."""
        A = read_complex(matrix, what)
        if A.shape != (size, size):
            raise ValueError(f"{what} has shape {A.shape}; give a Hermitian matrix ({size}, {size})")
        if not np.isfinite(A).all():
            raise ValueError(f"{what} is not finite; give finite numbers")
        check_sizes(np.abs(A), what)
        if np.abs(A - A.conj().T).max() > HERMITIAN * np.abs(A).max():
            raise ValueError(f"{what} is not Hermitian; give A with A = A^+")
        return np.asarray(0.5 * (A + A.conj().T))

    def substitute(self, label: str, fraction: float, seed: int, *, spin: float, g: float | None = None) -> NoReturn:
        """Refused: all sites of SU(N) have the same levels."""
        raise ValueError(
            'substitute is not available in mode="SU(N)", whose sites have equal levels; take mode="dipole"'
        )

    def coherent(self, directions: Any) -> Floats:
        """Return the state with the dipoles S n, the spin-coherent states, in which multipoles follow the directions.

        Parameters
        ----------
        directions : (3,) or (..., sites, 3) array_like
            n, for all sites or for each; of any length other than zero.

        Returns
        -------
        (n,) or (..., n) array

        Raises
        ------
        ValueError, TypeError
            Another shape, or a direction of length zero.

        Examples
        --------
        >>> import coadjoint as co
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> model = co.systems.spins(cube, (1, 1, 1), spin=2, mode="SU(N)")
        >>> model.dipoles(model.coherent((0, 1, 0))).round(12) + 0.0
        array([[0., 2., 0.]])
        """
        n = read_finite(directions, "directions")
        sites = len(self.sites)
        if n.ndim == 1 and n.shape == (3,):
            n = np.broadcast_to(n, (sites, 3))
        if n.ndim < 2 or n.shape[-2:] != (sites, 3):
            raise ValueError(f"directions has shape {n.shape}; give (3,), or ({sites}, 3) with one row for each site")
        size = np.abs(n).max(axis=-1, keepdims=True)
        if np.any(size == 0.0):
            raise ValueError("directions has a vector of length zero; give others")
        return self._states(coherent_amplitudes(self.levels, n / size))

    def from_amplitudes(self, Z: Any) -> Floats:
        """Return the state of amplitudes in the basis of Sz, from m = S down to -S.

        Parameters
        ----------
        Z : (..., sites, N) array_like, complex or real
            Of any norm other than zero; the phase of a site has no effect.

        Returns
        -------
        (..., n) array

        Raises
        ------
        ValueError, TypeError
            Another shape, numbers that are not finite, or a site without amplitude.

        Examples
        --------
        >>> import coadjoint as co
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> model = co.systems.spins(cube, (1, 1, 1), spin=1, mode="SU(N)")
        >>> model.from_amplitudes([[1, 1j, 0]]).shape
        (8,)
        """
        amplitudes = read_complex(Z, "Z")
        if amplitudes.ndim < 2 or amplitudes.shape[-2:] != (len(self.sites), self.levels):
            raise ValueError(
                f"Z has shape {amplitudes.shape}; give ({len(self.sites)}, {self.levels}), N for each site"
            )
        size = np.abs(amplitudes).max(axis=-1, keepdims=True)
        if not (np.isfinite(size).all() and np.all(size > 0.0)):
            raise ValueError("Z has a site without amplitude, or numbers that are not finite; give other amplitudes")
        return self._states(amplitudes / size)

    def random(self, seed: int, members: int | None = None) -> Floats:
        """Return states drawn uniformly from all pure states of the sites.

        Parameters
        ----------
        seed : int
            Seed, from 0 to 2^62.
        members : int, optional
            Number of states; None is one, without this axis.

        Returns
        -------
        (n,) or (members, n) array

        Raises
        ------
        ValueError, TypeError
            A seed or a number out of range.

        Examples
        --------
        >>> import coadjoint as co
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> co.systems.spins(cube, (2, 2, 2), spin=1, mode="SU(N)").random(seed=1, members=5).shape
        (5, 64)
        """
        shape = () if members is None else (read_integer(members, "members"),)
        check_available_memory(8 * math.prod(shape) * (self.dim + 6 * len(self.sites) * self.levels), "random states")
        normal = np.random.default_rng(read_seed(seed, "seed")).standard_normal(
            (*shape, len(self.sites), self.levels, 2)
        )
        return self._states(normal[..., 0] + 1j * normal[..., 1])

    def _states(self, Z: Complex) -> Floats:
        """Return expectations of the basis operators in amplitudes of any norm, (..., n)."""
        Z = Z / np.sqrt((Z.real**2 + Z.imag**2).sum(axis=-1, keepdims=True))
        T = tensor_operators(self.levels)[1:]
        found = [(Z.conj() * (Z[..., None, :] * matrix).sum(axis=-1)).sum(axis=-1).real for matrix in T]
        x = np.stack(found, axis=-1)
        return np.ascontiguousarray(x.reshape(*x.shape[:-2], -1))

    def expectation(self, x: Any, operator: Any) -> Floats:
        """Return the expectation of an operator at each site.

        Parameters
        ----------
        x : (..., n) array_like
            States, such as ``sol.x``.
        operator : (N, N) array_like, complex or real
            Hermitian, in the basis of `co.spins.operators`.

        Returns
        -------
        (..., sites) array

        Raises
        ------
        ValueError, TypeError
            Another shape, or an operator that is not Hermitian.

        Examples
        --------
        >>> import coadjoint as co
        >>> Sx, Sy, Sz = co.spins.operators(1)
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> model = co.systems.spins(cube, (1, 1, 1), spin=1, mode="SU(N)")
        >>> model.expectation(model.coherent((1, 0, 0)), Sz @ Sz).round(12)
        array([0.5])
        """
        a = self._coefficients(operator, "the operator")
        return np.asarray(a[0] + (self._of_sites(x) * a[1:]).sum(axis=-1))

    def dipoles(self, x: Any) -> Floats:
        """Return the dipoles of the sites, the expectations of Sx, Sy and Sz.

        Parameters
        ----------
        x : (..., n) array_like
            States, such as ``sol.x``.

        Returns
        -------
        (..., sites, 3) array

        Raises
        ------
        ValueError, TypeError
            Another shape.

        Examples
        --------
        >>> import coadjoint as co
        >>> cube = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> model = co.systems.spins(cube, (1, 1, 1), spin=1, mode="SU(N)")
        >>> bool(abs(model.dipoles(model.from_amplitudes([[0, 1, 0]]))).max() < 1e-15)     # a quadrupole only
        True
        """
        return self._of_sites(x)[..., :3]

    def _of_sites(self, x: Any) -> Floats:
        states = read_finite(x, "x")
        if states.ndim < 1 or states.shape[-1] != self.dim:
            raise ValueError(f"x has shape {states.shape}; {self.name} needs ({self.dim},) or (..., {self.dim})")
        return np.asarray(states.reshape(*states.shape[:-1], len(self.sites), -1))

    def __str__(self) -> str:
        of_levels = f"states of {self.levels} levels at each site, SU({self.levels}), with O20 = 3 Sz @ Sz - S (S + 1)"
        return f"{super().__str__()}\n{of_levels}"
