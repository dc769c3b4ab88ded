"""The Casimirs of matrices: traces of powers, block by block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.matrix_kinds import Kind
from coadjoint.algebra.matrix_states import MatrixAlgebra

Matrix = npt.NDArray[Any]


@dataclass(frozen=True)
class Trace:
    """The trace of a power of a block of W, real: of -i W where W is skew-Hermitian by its form.

    Parameters
    ----------
    name : str
        Such as "tr W^2".
    place : slice
        The rows of the block.
    kind : Kind
        Of the block.
    power : int
        The power.
    imaginary : bool
        Whether it is the imaginary part.
    matrices : callable
        Makes matrices of what is given: of matrices, or of rows of their numbers.
    numbers : callable
        Makes the numbers of a matrix.
    """

    name: str
    place: slice
    kind: Kind
    power: int
    imaginary: bool
    matrices: Callable[[Any], Matrix]
    numbers: Callable[[Matrix], Any]

    def __repr__(self) -> str:
        return self.name

    def __call__(self, x: Any) -> Any:
        """Return it at matrices (..., N, N), or at their numbers (..., n)."""
        base = self._base(self.matrices(x))
        return self.of(np.linalg.matrix_power(base, self.power - 1), base)

    def gradient(self, x: Any) -> Any:
        """Return the derivatives by the numbers of a state."""
        W = self.matrices(x)
        slope = self.power * np.linalg.matrix_power(self._base(W), self.power - 1)
        # d tr B^k = k tr(B^(k-1) dB), and the numbers of A* times those of B add up to Re tr(A B).
        slope = slope * (-1j if self.kind.conjugate else 1.0) * (-1j if self.imaginary else 1.0)
        found = np.zeros_like(W)
        found[..., self.place, self.place] = np.conj(np.swapaxes(slope, -1, -2))
        return self.numbers(found)

    def _base(self, W: Matrix) -> Matrix:
        part = W[..., self.place, self.place]
        return -1j * part if self.kind.conjugate else part

    def of(self, power: Matrix, base: Matrix) -> Any:
        """Return it from the power below and the block; the trace of a product needs no product."""
        products = power * np.swapaxes(base, -1, -2)
        found = products.reshape(*products.shape[:-2], base.shape[-1] ** 2).sum(axis=-1)
        return found.imag if self.imaginary else found.real


def traces_of(algebra: MatrixAlgebra, count: int, matrices: Any, numbers: Any) -> dict[str, Trace]:
    """Return the Casimirs of an algebra: the first `count` traces of each block that do not vanish, and no more than
    are independent.

    Examples
    --------
    >>> g = MatrixAlgebra.sum(MatrixAlgebra("so", 5), MatrixAlgebra("sl(C)", 2))
    >>> list(traces_of(g, 5, None, None))
    ['tr W1^2', 'tr W1^4', 'Re tr W2^2', 'Im tr W2^2']
    """
    found = {}
    for number, (place, block, kind) in enumerate(algebra.parts, 1):
        which = f"W{number}" if algebra.blocks else "W"
        first, each = (2, 2) if kind.even else (1 + kind.traceless, 1)
        for k in range(min(count, kind.rank(block.N) // (1 + kind.twofold))):
            power = first + each * k
            trace = f"tr {which}^{power}" if power > 1 else f"tr {which}"
            for part in ("Re ", "Im ") if kind.twofold else ("",):
                name = part + trace
                found[name] = Trace(name, place, kind, power, part == "Im ", matrices, numbers)
    return found


def values_of(traces: dict[str, Trace], W: Matrix) -> dict[str, Any]:
    """Return all of them at matrices (..., N, N), the powers of a block one from the other."""
    found: dict[str, Any] = {}
    place: slice | None = None
    for name, trace in traces.items():
        if trace.place != place:
            place, base = trace.place, trace._base(W)
            power, below = np.broadcast_to(np.eye(base.shape[-1], dtype=base.dtype), base.shape), 0
        while below < trace.power - 1:
            power, below = (power @ base if below else base), below + 1
        found[name] = trace.of(power, base)
    return found
