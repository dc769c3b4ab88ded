"""Invariants that are no polynomials: quotients, powers, logarithms and angles of semi-invariants, in exact arithmetic.

A semi-invariant P is a polynomial with J(x) grad P = chi P, chi constant. It is annihilated by [g, g], and an
eigenvector of the rest of g. So log|P| changes by the constants chi along g; so does P/Q if J(x) grad P = chi P + c Q
and J(x) grad Q = chi Q. Complex pairs give an angle besides. Combinations whose constants cancel are invariants.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.elimination import Span, coprime_integers
from coadjoint.algebra.exact.numbers import as_fraction, fraction, rational
from coadjoint.algebra.invariants.casimir_equations import equations, monomial_count, monomials
from coadjoint.algebra.invariants.invariant import ANGLE, LOGARITHM, QUOTIENT, LogarithmicSum
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.long_operations import note_progress

if TYPE_CHECKING:
    from flint import fmpq_mat

MAX_UNKNOWNS = 250  # monomials of a degree, solved as a dense matrix of fractions
MAX_ANNIHILATED = 60  # polynomials of a degree that [g, g] annihilates; their characteristic polynomial is factored
MAX_FACTORS = 12  # a product of powers with more factors stays a sum of logarithms
MAX_WEIGHT = 1000  # of terms whose weights become coprime integers
MIN_SINE = 2.0**-20  # gradients of rounded polynomials are dependent below this angle

_ORDER = {LOGARITHM: 0, QUOTIENT: 1, ANGLE: 2}

Character = dict[int, Any]


class Shifted(NamedTuple):
    """A function that each basis element changes by a constant, the component of its character."""

    function: LogarithmicSum
    character: Character


class Gradients:
    """Gradients of functions at a random point: exact, or in floats for rounded coefficients."""

    def __init__(self, dim: int, exact: bool) -> None:
        rng = np.random.default_rng(0)
        self._exact, self._span, self._rows = exact, Span(), list[NDArray[np.float64]]()
        self._x = np.array([Fraction(int(v), 64) for v in rng.integers(32, 128, dim)], dtype=object)
        self._x *= rng.choice([-1, 1], dim).astype(object)

    def add(self, function: Any) -> bool:
        """Add the gradient of a function unless it depends on those before; return whether it was added."""
        if self._exact:
            slope = function.gradient(self._x)
            return self._span.add({i: Fraction(value) for i, value in enumerate(slope) if value})
        rest = np.asarray(function.gradient(self._x.astype(np.float64)), dtype=np.float64)
        size = np.linalg.norm(rest)
        for row in self._rows * 2:  # twice is enough
            rest = rest - (row @ rest) * row
        independent = bool(np.linalg.norm(rest) > MIN_SINE * size)
        if independent:
            self._rows.append(rest / np.linalg.norm(rest))
        return independent


def semi_invariant_casimirs(
    triples: Triples, integers: NDArray[Any], dim: int, degree: int, wanted: int, gradients: Gradients
) -> list[LogarithmicSum]:
    """Return at most `wanted` independent invariants of semi-invariants up to a degree, independent of `gradients`."""
    found: list[LogarithmicSum] = []
    characters, base = Span(), list[LogarithmicSum]()
    for d in range(1, degree + 1):
        candidates = list(_shifted(triples, integers, dim, d))
        # logarithms first, then quotients and angles, whose combinations are harder to read
        for function, character in sorted(candidates, key=lambda one: _ORDER[one.function.terms[0].kind]):
            if len(found) == wanted:
                return found
            weights = characters.combination(character)
            if weights is None:
                if gradients.add(function):
                    characters.add(character)
                    base.append(function)
                continue
            invariant = function
            for number, weight in weights.items():
                simple = as_fraction(float(weight))
                invariant = invariant + base[number] * -(weight if simple is None else simple)
            if invariant.period is not None and gradients.add(function):
                found.append(_simplified(invariant))
    return found


def _simplified(invariant: LogarithmicSum) -> LogarithmicSum:
    """Scale to coprime weights if their ratios are simple, and return a quotient of polynomials for logarithms."""
    terms = sorted(invariant.terms, key=lambda term: _ORDER[term.kind])
    weights = coprime_integers(term.weight for term in terms)
    if max(map(abs, weights)) > MAX_WEIGHT:
        return LogarithmicSum(invariant.dim, tuple(terms)) * (1 / Fraction(terms[0].weight))
    scaled = tuple(term._replace(weight=weight) for term, weight in zip(terms, weights, strict=True))
    if scaled[-1].kind != LOGARITHM or min(weights) > 0 or sum(map(abs, weights)) > MAX_FACTORS:
        return LogarithmicSum(invariant.dim, scaled)
    parts = [Polynomial({(0,) * invariant.dim: 1})] * 2
    for term, weight in zip(scaled, weights, strict=True):
        for _ in range(abs(weight)):
            parts[weight < 0] = parts[weight < 0] * term.second
    return LogarithmicSum.quotient(*parts)


def _shifted(triples: Triples, integers: NDArray[Any], dim: int, degree: int) -> Iterator[Shifted]:
    """Yield the functions of semi-invariants of a degree that elements of the algebra change by constants."""
    from flint import fmpq_mat

    unknowns = monomial_count(dim, degree)
    if unknowns > MAX_UNKNOWNS:
        return
    note_progress(f"semi-invariants of degree {degree} of dimension {dim}")
    basis = monomials(dim, degree)
    system = equations(triples, integers, basis, dim)
    derivations = [fmpq_mat(unknowns, unknowns) for _ in range(dim)]
    for along, target, column, value in zip(
        system.along.tolist(), system.target.tolist(), system.columns.tolist(), system.values.tolist(), strict=True
    ):
        derivations[along][target, column] = rational(value)
    derived, outside = _derived_algebra(triples, integers, dim)
    annihilated = _identity(unknowns)
    for element in derived:
        change = fmpq_mat(unknowns, unknowns)
        for i, value in element:
            change = change + derivations[i] * value
        annihilated = annihilated * _kernel(change * annihilated)[0]
    count = annihilated.ncols()
    if not 0 < count <= MAX_ANNIHILATED or not outside:
        return
    actions = [_restricted(derivations[i], annihilated) for i in outside]
    draws = np.random.default_rng(degree).integers(2**10, 2**20, len(outside)).tolist()
    generic = fmpq_mat(count, count)
    for action, draw in zip(actions, draws, strict=True):
        generic = generic + action * draw
    for factor, power in generic.charpoly().numer().factor()[1]:
        root = _root(factor.coeffs())
        if root is None:
            continue
        shifted = generic * generic - generic * (2 * root[0]) + _identity(count) * (root[0] ** 2 + root[1] ** 2)
        block, _ = _kernel((shifted if root[1] else generic - _identity(count) * root[0]) ** power)
        parts = [_restricted(action, block) for action in actions]
        own = _restricted(generic, block)
        for pieces, character in _of_block(parts, own, root):
            polynomials = [_polynomial(annihilated * block * piece, basis, dim) for piece in pieces]
            labelled = [{i: fraction(v) for i, v in zip(outside, part, strict=True) if v != 0} for part in character]
            yield from _functions(polynomials, labelled)


def _functions(pieces: Sequence[Polynomial], character: Sequence[Character]) -> Iterator[Shifted]:
    """Yield the functions of a semi-invariant Q, or P/Q: of real ones, or of pairs of real and imaginary parts."""
    if len(pieces) == 1:
        yield Shifted(LogarithmicSum.logarithm(_primitive(pieces[0])), character[0])
    elif len(character) == 1:
        yield Shifted(_quotient(*pieces), character[0])
    elif len(pieces) == 2:
        real, imaginary = pieces
        double = {i: 2 * value for i, value in character[0].items()}
        yield Shifted(LogarithmicSum.logarithm(real * real + imaginary * imaginary), double)
        yield Shifted(LogarithmicSum.angle(imaginary, real), character[1])
    else:
        a, b, real, imaginary = pieces
        size = real * real + imaginary * imaginary
        yield Shifted(_quotient(a * real + b * imaginary, size), character[0])
        yield Shifted(_quotient(b * real - a * imaginary, size), character[1])


def _of_block(
    actions: Sequence[fmpq_mat], generic: fmpq_mat, root: tuple[Any, Any]
) -> Iterator[tuple[list[fmpq_mat], list[list[Any]]]]:
    """Yield the semi-invariants Q of a block with one character, and pairs P, Q; complex ones by their two parts."""
    from flint import fmpq, fmpq_mat

    size, copies = generic.ncols(), 2 if root[1] else 1
    traces = [sum((action[k, k] for k in range(size)), fmpq(0)) / size for action in actions]
    imaginary = [fmpq(0)] * len(actions)
    if copies == 2:  # the semisimple part of (A - p)/s, by Newton's iteration for X^2 = -1
        turn = (generic - _identity(size) * root[0]) * (1 / root[1])
        for _ in range(size.bit_length()):
            turn = (turn - turn.inv()) * fmpq(1, 2)
        imaginary = [-sum(((action * turn)[k, k] for k in range(size)), fmpq(0)) / size for action in actions]
    width, height = copies * size, copies * size * len(actions)
    rows = fmpq_mat(height, width)
    for a, action in enumerate(actions):
        for copy in range(copies):
            at = (a * copies + copy) * size
            for i in range(size):
                for j in range(size):
                    rows[at + i, copy * size + j] = action[i, j] - (traces[a] if i == j else 0)
                if copies == 2:
                    rows[at + i, (1 - copy) * size + i] = imaginary[a] * (1 - 2 * copy)
    vectors = _columns(_kernel(rows)[0])
    for vector in vectors:
        yield _pieces(vector, size), [traces, imaginary][:copies]
    if len(vectors) == width:
        return
    for vector in vectors:  # P with A P = chi P + c Q, a Jordan block of length two
        wide = fmpq_mat(height, width + copies * len(actions))
        for i in range(height):
            for j in range(width):
                wide[i, j] = rows[i, j]
        for a in range(len(actions)):
            for i in range(width):
                wide[a * width + i, width + copies * a] = -vector[i]
                if copies == 2:
                    wide[a * width + i, width + copies * a + 1] = vector[i + size] if i < size else -vector[i - size]
        for solution in _columns(_kernel(wide)[0]):
            if any(value != 0 for value in solution[width:]):
                constants = [solution[width + copy :: copies] for copy in range(copies)]
                yield [*_pieces(solution[:width], size), *_pieces(vector, size)], constants


def _pieces(vector: list[Any], size: int) -> list[fmpq_mat]:
    from flint import fmpq_mat

    return [fmpq_mat(size, 1, vector[at : at + size]) for at in range(0, len(vector), size)]


def _columns(matrix: fmpq_mat) -> list[list[Any]]:
    return [[matrix[i, j] for i in range(matrix.nrows())] for j in range(matrix.ncols())]


def _identity(size: int) -> fmpq_mat:
    from flint import fmpq_mat

    return fmpq_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])


def _kernel(matrix: fmpq_mat) -> tuple[fmpq_mat, list[int]]:
    """Return a basis of the kernel as columns, and the rows in which it is the identity."""
    from flint import fmpq_mat

    reduced, rank = matrix.rref()
    width = matrix.ncols()
    pivots = [next(j for j in range(width) if reduced[i, j] != 0) for i in range(rank)]
    free = sorted(set(range(width)) - set(pivots))
    basis = fmpq_mat(width, len(free))
    for column, j in enumerate(free):
        basis[j, column] = 1
        for i, pivot in enumerate(pivots):
            basis[pivot, column] = -reduced[i, j]
    return basis, free


def _restricted(action: fmpq_mat, basis: fmpq_mat) -> fmpq_mat:
    """Return the action on an invariant subspace in a basis of its columns."""
    transposed, rank = basis.transpose().rref()
    rows = [next(j for j in range(basis.nrows()) if transposed[i, j] != 0) for i in range(rank)]
    return _rows(basis, rows).inv() * _rows(action * basis, rows)


def _rows(matrix: fmpq_mat, rows: Sequence[int]) -> fmpq_mat:
    from flint import fmpq_mat

    return fmpq_mat(len(rows), matrix.ncols(), [matrix[i, j] for i in rows for j in range(matrix.ncols())])


def _derived_algebra(
    triples: Triples, integers: NDArray[Any], dim: int
) -> tuple[list[list[tuple[int, Any]]], list[int]]:
    """Return a basis of [g, g] as sparse vectors, and the basis elements that complete it to one of the algebra."""
    from flint import fmpq_mat

    pairs = {
        pair: row for row, pair in enumerate(sorted(set(zip(triples.i.tolist(), triples.j.tolist(), strict=True))))
    }
    brackets = fmpq_mat(len(pairs), dim)
    for i, j, k, value in zip(triples.i.tolist(), triples.j.tolist(), triples.k.tolist(), integers, strict=True):
        brackets[pairs[i, j], k] = rational(value)
    reduced, rank = brackets.rref()
    rows = [[(k, reduced[row, k]) for k in range(dim) if reduced[row, k] != 0] for row in range(rank)]
    return rows, sorted(set(range(dim)) - {row[0][0] for row in rows})


def _root(coefficients: Sequence[Any]) -> tuple[Any, Any] | None:
    """Return real and imaginary part of a root of an irreducible factor if both are rational, else None."""
    from flint import fmpq

    c, b, *a = (int(value) for value in coefficients)
    if not a:
        return fmpq(-c, b), fmpq(0)
    square = 4 * a[0] * c - b * b
    if len(a) > 1 or square < 0 or math.isqrt(square) ** 2 != square:
        return None
    return fmpq(-b, 2 * a[0]), fmpq(math.isqrt(square), abs(2 * a[0]))


def _polynomial(column: fmpq_mat, basis: NDArray[np.int64], dim: int) -> Polynomial:
    values = ((row, fraction(column[row, 0])) for row in range(column.nrows()))
    return Polynomial({tuple(np.bincount(basis[row], minlength=dim).tolist()): v for row, v in values if v})


def _quotient(numerator: Polynomial, denominator: Polynomial) -> LogarithmicSum:
    """Return a quotient as a multiple of one of primitive polynomials."""
    first, second = _primitive(numerator), _primitive(denominator)
    (e, value), (f, divisor) = next(iter(numerator.monomials.items())), next(iter(denominator.monomials.items()))
    scale = Fraction(value) / first.monomials[e] / (Fraction(divisor) / second.monomials[f])
    return LogarithmicSum.quotient(first, second) * scale


def _primitive(polynomial: Polynomial) -> Polynomial:
    """Return the multiple with coprime integers, the first of which is positive."""
    integers = coprime_integers(polynomial.monomials.values())
    return Polynomial(dict(zip(polynomial.monomials, integers, strict=True)))
