"""Closed-form precession of spins about their total spin."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.closed_forms.closed_form import check_finite_states, reject_attitude, start_and_times

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
    strengths = np.unique(J * T[..., 0, 0])
    complete = 2 * len(edges) == sites * (sites - 1)
    alike = np.all(B == B.reshape(-1, 3)[0])
    if np.any(T != T[..., :1, :1] * np.eye(3)) or len(strengths) > 1 or not (complete and alike):
        return None
    return partial(_precess, sites, float(strengths[0]), B)


def _precess(sites: int, strength: float, B: Floats, x0: Any, t: Any, attitude: Any = False) -> Floats:
    """Rotate all spins about their total, ``S_i' = strength S_i cross S``, and the total about the field."""
    reject_attitude(attitude, "spin_lattice")
    start, times = start_and_times(x0, t, 3 * sites)
    spins = start.reshape(sites, 3)
    with np.errstate(over="ignore", invalid="ignore"):
        about_total = turned(spins, strength * spins.sum(axis=0), times[..., None])
        about_field = turned(about_total, B, times[..., None])
    return check_finite_states(about_field.reshape(*times.shape, 3 * sites), start, times)


def turned(spins: Floats, axis: Floats, t: Floats) -> Floats:
    """Return the solution of ``S' = S cross axis`` at time t."""
    rate = np.sqrt(np.sum(axis**2, axis=-1))
    unit = axis / np.where(rate > 0.0, rate, 1.0)[..., None]
    angle = (rate * t)[..., None]
    across = spins - unit * np.sum(unit * spins, axis=-1, keepdims=True)
    return spins + np.sin(angle) * np.cross(spins, unit) - 2.0 * np.sin(angle / 2) ** 2 * across
