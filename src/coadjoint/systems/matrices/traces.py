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

    `to_matrices` and `to_vector` convert between states, matrices and vectors; `rows` is the range of the block.
    """

    name: str
    rows: slice
    kind: Kind
    power: int
    imaginary: bool
    to_matrices: Callable[[Any], Matrix]
    to_vector: Callable[[Matrix], Any]

    def __repr__(self) -> str:
        return self.name

    def __call__(self, x: Any) -> Any:
        """Return the trace for matrices (..., N, N) or vectors (..., n)."""
        base = self._base(self.to_matrices(x))
        return self.value_of(np.linalg.matrix_power(base, self.power - 1), base)

    def gradient(self, x: Any) -> Any:
        """Return the derivatives with respect to the numbers of a state."""
        W = self.to_matrices(x)
        derivative = self.power * np.linalg.matrix_power(self._base(W), self.power - 1)
        # d tr B^k = k tr(B^(k-1) dB); the dot product of the numbers of A* and B is Re tr(A B).
        derivative = derivative * (-1j if self.kind.conjugate else 1.0) * (-1j if self.imaginary else 1.0)
        gradient = np.zeros_like(W)
        gradient[..., self.rows, self.rows] = np.conj(np.swapaxes(derivative, -1, -2))
        return self.to_vector(gradient)

    def sum_of_absolute_terms(self, x: Any) -> Any:
        """Return the sum of the powers of the singular values, since eigenvalues may cancel."""
        return np.sum(np.linalg.svd(self._base(self.to_matrices(x)), compute_uv=False) ** self.power, axis=-1)

    def _base(self, W: Matrix) -> Matrix:
        part = W[..., self.rows, self.rows]
        return -1j * part if self.kind.conjugate else part

    def value_of(self, power: Matrix, base: Matrix) -> Any:
        """Return the trace from the block and its power below; the trace of a product needs no matrix product."""
        products = power * np.swapaxes(base, -1, -2)
        trace = products.reshape(*products.shape[:-2], base.shape[-1] ** 2).sum(axis=-1)
        return trace.imag if self.imaginary else trace.real


def traces_of(algebra: MatrixAlgebra, count: int, to_matrices: Any, to_vector: Any) -> dict[str, Trace]:
    """Return the Casimirs of an algebra: the first `count` nonvanishing, independent traces of each block.

    Examples
    --------
    >>> g = MatrixAlgebra.sum(MatrixAlgebra("so", 5), MatrixAlgebra("sl(C)", 2))
    >>> list(traces_of(g, 5, None, None))
    ['tr W1^2', 'tr W1^4', 'Re tr W2^2', 'Im tr W2^2']
    """
    traces = {}
    for number, (rows, block, kind) in enumerate(algebra.parts, 1):
        block_name = f"W{number}" if algebra.blocks else "W"
        first, step = (2, 2) if kind.even else (1 + kind.traceless, 1)
        for k in range(min(count, kind.rank(block.N) // (1 + kind.has_complex_traces))):
            power = first + step * k
            trace = f"tr {block_name}^{power}" if power > 1 else f"tr {block_name}"
            for part in ("Re ", "Im ") if kind.has_complex_traces else ("",):
                name = part + trace
                traces[name] = Trace(name, rows, kind, power, part == "Im ", to_matrices, to_vector)
    return traces


def values_of(traces: dict[str, Trace], W: Matrix) -> dict[str, Any]:
    """Return all traces for matrices (..., N, N), with successive powers of each block."""
    values: dict[str, Any] = {}
    rows: slice | None = None
    for name, trace in traces.items():
        if trace.rows != rows:
            rows, base = trace.rows, trace._base(W)
            power, below = np.broadcast_to(np.eye(base.shape[-1], dtype=base.dtype), base.shape), 0
        while below < trace.power - 1:
            power, below = (power @ base if below else base), below + 1
        values[name] = trace.value_of(power, base)
    return values
