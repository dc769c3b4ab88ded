"""Constant components of the total spin of a spin lattice."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.quadratic import Quadratic

Floats = npt.NDArray[np.float64]

MAX_DENSE_SQUARE = 64  # largest number of spins for which the dense |sum S|^2 is given
# The total spin along n generates rotations of all spins about n; (turn_k)_ab = -eps_kab generates those about axis k.
ROTATION_GENERATORS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)


def total_spins(sites: int, T: Floats, D: Floats, K: Floats, B: Floats, uniform: bool | None) -> dict[str, Any]:
    """Return the constant components of the total spin, or its square, as `Quadratic` by name.

    T, K (..., 3, 3) are tensors of exchange and of sites, D, B (..., 3) Dzyaloshinskii-Moriya vectors and fields;
    `uniform` is whether a time-dependent field in place of B is equal at all sites, None without such a field.

    Examples
    --------
    >>> z = np.zeros(3)
    >>> list(total_spins(2, np.eye(3), z, 0 * np.eye(3), z, None))
    ['total S1', 'total S2', 'total S3']
    >>> list(total_spins(2, np.eye(3), z, 0 * np.eye(3), np.array([0.0, 2.0, 0.0]), None))
    ['total S2', '|total S|^2']
    """
    inside = np.concatenate([_of_tensors(T), _of_tensors(K), _of_vectors(D)])
    isotropic = not np.any(inside)
    alike = bool(np.all(B == B.reshape(-1, 3)[0])) if uniform is None else uniform
    found: dict[str, Any] = {}
    if uniform is None:
        for axis in _kernel(np.concatenate([inside, _of_vectors(B)])):
            known = np.flatnonzero(axis)
            name = f"S{known[0] + 1}" if len(known) == 1 else f"S along ({', '.join(f'{a:.6g}' for a in axis)})"
            found[f"total {name}"] = Quadratic(np.zeros(3 * sites), linear=np.tile(axis, sites))
    if isotropic and alike and len(found) < 3 and sites <= MAX_DENSE_SQUARE:
        found["|total S|^2"] = Quadratic(np.kron(np.full((sites, sites), 2.0), np.eye(3)))
    return found


def _of_tensors(tensors: Floats) -> Floats:
    """Return rows r with r . n = 0 if all tensors commute with the rotation about n."""
    different = np.unique(tensors.reshape(-1, 9), axis=0).reshape(-1, 3, 3)
    commutators = np.einsum("eab,kbc->eack", different, ROTATION_GENERATORS) - np.einsum(
        "kab,ebc->eack", ROTATION_GENERATORS, different
    )
    return _different(commutators.reshape(-1, 3))


def _of_vectors(vectors: Floats) -> Floats:
    """Return rows r with r . n = 0 if all vectors are parallel to n."""
    return _different(
        np.einsum("kab,eb->eak", ROTATION_GENERATORS, np.unique(vectors.reshape(-1, 3), axis=0)).reshape(-1, 3)
    )


def _different(rows: Floats) -> Floats:
    return np.unique(rows[np.any(rows, axis=1)], axis=0)


def _kernel(rows: Floats) -> Floats:
    """Return the axes orthogonal to all rows: three, one (with largest entry 1), or none.

    There are never two: rotations about two axes generate those about all.
    """
    if not len(rows):
        return np.eye(3)
    with np.errstate(over="ignore", under="ignore"):
        units = rows / np.abs(rows).max(axis=1, keepdims=True)
        crosses = np.cross(units[0], units)
        axis = crosses[np.argmax(np.abs(crosses).max(axis=1))]
        size = np.abs(axis).max()
        if size == 0.0:
            return np.zeros((0, 3))
        axis = axis / axis[np.argmax(np.abs(axis))]
        kept = np.abs(units @ axis).max() <= 16 * UNIT_ROUNDOFF / min(size, 1.0)
    return axis[None] + 0.0 if kept else np.zeros((0, 3))
