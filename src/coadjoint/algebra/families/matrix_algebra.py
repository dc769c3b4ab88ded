"""Lie algebras whose elements are stored as matrices, without structure constants: classical ones and their sums."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import not_numbers_error, read_choice, read_integer, read_title, to_array

SUM = "sum"
MAX_MATRIX_SIZE = 4096
MEMBERSHIP_TOLERANCE = 64 * UNIT_ROUNDOFF
"""Relative rounding tolerance, times N and the largest entry, of membership in the algebra."""
TRACE_TOLERANCE = 8 * UNIT_ROUNDOFF

Matrix = npt.NDArray[Any]


class MatrixFamily(NamedTuple):
    """A family of matrix Lie algebras: A with ``adjoint(A) = -A``, of trace zero if `traceless`."""

    # `form` is "diagonal" (signs on the diagonal), "symplectic", or "" for all matrices. With `conjugate` the adjoint
    # conjugates entries.

    complex: bool
    form: str
    conjugate: bool
    traceless: bool
    description: str

    @property
    def even(self) -> bool:
        """Whether traces of odd powers vanish."""
        return self.form != "" and not self.conjugate

    @property
    def has_complex_traces(self) -> bool:
        """Whether traces are complex, each giving two invariants: the complex form itself."""
        return self.complex and not self.conjugate

    def dim(self, N: int) -> int:
        count = N * N - self.traceless
        if self.even:
            count = N * (N - 1) // 2 if self.form == "diagonal" else N * (N + 1) // 2
        return count * (1 + self.has_complex_traces)

    def rank(self, N: int) -> int:
        """Return the number of independent Casimirs."""
        return (N // 2 if self.even else N - self.traceless) * (1 + self.has_complex_traces)

    def adjoint(self, A: Matrix, q: int) -> Matrix:
        """Return the adjoint, ``J^-1 A^T J``, conjugated if `conjugate`; the last `q` signs are negative."""
        N, result = A.shape[-1], np.swapaxes(A, -1, -2)
        signs = np.ones(N)
        if self.form == "symplectic":
            order = np.roll(np.arange(N), N // 2)
            signs[N // 2 :] = -1.0
            result = result[..., order[:, None], order]
        else:
            signs[N - q :] = -1.0
        if self.conjugate:
            result = np.conj(result)
        return result if (signs > 0).all() else np.outer(signs, signs) * result


KINDS = {
    "u": MatrixFamily(True, "diagonal", True, False, "skew-Hermitian"),
    "su": MatrixFamily(True, "diagonal", True, True, "skew-Hermitian, of trace zero"),
    "so": MatrixFamily(False, "diagonal", False, False, "real and skew"),
    "gl": MatrixFamily(False, "", False, False, "real"),
    "sl": MatrixFamily(False, "", False, True, "real, of trace zero"),
    "sp": MatrixFamily(False, "symplectic", False, False, "real, with W^T J + J W = 0, J = [[0, 1], [-1, 0]]"),
    "gl(C)": MatrixFamily(True, "", False, False, "complex"),
    "sl(C)": MatrixFamily(True, "", False, True, "complex, of trace zero"),
    "so(C)": MatrixFamily(True, "diagonal", False, False, "complex, with W^T = -W"),
    "sp(C)": MatrixFamily(True, "symplectic", False, False, "complex, with W^T J + J W = 0, J = [[0, 1], [-1, 0]]"),
}
INDEFINITE_KINDS = ("u", "su", "so")
"""Kinds that exist for forms of any signature."""


@suggest_keywords
@dataclass(frozen=True)
class MatrixAlgebra:
    """Matrices with the commutator ``[A, B] = A B - B A``: a classical Lie algebra, or a block-diagonal sum.

    Choose it when structure constants would not fit in memory: u(512) has about 2 N^3 of them. An invariant pairing
    identifies the algebra with its dual: ``<A, B> = Re tr(A* B)`` if the algebra is skew, else ``Re tr(A B)``.

    Parameters
    ----------
    kind : {"u", "su", "so", "gl", "sl", "sp", "gl(C)", "sl(C)", "so(C)", "sp(C)"}
        Skew-Hermitian; skew-Hermitian and traceless; real skew-symmetric; all real matrices; real traceless;
        Hamiltonian, W^T J + J W = 0 with ``J = [[0, 1], [-1, 0]]``; the last four are the complex forms.
    N : int
        Rows and columns, from 2 to 4096; for "sp" and "sp(C)" an even number.
    q : int
        For "u", "su" and "so": number of negative signs of the form, placed last: u(p, q) with p = N - q.
    blocks : tuple of MatrixAlgebra
        Blocks of a direct sum; construct one with `sum`.

    Raises
    ------
    TypeError, ValueError
        Unknown kind, or invalid size.

    Examples
    --------
    >>> g = MatrixAlgebra("su", 3)
    >>> g.shape, g.complex, g.dim
    ((3, 3), True, 8)
    >>> print(MatrixAlgebra("so", 4, q=1), MatrixAlgebra.sum(g, MatrixAlgebra("sp", 4)))
    so(3, 1) su(3) + sp(4, R)
    """

    kind: str
    N: int
    q: int = 0
    blocks: tuple[MatrixAlgebra, ...] = ()

    def __post_init__(self) -> None:
        if isinstance(self.kind, str) and self.kind == SUM:
            self._check_blocks()
            return
        kind, N = read_choice(self.kind, "kind", KINDS), read_integer(self.N, "N", 2, MAX_MATRIX_SIZE)
        q = read_integer(self.q, "q", 0, N)
        if N % 2 and KINDS[kind].form == "symplectic":
            raise ValueError(f"N is {N}; it must be even for {kind}")
        if q and kind not in INDEFINITE_KINDS:
            raise ValueError(
                f"q is {q}; {kind} has no negative signs, so q must be 0; {', '.join(INDEFINITE_KINDS)} accept others"
            )
        if not isinstance(self.blocks, tuple) or self.blocks:
            raise ValueError(f"blocks is {short(self.blocks)} for a single algebra; use MatrixAlgebra.sum for a sum")
        for name, value in (("kind", kind), ("N", N), ("q", q)):
            object.__setattr__(self, name, value)

    def _check_blocks(self) -> None:
        blocks = self.blocks
        if not isinstance(blocks, tuple) or len(blocks) < 2 or not all(isinstance(b, MatrixAlgebra) for b in blocks):
            raise TypeError(f"blocks is {short(blocks)}; give a tuple of two MatrixAlgebras or more")
        size = sum(block.N for block in blocks)
        if size > MAX_MATRIX_SIZE or self.N != size or self.q != 0:
            raise ValueError(
                f"blocks have {size} rows together; they must have N of them, {MAX_MATRIX_SIZE} at most, and q = 0"
            )

    @classmethod
    def sum(cls, *algebras: MatrixAlgebra) -> MatrixAlgebra:
        """Return the algebra of block-diagonal matrices with the given algebras as blocks.

        Parameters
        ----------
        *algebras : MatrixAlgebra
            Two or more; sums are flattened.

        Returns
        -------
        MatrixAlgebra

        Examples
        --------
        >>> g = MatrixAlgebra.sum(MatrixAlgebra("so", 3), MatrixAlgebra("so", 3), MatrixAlgebra("gl", 2))
        >>> g.N, g.dim, g.skew
        (8, 10, False)
        """
        if not all(isinstance(algebra, MatrixAlgebra) for algebra in algebras):
            raise TypeError(f"algebras are {short(algebras)}; all must be MatrixAlgebras")
        blocks = tuple(block for algebra in algebras for block in algebra.blocks or (algebra,))
        return cls(SUM, sum(block.N for block in blocks), 0, blocks)

    def __str__(self) -> str:
        if self.kind == SUM:
            return " + ".join(map(str, self.blocks))
        name, _, field = self.kind.partition("(")
        size = f"{self.N - self.q}, {self.q}" if self.q else str(self.N)
        return f"{name}({size}{', C' if field else '' if name in INDEFINITE_KINDS else ', R'})"

    @property
    def name(self) -> str:
        """The name, such as "su(3)"."""
        return str(self)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (N, N) of a matrix."""
        return self.N, self.N

    @property
    def parts(self) -> Iterator[tuple[slice, MatrixAlgebra, MatrixFamily]]:
        """The diagonal blocks as (slice, algebra, kind); a single one unless the algebra is a sum."""
        first = 0
        for block in self.blocks or (self,):
            yield slice(first, first + block.N), block, KINDS[block.kind]
            first += block.N

    @cached_property
    def complex(self) -> bool:
        """Whether entries are complex."""
        return any(kind.complex for _, _, kind in self.parts)

    @cached_property
    def skew(self) -> bool:
        """Whether all matrices are skew-Hermitian: u(N), su(N), so(N), and sums of these."""
        return all(block.kind in INDEFINITE_KINDS and not block.q for _, block, _ in self.parts)

    @cached_property
    def dim(self) -> int:
        """The real dimension: the number of independent real numbers in an element."""
        return sum(kind.dim(block.N) for _, block, kind in self.parts)

    @cached_property
    def rank(self) -> int:
        """Number of independent Casimirs."""
        return sum(kind.rank(block.N) for _, block, kind in self.parts)

    def generic_rank(self) -> int:
        """Return the dimension of a generic orbit."""
        return self.dim - self.rank

    @property
    def basis(self) -> tuple[str, ...]:
        """Names of the real numbers that store a matrix, row by row."""
        parts = ("re", "im") if self.complex else ("",)
        return tuple(f"{part}{i},{j}" for i in range(self.N) for j in range(self.N) for part in parts)

    def bracket(self, A: Matrix, B: Matrix) -> Matrix:
        """Return the commutator.

        Examples
        --------
        >>> E = np.array([[0.0, 1.0], [-1.0, 0.0]])
        >>> bool((MatrixAlgebra("so", 2).bracket(E, 2 * E) == 0.0).all())
        True
        """
        return A @ B - B @ A

    def pairing(self, A: Matrix, B: Matrix) -> Any:
        """Return <A, B> of matrices (..., N, N), invariant: <[A, B], C> = <A, [B, C]>.

        Examples
        --------
        >>> E = np.array([[0.0, 1.0], [-1.0, 0.0]])
        >>> float(MatrixAlgebra("so", 2).pairing(E, E)), float(MatrixAlgebra("gl", 2).pairing(E, E))
        (2.0, -2.0)
        """
        products = np.real(np.conj(self.dual(A)) * B) if self.complex else self.dual(A) * B
        return products.reshape(*products.shape[:-2], self.N**2).sum(axis=-1)

    def dual(self, A: Matrix) -> Matrix:
        """Return D with <A, B> = Re(sum of conj(D) * B over the entries) for every B of the algebra."""
        return A if self.skew else np.conj(np.swapaxes(A, -1, -2))

    def projected(self, A: Matrix, spared: float = 0.0) -> Matrix:
        """Return the nearest element of the algebra.

        Parameters
        ----------
        A : ndarray, shape (..., N, N)
            Matrices.
        spared : float
            Relative to the largest entry: in traceless algebras, a mean of the diagonal up to this size is kept, since
            repeated removal of round-off would change the last bits of a state that is already in the algebra.

        Returns
        -------
        ndarray
            The projection, complex128 or float64.

        Examples
        --------
        >>> MatrixAlgebra("su", 2).projected(np.array([[1j, 2.0], [0.0, 3j]]))
        array([[ 0.-1.j,  1.+0.j],
               [-1.+0.j,  0.+1.j]])
        >>> MatrixAlgebra("sp", 2).projected(np.array([[1.0, 2.0], [3.0, 4.0]]))
        array([[-1.5,  2. ],
               [ 3. ,  1.5]])
        """
        A = np.asarray(A, dtype=np.complex128 if self.complex else None)
        if not self.complex and np.iscomplexobj(A):
            A = np.ascontiguousarray(A.real)
        result = np.zeros(A.shape, dtype=np.complex128 if self.complex else np.float64)
        for rows, block, kind in self.parts:
            part = A[..., rows, rows]
            part = part if kind.complex else part.real
            if kind.form:
                part = (part - kind.adjoint(part, block.q)) / 2
            if kind.traceless:
                mean = np.trace(part, axis1=-2, axis2=-1) / block.N
                mean = np.where(np.abs(mean) > spared * np.abs(part).max(axis=(-2, -1), initial=0.0), mean, 0.0)
                part = part - mean[..., None, None] * np.eye(block.N)
            result[..., rows, rows] = part
        return result

    def read(self, given: Any, what: str = "x0", beside: npt.ArrayLike = 0.0) -> Matrix:
        """Validate matrices of the algebra and project them onto it exactly.

        Parameters
        ----------
        given : array_like, shape (N, N) or (members, N, N)
            Matrices to validate.
        what : str
            Argument name used in messages.
        beside : float or (members,) array
            Largest entries of matrices that act on these, whose rounding they have.

        Returns
        -------
        ndarray
            A copy, complex128 or float64.

        Raises
        ------
        TypeError, ValueError
            Not finite, of another size, or not in the algebra.
        """
        what = read_title(what, "what")
        array = to_array(given, what, "iufc")
        if array.shape[-2:] != self.shape or array.ndim > 3:
            raise ValueError(
                f"{what} has the shape {array.shape}; it must be {self.shape} or (members, {self.N}, {self.N})"
            )
        try:
            A = array.astype(np.complex128)
        except OverflowError:
            raise ValueError(f"{what} holds a number that is too large for float64") from None
        except (TypeError, ValueError):
            raise not_numbers_error(given, what) from None
        if not np.isfinite(A).all():
            raise ValueError(f"{what} contains NaN or infinity; every entry must be finite")
        near = self.projected(A, spared=TRACE_TOLERANCE)
        away, size = (np.abs(B).max(axis=(-2, -1), initial=0.0).reshape(-1) for B in (A - near, A))
        wrong = np.flatnonzero(away > MEMBERSHIP_TOLERANCE * self.N * np.maximum(size, beside))
        if len(wrong):
            member = wrong[0]
            label = f"{what}[{member}]" if A.ndim == 3 else what
            raise ValueError(
                f"{label} is not a matrix of {self}: it must be {self.description}, but differs by {away[member]:.2g} "
                f"where its largest entry is {size[member]:.2g}"
            )
        return near

    @property
    def description(self) -> str:
        """Description of its matrices, for messages."""
        if self.blocks:
            return "block by block " + ", ".join(f"of {block}" for block in self.blocks) + ", and zero beside"
        signs = f", times the signs of {self.N - self.q} and {self.q}" if self.q else ""
        return KINDS[self.kind].description + signs
