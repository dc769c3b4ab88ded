"""Streams: maps from W to P in W' = [P, W], on the diagonals or the entries of W, or by a function of the user."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.systems.matrices.spherical_modes import (
    coefficients_of_diagonal,
    diagonal_of,
    harmonics,
    laplacian,
)
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import read_finite, set_fields, to_array

Floats = npt.NDArray[np.float64]
Matrix = npt.NDArray[Any]
Numbers = npt.NDArray[np.int64]


@runtime_checkable
class Stream(Protocol):
    """A symmetric linear map of matrices; ``matrices/stream.hpp`` describes the numbers of its ``table``."""

    @property
    def kind(self) -> str:
        """Code of the kernels."""

    @property
    def table(self) -> Floats:
        """Numbers for the kernels."""

    def __call__(self, W: Matrix) -> Matrix:
        """Return P."""


@suggest_keywords
@dataclass(frozen=True, eq=False)
class DiagonalSolve:
    """P solves a symmetric tridiagonal system for each diagonal of a skew-Hermitian matrix.

    Parameters
    ----------
    main : (N, N)
        ``main[i, m]`` is the diagonal coefficient of the system of diagonal m for the entry (i, i + m); unused beyond.
    beside : (N, N)
        ``beside[i, m]`` couples the entries (i - 1, i - 1 + m) and (i, i + m).
    factor : float
        Factor of P.

    Notes
    -----
    If the system of the main diagonal is singular, with multiples of the unit matrix as its kernel, P has trace zero
    and does not depend on the trace of W, which the stages of a step have.
    """

    main: Floats
    beside: Floats
    factor: float = 1.0
    table: Floats = field(init=False, repr=False)

    kind = "TRIDIAGONAL"
    centred: ClassVar[bool] = False
    """Whether P has trace zero, and does not depend on the trace of W, though no system is singular."""

    @property
    def size(self) -> int:
        """Number of rows of the matrices."""
        return len(self.main)

    def __post_init__(self) -> None:
        N = len(self.main)
        below, inverse = np.zeros((N, N)), np.zeros((N, N))
        pivot = self.main[0].copy()
        inverse[0] = self.factor / pivot
        for i in range(1, N):
            m = slice(0, N - i)
            below[i, m] = self.beside[i, m] / pivot[m]
            pivot = self.main[i, m] - below[i, m] * self.beside[i, m]
            is_singular = i == N - 1 and abs(pivot[0]) <= 1e-10 * abs(self.main[i, 0])
            inverse[i, m] = 0.0 if is_singular else self.factor / pivot
        below[0, 0] = self.centred or inverse[N - 1, 0] == 0.0
        set_fields(self, table=np.stack([below, inverse]).ravel())

    def __call__(self, W: Matrix) -> Matrix:
        N = len(self.main)
        below, inverse = self.table.reshape(2, N, N)
        P, centred = np.zeros_like(W), below[0, 0] != 0.0
        diagonal, mean = np.arange(N), np.trace(W, axis1=-2, axis2=-1) / N
        # Vectorized over the diagonals.
        for i in range(N):
            P[..., i, i:] = W[..., i, i:]
            if i:
                P[..., i, i:] -= below[i, : N - i] * P[..., i - 1, i - 1 : N - 1]
            if centred:
                P[..., i, i] -= mean
        for i in range(N - 1, -1, -1):
            P[..., i, i:] *= inverse[i, : N - i]
            P[..., i, i : N - 1] -= below[i + 1, : N - i - 1] * P[..., i + 1, i + 1 :] if i < N - 1 else 0.0
        if centred:
            P[..., diagonal, diagonal] -= (np.trace(P, axis1=-2, axis2=-1) / N)[..., None]
        return _mirrored(P)

    def inverted(self) -> Inverse:
        """Return the inverse stream."""
        return Inverse(self)

    @cached_property
    def _shift(self) -> float | None:
        """The shift of the equations from the Hoppe-Yau Laplacian, or None if they differ otherwise."""
        N = len(self.main)
        main, beside = laplacian(N)
        shifts = (self.main - main)[np.add.outer(np.arange(N), np.arange(N)) < N]
        return float(shifts[0]) if np.array_equal(self.beside, beside) and np.all(shifts == shifts[0]) else None

    @property
    def modes(self) -> str:
        """Kind of the modes on which the stream is diagonal; empty if these are not known."""
        return "" if self._shift is None else "HARMONICS"

    def on_modes(self, modes: Any, d: int, numbers: Numbers) -> Floats:
        """Return the eigenvalues of the stream on modes of a diagonal."""
        return np.asarray(self.factor / (modes.eigenvalues(d, numbers) + self._shift))

    def inverse(self, P: Matrix) -> Matrix:
        """Return W of P."""
        return tridiagonal_product(self.main, self.beside, P) / self.factor


def tridiagonal_product(main: Floats, beside: Floats, P: Matrix) -> Matrix:
    """Return the product of a symmetric tridiagonal matrix with each diagonal of skew-Hermitian matrices."""
    N, W = len(main), np.zeros_like(P)
    for i in range(N):
        W[..., i, i:] = main[i, : N - i] * P[..., i, i:]
        if i:
            W[..., i, i:] += beside[i, : N - i] * P[..., i - 1, i - 1 : N - 1]
        if i < N - 1:
            W[..., i, i : N - 1] += beside[i + 1, : N - i - 1] * P[..., i + 1, i + 1 :]
    return _mirrored(W)


class ScreenedSolve(DiagonalSolve):
    """The stream of a potential vorticity on the sphere, ``(Laplacian - gamma - lamb mu^2) P = W``, of trace zero.

    Parameters
    ----------
    N : int
        Size of the matrices.
    lamb, gamma : float
        Lamb's parameter, and the squared inverse of a constant deformation radius.

    Raises
    ------
    ValueError
        The matrices are so small for `lamb` that the operator is not negative.

    Attributes
    ----------
    screening : (main, beside)
        The tridiagonal matrices of ``gamma + lamb mu^2``.
    """

    centred = True
    modes = "HARMONICS"

    def __init__(self, N: int, lamb: float, gamma: float = 0.0) -> None:
        main, beside = laplacian(N)
        square, beside_square = squared_sine(N)
        set_fields(self, screening=(gamma + lamb * square, lamb * beside_square))
        super().__init__(main + self.screening[0], beside + self.screening[1], -1.0)
        if (self.table[N * N :] > 0.0).any():
            raise ValueError(
                f"lamb is {lamb:g}; matrices of N = {N} are too small for it, N >= {lamb**0.25:.0f} are not"
            )

    screening: tuple[Floats, Floats]

    def on_modes(self, modes: Any, d: int, numbers: Numbers) -> Floats:
        """Return the diagonal elements of the stream between modes of a diagonal."""
        below, inverse = (table[:, d] for table in self.table.reshape(2, len(self.main), -1))
        vectors = modes.vectors(d, numbers)
        if d == 0:  # the trace of a mode is zero, and that of its stream has no effect
            below = np.concatenate([[0.0], below[1:]])
        solved = vectors.copy()
        for i in range(1, vectors.shape[1]):
            solved[:, i] -= below[i] * solved[:, i - 1]
        for i in range(vectors.shape[1] - 1, -1, -1):
            solved[:, i] *= inverse[i]
            if i < vectors.shape[1] - 1:
                solved[:, i] -= below[i + 1] * solved[:, i + 1]
        return np.asarray(np.sum(vectors * solved, axis=1))

    def eigenmodes(self, m: int) -> tuple[Floats, Floats]:
        """Return the eigenvalues of minus the operator on diagonal m, ascending, and unit vectors as columns."""
        n = len(self.main) - m
        from scipy.linalg import eigh_tridiagonal

        values, vectors = eigh_tridiagonal(self.main[:n, m], self.beside[1:n, m])
        return np.asarray(values, dtype=np.float64), np.asarray(vectors, dtype=np.float64)


def squared_sine(N: int) -> tuple[Floats, Floats]:
    """Return the tridiagonal matrices of the product with mu^2, the squared sine of the latitude, to order 1/N^4."""
    # On a diagonal X = {Z, .}/2 is diagonal, the mean of two z. Between degrees its elements are those of mu, times the
    # root of (N^2 - l^2)/(N^2 - 1) for the larger degree l. So X^2 is mu^2 to order 1/N^2, as are (Z^2 P + P Z^2)/2 and
    # Z P Z. Since l^2 is the mean of the eigenvalues of L of both degrees, with M = N^2 - 1
    # X^2 (1 - 1/M) + (L X^2 + 2 X L X + X^2 L)/(4 M) is mu^2 to the next order, and tridiagonal too: the eigenvalues of
    # waves are better than those of all three.
    main, beside = laplacian(N)
    i, m, M = np.arange(N)[:, None], np.arange(N)[None, :], N * N - 1
    x = np.where(i + m < N, (N - 1 - 2 * i - m) / np.sqrt(M), 0.0)
    above = np.concatenate([np.zeros((1, N)), x[:-1]])
    return x * x * (1 - 1 / M) + main * x * x / M, beside * ((above + x) / 2) ** 2 / M


@dataclass(frozen=True, eq=False)
class HarmonicStream:
    """P is a factor times each degree of a matrix of the sphere, such as of surface quasi-geostrophic flow.

    Parameters
    ----------
    factors : (N,)
        The factor of each degree l; that of degree 0 is zero.
    """

    factors: Floats
    table: Floats = field(init=False, repr=False)

    kind = "SYMMETRIC"
    modes = "HARMONICS"

    @property
    def size(self) -> int:
        """Number of rows of the matrices."""
        return len(self.factors)

    def __post_init__(self) -> None:
        N = self.size
        parts = []
        for m in range(N):
            V, f = harmonics(N, m), self.factors[m:]
            for odd in range(2):
                half = V[odd::2, : (N - m + 1 - odd) // 2]
                parts.append((half.T * f[odd::2] @ half).ravel())
        set_fields(self, table=np.concatenate(parts))

    def __call__(self, W: Matrix) -> Matrix:
        P = np.zeros_like(W)
        for m in range(self.size):
            c = coefficients_of_diagonal(np.diagonal(W, m, -2, -1), self.size, m)
            i = np.arange(self.size - m)
            P[..., i, i + m] = diagonal_of(c * self.factors[m:], self.size, m)
        return _mirrored(P)

    def inverse(self, P: Matrix) -> Matrix:
        """Return W of P; degrees of factor zero are dropped."""
        with np.errstate(divide="ignore"):
            return HarmonicStream(np.where(self.factors == 0.0, 0.0, 1.0 / self.factors))(P)

    def on_modes(self, modes: Any, d: int, numbers: Numbers) -> Floats:
        """Return the eigenvalues of the stream on modes of a diagonal."""
        return self.factors[numbers]


def _mirrored(upper: Matrix) -> Matrix:
    """Return a skew-Hermitian matrix from its upper triangle; the diagonal is unchanged."""
    above = np.triu(upper, 1)
    return np.asarray(upper - np.conj(np.swapaxes(above, -1, -2)))


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Circulants:
    """P is a circulant matrix times each cyclic diagonal of a skew-Hermitian matrix of odd size.

    Parameters
    ----------
    spectrum : (N, N)
        ``spectrum[d, k]``: the factors of the discrete Fourier transform of diagonal d, the entries (a, a + d mod N),
        even in k, and equal for d and N - d; zero for modes in the kernel.
    """

    spectrum: Floats
    table: Floats = field(init=False, repr=False)

    kind = "CIRCULANT"
    modes = "WAVES"

    @property
    def size(self) -> int:
        """Number of rows of the matrices."""
        return len(self.spectrum)

    def __post_init__(self) -> None:
        N = len(self.spectrum)
        columns = np.fft.ifft(self.spectrum, axis=1).real
        set_fields(self, table=np.ascontiguousarray(columns[: (N + 1) // 2]).ravel())

    def __call__(self, W: Matrix) -> Matrix:
        rows = np.arange(len(self.spectrum))
        columns = (rows[None, :] + rows[:, None]) % len(rows)  # columns[d, a]
        diagonals = W[..., rows[None, :], columns]
        P = np.empty_like(W)
        P[..., rows[None, :], columns] = np.fft.ifft(np.fft.fft(diagonals, axis=-1) * self.spectrum, axis=-1)
        return P

    def inverse(self, P: Matrix) -> Matrix:
        """Return W of P; modes in the kernel of the stream are dropped."""
        return self.inverted()(P)

    def inverted(self) -> Circulants:
        """Return the inverse stream, zero on the kernel of this one."""
        with np.errstate(divide="ignore"):
            return Circulants(np.where(self.spectrum == 0.0, 0.0, 1.0 / self.spectrum))

    def on_modes(self, modes: Any, d: int, numbers: Numbers) -> Floats:
        """Return the eigenvalues of the stream on modes of a diagonal."""
        return np.asarray(self.spectrum[d, 2 * numbers % modes.N])


@dataclass(frozen=True, eq=False)
class LayeredStream:
    """The stream of the layers of a fluid, (..., k, N, N): of each vertical mode that of a single layer.

    Parameters
    ----------
    of_modes : sequence of Stream
        The streams of the vertical modes, of one kind.
    to_modes, to_layers : (k, k)
        Matrices from layers to vertical modes, and back.
    weights : (k,)
        Weights of the layers in the energy; the stream is symmetric with them.
    """

    of_modes: tuple[Any, ...]
    to_modes: Floats
    to_layers: Floats
    weights: Floats
    table: Floats = field(init=False, repr=False)

    kind = "LAYERED"

    def __post_init__(self) -> None:
        numbers = [self.weights, self.to_modes.ravel(), self.to_layers.ravel()]
        set_fields(self, table=np.concatenate([*numbers, *(stream.table for stream in self.of_modes)]))

    @property
    def size(self) -> int:
        """Number of rows of the matrices."""
        return int(self.of_modes[0].size)

    @property
    def modes(self) -> str:
        """Kind of the modes on which the streams act."""
        return str(self.of_modes[0].modes)

    def __call__(self, W: Matrix) -> Matrix:
        return self.by_modes(self.of_modes, W)

    def by_modes(self, functions: Sequence[Callable[[Matrix], Matrix]], W: Matrix) -> Matrix:
        """Return layers of which each vertical mode is a function of that of given layers."""
        V = np.einsum("ml,...lij->m...ij", self.to_modes, W)
        changed = np.stack([function(mode) for function, mode in zip(functions, V, strict=True)])
        return np.einsum("lm,m...ij->...lij", self.to_layers, changed)

    @property
    def couples_modes(self) -> bool:
        """Whether a stream is not diagonal on the modes of diagonals."""
        return any(isinstance(one, ScreenedSolve) and one.screening[1].any() for one in self.of_modes)

    def induction(self, layer: int, modes: Any, d: int, numbers: Numbers) -> Floats:
        """Return the streams that modes of a diagonal induce in a layer, of each layer, (layers, modes)."""
        values = np.array([one.on_modes(modes, d, numbers) for one in self.of_modes])
        return np.asarray(self.to_modes.T @ (self.to_layers[layer][:, None] * values))

    def of_layer(self, layer: int) -> SelfInduction:
        """Return the map of a layer to its own stream, times its weight, for the energy of its modes."""
        return SelfInduction(self, layer)


class SelfInduction(NamedTuple):
    """The stream that a layer induces in itself, on the modes of its diagonals."""

    stream: LayeredStream
    layer: int

    def on_modes(self, modes: Any, d: int, numbers: Numbers) -> Floats:
        """Return the diagonal elements between modes of a diagonal."""
        k = self.layer
        return np.asarray(self.stream.weights[k] * self.stream.induction(k, modes, d, numbers)[k])


@dataclass(frozen=True, eq=False)
class BuoyancyFactors:
    """How a buoyancy b adds to a potential vorticity, W = q + B b entry by entry, and the vorticity acts on it by -B P.

    Parameters
    ----------
    factors : (N, N)
        B, symmetric.
    """

    # b and B P are taken without their means, so that the map of b is the transpose of that of P.

    factors: Floats
    kind = "THERMAL"

    @property
    def table(self) -> Floats:
        """Numbers for the kernels."""
        return self.factors.ravel()

    def __call__(self, b: Matrix) -> Matrix:
        return self.factors * _without_mean(b)

    def separated(self, x: Matrix) -> Matrix:
        """Return the buoyancy and the potential vorticity q of states (..., 2, N, N)."""
        b = x[..., 0, :, :]
        return np.stack([b, _without_mean(x[..., 1, :, :] - self(b))], axis=-3)

    def joined(self, fields: Matrix) -> Matrix:
        """Return states of a buoyancy and a potential vorticity; inverse of `separated`."""
        b = fields[..., 0, :, :]
        return np.stack([b, _without_mean(fields[..., 1, :, :] + self(b))], axis=-3)

    def stream_of_buoyancy(self, P: Matrix) -> Matrix:
        """Return the derivative J of the energy by b."""
        return -_without_mean(self.factors * P)


def _without_mean(W: Matrix) -> Matrix:
    """Return matrices (..., N, N) without their trace."""
    N = W.shape[-1]
    return np.asarray(W - np.trace(W, axis1=-2, axis2=-1)[..., None, None] / N * np.eye(N))


@dataclass(frozen=True, eq=False)
class Inverse:
    """The inverse of a `DiagonalSolve`: W of P by tridiagonal products."""

    of: DiagonalSolve
    table: Floats = field(init=False, repr=False)

    kind = "MULTIPLIED"

    def __post_init__(self) -> None:
        set_fields(self, table=np.stack([self.of.main, self.of.beside]).ravel() / self.of.factor)

    def __call__(self, W: Matrix) -> Matrix:
        return self.of.inverse(W)

    def inverse(self, P: Matrix) -> Matrix:
        return self.of(P)

    def on_modes(self, modes: Any, d: int, numbers: Numbers) -> Floats:
        return 1.0 / self.of.on_modes(modes, d, numbers)


@suggest_keywords
@dataclass(frozen=True, eq=False)
class Weights:
    """P_ij = w_ij W_ij, such as the angular velocity of a body of N dimensions, w_ij = 1 / (a_i + a_j).

    Parameters
    ----------
    weights : (N, N)
        Symmetric.

    Raises
    ------
    ValueError
        Not square, symmetric and finite.

    Examples
    --------
    >>> Weights([[0.0, 2.0], [2.0, 0.0]])(np.array([[0.0, 1.0], [-1.0, 0.0]])).tolist()
    [[0.0, 2.0], [-2.0, 0.0]]
    """

    weights: Floats
    table: Floats = field(init=False, repr=False)

    kind = "WEIGHTS"

    @property
    def size(self) -> int:
        """Number of rows of the matrices."""
        return len(self.weights)

    def __post_init__(self) -> None:
        w = read_finite(self.weights, "weights")
        if w.ndim != 2 or w.shape[0] != w.shape[1] or not np.array_equal(w, w.T):
            raise ValueError(f"weights is {short(self.weights)}; give a symmetric (N, N)")
        set_fields(self, weights=w, table=w.ravel())

    def __call__(self, W: Matrix) -> Matrix:
        return self.weights * W

    def inverse(self, P: Matrix) -> Matrix:
        """Return W of P; entries of weight zero are dropped."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.weights == 0.0, 0.0, P / self.weights)


