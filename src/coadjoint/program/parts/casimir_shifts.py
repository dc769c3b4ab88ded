"""Casimir shifts: H - c C generates the same motion as H, and may have fewer parts; these can be counted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.exact.sparse_sums import distinct
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.commutation import MAX_REORDERED, count_groups
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.squares import complete_squares
from coadjoint.program.sparse_rows import MAX_PATTERN_SIZE, run_starts
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.terms import QuadraticTerm, Term
from coadjoint.systems.lie_poisson import LiePoissonSystem

Shift = tuple[tuple[str, float], ...]
Rule = tuple[tuple[str, int, float], ...]
"""Casimirs of a shift, each with a coordinate whose square it removes, and the entry of the Casimir there."""
Entries = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]

MAX_SINGULAR_DIMENSION = 8  # coordinates; above, singular factors, of n^3 for each bisection, are not sought
MAX_DENSE_DIMENSION = 32  # coordinates; up to this size adding all n^2 entries is faster than sorting the nonzero ones
# An entry after a shift counts as zero below this multiple of the sum of its absolute terms.
ROUNDING = 4 * UNIT_ROUNDOFF
BISECTIONS = 64  # of an interval of floats: to the last bit


class QuadraticCasimir(NamedTuple):
    """Casimir homogeneous of degree two, C = x.A x/2, with the entries of A."""

    polynomial: Polynomial
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    values: NDArray[np.float64]

    @property
    def diagonal(self) -> bool:
        return bool(np.array_equal(self.rows, self.columns))


def quadratic_casimirs(system: LiePoissonSystem) -> dict[str, QuadraticCasimir]:
    """Return the known Casimirs that are polynomials homogeneous of degree two, by name."""
    casimirs = {}
    for name, casimir in system.casimirs.items():
        if isinstance(casimir, Polynomial):
            entries = quadratic_entries(casimir)
            if entries is not None:
                casimirs[name] = QuadraticCasimir(casimir, *entries)
    return casimirs


def quadratic_entries(casimir: Polynomial) -> Entries | None:
    """Return rows, columns and values of A in C = x.A x/2; None if C is not homogeneous of degree two."""
    return (_cached_entries if casimir.dim <= MAX_PATTERN_SIZE else _compute_entries)(casimir)


def _compute_entries(casimir: Polynomial) -> Entries | None:
    pairs = [[k for k, e in powers.items() for _ in range(e)] for _, _, powers in casimir._factors]
    if not pairs or any(len(pair) != 2 for pair in pairs):
        return None
    i, j = np.array(pairs, dtype=np.int64).T
    values = np.array([float(c) for _, c, _ in casimir._factors])
    off_diagonal = i != j
    rows, columns = np.concatenate([i, j[off_diagonal]]), np.concatenate([j, i[off_diagonal]])
    return rows, columns, np.concatenate([np.where(off_diagonal, values, 2.0 * values), values[off_diagonal]])


# Cached, since scans over constants subtract the same Casimir repeatedly.
_cached_entries = lru_cache(maxsize=256)(_compute_entries)


def quadratic_position(terms: Sequence[Term]) -> int | None:
    """Return the index of the quadratic term outside of pieces, from which Casimirs are subtracted, or None."""
    return next((k for k, term in enumerate(terms) if term.form is not None and term.piece is None), None)


def shifted_terms(terms: Sequence[Term], casimirs: Mapping[str, QuadraticCasimir], shift: Shift) -> tuple[Term, ...]:
    """Subtract multiples of quadratic Casimirs from the quadratic term of a Hamiltonian."""
    if not shift:
        return tuple(terms)
    unknown = [name for name, _ in shift if name not in casimirs]
    if unknown:
        raise ValueError(f"the shift names {unknown[0]!r}; the quadratic Casimirs are {', '.join(map(repr, casimirs))}")
    index = quadratic_position(terms)
    if index is None:
        raise ValueError("a shift needs a quadratic term in the Hamiltonian, outside the pieces of a SplitHamiltonian")
    term = terms[index].form
    assert term is not None
    entries = [(term.rows, term.indices.astype(np.int64), term.values)]
    for name, factor in shift:
        casimir = casimirs[name]
        entries.append((casimir.rows, casimir.columns, -factor * casimir.values))
    rows, columns = (np.concatenate([entry[side] for entry in entries]) for side in (0, 1))
    values = np.concatenate([entry[2] for entry in entries])
    n = len(term.linear)
    flat, cells = rows * n + columns, np.arange(n * n) if n <= MAX_DENSE_DIMENSION else None
    if cells is None:
        cells, flat = np.unique(flat, return_inverse=True)
    total: NDArray[Any] = np.bincount(flat, weights=values, minlength=len(cells))
    nonzero = np.abs(total) > ROUNDING * np.bincount(flat, weights=np.abs(values), minlength=len(cells))
    rows, columns = np.divmod(cells[nonzero], n)
    indptr = np.searchsorted(rows, np.arange(n + 1))
    changed = QuadraticTerm(indptr, columns, total[nonzero], term.linear, term.constant)
    return (*terms[:index], changed, *terms[index + 1 :])


def without_squares(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Return terms without what diagonal Casimirs may remove: their parts are the fewest that a shift may leave."""
    index = quadratic_position(terms)
    if index is None:
        return tuple(terms)
    term = terms[index].form
    assert term is not None
    mixed = term.rows != term.indices
    indptr = np.searchsorted(term.rows[mixed], np.arange(len(term.linear) + 1))
    rest = QuadraticTerm(indptr, term.indices[mixed], term.values[mixed], term.linear, term.constant)
    return (*terms[:index], rest, *terms[index + 1 :])


