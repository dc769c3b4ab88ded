"""Constructions from one algebra, in exact arithmetic: change of basis, subalgebras, quotients by ideals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from coadjoint.algebra.constants import read_basis
from coadjoint.algebra.exact.elimination import Number, Span, Vector, add_multiple, read_vector
from coadjoint.algebra.exact.numbers import exact_number, rounded
from coadjoint.algebra.exact.sparse_sums import Floats
from coadjoint.algebra.families.matrix_bases import linear
from coadjoint.algebra.lie_algebra import LieAlgebra, read_algebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.short_repr import short
from coadjoint.validation import to_array, truncate_title

Rows = dict[int, list[tuple[int, int, Number]]]
Brackets = Mapping[tuple[int, int], Mapping[int, Number]]


def _parse_vectors(g: LieAlgebra, argument: Any, what: str) -> list[Vector]:
    """Parse vectors of g, given as components or names of basis elements."""
    read_algebra(g, f"{what} belongs to a LieAlgebra, not to")
    if isinstance(argument, np.ndarray) and argument.dtype.kind == "U":
        argument = argument.tolist()
    if not isinstance(argument, list | tuple) and np.ndim(argument := to_array(argument, what)) == 0:
        raise TypeError(f"{what} must be a sequence of vectors or of names of basis elements, not {short(argument)}")
    index_of = {label: i for i, label in enumerate(g.basis)}
    vectors: list[Vector] = []
    for number, vector in enumerate(argument):
        if isinstance(vector, str):
            if vector not in index_of:
                known = ", ".join(map(short, g.basis[:8]))
                raise ValueError(f"{short(vector)} in {what} is not a basis element of {short(g)}: {known}, ...")
            vectors.append({index_of[vector]: 1})
        else:
            vectors.append(read_vector(vector, g.dim, f"vector {number} of {what}"))
    return vectors


def _span(vectors: Sequence[Vector], what: str) -> Span:
    try:
        return Span(vectors)
    except ValueError as error:
        raise ValueError(f"{what} must consist of independent vectors, but {error}") from None


def _brackets_by_element(g: LieAlgebra) -> Rows:
    """Return for each i all (j, k, c_ij^k), in both orders of i and j."""
    rows: Rows = {i: [] for i in range(g.dim)}
    for i, j, k, c in zip(*(column.tolist() for column in g.triples), strict=True):
        exact = exact_number(c)
        rows[i].append((j, k, exact))
        rows[j].append((i, k, -exact))
    return rows


def _bracket(rows: Rows, u: Mapping[int, Number], v: Mapping[int, Number]) -> Vector:
    result: Vector = {}
    for i, left in u.items():
        for j, k, c in rows[i]:
            if j in v:
                add_multiple(result, left * v[j], {k: c})
    return result


def _constants(brackets: Brackets) -> list[tuple[int, int, int, float]]:
    return [(i, j, k, rounded(c)) for (i, j), components in brackets.items() for k, c in components.items()]


def _combine_representation(g: LieAlgebra, vectors: Sequence[Vector]) -> Floats | None:
    """Return sum_j v_j rho_j for each vector, each entry rounded once."""
    if g.representation is None:
        return None
    d = g.representation.shape[1]
    rho = np.zeros((len(vectors), d, d))
    entries = [
        {int(index): exact_number(float(part.flat[index])) for index in np.flatnonzero(part)}
        for part in g.representation
    ]
    for number, vector in enumerate(vectors):
        total: Vector = {}
        for j, value in vector.items():
            add_multiple(total, value, entries[j])
        for position, value in total.items():
            rho[number].flat[position] = rounded(value)
    return rho


def substituted(p: Polynomial, rows: Sequence[Mapping[int, Number]], dim: int) -> Polynomial:
    """Substitute x_i = sum_j rows[i][j] y_j (sparse rows) in a polynomial of x; the result has `dim` coordinates."""
    forms: dict[int, Polynomial] = {}
    total = Polynomial({}, dim=dim)
    for exponents, value in p.monomials.items():
        product = Polynomial({(0,) * dim: value})
        for i, power in enumerate(exponents):
            if power:
                if i not in forms:
                    forms[i] = linear(rows[i], dim)
                product = product * forms[i] ** power
        total = total + product
    return total


def _casimirs(g: LieAlgebra, rows: Sequence[Mapping[int, Number]], dim: int, exact: bool) -> dict[str, Any]:
    """Return the known Casimirs that do not vanish in new coordinates, x_i = sum_j rows[i][j] y_j."""

    def changed(p: Polynomial) -> Polynomial:
        q = substituted(p, rows, dim)
        return q if exact else Polynomial({key: rounded(value) for key, value in q.monomials.items()}, dim=dim)

    result: dict[str, Any] = {}
    for name, casimir in g.casimirs_known.items():
        form = casimir._transformed(changed, restricted=len(rows) != dim)
        if form is not None and getattr(form, "degree", True):
            result[name] = form
    return result


def _is_exact(brackets: Brackets) -> bool:
    return all(rounded(c) == c for components in brackets.values() for c in components.values())


def _to_integers(vectors: Sequence[Mapping[int, Number]]) -> tuple[list[dict[int, int]], int]:
    """Return integer vectors and their common denominator; integers multiply much faster than fractions."""
    common = math.lcm(*(value.denominator for vector in vectors for value in vector.values()))
    return [{i: int(value * common) for i, value in vector.items()} for vector in vectors], common


@suggest_keywords
def change_of_basis(g: LieAlgebra, matrix: Any, basis: Sequence[str] | None = None) -> LieAlgebra:
    """Return the same algebra in the basis e'_i = sum_j T_ij e_j.

    The coordinates of the dual transform as x' = T x.

    Parameters
    ----------
    g : LieAlgebra
    matrix : (n, n) array of int, float or Fraction
        T, invertible. Floats are converted exactly to rational numbers; the computation is exact, and each constant is
        rounded once.
    basis : sequence of str, optional
        New names; ``e1, e2, ...`` by default.

    Returns
    -------
    LieAlgebra
        With the representation sum_j T_ij rho_j and the known Casimirs as functions of x'; their coefficients are exact
        if all new constants are exact floats, else rounded. A user's `Invariant` given as a Python function is not
        carried over.

    Raises
    ------
    TypeError, ValueError
        T has the wrong shape, is singular, or does not hold finite numbers.

    Examples
    --------
    >>> from coadjoint.algebra.families.classical import so
    >>> g = change_of_basis(so(3), [[2, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> g.bracket([0, 1, 0], [0, 0, 1])
    array([0.5, 0. , 0. ])
    >>> g.casimirs_known["|x|^2"]
    (1/4)*x1^2 + x2^2 + x3^2
    """
    vectors = _parse_vectors(g, matrix, "the new basis")
    if len(vectors) != g.dim:
        raise ValueError(f"the new basis must consist of {g.dim} vectors, not {len(vectors)}")
    span = _span(vectors, "the new basis")
    old = [span.combination({i: 1}) or {} for i in range(g.dim)]  # e_i by the new basis, so x_i by x'
    (new, by_new), (inverse, by_inverse) = _to_integers(vectors), _to_integers(old)
    rows, brackets = _brackets_by_element(g), {}
    elements_along: list[list[int]] = [[] for _ in range(g.dim)]  # indices of new elements with a component along e_j
    for number, vector in enumerate(new):
        for j in vector:
            elements_along[j].append(number)
    for i, u in enumerate(new):
        for partner in sorted({v for a in u for j, _, _ in rows[a] for v in elements_along[j] if v > i}):
            components: Vector = {}
            for k, value in _bracket(rows, u, new[partner]).items():
                add_multiple(components, value, inverse[k])
            brackets[i, partner] = {k: Fraction(value) / (by_new**2 * by_inverse) for k, value in components.items()}
    return LieAlgebra(
        _constants(brackets),
        dim=g.dim,
        basis=read_basis(basis, g.dim),
        name=None if g.name is None else truncate_title(f"{g.name} in another basis"),
        representation=_combine_representation(g, vectors),
        casimirs=_casimirs(g, old, g.dim, _is_exact(brackets)),
    )


@suggest_keywords
def subalgebra(g: LieAlgebra, vectors: Any, basis: Sequence[str] | None = None) -> LieAlgebra:
    """Return the subalgebra with a given basis.

    Parameters
    ----------
    g : LieAlgebra
    vectors : (m, n) array of int, float or Fraction, or sequence of names of basis elements
        Independent and closed under the bracket, exactly.
    basis : sequence of str, optional
        New names; by default the given names, else ``e1, e2, ...``.

    Returns
    -------
    LieAlgebra
        With the representation of g restricted to it. No Casimirs are known.

    Raises
    ------
    TypeError, ValueError
        There are no vectors, they are dependent, or a bracket of two leaves their span.

    Examples
    --------
    >>> from coadjoint.algebra.families.classical import so
    >>> subalgebra(so(4), ["e1", "e2", "e4"]).bracket([1, 0, 0], [0, 1, 0])
    array([ 0.,  0., -1.])
    """
    argument = _parse_vectors(g, vectors, "the subalgebra")
    if not argument:
        raise ValueError("the subalgebra has no vectors; give at least one")
    span, rows = _span(argument, "the subalgebra"), _brackets_by_element(g)
    brackets = {}
    for i, u in enumerate(argument):
        for j in range(i + 1, len(argument)):
            components = span.combination(_bracket(rows, u, argument[j]))
            if components is None:
                raise ValueError(f"this span is not a subalgebra: the bracket of vectors {i} and {j} leaves their span")
            brackets[i, j] = components
    if basis is None and all(isinstance(vector, str) for vector in vectors):
        basis = vectors
    return LieAlgebra(
        _constants(brackets),
        dim=len(argument),
        basis=basis,
        name=None if g.name is None else truncate_title(f"subalgebra of {g.name}"),
        representation=_combine_representation(g, argument),
    )


@suggest_keywords
def quotient(g: LieAlgebra, ideal: Any) -> LieAlgebra:
    """Return the quotient of g by an ideal; its basis consists of the classes of the e_k not determined by the ideal.

    The dual of the quotient is the set of x in the dual of g that vanish on the ideal.

    Parameters
    ----------
    g : LieAlgebra
    ideal : (m, n) array of int, float or Fraction, or sequence of names of basis elements
        Independent vectors that span the ideal, exactly.

    Returns
    -------
    LieAlgebra
        With the names of these e_k, the nonconstant restrictions of the known polynomial Casimirs to the dual of the
        quotient, and the representation if it is zero on the ideal.

    Raises
    ------
    TypeError, ValueError
        The vectors are dependent, span g, or do not span an ideal; the message names a basis element and a vector.

    Examples
    --------
    >>> from coadjoint.algebra.families.classical import e
    >>> quotient(e(3), ["e4", "e5", "e6"])
    LieAlgebra('e(3) / ideal', dim=3: [e1, e2] = e3, [e1, e3] = -e2, [e2, e3] = e1)
    """
    argument = _parse_vectors(g, ideal, "the ideal")
    span, rows = _span(argument, "the ideal"), _brackets_by_element(g)
    if len(argument) == g.dim:
        raise ValueError("the ideal is all of g; the quotient would have dimension 0")
    for number, vector in enumerate(argument):
        for i in sorted({j for part in vector for j, _, _ in rows[part]}):
            if span.combination(_bracket(rows, {i: 1}, vector)) is None:
                raise ValueError(
                    f"the vectors do not span an ideal: the bracket of {g.basis[i]} with vector {number} leaves it"
                )
    complement = [k for k in range(g.dim) if k not in span.pivots]
    index_of = {k: number for number, k in enumerate(complement)}
    brackets: dict[tuple[int, int], dict[int, Number]] = {}
    pairs = {(i, j) for i in complement for j, _, _ in rows[i] if i < j and j in index_of}
    for i, j in sorted(pairs):
        rest = span.remainder(_bracket(rows, {i: 1}, {j: 1}))
        brackets[index_of[i], index_of[j]] = {index_of[k]: value for k, value in rest.items()}
    restricted = [{index_of[j]: value for j, value in span.remainder({i: 1}).items()} for i in range(g.dim)]
    rho = g.representation
    if rho is not None:
        zero = _combine_representation(g, argument)
        rho = rho[complement] if zero is not None and not zero.any() else None
    return LieAlgebra(
        _constants(brackets),
        dim=len(complement),
        basis=[g.basis[k] for k in complement],
        name=None if g.name is None else truncate_title(f"{g.name} / ideal"),
        representation=rho,
        casimirs=_casimirs(g, restricted, len(complement), _is_exact(brackets)),
    )
