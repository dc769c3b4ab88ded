"""Bonds and sites of crystals in classes that symmetry makes equal, and the matrices that it allows on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.lattices.space_groups import product
from coadjoint.validation import read_finite

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MATRIX_TOLERANCE = 1e-6  # of typed exchange matrices, relative to the largest entry
MAX_ENTRY = 1e100  # of matrices, as of couplings of spins
SYMMETRIC = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
LETTERS = "ABCDEFGHI"  # of the free entries of a matrix
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
        images = clean(product(product(R, near), R.swapaxes(-1, -2)), size)
        equal = np.abs(images - near).max(axis=(1, 2)) <= 1e-14 * size  # such as isotropic exchange, without round-off
        return np.where(equal[:, None, None], near, images)

    @cached_property
    def basis(self) -> Floats:
        """Basis of the allowed matrices."""
        return np.concatenate([self._reduced(SYMMETRIC, 1.0), self._reduced(AXIAL, -1.0)])

    def _entries(self, J: Floats) -> dict[str, float]:
        """Return the coefficients A, B, ... of an allowed matrix in the basis, each an entry of its form."""
        found = {}
        for letter, matrix in zip(LETTERS, self.basis, strict=False):
            even = np.array_equal(matrix, matrix.T)
            a, b = next(entry for entry in (SYMMETRIC if even else AXIAL) if matrix[entry])
            found[letter] = float(0.5 * (J[a, b] + J[b, a] if even else J[a, b] - J[b, a]))
        return found

    def _projected(self, J: Floats) -> Floats:
        """Return the nearest allowed matrix, the mean over the operations that keep the representative."""
        images = product(product(self._kept, J), self._kept.swapaxes(-1, -2))
        images[self._reversed] = images[self._reversed].swapaxes(-1, -2)
        return clean(images.sum(axis=0) / len(images), np.abs(J).max())

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

    ``bonds["2a"]`` is a bond by its name, ``bonds[0]`` the first one, and ``bonds[:3]`` the first three.
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


def _combination(coefficients: Floats) -> str:
    text = ""
    for place, value in enumerate(coefficients.tolist()):
        if abs(value) > 1e-9:
            size = "" if abs(abs(value) - 1.0) < 1e-9 else f"{abs(value):.6g}"
            text += ("-" if value < 0 else "+" if text else "") + size + LETTERS[place]
    return text or "0"


def clean(matrices: Floats, size: float) -> Floats:
    """Return matrices without the entries that are round-off."""
    return np.where(np.abs(matrices) <= 1e-14 * size, 0.0, matrices)


def antisymmetric(D: Any) -> Floats:
    """Return the matrix of ``D . (S_i x S_j)``, for a vector (..., 3)."""
    vectors = np.asarray(D, dtype=np.float64)
    matrices = np.zeros((*vectors.shape, 3))
    for axis, (a, b) in enumerate(AXIAL):
        matrices[..., a, b], matrices[..., b, a] = vectors[..., axis], -vectors[..., axis]
    return matrices
