"""The Lie algebra: sparse structure constants and what they define on g and on its dual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.actions import actions, coadjoint_entries, neighbours, structure_operator
from coadjoint.algebra.constants import Triples, read_basis, read_brackets, read_constants
from coadjoint.algebra.exact import exact_numbers
from coadjoint.algebra.identities import antisymmetric, check_jacobi
from coadjoint.algebra.joins import Floats, Integers
from coadjoint.algebra.modular import structure_rank
from coadjoint.algebra.representation import check_representation

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator


class LieAlgebra:
    """A finite-dimensional real Lie algebra, [e_i, e_j] = sum_k c_ij^k e_k, given by its structure constants.

    The constants are stored sparse. Antisymmetry and the Jacobi identity are checked at construction, to 64 u times the
    sum of the absolute values of the products in each identity (u = 2^-53). The object does not change after that, and
    two algebras with equal constants are equal; names do not matter.

    Choose `LieAlgebra` for constants in an array or a list, `LieAlgebra.from_brackets` to write brackets down, and
    `coadjoint.algebras` for the known algebras.

    Parameters
    ----------
    constants : array of shape (n, n, n), or sequence of (i, j, k, c), or Triples
        ``constants[i, j, k]`` is c_ij^k; or the nonzero constants with indices from 0. In the sparse forms one order of
        each pair is enough; where both are given they must be opposite, in every component.
    dim : int, optional
        The dimension n; needed with the sparse forms.
    basis : sequence of str, optional
        Names of the basis elements; ``e1, e2, ...`` by default.
    name : str, optional
        Name of the algebra.
    representation : array of shape (n, d, d), optional
        Matrices rho_i with [rho_i, rho_j] = sum_k c_ij^k rho_k; checked.
    casimirs : mapping of str to Polynomial or Invariant, optional
        Known Casimir functions; kept as given.

    Raises
    ------
    TypeError, ValueError
        In one sentence that names the constant, pair, or triple of basis elements that is wrong.

    See Also
    --------
    coadjoint.algebra.catalogue : so(n), sl(2), e(3), Heisenberg, A_{3,7}.

    References
    ----------
    S. Reich, Numerical integration of the generalized Euler equations, equations (1)-(2).

    Examples
    --------
    >>> g = LieAlgebra([(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3, name="so(3)")
    >>> g
    LieAlgebra('so(3)', dim=3)
    >>> g.structure_matrix([1.0, 2.0, 3.0])
    array([[ 0.,  3., -2.],
           [-3.,  0.,  1.],
           [ 2., -1.,  0.]])
    """

    def __init__(
        self,
        constants: Any,
        *,
        dim: int | None = None,
        basis: Sequence[str] | None = None,
        name: str | None = None,
        representation: Any = None,
        casimirs: Mapping[str, Any] | None = None,
    ) -> None:
        self._dim, given, complete = read_constants(constants, dim)
        self._basis = read_basis(basis, self._dim)
        if name is not None and not isinstance(name, str):
            raise TypeError(f"name of a Lie algebra must be a string, not {name!r}")
        self._name = name
        triples = antisymmetric(given, self._dim, self._basis, complete)
        check_jacobi(triples, self._dim, self._basis)
        for column in triples:
            column.flags.writeable = False
        self._triples = triples
        if casimirs is not None and not isinstance(casimirs, Mapping):
            raise TypeError(f"casimirs must be a mapping from names to functions, not {type(casimirs).__name__}")
        self._casimirs = dict(casimirs or {})
        self._representation = (
            None if representation is None else check_representation(representation, triples, self._dim, self._basis)
        )

    @classmethod
    def from_brackets(
        cls,
        dim: int,
        brackets: Mapping[tuple[int, int], Mapping[int, float]],
        *,
        basis: Sequence[str] | None = None,
        name: str | None = None,
        representation: Any = None,
        casimirs: Mapping[str, Any] | None = None,
    ) -> LieAlgebra:
        """Build an algebra from its nonzero brackets.

        Parameters
        ----------
        dim : int
            The dimension.
        brackets : mapping
            ``{(i, j): {k: c}}`` says that [e_i, e_j] = sum_k c e_k; indices from 0. One order of each pair is enough.
        basis, name, representation, casimirs
            As for `LieAlgebra`.

        Returns
        -------
        LieAlgebra

        Raises
        ------
        TypeError, ValueError
            As for `LieAlgebra`.

        Examples
        --------
        >>> a = 2.0
        >>> g = LieAlgebra.from_brackets(3, {(0, 2): {0: a, 1: -1.0}, (1, 2): {0: 1.0, 1: a}})
        >>> g.bracket([1, 0, 0], [0, 0, 1])
        array([ 2., -1.,  0.])
        """
        rows = read_brackets(dim, brackets)
        return cls(rows, dim=dim, basis=basis, name=name, representation=representation, casimirs=casimirs)

    @property
    def dim(self) -> int:
        """Dimension n."""
        return self._dim

    @property
    def basis(self) -> tuple[str, ...]:
        """Names of the basis elements."""
        return self._basis

    @property
    def name(self) -> str | None:
        """Name of the algebra, or None."""
        return self._name

    @property
    def representation(self) -> Floats | None:
        """Matrices of the representation, shape (n, d, d), read-only; None where none was given."""
        return self._representation

    @property
    def casimirs_known(self) -> Mapping[str, Any]:
        """Casimirs given at construction, name -> Polynomial or Invariant; read-only."""
        return MappingProxyType(self._casimirs)

    @property
    def triples(self) -> Triples:
        """The nonzero constants (i, j, k, c) with i < j, sorted, each once; four read-only arrays."""
        return self._triples

    def __repr__(self) -> str:
        label = "" if self._name is None else f"{self._name!r}, "
        return f"LieAlgebra({label}dim={self._dim})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, LieAlgebra):
            return NotImplemented
        pairs = zip(self._triples, other._triples, strict=True)
        return self._dim == other._dim and all(np.array_equal(mine, theirs) for mine, theirs in pairs)

    def __hash__(self) -> int:
        return hash((self._dim, *(column.tobytes() for column in self._triples)))

    @cached_property
    def _exact_constants(self) -> NDArray[Any]:
        return exact_numbers(self._triples.c.tolist())

    def _vector(self, values: Any, what: str) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return a vector of g or g*, and the constants in the kind of number that goes with it."""
        vector = np.asarray(values)
        if vector.shape != (self._dim,):
            raise ValueError(f"{what} must have shape ({self._dim},), not {vector.shape}")
        if vector.dtype == object:
            return vector, self._exact_constants
        if vector.dtype.kind not in "iufc":
            raise TypeError(f"{what} must hold numbers, not {vector.dtype}")
        return vector.astype(np.result_type(vector.dtype, np.float64), copy=False), self._triples.c

    def structure_matrix(self, x: Any) -> NDArray[Any]:
        """Return J(x), J_ij = sum_k c_ij^k x_k: the Poisson bracket {F, G} = grad F . J(x) grad G (equation (2)).

        Parameters
        ----------
        x : (n,) array
            Point of the dual. With dtype object (Fraction, mpmath) the result is exact or multiprecision too.

        Returns
        -------
        (n, n) array, skew-symmetric

        Raises
        ------
        TypeError, ValueError
            x does not hold numbers, or has another shape.

        See Also
        --------
        structure_operator : the same without an n x n array.

        Examples
        --------
        >>> LieAlgebra([(0, 1, 1, 1.0)], dim=2).structure_matrix([5.0, 7.0])
        array([[ 0.,  7.],
               [-7.,  0.]])
        """
        point, constants = self._vector(x, "x")
        i, j, k, _ = self._triples
        matrix = np.zeros((self._dim, self._dim), dtype=point.dtype)
        entries = constants * point[k]
        np.add.at(matrix, (i, j), entries)
        np.subtract.at(matrix, (j, i), entries)
        return matrix

    def bracket(self, u: Any, v: Any) -> NDArray[Any]:
        """Return the Lie bracket [u, v] = sum_ijk u_i v_j c_ij^k e_k.

        Parameters
        ----------
        u, v : (n,) arrays
            Elements of the algebra; dtype object is allowed.

        Returns
        -------
        (n,) array

        Raises
        ------
        TypeError, ValueError
            u or v does not hold numbers, or has another shape.

        Examples
        --------
        >>> LieAlgebra([(0, 1, 1, 1.0)], dim=2).bracket([1, 2], [3, 4])
        array([ 0., -2.])
        """
        left, constants = self._vector(u, "u")
        right, others = self._vector(v, "v")
        if right.dtype == object and left.dtype != object:
            left, constants = exact_numbers(left.tolist()), others
        elif left.dtype == object and right.dtype != object:
            right = exact_numbers(right.tolist())
        i, j, k, _ = self._triples
        entries = constants * (left[i] * right[j] - left[j] * right[i])
        result = np.zeros(self._dim, dtype=np.result_type(left.dtype, right.dtype))
        np.add.at(result, k, entries)
        return result

    def coadjoint(self, u: Any) -> NDArray[Any]:
        """Return the matrix D_u of the coadjoint action: D_u x = J(x) u, (D_u)_jk = sum_i u_i c_ji^k.

        Parameters
        ----------
        u : (n,) array
            Element of the algebra; dtype object is allowed.

        Returns
        -------
        (n, n) array

        Raises
        ------
        TypeError, ValueError
            u does not hold numbers, or has another shape.

        See Also
        --------
        coadjoint_entries : the same, sparse.

        Examples
        --------
        >>> LieAlgebra([(0, 1, 1, 1.0)], dim=2).coadjoint([1.0, 0.0])
        array([[ 0.,  0.],
               [ 0., -1.]])
        """
        vector, constants = self._vector(u, "u")
        i, j, k, _ = self._triples
        matrix = np.zeros((self._dim, self._dim), dtype=vector.dtype)
        np.add.at(matrix, (i, k), constants * vector[j])
        np.subtract.at(matrix, (j, k), constants * vector[i])
        return matrix

    @cached_property
    def _actions(self) -> tuple[Integers, Triples]:
        """The entries (i, row, column, value) of every D_{e_i}, sorted, and where each i begins."""
        return actions(self._triples, self._dim)

    def coadjoint_entries(self, u: Any) -> tuple[Integers, Integers, NDArray[Any]]:
        """Return the nonzero entries of D_u.

        Parameters
        ----------
        u : (n,) array, or mapping of index to number
            Element of the algebra; dtype object is allowed. A mapping {i: u_i} costs only what its entries cost.

        Returns
        -------
        rows, columns : (m,) integer arrays
            Sorted by row, then column; each position once.
        values : (m,) array
            Entries; what cancels to exactly zero is left out.

        Raises
        ------
        TypeError, ValueError
            u does not hold numbers, has another shape, or an index out of range.

        Examples
        --------
        >>> g = LieAlgebra([(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3)
        >>> [part.tolist() for part in g.coadjoint_entries({2: 2.0})]
        [[0, 1], [1, 0], [-2.0, 2.0]]
        """
        if isinstance(u, Mapping):
            wrong = [
                i for i in u if isinstance(i, bool) or not isinstance(i, int | np.integer) or not 0 <= i < self._dim
            ]
            if wrong:
                raise ValueError(f"index {wrong[0]!r} of u must be an integer from 0 to {self._dim - 1}")
            indices = np.array(sorted(u), dtype=np.int64)
            coefficients = np.array([u[i] for i in sorted(u)]) if u else np.zeros(0)
            if coefficients.dtype != object and coefficients.dtype.kind not in "iufc":
                raise TypeError(f"u must hold numbers, not {coefficients.dtype}")
        else:
            vector, _ = self._vector(u, "u")
            indices = np.flatnonzero(vector != 0).astype(np.int64)
            coefficients = vector[indices]
        return coadjoint_entries(*self._actions, indices, coefficients)

    def structure_operator(self, x: Any) -> LinearOperator:
        """Return J(x) as a SciPy linear operator that holds no n x n array; for large n.

        Parameters
        ----------
        x : (n,) real array
            Point of the dual.

        Returns
        -------
        scipy.sparse.linalg.LinearOperator of shape (n, n)

        Raises
        ------
        TypeError, ValueError
            x does not hold real numbers, or has another shape.

        Examples
        --------
        >>> g = LieAlgebra([(0, 1, 1, 1.0)], dim=2)
        >>> g.structure_operator([5.0, 7.0]) @ np.array([0.0, 1.0])
        array([7., 0.])
        """
        point, _ = self._vector(x, "x")
        if point.dtype.kind != "f":
            raise TypeError(f"x must hold real floats, not {point.dtype}: use structure_matrix for other numbers")
        return structure_operator(self._triples, point)

    def generic_rank(self) -> int:
        """Return the rank of J(x) at a generic x; ``dim - rank`` is the number of independent Casimirs.

        Exact in whole numbers: the constants, floats and so rational numbers over powers of two, are taken modulo the
        prime p = 2^61 - 1, and the rank is the largest at three random points (seeded: the same answer every time).
        A minor of degree at most n that is not the zero polynomial modulo p vanishes at a random point with probability
        at most n/p (Schwartz and Zippel), so all three points fail with probability at most (n/p)^3, below 2^-60 for
        every n < 2^41. The answer is never too large; it is too small for every point only if p divides all the largest
        minors, as polynomials.

        Returns
        -------
        int, even

        Examples
        --------
        >>> LieAlgebra([(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3).generic_rank()
        2
        """
        return self._rank

    @cached_property
    def _rank(self) -> int:
        return structure_rank(*self._triples, dim=self._dim, points=3, seed=0)

    @cached_property
    def _neighbours(self) -> tuple[Integers, Integers]:
        return neighbours(self._triples, self._dim)

    def neighbours(self) -> tuple[Integers, Integers]:
        """Return, for each basis element, those that do not commute with it, in compressed sparse rows.

        Returns
        -------
        indptr : (n + 1,) integer array, read-only
        indices : integer array, read-only
            ``indices[indptr[i]:indptr[i + 1]]`` are the j with [e_i, e_j] != 0, sorted.

        Examples
        --------
        >>> [part.tolist() for part in LieAlgebra([(0, 2, 0, 1.0)], dim=3).neighbours()]
        [[0, 1, 1, 2], [2, 0]]
        """
        return self._neighbours

    def commuting(self, i: int, j: int) -> bool:
        """Say whether [e_i, e_j] = 0.

        Parameters
        ----------
        i, j : int
            Indices of basis elements, from 0.

        Returns
        -------
        bool

        Raises
        ------
        ValueError
            An index is out of range.

        Examples
        --------
        >>> g = LieAlgebra([(0, 2, 0, 1.0)], dim=3)
        >>> g.commuting(0, 1), g.commuting(2, 0)
        (True, False)
        """
        for index in (i, j):
            if not 0 <= index < self._dim:
                raise ValueError(f"index {index!r} of a basis element must be from 0 to {self._dim - 1}")
        indptr, indices = self._neighbours
        row = indices[indptr[i] : indptr[i + 1]]
        at = int(np.searchsorted(row, j))
        return not (at < row.size and row[at] == j)
