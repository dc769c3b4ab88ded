"""Isospectral systems of matrices, W' = [P, W], with P a linear or nonlinear function of W."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import TRACE_TOLERANCE, MatrixAlgebra
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import html_table, short
from coadjoint.systems.closed_forms.closed_form import require_closed_form
from coadjoint.systems.forces.base import Force, forces_text
from coadjoint.systems.matrices.conjugation import units_of
from coadjoint.systems.matrices.matrix_invariants import (
    MatrixEnergy,
    applied,
    check_stream,
    read_energy,
    traces_of,
    values_of,
)
from coadjoint.systems.matrices.streams import BuoyancyFactors, Stream, as_stream
from coadjoint.systems.system import System
from coadjoint.systems.system_checks import read_closed_form, read_parameters, read_sign
from coadjoint.validation import (
    Immutable,
    check_finite,
    not_numbers_error,
    read_integer,
    read_numbers,
    read_title,
    set_fields,
    to_array,
)

Matrix = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

POWERS = 5
"""Default number of recorded traces of powers of W, from the lowest nonvanishing power."""
MAX_POWERS = 64
DEGENERACY_TOLERANCE = 1e-9
"""Relative to the largest eigenvalue: real parts that differ by less are treated as equal in sorting."""


@suggest_keywords
class MatrixSystem(Immutable, System):
    """A system whose state is a matrix W in a Lie algebra of matrices, ``W' = [P, W]`` with P = stream(W) + linear.

    Choose it for algebras too large for structure constants: the quantized sphere and torus, bodies of many dimensions.
    The spectrum of W is constant; runs record its invariants as traces of powers, at the saved points.

    Parameters
    ----------
    algebra : MatrixAlgebra
        The algebra of W.
    stream : Stream or callable
        P as a function of W: a symmetric linear map, such as `Weights`; or a function of a matrix (N, N), or of a
        matrix and the time. A function must be linear and symmetric, or the gradient of `energy`.
    linear : array_like, shape (N, N), optional
        A constant matrix of the algebra that is added to P.
    energy : callable, optional
        H without the term of `linear`, a function of a matrix (and the time, if the stream is): ``energy_sign P`` is
        its gradient in the pairing of the algebra. By default ``H = energy_sign (<P, W>/2 + <linear, W>)``, times
        `energy_unit`, which is 1 but for fluids.
    energy_sign : {1, -1}
        Sign of the energy.
    name : str
        Name in messages.
    parameters : mapping, optional
        Parameters for which ``co.systems.get(name, **parameters)`` makes this system again.
    exact : callable, optional
        Closed form ``exact(W0, t)``, if known.
    powers : int
        Number of traces of powers of W to record, for each block of a sum; at most as many as are independent.

    Raises
    ------
    TypeError, ValueError
        An argument of the wrong type or shape, or a stream that at sample points leaves the algebra or is inconsistent
        with the energy.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.systems.matrices.streams import Weights
    >>> a = np.array([1.0, 2.0, 3.0, 4.0])
    >>> body = MatrixSystem(MatrixAlgebra("so", 4), Weights(1 / np.add.outer(a, a)), name="body")
    >>> W = body.algebra.projected(np.arange(16.0).reshape(4, 4))
    >>> list(body.casimirs_at(W)), bool(abs(np.trace(body.vector_field(W) @ W)) < 1e-12)
    (['tr W^2', 'tr W^4'], True)

    An energy that is not quadratic, on gl(3):

    >>> s = MatrixSystem(MatrixAlgebra("gl", 3), lambda W: W.T @ W @ W.T, energy=lambda W: np.sum((W @ W.T) ** 2) / 4)
    >>> bool(abs(s.vector_field(np.eye(3))).max() == 0.0)
    True
    """

    sign = 1
    shape: tuple[int, ...] = ()
    has_matrices = True
    second_stream: Stream | None = None
    buoyancy: BuoyancyFactors | None = None
    """How a carried field adds to the vorticity."""
    energy_parameters: tuple[str, ...] | None = None
    """Parameters on which only the energy depends, each of whose numbers may change; by default all real numbers."""
    independent_layers = False
    """Whether the matrices of a state are multiplied one by one, and not as dual numbers."""
    energy_unit: float = 1.0
    """Energy of ``<P, W>/2 = 1``."""

    def __init__(
        self,
        algebra: MatrixAlgebra,
        stream: Stream | Callable[..., Any],
        linear: npt.ArrayLike | None = None,
        *,
        energy: Callable[..., Any] | None = None,
        energy_sign: int = 1,
        name: str = "matrix system",
        parameters: Mapping[str, Any] | None = None,
        exact: Callable[..., Any] | None = None,
        powers: int = POWERS,
    ) -> None:
        if not isinstance(algebra, MatrixAlgebra):
            raise TypeError(f"algebra is {short(algebra)}; give a MatrixAlgebra, such as MatrixAlgebra('su', 16)")
        self.algebra, self.stream, self.complex = algebra, as_stream(stream, algebra), algebra.complex
        self.timed: bool = getattr(self.stream, "timed", False)
        self.energy_function = read_energy(energy, self.timed)
        self.energy_sign = read_sign(energy_sign, "energy_sign")
        self.name = read_title(name, "name")
        self._parameters, self.closed_form = read_parameters(parameters), read_closed_form(exact)
        self.powers = read_integer(powers, "powers", 0, MAX_POWERS)
        self.shape = algebra.shape
        self.matrix_shape: tuple[int, ...] = algebra.shape  # also of states given as vectors
        self.dim = (1 + self.complex) * algebra.N**2
        self.linear = None if linear is None else algebra.read(linear, "linear")
        if self.linear is not None and self.linear.ndim != 2:
            raise ValueError(f"linear has the shape {self.linear.shape}; it must be {algebra.shape}")
        if self.linear is not None:
            self.linear.flags.writeable = False
        self._check_stream(self.stream)
        self.hamiltonian = MatrixEnergy(self)

    def _check_stream(self, stream: Stream) -> None:
        """Raise ValueError unless a stream is one of the algebra, symmetric or the gradient of the energy."""
        algebra, size = self.algebra, getattr(stream, "size", None)
        if size not in (None, algebra.N):
            raise ValueError(f"the stream acts on matrices of {size} rows; those of {algebra} have {algebra.N}")
        if stream.kind not in ("WEIGHTS", "BY_FUNCTION") and not algebra.skew:
            raise ValueError(f"{type(stream).__name__} needs skew-Hermitian matrices; those of {algebra} are not")
        check_stream(self, stream)

    def _text(self) -> str:
        return f"<{self.name} on {self.algebra}>"

    def _repr_html_(self) -> str:
        rows = {
            "states": f"{' x '.join(map(str, self.shape))}, of {self.dim} real numbers",
            "algebra": str(self.algebra),
            "Casimirs": f"{len(self.casimirs)}, traces of powers",
        }
        return html_table(self.name, {**rows, **({"forces": forces_text(self.forces)} if self.forces else {})})

    @property
    def fluid(self) -> Any:
        """The ideal fluid on a surface whose vorticity is the state, or the second of two fields; None by default."""
        return None

    def fluid_state(self, x: Any) -> Matrix:
        """Return the states of `fluid`, (..., N, N), of states."""
        return self.matrices(x)

    @property
    def energy_factor(self) -> float:
        """Factor of the energy before ``<P, W>/2``: its sign, in the unit of the energy."""
        return self.energy_sign * self.energy_unit

    @property
    def linear_stream(self) -> bool:
        """Whether the stream is known to be linear, which holds if no function is given for the energy."""
        return self.energy_function is None

    @cached_property
    def casimirs(self) -> dict[str, Any]:
        """Name to function of W, shape (..., N, N), or of its vectors: the traces of powers."""
        return dict(traces_of(self.algebra, self.powers, self.matrices, self.to_vector))

    @cached_property
    def in_numbers(self) -> MatrixSystem:
        """The same system with vectors as states, in the form of `to_vector`, for functions that need coordinates.

        A vector represents the nearest matrix of the algebra.
        """
        view = copy.copy(self)
        set_fields(view, shape=(self.dim,))
        view._unforced = self.unforced.in_numbers if self.forces else None
        view.__dict__["in_numbers"] = view
        return view

    def slope_of(self, W: Matrix, t: float = 0.0) -> Matrix:
        """Return stream(W) for matrices (..., N, N), without the constant term."""
        return applied(self.stream, W, t)

    def slope_transposed(self, Y: Matrix, t: float = 0.0) -> Matrix:
        """Return the transpose of the linear map `slope_of`, for the real inner product of entries."""
        return self.slope_of(Y, t)

    def stream_of(self, W: Any, t: float = 0.0) -> Matrix:
        """Return P = stream(W) + linear for matrices (..., N, N)."""
        P = self.slope_of(self.matrices(W), t)
        return P if self.linear is None else P + self.linear

    @property
    def quadratic_casimirs(self) -> tuple[str, ...]:
        """Names of the quadratic Casimirs for which runs record the work of forces: tr W^2 if there is one block."""
        return tuple(name for name in ("tr W^2", "Re tr W^2") if name in self.casimirs)

    def with_forces(self, *forces: Force) -> Self:
        if not self.linear_stream:
            # the kernels compute the energy of matrices from their stream
            raise ValueError(f"the energy of {self.name} is a user function; forces need a system without energy=")
        return super().with_forces(*forces)

    def _vector(self, x: Any) -> Floats:
        return super()._vector(x if self.is_in_numbers(x) else self.read(x, "x"))

    def bracket(self, Y: Matrix, X: Matrix) -> Matrix:
        """Return the commutator of states (..., N, N)."""
        return self.algebra.bracket(Y, X)

    def dual(self, Y: Matrix) -> Matrix:
        """Return the gradient of the pairing with an element of the algebra; its own inverse."""
        return self.algebra.dual(Y)

    def pairing(self, Y: Matrix, X: Matrix) -> Any:
        """Return the pairing of elements of the algebra with states (..., N, N)."""
        return self.algebra.pairing(Y, X)

    def vector_field(self, x: Any, t: float = 0.0) -> Matrix:
        """Return W' for matrices (..., N, N) or vectors, in the same form; with forces for one matrix."""
        if not self.forces:
            return self.hamiltonian_field(x, t)
        field = super().vector_field(x, t)
        return field if self.is_in_numbers(x) else self.from_vector(field)

    def hamiltonian_field(self, x: Any, t: float = 0.0) -> Matrix:
        W = self.matrices(x)
        commutator = self.bracket(self.stream_of(W, t), W)
        return self.to_vector(commutator) if self.is_in_numbers(x) else commutator

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return H of matrices (..., N, N) or of vectors."""
        W, pairing = self.matrices(x), self.pairing
        if self.energy_function is None:
            value = 0.5 * self.energy_factor * pairing(self.slope_of(W, t), W)
        else:
            time_argument = (t,) if self.timed else ()
            flat = [self.energy_function(part, *time_argument) for part in W.reshape(-1, *self.algebra.shape)]
            value = np.array(flat, dtype=np.float64).reshape(W.shape[:-2])
        if self.linear is not None:
            value = value + self.energy_factor * pairing(self.linear, W)
        return float(value) if np.ndim(value) == 0 else value

    def structure_matrix(self, x: Any) -> Floats:
        """Return J, (n, n), of a state as a vector: x' = J(x) grad H(x) on the algebra, zero on its complement."""
        check_available_memory(8 * 8 * self.dim**2, f"the structure matrix of {self.name}, of {self.dim} numbers,")
        return self._product(x, np.eye(self.dim)).T

    def _product(self, x: Any, u: Floats) -> Floats:
        """Return J(x) u for one vector u or several (k, n)."""
        return self.to_vector(self.bracket(self._of_gradient(u), self.matrices(x))) / self.energy_factor

    def product_derivative(self, x: Any, u: Floats) -> Floats:
        return self.to_vector(self.bracket(self._of_gradient(u), units_of(self))).T / self.energy_factor

    def _of_gradient(self, u: Floats) -> Matrix:
        """Return the element of the algebra for a gradient of the numbers of a state."""
        return self.dual(self.algebra.projected(self.from_vector(u)))

    def casimirs_at(self, x: Any) -> dict[str, Any]:
        """Return the traces of powers of matrices (..., N, N), or of vectors.

        If the algebra is skew-Hermitian these are traces of powers of -i W, which are real.
        """
        return values_of(self.casimirs, self.matrices(x))

    def spectrum(self, x: Any) -> npt.NDArray[Any]:
        """Return the eigenvalues of matrices (..., N, N), shape (..., N): of -i W, real and ascending, if W is
        skew-Hermitian; otherwise of W, complex, sorted by real and then by imaginary parts.

        Examples
        --------
        >>> from coadjoint.systems.matrices.streams import Weights
        >>> s = MatrixSystem(MatrixAlgebra("gl", 2), Weights([[1.0, 0.0], [0.0, 1.0]]))
        >>> s.spectrum([[1.0, 0.0], [2.0, -4.0]]).tolist()
        [(-4+0j), (1+0j)]
        """
        W = self.matrices(x)
        check_finite(W, "a state")
        if self.algebra.skew:
            return np.asarray(np.linalg.eigvalsh(-1j * W), dtype=np.float64)
        eigenvalues = np.linalg.eigvals(W).astype(np.complex128)
        size = DEGENERACY_TOLERANCE * (
            np.abs(eigenvalues).max(axis=-1, keepdims=True, initial=0.0) + np.finfo(float).tiny
        )
        order = np.lexsort((eigenvalues.imag, np.round(eigenvalues.real / size)), axis=-1)
        return np.take_along_axis(eigenvalues, order, axis=-1)

    def exact(self, x0: Any, t: Any, attitude: Any = False) -> Matrix:
        """Return the closed-form solution; raise TypeError if none is known, or for an attitude, which it never has."""
        if attitude is not False:
            raise TypeError(f"attitude is {short(attitude)}; the closed form of {self.name} has none")
        return np.asarray(require_closed_form(self.closed_form, self.name)(x0, t))

    def to_vector(self, W: Any) -> Floats:
        """Return matrices (..., N, N) as vectors: entry by entry, real and imaginary parts."""
        W = np.ascontiguousarray(W, dtype=np.complex128 if self.complex else np.float64)
        return W.view(np.float64).reshape(*W.shape[:-2], self.dim)

    def from_vector(self, x: Any) -> Matrix:
        """Return vectors as matrices."""
        numbers = np.ascontiguousarray(x, dtype=np.float64)
        lead = numbers.shape[:-1]
        return (numbers.view(np.complex128) if self.complex else numbers).reshape(*lead, *self.matrix_shape)

    def is_in_numbers(self, x: Any) -> bool:
        """Return whether states are vectors rather than matrices."""
        shape = to_array(self.states_by_label(x, "a state"), "a state", "iufc").shape
        return len(shape) > 0 and shape[-1] == self.dim

    def matrices(self, x: Any) -> Matrix:
        """Return matrices unchanged, and vectors as the nearest matrices of the algebra.

        Raises
        ------
        TypeError, ValueError
            Not numbers, or the wrong shape.
        """
        x = self.states_by_label(x, "a state")
        if self.is_in_numbers(x):
            return self.algebra.projected(self.from_vector(x), spared=TRACE_TOLERANCE)
        W = to_array(x, "a state", "iufc")
        if W.shape[-2:] != self.algebra.shape:
            raise ValueError(f"a state has the shape {W.shape}; it must be {self.algebra.shape}, or ({self.dim},)")
        if W.dtype.kind == "c" and not self.complex:
            raise ValueError(f"a state is complex; matrices of {self.algebra} are real")
        try:
            return W.astype(np.complex128 if self.complex else np.float64, copy=False)
        except (TypeError, ValueError, OverflowError):
            raise not_numbers_error(x, "a state") from None

    def read(self, given: Any, what: str = "x0") -> Floats:
        """Validate initial states, and return them as vectors: one for a state, several for members."""
        if self.shape == self.matrix_shape:
            return self.to_vector(self.read_matrices(given, what))
        rows = read_numbers(self.states_by_label(given, what), what)
        if rows.ndim not in (1, 2) or rows.shape[-1] != self.dim:
            raise ValueError(f"{what} has the shape {rows.shape}; it must be ({self.dim},) or (members, {self.dim})")
        check_finite(rows, what)
        return self.to_vector(self.algebra.projected(self.from_vector(rows), spared=TRACE_TOLERANCE))

    def read_matrices(self, given: Any, what: str) -> Matrix:
        """Validate initial states that are matrices, and return them."""
        return self.algebra.read(self.states_by_label(given, what), what)

    def states_of(self, rows: Floats) -> Matrix:
        """Return rows of numbers as states, which are matrices unless the system is `in_numbers`."""
        return self.from_vector(rows) if self.shape == self.matrix_shape else rows

    def rows_of(self, states: Matrix) -> Floats:
        """Return states as rows of numbers."""
        return self.to_vector(states) if self.shape == self.matrix_shape else states
