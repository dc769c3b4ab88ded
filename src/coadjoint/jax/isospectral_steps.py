"""Isospectral Gauss steps of skew-Hermitian matrices: stages by iteration, predicted from earlier steps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from math import comb
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.algebra.families.matrix_algebra import KINDS, MEMBERSHIP_TOLERANCE
from coadjoint.jax.matrix_streams import adjoint, skew_part, stream_map
from coadjoint.jax.stage_steps import Steps, fixed_point
from coadjoint.methods.isospectral_gauss import IsospectralGauss
from coadjoint.methods.numerics.gauss_coefficients import gauss_legendre
from coadjoint.methods.numerics.isospectral_stages import MAX_ITERATIONS

HISTORY = 8
"""Earlier steps from which the stages are extrapolated, by a polynomial in time."""
# Updates of S for each P: errors of V then fall by the square of h |P| / 2, and the iteration by about 30.
SWEEPS = 2
# Rows of extrapolations: from k known steps, the last one first.
EXTRAPOLATIONS = np.array([[(-1) ** j * comb(k, j + 1) for j in range(HISTORY)] for k in range(HISTORY + 1)], float)


def isospectral_steps(system: Any, scheme: IsospectralGauss, fractions: Sequence[float]) -> Steps:
    """Return the steps of a scheme with substeps of these fractions."""
    # The unknowns are S_i = P_i (1 + C_i), C_i = h sum_j a_ij S_j: V_i = 1 + C_i, M_i = V_i W V_i*, P_i = stream(M_i).
    # With E = h sum_i b_i S_i the matrix 1 + E is unitary, and the step is its conjugation.
    _, b, mu = gauss_legendre(scheme.stages)
    a = mu * b
    (arrays, stream), product = stream_map(system), dual_product if len(system.matrix_shape) == 3 else matrix_product

    def conjugated(W: Any, C: Any) -> Any:
        """Return (1 + C) W (1 + C)*."""
        Z = product(C, W)
        return W + (Z - adjoint(Z)) + skew_part(product(Z, adjoint(C)))

    def improved(constants: Any, W: Any, h: Any, S: Any) -> Any:
        P = stream(constants, conjugated(W, h * jnp.tensordot(a, S, 1)))
        for _ in range(SWEEPS):
            S = P + product(P, h * jnp.tensordot(a, S, 1))
        return S

    def substep(constants: Any, W: Any, history: Any, count: Any, h: Any) -> Any:
        update = partial(improved, constants, W, h)
        first = jnp.tensordot(jnp.asarray(EXTRAPOLATIONS)[count], history, 1)
        S = fixed_point(update, first, 1.0 / jnp.abs(h), MAX_ITERATIONS)
        history = jnp.concatenate([lax.stop_gradient(S)[None], history[:-1]])
        return conjugated(W, h * jnp.tensordot(b, S, 1)), history

    def step(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        W, (histories, count) = state
        W, histories = lax.scan(
            lambda W, at: substep(constants, W, at[0], count, at[1]), W, (histories, h * jnp.asarray(fractions))
        )
        return W, (histories, jnp.minimum(count + 1, HISTORY))

    def begin(constants: Any, state: Any, *_: Any) -> Any:
        W = state[0]
        return W, (jnp.zeros((len(fractions), HISTORY, len(b), *W.shape), W.dtype), jnp.asarray(0))

    def finish(constants: Any, state: Any, *_: Any) -> Any:
        return state[0], None

    def whole(constants: Any, state: Any, t: Any, h: Any, member: Any) -> Any:
        return finish(constants, step(constants, begin(constants, state), t, h, member))

    return Steps(lambda _: arrays, step, whole, begin, finish)


# Matrices, with axes of stages before them, and with two layers as dual numbers, axis -3.


def matrix_product(A: Any, B: Any) -> Any:
    """Return A B, of complex matrices by three real products."""
    if not jnp.iscomplexobj(A):
        return A @ B
    real, imaginary = A.real @ B.real, A.imag @ B.imag
    return lax.complex(real - imaginary, (A.real + A.imag) @ (B.real + B.imag) - real - imaginary)


def dual_product(A: Any, B: Any) -> Any:
    """Return the product of A_0 + eps A_1 and B_0 + eps B_1, eps^2 = 0."""
    (A0, A1), (B0, B1) = (jnp.moveaxis(one, -3, 0) for one in (A, B))
    return jnp.stack([matrix_product(A0, B0), matrix_product(A0, B1) + matrix_product(A1, B0)], -3)


def project(system: Any, x0: Any) -> Any:
    """Return initial states projected on the algebra; NaN where they are not of it: traced ones raise no errors."""
    kind, N = KINDS[system.algebra.kind], system.algebra.N
    near = skew_part(x0)
    if kind.traceless:
        near = near - jnp.trace(near, axis1=-2, axis2=-1)[..., None, None] / N * np.eye(N)
    away, size = (jnp.max(jnp.abs(A), axis=(-2, -1), keepdims=True) for A in (x0 - near, x0))
    return jnp.where(away <= MEMBERSHIP_TOLERANCE * N * size, near, jnp.nan)
