"""Invariants of a matrix system: the energy, from its stream or by a user function, and traces of powers of blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra, MatrixFamily
from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME
from coadjoint.short_repr import short
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.matrices.conjugation import units_of
from coadjoint.systems.user_functions import takes_time
from coadjoint.validation import is_real

if TYPE_CHECKING:
    from coadjoint.systems.matrices.matrix_system import MatrixSystem
    from coadjoint.systems.matrices.streams import Stream

Matrix = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

ROUNDING_TOLERANCE = 1e-12
"""Times N: relative tolerance for round-off in identities."""
DIFFERENCE_STEP = 2.0**-17  # of central differences, whose errors h^2 and u / h are both near 1e-11
AGREEMENT = 2.0**-24
"""Relative tolerance of a central difference, for truncation and round-off."""


class MatrixEnergy:
    """The energy of a matrix system as a function of states as vectors of `dim` numbers, in the form that runs use."""

    def __init__(self, system: MatrixSystem) -> None:
        self._system, self.dim, self.timed = system, system.dim, system.timed

    def __repr__(self) -> str:
        return f"energy of {self._system!r}"

    def bind(self, n: int) -> MatrixEnergy:
        return self

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> float:
        return float(self._system.energy(x, t))

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> Floats:
        """Return the derivatives with respect to the numbers of a state, projected on the algebra."""
        system = self._system
        P = system.stream_of(system.matrices(x), t)
        return system.energy_factor * system.to_vector(system.dual(P))

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> Floats:
        """Return the second derivatives; raise TypeError if the stream is a nonlinear function."""
        system = self._system
        if not system.linear_stream:
            raise TypeError(
                f"the stream of {system.name} is a function that is not linear; its derivative is not known"
            )
        return system.energy_factor * system.to_vector(system.dual(system.slope_of(units_of(system), t))).T

    def terms(self) -> tuple[Any, ...]:
        """Return no terms: the kernels evaluate the stream."""
        return ()


def applied(stream: Any, W: Matrix, t: float) -> Matrix:
    """Return a stream of matrices (..., N, N), at a time if it takes one."""
    return np.asarray(stream(W, t) if getattr(stream, "timed", False) else stream(W))


def read_energy(energy: Any, timed: bool) -> Callable[..., Any] | None:
    """Validate a function for the energy, which must have the same arguments as the stream."""
    if energy is None:
        return None
    if takes_time(energy, "energy") != timed:
        raise TypeError(
            f"stream takes {'(W, t)' if timed else '(W)'} and energy {'(W)' if timed else '(W, t)'}; give both the same"
        )
    function: Callable[..., Any] = energy
    return function


def samples(system: MatrixSystem) -> list[Matrix]:
    """Return seeded sample matrices of the algebra, of norm one."""
    rng, shape = np.random.default_rng(1), system.algebra.shape
    random_matrices = [rng.standard_normal(shape) + 1j * system.complex * rng.standard_normal(shape) for _ in range(2)]
    projected = [system.algebra.projected(matrix) for matrix in random_matrices]
    return [matrix / (np.abs(matrix).max(initial=0.0) or 1.0) for matrix in projected]


@ignore_overflow
def check_stream(system: MatrixSystem, stream: Stream) -> None:
    """Raise ValueError if, at sample matrices, a stream leaves the algebra or is inconsistent with the energy."""
    # Without a function for the energy the stream must be linear and symmetric; otherwise it must be its gradient.
    A, B = samples(system)
    P, tolerance, algebra = applied(stream, A, SAMPLE_TIME), ROUNDING_TOLERANCE * system.algebra.N, system.algebra
    size = float(np.abs(P).max(initial=0.0))
    if not float(np.abs(P - algebra.projected(P)).max(initial=0.0)) <= tolerance * size:
        raise ValueError(f"the stream leaves {algebra}: its values at sample matrices are not {algebra.description}")
    if system.energy_function is not None:
        _check_slope(system, A, B)
        return
    Q, R = (applied(stream, W, SAMPLE_TIME) for W in (B, (A + B) / 2.0))
    deviation, size = float(np.abs(2.0 * R - P - Q).max(initial=0.0)), float((np.abs(P) + np.abs(Q)).max(initial=0.0))
    if not deviation <= tolerance * size:
        raise ValueError(
            "the stream is not linear: stream((A + B)/2) is not the mean of stream(A), stream(B) at sample matrices; "
            "give energy=, the function with this gradient"
        )
    sizes = float(np.sum(np.abs(P.T * B.T)) + np.sum(np.abs(Q * A)))
    if not abs(algebra.pairing(P, B) - algebra.pairing(A, Q)) <= tolerance * sizes:
        raise ValueError("the stream is not symmetric: <stream(A), B> and <A, stream(B)> differ at sample matrices")


def _check_slope(system: MatrixSystem, A: Matrix, B: Matrix) -> None:
    energy = system.energy_function
    assert energy is not None
    time_argument = (SAMPLE_TIME,) if system.timed else ()
    ahead, behind = (_energy_value(energy(A + side * DIFFERENCE_STEP * B, *time_argument)) for side in (1.0, -1.0))
    difference = (ahead - behind) / (2.0 * DIFFERENCE_STEP)
    P = system.slope_of(A, SAMPLE_TIME)
    declared = system.energy_sign * float(system.algebra.pairing(P, B))
    size = float(np.sum(np.abs(P) * np.abs(B.T))) + abs(ahead)
    if np.isfinite(difference) and not abs(difference - declared) <= AGREEMENT * system.algebra.N * size:
        raise ValueError(
            f"the stream is not the gradient of the energy: along a sample matrix the derivative of the energy is "
            f"{difference:.6g}, and energy_sign <stream, .> is {declared:.6g}; correct one of them"
        )


def _energy_value(value: Any) -> float:
    """Return the value of a function for the energy; NaN outside its domain."""
    if not is_real(value):
        raise TypeError(f"energy returns {short(value)} at a sample matrix; it must return one real number")
    try:
        return float(value)
    except OverflowError:
        return float("nan")


@dataclass(frozen=True)
class Trace:
    """The real trace of a power of a block of W (of -i W if the algebra is skew-Hermitian), or its imaginary part."""

    name: str
    rows: slice
    kind: MatrixFamily
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
    """Return the Casimirs of an algebra: the first `count` nonvanishing, independent traces of each block."""
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
