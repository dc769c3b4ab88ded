"""Casimirs of matrices: traces of powers, by blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.algebra.families.matrix_families import Kind

Matrix = npt.NDArray[Any]


@dataclass(frozen=True)
class Trace:
    """The real trace of a power of a block of W (of -i W if the algebra is skew-Hermitian), or its imaginary part.

    `matrices` and `numbers` convert states to matrices and matrices to vectors; `place` is the slice of the rows.
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
        """Return the trace for matrices (..., N, N) or vectors (..., n)."""
        base = self._base(self.matrices(x))
        return self.of(np.linalg.matrix_power(base, self.power - 1), base)

    def gradient(self, x: Any) -> Any:
        """Return the derivatives with respect to the numbers of a state."""
        W = self.matrices(x)
        slope = self.power * np.linalg.matrix_power(self._base(W), self.power - 1)
        # d tr B^k = k tr(B^(k-1) dB); the dot product of the numbers of A* and B is Re tr(A B).
        slope = slope * (-1j if self.kind.conjugate else 1.0) * (-1j if self.imaginary else 1.0)
        found = np.zeros_like(W)
        found[..., self.place, self.place] = np.conj(np.swapaxes(slope, -1, -2))
        return self.numbers(found)

    def _base(self, W: Matrix) -> Matrix:
        part = W[..., self.place, self.place]
        return -1j * part if self.kind.conjugate else part

    def of(self, power: Matrix, base: Matrix) -> Any:
        """Return the trace from the block and its power below; the trace of a product needs no matrix product."""
        products = power * np.swapaxes(base, -1, -2)
        found = products.reshape(*products.shape[:-2], base.shape[-1] ** 2).sum(axis=-1)
        return found.imag if self.imaginary else found.real


def traces_of(algebra: MatrixAlgebra, count: int, matrices: Any, numbers: Any) -> dict[str, Trace]:
    """Return the Casimirs of an algebra: the first `count` nonvanishing, independent traces of each block.

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
        for k in range(min(count, kind.rank(block.N) // (1 + kind.has_complex_traces))):
            power = first + each * k
            trace = f"tr {which}^{power}" if power > 1 else f"tr {which}"
            for part in ("Re ", "Im ") if kind.has_complex_traces else ("",):
                name = part + trace
                found[name] = Trace(name, place, kind, power, part == "Im ", matrices, numbers)
    return found


def values_of(traces: dict[str, Trace], W: Matrix) -> dict[str, Any]:
    """Return all traces for matrices (..., N, N), with successive powers of each block."""
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
