"""Fourier modes of the torus as matrices: w_n and W = -i N / (4 pi) sum_n w_n T_n."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.validation import read_complex, read_mode

Complexes = npt.NDArray[np.complex128]


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
    w = read_complex(argument, "modes")
    if w.ndim < 2 or w.shape[-2:] != (N, N):
        raise ValueError(f"modes has the shape {w.shape}; give a mapping of (n1, n2) to w, or (..., {N}, {N})")
    if not np.isfinite(w).all():
        raise ValueError("modes contains NaN or infinity; every w must be finite")
    mirrored = np.conj(np.roll(w[..., ::-1, ::-1], 1, (-2, -1)))
    violation = max(np.abs(w - mirrored).max(initial=0.0), np.abs(w[..., 0, 0]).max(initial=0.0))
    if violation > 1e-12 * np.abs(w).max(initial=0.0):
        raise ValueError("modes of n and -n are not conjugate, or that of (0, 0) is not zero; give a real vorticity")
    return np.asarray(w, dtype=np.complex128)
