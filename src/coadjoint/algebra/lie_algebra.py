"""The class `LieAlgebra`: construction, validation and names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from coadjoint.algebra.brackets import count_of_brackets, format_brackets, names_in, parse_brackets
from coadjoint.algebra.constants import (
    Triples,
    antisymmetric,
    check_jacobi,
    parse_constants,
    read_basis,
)
from coadjoint.algebra.exact.sparse_sums import Floats
from coadjoint.algebra.invariants.invariant import Invariant
from coadjoint.algebra.invariants.sampled_checks import check_casimir
from coadjoint.algebra.polynomials.monomials import check_names, names_of_basis
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.representation import check_representation
from coadjoint.algebra.structure import Structure
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import html_table, short
from coadjoint.validation import read_integer, read_list, read_title, truncate_title

FEW_BRACKETS = 6
"""Number of brackets shown in a one-line repr."""
MAX_BRACKETS = 30
"""Number of brackets shown by `print` and in notebooks."""


@suggest_keywords
class LieAlgebra(Structure):
    """A finite-dimensional real Lie algebra, [e_i, e_j] = sum_k c_ij^k e_k, given by its structure constants.

    The constants are stored sparse. Antisymmetry and the Jacobi identity are checked at construction, to 64 u times the
    sum of the absolute values of the products in each identity (u = 2^-53). The object is immutable, and two algebras
    with equal constants are equal, even if their names differ.

    Choose `LieAlgebra` for constants in an array or a list, `LieAlgebra.from_brackets` to write brackets down,
    `LieAlgebra.from_matrices` for matrices, and `coadjoint.algebras` for the known algebras.

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
        Known Casimir functions, stored unchanged; J(x) grad C(x) = 0 is checked at sample points where they are finite.

    Raises
    ------
    TypeError, ValueError
        The message names the invalid constant, pair, or triple of basis elements.

    See Also
    --------
    coadjoint.algebra.structure : operations defined by the constants: brackets, J(x), the coadjoint action, ranks.
    coadjoint.algebra.catalogue : the catalogue, and constructions of new algebras.

    References
    ----------
    S. Reich, Numerical integration of the generalized Euler equations, equations (1)-(2).

    Examples
    --------
    >>> g = LieAlgebra([(0, 1, 2, 1.0), (1, 2, 0, 1.0), (2, 0, 1, 1.0)], dim=3, name="so(3)")
    >>> g
    LieAlgebra('so(3)', dim=3: [e1, e2] = e3, [e1, e3] = -e2, [e2, e3] = e1)
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
        size, parsed, complete = parse_constants(constants, dim)
        names = read_basis(basis, size)
        if name is not None:
            read_title(name, "name of a Lie algebra")
        triples = antisymmetric(parsed, size, names, complete)
        check_jacobi(triples, size, names)
        _check_casimirs(casimirs, names)
        rho = None if representation is None else check_representation(representation, triples, size, names)
        self._store(triples, size, names, name, rho, casimirs or {})
        for key, casimir in self._casimirs.items():
            check_casimir(key, casimir, size, self._product, self._rounded_product)

    # The algebra and the number of its copies, for a sum of copies.
    _copied: tuple[LieAlgebra, int] | None = None

    def _store(
        self,
        triples: Triples | Callable[[], Triples],
        dim: int,
        basis: tuple[str, ...] | Callable[[], tuple[str, ...]],
        name: str | None,
        representation: Floats | None,
        casimirs: Mapping[str, Any],
    ) -> None:
        """Store valid data; constants and names, which may be millions, can be functions, called when they are read."""
        arrays = () if callable(triples) else triples
        for column in (*arrays, *(() if representation is None else (representation,))):
            column.flags.writeable = False
        self._constants, self._dim, self._basis, self._name = triples, dim, basis, name
        self._representation = representation
        coordinates = names_of_basis(self.basis) if casimirs else ()
        self._casimirs = {key: casimir.named(coordinates) for key, casimir in casimirs.items()}

    @property
    def _constant_count(self) -> int:
        """Number of nonzero constants, without making those of copies."""
        return len(self._triples.c) if self._copied is None else len(self._copied[0].triples.c) * self._copied[1]

    @property
    def _triples(self) -> Triples:  # type: ignore[override]
        return self._constants() if callable(self._constants) else self._constants

    @classmethod
    def _from_valid(cls, *data: Any) -> LieAlgebra:
        """Construct without validation from data that is valid by construction, sorted and unique; see `_store`."""
        algebra = cls.__new__(cls)
        algebra._store(*data)
        return algebra

    @classmethod
    def from_brackets(
        cls,
        dim: int | str | Sequence[str],
        brackets: Mapping[tuple[Any, Any], Mapping[Any, float]] | Sequence[str] | None = None,
        *,
        basis: Sequence[str] | None = None,
        name: str | None = None,
        representation: Any = None,
        casimirs: Mapping[str, Any] | None = None,
    ) -> LieAlgebra:
        """Build an algebra from its nonzero brackets.

        Parameters
        ----------
        dim : int, str, or sequence of str
            The dimension; or only the brackets as lines, such as ``"[h, e] = 2 e"``, or a text of such lines: the basis
            then consists of the names in them, in order of first appearance.
        brackets : mapping, or sequence of str
            ``{(i, j): {k: c}}`` stands for [e_i, e_j] = sum_k c e_k; indices from 0, or names of the basis. One order
            of each pair is enough. Or lines, as above.
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
        >>> LieAlgebra.from_brackets(["[h, e] = 2 e", "[h, f] = -2 f", "[e, f] = h"])
        LieAlgebra(dim=3: [h, e] = 2 e, [h, f] = -2 f, [e, f] = h)
        >>> LieAlgebra.from_brackets("[n, a] = b; [n, b] = -a; [a, b] = z").basis
        ('n', 'a', 'b', 'z')
        """
        if brackets is None:
            rule = (
                "give lines such as '[h, e] = 2 e', or first the dimension, as in from_brackets(3, {(0, 1): {2: 1.0}})"
            )
            if isinstance(dim, str):
                dim = [line for line in dim.replace(";", "\n").splitlines() if line.strip()]
            lines = read_list(dim, "brackets", rule)
            basis = names_in(lines) if basis is None else read_list(basis, "basis", "give names, one for each element")
            dim, brackets = len(basis), lines
        size = read_integer(dim, "dim")
        rows = parse_brackets(size, brackets, basis)
        return cls(rows, dim=size, basis=basis, name=name, representation=representation, casimirs=casimirs)

    @classmethod
    def from_matrices(
        cls,
        matrices: Any,
        *,
        basis: Sequence[str] | None = None,
        name: str | None = None,
        casimirs: Mapping[str, Any] | None = None,
    ) -> LieAlgebra:
        """Build the algebra of which matrices are a basis, from their commutators.

        Choose it if the algebra is known by its matrices. If every number is rational, a float of a simple fraction, or
        a rational multiple of the square root of an integer (``np.sqrt(3) / 2``), the constants are computed exactly
        and rounded once. Otherwise they are found by least squares, and a commutator belongs to the span if its
        distance from it is at most 2^-40 of the product of the norms of the two matrices.

        Parameters
        ----------
        matrices : sequence of n arrays of shape (d, d)
            A basis: independent, and closed under the commutator. Integers, fractions, floats or complex numbers, also
            sparse. Complex matrices span the algebra over the real numbers: of Hermitian matrices give -i times them.
        basis, name, casimirs
            As for `LieAlgebra`.

        Returns
        -------
        LieAlgebra
            With the matrices as representation, complex ones A + i B as real matrices (A, -B; B, A) of twice the size.

        Raises
        ------
        TypeError, ValueError
            The matrices are not numbers of one shape; one of them depends on those before it, and the message has the
            combination; or a commutator is outside of their span, and the message has the pair and the matrix.

        See Also
        --------
        closure : adds the commutators that are missing.

        Examples
        --------
        >>> LieAlgebra.from_matrices([[[1, 0], [0, -1]], [[0, 1], [0, 0]], [[0, 0], [1, 0]]], basis=("h", "e", "f"))
        LieAlgebra(dim=3: [h, e] = 2 e, [h, f] = -2 f, [e, f] = h)
        >>> spins = np.array([[[0, 1], [1, 0]], [[0, -1j], [1j, 0]], [[1, 0], [0, -1]]]) / 2
        >>> LieAlgebra.from_matrices(-1j * spins)
        LieAlgebra(dim=3: [e1, e2] = e3, [e1, e3] = -e2, [e2, e3] = e1)
        >>> LieAlgebra.from_matrices([[[0, 1], [0, 0]], [[0, 0], [1, 0]]])
        Traceback (most recent call last):
        ValueError: [A1, A2] is not in the span of the 2 matrices: it is [[1.0, 0.0], [0.0, -1.0]]; add this matrix, ...
        """
        from coadjoint.algebra.matrix_span import read_matrices, spanned

        given = read_matrices(matrices)
        names = read_basis(basis, len(given.entries))
        constants, rho = spanned(given, names if basis is not None else [f"A{k + 1}" for k in range(len(names))])
        return cls(constants, dim=len(names), basis=names, name=name, representation=rho, casimirs=casimirs)

    @classmethod
    def closure(cls, matrices: Any, *, basis: Sequence[str] | None = None, name: str | None = None) -> LieAlgebra:
        """Build the smallest algebra that contains matrices: their commutators are added until nothing is missing.

        Choose it for the algebra that control fields or a few generators span. The given matrices are the first
        elements of the basis, and each further one is the commutator of a given matrix with an element before it.

        Parameters
        ----------
        matrices : sequence of arrays of shape (d, d)
            Independent, as for `from_matrices`.
        basis : sequence of str, optional
            Names of the given matrices; added ones are called e and their number.
        name : str, optional
            Name of the algebra; by default it states which elements were added.

        Returns
        -------
        LieAlgebra
            Its `representation` has the given matrices, followed by those that were added.

        Raises
        ------
        TypeError, ValueError
            As for `from_matrices`; or the dimension exceeds 256.

        Examples
        --------
        >>> g = LieAlgebra.closure([[[0, 1], [0, 0]], [[0, 0], [1, 0]]])
        >>> g
        LieAlgebra('2 matrices, and e3 = [e1, e2]', dim=3: [e1, e2] = e3, [e1, e3] = -2 e1, [e2, e3] = 2 e2)
        >>> g.representation[2]
        array([[ 1.,  0.],
               [ 0., -1.]])
        """
        from coadjoint.algebra.matrix_span import closed, read_matrices

        given = read_matrices(matrices)
        first = read_basis(basis, len(given.entries))
        labels = list(first) if basis is not None else [f"A{k + 1}" for k in range(len(first))]
        constants, rho, pairs = closed(given, labels)
        names = [*first, *(f"e{len(first) + k + 1}" for k in range(len(pairs)))]
        added = (f"{names[len(first) + k]} = [{names[i]}, {names[j]}]" for k, (i, j) in enumerate(pairs))
        title = ", and ".join([f"{len(first)} matrices", *(", ".join(added),) * bool(pairs)])
        name = truncate_title(title) if name is None else name
        return cls(constants, dim=len(names), basis=names, name=name, representation=rho)

    @property
    def dim(self) -> int:
        """Dimension n."""
        return self._dim

    @property
    def basis(self) -> tuple[str, ...]:
        """Names of the basis elements."""
        if not isinstance(self._basis, tuple):
            self._basis = self._basis()
        return self._basis

    @property
    def name(self) -> str | None:
        """Name of the algebra, or None."""
        return self._name

    @property
    def representation(self) -> Floats | None:
        """Matrices of the representation, shape (n, d, d), read-only; None if none was given."""
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
        count = count_of_brackets(self._triples)
        if not 0 < count <= FEW_BRACKETS:
            return f"LieAlgebra({label}dim={self._dim}{f', {count} brackets' if count else ', commutative'})"
        return f"LieAlgebra({label}dim={self._dim}: {', '.join(format_brackets(self._triples, self.basis, count))})"

    def __str__(self) -> str:
        heading = f"{self._name or 'a Lie algebra'}, of dimension {self._dim}"
        count, lines = count_of_brackets(self._triples), format_brackets(self._triples, self.basis, MAX_BRACKETS)
        remainder = [f"and {count - len(lines)} more"] if count > len(lines) else []
        return "\n  ".join([heading, *lines, *remainder])

    def _repr_html_(self) -> str:
        count, lines = count_of_brackets(self._triples), format_brackets(self._triples, self.basis, MAX_BRACKETS)
        brackets = (", ".join(lines) or "none") + (f", and {count - len(lines)} more" if count > len(lines) else "")
        rows = {"dimension": self._dim, "basis": short(self.basis), "brackets": brackets}
        return html_table(self._name or "a Lie algebra", rows)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, LieAlgebra):
            return NotImplemented
        pairs = zip(self._triples, other._triples, strict=True)
        return self._dim == other._dim and all(np.array_equal(mine, theirs) for mine, theirs in pairs)

    def __hash__(self) -> int:
        return hash((self._dim, *(column.tobytes() for column in self._triples)))


def _check_casimirs(casimirs: Any, basis: Sequence[str]) -> None:
    """Raise an error for Casimirs that are not functions of the coordinates, by name."""
    size = len(basis)
    if casimirs is not None and not isinstance(casimirs, Mapping):
        raise TypeError(f"casimirs must be a mapping from names to functions, not {type(casimirs).__name__}")
    for key, casimir in (casimirs or {}).items():
        if not isinstance(key, str) or not isinstance(casimir, Polynomial | Invariant):
            raise TypeError(
                f"casimirs has {short(key)}: {short(casimir)}; give a name, and a Polynomial or an Invariant"
            )
        dim = getattr(casimir, "dim", size)
        if dim != size:
            raise ValueError(f"casimirs has {short(key)} of {dim} variables; the algebra has dimension {size}")
        check_names(casimir, names_of_basis(basis), f"the Casimir {short(key)}")


def read_algebra(argument: Any, rule: str) -> LieAlgebra:
    """Return a Lie algebra; raise TypeError for anything else, with a rule that its type ends."""
    if not isinstance(argument, LieAlgebra):
        raise TypeError(f"{rule} a {type(argument).__name__}")
    return argument
