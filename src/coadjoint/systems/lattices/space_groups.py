"""Operations of space groups: by name or number (gemmi), of a structure (spglib), and their rotations in space."""

from __future__ import annotations

import math
import warnings
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_OPERATIONS = 1000
EXACT_ENTRIES = np.array([0.0, 0.5, math.sqrt(0.75), 1.0])  # of rotations by 60 and 90 degrees about axes of the frame


class SymmetryOperations(NamedTuple):
    """Operations x -> W x + w on fractional coordinates, with centring translations, and their name."""

    rotations: Integers
    translations: Floats
    name: str


def product(a: npt.NDArray[Any], b: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a b for small matrices, without BLAS, whose last bits differ between machines."""
    return np.asarray((a[..., :, :, None] * b[..., None, :, :]).sum(axis=-2))


def inverse(a: Floats) -> Floats:
    """Return the inverse of 3 x 3 matrices by cofactors."""
    rows = np.stack([np.cross(a[..., (i + 1) % 3, :], a[..., (i + 2) % 3, :]) for i in range(3)], axis=-1)
    return np.asarray(rows / (a[..., 0, :] * rows[..., :, 0]).sum(axis=-1)[..., None, None])


def cosine(degrees: float) -> float:
    """Return the cosine of an angle between 0 and 180 degrees, with the same bits on every machine."""
    if degrees > 90.0:
        return -cosine(180.0 - degrees)
    if degrees in (60.0, 90.0):
        return 0.5 if degrees == 60.0 else 0.0
    square, total = -((degrees * (math.pi / 180.0)) ** 2), 0.0
    for k in range(26, 0, -2):
        total = (1.0 + total) * square / (k * (k - 1))
    return 1.0 + total


def fits(rotations: Integers, lattice: Floats, tolerance: float) -> npt.NDArray[np.bool_]:
    """Return which rotations preserve the lengths and angles of a lattice, to a relative tolerance."""
    metric = product(lattice, lattice.T)
    W = rotations.astype(np.float64)
    turned = product(product(W.swapaxes(-1, -2), metric), W)
    return np.asarray(np.abs(turned - metric).max(axis=(-1, -2)) <= 4.0 * tolerance * np.abs(metric).max())


def rotations_in_space(rotations: Integers, lattice: Floats) -> Floats:
    """Return the orthogonal matrices of rotations given in fractional coordinates."""
    R = product(product(lattice.T, rotations.astype(np.float64)), inverse(lattice.T))
    for _ in range(6):  # Newton's iteration for the nearest orthogonal matrix
        R = 0.5 * (R + inverse(R).swapaxes(-1, -2))
    size = np.abs(R)
    nearest = EXACT_ENTRIES[np.abs(size[..., None] - EXACT_ENTRIES).argmin(axis=-1)]
    return np.where(np.abs(size - nearest) < 1e-12, np.copysign(nearest, R) + 0.0, R)


def operations_of_triplets(triplets: list[str], what: str) -> SymmetryOperations:
    """Return operations given as coordinate triplets, such as ``-y,x-y,z+1/2``."""
    import gemmi

    if len(triplets) > MAX_OPERATIONS:
        raise ValueError(f"{what} has {len(triplets)} symmetry operations; at most {MAX_OPERATIONS} are read")
    found = []
    for triplet in triplets:
        try:
            found.append(gemmi.Op(triplet))
        except Exception as reason:
            raise ValueError(f"{what}: {short(triplet)} is no symmetry operation ({reason}); give x,y,z") from None
    operations = _operations(found, what, f"{len(found)} operations")
    whole = (operations.rotations == np.eye(3)).all(axis=(1, 2)) & (operations.translations % 1.0 == 0.0).all(axis=1)
    if not whole.any():
        raise ValueError(f"{what} lists symmetry operations without x,y,z; it must list all of them")
    return operations


def _operations(found: list[Any], what: str, name: str) -> SymmetryOperations:
    parts = np.array([op.rot for op in found], dtype=np.int64)
    whole = parts // 24
    det = np.round(np.linalg.det(whole.astype(np.float64)))
    wrong = np.flatnonzero(
        (parts != 24 * whole).any(axis=(1, 2)) | (np.abs(whole) > 1).any(axis=(1, 2)) | (abs(det) != 1)
    )
    if wrong.size:
        raise ValueError(f"{what}: {found[wrong[0]].triplet()} is no symmetry operation; it deforms the lattice")
    return SymmetryOperations(whole, np.array([op.tran for op in found], dtype=np.float64) / 24.0, name)


def operations_by_name(space_group: Any, lattice: Floats, tolerance: float, what: str) -> SymmetryOperations:
    """Return the operations of a space group given by number or Hermann-Mauguin symbol, in the setting of a lattice."""
    require_packages(f"a space group ({what})", "gemmi")
    import gemmi

    if isinstance(space_group, str):
        found = gemmi.find_spacegroup_by_name(space_group)
        if found is None:
            raise ValueError(
                f"{what} is {short(space_group)}, no known symbol; give one such as 'P -3 m 1' or 'F d -3 m:2'"
            )
        chosen = ":" in space_group
        settings = [found] if chosen else [s for s in gemmi.spacegroup_table() if s.hm == found.hm]
    elif type(space_group) is int and 1 <= space_group <= 230:
        settings = [s for s in gemmi.spacegroup_table() if s.number == space_group]
    else:
        raise ValueError(f"{what} is {short(space_group)}; give a number from 1 to 230, or a symbol such as 'P -3 m 1'")
    groups = [_operations(list(s.operations()), what, f"{s.xhm()} ({s.number})") for s in settings]
    fitting = [group for group in groups if fits(group.rotations, lattice, tolerance).all()]
    if not fitting:
        raise ValueError(
            f"{what} is {short(space_group)}, whose rotations do not preserve the lattice; correct its lengths and "
            "angles, or give the symbol of another setting"
        )
    if len(fitting) > 1:
        names = ", ".join(repr(group.name.rsplit(" (", 1)[0]) for group in fitting[:12])
        raise ValueError(
            f"{what} is {short(space_group)}, which has several settings on this lattice; give one of {names}"
        )
    return fitting[0]


def operations_found(lattice: Floats, positions: Floats, kinds: list[int], tolerance: float) -> SymmetryOperations:
    """Return the symmetry operations of a structure, found by spglib, to a tolerance of its shortest vector."""
    require_packages("the symmetry of a crystal without a given space group", "spglib")
    import spglib.error

    unit = lattice / np.sqrt((lattice**2).sum(axis=1)).min()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of its own way to report errors, in every call
        try:
            data = spglib.get_symmetry_dataset((unit.tolist(), positions.tolist(), kinds), symprec=tolerance)
        except spglib.error.SpglibError:  # where users select it in place of None
            data = None
    if data is None:
        raise ValueError("spglib finds no symmetry of this structure; correct its sites, or give space_group=")
    rotations = np.asarray(data.rotations, dtype=np.int64)
    return SymmetryOperations(
        rotations, np.asarray(data.translations, np.float64), f"{data.international} ({data.number})"
    )
