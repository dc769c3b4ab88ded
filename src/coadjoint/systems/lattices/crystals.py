"""Crystals: sites of a cell, symmetry operations, bonds by shell, and exchange matrices that symmetry allows."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.lattices.space_groups import (
    SymmetryOperations,
    fits,
    inverse,
    operations_found,
    product,
    rotations_in_space,
)
from coadjoint.validation import read_choice, read_finite, read_integer, read_positive

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_SITES = 2000  # of a cell
MAX_BONDS = 2_000_000  # directed, of one cell
COLLISION = 0.1  # least distance of two sites, in units of (volume / sites)^(1/3)
MATRIX_TOLERANCE = 1e-6  # of typed exchange matrices, relative to the largest entry
MAX_ENTRY = 1e100  # of matrices, as of couplings of spins
SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
AXIAL = ((1, 2), (2, 0), (0, 1))  # entries of the antisymmetric part that are D_x, D_y, D_z


class AllowedMatrices:
    """Matrices of a bond or a site, of which symmetry allows some and takes one to all equivalent places."""

    _rotations: Floats  # from the representative to each of its class
    _kept: Floats  # rotations that keep the representative
    _reversed: npt.NDArray[np.bool_]  # which of them transpose its matrix, as those that exchange the ends of a bond

    def _propagated(self, matrix: Any, what: str, where: str) -> Floats:
        """Return the matrices of all of the class from that of the representative; ValueError if it is not allowed."""
        J = read_finite(matrix, f"the {what}")
        if J.ndim == 0:
            J = J * np.eye(3)
        if J.shape != (3, 3):
            raise ValueError(f"the {what} has shape {J.shape}; give a number, or a matrix of shape (3, 3)")
        size = np.abs(J).max()
        if size > MAX_ENTRY:
            raise ValueError(f"the {what} has numbers beyond {MAX_ENTRY:g}; take larger units")
        near = self._projected(J)
        if np.abs(near - J).max() > MATRIX_TOLERANCE * size:
            rounded = [[float(f"{value:.9g}") for value in row] for row in near.tolist()]
            raise ValueError(
                f"the {what} {short(J.tolist(), 120)} is not allowed by symmetry on {where}, whose form is "
                f"{'; '.join(' '.join(row) for row in self._form())}; the nearest allowed matrix is {rounded}"
            )
        R = self._rotations
        if np.abs(near - J).max() <= 1e-14 * size:  # allowed as given
            near = J
        images = _clean(product(product(R, near), R.swapaxes(-1, -2)), size)
        equal = np.abs(images - near).max(axis=(1, 2)) <= 1e-14 * size  # such as isotropic exchange, without round-off
        return np.where(equal[:, None, None], near, images)

    @cached_property
    def basis(self) -> Floats:
        """Basis of the allowed matrices."""
        return np.concatenate([self._reduced(SYMMETRIC, 1.0), self._reduced(AXIAL, -1.0)])

    def _projected(self, J: Floats) -> Floats:
        """Return the nearest allowed matrix, the mean over the operations that keep the representative."""
        images = product(product(self._kept, J), self._kept.swapaxes(-1, -2))
        images[self._reversed] = images[self._reversed].swapaxes(-1, -2)
        return _clean(images.sum(axis=0) / len(images), np.abs(J).max())

    def _reduced(self, entries: tuple[tuple[int, int], ...], sign: float) -> Floats:
        """Return the allowed matrices that are symmetric (1) or antisymmetric (-1), in reduced row echelon form."""
        rows = []
        for a, b in entries:
            unit = np.zeros((3, 3))
            unit[b, a] = sign
            unit[a, b] = 1.0
            image = self._projected(unit)
            rows.append([image[entry] for entry in entries])
        reduced, found = np.array(rows), 0
        for column in range(len(entries)):
            pivot = found + int(np.abs(reduced[found:, column]).argmax()) if found < len(rows) else found
            if found == len(rows) or abs(reduced[pivot, column]) < 1e-9:
                continue
            reduced[[found, pivot]] = reduced[[pivot, found]]
            reduced[found] /= reduced[found, column]
            others = np.arange(len(rows)) != found
            reduced[others] -= reduced[others, column][:, None] * reduced[found]
            found += 1
        matrices = np.zeros((found, 3, 3))
        for place, (a, b) in enumerate(entries):
            matrices[:, b, a] = sign * reduced[:found, place]
            matrices[:, a, b] = reduced[:found, place]
        return np.where(np.abs(matrices) < 1e-9, 0.0, matrices)

    def _form(self) -> list[list[str]]:
        return [[_combination(self.basis[:, a, b]) for b in range(3)] for a in range(3)]

    def _table(self) -> list[str]:
        """Return the allowed form, a line for each row."""
        form = self._form()
        widths = [max(len(row[b]) for row in form) for b in range(3)]
        return [f"  [ {'  '.join(text.rjust(w) for text, w in zip(row, widths, strict=True))} ]" for row in form]


@dataclass(frozen=True, eq=False)
class Bond(AllowedMatrices):
    """A class of bonds that the symmetry of a crystal makes equal, represented by one of them.

    `Crystal.bonds` returns them. Sites are numbered as in `Crystal.labels`, from 0 on; a bond joins site i of a cell to
    site j of the cell at `offset`, and an exchange matrix J of it is the energy S_i . J S_j.

    Attributes
    ----------
    name : str
        Number of the shell, from 1 on in the order of lengths, and a letter where bonds of one length are not
        equivalent: ``"1"``, ``"2a"``, ``"2b"``.
    kinds : tuple of str
        Labels of the two sites of the representative.
    first, second : int
        Its sites.
    offset : tuple of int
        Cell of its second site, in units of the lattice vectors.
    vector : (3,) array
        From the first to the second site, in the Cartesian frame and the lengths of the lattice.
    distance : float
        Length.
    multiplicity : int
        Bonds of the class in one cell; each bond counts once.
    coordination : int
        Bonds of the class that end at the first site.
    sites : (multiplicity, 2) array
        First and second sites of all equivalent bonds; the representative is the first of them.
    offsets : (multiplicity, 3) array
        Their offsets.
    vectors : (multiplicity, 3) array
        Their vectors.
    basis : (k, 3, 3) array
        A basis of the exchange matrices that symmetry allows on the representative: A, B, ... of ``print(bond)``.

    Examples
    --------
    >>> import coadjoint as co
    >>> cubic = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
    >>> print(cubic.bonds(1)["1"])
    bond 1: Fe 0 to Fe 0 at offset (1, 0, 0), length 1, 3 in a cell, 6 at Fe 0
    allowed exchange:
      [ A  0  0 ]
      [ 0  B  0 ]
      [ 0  0  B ]
    allowed Dzyaloshinskii-Moriya vector: (0, 0, 0)
    """

    name: str
    kinds: tuple[str, str]
    first: int
    second: int
    offset: tuple[int, int, int]
    vector: Floats
    distance: float
    multiplicity: int
    coordination: int
    sites: Integers
    offsets: Integers
    vectors: Floats
    _rotations: Floats = field(repr=False)
    _kept: Floats = field(repr=False)
    _reversed: npt.NDArray[np.bool_] = field(repr=False)

    def exchange(self, matrix: Any) -> Floats:
        """Return the exchange matrices of all equivalent bonds, from that of the representative.

        Parameters
        ----------
        matrix : float or (3, 3) array_like
            Exchange J of the representative in the Cartesian frame of the lattice, S_i . J S_j, of any unit and sign
            convention; a number J is J times the unit matrix. Its antisymmetric part is the Dzyaloshinskii-Moriya
            coupling D . (S_i x S_j), with D = (J_yz, J_zx, J_xy).

        Returns
        -------
        (multiplicity, 3, 3) array
            R J R^T for each of `sites` and `offsets`, with the rotation R that takes the representative there. A matrix
            that is allowed to within 1e-6 of its largest entry is replaced by the nearest allowed one.

        Raises
        ------
        ValueError
            Symmetry does not allow the matrix; the message has the allowed form.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> square = co.spins.crystal(lattice=(1, 1, 3, 90, 90, 90), sites={"Cu": (0, 0, 0)})
        >>> compass = square.bonds(1)["1"].exchange(np.diag([1.0, 0.0, 0.2]))
        >>> compass.diagonal(axis1=1, axis2=2).tolist()
        [[1.0, 0.0, 0.2], [0.0, 1.0, 0.2]]
        """
        return self._propagated(matrix, "exchange matrix", f"bond {self.name} ({self._ends()})")

    def _ends(self) -> str:
        return f"{self.kinds[0]} {self.first} to {self.kinds[1]} {self.second} at offset {self.offset}"

    def __str__(self) -> str:
        antisymmetric = 0.5 * (self.basis - self.basis.swapaxes(1, 2))
        vector = ", ".join(_combination(antisymmetric[:, a, b]) for a, b in AXIAL)
        first = (
            f"bond {self.name}: {self._ends()}, length {self.distance:.6g}, {self.multiplicity} in a cell, "
            f"{self.coordination} at {self.kinds[0]} {self.first}"
        )
        moriya = f"allowed Dzyaloshinskii-Moriya vector: ({vector})"
        return "\n".join([first, "allowed exchange:", *self._table(), moriya])

    def __repr__(self) -> str:
        return f"<bond {self.name}, {self._ends()}, length {self.distance:.6g}, {self.multiplicity} in a cell>"


@dataclass(frozen=True, eq=False)
class Site(AllowedMatrices):
    """A class of sites that the symmetry of a crystal makes equal, represented by one of them.

    `Crystal.site` returns them. A single-ion matrix A of a site is the energy S . A S.

    Attributes
    ----------
    label : str
        Label of the representative.
    number : int
        Its number in `Crystal.labels`.
    sites : (multiplicity,) array
        Numbers of all equivalent sites of a cell; the representative is the first of them.
    basis : (k, 3, 3) array
        A basis of the single-ion matrices that symmetry allows: A, B, ... of ``print(site)``.

    Examples
    --------
    >>> import coadjoint as co
    >>> tetragonal = co.spins.crystal(lattice=(1, 1, 2, 90, 90, 90), sites={"Mn": (0, 0, 0)})
    >>> print(tetragonal.site("Mn"))
    site Mn 0, 1 in a cell
    allowed single-ion matrix:
      [ A  0  0 ]
      [ 0  A  0 ]
      [ 0  0  B ]
    """

    label: str
    number: int
    sites: Integers
    _rotations: Floats = field(repr=False)
    _kept: Floats = field(repr=False)
    _reversed: npt.NDArray[np.bool_] = field(repr=False)

    def single_ion(self, matrix: Any) -> Floats:
        """Return the single-ion matrices of all equivalent sites, from that of the representative.

        Parameters
        ----------
        matrix : (3, 3) array_like
            A of S . A S, symmetric, in the Cartesian frame of the lattice; an easy axis has a negative entry.

        Returns
        -------
        (multiplicity, 3, 3) array
            R A R^T for each of `sites`, with the rotation R that takes the representative there.

        Raises
        ------
        ValueError
            Symmetry does not allow the matrix; the message has the allowed form.

        Examples
        --------
        >>> import numpy as np, coadjoint as co
        >>> tetragonal = co.spins.crystal(lattice=(1, 1, 2, 90, 90, 90), sites={"Mn": (0, 0, 0)})
        >>> tetragonal.site("Mn").single_ion(np.diag([0.0, 0.0, -0.1])).shape
        (1, 3, 3)
        """
        return self._propagated(matrix, "single-ion matrix", f"site {self.label} {self.number}")

    def __str__(self) -> str:
        first = f"site {self.label} {self.number}, {len(self.sites)} in a cell"
        return "\n".join([first, "allowed single-ion matrix:", *self._table()])

    def __repr__(self) -> str:
        return f"<site {self.label} {self.number}, {len(self.sites)} in a cell>"


class Bonds(Sequence[Bond]):
    """The bonds of a crystal by shell, as `Crystal.bonds` returns them; ``print`` shows a table.

    ``bonds["2a"]`` is a bond by its name, ``bonds[0]`` the first one.
    """

    def __init__(self, bonds: Sequence[Bond]) -> None:
        self._bonds = tuple(bonds)

    def __len__(self) -> int:
        return len(self._bonds)

    def __iter__(self) -> Iterator[Bond]:
        return iter(self._bonds)

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            for bond in self._bonds:
                if bond.name == key:
                    return bond
            names = short([bond.name for bond in self._bonds], 200)
            raise KeyError(f"there is no bond {short(key)}; the bonds are {names}")
        return Bonds(self._bonds[key]) if isinstance(key, slice) else self._bonds[key]

    def __str__(self) -> str:
        header = ("bond", "sites", "offset", "vector", "distance", "in a cell", "at a site", "free")
        rows = [
            (
                bond.name,
                f"{bond.kinds[0]} {bond.first} - {bond.kinds[1]} {bond.second}",
                " ".join(map(str, bond.offset)),
                " ".join(f"{value:.5g}" for value in bond.vector.tolist()),
                f"{bond.distance:.6g}",
                str(bond.multiplicity),
                str(bond.coordination),
                str(len(bond.basis)),
            )
            for bond in self._bonds
        ]
        widths = [max(map(len, column)) for column in zip(header, *rows, strict=True)]
        return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in (header, *rows))

    def __repr__(self) -> str:
        return f"<{len(self)} classes of bonds, {sum(bond.multiplicity for bond in self)} bonds in a cell>"


class Crystal:
    """A crystal: a lattice, the sites of its cell and its symmetry; `co.spins.crystal` makes them.

    Attributes
    ----------
    lattice : (3, 3) array
        The lattice vectors, as rows. Of cell constants, a is along x and b in the plane of x and y.
    labels : tuple of str
        Label of each site of the cell. Sites are numbered in this order.
    species : tuple of str
        What symmetry may exchange with each other: labels of typed sites, elements with charges of files.
    positions : (sites, 3) array
        Fractional coordinates, from 0 to 1.
    space_group : str
        Symbol and number, or the number of operations that a file lists.
    rotations, translations : (operations, 3, 3) and (operations, 3) arrays
        Symmetry operations of fractional coordinates, x -> W x + w, with those of centred cells.
    """

    def __init__(
        self,
        lattice: Floats,
        labels: Sequence[str],
        species: Sequence[str],
        positions: Floats,
        operations: SymmetryOperations | None,
        tolerance: float,
    ) -> None:
        self.lattice, self.labels, self.species = lattice, tuple(labels), tuple(species)
        within = positions - np.floor(positions)
        self.positions = np.where(within < 1.0, within, 0.0)  # -1e-17 has the remainder 1
        self._length = tolerance * float(np.sqrt((lattice**2).sum(axis=1)).min())
        self._tolerance = tolerance
        self._refuse_collisions()
        kinds = {kind: number for number, kind in enumerate(dict.fromkeys(self.species), 1)}
        if operations is None:
            numbers = [kinds[kind] for kind in self.species]
            operations = operations_found(lattice, self.positions, numbers, tolerance)
        self.rotations, self.translations, self.space_group = operations
        self._turns = rotations_in_space(self.rotations, lattice)
        self._images, self._shifts = self._permutations()
        for array in (self.lattice, self.positions, self.rotations, self.translations):
            array.flags.writeable = False

    def __repr__(self) -> str:
        counts = ", ".join(f"{kind} {self.labels.count(kind)}" for kind in dict.fromkeys(self.labels))
        count = len(self.labels)
        cell = f"{count} site{'s' if count > 1 else ''} in a cell ({short(counts, 80)[1:-1]})"
        return f"<crystal of {cell}, {self.space_group}>"

    def subcrystal(self, *labels: str) -> Crystal:
        """Return the crystal of some of the sites, with the symmetry of the whole one.

        Choose it to keep the magnetic ions of a structure, whose ligands still decide what symmetry allows.

        Parameters
        ----------
        *labels : str
            Labels, or elements, of the sites to keep.

        Returns
        -------
        Crystal
            Its sites have the order of the whole crystal.

        Raises
        ------
        ValueError
            A label that no site has, or sites that symmetry takes to others that are not kept.

        Examples
        --------
        >>> import coadjoint as co
        >>> sites = {"Fe": (0, 0, 0), "I": (1 / 3, 2 / 3, 0.249)}
        >>> whole = co.spins.crystal(lattice=(4.05, 4.05, 6.75, 90, 90, 120), sites=sites, space_group="P -3 m 1")
        >>> whole.subcrystal("Fe")
        <crystal of 1 site in a cell (Fe 1), P -3 m 1 (164)>
        """
        names = [(label, kind, _element(kind)) for label, kind in zip(self.labels, self.species, strict=True)]
        for label in labels or ("",):
            if not any(label in three for three in names):
                known = ", ".join(dict.fromkeys(self.labels))
                raise ValueError(f"no site has the label {short(label)}; give some of {short(known, 200)}")
        kept = [site for site, three in enumerate(names) if any(label in three for label in labels)]
        return Crystal(
            self.lattice,
            [self.labels[site] for site in kept],
            [self.species[site] for site in kept],
            self.positions[kept],
            SymmetryOperations(self.rotations, self.translations, self.space_group),
            self._tolerance,
        )

    def site(self, site: str | int) -> Site:
        """Return the class of equivalent sites of a label or a number, with the single-ion matrices that it allows.

        Parameters
        ----------
        site : str or int
            A label, if all sites that have it are equivalent; or the number of the representative in `labels`.

        Returns
        -------
        Site

        Raises
        ------
        ValueError, TypeError
            An unknown site, or a label of sites that symmetry does not make equal.

        Examples
        --------
        >>> import coadjoint as co
        >>> cubic = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> cubic.site("Fe"), len(cubic.site(0).basis)
        (<site Fe 0, 1 in a cell>, 1)
        """
        if isinstance(site, str):
            number = self.labels.index(read_choice(site, "site", dict.fromkeys(self.labels)))
            others = [k for k, label in enumerate(self.labels) if label == site]
            first = [min(self._images[:, k].tolist()) for k in others]
            if len(set(first)) > 1:
                raise ValueError(
                    f"the sites {others} have the label {site}, and symmetry does not make them equal; give the number "
                    f"of one of each kind, {sorted(set(first))}"
                )
        else:
            number = read_integer(site, "site", 0, len(self.labels) - 1)
        images = self._images[:, number]
        found = sorted(set(images.tolist()), key=lambda k: (k != number, k))
        trace = self.rotations.trace(axis1=1, axis2=2)
        ways = [max(np.flatnonzero(images == k).tolist(), key=lambda way: int(trace[way])) for k in found]
        kept = np.flatnonzero(images == number)
        numbers = np.array(found, dtype=np.int64)
        numbers.flags.writeable = False
        stabilizer, transposed = self._turns[np.tile(kept, 2)], np.arange(2 * len(kept)) >= len(kept)
        return Site(self.labels[number], number, numbers, self._turns[ways], stabilizer, transposed)

    def bonds(self, max_distance: float) -> Bonds:
        """Return the bonds up to a length, by shell, in classes of bonds that symmetry makes equal.

        Parameters
        ----------
        max_distance : float
            Largest length, in the unit of the lattice.

        Returns
        -------
        Bonds
            A sequence of `Bond`, the shortest first. ``print`` shows it as a table, whose last column is the number of
            free parameters of an exchange matrix; ``print(bonds["1"])`` shows its form.

        Raises
        ------
        ValueError, TypeError
            A length that is not positive, or with too many bonds.

        Examples
        --------
        >>> import coadjoint as co
        >>> cubic = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> print(cubic.bonds(max_distance=1.8))
        bond  sites        offset  vector  distance  in a cell  at a site  free
        1     Fe 0 - Fe 0  1 0 0   1 0 0   1         3          6          2
        2     Fe 0 - Fe 0  1 1 0   1 1 0   1.41421   6          12         3
        3     Fe 0 - Fe 0  1 1 1   1 1 1   1.73205   4          8          2
        """
        limit = read_positive(max_distance, "max_distance") * (1.0 + 1e-9)
        bonds, seen = [], set()
        for key in self._pairs(limit):
            if key not in seen and not (key[0] == key[1] and key[2:] == (0, 0, 0)):
                bonds.append(self._class_of(key))
                for (i, j), n in zip(bonds[-1].sites.tolist(), bonds[-1].offsets.tolist(), strict=True):
                    seen.update([(i, j, *n), (j, i, *(-m for m in n))])
        return Bonds(self._named(bonds))

    def _named(self, bonds: list[Bond]) -> list[Bond]:
        bonds = sorted(bonds, key=lambda bond: bond.distance)
        shells: list[list[Bond]] = []
        for bond in bonds:
            if not shells or bond.distance - shells[-1][-1].distance > self._length:
                shells.append([])
            shells[-1].append(bond)
        named = []
        for number, shell in enumerate(shells, 1):
            shell.sort(key=lambda bond: _preference((bond.first, bond.second, *bond.offset)))
            for place, bond in enumerate(shell):
                letters = _letters(place) if len(shell) > 1 else ""
                named.append(replace(bond, name=f"{number}{letters}"))
        return named

    def _class_of(self, key: tuple[int, ...]) -> Bond:
        images = self._images_of(key)
        chosen = min({*images, *map(_turned, images)}, key=_preference)
        images = self._images_of(chosen)
        kept = [k for k, image in enumerate(images) if image == chosen]
        swapped = [k for k, image in enumerate(images) if image == _turned(chosen)]
        members = {chosen: max(kept, key=lambda k: int(self.rotations[k].trace()))}  # the identity
        for k, image in enumerate(images):
            if image not in members and _turned(image) not in members:
                members[image] = k
        order = sorted(members, key=lambda member: (member != chosen, _preference(member)))
        array = np.array(order, dtype=np.int64)
        vectors = self._vectors(array)
        for shared in (array, vectors):
            shared.flags.writeable = False
        sites, offsets = array[:, :2], array[:, 2:]
        first = chosen[0]
        return Bond(
            "",
            (self.labels[first], self.labels[chosen[1]]),
            first,
            chosen[1],
            (chosen[2], chosen[3], chosen[4]),
            vectors[0],
            math.sqrt(float((vectors[0] ** 2).sum())),
            len(order),
            int((sites == first).sum()),
            sites,
            offsets,
            vectors,
            self._turns[[members[member] for member in order]],
            self._turns[kept + swapped],
            np.arange(len(kept) + len(swapped)) >= len(kept),
        )

    def _images_of(self, key: tuple[int, ...]) -> list[tuple[int, ...]]:
        i, j = key[:2]
        n = (self.rotations * np.array(key[2:], dtype=np.int64)).sum(axis=2) + self._shifts[:, j] - self._shifts[:, i]
        return list(map(tuple, np.column_stack([self._images[:, i], self._images[:, j], n]).tolist()))

    def _vectors(self, bonds: Integers) -> Floats:
        steps = bonds[:, 2:].astype(np.float64) + self.positions[bonds[:, 1]] - self.positions[bonds[:, 0]]
        return product(steps[:, None, :], self.lattice)[:, 0]

    def _pairs(self, limit: float) -> list[tuple[int, ...]]:
        """Return (site, site, offset) of all directed pairs up to a distance, also of sites with themselves."""
        reach = limit * np.sqrt((inverse(self.lattice) ** 2).sum(axis=0))
        spans = [2 * math.ceil(r) + 1 if r < 1e4 else 10**5 for r in reach.tolist()]
        sites, cells = len(self.labels), math.prod(spans)
        expected = 4.19 * limit**3 / self._volume() * sites**2 if limit < 1e100 else math.inf
        if expected > MAX_BONDS:
            raise ValueError(
                f"about {expected:.2g} bonds of a cell are shorter than {limit:.6g}; give a smaller distance"
            )
        check_available_memory(24 * cells, f"bonds up to {limit:.6g}")
        offsets = np.indices(spans).reshape(3, -1).T - np.array(spans) // 2
        found, chunk = [], max(1, 10**6 // sites**2)
        for start in range(0, cells, chunk):
            part = offsets[start : start + chunk]
            steps = part[:, None, None] + self.positions - self.positions[:, None]  # (offsets, first, second, 3)
            near = ((steps @ self.lattice) ** 2).sum(axis=-1) <= limit**2
            o, i, j = np.nonzero(near)
            found.append(np.column_stack([i, j, part[o]]))
        return list(map(tuple, np.concatenate(found).tolist()))

    def _volume(self) -> float:
        return abs(float((np.cross(self.lattice[0], self.lattice[1]) * self.lattice[2]).sum()))

    def _refuse_collisions(self) -> None:
        least = COLLISION * (self._volume() / len(self.labels)) ** (1 / 3)
        for i, j, *n in self._pairs(max(least, self._length)):
            if i == j and not any(n):
                continue
            distance = math.sqrt(float((self._vectors(np.array([[i, j, *n]])) ** 2).sum()))
            what = (
                f"the sites {i} ({self.labels[i]}) and {j} ({self.labels[j]}), at "
                f"{self.positions[i].round(6).tolist()} and {self.positions[j].round(6).tolist()}"
            )
            if distance <= self._length:
                raise ValueError(f"{what}, are the same place; give every site once")
            raise ValueError(
                f"{what}, are {distance:.3g} apart, where cells of this size have room for {least:.3g} and more; "
                "correct the positions, the space group or the lattice"
            )

    def _permutations(self) -> tuple[Integers, Integers]:
        """Return, for every operation, the site that each site is taken to, and the cell of it."""
        if not fits(self.rotations, self.lattice, self._tolerance).all():
            raise ValueError("the symmetry operations do not preserve the lattice; correct its lengths and angles")
        sites = len(self.labels)
        check_available_memory(32 * len(self.rotations) * sites + 100 * sites**2, "symmetry of the sites")
        images = np.empty((len(self.rotations), sites), dtype=np.int64)
        shifts = np.empty((len(self.rotations), sites, 3), dtype=np.int64)
        kinds = np.array([list(dict.fromkeys(self.species)).index(kind) for kind in self.species])
        for k, (W, w) in enumerate(zip(self.rotations, self.translations, strict=True)):
            moved = (W * self.positions[:, None, :]).sum(axis=2) + w
            steps = moved[:, None] - self.positions
            cells = np.round(steps)
            gaps = (((steps - cells) @ self.lattice) ** 2).sum(axis=-1)
            gaps[kinds[:, None] != kinds] = np.inf
            images[k] = gaps.argmin(axis=1)
            lost = np.flatnonzero(gaps.min(axis=1) > (4.0 * self._length) ** 2)
            if lost.size or len(set(images[k].tolist())) < sites:
                site = int(lost[0]) if lost.size else 0
                raise ValueError(
                    f"symmetry takes site {site} ({self.labels[site]}) to {(moved[site] % 1.0).round(6).tolist()}, "
                    "where there is no site of its kind; give all sites of the cell, or another space group"
                )
            shifts[k] = cells[np.arange(sites), images[k]]
        return images, shifts


def expanded_crystal(
    lattice: Floats,
    sites: Sequence[tuple[str, str, Floats]],
    operations: SymmetryOperations | None,
    tolerance: float,
) -> Crystal:
    """Return the crystal of sites (label, species, fractional position), repeated by operations if there are any."""
    labels, species, positions = [], [], []
    if not sites:
        raise ValueError("the crystal has no sites; give at least one")
    length = tolerance * float(np.sqrt((lattice**2).sum(axis=1)).min())
    for label, kind, position in sites:
        orbit = position[None] if operations is None else _orbit(label, position, lattice, operations, length)
        labels += [label] * len(orbit)
        species += [kind] * len(orbit)
        positions += list(orbit)
        if len(labels) > MAX_SITES:
            raise ValueError(
                f"the cell has more than {MAX_SITES} sites; give a smaller cell, such as the primitive one"
            )
    return Crystal(lattice, labels, species, np.array(positions), operations, tolerance)


def _orbit(label: str, position: Floats, lattice: Floats, operations: SymmetryOperations, length: float) -> Floats:
    """Return the images of a site, moved first to the special position that it is at to within a length."""

    def images(x: Floats) -> Floats:
        return (operations.rotations * x).sum(axis=2) + operations.translations

    def near(points: Floats, x: Floats) -> npt.NDArray[np.bool_]:
        steps = points - x
        cart = product((steps - np.round(steps))[:, None, :], lattice)[:, 0]
        return np.asarray((cart**2).sum(axis=1) <= length**2)

    moved = images(position)
    own = near(moved, position)
    steps = moved[own] - position
    exact = _without_roundoff(position + (steps - np.round(steps)).sum(axis=0) / max(1, len(steps)))
    moved, orbit = _without_roundoff(images(exact)), []
    rest = np.ones(len(moved), dtype=bool)
    while rest.any():
        point = moved[rest.argmax()]
        same = near(moved, point)
        if same.sum() != own.sum():
            raise ValueError(
                f"site {short(label)} at {position.round(6).tolist()}: the space group makes its images collide, "
                f"closer than {length:.3g}; correct the position, or the tolerance"
            )
        orbit.append(point)
        rest &= ~same
    return np.array(orbit)


def _without_roundoff(points: Floats) -> Floats:
    """Return coordinates in which multiples of 1/24, those of special positions, are exact."""
    parts = np.round(24.0 * points)
    return np.where(np.abs(24.0 * points - parts) < 1e-12, parts / 24.0, points)


def _turned(key: tuple[int, ...]) -> tuple[int, ...]:
    return (key[1], key[0], -key[2], -key[3], -key[4])


def _preference(key: tuple[int, ...]) -> tuple[Any, ...]:
    i, j, *n = key
    return (i > j, i, j, sum(m < 0 for m in n), sum(map(abs, n)), [-m for m in n])


def _element(kind: str) -> str:
    match = re.match(r"[A-Za-z]+", kind)
    return match[0] if match else kind


def _letters(number: int) -> str:
    rest, place = divmod(number, 26)
    return (_letters(rest - 1) if rest else "") + chr(ord("a") + place)


def _combination(coefficients: Floats) -> str:
    text = ""
    for place, value in enumerate(coefficients.tolist()):
        if abs(value) > 1e-9:
            size = "" if abs(abs(value) - 1.0) < 1e-9 else f"{abs(value):.6g}"
            text += ("-" if value < 0 else "+" if text else "") + size + chr(ord("A") + place)
    return text or "0"


def _clean(matrices: Floats, size: float) -> Floats:
    """Return matrices without the entries that are round-off."""
    return np.where(np.abs(matrices) <= 1e-14 * size, 0.0, matrices)
