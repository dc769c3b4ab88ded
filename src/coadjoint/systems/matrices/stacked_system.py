"""Base class of systems whose states are several matrices of one algebra."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import TRACE_TOLERANCE, MatrixAlgebra
from coadjoint.short_repr import short
from coadjoint.systems.matrices.matrix_invariants import MatrixEnergy
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.validation import read_complex, set_fields, to_array

Matrix = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]


class StackedSystem(MatrixSystem):
    """A system whose states are arrays (k, N, N) of skew-Hermitian matrices of one algebra, by layers."""

    layer_names: str
    """What the layers are, for messages."""

    def _stack(self, algebra: MatrixAlgebra, layers: int) -> None:
        """Take states of several layers; the fields of a system of single matrices are set."""
        if not algebra.skew or algebra.blocks:
            raise ValueError(f"algebra is {algebra}; layers need skew-Hermitian matrices of one block")
        shape = (layers, *algebra.shape)
        set_fields(self, shape=shape, matrix_shape=shape, dim=layers * self.dim)
        set_fields(self, hamiltonian=MatrixEnergy(self))

    def matrices(self, x: Any) -> Matrix:
        """Return states (..., k, N, N) unchanged, and vectors as the nearest states."""
        x = to_array(self.states_by_label(x, "a state"), "a state", "iufc")
        if x.shape[-1:] == (self.dim,):
            return self.algebra.projected(self.from_vector(x), spared=TRACE_TOLERANCE)
        X = np.asarray(x, dtype=np.complex128 if self.complex else np.float64)
        if X.shape[-3:] != self.matrix_shape:
            raise ValueError(f"a state has the shape {X.shape}; it must be {self.matrix_shape}, or ({self.dim},)")
        return X

    def read_matrices(self, given: Any, what: str) -> Matrix:
        state = to_array(self.states_by_label(given, what), what, "iufc")
        if state.shape[-3:] != self.shape or state.ndim > 4:
            raise ValueError(
                f"{what} has the shape {state.shape}; it must be {self.shape}, {self.layer_names}, or "
                f"(members, {str(self.shape)[1:]}"
            )
        # A layer has the rounding of the others, which move it.
        size = np.nan_to_num(np.abs(read_complex(state, what)).max(axis=(-3, -2, -1), initial=0.0))
        layers = [self.algebra.read(state[..., k, :, :], f"{what}, layer {k},", size) for k in range(self.shape[0])]
        return np.stack(layers, axis=-3)

    def to_vector(self, W: Any) -> Floats:
        """Return states (..., k, N, N) as vectors: layer by layer, entry by entry."""
        X = np.ascontiguousarray(W, dtype=np.complex128 if self.complex else np.float64)
        if X.shape[-3:] != self.matrix_shape:
            raise ValueError(f"a state is {short(W)}; it must have the shape {self.matrix_shape}")
        return X.view(np.float64).reshape(*X.shape[:-3], self.dim)
