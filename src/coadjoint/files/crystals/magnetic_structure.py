"""Commensurate magnetic structures from magnetic CIF (mCIF), parsed by gemmi."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.files.crystals.cif import cell_of_block, cif_number, sites_of_block, structure_block
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.lattices.coherent_spins import CoherentSpinModel
from coadjoint.systems.lattices.crystals import Crystal, expanded_crystal
from coadjoint.systems.lattices.space_groups import (
    SymmetryOperations,
    inverse,
    operations_of_triplets,
    product,
    rotations_in_space,
)
from coadjoint.systems.lattices.spin_model import SpinModel
from coadjoint.validation import read_path, read_positive

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

# Names of magnetic CIF 1.0, and of files from before.
OPERATIONS = ("_space_group_symop_magn_operation.xyz", "_space_group_symop.magn_operation_xyz")
CENTRINGS = ("_space_group_symop_magn_centering.xyz", "_space_group_symop.magn_centering_xyz")
MODULATED = ("_cell_modulation_dimension", "_cell_wave_vector_x", "_atom_site_moment_Fourier_atom_site_label")
STRAIN = 0.02  # largest difference of a cell from a supercell of the other, relative
NEAR = 0.05  # largest distance of a spin from the site of its moment, in shortest lattice vectors
MOMENT = 0.02  # largest difference of moments that symmetry makes equal, relative to the largest: files have few digits


@dataclass(frozen=True, eq=False, repr=False)
class MagneticStructure:
    """A commensurate magnetic structure; `co.spins.magnetic_structure` reads it.

    Attributes
    ----------
    crystal : Crystal
        The magnetic cell with all sites. Its symmetry are the operations of the file without time reversal, of which
        the paramagnet may have more.
    moments : (sites, 3) ndarray
        Moment of each site in Bohr magnetons, in the Cartesian frame of the lattice; zero without one.
    source : str
        The file.
    """

    crystal: Crystal
    moments: Floats
    source: str

    def __repr__(self) -> str:
        sizes = np.linalg.norm(self.moments, axis=1)
        return f"<{int((sizes > 0.0).sum())} moments of up to {sizes.max():.4g} mu_B on {self.crystal!r}>"

    @suggest_keywords
    def state(self, model: SpinModel) -> Floats:
        """Return the state of a model in this structure, with spins along the moments or opposite to them.

        Parameters
        ----------
        model : SpinModel
            On `crystal` or its magnetic sites, or on the crystal of a smaller or larger cell, such as that of the
            paramagnet, in the same frame. Periodic axes must have whole magnetic cells. Spins of positive g are along
            the moments, of negative g opposite to them.

        Returns
        -------
        (n,) ndarray
            Unit vectors, in the order of the model; the coherent states of these directions for SU(N).

        Raises
        ------
        ValueError, TypeError
            Another lattice, sizes that do not fit, or spins at places without a moment.

        Examples
        --------
        See `magnetic_structure`.
        """
        if not isinstance(model, SpinModel):
            raise TypeError(f"model is {short(model)}; give a model of co.systems.spins")
        to_magnetic = _in_cells(model.crystal.lattice, self.crystal.lattice)
        if to_magnetic is None:
            raise ValueError(
                f"the lattice vectors {model.crystal.lattice.round(4).tolist()} of the model and "
                f"{self.crystal.lattice.round(4).tolist()} of {self.source} are of no common lattice in one frame; "
                "give a model on the crystal of this structure, or of its paramagnet"
            )
        for axis, (count, periodic) in enumerate(zip(model.size, model.periodic, strict=True)):
            turns = count * to_magnetic[axis]
            if periodic and np.abs(turns - np.round(turns)).max() > 1e-6:
                raise ValueError(
                    f"the model has {count} cells along {'abc'[axis]}, {turns.round(4).tolist()} magnetic cells; give "
                    "whole numbers, or periodic=False there"
                )
        places = (model.cells + model.crystal.positions[model.sites]) @ to_magnetic
        shortest = float(np.linalg.norm(model.crystal.lattice, axis=1).min())
        steps = places[:, None] - self.crystal.positions
        gaps = np.linalg.norm((steps - np.round(steps)) @ self.crystal.lattice, axis=2)
        found = gaps.argmin(axis=1)
        moments = self.moments[found]
        sizes = np.linalg.norm(moments, axis=1)
        bad = np.flatnonzero((gaps.min(axis=1) > NEAR * shortest) | (sizes == 0.0))
        if bad.size:
            raise ValueError(
                f"{self.source} has no moment at spin {bad[0]} of the model, at {places[bad[0]].round(4).tolist()} in "
                "units of the magnetic cell; give a model of the magnetic sites, with the same origin"
            )
        directions = np.asarray((np.sign(model.moments) / sizes)[:, None] * moments)
        return model.coherent(directions) if isinstance(model, CoherentSpinModel) else directions.ravel()


@suggest_keywords
def magnetic_structure(path: str | Path, *, tolerance: float = 1e-3) -> MagneticStructure:
    """Read a magnetic structure from a magnetic CIF, as MAGNDATA, ISODISTORT, GSAS-II and FullProf write it.

    Choose it to start a model in the order that was measured: ``structure.state(model)``. Packages:
    ``coadjoint[crystals]``.

    Parameters
    ----------
    path : str or pathlib.Path
        A file ``.mcif`` of a commensurate structure, with moments along the crystal axes and all magnetic operations.
    tolerance : float
        Largest distance of coinciding sites, in units of the shortest lattice vector.

    Returns
    -------
    MagneticStructure
        With ``crystal``, ``moments`` and ``state(model)``.

    Raises
    ------
    OSError
        The file cannot be read.
    ValueError
        Files of other content, by tag; modulated structures; moments in other coordinates, of unknown sites, or that
        the operations contradict; no operations or no moments; partial occupancy.
    MissingPackageError
        Without ``gemmi``.

    Notes
    -----
    Components are along the lattice vectors a, b, c, in Bohr magnetons. An operation ``x -> W x + w`` with time
    reversal theta = -1 takes a moment m to ``theta det(W) R m``, R the matrix of W in the Cartesian frame.

    References
    ----------
    S. V. Gallego et al., "MAGNDATA: towards a database of magnetic structures", J. Appl. Cryst. 49, 1750 (2016);
    B. J. Campbell et al., "Introducing a unified magnetic space-group symbol", Acta Cryst. A78, 99 (2022).

    Examples
    --------
    A chain with an antiferromagnetic order of twice its period:

    >>> import pathlib, tempfile
    >>> import coadjoint as co
    >>> file = pathlib.Path(tempfile.mkdtemp(), "chain.mcif")
    >>> _ = file.write_text('''data_chain
    ... _cell_length_a 4.0
    ... _cell_length_b 4.0
    ... _cell_length_c 6.0
    ... _cell_angle_alpha 90
    ... _cell_angle_beta 90
    ... _cell_angle_gamma 90
    ... loop_
    ... _space_group_symop_magn_operation.xyz
    ... x,y,z,+1
    ... loop_
    ... _space_group_symop_magn_centering.xyz
    ... x,y,z,+1
    ... x,y,z+1/2,-1
    ... loop_
    ... _atom_site_label
    ... _atom_site_type_symbol
    ... _atom_site_fract_x
    ... _atom_site_fract_y
    ... _atom_site_fract_z
    ... Cu1 Cu 0 0 0
    ... loop_
    ... _atom_site_moment.label
    ... _atom_site_moment.crystalaxis_x
    ... _atom_site_moment.crystalaxis_y
    ... _atom_site_moment.crystalaxis_z
    ... Cu1 0.6(1) 0 0
    ... ''')
    >>> order = co.spins.magnetic_structure(file)
    >>> order
    <2 moments of up to 0.6 mu_B on <crystal of 2 sites in a cell (Cu1 2), 2 operations>>
    >>> chain = co.spins.crystal(lattice=(4, 4, 3, 90, 90, 90), sites={"Cu": (0, 0, 0)}, space_group="P 1")
    >>> order.state(co.systems.spins(chain, (1, 1, 4))).reshape(-1, 3)[:, 0]
    array([ 1., -1.,  1., -1.])
    """
    file, tol = read_path(path, "path"), read_positive(tolerance, "tolerance")
    block = structure_block(file)
    modulated = next((tag for tag in MODULATED if block.find_values(tag) or block.find_value(tag)), None)
    if modulated is not None and block.find_value(modulated) not in ("0", "?", "."):
        raise ValueError(f"{file} is a modulated structure ({modulated}); give a commensurate one in its magnetic cell")
    lattice, sites = cell_of_block(block, file), sites_of_block(block, file)
    operations = _operations(block, file)
    moments = _moments(block, file, {label for label, *_ in sites}, lattice)
    try:
        crystal = expanded_crystal(lattice, sites, operations.spatial, tol)
    except ValueError as reason:
        raise ValueError(f"{file}: {reason}") from None
    turns = rotations_in_space(operations.spatial.rotations, lattice)
    signs = operations.reversal * np.round(np.linalg.det(turns))
    found, known = np.zeros((len(crystal.labels), 3)), np.zeros(len(crystal.labels), dtype=bool)
    largest = max(float(np.linalg.norm(one)) for one in moments.values())
    length = 4.0 * tol * float(np.linalg.norm(lattice, axis=1).min())
    for label, _, place in sites:
        images = (operations.spatial.rotations * place).sum(axis=2) + operations.spatial.translations
        turned = signs[:, None] * (turns @ moments.get(label, np.zeros(3)))
        steps = images[:, None] - crystal.positions
        gaps = np.linalg.norm((steps - np.round(steps)) @ lattice, axis=2)
        for k, (site, gap) in enumerate(zip(gaps.argmin(axis=1).tolist(), gaps.min(axis=1).tolist(), strict=True)):
            if gap > length:
                raise ValueError(f"{file}: the images of {label} are at no site; give more digits, or a tolerance")
            if known[site] and np.linalg.norm(found[site] - turned[k]) > MOMENT * largest:
                raise ValueError(
                    f"{file}: the operations give the site of {label} at {crystal.positions[site].round(4).tolist()} "
                    f"the moments {found[site].round(3).tolist()} and {turned[k].round(3).tolist()}; correct them"
                )
            if not known[site]:
                found[site], known[site] = turned[k], True
    found.flags.writeable = False
    return MagneticStructure(crystal, found, str(file))


class _MagneticOperations(NamedTuple):
    spatial: SymmetryOperations
    reversal: Integers


def _operations(block: Any, file: Path) -> _MagneticOperations:
    """Return the products of the centrings and the operations of a file."""
    import gemmi

    parts = []
    for tags, needed in ((OPERATIONS, True), (CENTRINGS, False)):
        column = next((list(found) for found in map(block.find_values, tags) if found), [] if needed else ["x,y,z,+1"])
        if not column:
            raise ValueError(f"{file} has no magnetic operations, {OPERATIONS[0]}; it must list all of them")
        texts = [gemmi.cif.as_string(text).replace(" ", "") for text in column]
        matches = [re.fullmatch(r"(.+),([+-]?1)", text) for text in texts]
        wrong = next((text for text, match in zip(texts, matches, strict=True) if match is None), None)
        if wrong is not None:
            raise ValueError(f"{file}: {short(wrong)} is no magnetic operation; give x,y,z,+1 or x,y,z,-1")
        operations = operations_of_triplets([match[1] for match in matches if match], str(file))
        parts.append((operations, np.array([int(match[2]) for match in matches if match], dtype=np.int64)))
    (inner, theta), (outer, sign) = parts
    if (outer.rotations != np.eye(3)).any():
        raise ValueError(f"{file} has centrings that turn; {CENTRINGS[0]} are translations")
    count = len(theta) * len(sign)
    spatial = SymmetryOperations(
        np.tile(inner.rotations, (len(sign), 1, 1)),
        (outer.translations[:, None] + inner.translations).reshape(-1, 3),
        f"{count} operations",
    )
    return _MagneticOperations(spatial, (sign[:, None] * theta).ravel())


def _moments(block: Any, file: Path, labels: set[str], lattice: Floats) -> dict[str, Floats]:
    """Return the Cartesian moments of the listed sites."""
    import gemmi

    for prefix in ("_atom_site_moment.", "_atom_site_moment_"):
        rows = block.find(prefix, ["label", *(f"crystalaxis_{axis}" for axis in "xyz")])
        if len(rows):
            break
    else:
        raise ValueError(
            f"{file} has no moments along the crystal axes, _atom_site_moment.crystalaxis_x, _y and _z; write them so"
        )
    units = lattice / np.linalg.norm(lattice, axis=1, keepdims=True)
    found = {}
    for row in rows:
        label = gemmi.cif.as_string(row[0])
        if label not in labels or label in found:
            reason = "no site has" if label not in labels else "is listed twice"
            raise ValueError(f"{file} has a moment of {short(label)}, which {reason}; correct the label")
        components = np.array([cif_number(row[k], f"{file}: a moment of {short(label)}") for k in (1, 2, 3)])
        found[label] = product(components[None, :], units)[0]
    if not any(np.any(one) for one in found.values()):
        raise ValueError(f"{file} has moments that are all zero; give a magnetic structure")
    return found


def _in_cells(lattice: Floats, magnetic: Floats) -> Floats | None:
    """Return lattice vectors in units of magnetic ones, of which either are whole multiples; None for others."""
    wide, narrow = product(magnetic, inverse(lattice)), product(lattice, inverse(magnetic))
    for matrix, invert in ((wide, True), (narrow, False)):
        whole = np.round(matrix)
        if np.abs(matrix - whole).max() <= STRAIN * max(1.0, np.abs(matrix).max()) and np.linalg.det(whole):
            return inverse(whole) if invert else whole
    return None
