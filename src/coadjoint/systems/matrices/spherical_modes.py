"""Spherical harmonics as matrices: the coefficients of a vorticity on the sphere, its matrix W, and the Laplacian.

The vorticity is ``omega = sum over l, m of c_lm Y_lm`` with orthonormal spherical harmonics in the phase convention of
Condon and Shortley; c_l(-m) = (-1)^m conj(c_lm) for a real field. Its matrix is
``W = i S sum of c_lm T_lm`` with ``S^2 = N (N^2 - 1)/(16 pi)``, where tr(T_lm* T_l'm') = 1 or 0:

- T_lm, m >= 0, is real and lies on the diagonal of the entries (i, i + m); i = 0 is the north pole;
- on each diagonal it is an eigenvector of the Hoppe-Yau Laplacian, with the eigenvalue l(l + 1);
- ``T_l(-m) = (-1)^m`` times the transpose of T_lm;
- the coordinates x, y, z of the sphere have the matrices -S_1, -S_2, -S_3 of `generators`.

W is ``(i/hbar)`` times the Hermitian matrix that represents omega, ``hbar = 2/sqrt(N^2 - 1)``, and [P, W] is then the
matrix of ``{psi, omega}`` up to O(1/N^2): ``W' = [P, W]`` is the Euler equation of the unit sphere in physical time,
``d omega/dt + u . grad omega = 0`` with ``u = r x grad psi``, ``laplacian psi = omega``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from math import pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import available, check_available_memory
from coadjoint.short_repr import short
from coadjoint.validation import read_complex

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

MAX_CACHE_BYTES = 2**32
"""Cache size in bytes for matrix harmonics, about N^3/6 numbers for N; beyond it they are recomputed on each use."""


def scale(N: int) -> float:
    """Return S in ``W = i S sum c_lm T_lm``: integrals over the sphere are traces over S^2."""
    return sqrt(N * (N * N - 1) / (16 * pi))


def laplacian(N: int) -> tuple[Floats, Floats]:
    """Return L = -sum_a [S_a, [S_a, .]] by diagonal: ``main[i, m]`` for entry (i, i + m), and couplings `beside`."""
    # The eigenvalues on diagonal m are l(l + 1), l = m, ..., N - 1. J. Hoppe and S.-T. Yau, "Some properties of matrix
    # harmonics on S^2", Comm. Math. Phys. 195, 67 (1998).
    i, m = np.arange(N)[:, None], np.arange(N)[None, :]
    valid = i + m < N
    main = np.where(valid, (N - 1) * (2 * i + 1 + m) - 2 * i * (i + m), 1).astype(float)
    # (i (N - i)) (j (N - j)) with j = i + m is an integer below 2^53, exact for N up to about ten thousand
    product = (i * (N - i)) * ((i + m) * np.maximum(N - i - m, 0))
    return main, -np.sqrt(np.where(valid, product, 0).astype(float))


@lru_cache(maxsize=8)
def generators(N: int) -> tuple[Complexes, Complexes, Complexes]:
    """Return the anti-Hermitian generators S_1, S_2, S_3 of spin (N - 1)/2, with [S_1, S_2] = S_3 and cyclic."""
    s = (N - 1) / 2
    raising = np.diag(np.sqrt(np.arange(1, N) * np.arange(N - 1, 0, -1.0)), 1)
    first, second = (raising + raising.T) / 2, (raising - raising.T) / 2j
    # S_a = -i J_a with [J_1, J_2] = i J_3
    return -1j * first, -1j * second, -1j * np.diag(s - np.arange(N)).astype(complex)


@lru_cache(maxsize=1)
def _cached_orders(N: int) -> dict[int, Floats]:
    """Return the harmonics of the most recent N that are cached, by order."""
    return {}


def _cached_harmonics(N: int, m: int) -> Floats:
    cached = _cached_orders(N)
    entries = cached.get(m)
    if entries is None:
        entries = harmonics(N, m)
        size = sum(others.nbytes for others in tuple(cached.values()))
        if size + entries.nbytes <= MAX_CACHE_BYTES and entries.nbytes < available() // 4:
            cached[m] = entries
    return entries


def harmonics(N: int, m: int) -> Floats:
    """Return the entries (i, i + m) of T_lm as [l - m, i], for i up to the middle; the parity is that of l - m."""
    # The position along the diagonal times T_lm is a sum of its neighbours in l, with positive factors that rise and
    # fall with l. Such a recurrence is stable from either end up to the maximum.
    n, m2 = N - m, m * m
    check_available_memory(24 * n * n, f"the matrix harmonics of order {m} for N = {N}")
    half = n - n // 2
    positions: Floats = np.asarray((n - 1) / 2 - np.arange(half), dtype=np.float64)
    l = np.arange(m + 1, N, dtype=float)
    beside: Floats = np.sqrt((l * l - m2) * (N * N - l * l) / (4 * l * l - 1)) / 2
    peak = int(np.argmax(beside)) if n > 1 else 0
    V = np.empty((n, half))
    V[: peak + 2] = _recurrence(positions, beside[: peak + 1])
    if peak + 2 < n:
        from_above = _recurrence(positions, beside[peak:][::-1])[::-1]
        forward, backward = V[peak : peak + 2], from_above[:2]
        V[peak:] = from_above * (np.sum(forward * backward, axis=0) / np.sum(backward * backward, axis=0))
    # near the north pole T_lm has the sign of (-1)^m
    V *= (-1.0) ** m / np.sqrt(np.sum(V * V, axis=0))
    return V


def _recurrence(positions: Floats, beside: Floats) -> Floats:
    """Return v, one row more than `beside`, with ``position v_k = beside_(k-1) v_(k-1) + beside_k v_(k+1)``."""
    # Columns begin with a positive number, and are scaled so that growing ones end with entries of order 1.
    v = np.ones((len(beside) + 1, len(positions)))
    for k in range(len(beside)):
        np.multiply(positions, v[k], out=v[k + 1])
        if k:
            v[k + 1] -= beside[k - 1] * v[k - 1]
        v[k + 1] /= beside[k]
        if k % 32 == 31 or k == len(beside) - 1:
            size = np.maximum(np.abs(v[k]), np.abs(v[k + 1]))
            large = size > (2.0**300 if k < len(beside) - 1 else 1.0)
            if large.any():
                v[: k + 2, large] /= size[large]
    return v


def diagonal_of(c: Complexes, N: int, m: int) -> Complexes:
    """Return the entries (i, i + m) of sum over l of c_l T_lm, from c of shape (..., N - m)."""
    V, n = _cached_harmonics(N, m), N - m
    even, odd = _times(c[..., ::2], V[::2]), _times(c[..., 1::2], V[1::2])
    return np.concatenate([even + odd, (even - odd)[..., : n // 2][..., ::-1]], axis=-1)


def coefficients_of_diagonal(d: Complexes, N: int, m: int) -> Complexes:
    """Return c of entries (i, i + m); inverse of `diagonal_of`."""
    V, n = _cached_harmonics(N, m), N - m
    half = n - n // 2
    upper, lower = d[..., :half], d[..., ::-1][..., :half]
    total = upper + lower
    if n % 2:
        total[..., -1] /= 2
    c = np.empty(d.shape, dtype=np.complex128)
    c[..., ::2] = _times(total, V[::2].T)
    c[..., 1::2] = _times(upper - lower, V[1::2].T)
    return c


def _times(x: Complexes, T: Floats) -> Complexes:
    products = np.stack([x.real, x.imag]) @ T
    return np.asarray(products[0] + 1j * products[1])


def matrix_of_harmonics(c: Complexes) -> Complexes:
    """Return W, (..., N, N), of coefficients ``c[l, m]``, m >= 0, of a real vorticity; m > l and l = 0 are ignored."""
    N = c.shape[-1]
    factor = 1j * scale(N)
    W = np.zeros(c.shape, dtype=np.complex128)
    for m in range(N):
        column = np.array(c[..., m:, m], dtype=np.complex128)
        if m == 0:
            column.imag, column[..., 0] = 0.0, 0.0
        if not column.any():
            continue
        d, i = factor * diagonal_of(column, N, m), np.arange(N - m)
        W[..., i + m, i] = -np.conj(d)
        W[..., i, i + m] = d
    return W


def harmonics_of_matrix(W: Any) -> Complexes:
    """Return c of W, shape (..., N, N), zero for m > l; inverse of `matrix_of_harmonics`."""
    W = np.asarray(W, dtype=np.complex128)
    N = W.shape[-1]
    factor = -1j / scale(N)
    c = np.zeros(W.shape, dtype=np.complex128)
    for m in range(N):
        c[..., m:, m] = coefficients_of_diagonal(factor * np.diagonal(W, m, -2, -1), N, m)
    c[..., :, 0].imag = 0.0
    c[..., 0, 0] = 0.0
    return c


def read_mode(mode: Any, value: Any, form: str) -> tuple[int, int, complex]:
    """Return the two whole numbers of a mode and its coefficient; TypeError or ValueError with the `form` to give."""
    try:
        first, second = (int(number) for number in mode)
        coefficient = complex(value)
        if (first, second) != tuple(mode):
            raise ValueError
    except (TypeError, ValueError):
        raise TypeError(f"modes has {short(mode)}: {short(value)}; give {form}") from None
    except OverflowError:
        raise ValueError(f"modes has {short(mode)}: {short(value)}, too large for float64; give {form}") from None
    return first, second, coefficient


def read_harmonics(argument: Any, N: int) -> Complexes:
    """Validate a mapping of (l, m) to a coefficient, or an array, and return c (..., N, N) of a real field."""
    if not isinstance(argument, Mapping):
        return _read_array(argument, N)
    c = np.zeros((N, N), dtype=np.complex128)
    for mode, value in argument.items():
        l, m, number = read_mode(mode, value, "(l, m): coefficient")
        if not (0 < l < N and abs(m) <= l and np.isfinite(number)):
            raise ValueError(
                f"mode {short(mode)}: {short(value)}; give a degree l from 1 to {N - 1}, an order m from -l to l, and "
                "a finite coefficient"
            )
        mirrored = (-1) ** m * number.conjugate()
        try:
            conjugate = complex(argument.get((l, -m), mirrored))
        except (TypeError, ValueError, OverflowError):
            continue  # reported at its own key
        if abs(conjugate - mirrored) > 1e-12 * abs(number):
            raise ValueError(
                f"modes ({l}, {m}) and ({l}, {-m}) do not belong to a real vorticity: c_l(-m) = (-1)^m conj(c_lm)"
            )
        c[l, abs(m)] = number if m > 0 else mirrored if m < 0 else number.real
    return c


def _read_array(argument: Any, N: int) -> Complexes:
    c = read_complex(argument, "modes")
    if c.ndim < 2 or c.shape[-2:] != (N, N):
        raise ValueError(
            f"modes has the shape {c.shape}; give a mapping of (l, m) to a coefficient, or (..., {N}, {N})"
        )
    if not np.isfinite(c).all():
        raise ValueError("modes contains NaN or infinity; every coefficient must be finite")
    violation = np.abs(np.where(np.arange(N)[:, None] < np.arange(N), c, 0)).max(initial=0.0)
    violation = max(violation, np.abs(c[..., 0, 0]).max(initial=0.0), np.abs(np.imag(c[..., 0])).max(initial=0.0))
    if violation > 1e-12 * np.abs(c).max(initial=0.0):
        raise ValueError("modes has entries [l, m] with m > l, or [0, 0], or complex ones of m = 0; these must be zero")
    return np.asarray(c, dtype=np.complex128)


def as_mapping(c: Complexes) -> dict[tuple[int, int], complex]:
    """Return coefficients (N, N) as a mapping of (l, m), m from -l to l, without round-off."""
    modes: dict[tuple[int, int], complex] = {}
    for l, m in np.argwhere(np.abs(c) > 1e-14 * np.abs(c).max(initial=0.0)).tolist():
        number = complex(c[l, m])
        if m:
            modes[l, -m] = (-1) ** m * number.conjugate()
        modes[l, m] = number
    return dict(sorted(modes.items()))
