"""Crystals from crystallographic information files (CIF), parsed by gemmi."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.optional_packages import require_packages
from coadjoint.regular_files import content_of
from coadjoint.short_repr import short
from coadjoint.systems.lattices.crystals import Crystal, expanded_crystal
from coadjoint.systems.lattices.lattice_vectors import lattice_of
from coadjoint.systems.lattices.space_groups import operations_by_name, operations_of_triplets

MAX_BYTES = 2**24
OPERATIONS = ("_space_group_symop_operation_xyz", "_symmetry_equiv_pos_as_xyz")
NAMES = ("_space_group_name_H-M_alt", "_symmetry_space_group_name_H-M")
NUMBERS = ("_space_group_IT_number", "_symmetry_Int_Tables_number")
MAGNETIC = ("_space_group_symop_magn_operation", "_space_group_symop.magn_operation", "_atom_site_moment")


def crystal_of_cif(path: Path, space_group: Any, tolerance: float) -> Crystal:
    """Return the crystal in a CIF of one structure."""
    block = structure_block(path)
    import gemmi

    tags = [tag for item in block for tag in _tags_of(item)]
    moment = next((tag for tag in tags if tag.startswith(MAGNETIC)), None)
    if moment is not None:
        raise ValueError(
            f"{path} is a magnetic CIF ({moment}), whose moments would be lost; give it to "
            "co.spins.magnetic_structure, or a CIF without them"
        )
    lattice, sites = cell_of_block(block, path), sites_of_block(block, path)
    triplets = next((list(column) for column in map(block.find_values, OPERATIONS) if column), [])
    if space_group is None and triplets:
        operations = operations_of_triplets([gemmi.cif.as_string(text) for text in triplets], str(path))
    else:
        name = space_group if space_group is not None else _named(block)
        if name is None:
            raise ValueError(f"{path} has neither symmetry operations nor a space group; give space_group=")
        operations = operations_by_name(name, lattice, tolerance, f"{path}: the space group")
    try:
        only_identity = len(operations.rotations) == 1 and space_group is None  # as programs write full cells
        return expanded_crystal(lattice, sites, None if only_identity else operations, tolerance)
    except ValueError as reason:
        raise ValueError(f"{path}: {reason}") from None


def structure_block(path: Path) -> Any:
    """Return the block of a CIF that has fractional coordinates; ValueError unless there is one."""
    require_packages(f"{path}, a CIF,", "gemmi")
    import gemmi

    content = content_of(path, MAX_BYTES, "a CIF", 10)
    try:
        document = gemmi.cif.read_string(content.decode("utf-8", "replace"))
    except Exception as reason:  # of the parser, with the line
        raise ValueError(f"{path} is no CIF: {short(str(reason), 200)}") from None
    blocks = [block for block in document if block.find_values("_atom_site_fract_x")]
    if len(blocks) != 1:
        found = "no block with fractional coordinates" if not blocks else f"{len(blocks)} structures"
        raise ValueError(f"{path} has {found}; give a CIF of one structure, with _atom_site_fract_x, _y and _z")
    return blocks[0]


def cell_of_block(block: Any, path: Path) -> npt.NDArray[np.float64]:
    """Return the lattice vectors of a structure."""
    constants = [
        cif_number(block.find_value(f"_cell_{name}"), f"{path}: _cell_{name}")
        for name in ("length_a", "length_b", "length_c", "angle_alpha", "angle_beta", "angle_gamma")
    ]
    return lattice_of(constants, f"{path}: the cell")


def _tags_of(item: Any) -> list[str]:
    if item.pair is not None:
        return [item.pair[0]]
    return list(item.loop.tags) if item.loop is not None else []


def _named(block: Any) -> str | int | None:
    import gemmi

    for tag in NAMES:
        text = block.find_value(tag)
        if text and text not in "?.":
            return str(gemmi.cif.as_string(text))
    for tag in NUMBERS:
        text = block.find_value(tag)
        if text and text.isdecimal():
            return int(text)
    return None


def sites_of_block(block: Any, path: Path) -> list[tuple[str, str, Any]]:
    """Return label, species and fractional position of the listed sites."""
    import gemmi

    tags = ["label", "fract_x", "fract_y", "fract_z", "?type_symbol", "?occupancy"]
    sites = []
    for row in block.find("_atom_site_", tags):
        label = gemmi.cif.as_string(row[0])
        kind = gemmi.cif.as_string(row[4]) if row.has(4) else label.rstrip("0123456789")
        position = np.array([cif_number(row[k], f"{path}: _atom_site_fract of {short(label)}") for k in (1, 2, 3)])
        if row.has(5) and row[5] not in (".", "?") and cif_number(row[5], f"{path}: _atom_site_occupancy") != 1.0:
            raise ValueError(f"{path}: the occupancy of {short(label)} is {row[5]}; give a CIF of fully occupied sites")
        sites.append((label, kind, position))
    if not sites:
        raise ValueError(f"{path} has sites without _atom_site_label or a coordinate; give them all")
    return sites


def cif_number(text: str | None, what: str) -> float:
    """Return a number without its uncertainty; ValueError unless it is finite."""
    import gemmi

    value = float("nan") if text is None else float(gemmi.cif.as_number(text))
    if not abs(value) < 1e30:
        raise ValueError(f"{what} is {'missing' if text is None else short(text)}; give a finite number")
    return value
