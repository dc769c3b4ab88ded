"""Isospectral motions of matrices, W' = [P, W], P linear in W, or linear and a constant."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.matrix_states import MatrixAlgebra
from coadjoint.given import read_title, read_whole
from coadjoint.systems.closed_form import checked_exact, checked_parameters, solution_of
from coadjoint.systems.forced import ForcedSystem
from coadjoint.systems.forces.base import Force
from coadjoint.systems.matrices.streams import Stream
from coadjoint.systems.points import checked_sign
from coadjoint.wording import short

Matrix = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

POWERS = 5
"""So many powers of W have their traces followed: from 2 on, of real matrices the even ones."""
MOST_POWERS = 64


class MatrixEnergy:
    """The energy ``sign <P, W> / 2`` as runs ask for it: of a state as a row of numbers."""

    timed = False

    def __init__(self, system: MatrixSystem) -> None:
        self._system, self.dim = system, system.dim

    def bind(self, n: int) -> MatrixEnergy:
        """Return this energy."""
        return self

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> float:
        """Return it."""
        return float(self._system.energy(self._system.from_vector(x)))

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> Floats:
        """Return its derivatives by the numbers of a state, sign P."""
        system = self._system
        return system.energy_sign * system.to_vector(system.stream_of(system.from_vector(x)))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> Floats:
        """Return the second derivatives, the columns of the gradient of a linear stream."""
        rest = self.gradient(np.zeros(self.dim))
        return np.stack([self.gradient(unit) - rest for unit in np.eye(self.dim)], axis=1)

    def terms(self) -> tuple[Any, ...]:
        """Return none: the kernels read the stream."""
        return ()


class MatrixSystem:
    """A matrix W in a Lie algebra of skew-Hermitian matrices that moves by ``W' = [P, W]``, P = stream(W) + linear.

    Choose it for algebras too large for structure constants: the quantized sphere and torus, bodies of many dimensions.
    The spectrum of W is constant; its invariants are followed as traces of powers.

    Parameters
    ----------
    algebra : MatrixAlgebra
        Where W lives.
    stream : Stream
        A symmetric linear map from W to P.
    energy_sign : {1, -1}
        Of the energy ``energy_sign (<stream(W), W>/2 + <linear, W>)``, <A, B> = tr(A* B).
    linear : (N, N) array, optional
        A matrix of the algebra that is added to the stream, such as that of a rotation of the frame.
    name : str
        For messages.
    parameters : mapping, optional
        What makes a ready-made system again.
    exact : callable, optional
        ``exact(W0, t)``.
    powers : int
        How many traces of powers of W are followed.

    Raises
    ------
    TypeError, ValueError
        Something else was given, or the stream leaves the algebra or is not symmetric at sample points.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.systems.matrices.streams import Weights
    >>> a = np.array([1.0, 2.0, 3.0, 4.0])
    >>> body = MatrixSystem(MatrixAlgebra("so", 4), Weights(1 / np.add.outer(a, a)), name="body")
    >>> W = body.algebra.projected(np.arange(16.0).reshape(4, 4))
    >>> list(body.casimirs_at(W)), bool(np.trace(body.vector_field(W) @ W) < 1e-12)
    (['tr W^2', 'tr W^4', 'tr W^6', 'tr W^8', 'tr W^10'], True)
    """

    sign = 1
    representation = None

    def __init__(
        self,
        algebra: MatrixAlgebra,
        stream: Stream,
        *,
        energy_sign: int = 1,
        linear: Any = None,
        name: str = "matrix system",
        parameters: Mapping[str, Any] | None = None,
        exact: Callable[..., Any] | None = None,
        powers: int = POWERS,
    ) -> None:
        if not isinstance(algebra, MatrixAlgebra):
            raise TypeError(f"algebra is {short(algebra)}; give a MatrixAlgebra, such as MatrixAlgebra('su', 16)")
        if not isinstance(stream, Stream):
            raise TypeError(f"stream is {short(stream)}; give a Stream, such as Weights(w)")
        self.algebra, self.stream = algebra, stream
        self.energy_sign = checked_sign(energy_sign)
        self.linear: Matrix | None = None if linear is None else algebra.read(linear, "linear")
        if self.linear is not None:
            if self.linear.ndim != 2:
                raise ValueError(f"linear has the shape {self.linear.shape}; give one matrix, {algebra.shape}")
            self.linear.flags.writeable = False
        self.name = read_title(name, "name")
        self.parameters, self._exact = checked_parameters(parameters), checked_exact(exact)
        even = 1 if algebra.complex else 2
        count = read_whole(powers, "powers", 0, MOST_POWERS)
        self.powers = tuple(2 + even * k for k in range(count))
        self.shape: tuple[int, ...] = algebra.shape
        self.complex = algebra.complex
        self.dim = (1 + self.complex) * algebra.N**2
        self.hamiltonian = MatrixEnergy(self)
        self._check_stream()

    def _check_stream(self) -> None:
        rng = np.random.default_rng(1)
        A, B = (
            self.algebra.projected(
                rng.standard_normal(self.shape) + 1j * self.complex * rng.standard_normal(self.shape)
            )
            for _ in range(2)
        )
        if not self.complex:
            A, B = A.real, B.real
        P, Q = self.stream(A), self.stream(B)
        size = float(np.sum(np.abs(np.conj(P) * B))) + float(np.sum(np.abs(np.conj(Q) * A)))
        rounded = 1e-12 * self.algebra.N
        if not abs(np.vdot(P, B) - np.conj(np.vdot(Q, A))) <= rounded * size:
            raise ValueError("the stream is not symmetric: <stream(A), B> and <A, stream(B)> differ at sample matrices")
        if not np.abs(P + np.conj(P.T)).max() <= rounded * np.abs(P).max():
            raise ValueError("the stream leaves the algebra: its values at sample matrices are not skew-Hermitian")

    def __repr__(self) -> str:
        return f"<{self.name} on {self.algebra}>"

    @property
    def casimirs(self) -> dict[str, Any]:
        """Name -> function of W, shape (..., N, N): the traces of its powers."""
        return {f"tr W^{k}": _Trace(k) for k in self.powers}

    @property
    def quadratic_casimirs(self) -> tuple[str, ...]:
        """Names of those of degree two, the first of all, which runs with forces keep account of."""
        return ("tr W^2",) if self.powers else ()

    def with_forces(self, *forces: Force) -> ForcedSystem:
        """Return the system with forces; see `LiePoissonSystem.with_forces`."""
        return ForcedSystem(self, forces)

    def stream_of(self, W: Any) -> Matrix:
        """Return P = stream(W) + linear of matrices (..., N, N)."""
        P = self.stream(np.asarray(W))
        return P if self.linear is None else P + self.linear

    def vector_field(self, x: Any, t: float = 0.0) -> Matrix:
        """Return W' of a matrix, or of the numbers of one, in the same form."""
        flat = np.ndim(x) == 1
        W = self.from_vector(x) if flat else np.asarray(x)
        found = self.algebra.bracket(self.stream_of(W), W)
        return self.to_vector(found) if flat else found

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return H of matrices (..., N, N)."""
        W = np.asarray(x)
        P = 0.5 * self.stream(W) if self.linear is None else 0.5 * self.stream(W) + self.linear
        found = self.energy_sign * np.sum(np.conj(P) * W, axis=(-2, -1)).real
        return float(found) if found.ndim == 0 else found

    def casimirs_at(self, x: Any) -> dict[str, Any]:
        """Return the traces of powers at matrices (..., N, N): of W for real ones, else of -i W, which are real."""
        W = np.asarray(x)
        base = -1j * W if self.complex else W
        found, power, k = {}, base, 1
        for wanted in self.powers:
            while k < wanted - 1:
                power, k = power @ base, k + 1
            # the trace of a product needs no product
            found[f"tr W^{wanted}"] = np.einsum("...ij,...ji->...", power, base).real
        return found

    def spectrum(self, x: Any) -> Floats:
        """Return the eigenvalues of -i W, real and rising, of matrices (..., N, N)."""
        return np.asarray(np.linalg.eigvalsh(-1j * np.asarray(x)), dtype=np.float64)

    def exact(self, x0: Any, t: Any) -> Matrix:
        """Return the solution in closed form; refuse where none is known."""
        return np.asarray(solution_of(self._exact, self.name)(x0, t))

    def read(self, given: Any, what: str = "x0") -> Floats:
        """Return initial states as rows of numbers, one for a state and more for members; refuse others."""
        return self.to_vector(self.algebra.read(given, what))

    def to_vector(self, W: Any) -> Floats:
        """Return matrices (..., N, N) as rows of numbers: entry by entry, real and imaginary parts."""
        W = np.ascontiguousarray(W, dtype=np.complex128 if self.complex else np.float64)
        return W.view(np.float64).reshape(*W.shape[:-2], self.dim)

    def from_vector(self, x: Any) -> Matrix:
        """Return rows of numbers as matrices."""
        found = np.ascontiguousarray(x, dtype=np.float64)
        lead = found.shape[:-1]
        return (found.view(np.complex128) if self.complex else found).reshape(*lead, *self.shape)


class _Trace:
    def __init__(self, power: int) -> None:
        self.power = power

    def __repr__(self) -> str:
        return f"tr W^{self.power}"

    def __call__(self, W: Any) -> Any:
        W = np.asarray(W)
        base = -1j * W if np.iscomplexobj(W) else W
        return np.trace(np.linalg.matrix_power(base, self.power), axis1=-2, axis2=-1).real
