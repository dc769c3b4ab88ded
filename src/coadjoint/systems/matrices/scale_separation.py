"""What of a quantized vorticity is steady where it is? Its large scales, without a filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[Any]


def large_scales(P: Matrix, W: Matrix) -> Matrix:
    """Return the part of W that commutes with its stream matrix P: the diagonal of W in a basis of eigenvectors of P.

    In a fluid it is the vorticity averaged along streamlines. After a while it holds the large vortices, and what is
    left of W, ``W - large_scales(P, W)``, their fine grain.

    Parameters
    ----------
    P, W : (..., N, N) array
        Skew-Hermitian.

    Returns
    -------
    (..., N, N) array
        The orthogonal projection of W to the matrices that commute with P, if the eigenvalues of P are distinct.

    References
    ----------
    K. Modin, M. Viviani, "Canonical scale separation in two-dimensional incompressible hydrodynamics", J. Fluid Mech.
    943 (2022) A36.

    Examples
    --------
    >>> P, W = np.diag([1j, 2j, -3j]), np.array([[1j, 2, 0], [-2, 1j, 0], [0, 0, -2j]])
    >>> bool(np.abs(large_scales(P, W) - np.diag([1j, 1j, -2j])).max() < 1e-15)
    True
    """
    _, V = np.linalg.eigh(-1j * P)
    back = np.conj(np.swapaxes(V, -1, -2))
    along = np.einsum("...ji,...jk,...ki->...i", np.conj(V), W, V, optimize=True)
    return np.asarray((V * (1j * along.imag)[..., None, :]) @ back)
