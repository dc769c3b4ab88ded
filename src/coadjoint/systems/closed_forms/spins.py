"""Spin lattices: closed-form precession about the total spin, and constant components of the total spin."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.closed_forms.closed_form import check_finite_states, reject_attitude, start_and_times
from coadjoint.systems.hamiltonians.quadratic import Quadratic

Floats = npt.NDArray[np.float64]


def precession(
    sites: int, edges: npt.NDArray[np.int64], J: Floats, T: Floats, K: Floats, B: Floats
) -> Callable[..., Any] | None:
    """Return the closed form ``exact(x0, t, attitude)`` of spins without Dzyaloshinskii-Moriya coupling, or None.

    J is () or (edges,), B (3,) or (sites, 3); T, K (..., 3, 3) are tensors of exchange (zero if uncoupled) and sites.
    """
    if np.any(K != K[..., :1, :1] * np.eye(3)):
        return None
    if not np.any(T):
        return partial(_precess, sites, 0.0, B)
    complete = 2 * len(edges) == sites * (sites - 1)
    if not complete:
        return None
    strengths = np.unique(J * T[..., 0, 0])
    is_uniform = np.all(B == B.reshape(-1, 3)[0])
    if np.any(T != T[..., :1, :1] * np.eye(3)) or len(strengths) > 1 or not is_uniform:
        return None
    return partial(_precess, sites, float(strengths[0]), B)


def _precess(sites: int, strength: float, B: Floats, x0: Any, t: Any, attitude: Any = False) -> Floats:
    """Rotate all spins about their total, ``S_i' = strength S_i cross S``, and the total about the field."""
    reject_attitude(attitude, "spin_lattice")
    start, times = start_and_times(x0, t, 3 * sites)
    spins = start.reshape(sites, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        about_total = rotate_about(spins, strength * spins.sum(axis=0), times[..., None])
        about_field = rotate_about(about_total, B, times[..., None])
    return check_finite_states(about_field.reshape(*times.shape, 3 * sites), start, times)


def rotate_about(spins: Floats, axis: Floats, t: Floats) -> Floats:
    """Rotate spins about an axis: the solution of ``S' = S cross axis`` at time t."""
    rate = np.sqrt(np.sum(axis**2, axis=-1))
    direction = axis / np.where(rate > 0.0, rate, 1.0)[..., None]
    angle = (rate * t)[..., None]
    across = spins - direction * np.sum(direction * spins, axis=-1, keepdims=True)
    return spins + np.sin(angle) * np.cross(spins, direction) - 2.0 * np.sin(angle / 2) ** 2 * across


MAX_DENSE_SQUARE = 64  # largest number of spins for which the dense |sum S|^2 is given
# The total spin along n generates rotations of all spins about n; (turn_k)_ab = -eps_kab generates those about axis k.
ROTATION_GENERATORS = np.array(
    [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
)


def total_spins(
    sites: int, T: Floats, D: Floats, K: Floats, B: Floats, uniform: bool | None
) -> dict[str, Callable[[], Quadratic]]:
    """Return the constant components of the total spin, or its square, by name as functions that make them."""
    # T, K (..., 3, 3) are tensors of exchange and of sites, D, B (..., 3) Dzyaloshinskii-Moriya vectors and fields;
    # `uniform` is whether a time-dependent field in place of B is equal at all sites, None without such a field.
    constraints = np.concatenate([_tensor_constraints(T), _tensor_constraints(K), _vector_constraints(D)])
    isotropic = not np.any(constraints)
    is_uniform = bool(np.all(B == B.reshape(-1, 3)[0])) if uniform is None else uniform
    integrals: dict[str, Callable[[], Quadratic]] = {}
    if uniform is None:
        for axis in _kernel(np.concatenate([constraints, _vector_constraints(B)])):
            nonzero = np.flatnonzero(axis)
            name = f"S{nonzero[0] + 1}" if len(nonzero) == 1 else f"S along ({', '.join(f'{a:.6g}' for a in axis)})"
            integrals[f"total {name}"] = partial(_total_along, sites, axis)
    if isotropic and is_uniform and len(integrals) < 3 and sites <= MAX_DENSE_SQUARE:
        integrals["|total S|^2"] = partial(_total_squared, sites)
    return integrals


def _total_along(sites: int, axis: Floats) -> Quadratic:
    return Quadratic(np.zeros(3 * sites), linear=np.tile(axis, sites))


def _total_squared(sites: int) -> Quadratic:
    return Quadratic(np.kron(np.full((sites, sites), 2.0), np.eye(3)))


def _tensor_constraints(tensors: Floats) -> Floats:
    """Return rows r with r . n = 0 if all tensors commute with the rotation about n."""
    different = np.unique(tensors.reshape(-1, 9), axis=0).reshape(-1, 3, 3)
    commutators = np.einsum("eab,kbc->eack", different, ROTATION_GENERATORS) - np.einsum(
        "kab,ebc->eack", ROTATION_GENERATORS, different
    )
    return _unique_nonzero(commutators.reshape(-1, 3))


def _vector_constraints(vectors: Floats) -> Floats:
    """Return rows r with r . n = 0 if all vectors are parallel to n."""
    return _unique_nonzero(
        np.einsum("kab,eb->eak", ROTATION_GENERATORS, np.unique(vectors.reshape(-1, 3), axis=0)).reshape(-1, 3)
    )


def _unique_nonzero(rows: Floats) -> Floats:
    return np.unique(rows[np.any(rows, axis=1)], axis=0)


def _kernel(rows: Floats) -> Floats:
    """Return the axes orthogonal to all rows: three, one (with largest entry 1), or none."""
    # There are never two: rotations about two axes generate those about all.
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
        is_orthogonal = np.abs(units @ axis).max() <= 16 * UNIT_ROUNDOFF / min(size, 1.0)
    return axis[None] + 0.0 if is_orthogonal else np.zeros((0, 3))
