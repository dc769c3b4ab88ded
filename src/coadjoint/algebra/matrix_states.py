"""Lie algebras whose elements are kept as matrices: u(N), su(N) and so(N), without structure constants."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.given import read_choice, read_whole
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.wording import short

KINDS = ("u", "su", "so")
LARGEST = 4096
ROUNDED = 64 * UNIT_ROUNDOFF
"""Of the largest entry: by so much, times N, a matrix may miss the algebra by rounding."""

Matrix = npt.NDArray[Any]


@dataclass(frozen=True)
class MatrixAlgebra:
    """Skew-Hermitian matrices, complex or real, with the commutator ``[A, B] = A B - B A``.

    Choose it where structure constants would not fit: u(512) has some 2 N^3 of them. The pairing of matrices is
    ``<A, B> = tr(A* B)``, by which the algebra is its own dual.

    Parameters
    ----------
    kind : {"u", "su", "so"}
        Complex skew-Hermitian, the same with trace zero, or real and skew.
    N : int
        Rows and columns, from 2 to 4096.

    Raises
    ------
    ValueError
        Of another kind, or size.

    Examples
    --------
    >>> g = MatrixAlgebra("su", 3)
    >>> g.shape, g.complex, g.dim
    ((3, 3), True, 8)
    """

    kind: str
    N: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", read_choice(self.kind, "kind", KINDS))
        object.__setattr__(self, "N", read_whole(self.N, "N", 2, LARGEST))

    def __str__(self) -> str:
        return f"{self.kind}({self.N})"

    @property
    def name(self) -> str:
        """Such as "su(3)"."""
        return str(self)

    @property
    def shape(self) -> tuple[int, int]:
        """Of a matrix."""
        return self.N, self.N

    @property
    def skew(self) -> bool:
        """Whether every element is skew-Hermitian."""
        return True

    @property
    def complex(self) -> bool:
        """Whether entries are complex."""
        return self.kind != "so"

    @property
    def dim(self) -> int:
        """The dimension, real: how many numbers tell an element."""
        return {"u": self.N**2, "su": self.N**2 - 1, "so": self.N * (self.N - 1) // 2}[self.kind]

    @property
    def basis(self) -> tuple[str, ...]:
        """Names of the numbers of which a matrix is stored, row by row."""
        parts = ("re", "im") if self.complex else ("",)
        return tuple(f"{part}{i},{j}" for i in range(self.N) for j in range(self.N) for part in parts)

    def bracket(self, A: Matrix, B: Matrix) -> Matrix:
        """Return the commutator.

        Examples
        --------
        >>> E = np.array([[0.0, 1.0], [-1.0, 0.0]])
        >>> MatrixAlgebra("so", 2).bracket(E, 2 * E)
        array([[0., 0.],
               [0., 0.]])
        """
        return A @ B - B @ A

    def projected(self, A: Matrix) -> Matrix:
        """Return the nearest element of the algebra.

        Examples
        --------
        >>> MatrixAlgebra("su", 2).projected(np.array([[1j, 2.0], [0.0, 3j]]))
        array([[0.-1.j, 1.+0.j],
               [-1.+0.j, 0.+1.j]])
        """
        skew = (A - np.conj(np.swapaxes(A, -1, -2))) / 2
        if self.kind == "su":
            mean = np.trace(skew, axis1=-2, axis2=-1) / self.N
            skew = skew - mean[..., None, None] * np.eye(self.N)
        return skew

    def read(self, given: Any, what: str = "x0") -> Matrix:
        """Return matrices of the algebra, to the last bit; refuse others.

        Parameters
        ----------
        given : array_like, shape (N, N) or (members, N, N)
            What was given.
        what : str
            Its name, for messages.

        Returns
        -------
        ndarray
            A copy, complex128 or float64.

        Raises
        ------
        TypeError, ValueError
            No finite matrix of this size, or of another algebra.
        """
        try:
            A = np.array(given, dtype=np.complex128)
        except (TypeError, ValueError):
            raise TypeError(f"{what} is {short(given)}; give a matrix of {self}") from None
        if A.shape[-2:] != self.shape or A.ndim > 3:
            raise ValueError(
                f"{what} has the shape {A.shape}; it must be {self.shape} or (members, {self.N}, {self.N})"
            )
        if not np.isfinite(A).all():
            raise ValueError(f"{what} contains NaN or infinity; every entry must be finite")
        near = self.projected(A)
        if not self.complex:
            near = np.ascontiguousarray(near.real)
        away, size = np.abs(A - near).max(initial=0.0), np.abs(A).max(initial=0.0)
        if away > ROUNDED * self.N * size:
            what_is = {"u": "skew-Hermitian", "su": "skew-Hermitian, of trace zero", "so": "real and skew"}[self.kind]
            raise ValueError(
                f"{what} is no matrix of {self}: it must be {what_is}, and misses that by {away:.2g} where its largest "
                f"entry is {size:.2g}"
            )
        return near