def candidate_shifts(
    system: LiePoissonSystem, parts: Parts, casimirs: Mapping[str, QuadraticCasimir]
) -> Iterable[Shift]:
    """Yield shifts, each once, for which a coordinate, one of `parts`, or a completed square may vanish."""
    forms = (term.form for term in system.hamiltonian.terms() if term.piece is None)
    quadratic = [form for form in forms if form is not None]
    if not quadratic or not casimirs:
        return
    on_diagonal = quadratic[0].rows == quadratic[0].indices
    diagonal = dict(
        zip(quadratic[0].indices[on_diagonal].tolist(), quadratic[0].values[on_diagonal].tolist(), strict=True)
    )
    seen: set[Shift] = {()}
    for rule in shift_rules(parts, casimirs):
        factors = [(name, diagonal.get(coordinate, 0.0) / entry) for name, coordinate, entry in rule]
        shift = tuple((name, factor) for name, factor in factors if factor)
        if shift not in seen:
            seen.add(shift)
            yield shift
    if len(casimirs) == 1 and system.dim <= MAX_SINGULAR_DIMENSION:
        ((name, casimir),) = casimirs.items()
        term = quadratic[0]
        matrices = (term.rows, term.indices, term.values), casimir[1:]
        for factor in singular_factors(*(_dense_matrix(system.dim, *entries) for entries in matrices)):
            if ((name, factor),) not in seen:
                yield ((name, factor),)


def shift_rules(parts: Parts, casimirs: Mapping[str, QuadraticCasimir]) -> Iterable[Rule]:
    """Yield rules for shifts after which coordinates have no square."""
    holders = _casimirs_by_square(casimirs)
    edges = parts.forms.start[parts.angle]
    for first, last in pairwise(edges.tolist()):
        coordinates = distinct(parts.forms.coordinate[first:last]).tolist()
        # All coordinates of a part at once, each by the first Casimir with its square (a lattice has one per spin).
        joint: dict[str, tuple[str, int, float]] = {}
        for coordinate in coordinates:
            for name, entry in holders.get(coordinate, [])[:1]:
                joint.setdefault(name, (name, coordinate, entry))
        yield tuple(rule for _, rule in sorted(joint.items()))
        for coordinate in coordinates if len(casimirs) <= 4 else []:
            for name, entry in holders.get(coordinate, []):
                yield ((name, coordinate, entry),)


def _casimirs_by_square(casimirs: Mapping[str, QuadraticCasimir]) -> dict[int, list[tuple[str, float]]]:
    """Return for each coordinate the Casimirs with its square, and their diagonal entries."""
    holders: dict[int, list[tuple[str, float]]] = {}
    for name, casimir in casimirs.items():
        on_diagonal = casimir.rows == casimir.columns
        for coordinate, value in zip(
            casimir.rows[on_diagonal].tolist(), casimir.values[on_diagonal].tolist(), strict=True
        ):
            holders.setdefault(coordinate, []).append((name, value))
    return holders


