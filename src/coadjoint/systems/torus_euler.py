"""Ideal fluids on the torus by the sine bracket: Zeitlin's model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.matrix_states import MatrixAlgebra
from coadjoint.given import read_whole
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.streams import Circulants
from coadjoint.systems.matrices.torus_modes import matrix_of_modes, modes_of_matrix, read_modes, representatives
from coadjoint.systems.ready_made import ready_made

LARGEST = 1001
Matrix = npt.NDArray[np.complex128]


class TorusEuler(MatrixSystem):
    """A fluid on the torus, with the way from Fourier modes of the vorticity to matrices and back."""

    def from_modes(self, modes: Mapping[tuple[int, int], complex]) -> Matrix:
        """Return the matrix W of modes.

        Parameters
        ----------
        modes : mapping
            ``(n1, n2) -> w``, from -(N - 1)/2 to (N - 1)/2; those that are missing are conjugates, or zero.

        Returns
        -------
        (N, N) array

        Examples
        --------
        >>> s = torus_euler(N=5)
        >>> bool(abs(s.modes(s.from_modes({(1, 2): 0.5 - 1j}))[-1, -2] - (0.5 + 1j)) < 1e-15)
        True
        """
        N = self.algebra.N
        return self.algebra.projected(matrix_of_modes(read_modes(modes, N)))

    def modes(self, W: Any) -> dict[tuple[int, int], complex]:
        """Return the modes of a matrix W, those that are not zero to round-off."""
        N = self.algebra.N
        w = modes_of_matrix(np.asarray(W, dtype=np.complex128))
        n, size = representatives(N), np.abs(w).max(initial=0.0)
        return {
            (int(n[i]), int(n[j])): complex(round_off(w[i, j], size)) for i, j in np.argwhere(np.abs(w) > 1e-14 * size)
        }


def round_off(value: complex, size: float) -> complex:
    """Return a number without parts that are rounding of numbers of a size."""
    real, imaginary = (part if abs(part) > 1e-15 * size else 0.0 for part in (value.real, value.imag))
    return complex(round(real / size, 15) * size, round(imaginary / size, 15) * size)


@ready_made
def torus_euler(N: int = 33) -> TorusEuler:
    """Return the Euler equations of an ideal fluid on the torus with the sine bracket: ``W' = [P, W]``, ``L P = -W``.

    ``w_n' = sum over m of N/(2 pi) sin(2 pi (m x n)/N) w_m w_(n-m) / |m|^2`` for the Fourier modes w_n of the
    vorticity, m x n = m1 n2 - m2 n1, modes counted mod N.

    Parameters
    ----------
    N : int
        Size of the matrices, odd, from 3 to 1001: modes n1, n2 from -(N - 1)/2 to (N - 1)/2 are resolved.

    Returns
    -------
    TorusEuler
        With ``from_modes`` and ``modes``. Energy ``sum |w_n|^2 / |n|^2 / 2`` times N^3/(4 pi)^2.

    Notes
    -----
    D. Fairlie and C. Zachos, Phys. Lett. B 224 (1989) 101; V. Zeitlin, Physica D 49 (1991) 353.

    Examples
    --------
    >>> s = torus_euler(N=9)
    >>> W = s.from_modes({(1, 0): 1.0, (0, 1): 0.5})
    >>> s.shape, bool(np.abs(s.vector_field(W)).max() < 1.0)
    ((9, 9), True)
    """
    N = read_whole(N, "N", 3, LARGEST)
    if N % 2 == 0:
        raise ValueError(f"N is {N}; the sine bracket needs an odd N")
    n = representatives(N)
    squares = (n[:, None] ** 2 + n[None, :] ** 2).astype(float)  # [d, n1]
    with np.errstate(divide="ignore"):
        by_mode = np.where(squares == 0.0, 0.0, -1.0 / squares)
    # along the diagonal d the mode n1 turns by 2 n1 from entry to entry
    spectrum = np.empty((N, N))
    spectrum[:, (2 * np.arange(N)) % N] = by_mode
    return TorusEuler(
        MatrixAlgebra("su", N), Circulants(spectrum), energy_sign=-1, name="torus_euler", parameters={"N": N}
    )
