"""What users declare of a spin model on a crystal: units, lengths, couplings of bonds, anisotropies of sites."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.lattices.crystals import Crystal
from coadjoint.systems.lattices.spin_lattice import MAX_COUPLING
from coadjoint.systems.lattices.spin_polynomials import SitePolynomial
from coadjoint.systems.lattices.twists import Twist

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

AXES = "abc"
MEV_PER_JOULE = 1.0 / 1.602176634e-22


class Units(NamedTuple):
    """Constants of nature in the units of a model, and its units of energy, field, time, temperature and length."""

    hbar: float
    mu_B: float
    k_B: float
    dipole: float  # mu0 mu_B^2 / (4 pi)
    names: tuple[str, str, str, str, str]


# CODATA 2022; hbar and k_B are exact.
UNITS = {
    "natural": Units(1.0, 1.0, 1.0, 1.0, ("", "", "", "", "")),
    "meV": Units(
        0.6582119569509067,
        0.057883817982,
        0.08617333262145179,
        0.053681511053262,
        (" meV", " T", " ps", " K", " angstrom"),
    ),
}


class Coupling(NamedTuple):
    """Matrices of bonds of a cell, that act on states; `bonds` (k, 5) are sites and offsets.

    States are unit vectors, or the unit and expectations of the operators of a site. `given` are constants of the bond
    `source`, by what follows `name` in their names: nothing for a number, A, B, ... for the entries of a matrix.
    """

    what: str
    bond: str
    bonds: Integers
    matrices: Floats
    text: str
    source: Any = None
    given: Mapping[str, float] | None = None
    name: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class ExchangeTable:
    """Exchange matrices of bonds of a cell, each bond once; `co.spins.read_exchange` makes them.

    Attributes
    ----------
    sites : (bonds, 2) array of int
        First and second site of each bond.
    offsets : (bonds, 3) array of int
        Cell of the second site.
    matrices : (bonds, 3, 3) array
        J of the energy ``S_i . J S_j``: positive ones are antiferromagnetic.
    units : str
        ``"meV"``, or ``"natural"``.
    of_directions : bool
        Whether the matrices belong to directions of length 1, as of TB2J and VAMPIRE, else to spins of lengths S.
    source : str
        The file.
    """

    sites: Integers
    offsets: Integers
    matrices: Floats
    units: str
    of_directions: bool
    source: str

    def __repr__(self) -> str:
        of = "directions" if self.of_directions else "spins of lengths S"
        return f"<exchange of {len(self.sites)} bonds of a cell, {self.units}, for {of}, from {short(self.source)}>"


class Anisotropy(NamedTuple):
    """Single-ion matrices of sites of a cell, and site, degree and polynomial of Stevens functions, of unit vectors.

    Of sites of SU(N) the matrices are columns of coefficients of operators.
    """

    what: str
    sites: Integers
    matrices: Floats
    polynomials: tuple[tuple[int, int, SitePolynomial], ...]
    text: str
    source: Any = None
    given: Mapping[str, float] | None = None


class Biquadratic(NamedTuple):
    """Strengths K of K (S_i . S_j)^2 of bonds of a cell, of unit vectors; `bonds` (k, 5) are sites and offsets."""

    what: str
    bond: str
    bonds: Integers
    strengths: Floats
    text: str
    source: Any
    given: Mapping[str, float]
    name: str


class Substitution(NamedTuple):
    """Sites, numbered among all of the lattice, that have other ions."""

    numbers: Integers
    spin: float
    g: float
    text: str


@dataclass(frozen=True, eq=False)
class Declaration:
    """What a user has declared of a spin model."""

    crystal: Crystal
    size: tuple[int, int, int]
    periodic: tuple[bool, bool, bool]
    units: str
    spin: Floats  # of the sites of a cell
    g: Floats
    twist: Twist | None = None
    occupied: Integers | None = None
    substitutions: tuple[Substitution, ...] = ()
    couplings: tuple[Coupling, ...] = ()
    biquadratics: tuple[Biquadratic, ...] = ()
    anisotropies: tuple[Anisotropy, ...] = ()
    field: Any = None
    dipolar: bool = False

    @property
    def count(self) -> int:
        """Number of all sites, also of empty ones."""
        return len(self.crystal.labels) * math.prod(self.size)

    @property
    def numbers(self) -> Integers:
        """Numbers of the occupied sites among all."""
        return np.arange(self.count) if self.occupied is None else self.occupied

    @property
    def sites(self) -> Integers:
        """Number of the site of each spin in its cell."""
        return self.numbers % len(self.crystal.labels)

    @property
    def lengths(self) -> Floats:
        """Length S of each spin."""
        return self._with_substituted(self.spin, lambda ion: ion.spin)

    @property
    def moments(self) -> Floats:
        """Moment g S of each spin."""
        return self._with_substituted(self.g * self.spin, lambda ion: ion.g * ion.spin)

    def _with_substituted(self, of_cell: Floats, of_ion: Callable[[Substitution], float]) -> Floats:
        """Return numbers of the spins, from those of the sites of a cell, and of ions that are in their place."""
        found, numbers = of_cell[self.sites], self.numbers
        for ion in self.substitutions:
            found[np.searchsorted(numbers, ion.numbers[np.isin(ion.numbers, numbers)])] = of_ion(ion)
        return found


def merged_bonds(declared: Declaration) -> tuple[list[tuple[int, ...]], Floats, list[int]]:
    """Return the bonds of a cell, each once, the distinct matrices, and which of them each bond has."""
    total: dict[tuple[int, ...], Floats] = {}
    owner: dict[tuple[int, ...], str] = {}
    for coupling in declared.couplings:
        for key, matrix in zip(map(tuple, coupling.bonds.tolist()), coupling.matrices, strict=True):
            back = (key[1], key[0], *(-n for n in key[2:]))
            if back in total:
                total[back] = total[back] + matrix.T
            else:
                total[key] = total[key] + matrix if key in total else matrix
                owner.setdefault(key, coupling.bond)
    check_joined_once(declared, owner)
    known: dict[bytes, int] = {}
    kinds = [known.setdefault((matrix + 0.0).tobytes(), len(known)) for matrix in total.values()]
    shape = declared.couplings[0].matrices.shape[1:] if declared.couplings else (3, 3)
    distinct = np.array([np.frombuffer(code).reshape(shape) for code in known]).reshape(-1, *shape)
    return list(total), distinct if len(distinct) else np.zeros((1, *shape)), kinds


def check_joined_once(declared: Declaration, owner: Mapping[tuple[int, ...], str]) -> None:
    """Raise ValueError if bonds of a cell, with names, join two sites of a periodic lattice twice."""
    seen: dict[tuple[int, ...], tuple[int, ...]] = {}
    for key in owner:
        for i, j, *n in (key, (key[1], key[0], *(-m for m in key[2:]))):
            wrapped = [
                m % size if flag else m for m, size, flag in zip(n, declared.size, declared.periodic, strict=True)
            ]
            place = (i, j, *wrapped)
            other = (i, i, 0, 0, 0) if i == j and not any(wrapped) else seen.setdefault(place, (i, j, *n))
            if other != (i, j, *n):
                raise _cut_twice(declared, owner[key], (i, j, *n), other)


def _cut_twice(declared: Declaration, name: str, bond: tuple[int, ...], other: tuple[int, ...]) -> ValueError:
    """Return the error of two bonds that join the same sites of a periodic lattice."""
    labels, (i, j, *n) = declared.crystal.labels, bond
    alone = i == j and not any(other[2:])
    far = [abs(m if alone else m - k) * (1 + alone) + 1 for m, k in zip(n, other[2:], strict=True)]
    axis = int(np.argmax(far))
    joined = "to itself" if alone else f"and {labels[j]} {j} twice"
    return ValueError(
        f"bond {name} joins {labels[i]} {i} {joined} in {cells_text(declared.size)} cells, at the offsets {tuple(n)} "
        f"and {tuple(other[2:])}; take at least {far[axis]} cells along {AXES[axis]}, or periodic=False there"
    )


def check_sizes(values: Floats, what: str) -> None:
    """Raise ValueError for numbers whose products may leave the range of float64."""
    if not np.abs(values).max(initial=0.0) <= MAX_COUPLING:
        raise ValueError(f"{what} has numbers beyond {MAX_COUPLING:g}; take larger units")


def cells_text(size: tuple[int, ...]) -> str:
    """Return numbers of cells as text."""
    return " x ".join(map(str, size))
