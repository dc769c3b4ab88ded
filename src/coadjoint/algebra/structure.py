"""Operations defined by structure constants: J(x), brackets, the coadjoint action, ranks, Casimirs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples, both_orders
from coadjoint.algebra.exact.elimination import generic_rank
from coadjoint.algebra.exact.numbers import exact_numbers
from coadjoint.algebra.exact.sparse_sums import Floats, Integers, expand, groups, strongly_connected
from coadjoint.algebra.polynomials.monomials import names_of_basis
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.caching import cached_if_small
from coadjoint.long_operations import warn_caller
from coadjoint.memory import check_available_memory
from coadjoint.validation import not_numbers_error, read_integer, to_array

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

    from coadjoint.algebra.invariants.casimirs import Casimirs


class Structure:
    """Operations of the structure constants; a subclass sets `_dim`, names, and `_triples`, sorted, unique, i < j."""

    _dim: int
    _triples: Triples
    _casimirs: dict[str, Any]
    basis: Any

    @cached_property
    def _exact_constants(self) -> NDArray[Any]:
        return exact_numbers(self._triples.c.tolist())

    def _vector(self, values: Any, what: str) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return a vector of g or g*, and the constants converted to its number type."""
        vector = to_array(values, what, "iufc")
        if vector.shape != (self._dim,):
            raise ValueError(f"{what} must have shape ({self._dim},), not {vector.shape}")
        if vector.dtype == object:
            return vector, self._exact_constants
        return vector.astype(np.result_type(vector.dtype, np.float64), copy=False), self._triples.c

    def _zeros(self, dtype: Any, what: str) -> NDArray[Any]:
        """Return an (n, n) array of zeros after a memory check."""
        need = self._dim**2 * np.dtype(dtype).itemsize + 24 * self._triples.c.size
        check_available_memory(need, f"{what} of dimension {self._dim}", "take the sparse entries, or the operator")
        return np.zeros((self._dim, self._dim), dtype=dtype)

    def _product(self, x: Floats, u: Floats) -> Floats:
        """Return J(x) u without the matrix."""
        i, j, k, c = self._triples
        first, second = np.bincount(i, c * x[k] * u[j], self._dim), np.bincount(j, c * x[k] * u[i], self._dim)
        return np.asarray(first - second, dtype=np.float64)

    def _rounded_product(self, x: Floats, u: Floats) -> Floats:
        """Return 2^12 times the sums of the absolute terms of J(x) u: constants and coefficients may be rounded."""
        i, j, k, c = self._triples
        terms = 2.0**12 * np.abs(c * x[k])
        first, second = np.bincount(i, terms * np.abs(u[j]), self._dim), np.bincount(j, terms * np.abs(u[i]), self._dim)
        return np.asarray(first + second, dtype=np.float64)

    def structure_matrix(self, x: Any) -> NDArray[Any]:
        """Return J(x), ``J_ij = sum_k c_ij^k x_k``: the Poisson bracket ``{F, G} = grad F . J(x) grad G``.

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
        >>> import coadjoint as co
        >>> co.LieAlgebra([(0, 1, 1, 1.0)], dim=2).structure_matrix([5.0, 7.0])
        array([[ 0.,  7.],
               [-7.,  0.]])
        """
        point, constants = self._vector(x, "x")
        i, j, k, _ = self._triples
        matrix = self._zeros(point.dtype, "the structure matrix")
        entries = constants * point[k]
        np.add.at(matrix, (i, j), entries)
        np.subtract.at(matrix, (j, i), entries)
        return matrix

    def bracket(self, u: Any, v: Any) -> NDArray[Any]:
        """Return the Lie bracket ``[u, v] = sum_ijk u_i v_j c_ij^k e_k``.

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
        >>> import coadjoint as co
        >>> co.LieAlgebra([(0, 1, 1, 1.0)], dim=2).bracket([1, 2], [3, 4])
        array([ 0., -2.])
        """
        left, constants = self._vector(u, "u")
        right, right_constants = self._vector(v, "v")
        if right.dtype == object and left.dtype != object:
            left, constants = exact_numbers(left.tolist()), right_constants
        elif left.dtype == object and right.dtype != object:
            right = exact_numbers(right.tolist())
        i, j, k, _ = self._triples
        entries = constants * (left[i] * right[j] - left[j] * right[i])
        result = np.zeros(self._dim, dtype=np.result_type(left.dtype, right.dtype))
        np.add.at(result, k, entries)
        return result

    def coadjoint(self, u: Any) -> NDArray[Any]:
        """Return the matrix D_u of the coadjoint action: ``D_u x = J(x) u``, ``(D_u)_jk = sum_i u_i c_ji^k``.

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
        >>> import coadjoint as co
        >>> co.LieAlgebra([(0, 1, 1, 1.0)], dim=2).coadjoint([1.0, 0.0])
        array([[ 0.,  0.],
               [ 0., -1.]])
        """
        vector, constants = self._vector(u, "u")
        i, j, k, _ = self._triples
        matrix = self._zeros(vector.dtype, "the matrix of the coadjoint action")
        np.add.at(matrix, (i, k), constants * vector[j])
        np.subtract.at(matrix, (j, k), constants * vector[i])
        return matrix

    @cached_if_small
    def actions(self) -> tuple[Integers, Triples]:
        """Return starts and sorted entries (i, row, column, value) of all matrices D_{e_i}; read-only."""
        both = both_orders(self._triples)  # (D_{e_i})_jk = c_ji^k
        order, _ = groups(both.j, both.i, both.k)
        element = both.j[order]
        starts = np.searchsorted(element, np.arange(self._dim + 1)).astype(np.int64)
        return starts, Triples(element, both.i[order], both.k[order], both.c[order])

    def coadjoint_entries(self, u: Any) -> tuple[Integers, Integers, NDArray[Any]]:
        """Return sorted rows, columns and values of the nonzero entries of D_u; u is (n,) or a mapping {i: u_i}."""
        if isinstance(u, Mapping):
            for i in u:
                read_integer(i, "an index of u", 0, self._dim - 1)
            indices = np.array(sorted(u), dtype=np.int64)
            coefficients = to_array([u[i] for i in sorted(u)], "u", "iufc") if u else np.zeros(0)
            if coefficients.ndim != 1:
                raise not_numbers_error(list(u.values()), "u")
        else:
            vector, _ = self._vector(u, "u")
            indices = np.flatnonzero(vector != 0).astype(np.int64)
            coefficients = vector[indices]
        starts, entries = self.actions
        element, index = expand(starts[indices], starts[indices + 1])
        constants = exact_numbers(entries.c[index].tolist()) if coefficients.dtype == object else entries.c[index]
        products = coefficients[element] * constants
        rows, columns = entries.j[index], entries.k[index]
        order, first = groups(rows, columns)
        values = np.add.reduceat(products[order], first) if order.size else products
        nonzero = np.asarray(values != 0, dtype=bool)
        representatives = order[first][nonzero]
        return rows[representatives], columns[representatives], values[nonzero]

    def structure_operator(self, x: Any) -> LinearOperator:
        """Return J(x) as a SciPy linear operator without an n x n array, for large n."""
        from scipy.sparse.linalg import LinearOperator

        point, _ = self._vector(x, "x")
        if point.dtype.kind != "f":
            raise TypeError(f"x must hold real floats, not {point.dtype}: use structure_matrix for other numbers")
        i, j, k, c = self._triples
        entries, n = c * point[k], point.size

        def apply(v: Any) -> Any:
            flat = np.asarray(v).reshape(n)
            result = np.zeros(n, dtype=np.result_type(flat.dtype, entries.dtype))
            np.add.at(result, i, entries * flat[j])
            np.subtract.at(result, j, entries * flat[i])
            return result

        return LinearOperator((n, n), matvec=apply, rmatvec=lambda v: -apply(v), dtype=entries.dtype)

    def generic_rank(self) -> int:
        """Return the rank of J(x) at a generic x; ``dim - rank`` is the number of independent Casimirs.

        Constants are interpreted as simple fractions (q <= 10^6), or as exact floats. If they then fulfil the Jacobi
        identity exactly, the rank is the larger of two, modulo random 62-bit primes at seeded random points: never too
        large, and too small with probability below 2^-60 (Schwartz and Zippel; `coadjoint.algebra.exact.elimination`).
        For constants known only to round-off, singular values decide the rank.

        Returns
        -------
        int, even

        Raises
        ------
        ValueError
            The constants are rounded, and the singular values leave no clear gap.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.LieAlgebra([(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3).generic_rank()
        2
        """
        return self._rank

    @cached_property
    def _rank(self) -> int:
        return generic_rank(self._triples, self._dim)

    @cached_if_small
    def factors(self) -> Integers:
        """Numbers of the factors of the coordinates: equal where brackets with basis elements lead from either to the
        other; read-only.

        These are the finest sets between successive ideals that basis elements span, by their first coordinates.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.algebras.e(3).factors.tolist(), co.algebras.heisenberg(1).factors.tolist()
        ([0, 0, 0, 1, 1, 1], [0, 1, 2])
        """
        i, j, k, _ = self._triples
        labels = strongly_connected(self._dim, np.concatenate([i, j]), np.concatenate([k, k]))
        numbers: Integers = np.unique(labels, return_inverse=True)[1].reshape(-1)
        numbers.flags.writeable = False
        return numbers

    @cached_if_small
    def _neighbours(self) -> tuple[Integers, Integers]:
        first, second, _, _ = both_orders(self._triples)
        order, starts = groups(first, second)
        first, indices = first[order[starts]], second[order[starts]]
        indptr = np.searchsorted(first, np.arange(self._dim + 1)).astype(np.int64)
        for column in (indptr, indices):
            column.flags.writeable = False
        return indptr, indices

    def neighbours(self) -> tuple[Integers, Integers]:
        """Return the noncommuting pairs of basis elements in compressed sparse rows (indptr, indices), read-only."""
        return self._neighbours

    def commuting(self, i: int, j: int) -> bool:
        """Return whether [e_i, e_j] = 0."""
        i, j = (read_integer(index, "the index of a basis element", 0, self._dim - 1) for index in (i, j))
        indptr, indices = self._neighbours
        row = indices[indptr[i] : indptr[i + 1]]
        position = int(np.searchsorted(row, j))
        return not (position < row.size and row[position] == j)

    def casimirs(self, max_degree: int = 4) -> Casimirs:
        """Find Casimirs C, J(x) grad C(x) = 0, from the structure constants alone.

        The homogeneous polynomial solutions of each degree form a linear space. A basis of it modulo the products of
        Casimirs of lower degree is returned. So every polynomial Casimir up to `max_degree` is a polynomial in the
        ones returned. For this they can be more than the ``dim - generic_rank()`` independent ones, with relations
        between them: A5,2 has C1 ... C4 for three, since C4 is a quotient of polynomials in the others. The attribute
        `independent` names as many as are functionally independent.

        If these are fewer than the corank, Casimirs that are not polynomials are added: quotients, sums of logarithms,
        quotients and angles of semi-invariants up to `max_degree`, polynomials P with J(x) grad P = chi P, chi
        constant. Algebras with a diagonal or triangular action on an ideal have such. They are found if the constants
        fulfil the Jacobi identity exactly, as simple fractions or as floats, and eigenvalues are rational, or pairs of
        rational real and imaginary parts, in a summand of at most 250 monomials of a degree. If some are still missing,
        one warning states how many, and how to give them to a system.

        If the constants round simple fractions (`coadjoint.algebra.exact.elimination`), the equations are solved
        exactly and every solution is verified in exact arithmetic. Otherwise singular values decide if they leave a
        clear gap (`coadjoint.algebra.invariants.casimir_equations`), and the coefficients are floats. Direct summands
        visible in the basis are solved separately, equal ones once.

        Parameters
        ----------
        max_degree : int, optional
            Largest degree, from 1.

        Returns
        -------
        dict of str to Polynomial or Invariant
            Polynomials by degree and leading monomial: ``"C2"`` if there is one of degree 2, ``"C2_1", "C2_2"`` if
            there are two. Those of one degree are the rows of a reduced row echelon form over the monomials in the
            order of `Polynomial.monomials`, scaled to coprime integers with a positive leading one; in floats the
            leading coefficient is 1. Then others, ``"I"`` or ``"I1", "I2", ...``, NaN where undefined.
            The dict has the attributes `corank`, the number of independent Casimirs of any kind; `independent`, names
            of independent ones among those found; `missing`, the difference; and `sentence`, which ends the repr of an
            empty or incomplete result.

        Warns
        -----
        UserWarning
            Fewer independent Casimirs were found than there are. Systems search without warning.

        Raises
        ------
        ValueError
            `max_degree` is not a whole number from 1 up; a degree has more than 40 000 monomials in a summand, or more
            coupled ones than fit a dense matrix; or rounded constants leave no clear gap.

        See Also
        --------
        casimirs_known : Casimirs given with the algebra, of any kind.
        generic_rank : for the number of independent Casimirs.

        References
        ----------
        S. Reich, Numerical integration of the generalized Euler equations, section 2.

        Examples
        --------
        >>> import coadjoint as co
        >>> co.algebras.so(4).casimirs()
        {'C2_1': x1^2 + x2^2 + x3^2 + x4^2 + x5^2 + x6^2, 'C2_2': x1*x6 - x2*x5 + x3*x4}
        >>> weights = co.LieAlgebra.from_brackets("[d, a] = a; [d, b] = 2 b; [d, c] = 1.5 c; [d, z] = 0.3 z")
        >>> found = weights.casimirs()
        >>> found
        {'I1': 3 log|a| - 10 log|z|, 'I2': 3 log|b| - 20 log|z|, 'I3': (c)/(z^5)}
        >>> found.corank, found.independent, found.missing
        (3, ('I1', 'I2', 'I3'), 0)
        """
        found = self._find_casimirs(max_degree)
        if found.missing:
            warn_caller(f"casimirs() {found.sentence}", UserWarning)
        return found

    def _find_casimirs(self, max_degree: int = 4) -> Casimirs:
        """Find Casimirs as `casimirs` does, without the warning."""
        from coadjoint.algebra.invariants.casimirs import Casimirs, casimirs

        coordinates = names_of_basis(self.basis)

        def named(polynomial: Polynomial) -> Polynomial:
            return polynomial.named(coordinates)

        found, corank, independent = casimirs(self._triples, self._dim, max_degree)
        functions = {
            key: named(one) if isinstance(one, Polynomial) else one.transformed(named).invariant()
            for key, one in found.items()
        }
        return Casimirs(functions, corank, independent, max_degree, list(self._casimirs))