def _dense_matrix(
    n: int, rows: NDArray[Any], columns: NDArray[Any], values: NDArray[np.float64]
) -> NDArray[np.float64]:
    matrix = np.zeros((n, n))
    matrix[rows, columns] = values
    return matrix


def count_parts(
    system: LiePoissonSystem, casimirs: Mapping[str, QuadraticCasimir], shifts: Sequence[Shift]
) -> NDArray[np.int64]:
    """Count the parts of ``"auto"`` after each shift; 0 if they must be built to be counted."""
    counts = np.zeros(len(shifts), dtype=np.int64)
    terms = system.hamiltonian.terms()
    term = terms[0].form
    if not shifts or len(terms) > 1 or term is None or term.piece is not None:
        return counts
    used = {name for shift in shifts for name, _ in shift}
    if np.any(term.rows != term.indices) or not all(casimirs[name].diagonal for name in used):
        return counts
    diagonal = np.zeros(system.dim)
    diagonal[term.indices] = term.values
    present = np.empty((system.dim, len(shifts)), dtype=bool)
    for number, shift in enumerate(shifts):
        total, size = diagonal.copy(), np.abs(diagonal)
        for name, factor in shift:
            casimir = casimirs[name]
            total[casimir.rows] -= factor * casimir.values
            size[casimir.rows] += np.abs(factor * casimir.values)
        present[:, number] = (np.abs(total) > ROUNDING * size) | (term.linear != 0)
    i, j, _, _ = system.algebra.triples
    pairs = run_starts(i, j)
    countable = np.flatnonzero(np.count_nonzero(present, axis=0) > MAX_REORDERED)
    counts[countable] = count_groups(system.dim, i[pairs], j[pairs], present[:, countable])
    return counts


def singular_factors(matrix: NDArray[np.float64], casimir: NDArray[np.float64]) -> tuple[float, ...]:
    """Return the c with M - c C singular, where a square vanishes, for symmetric M and definite C (else empty).

    Real zeros of det(M - c C) are counted in integers and bisected, to the float beyond; a diagonal M gives its own.
    """
    if not np.any(matrix - np.diag(np.diag(matrix))):
        return ()
    size = len(matrix)
    sign, smallest = _definiteness(casimir.tobytes(), size)
    if sign == 0:
        return ()
    bound = 2.0 * size**2 * float(np.max(np.abs(matrix))) / smallest
    polynomial = _determinant(matrix, sign * casimir)
    factors = []
    for count in range(1, size + 1):
        low, high = -bound, bound
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            previous = low, high
            low, high = (low, middle) if _zeros_below(polynomial, middle) >= count else (middle, high)
            if (low, high) == previous:
                break
        factors.append(sign * high)
    return tuple(sorted(factors))


@lru_cache(maxsize=64)
def _definiteness(entries: bytes, size: int) -> tuple[int, float]:
    """Return +1 or -1 for a definite matrix and 0 for any other, and the smallest absolute pivot."""
    matrix = np.frombuffer(entries).reshape(size, size)
    lift = np.vectorize(Fraction, otypes=[object])
    weights = list(complete_squares(lift(matrix), lift(np.zeros(size))).weights)
    signs = {weight > 0 for weight in weights}
    if len(weights) < size or len(signs) != 1:
        return 0, 0.0
    return (1 if weights[0] > 0 else -1), min(float(abs(weight)) for weight in weights)


def _determinant(matrix: NDArray[np.float64], casimir: NDArray[np.float64]) -> list[int]:
    """Return integer coefficients of a multiple of det(M - c C), the characteristic polynomial of C^-1 M."""
    from flint import fmpq_mat

    M, C = (fmpq_mat([[rational(value) for value in row] for row in each.tolist()]) for each in (matrix, casimir))
    return [int(value) for value in C.solve(M).charpoly().numer().coeffs()]


def _zeros_below(polynomial: list[int], point: float) -> int:
    """Count the zeros of a polynomial of real zeros below a point, by Descartes' rule, exact for these."""
    numerator, denominator = point.as_integer_ratio()
    degree = len(polynomial) - 1
    about = [value * denominator ** (degree - power) for power, value in enumerate(polynomial)]
    for start in range(degree):
        for power in range(degree - 1, start - 1, -1):
            about[power] += numerator * about[power + 1]
    signs = [value > 0 for value in about if value]
    at_point = next(power for power, value in enumerate(about) if value)
    return degree - at_point - sum(a != b for a, b in pairwise(signs))
