"""Crystals: sites of a cell, symmetry operations, and bonds by shell."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.lattices.bonds import Bond, Bonds, Site
from coadjoint.systems.lattices.space_groups import (
    SymmetryOperations,
    fits,
    inverse,
    operations_found,
    product,
    rotations_in_space,
)
from coadjoint.validation import read_choice, read_integer, read_positive

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_SITES = 2000  # of a cell
MAX_BONDS = 2_000_000  # directed, of one cell
COLLISION = 0.1  # least distance of two sites, in units of (volume / sites)^(1/3)


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
            A label, or the element of one label only, if all its sites are equivalent; or the number of the
            representative in `labels`.

        Returns
        -------
        Site

        Raises
        ------
        ValueError, TypeError
            An unknown site, an element of several labels, or a label of sites that symmetry does not make equal.

        Examples
        --------
        >>> import coadjoint as co
        >>> cubic = co.spins.crystal(lattice=(1, 1, 1, 90, 90, 90), sites={"Fe": (0, 0, 0)})
        >>> cubic.site("Fe"), len(cubic.site(0).basis)
        (<site Fe 0, 1 in a cell>, 1)
        """
        if isinstance(site, str):
            site = label_of(self, site, "site")
            number = self.labels.index(site)
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


def check_bond(crystal: Crystal, bond: Any) -> None:
    """Raise an error for anything else than a bond of a crystal."""
    if not isinstance(bond, Bond):
        raise TypeError(f'bond is {short(bond)}; give one of crystal.bonds(max_distance), such as bonds["1"]')
    known = max(bond.first, bond.second) < len(crystal.labels)
    ends = (crystal.labels[bond.first], crystal.labels[bond.second]) if known else ()
    if ends == bond.kinds:
        step = crystal.positions[bond.second] + bond.offset - crystal.positions[bond.first]
        known = bool(np.abs(step @ crystal.lattice - bond.vector).max() <= 1e-9 * bond.distance)
    if ends != bond.kinds or not known:
        raise ValueError(f"{bond!r} is of another crystal than {crystal!r}; take one of its own bonds")


def label_of(crystal: Crystal, name: Any, what: str) -> str:
    """Return a label of a crystal, given itself or, where one label only has it, by its element."""
    known = dict.fromkeys(crystal.labels)
    if isinstance(name, str) and name not in known:
        kinds = zip(crystal.labels, crystal.species, strict=True)
        found = list(dict.fromkeys(label for label, kind in kinds if name in (kind, _element(kind))))
        if len(found) > 1:
            raise ValueError(f"{what} is {short(name)}, the element of {', '.join(found)}; give one of these labels")
        name = found[0] if found else name
    return read_choice(name, what, known)


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
