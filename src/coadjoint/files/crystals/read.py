"""Crystals as users give them: a file, or a lattice and its sites."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.files.crystals.cif import crystal_of_cif
from coadjoint.files.crystals.poscar import crystal_of_poscar
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.lattices.crystals import Crystal, expanded_crystal
from coadjoint.systems.lattices.lattice_vectors import lattice_of
from coadjoint.systems.lattices.space_groups import operations_by_name
from coadjoint.validation import read_choice, read_finite, read_path, read_positive


@suggest_keywords
def crystal(
    path: str | Path | None = None,
    *,
    lattice: npt.ArrayLike | None = None,
    sites: Mapping[str, Any] | None = None,
    space_group: str | int | None = None,
    tolerance: float = 1e-3,
) -> Crystal:
    """Return a crystal from a CIF, a POSCAR, or a lattice and its sites.

    Choose it for spins on the sites of a real structure: `Crystal.bonds` lists bonds by shell, and a bond gives the
    exchange matrices that symmetry allows, and those of all equivalent bonds.

    Parameters
    ----------
    path : str or pathlib.Path, optional
        A file ``.cif``, or one of VASP: ``.vasp``, ``.poscar``, or a name that begins with POSCAR or CONTCAR. Lengths
        are in angstroms. Either a file or `lattice` and `sites`.
    lattice : (6,) or (3, 3) array_like, optional
        Lengths a, b, c in any unit and angles alpha, beta, gamma in degrees; or the lattice vectors as rows. Of the
        former, a is along x and b in the plane of x and y.
    sites : mapping, optional
        Label -> fractional coordinates, of one site (3,) or several (k, 3). Without `space_group` all sites of the
        cell, and with it one of each orbit. Sites of one label are of one kind.
    space_group : str or int, optional
        Hermann-Mauguin symbol, such as ``"P -3 m 1"``, with the origin where there are two (``"F d -3 m:2"``), or a
        number from 1 to 230 where this is unique on the lattice. By default the operations that a CIF lists; spglib
        finds those of typed sites, of POSCAR, and of a CIF whose only operation is x,y,z. Of a POSCAR, which lists all
        sites, it is only their symmetry. ``"P 1"`` is no symmetry.
    tolerance : float
        Largest distance of coinciding sites, in units of the shortest lattice vector. Sites this close to special
        positions of a given space group are moved there.

    Returns
    -------
    Crystal
        With ``lattice``, ``labels``, ``positions``, ``space_group``, ``bonds(max_distance)`` and
        ``subcrystal(*labels)``.

    Raises
    ------
    OSError
        The file cannot be read.
    TypeError, ValueError
        Unknown files, files of other content, by line or tag; partial occupancy; a magnetic CIF; a space group that
        does not fit the lattice, has several settings, or makes sites collide; a site that is given twice.
    MissingPackageError
        A CIF or a space group without ``gemmi``, or no space group without ``spglib``.

    Notes
    -----
    The magnetic order is not part of a crystal: the symmetry is that of the paramagnet. Without ligands a structure may
    have more symmetry than the material; give all atoms, and keep those with spins by ``subcrystal``.

    References
    ----------
    S. R. Hall, F. H. Allen, I. D. Brown, "The crystallographic information file", Acta Cryst. A47, 655 (1991); A. Togo,
    K. Shinohara, I. Tanaka, "Spglib", Sci. Technol. Adv. Mater. Methods 4, 2384822 (2024); M. Wojdyr, "GEMMI", J. Open
    Source Softw. 7, 4200 (2022).

    Examples
    --------
    >>> import coadjoint as co
    >>> sites = {"Fe": (0, 0, 0), "I": (1 / 3, 2 / 3, 0.249)}
    >>> whole = co.spins.crystal(lattice=(4.05, 4.05, 6.75, 90, 90, 120), sites=sites, space_group="P -3 m 1")
    >>> whole
    <crystal of 3 sites in a cell (Fe 1, I 2), P -3 m 1 (164)>
    >>> print(whole.subcrystal("Fe").bonds(max_distance=7)["1"])
    bond 1: Fe 0 to Fe 0 at offset (1, 0, 0), length 4.05, 3 in a cell, 6 at Fe 0
    allowed exchange:
      [ A  0  0 ]
      [ 0  B  D ]
      [ 0  D  C ]
    allowed Dzyaloshinskii-Moriya vector: (0, 0, 0)
    """
    tol = read_positive(tolerance, "tolerance")
    if tol > 0.05:
        raise ValueError(f"tolerance is {tol:.6g}; give at most 0.05 of the shortest lattice vector")
    if path is not None:
        file = read_path(path, "path")
        for name, value in (("lattice", lattice), ("sites", sites)):
            if value is not None:
                raise ValueError(f"{name} was given beside the file {short(str(file))}, which has it; give one of them")
        return _crystal_of_file(file, space_group, tol)
    if lattice is None or sites is None:
        raise ValueError("a crystal needs a file, or lattice= and sites=; give crystal('FeI2.cif'), or both of them")
    vectors = lattice_of(lattice, "lattice")
    operations = None if space_group is None else operations_by_name(space_group, vectors, tol, "space_group")
    return expanded_crystal(vectors, _read_sites(sites), operations, tol)


STRUCTURES = Path(__file__).parent / "structures"


@suggest_keywords
def structure(name: str) -> Path:
    """Return the path of a structure file of the package, a CIF.

    Choose it to try a model on a known crystal, and as a template of CIF.

    Parameters
    ----------
    name : {"CsNiF3", "FeI2", "MnF2", "RbMnF3"}
        CsNiF3: ferromagnetic chains; FeI2: triangular layers of easy-axis spins; MnF2: an easy-axis antiferromagnet;
        RbMnF3: a simple cubic one. The files name the sources of their cell constants.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    ValueError, TypeError
        An unknown name.

    Examples
    --------
    >>> import coadjoint as co
    >>> co.spins.crystal(co.spins.structure("MnF2"))
    <crystal of 6 sites in a cell (Mn 2, F 4), P 42/m n m (136)>
    """
    known = {file.stem: file for file in sorted(STRUCTURES.glob("*.cif"))}
    return known[read_choice(name, "structure", known)]


def _read_sites(sites: Any) -> list[tuple[str, str, npt.NDArray[np.float64]]]:
    if not isinstance(sites, Mapping):
        raise TypeError(f"sites is {short(sites)}; give a mapping such as {{'Fe': (0, 0, 0)}}")
    found = []
    for label, value in sites.items():
        if not isinstance(label, str) or not label.isprintable() or not 0 < len(label) <= 40 or " " in label:
            raise ValueError(f"sites has the label {short(label)}; give text without blanks of at most 40 letters")
        positions = read_finite(value, f"sites[{short(label)}]")
        if positions.ndim not in (1, 2) or positions.shape[-1] != 3 or not np.all(np.abs(positions) < 1e6):
            raise ValueError(f"sites[{short(label)}] is {short(value)}; give fractional coordinates, (3,) or (k, 3)")
        found += [(label, label, position) for position in positions.reshape(-1, 3)]
    return found


def _crystal_of_file(file: Path, space_group: Any, tolerance: float) -> Crystal:
    if file.suffix.lower() == ".cif":
        return crystal_of_cif(file, space_group, tolerance)
    if file.suffix.lower() in (".vasp", ".poscar") or file.name.upper().startswith(("POSCAR", "CONTCAR")):
        return crystal_of_poscar(file, space_group, tolerance)
    if file.suffix.lower() == ".mcif":
        raise ValueError(
            f"{file} is a magnetic CIF, whose moments would be lost; give it to co.spins.magnetic_structure, or a CIF "
            "without them"
        )
    raise ValueError(f"{file} has no name of a structure; give .cif, .vasp, .poscar, POSCAR... or CONTCAR...")
