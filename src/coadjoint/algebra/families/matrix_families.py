"""The classical families of matrix Lie algebras, defined by an adjoint: A with adjoint(A) = -A."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[Any]


class Kind(NamedTuple):
    """A family of matrix Lie algebras: A with ``adjoint(A) = -A``, of trace zero if `traceless`.

    `form` is "diagonal" (signs on the diagonal), "symplectic", or "" for all matrices; `conjugate`: the adjoint
    conjugates entries; `complex`: entries are complex; `description`: for messages.
    """

    complex: bool
    form: str
    conjugate: bool
    traceless: bool
    description: str

    @property
    def even(self) -> bool:
        """Whether traces of odd powers vanish."""
        return self.form != "" and not self.conjugate

    @property
    def has_complex_traces(self) -> bool:
        """Whether traces are complex, each giving two invariants: the complex form itself."""
        return self.complex and not self.conjugate

    def dim(self, N: int) -> int:
        """Return the real dimension."""
        count = N * N - self.traceless
        if self.even:
            count = N * (N - 1) // 2 if self.form == "diagonal" else N * (N + 1) // 2
        return count * (1 + self.has_complex_traces)

    def rank(self, N: int) -> int:
        """Return the number of independent Casimirs."""
        return (N // 2 if self.even else N - self.traceless) * (1 + self.has_complex_traces)


KINDS = {
    "u": Kind(True, "diagonal", True, False, "skew-Hermitian"),
    "su": Kind(True, "diagonal", True, True, "skew-Hermitian, of trace zero"),
    "so": Kind(False, "diagonal", False, False, "real and skew"),
    "gl": Kind(False, "", False, False, "real"),
    "sl": Kind(False, "", False, True, "real, of trace zero"),
    "sp": Kind(False, "symplectic", False, False, "real, with W^T J + J W = 0, J = [[0, 1], [-1, 0]]"),
    "gl(C)": Kind(True, "", False, False, "complex"),
    "sl(C)": Kind(True, "", False, True, "complex, of trace zero"),
    "so(C)": Kind(True, "diagonal", False, False, "complex, with W^T = -W"),
    "sp(C)": Kind(True, "symplectic", False, False, "complex, with W^T J + J W = 0, J = [[0, 1], [-1, 0]]"),
}
INDEFINITE_KINDS = ("u", "su", "so")
"""Kinds that exist for forms of any signature."""


class Adjoint:
    """The adjoint by a form, ``J^-1 A^T J``, conjugated if `kind.conjugate`; the last `q` signs are negative.

    Examples
    --------
    >>> Adjoint(KINDS["so"], 2, 1)(np.array([[1.0, 2.0], [3.0, 4.0]]))
    array([[ 1., -3.],
           [-2.,  4.]])
    """

    def __init__(self, kind: Kind, N: int, q: int) -> None:
        self.conjugate, order, signs = kind.conjugate, np.arange(N), np.ones(N)
        if kind.form == "symplectic":
            order, signs[N // 2 :] = np.roll(order, N // 2), -1.0
        else:
            signs[N - q :] = -1.0
        self._permuted = bool((order != np.arange(N)).any())
        self._order, self._signs = order, None if (signs > 0).all() else np.outer(signs, signs)

    def __call__(self, A: Matrix) -> Matrix:
        result = np.swapaxes(A, -1, -2)
        if self._permuted:
            result = result[..., self._order[:, None], self._order]
        if self.conjugate:
            result = np.conj(result)
        return result if self._signs is None else self._signs * result
