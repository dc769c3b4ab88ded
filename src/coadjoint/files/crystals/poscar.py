"""Crystals from POSCAR and CONTCAR, the structure files of VASP 5 and 6."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.regular_files import content_of
from coadjoint.short_repr import short
from coadjoint.systems.lattices.crystals import MAX_SITES, Crystal, expanded_crystal
from coadjoint.systems.lattices.lattice_vectors import lattice_of
from coadjoint.systems.lattices.space_groups import inverse, operations_by_name, product

Floats = npt.NDArray[np.float64]

MAX_BYTES = 2**24


def crystal_of_poscar(path: Path, space_group: Any, tolerance: float) -> Crystal:
    """Return the crystal in a POSCAR."""
    lines = content_of(path, MAX_BYTES, "a POSCAR", 10).decode("utf-8", "replace").splitlines()
    if len(lines) < 8:
        raise ValueError(f"{path} has {len(lines)} lines; a POSCAR has a comment, a scale, three vectors, and sites")
    scale = _numbers(lines[1], (1, 3), f"{path}, line 2, the scale,")
    vectors = np.array([_numbers(lines[k], (3,), f"{path}, line {k + 1}, a lattice vector,") for k in (2, 3, 4)])
    factors = _factors(scale, vectors, path)
    lattice = lattice_of(vectors * factors, f"{path}: the lattice")
    species = [name.split("/")[0].split("_")[0] for name in lines[5].split()]  # Fe_pv/hash of recent versions
    if not species or not all(name.isalpha() for name in species):
        raise ValueError(f"{path}, line 6, is {short(lines[5])}; give the names of the species, as VASP 5 does")
    counts = lines[6].split()
    if len(counts) != len(species) or not all(text.isdecimal() and len(text) < 10 for text in counts):
        raise ValueError(f"{path}, line 7, is {short(lines[6])}; give one number of sites for each of {short(species)}")
    labels = [name for name, count in zip(species, counts, strict=True) for _ in range(min(int(count), MAX_SITES + 1))]
    mode = 8 if lines[7].strip()[:1] in ("S", "s") else 7
    kind = lines[mode].strip()[:1].lower() if mode < len(lines) else ""
    if kind not in ("d", "c", "k"):
        given = short(lines[mode]) if kind else "empty"
        raise ValueError(f"{path}, line {mode + 1}, is {given}; give Direct or Cartesian")
    if len(labels) > MAX_SITES or len(lines) < mode + 1 + len(labels):
        raise ValueError(
            f"{path} announces {len(labels)} sites, of at most {MAX_SITES}, and has {len(lines) - mode - 1} lines of "
            "them; correct line 7"
        )
    rows = [
        _numbers(" ".join(lines[k].split()[:3]), (3,), f"{path}, line {k + 1}, a site,")
        for k in range(mode + 1, mode + 1 + len(labels))
    ]
    positions = np.array(rows).reshape(-1, 3)
    if kind != "d":
        positions = product(positions * factors, inverse(lattice))
    try:
        crystal = expanded_crystal(lattice, list(zip(labels, labels, positions, strict=True)), None, tolerance)
        if space_group is None:
            return crystal
        operations = operations_by_name(space_group, lattice, tolerance, "space_group")
        return Crystal(crystal.lattice, crystal.labels, crystal.species, crystal.positions, operations, tolerance)
    except ValueError as reason:
        raise ValueError(f"{path}: {reason}") from None


def _factors(scale: Floats, vectors: Floats, path: Path) -> Floats:
    """Return the factors of Cartesian components; a negative number is minus the volume of the cell."""
    if len(scale) == 3:
        if (scale <= 0.0).any():
            raise ValueError(f"{path}, line 2, has the scales {scale.tolist()}; three of them must be positive")
        return scale
    volume = abs(float((np.cross(vectors[0], vectors[1]) * vectors[2]).sum()))
    if scale[0] == 0.0 or volume == 0.0:
        raise ValueError(f"{path} has a cell without volume; correct the scale, or the lattice vectors")
    return np.full(3, scale[0] if scale[0] > 0.0 else math.pow(-scale[0] / volume, 1.0 / 3.0))


def _numbers(line: str, counts: tuple[int, ...], what: str) -> Floats:
    words = line.split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([math.nan])
    if len(words) not in counts or not (np.abs(values) < 1e30).all():
        needed = " or ".join(map(str, counts))
        raise ValueError(f"{what} is {short(line)}; give {needed} finite number{'s' if needed != '1' else ''}")
    return values