@suggest_keywords
@dataclass(frozen=True, eq=False)
class FunctionStream:
    """P = f(W), or f(W, t), given by a Python function of one matrix.

    Compiled loops call machine code if Numba can compile the function, otherwise Python.

    Parameters
    ----------
    function : callable
        Pure function of a matrix (N, N), real or complex like the algebra, or of a matrix and the time.
    traceless : tuple of (int, int)
        Ranges of rows of the blocks whose matrices have trace zero. The stages of a step have a trace there, which is
        removed before the function is called: otherwise a step would not be a Poisson map.

    Raises
    ------
    TypeError
        Not a function of these arguments.

    Examples
    --------
    >>> FunctionStream(lambda W: 2.0 * W)(np.eye(2))
    array([[2., 0.],
           [0., 2.]])
    """

    function: Callable[..., Any]
    traceless: tuple[tuple[int, int], ...] = ()
    timed: bool = field(init=False)
    table: Floats = field(init=False, repr=False)

    kind = "BY_FUNCTION"

    def __post_init__(self) -> None:
        set_fields(self, timed=takes_time(self.function, "stream"), table=np.zeros(0))

    def __call__(self, W: Matrix, t: float = 0.0) -> Matrix:
        W = np.asarray(W)
        if W.ndim == 2:
            W = self._centred(W)
            return self.checked(self.function(W, t) if self.timed else self.function(W), W)
        return np.stack([self(part, t) for part in W]) if len(W) else np.zeros_like(W)

    def _centred(self, W: Matrix) -> Matrix:
        result = W.copy() if self.traceless else W
        for first, last in self.traceless:
            rows = np.arange(first, last)
            result[rows, rows] -= result[rows, rows].mean()
        return result

    def checked(self, P: Any, W: Matrix) -> Matrix:
        """Validate the returned value, and return it as a matrix like W."""
        kinds = "iufc" if np.iscomplexobj(W) else "iuf"
        result = to_array(P, "the value of the stream", kinds)
        if result.shape != W.shape or result.dtype.kind not in kinds:
            kind = "complex" if kinds == "iufc" else "real"
            raise TypeError(f"the stream returns {short(P)}; it must return a {kind} matrix of shape {W.shape}")
        return result.astype(W.dtype, copy=False)


def as_stream(given: Any, algebra: MatrixAlgebra, what: str = "stream") -> Stream:
    """Return a stream, made of a function of W where one is given."""
    if isinstance(given, Stream):
        return given
    if isinstance(given, type) or not callable(given):
        raise TypeError(f"{what} is {short(given)}; give a Stream, such as Weights(w), or a function of W")
    return FunctionStream(given, tuple((rows.start, rows.stop) for rows, _, kind in algebra.parts if kind.traceless))
