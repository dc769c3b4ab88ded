"""Exchange constants from files: TB2J's exchange.out, unit cell files of VAMPIRE, and tables of bonds."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.files.ccsds import lines_of
from coadjoint.files.columns import split_unit, text_table
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.regular_files import content_of
from coadjoint.short_repr import short
from coadjoint.systems.lattices.bonds import antisymmetric
from coadjoint.systems.lattices.crystals import MAX_BONDS, MAX_SITES, Crystal
from coadjoint.systems.lattices.declared_spins import MEV_PER_JOULE, ExchangeTable
from coadjoint.validation import read_choice, read_path, read_positive

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_BYTES = 2**28
CELL_TOLERANCE = 1e-3  # of lattice vectors and of positions, relative to the shortest lattice vector
RECIPROCITY = 0.01  # largest difference of a matrix and the transpose of its reverse, of the largest entry of a file
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
TB2J_BOND = re.compile(rf"\s*(\S+)\s+(\S+)\s+\(\s*(-?\d+),\s*(-?\d+),\s*(-?\d+)\)\s+({NUMBER})\s+\(")
TB2J_TAG = re.compile(r"\s*\[\w+!\]\s*")
UCF_TYPES = {"isotropic": 1, "vectorial": 3, "tensorial": 9, "0": 1, "1": 3, "2": 9}
MATRIX_COLUMNS = [f"J{a}{b}" for a in "xyz" for b in "xyz"]


class ListedExchange(NamedTuple):
    """What a file lists: its cell, positions of atoms by label in units of it, and matrices of bonds.

    `entries` are (label, label, offset) and matrices, `factor` times which, of each direction, is the energy.
    """

    lattice: Floats | None
    atoms: dict[str, Floats]
    ends: list[tuple[str, str]]
    offsets: Integers
    matrices: Floats
    factor: float
    units: str


@suggest_keywords
def read_exchange(
    path: str | Path, crystal: Crystal, *, format: str | None = None, max_distance: float | None = None
) -> ExchangeTable:
    r"""Read exchange constants of a crystal from a file of a first-principles code, VAMPIRE, or a table.

    Choose it for many bonds, or matrices that someone has computed; ``model.exchange(table)`` adds them. All matrices
    are converted to those of ``S_i . J S_j`` with each bond once, in which J > 0 is antiferromagnetic.

    Parameters
    ----------
    path : str or pathlib.Path
        The file: TB2J's ``exchange.out``, ``.ucf`` of VAMPIRE, or a table ``.csv``.
    crystal : Crystal
        The magnetic sites. Its lattice vectors, in angstroms, must be those of the file, in the same Cartesian frame,
        and its sites among the atoms of the file.
    format : {"tb2j", "ucf", "csv"}, optional
        Format of a file of another name.
    max_distance : float, optional
        Bonds beyond this length, in the unit of the crystal, are left out.

    Returns
    -------
    ExchangeTable

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError, TypeError
        A file of other content, by line; another cell or other atoms than those of the crystal; a bond that is listed
        twice, or in one direction only; single-ion and biquadratic terms, which would be lost; normalised exchange,
        whose constants are in another file.

    Notes
    -----
    TB2J: ``E = -sum e_i . J e_j`` over both directions of each bond, J of its isotropic, anisotropic and
    Dzyaloshinskii-Moriya parts in meV, of directions e. VAMPIRE: joules, of directions, with the field
    ``sum_j J_ij e_j``; types isotropic, vectorial and tensorial. Tables: columns ``i``, ``j`` (sites of the crystal,
    from 0), ``n1``, ``n2``, ``n3`` (cell of the second site), and ``J`` or ``Jxx``, ``Jxy``, ... ``Jzz``, and
    optionally ``Dx``, ``Dy``, ``Dz``, for spins of the lengths of the model and each bond once, as for
    `SpinModel.exchange`; with the unit ``J [meV]``, or none for natural units. No symmetry is applied.

    References
    ----------
    X. He, N. Helbig, M. J. Verstraete, E. Bousquet, TB2J, Comput. Phys. Commun. 264, 107938 (2021); R. F. L. Evans et
    al., J. Phys.: Condens. Matter 26, 103202 (2014).

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import coadjoint as co
    >>> file = pathlib.Path(tempfile.mkdtemp(), "bonds.csv")
    >>> _ = file.write_text("i,j,n1,n2,n3,J [meV]\n0,0,1,0,0,-1.5\n0,0,0,1,0,0.5\n")
    >>> square = co.spins.crystal(lattice=(3, 3, 9, 90, 90, 90), sites={"Fe": (0, 0, 0)}, space_group="P 1")
    >>> table = co.spins.read_exchange(file, square)
    >>> co.systems.spins(square, (4, 4, 1), units="meV").exchange(table).energy([0, 0, 1] * 16)
    -16.0
    """
    file = read_path(path, "path")
    if not isinstance(crystal, Crystal):
        raise TypeError(f"crystal is {short(crystal)}; give one of co.spins.crystal")
    limit = None if max_distance is None else read_positive(max_distance, "max_distance")
    chosen = _format_of(file) if format is None else read_choice(format, "format", FORMATS)
    listed = FORMATS[chosen](file)
    if len(listed.ends) > 2 * MAX_BONDS:
        raise ValueError(f"{file} lists {len(listed.ends)} bonds; at most {2 * MAX_BONDS} are read")
    sites, shifts = _sites_of(file, listed, crystal)
    missing = next((label for ends in listed.ends for label in ends if label not in sites), None)
    if missing is not None:
        raise ValueError(
            f"{file} has exchange of {short(missing)}, which is no site of {crystal!r}; give its magnetic sites"
        )
    first, second = (np.array([sites[ends[k]] for ends in listed.ends], dtype=np.int64) for k in (0, 1))
    moved = [np.array([shifts[ends[k]] for ends in listed.ends], dtype=np.int64).reshape(-1, 3) for k in (0, 1)]
    bonds = np.column_stack([first, second, listed.offsets.reshape(-1, 3) + moved[1] - moved[0]])
    steps = (bonds[:, 2:] + crystal.positions[bonds[:, 1]] - crystal.positions[bonds[:, 0]]) @ crystal.lattice
    near = np.ones(len(bonds), dtype=bool) if limit is None else np.linalg.norm(steps, axis=1) <= limit * (1 + 1e-9)
    both = listed.factor if listed.lattice is not None else None
    kept, matrices = _once(file, bonds[near], listed.matrices[near], both)
    for array in (kept, matrices):
        array.flags.writeable = False
    return ExchangeTable(kept[:, :2], kept[:, 2:], matrices, listed.units, listed.lattice is not None, str(file))


def _format_of(file: Path) -> str:
    name = file.name.lower()
    found = {".csv": "csv", ".ucf": "ucf", ".out": "tb2j"}.get(Path(name).suffix)
    if found is None:
        raise ValueError(f"{file} has no name of an exchange file; give exchange.out, .ucf or .csv, or format=")
    return found


def _sites_of(file: Path, listed: ListedExchange, crystal: Crystal) -> tuple[dict[str, int], dict[str, Integers]]:
    """Return the site of the crystal at each atom of a file, and the cell of the crystal in which the atom is."""
    if listed.lattice is None:
        known = {label for ends in listed.ends for label in ends}
        outside = next((label for label in known if int(label) >= len(crystal.labels)), None)
        if outside is not None:
            raise ValueError(f"{file} has the site {outside}; sites are numbered from 0 to {len(crystal.labels) - 1}")
        return {label: int(label) for label in known}, {label: np.zeros(3, dtype=np.int64) for label in known}
    length = CELL_TOLERANCE * float(np.linalg.norm(crystal.lattice, axis=1).min())
    if np.abs(listed.lattice - crystal.lattice).max() > length:
        raise ValueError(
            f"{file} has the lattice vectors {np.round(listed.lattice, 4).tolist()}, and the crystal "
            f"{np.round(crystal.lattice, 4).tolist()}; give a crystal of these vectors: "
            "crystal(lattice=vectors, sites=...)"
        )
    sites, shifts = {}, {}
    for label, place in listed.atoms.items():
        steps = place - crystal.positions
        cells = np.round(steps)
        gaps = np.linalg.norm((steps - cells) @ crystal.lattice, axis=1)
        site = int(gaps.argmin())
        if gaps[site] <= length:
            sites[label], shifts[label] = site, cells[site].astype(np.int64)
    lost = sorted(set(range(len(crystal.labels))) - set(sites.values()))
    if lost:
        raise ValueError(
            f"{file} has no atom at site {lost[0]} ({crystal.labels[lost[0]]}) of the crystal, at "
            f"{crystal.positions[lost[0]].round(5).tolist()}; give a crystal of the same cell"
        )
    return sites, shifts


def _once(file: Path, bonds: Integers, matrices: Floats, factor: float | None) -> tuple[Integers, Floats]:
    """Return each bond once with its energy matrix; `factor` of bonds that are listed in both directions."""
    found: dict[tuple[int, ...], Floats] = {}
    kept: list[tuple[int, ...]] = []
    size = np.abs(matrices).max(initial=0.0)
    for key, matrix in zip(map(tuple, bonds.tolist()), matrices, strict=True):
        what = f"the bond of sites {key[0]} and {key[1]} at offset {key[2:]}"
        if key[0] == key[1] and not any(key[2:]):
            raise ValueError(f"{file} has a bond of site {key[0]} to itself; remove it")
        if key in found:
            raise ValueError(f"{file} has {what} twice; give it once")
        found[key] = matrix
    total = []
    for key, matrix in found.items():
        back = (key[1], key[0], *(-n for n in key[2:]))
        what = f"the bond of sites {key[0]} and {key[1]} at offset {key[2:]}"
        if factor is None:
            if back in found:
                raise ValueError(f"{file} has {what} in both directions; give each bond once")
            kept.append(key)
            total.append(matrix)
        elif back not in found:
            raise ValueError(f"{file} has {what} in one direction only; its format lists both")
        elif key < back:
            if np.abs(matrix - found[back].T).max() > RECIPROCITY * size:
                raise ValueError(f"{file} has different matrices for both directions of {what}; correct them")
            kept.append(key)
            total.append(factor * (matrix + found[back].T))
    return np.array(kept, dtype=np.int64).reshape(-1, 5), np.array(total, dtype=np.float64).reshape(-1, 3, 3)


def _lines(file: Path, what: str) -> list[str]:
    return content_of(file, MAX_BYTES, what, 10).decode("utf-8", "replace").splitlines()


def _numbers(text: str, count: int, where: str) -> list[float]:
    found = [float(one) for one in re.findall(NUMBER, text)]
    if len(found) < count or not all(abs(one) < 1e30 for one in found[:count]):
        raise ValueError(f"{where} is {short(text)}; it must have {count} finite numbers")
    return found[:count]


def _tb2j(file: Path) -> ListedExchange:
    lines = _lines(file, "an exchange.out of TB2J")
    heads = {
        text: k
        for k, line in enumerate(lines)
        for text in ("Cell (Angstrom):", "Atoms:", "Exchange:")
        if line.startswith(text)
    }
    if len(heads) < 3:
        raise ValueError(f"{file} is no exchange.out of TB2J: it has no sections Cell, Atoms and Exchange")
    if any(line.startswith("Single Ion Anisotropy") for line in lines):
        raise ValueError(
            f"{file} has single-ion anisotropies, which would be lost; remove this section, and give them by single_ion"
        )
    k = heads["Cell (Angstrom):"]
    lattice = np.array([_numbers(line, 3, f"{file}, a vector of the cell,") for line in lines[k + 1 : k + 4]])
    if lattice.shape != (3, 3) or abs(np.linalg.det(lattice)) == 0.0:
        raise ValueError(f"{file} has no cell of three vectors with a volume")
    inverse, atoms = np.linalg.inv(lattice), {}
    for line in lines[heads["Atoms:"] + 1 : heads["Exchange:"]]:
        words = line.split()
        if words and words[0] == "Total":
            break
        if len(words) >= 4 and re.fullmatch(r"[A-Z][a-z]?\d+", words[0]):
            atoms[words[0]] = np.array(_numbers(" ".join(words[1:4]), 3, f"{file}, an atom,")) @ inverse
    if len(atoms) > MAX_SITES:
        raise ValueError(f"{file} has {len(atoms)} atoms; at most {MAX_SITES} are read")
    ends, offsets, matrices = [], [], []
    for number in range(heads["Exchange:"] + 1, len(lines)):
        line, where = lines[number], f"{file}, line {number + 1},"
        part, _, values = TB2J_TAG.sub("", line).partition(":")
        if part == "Jprime":
            raise ValueError(f"{where} has biquadratic exchange, which would be lost; remove such lines")
        bond = TB2J_BOND.match(line)
        if bond is not None:
            ends.append((bond[1], bond[2]))
            offsets.append([int(bond[m]) for m in (3, 4, 5)])
            matrices.append(float(bond[6]) * np.eye(3))
        elif part == "J_iso" and matrices:
            matrices[-1] = _numbers(values, 1, where)[0] * np.eye(3)
        elif part == "DMI" and matrices:
            matrices[-1] = matrices[-1] + antisymmetric(_numbers(values, 3, where))
        elif part == "J_ani" and matrices:
            rows = " ".join(lines[number + 1 : number + 4])
            matrices[-1] = matrices[-1] + np.reshape(_numbers(rows, 9, where), (3, 3))
    if not ends:
        raise ValueError(f"{file} has no bonds in its section Exchange, as TB2J writes them from version 0.3 on")
    return ListedExchange(lattice, atoms, ends, np.array(offsets), np.array(matrices), -1.0, "meV")


def _ucf(file: Path) -> ListedExchange:
    lines = [
        (number, text.split())
        for number, text in enumerate((line.partition("#")[0] for line in _lines(file, "a unit cell file")), 1)
        if text.strip()
    ]
    rows = iter(lines)

    def row(count: int, what: str) -> list[float]:
        number, words = next(rows, (len(lines), []))
        return _numbers(" ".join(words), count, f"{file}, line {number}, {what},")

    sizes = np.array(row(3, "the size of the cell"))
    lattice = sizes[:, None] * np.array([row(3, "a lattice vector") for _ in range(3)])
    if abs(np.linalg.det(lattice)) == 0.0:
        raise ValueError(f"{file} has a cell without volume; correct its vectors")
    atoms = {}
    count = _count(file, row(1, "the number of atoms")[0], MAX_SITES, "atoms")
    for _ in range(count):
        number, *place = row(4, "an atom")
        atoms[str(int(number))] = np.array(place)
    line, words = next(rows, (len(lines), ["0"]))
    kind = words[1] if len(words) > 1 else "isotropic"
    if kind not in UCF_TYPES:
        raise ValueError(
            f"{file}, line {line}, has exchange of the type {short(kind)}; types are isotropic, vectorial and "
            "tensorial, and those that are normalised have their constants in a material file: multiply them"
        )
    width = UCF_TYPES[kind]
    count = _count(file, _numbers(words[0], 1, f"{file}, line {line},")[0], 2 * MAX_BONDS, "interactions")
    ends, offsets, matrices = [], [], []
    for _ in range(count):
        _, i, j, *rest = row(6 + width, "an interaction")
        ends.append((str(int(i)), str(int(j))))
        offsets.append([int(value) for value in rest[:3]])
        values = np.array(rest[3:]) * MEV_PER_JOULE
        matrices.append(values.reshape(3, 3) if width == 9 else values * np.eye(3))
    surplus = next(rows, None)
    if surplus is not None:
        raise ValueError(
            f"{file}, line {surplus[0]}, is after the {count} interactions; biquadratic exchange would be lost"
        )
    return ListedExchange(
        lattice, atoms, ends, np.array(offsets, dtype=np.int64), np.array(matrices).reshape(-1, 3, 3), -0.5, "meV"
    )


def _count(file: Path, value: float, most: int, what: str) -> int:
    if not 0 <= value <= most or value != int(value):
        raise ValueError(f"{file} announces {value:g} {what}; from 0 to {most} are read")
    return int(value)


def _csv(file: Path) -> ListedExchange:
    table = text_table(str(file), lines_of(file)[1])
    named = [split_unit(name) for name in table.names]
    columns = {name: k for k, (name, _) in enumerate(named)}
    bond, single, full, vector = ("i", "j", "n1", "n2", "n3"), ["J"], MATRIX_COLUMNS, ["Dx", "Dy", "Dz"]
    energies = [name for name in columns if name not in bond]
    allowed = [kind + extra for kind in (single, full) for extra in ([], vector)] + [vector]
    if not set(bond) <= set(columns) or not any(set(energies) == set(kind) for kind in allowed):
        raise ValueError(
            f"{file} has the columns {short(', '.join(table.names), 200)}; give i, j, n1, n2, n3, and J or Jxx, "
            "Jxy, ... Jzz, or Dx, Dy, Dz, or both"
        )
    units = {named[columns[name]][1] for name in energies}
    if units not in ({""}, {"meV"}):
        raise ValueError(
            f"{file} has energies in {short(sorted(units))}; give meV in all columns, or none for natural units"
        )
    rows = []
    for number, cells in zip(table.numbers, table.rows, strict=True):
        try:
            rows.append([float(cell) for cell in cells])
        except ValueError:
            raise ValueError(
                f"{file}, line {number}: {short(','.join(cells))} has something else than numbers"
            ) from None
    values = np.array(rows).reshape(len(rows), -1)
    whole = values[:, [columns[name] for name in bond]]
    bad = np.flatnonzero(
        ~(np.abs(values) < 1e30).all(axis=1)
        | (whole != np.round(whole)).any(axis=1)
        | (whole[:, :2] < 0).any(axis=1)
        | (np.abs(whole) > 1e6).any(axis=1)
    )
    if bad.size:
        raise ValueError(
            f"{file}, line {table.numbers[bad[0]]}: give whole numbers of sites and cells, and finite energies"
        )
    matrices = np.zeros((len(rows), 3, 3))
    if "J" in columns:
        matrices += values[:, columns["J"], None, None] * np.eye(3)
    elif "Jxx" in columns:
        matrices += values[:, [columns[name] for name in full]].reshape(-1, 3, 3)
    if "Dx" in columns:
        matrices += antisymmetric(values[:, [columns[name] for name in vector]])
    integers = whole.astype(np.int64)
    ends = [(str(i), str(j)) for i, j in integers[:, :2].tolist()]
    return ListedExchange(None, {}, ends, integers[:, 2:], matrices, 1.0, "meV" if units == {"meV"} else "natural")


FORMATS: dict[str, Callable[[Path], ListedExchange]] = {"tb2j": _tb2j, "ucf": _ucf, "csv": _csv}
