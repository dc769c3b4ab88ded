"""Hamiltonians that are sums of functions of one coordinate each, or of commuting coordinates."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import Coefficient
from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import MAX_SHOWN_LENGTH, short
from coadjoint.systems.evaluation import read_point
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike, as_hamiltonian
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.summable import Summable
from coadjoint.systems.hamiltonians.terms import MAX_COORDINATES, FunctionTerm, Term
from coadjoint.systems.user_functions import all_take_time, check_derivative, multiple_of
from coadjoint.validation import read_integer, read_list


@suggest_keywords
class Separable(Summable):
    """A sum of functions of one coordinate each, ``sum of H_i(x_i)``.

    Explicit splittings support it on every algebra, since the flow of each H_i is linear. If a piece of H depends on
    several commuting coordinates together, use `SplitHamiltonian`.

    Parameters
    ----------
    functions : mapping
        Coordinate (0-based) to ``(H_i, dH_i)`` or ``(H_i, dH_i, d2H_i)``: pure functions of a number, or of a number
        and the time, that return a number. H does not depend on omitted coordinates.

    Raises
    ------
    TypeError
        Not functions, or functions of one coordinate with different arguments.
    ValueError
        In `bind`: a coordinate does not exist, or a derivative disagrees with a finite difference at a sample point.

    Notes
    -----
    Section 7 of Reich (1993): in the flows of section 4, m_ii x_i is replaced by H_i'(x_i).

    Examples
    --------
    >>> H = Separable({0: (np.cosh, np.sinh), 2: (lambda y: y**2, lambda y: 2 * y)})
    >>> float(H([0.0, 7.0, 3.0]))
    10.0
    >>> H.gradient([0.0, 7.0, 3.0])
    array([0., 0., 6.])
    """

    def __init__(self, functions: Mapping[int, tuple[Callable[..., Any], ...]]) -> None:
        if not isinstance(functions, Mapping) or not functions:
            raise TypeError("Separable needs a mapping from coordinate to (H_i, dH_i) with at least one entry")
        self.dim: int | None = None
        self._terms: list[FunctionTerm] = []
        for key in functions:
            i = read_integer(key, "a coordinate of Separable", 0, MAX_COORDINATES)
            group = functions[key]
            if not isinstance(group, tuple | list) or len(group) not in (2, 3):
                raise TypeError(f"coordinate {i} has {short(group)}; give (H_i, dH_i) or (H_i, dH_i, d2H_i)")
            value, slope = group[0], group[1]
            curvature = group[2] if len(group) == 3 else None
            timed = all_take_time({f"H_{i}": value, f"dH_{i}": slope, f"d2H_{i}": curvature})
            coordinates = np.array([i], dtype=np.int64)
            self._terms.append(FunctionTerm(coordinates, value, slope, curvature, scalar=True, timed=timed))
        self._terms.sort(key=lambda term: int(term.coordinates[0]))
        self.timed = any(term.timed for term in self._terms)

    def bind(self, n: int) -> Separable:
        """Return this Hamiltonian bound to dimension `n`, after checking its functions at sample points."""
        n = read_integer(n, "the dimension")
        if self.dim == n:
            return self
        if self.dim is not None:
            raise ValueError(f"Separable is bound to dimension {self.dim}, not {short(n)}; make a new one")
        for term in self._terms:
            i = int(term.coordinates[0])
            if i >= n:
                raise ValueError(f"Separable has a function of coordinate {i}; the system has coordinates 0 to {n - 1}")
            names, chain = (f"H_{i}", f"dH_{i}", f"d2H_{i}"), (term.value, term.gradient, term.hessian)
            for level in (0, 1):
                function, derivative = chain[level], chain[level + 1]
                if function is not None and derivative is not None:
                    pair = (names[level], names[level + 1])
                    check_derivative(function, derivative, names=pair, shapes=((), ()), n=None, timed=term.timed)
        bound = object.__new__(Separable)
        bound.dim, bound.timed, bound._terms = n, self.timed, self._terms
        return bound

    def times(self, factor: Coefficient) -> Self:
        result = object.__new__(type(self))
        result.dim, result.timed, result._terms = self.dim, self.timed, []
        for term in self._terms:
            chain = term.value, term.gradient, term.hessian
            value, gradient, hessian = (multiple_of(function, factor, scalar=True) for function in chain)
            result._terms.append(replace(term, value=value, gradient=gradient, hessian=hessian))
        return result

    def _each(self, attribute: str, y: npt.NDArray[Any], t: float) -> list[tuple[int, Any]]:
        results = []
        for term in self._terms:
            i, function = int(term.coordinates[0]), getattr(term, attribute)
            if i >= y.size:
                raise ValueError(f"Separable has a function of coordinate {i}, but x has only {y.size} entries")
            if function is None:
                raise TypeError(f"Separable has no second derivative for coordinate {i}; give (H_i, dH_i, d2H_i)")
            try:
                results.append((i, function(y[i], t) if term.timed else function(y[i])))
            except (TypeError, ArithmeticError) as reason:
                if y.dtype != object:
                    raise
                # NumPy functions reject Python objects that lack the method.
                message = in_one_line(str(reason), 200)
                raise TypeError(f"the function of coordinate {i} does not take {short(y[i])} ({message})") from None
        return results

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return the sum of ``H_i(x_i)``."""
        y = read_point(x, self.dim)
        total = sum(result for _, result in self._each("value", y, t))
        return float(total) if y.dtype == np.float64 else total

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        y = read_point(x, self.dim)
        result = np.zeros(y.size, dtype=y.dtype)
        for i, slope in self._each("gradient", y, t):
            result[i] = slope
        return result

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the diagonal matrix of second derivatives, shape (n, n)."""
        y = read_point(x, self.dim)
        result = np.zeros((y.size, y.size), dtype=y.dtype)
        for i, curvature in self._each("hessian", y, t):
            result[i, i] = curvature
        return result

    def terms(self) -> tuple[Term, ...]:
        """Return one `FunctionTerm` for each coordinate, in order; the Hamiltonian must be bound."""
        if self.dim is None:
            raise TypeError("Separable has no dimension yet; call bind(n) first")
        return self.functions()

    def linear_part(self) -> npt.NDArray[np.float64]:
        """Return zeros, (n,): linear functions are functions like others."""
        assert self.dim is not None
        return np.zeros(self.dim)

    def with_linear(self, linear: npt.NDArray[np.float64]) -> Summable:
        """Return the functions as pieces of a `SplitHamiltonian`, with the linear term in others."""
        pieces = []
        for term in self._terms:
            functions = (term.value, term.gradient, *(() if term.hessian is None else (term.hessian,)))
            pieces.append(((int(term.coordinates[0]),), Separable({0: functions})))
        return SplitHamiltonian(pieces).bind(len(linear)).with_linear(linear)

    def functions(self) -> tuple[FunctionTerm, ...]:
        """Return the functions of each coordinate, in order."""
        return tuple(self._terms)

    def __repr__(self) -> str:
        coordinates = [int(term.coordinates[0]) for term in self._terms]
        return (
            f"Separable(of coordinates {coordinates})"
            if len(coordinates) <= 8
            else f"Separable(of {len(coordinates)} coordinates)"
        )


@suggest_keywords
class SplitHamiltonian(Summable):
    """A sum of pieces ``H_a(x[coordinates of a])``, each of coordinates that commute in the algebra.

    Explicit splittings support it: the gradient of a piece is constant along the flow of that piece, so this flow is
    known exactly. Whether the coordinates of a piece commute is checked when the system is constructed. For functions
    of one coordinate each, `Separable` is shorter.

    Parameters
    ----------
    pieces : sequence of (coordinates, Hamiltonian)
        The coordinates of the piece (0-based), and a Hamiltonian of any type in these coordinates, in their order: x1
        of a text is the first coordinate of its piece. Different pieces may share coordinates.

    Attributes
    ----------
    coordinates : tuple of tuple of int
        The coordinates of every piece.
    pieces : tuple
        The Hamiltonian of every piece, bound to the number of its coordinates.

    Raises
    ------
    ValueError
        A coordinate is negative or occurs twice in a piece, or a Hamiltonian has another number of coordinates.
    TypeError
        No pieces, or a piece that is not such a pair.

    Notes
    -----
    Section 4 of Reich (1993) uses single coordinates; the same holds for any function of commuting coordinates, since
    ``sum of (dH/dx_i) e_i`` is constant along its own flow.

    Examples
    --------
    >>> from coadjoint.systems.hamiltonians.quadratic import Quadratic
    >>> H = SplitHamiltonian([((0, 1), Quadratic([[1.0, 0.5], [0.5, 1.0]])), ((2,), Quadratic(3.0))])
    >>> H([1.0, 0.0, 2.0])
    6.5
    >>> H.gradient([1.0, 0.0, 2.0])
    array([1. , 0.5, 6. ])
    """

    def __init__(self, pieces: Sequence[tuple[Sequence[int], Any]]) -> None:
        self.dim: int | None = None
        indices: list[npt.NDArray[np.int64]] = []
        parts: list[HamiltonianLike] = []
        rule = "give a list of (coordinates, Hamiltonian)"
        for number, piece in enumerate(read_list(pieces, "pieces", rule)):
            if not isinstance(piece, tuple | list) or len(piece) != 2:
                raise TypeError(f"piece {number} is {short(piece)}; give (coordinates, Hamiltonian)")
            indices.append(_read_coordinates(piece[0], number))
            try:
                parts.append(as_hamiltonian(piece[1], indices[-1].size))
            except (TypeError, ValueError) as reason:
                raise type(reason)(f"piece {number}, of {indices[-1].size} coordinates: {reason}") from reason
        if not parts:
            raise TypeError("SplitHamiltonian has no pieces; give at least one (coordinates, Hamiltonian)")
        self._indices = tuple(indices)
        self.pieces = tuple(parts)
        self.timed = any(part.timed for part in self.pieces)

    @property
    def coordinates(self) -> tuple[tuple[int, ...], ...]:
        """The coordinates of every piece."""
        return tuple(tuple(indices.tolist()) for indices in self._indices)

    def bind(self, n: int) -> SplitHamiltonian:
        """Return this Hamiltonian bound to dimension `n`."""
        n = read_integer(n, "the dimension")
        for number, indices in enumerate(self._indices):
            if indices.max() >= n:
                raise ValueError(
                    f"piece {number} has coordinate {indices.max()}; the system has coordinates 0 to {n - 1}"
                )
        bound = object.__new__(SplitHamiltonian)
        bound.dim, bound.timed, bound._indices, bound.pieces = n, self.timed, self._indices, self.pieces
        return bound

    place_in_sum = 1

    def joined(self, other: Any) -> SplitHamiltonian:
        """Return the pieces of both."""
        if None not in (self.dim, other.dim) and self.dim != other.dim:
            raise ValueError(f"Hamiltonians of {self.dim} and {other.dim} coordinates cannot be added")
        pieces = [pair for H in (self, other) for pair in zip(H._indices, H.pieces, strict=True)]
        dim = self.dim if self.dim is not None else other.dim
        return SplitHamiltonian(pieces) if dim is None else SplitHamiltonian(pieces).bind(dim)

    def check_commuting(self, algebra: LieAlgebra) -> None:
        """Raise ValueError if a piece has coordinates whose basis elements do not commute in the algebra."""
        i, j, _, _ = algebra.triples
        for number, indices in enumerate(self._indices):
            in_piece = np.zeros(algebra.dim, dtype=bool)
            in_piece[indices] = True
            conflicts = np.flatnonzero(in_piece[i] & in_piece[j])
            if conflicts.size:
                a, b = int(i[conflicts[0]]), int(j[conflicts[0]])
                raise ValueError(
                    f"piece {number} has the coordinates {a} and {b}, whose basis elements {algebra.basis[a]} "
                    f"and {algebra.basis[b]} do not commute; put them in different pieces"
                )

    def times(self, factor: Coefficient) -> Self:
        """Return the Hamiltonian multiplied by a factor.

        Parameters
        ----------
        factor : int, float or Fraction
            Finite.

        Returns
        -------
        SplitHamiltonian

        Raises
        ------
        TypeError
            A piece is of a user-defined type without multiples.
        """
        pieces = []
        for number, piece in enumerate(self.pieces):
            if not isinstance(piece, Summable):
                raise TypeError(
                    f"piece {number} is {short(piece)}, which has no method times; multiply the piece itself"
                )
            pieces.append(piece.times(factor))
        result = copy.copy(self)
        result.pieces = tuple(pieces)
        return result

    has_linear = True

    def linear_part(self) -> npt.NDArray[np.float64]:
        """Return the sum of the linear parts of the pieces, (n,)."""
        assert self.dim is not None
        linear = np.zeros(self.dim)
        for indices, piece in zip(self._indices, self.pieces, strict=True):
            if getattr(piece, "has_linear", False):
                linear[indices] += cast(Summable, piece).linear_part()
        return linear

    def with_linear(self, linear: npt.NDArray[np.float64]) -> SplitHamiltonian:
        """Return the pieces with another linear term: a coefficient that changes is that of one piece, or a new one."""
        pieces: list[Any] = list(zip(self.coordinates, self.pieces, strict=True))
        for k in np.flatnonzero(linear != self.linear_part()).tolist():
            candidates = [
                p for p, (chosen, piece) in enumerate(pieces) if k in chosen and getattr(piece, "has_linear", False)
            ]
            if len(candidates) > 1:
                raise ValueError(
                    f"pieces {candidates[0]} and {candidates[1]} of the SplitHamiltonian are polynomials in coordinate "
                    f"{k}, so its linear coefficient is ambiguous; use the coordinate in one of them"
                )
            if not candidates:
                pieces.append(((k,), Quadratic(0.0, linear=linear[k : k + 1])))
                continue
            chosen, piece = pieces[candidates[0]]
            part = piece.linear_part()
            part[chosen.index(k)] = linear[k]
            pieces[candidates[0]] = chosen, piece.with_linear(part)
        return SplitHamiltonian(pieces).bind(len(linear))

    def value(self, x: npt.ArrayLike, t: float = 0.0) -> Any:
        """Return the sum of the pieces."""
        y = read_point(x, self.dim)
        return sum(part.value(y[indices], t) for indices, part in zip(self._indices, self.pieces, strict=True))

    def gradient(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the gradient, shape (n,)."""
        y = read_point(x, self.dim)
        result = np.zeros(y.size, dtype=y.dtype)
        for indices, part in zip(self._indices, self.pieces, strict=True):
            result[indices] += part.gradient(y[indices], t)
        return result

    def hessian(self, x: npt.ArrayLike, t: float = 0.0) -> npt.NDArray[Any]:
        """Return the second derivatives, shape (n, n)."""
        y = read_point(x, self.dim)
        result = np.zeros((y.size, y.size), dtype=y.dtype)
        for indices, part in zip(self._indices, self.pieces, strict=True):
            result[np.ix_(indices, indices)] += part.hessian(y[indices], t)
        return result

    def terms(self) -> tuple[Term, ...]:
        """Return the terms of all pieces in the n coordinates, with the numbers of the pieces; must be bound."""
        if self.dim is None:
            raise TypeError("SplitHamiltonian has no dimension yet; call bind(n) first")
        result: list[Term] = []
        for number, (indices, part) in enumerate(zip(self._indices, self.pieces, strict=True)):
            result += [term.placed(indices, self.dim, number) for term in part.terms()]
        return tuple(result)

    def __repr__(self) -> str:
        shown = [f"({short(chosen)}, {part!r})" for chosen, part in zip(self.coordinates, self.pieces, strict=True)]
        text = ", ".join(shown)
        return f"SplitHamiltonian({f'[{text}]' if len(text) <= MAX_SHOWN_LENGTH else f'{len(shown)} pieces'})"


def _read_coordinates(values: Any, number: int) -> npt.NDArray[np.int64]:
    """Validate the coordinates of a piece and return them; the numbers of a range lie between its ends."""
    if isinstance(values, range) and values:
        for end in (values[0], values[-1]):
            read_integer(end, f"a coordinate of piece {number}", 0, MAX_COORDINATES)
        return np.fromiter(values, np.int64)
    listed = read_list(values, f"the coordinates of piece {number}", "give (coordinates, Hamiltonian)")
    chosen = tuple(read_integer(i, f"a coordinate of piece {number}", 0, MAX_COORDINATES) for i in listed)
    if not chosen or len(set(chosen)) != len(chosen):
        raise ValueError(f"piece {number} has coordinates {short(chosen)}; give different numbers, from 0")
    return np.array(chosen, dtype=np.int64)
