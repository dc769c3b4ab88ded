"""Fourier modes of the torus as matrices, w_n and W = -i N / (4 pi) sum_n w_n T_n, and as values on grids."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.matrices.spherical_modes import read_mode, read_mode_array
from coadjoint.validation import read_finite

Complexes = npt.NDArray[np.complex128]
Floats = npt.NDArray[np.float64]


def representatives(N: int) -> npt.NDArray[np.int64]:
    """Return 0, 1, ..., (N - 1)/2, -(N - 1)/2, ..., -1."""
    n = np.arange(N)
    return np.where(n > N // 2, n - N, n)


def matrix_of_modes(w: Complexes) -> Complexes:
    """Return W of modes w, shape (..., N, N), ``w[n1 mod N, n2 mod N]``."""
    # The entry (a, a + n2) of T_n is exp(2 pi i n1 (n2 + 2 a)/N): a Fourier transform along each cyclic diagonal.
    N = w.shape[-1]
    a, d = np.arange(N)[:, None], np.arange(N)[None, :]
    # sum over n1 of w[n1, d] omega^(n1 (d + 2 a))
    transformed = np.fft.ifft(w, axis=-2) * N
    signed = representatives(N)[None, :]
    W = np.empty_like(transformed)
    W[..., a, (a + d) % N] = transformed[..., (signed + 2 * a) % N, d]
    return -1j * N / (4 * pi) * W


def modes_of_matrix(W: Complexes) -> Complexes:
    """Return the modes w of W; inverse of `matrix_of_modes`."""
    N = W.shape[-1]
    a, d = np.arange(N)[:, None], np.arange(N)[None, :]
    transformed = np.empty_like(W)
    transformed[..., (representatives(N)[None, :] + 2 * a) % N, d] = W[..., a, (a + d) % N]
    return np.fft.fft(transformed, axis=-2) / N / (-1j * N / (4 * pi))


def read_modes(argument: Any, N: int) -> Complexes:
    """Validate modes, a mapping of (n1, n2) to w or an array (..., N, N); missing ones of -n are conjugates."""
    if not isinstance(argument, Mapping):
        return _read_array(argument, N)
    w, half = np.zeros((N, N), dtype=np.complex128), N // 2
    coefficients: dict[tuple[int, int], complex] = {}
    for mode, value in argument.items():
        n1, n2, number = read_mode(mode, value, "(n1, n2): w")
        if max(abs(n1), abs(n2)) > half or (n1, n2) == (0, 0) or not np.isfinite(number):
            raise ValueError(f"mode {short(mode)}: give n1, n2 from {-half} to {half}, not both 0, and a finite w")
        coefficients[n1, n2] = number
    for (n1, n2), number in coefficients.items():
        if abs(coefficients.get((-n1, -n2), number.conjugate()) - number.conjugate()) > 1e-12 * abs(number):
            raise ValueError(
                f"modes ({n1}, {n2}) and ({-n1}, {-n2}) are not conjugate: the vorticity would not be real"
            )
        w[n1, n2], w[-n1, -n2] = number, number.conjugate()
    return w


def _read_array(argument: Any, N: int) -> Complexes:
    w = read_mode_array(argument, N, "(n1, n2)", "w")
    mirrored = np.conj(np.roll(w[..., ::-1, ::-1], 1, (-2, -1)))
    violation = max(np.abs(w - mirrored).max(initial=0.0), np.abs(w[..., 0, 0]).max(initial=0.0))
    if violation > 1e-12 * np.abs(w).max(initial=0.0):
        raise ValueError("modes of n and -n are not conjugate, or that of (0, 0) is not zero; give a real vorticity")
    return w


def coordinates(count: int) -> Floats:
    """Return `count` equally spaced points from 0, without 2 pi."""
    return 2 * pi * np.arange(count) / count


def values_of(w: Complexes, shape: tuple[int, int]) -> Floats:
    """Return the values (..., nx, ny) of ``sum of w_n exp(i (n1 x - n2 y))``, ``w[n1 mod N, n2 mod N]``, on a grid."""
    lead = w.shape[:-2]
    n = representatives(w.shape[-1])
    folded = np.zeros((*lead, *shape), dtype=np.complex128)
    # modes that alias on a coarse grid have the same values there
    indices: Any = np.index_exp[..., (n % shape[0])[:, None], (-n % shape[1])[None, :]]
    np.add.at(folded, indices, w)
    return np.asarray(np.fft.ifft2(folded).real * (shape[0] * shape[1]))


def velocity_of(w: Complexes, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Return the components along x and y of the velocity of a stream function with modes w, (..., N, N), on a grid."""
    n = representatives(w.shape[-1])
    # u = -d psi/dy, v = d psi/dx
    return values_of(1j * n[None, :] * w, shape), values_of(1j * n[:, None] * w, shape)


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
