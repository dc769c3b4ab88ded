"""Grids on the torus of side 2 pi: values from Fourier modes, and modes from values."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.systems.matrices.torus_modes import representatives
from coadjoint.validation import read_finite

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


def coordinates(count: int) -> Floats:
    """Return `count` equally spaced points from 0, without 2 pi."""
    return 2 * pi * np.arange(count) / count


def values_of(w: Complexes, shape: tuple[int, int]) -> Floats:
    """Return the values (..., nx, ny) of ``sum of w_n exp(i (n1 x - n2 y))``, ``w[n1 mod N, n2 mod N]``, on a grid."""
    lead = w.shape[:-2]
    check_available_memory(48 * int(np.prod(lead)) * shape[0] * shape[1], f"values on {shape[0]} x {shape[1]} points")
    n = representatives(w.shape[-1])
    folded = np.zeros((*lead, *shape), dtype=np.complex128)
    # modes that alias on a coarse grid have the same values there
    indices: Any = np.index_exp[..., (n % shape[0])[:, None], (-n % shape[1])[None, :]]
    np.add.at(folded, indices, w)
    return np.asarray(np.fft.ifft2(folded).real * (shape[0] * shape[1]))


def modes_of(values: Floats, N: int) -> Complexes:
    """Return w (..., N, N) of values (..., nx, ny), all modes that N and the grid resolve; w[0, 0] is the mean."""
    shape = values.shape[-2:]
    n = representatives(N)
    modes = np.fft.fft2(values) / (shape[0] * shape[1])
    w = modes[..., (n % shape[0])[:, None], (-n % shape[1])[None, :]]
    x, y = (2 * np.abs(n) < count for count in shape)
    return np.where(x[:, None] & y[None, :], w, 0.0)


def delta_coefficients(points: Floats, strengths: Floats, N: int) -> Complexes:
    """Return w (N, N) of a sum of delta functions at points (k, 2) with strengths (k,)."""
    n = representatives(N)
    along = np.exp(-1j * np.multiply.outer(points[:, 0], n)) * strengths[:, None]
    across = np.exp(1j * np.multiply.outer(points[:, 1], n))
    return np.asarray(along.T @ across / (2 * pi) ** 2)


def disc_profile(radius: float, length: Floats) -> Floats:
    """Return the integrals of exp(i n . x) over a disc, from |n|."""
    if not 0.0 < radius < pi:
        raise ValueError(f"a radius is {short(radius)}; give radians below pi")
    from scipy.special import j1

    safe_length = np.where(length > 0.0, length, 1.0)
    return np.where(length > 0.0, 2 * pi * radius * j1(radius * length) / safe_length, pi * radius**2)


def read_places(places: Any, what: str) -> Floats:
    """Validate points x and y, (k, 2)."""
    points = read_finite(places, what)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"{what} has the shape {points.shape}; give (k, 2), x and y in each row")
    return points


def grid_orientation(first: Floats, name: str) -> int:
    """Return 1 for a coordinate increasing in equal steps once around, -1 if decreasing; else raise ValueError."""
    if first.ndim == 1 and len(first) > 1:
        step = 2 * pi / len(first) * (1 if first[-1] > first[0] else -1)
        # coordinates in files may be float32
        if np.abs(first - first[0] - step * np.arange(len(first))).max() <= 1e-5:
            return 1 if step > 0 else -1
    raise ValueError(f"{name} is not equally spaced over 2 pi; give one period without its end point")
