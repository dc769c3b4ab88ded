"""The Hoppe-Yau Laplacian of the quantized sphere as tridiagonal matrices by diagonal, and the spin generators."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


def laplacian(N: int) -> tuple[Floats, Floats]:
    """Return L = -sum_a [S_a, [S_a, .]] by diagonal: ``main[i, m]`` for the entry (i, i + m), and couplings `beside`.

    Both are (N, N), as in `streams.DiagonalSolve`; the eigenvalues on diagonal m are l(l + 1), l = m, ..., N - 1.
    J. Hoppe and S.-T. Yau, "Some properties of matrix harmonics on S^2", Comm. Math. Phys. 195, 67 (1998).

    Examples
    --------
    >>> main, beside = laplacian(2)
    >>> main[:, 0].tolist(), float(beside[1, 0]), float(main[0, 1])
    ([1.0, 1.0], -1.0, 2.0)
    """
    i, m = np.arange(N)[:, None], np.arange(N)[None, :]
    inside = i + m < N
    main = np.where(inside, (N - 1) * (2 * i + 1 + m) - 2 * i * (i + m), 1).astype(float)
    # (i (N - i)) (j (N - j)) with j = i + m is an integer below 2^53, exact for N up to about ten thousand
    product = (i * (N - i)) * ((i + m) * np.maximum(N - i - m, 0))
    return main, -np.sqrt(np.where(inside, product, 0).astype(float))


@lru_cache(maxsize=8)
def generators(N: int) -> tuple[Complexes, Complexes, Complexes]:
    """Return the anti-Hermitian generators S_1, S_2, S_3 of spin (N - 1)/2, with [S_1, S_2] = S_3 and cyclic."""
    s = (N - 1) / 2
    raising = np.diag(np.sqrt(np.arange(1, N) * np.arange(N - 1, 0, -1.0)), 1)
    first, second = (raising + raising.T) / 2, (raising - raising.T) / 2j
    # S_a = -i J_a with [J_1, J_2] = i J_3
    return -1j * first, -1j * second, -1j * np.diag(s - np.arange(N)).astype(complex)
