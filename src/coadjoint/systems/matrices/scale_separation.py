"""Canonical scale separation of a quantized vorticity, without a filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[Any]


def large_scales(P: Matrix, W: Matrix) -> Matrix:
    """Return the part of W, (..., N, N), that commutes with its stream matrix P: its diagonal in an eigenbasis of P.

    In a fluid it is the vorticity averaged along streamlines. With distinct eigenvalues of P it is an orthogonal
    projection. K. Modin, M. Viviani, J. Fluid Mech. 943 (2022) A36.
    """
    _, V = np.linalg.eigh(-1j * P)
    back = np.conj(np.swapaxes(V, -1, -2))
    along = np.einsum("...ji,...jk,...ki->...i", np.conj(V), W, V, optimize=True)
    return np.asarray((V * (1j * along.imag)[..., None, :]) @ back)
