"""Streams of matrices as operations of JAX: tridiagonal solves, and factors of modes, along the diagonals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import lax

from coadjoint.memory import check_available_memory
from coadjoint.systems.forces.mode_force import Harmonics

Constants = dict[str, Any]


def stream_map(system: Any) -> tuple[Constants, Callable[[Constants, Any], Any]]:
    """Return the arrays of the stream of a system, and the stream as a function of these and of states (..., N, N)."""
    layers = len(system.matrix_shape) == 3
    buoyancy = system.buoyancy
    maps = {"first": system.stream, "second": None if buoyancy is not None else system.second_stream}
    named = {name: _map_of(one, system.name) for name, one in maps.items() if one is not None}
    constants: Constants = {name: arrays for name, (arrays, _) in named.items()}
    if system.linear is not None:
        constants["linear"] = system.linear
    if buoyancy is not None:
        constants["factors"] = buoyancy.factors

    def of_carried(given: Constants, X: Any) -> Any:
        """Return P and J of two fields."""
        carried, W = X[..., 0, :, :], X[..., 1, :, :]
        if buoyancy is not None:
            P = named["first"][1](given["first"], W - given["factors"] * _without_mean(carried))
            return jnp.stack([P, -_without_mean(given["factors"] * P)], -3)
        P = named["first"][1](given["first"], W)
        J = named["second"][1](given["second"], carried) if "second" in named else jnp.zeros_like(P)
        return jnp.stack([P, J], -3)

    def stream(given: Constants, X: Any) -> Any:
        P = of_carried(given, X) if layers else named["first"][1](given["first"], X)
        return P + given["linear"] if "linear" in given else P

    return constants, stream


def _map_of(stream: Any, name: str) -> tuple[Any, Callable[[Any, Any], Any]]:
    """Return the arrays of a linear map of matrices, and the map as a function of these and of matrices."""
    if stream.kind == "TRIDIAGONAL":
        below, inverse = stream.table.reshape(2, stream.size, stream.size)
        is_centred = below[0, 0] != 0.0
        return (below, inverse), lambda arrays, W: _solve(arrays[0], arrays[1], W, is_centred)
    if stream.kind == "MULTIPLIED":
        N = stream.of.size
        return stream.table.reshape(2, N, N), _multiply
    if stream.kind == "CIRCULANT":
        return stream.spectrum.T, scale_waves
    if stream.kind == "WEIGHTS":
        return stream.weights, jnp.multiply
    if stream.kind == "SYMMETRIC":
        N = stream.size
        factors = np.array([np.concatenate([np.zeros(m), stream.factors[m:]]) for m in range(N)])
        return (harmonics_by_diagonal(N), factors), lambda arrays, W: scale_harmonics(arrays[0], arrays[1], W)
    raise TypeError(f"JAX takes streams by numbers, and that of {name} is a function; take prepared.run")


def _without_mean(A: Any) -> Any:
    """Return matrices without their trace."""
    return A - jnp.trace(A, axis1=-2, axis2=-1)[..., None, None] / A.shape[-1] * jnp.eye(A.shape[-1])


def adjoint(A: Any) -> Any:
    """Return the conjugate transpose."""
    return jnp.conj(jnp.swapaxes(A, -1, -2))


def skew_part(A: Any) -> Any:
    """Return the skew-Hermitian part."""
    return 0.5 * (A - adjoint(A))


def diagonals(W: Any) -> Any:
    """Return the diagonals of the upper half, D[..., i, m] = W[..., i, i + m], and zero beyond."""
    N = W.shape[-1]
    return _sheared(jnp.concatenate([W, jnp.zeros_like(W)], -1), 2 * N + 1)[..., :N]


def of_diagonals(D: Any) -> Any:
    """Return the skew-Hermitian matrices with these diagonals, of which the main one is kept as it is."""
    N = D.shape[-1]
    U = _sheared(jnp.concatenate([D, jnp.zeros((*D.shape[:-1], N + 1), D.dtype)], -1), 2 * N)[..., :N]
    return U - adjoint(jnp.triu(U, 1))


def _sheared(A: Any, width: int) -> Any:
    """Return the joined rows (..., N, k) as N rows of another width, cut or padded by zeros."""
    *lead, N, k = A.shape
    flat = jnp.concatenate([A.reshape(*lead, -1), jnp.zeros((*lead, max(0, N * (width - k))), A.dtype)], -1)
    return flat[..., : N * width].reshape(*lead, N, width)


def _solve(below: Any, inverse: Any, W: Any, is_centred: bool) -> Any:
    """Return the solution of a tridiagonal system for each diagonal; see `DiagonalSolve`."""
    D = diagonals(W)
    if is_centred:
        D = D.at[..., 0].add(-jnp.mean(D[..., 0], -1, keepdims=True))
    D = _recurrence(-below, D, reverse=False)
    above = jnp.concatenate([below[1:], jnp.zeros_like(below[:1])])
    D = _recurrence(-above, inverse * D, reverse=True)
    if is_centred:
        D = D.at[..., 0].add(-jnp.mean(D[..., 0], -1, keepdims=True))
    return of_diagonals(D)


def _recurrence(factors: Any, D: Any, reverse: bool) -> Any:
    """Return y_i = d_i + f_i y_(i-1) along the rows, or from the last row backward, in log2(N) parallel steps."""

    def joined(first: Any, second: Any) -> Any:
        return first[0] * second[0], second[0] * first[1] + second[1]

    factors = jnp.broadcast_to(factors, D.shape)
    return lax.associative_scan(joined, (factors, D), reverse=reverse, axis=D.ndim - 2)[1]


def _multiply(table: Any, P: Any) -> Any:
    """Return the product of a tridiagonal matrix with each diagonal."""
    (main, beside), D = table, diagonals(P)
    zero = jnp.zeros_like(D[..., :1, :])
    moved = jnp.concatenate([zero, D[..., :-1, :]], -2) * beside
    return of_diagonals(main * D + moved + jnp.concatenate([beside[1:] * D[..., 1:, :], zero], -2))


# Modes.


def harmonics_by_diagonal(N: int) -> Any:
    """Return the modes T_lm of the sphere along the diagonals m, as [m, l, i], with zeros elsewhere."""
    check_available_memory(8 * N**3, f"the modes of matrices of {N} rows on the sphere, as arrays of JAX,")
    basis, modes = Harmonics(N), np.zeros((N, N, N))
    for m in range(N):
        modes[m, max(m, 1) :, : N - m] = basis.vectors(m, basis.numbers(m))
    return modes


def scale_harmonics(modes: Any, factors: Any, W: Any) -> Any:
    """Return matrices with each mode of the sphere times its factor [m, l]; degree 0 is dropped."""
    c = factors * jnp.einsum("mli,...im->...ml", modes, diagonals(W))
    return of_diagonals(jnp.einsum("mli,...ml->...im", modes, c))


def scale_waves(factors: Any, W: Any) -> Any:
    """Return matrices with each mode of the torus times its factor: [k, d] of the Fourier transform of diagonal d."""
    N = W.shape[-1]
    D = _sheared(jnp.concatenate([W, W], -1), 2 * N + 1)[..., :N]  # [a, d] = W[a, a + d]
    D = jnp.fft.ifft(factors * jnp.fft.fft(D, axis=-2), axis=-2)
    twice = jnp.concatenate([D, D], -1)
    flat = twice.reshape(*D.shape[:-2], -1)[..., N:]
    return flat.reshape(*D.shape[:-2], N, 2 * N - 1)[..., :N]
