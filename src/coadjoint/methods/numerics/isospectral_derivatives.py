"""Derivatives of steps of isospectral Gauss methods along matrices, and their transposes, in NumPy.

The linear equations of the stages are iterated like the stages. Inner products are those of real and imaginary parts.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.methods.numerics.isospectral_stages import (
    Stages,
    as_blocks,
    increment_of,
    iterated,
    largest,
    of_blocks,
    slope_along,
    stages_of,
    two_layer_stages,
    weighted_sums,
)
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.two_layer_system import TwoLayerSystem

Matrix = NDArray[Any]
Floats = NDArray[np.float64]

NO_CONVERGENCE = "the linear equations of the stages do not converge; take a smaller step"


class StageDerivatives(ABC):
    """The derivative of a step at a state W, by the stages of the step; `end` is the state after it, as a vector."""

    def __init__(
        self, system: MatrixSystem, W: Matrix, stages: Stages, t: float, h: float, a: Floats, b: Floats
    ) -> None:
        self.system, self._W, self._stages = system, W, stages
        self._t, self._h, self._a, self._b = t, h, a, b
        self.end = system.to_vector(self.states(W + increment_of(stages, h, b)))

    @abstractmethod
    def matrices(self, states: Matrix) -> Matrix:
        """Return the matrices in the stages of states."""

    @abstractmethod
    def states(self, matrices: Matrix) -> Matrix:
        """Return the states of matrices in the stages."""

    @abstractmethod
    def slopes(self, along: Matrix) -> Matrix:
        """Return the derivatives of the streams of the stages along matrices (stages, k, N, N)."""

    @abstractmethod
    def slopes_transposed(self, of_streams: Matrix) -> Matrix:
        """Return the cotangents of the stages for those of their streams, (stages, N, N)."""

    @abstractmethod
    def matrices_transposed(self, of_matrices: Matrix) -> Matrix:
        """Return the transpose of `matrices`."""

    @abstractmethod
    def states_transposed(self, of_states: Matrix) -> Matrix:
        """Return the transpose of `states`."""

    @property
    def linear(self) -> bool:
        """Whether `slopes` are linear maps to round-off."""
        return self.system.linear_stream

    def tangents(self, rows: Floats) -> Floats:
        """Return the tangents (k, n) after the step for vectors before it, which are projected on the algebra."""
        system = self.system
        directions = system.algebra.projected(system.from_vector(rows))
        return system.to_vector(self.states(self._along(self.matrices(directions))))

    def cotangent(self, row: Floats) -> Floats:
        """Return the cotangent (n,) before the step, projected on the algebra."""
        system = self.system
        before = self._transposed(self.states_transposed(system.from_vector(row)))
        return system.to_vector(system.algebra.projected(self.matrices_transposed(before)))

    def _along(self, directions: Matrix) -> Matrix:
        """Return the derivatives of the step along matrices (k, N, N)."""
        h, a, b, W = self._h, self._a, self._b, self._W
        check_available_memory(
            13 * len(b) * directions.nbytes, f"the derivatives of a step along {len(directions)} directions"
        )
        V1, U1, M1, P1 = (array[:, None] for array in self._stages[:4])

        def update(dV: Matrix, dU: Matrix, dM: Matrix, dP: Matrix) -> Any:
            dM_new = dV @ W @ U1 + V1 @ directions @ U1 + V1 @ W @ dU
            # A difference is linear in its direction up to an error relative to it. Along the corrections of dM these
            # errors shrink with them; along dM they would stay, and corrections might cycle above ROUND_OFF_CANDIDATE.
            dP = self.slopes(dM_new) if self.linear else dP + self.slopes(dM_new - dM)
            dV_new, dU_new = h * weighted_sums(a, dP @ V1 + P1 @ dV), -h * weighted_sums(a, dU @ P1 + U1 @ dP)
            change = max(largest(dV_new - dV), largest(dU_new - dU))
            return (dV_new, dU_new, dM_new, dP), change, largest(dV_new)

        # Axes: stage, direction, row, column.
        zero = np.zeros((len(b), *directions.shape), dtype=M1.dtype)
        _, _, dM, dP = iterated(update, (zero,) * 4, len(W), NO_CONVERGENCE, self._t)
        return np.asarray(directions + h * np.tensordot(b, dP @ M1 + P1 @ dM - dM @ P1 - M1 @ dP, 1))

    def _transposed(self, after: Matrix) -> Matrix:
        """Return the cotangent before the step for that after it, matrices (N, N)."""
        h, a, b, W = self._h, self._a, self._b, self._W
        V, U, M, P = self._stages[:4]
        Vt, Ut, Mt, Pt = (_adjoint(array) for array in (V, U, M, P))
        WU, VW = _adjoint(W @ U), _adjoint(V @ W)
        weights = (h * b)[:, None, None]
        of_M = weights * (Pt @ after - after @ Pt)
        of_P = weights * (after @ Mt - Mt @ after)

        def update(v: Matrix, u: Matrix, m: Matrix, p: Matrix, q: Matrix) -> Any:
            p_new = of_P + h * weighted_sums(a.T, v) @ Vt - Ut @ (h * weighted_sums(a.T, u))
            q = self.slopes_transposed(p_new) if self.linear else q + self.slopes_transposed(p_new - p)
            m = of_M + q
            v_new = m @ WU + Pt @ (h * weighted_sums(a.T, v))
            u_new = VW @ m - (h * weighted_sums(a.T, u)) @ Pt
            change = max(largest(v_new - v), largest(u_new - u))
            return (v_new, u_new, m, p_new, q), change, max(largest(v_new), largest(u_new))

        zero = np.zeros_like(M)
        _, _, m, _, _ = iterated(update, (zero,) * 5, len(W), NO_CONVERGENCE, self._t)
        return np.asarray(after + np.sum(Vt @ m @ Ut, axis=0))


class LayerDerivatives(StageDerivatives):
    """The derivative of a step of one matrix."""

    def __init__(self, system: MatrixSystem, W: Matrix, t: float, h: float, a: Floats, b: Floats, name: str) -> None:
        super().__init__(system, W, stages_of(system, W, t, h, a, name), t, h, a, b)

    def matrices(self, states: Matrix) -> Matrix:
        return states

    def states(self, matrices: Matrix) -> Matrix:
        return matrices

    def matrices_transposed(self, of_matrices: Matrix) -> Matrix:
        return of_matrices

    def states_transposed(self, of_states: Matrix) -> Matrix:
        return of_states

    def slopes(self, along: Matrix) -> Matrix:
        M, times = self._stages.M, self._stages.times
        return np.stack([slope_along(self.system, m, dm, t) for m, dm, t in zip(M, along, times, strict=True)])

    def slopes_transposed(self, of_streams: Matrix) -> Matrix:
        system, algebra = self.system, self.system.algebra
        if system.stream.kind != "BY_FUNCTION":
            # Symmetric for all matrices that are skew-Hermitian if the algebra is: the stages have a trace.
            return np.asarray(system.slope_of((of_streams - _adjoint(of_streams)) / 2 if algebra.skew else of_streams))
        # Functions are symmetric in the pairing of the algebra.
        inner = algebra.projected(algebra.dual(of_streams))
        return np.asarray(algebra.dual(self.slopes(inner[:, None])[:, 0]))


class TwoLayerDerivatives(StageDerivatives):
    """The derivative of a step of two layers, whose stages are blocks."""

    system: TwoLayerSystem

    def __init__(self, system: TwoLayerSystem, X: Matrix, t: float, h: float, a: Floats, b: Floats) -> None:
        super().__init__(system, as_blocks(X), two_layer_stages(system, X, t, h, a), t, h, a, b)

    def matrices(self, states: Matrix) -> Matrix:
        return as_blocks(states)

    def states(self, matrices: Matrix) -> Matrix:
        return of_blocks(matrices)

    def slopes(self, along: Matrix) -> Matrix:
        return as_blocks(self.system.stream_of(of_blocks(along)))

    def slopes_transposed(self, of_streams: Matrix) -> Matrix:
        layers = self.matrices_transposed(of_streams)
        layers = (layers - _adjoint(layers)) / 2
        # The stream takes the vorticity to P and the carried field to J.
        return self.states_transposed(self.system.stream_of(layers[..., ::-1, :, :])[..., ::-1, :, :])

    def matrices_transposed(self, of_matrices: Matrix) -> Matrix:
        N = of_matrices.shape[-1] // 2
        A, B = of_matrices[..., :N, :N] + of_matrices[..., N:, N:], of_matrices[..., :N, N:]
        return np.stack([A, B], axis=-3)

    def states_transposed(self, of_states: Matrix) -> Matrix:
        A, B = of_states[..., 0, :, :], of_states[..., 1, :, :]
        rows = np.concatenate([A, B], axis=-1)
        return np.concatenate([rows, np.zeros_like(rows)], axis=-2)


def _adjoint(matrices: Matrix) -> Matrix:
    return np.conj(np.swapaxes(matrices, -1, -2))
