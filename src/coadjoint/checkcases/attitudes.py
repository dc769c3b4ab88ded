"""Columns of rates and attitudes from the states of bodies, and rotations of these columns."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from coadjoint.checkcases.check_case import ATTITUDE, RATES, BodyModel, Columns, DerivedQuantity
from coadjoint.systems.bodies.rigid_body import rigid_body

Floats = npt.NDArray[np.float64]


def stacked(columns: Mapping[str, Any], names: tuple[str, ...]) -> Floats:
    """Return columns side by side, (k, n)."""
    return np.column_stack([np.asarray(columns[name], dtype=np.float64) for name in names])


def rotations_of(columns: Mapping[str, Any], names: tuple[str, ...] = ATTITUDE.columns) -> Rotation:
    """Return the rotations of quaternions in columns, scalar first."""
    return Rotation.from_quat(np.roll(stacked(columns, names), -1, axis=1))


def quaternions(rotations: Rotation) -> Floats:
    """Return unit quaternions with qw >= 0, (k, 4), scalar first."""
    return np.roll(rotations.as_quat(canonical=True), 1, axis=-1)


def body_columns(rates: Floats, attitudes: Rotation, suffix: str = "") -> Columns:
    """Return the columns of a body from its rates (k, 3) and k attitudes."""
    names = [f"{name}{suffix}" for name in (*RATES.columns, *ATTITUDE.columns)]
    return dict(zip(names, np.column_stack([rates, quaternions(attitudes)]).T.copy(), strict=True))


def state_columns(rates: Floats, x: Floats) -> Columns:
    """Return the columns of a body from its rates and states (L, X, Y, Z) of the library, (k, 12)."""
    return body_columns(rates, Rotation.from_matrix(x[:, 3:12].reshape(-1, 3, 3)))


def as_tensor(inertia: npt.ArrayLike) -> Floats:
    """Return an inertia tensor, (3, 3), from moments or a tensor."""
    array = np.asarray(inertia, dtype=np.float64)
    return np.diag(array) if array.ndim == 1 else array


def free_columns(inertia: Floats, rates: Floats, times: Floats) -> Columns:
    """Return the closed form of a free body from the attitude of space."""
    moving = rigid_body(np.diag(inertia) if np.array_equal(inertia, np.diag(np.diag(inertia))) else inertia)
    x, A = moving.exact(inertia @ rates, times, attitude=True)
    return body_columns(np.linalg.solve(inertia, x.T).T, Rotation.from_matrix(A))


def body_invariants(body: BodyModel) -> tuple[DerivedQuantity, ...]:
    """Return the energy of a body and its angular momentum in space."""

    def energy(columns: Mapping[str, Floats]) -> Floats:
        w = stacked(columns, RATES.columns)
        kinetic = 0.5 * np.einsum("ki,ij,kj->k", w, body.inertia, w)
        return kinetic if body.potential is None else kinetic + body.potential(rotations_of(columns).as_matrix())

    def momentum(columns: Mapping[str, Floats]) -> Floats:
        L = stacked(columns, RATES.columns) @ body.inertia + body.rotors
        return rotations_of(columns).apply(L)

    both = ("rates", "attitude")
    return (
        DerivedQuantity("energy", "J", energy, ("rates",) if body.potential is None else both),
        DerivedQuantity("momentum in space", "kg m^2/s", momentum, both),
    )
