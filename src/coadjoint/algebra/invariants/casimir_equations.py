"""Linear equations for the homogeneous polynomial Casimirs of one degree, and their kernels: exact or in floats.

Exact kernels are found by elimination modulo primes, rational reconstruction and exact verification; those in floats by
singular values, accepted only if they leave a clear gap.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.constants import Triples
from coadjoint.algebra.exact.elimination import random_prime, rank_from_gap, residues
from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.exact.sparse_sums import (
    DEFECT_FACTOR,
    Floats,
    Integers,
    connected,
    expand,
    group_max_abs,
    groups,
    parts_and_rows,
    positions,
)
from coadjoint.long_operations import note_progress
from coadjoint.rounding import UNIT_ROUNDOFF

if TYPE_CHECKING:
    from flint import nmod_mat

MAX_EXACT_UNKNOWNS = 3000  # of a block; at most a minute
MAX_NUMERICAL_UNKNOWNS = 1000
MIN_PIVOT = 2.0**-20  # pivots of unit vectors must be above this or below round-off

Vector = dict[int, Any]  # unknown -> coefficient, sorted; the first coefficient is 1


class CasimirEquations(NamedTuple):
    """Sparse linear equations for the coefficients v of a polynomial that every derivation e_i annihilates."""

    # In the derivative along e_i, i = along[m], monomial target[m] has the term values[m] v[columns[m]].

    unknowns: int
    along: Integers
    target: Integers
    columns: Integers
    values: NDArray[Any]


def monomial_count(dim: int, degree: int) -> int:
    """Return the number of monomials of a degree in `dim` coordinates."""
    return math.comb(dim + degree - 1, degree)


def monomials(dim: int, degree: int) -> Integers:
    """Return the monomials of a degree as sorted tuples of coordinates, in the order of `Polynomial.monomials`."""
    rows = np.zeros((1, 0), dtype=np.int64)
    for _ in range(degree):
        last = rows[:, -1] if rows.shape[1] else np.zeros(1, dtype=np.int64)
        row, variable = expand(last, np.full(last.size, dim, dtype=np.int64))
        rows = np.column_stack([rows[row], variable])
    return rows


def monomial_positions(basis: Integers, dim: int) -> Integers:
    """Return the positions of sorted tuples in the list `monomials`."""
    count, degree = basis.shape
    result = np.zeros(count, dtype=np.int64)
    previous = np.zeros(count, dtype=np.int64)
    for slot in range(degree):
        # number of tuples of the remaining length with all entries >= a
        counts = np.array([monomial_count(dim - a, degree - slot) for a in range(dim)], dtype=np.int64)
        result += counts[previous] - counts[basis[:, slot]]
        previous = basis[:, slot]
    return result


def equations(triples: Triples, values: NDArray[Any], basis: Integers, dim: int) -> CasimirEquations:
    """Assemble J(x) grad C(x) = 0, sum_jk c_ij^k x_k dC/dx_j = 0 for all i, monomial by monomial."""
    # `values` are the constants, integer objects or floats. A sum of floats below 64 u times its absolute terms counts
    # as zero (u = 2^-53), each constant taken as the largest in its bracket, as in the Jacobi check.
    count, degree = basis.shape
    acting, removed = np.concatenate([triples.i, triples.j]), np.concatenate([triples.j, triples.i])
    added, constants = np.concatenate([triples.k, triples.k]), np.concatenate([values, -values])
    if constants.dtype == object and max(map(abs, constants.tolist()), default=0) * degree * dim < 2**62:
        constants = constants.astype(np.int64)
    by_removed = np.argsort(removed, kind="stable")
    acting, added, constants = acting[by_removed], added[by_removed], constants[by_removed]
    begin = np.searchsorted(removed[by_removed], np.arange(dim + 1)).astype(np.int64)
    positions, entries = [], []
    for slot in range(degree):
        variable = basis[:, slot]
        column, source = expand(begin[variable], begin[variable + 1])
        changed = basis[column]
        changed[:, slot] = added[source]
        changed.sort(axis=1)
        positions.append((acting[source] * count + monomial_positions(changed, dim)) * count + column)
        entries.append(source)
    position, entry = np.concatenate(positions), np.concatenate(entries)
    term = constants[entry]
    order, starts = groups(position)
    value = np.add.reduceat(term[order], starts) if order.size else term
    tolerance: Any = 0
    if constants.dtype.kind == "f" and order.size:
        sizes = np.tile(group_max_abs(triples.i * dim + triples.j, values), 2)[by_removed]
        tolerance = DEFECT_FACTOR * UNIT_ROUNDOFF * np.add.reduceat(sizes[entry][order], starts)
    nonzero = np.asarray(np.abs(value) > tolerance, dtype=bool)
    row, column = np.divmod(position[order[starts]][nonzero], count)
    along, target = np.divmod(row, count)
    return CasimirEquations(count, along, target, column, value[nonzero])


def blocks(linear_equations: CasimirEquations) -> Iterator[tuple[Integers, CasimirEquations]]:
    """Yield the independent blocks: their sorted unknowns, and their equations renumbered from 0."""
    # Unknowns that one equation sets to zero are eliminated repeatedly; the remaining equations split into connected
    # blocks. This finds every grading visible in the basis: weights of diagonal elements, reflection signs of so(n).
    names, rows = np.unique(
        linear_equations.along * linear_equations.unknowns + linear_equations.target, return_inverse=True
    )
    rows = rows.astype(np.int64)
    columns, values = linear_equations.columns, linear_equations.values
    unresolved = np.ones(linear_equations.unknowns, dtype=bool)
    single = np.bincount(rows, minlength=names.size)[rows] == 1
    while single.any():
        unresolved[columns[single]] = False
        remaining = unresolved[columns]
        rows, columns, values = rows[remaining], columns[remaining], values[remaining]
        single = np.bincount(rows, minlength=names.size)[rows] == 1
    label = connected(linear_equations.unknowns + names.size, columns, linear_equations.unknowns + rows)[
        : linear_equations.unknowns
    ]
    position = positions(label)
    for members, block_rows in parts_and_rows(label, columns):
        if unresolved[members[0]]:
            along, target = np.divmod(names[rows[block_rows]], linear_equations.unknowns)
            target = np.unique(target, return_inverse=True)[1].astype(np.int64)
            yield (
                members,
                CasimirEquations(members.size, along, target, position[columns[block_rows]], values[block_rows]),
            )


def solutions(
    linear_equations: CasimirEquations, largest: int, one: Any, block_kernel: Callable[[CasimirEquations], list[Vector]]
) -> list[Vector]:
    """Return the solutions in reduced row echelon form, {unknown: value}, by leading unknown, from those of blocks."""
    # Blocks of at most `largest` unknowns are solved as dense matrices; `one` is a free coefficient.
    found: list[Vector] = []
    for unknowns, part in blocks(linear_equations):
        if part.unknowns > largest and part.values.size:
            raise ValueError(
                f"{part.unknowns} coefficients of a Casimir are coupled, above the limit of {largest}; "
                f"lower max_degree, or choose a basis with diagonal or sparse brackets"
            )
        of_block = block_kernel(part) if part.values.size else [{index: one} for index in range(part.unknowns)]
        found += [{int(unknowns[index]): value for index, value in vector.items()} for vector in of_block]
    return sorted(found, key=lambda vector: next(iter(vector)))


def _modular_echelon_form(rows: nmod_mat) -> tuple[tuple[int, ...], list[list[int]]]:
    """Return pivots and rows of the reduced row echelon form."""
    reduced, rank = rows.rref()
    width = reduced.ncols()
    flat = [int(value) for value in reduced.entries()[: rank * width]]
    echelon = [flat[index * width : (index + 1) * width] for index in range(rank)]
    return tuple(next(index for index, value in enumerate(row) if value) for row in echelon), echelon


def _kernel_modulo(linear_equations: CasimirEquations, prime: int) -> tuple[tuple[int, ...], list[list[int]]]:
    """Return the kernel modulo a prime in reduced row echelon form, intersected derivation by derivation."""
    from flint import nmod_mat

    size, values = linear_equations.unknowns, residues(linear_equations.values, prime)
    order, starts = groups(linear_equations.along)
    cuts = np.split(order, starts[1:]) if order.size else []
    kernel: Any = None
    for selection in sorted(cuts, key=len, reverse=True):  # longest first, since it reduces the kernel most
        note_progress(f"the equations of {size} coupled coefficients")
        names, row = np.unique(linear_equations.target[selection], return_inverse=True)
        flat = [0] * (names.size * size)
        positions = (row * size + linear_equations.columns[selection]).tolist()
        for position, value in zip(positions, values[selection].tolist(), strict=True):
            flat[position] = value
        matrix = nmod_mat(names.size, size, flat, prime)
        if kernel is not None:
            matrix = matrix * kernel
        null, nullity = matrix.nullspace()
        if not nullity:
            return (), []
        width = null.nrows()
        chosen = [int(column == r) for r in range(width) for column in range(nullity)]
        null = null * nmod_mat(width, nullity, chosen, prime)
        kernel = null if kernel is None else kernel * null
    if kernel is None:
        kernel = nmod_mat(size, size, [int(a == b) for a in range(size) for b in range(size)], prime)
    return _modular_echelon_form(kernel.transpose())


def _fraction_modulo(residue: int, modulus: int) -> Fraction | None:
    """Return the fraction p/q with p^2, q^2 <= modulus/2 that has this residue, or None (Wang's algorithm)."""
    bound = math.isqrt(modulus // 2)
    previous, current = (modulus, 0), (residue, 1)
    while current[0] > bound:
        quotient = previous[0] // current[0]
        previous, current = current, (previous[0] - quotient * current[0], previous[1] - quotient * current[1])
    if current[1] == 0 or abs(current[1]) > bound or math.gcd(current[0], current[1]) != 1:
        return None
    return Fraction(current[0], current[1])


def _annihilated(linear_equations: CasimirEquations, vector: Vector) -> bool:
    """Return whether a rational vector fulfils the equations exactly."""
    common = math.lcm(*(Fraction(value).denominator for value in vector.values()))
    dense = np.zeros(linear_equations.unknowns, dtype=object)
    for column, value in vector.items():
        dense[column] = int(value * common)
    touched = np.isin(linear_equations.columns, list(vector))
    terms = linear_equations.values[touched].astype(object) * dense[linear_equations.columns[touched]]
    order, starts = groups(linear_equations.along[touched], linear_equations.target[touched])
    return not (order.size and np.any(np.add.reduceat(terms[order], starts) != 0))


def _exact_block_kernel(linear_equations: CasimirEquations, rng: np.random.Generator) -> list[Vector]:
    """Return the kernel of one block in reduced row echelon form."""
    # Modulo a prime the kernel is at least as large as over Q, so once that many reconstructed vectors fulfil the
    # equations exactly they span it. A prime with a larger kernel or later pivots is dropped.
    pivots: tuple[int, ...] = ()
    columns: list[list[int]] = []
    modulus = 1
    while True:
        prime = random_prime(rng)
        if modulus % prime == 0:
            continue
        leading, rows = _kernel_modulo(linear_equations, prime)
        if not leading:
            return []
        if modulus == 1 or (len(leading), leading) < (len(pivots), pivots):
            pivots, columns, modulus = leading, rows, prime
        elif leading == pivots:
            inverse = pow(modulus, -1, prime)
            columns = [
                [old + modulus * ((new - old) * inverse % prime) for old, new in zip(*pair, strict=True)]
                for pair in zip(columns, rows, strict=True)
            ]
            modulus *= prime
        else:
            continue
        vectors: list[Vector] = []
        for row in columns:
            vector = {index: _fraction_modulo(value, modulus) for index, value in enumerate(row) if value}
            if None in vector.values() or not _annihilated(linear_equations, vector):
                break
            vectors.append(vector)
        if len(vectors) == len(pivots):
            return vectors


def exact_kernel(linear_equations: CasimirEquations, largest: int = MAX_EXACT_UNKNOWNS) -> list[Vector]:
    """Return the solutions of integer equations as Fractions; every one fulfils its block in exact arithmetic."""
    rng = np.random.default_rng(0)
    return solutions(linear_equations, largest, 1, lambda block: _exact_block_kernel(block, rng))


def exact_pivots(rows: Sequence[Sequence[Any]], width: int) -> list[int]:
    """Return the pivot columns of the exact reduced row echelon form."""
    from flint import fmpq_mat

    if not rows:
        return []
    flat = [rational(value) for row in rows for value in row]
    reduced, rank = fmpq_mat(len(rows), width, flat).rref()
    entries = reduced.entries()
    return [next(column for column in range(width) if entries[row * width + column] != 0) for row in range(rank)]


def _row_echelon_form(basis: Floats, error: float) -> tuple[list[int], Floats, float]:
    """Return pivots, reduced row echelon form and its error, for orthonormal rows known to `error`."""
    rows = basis.copy()
    pivot_columns: list[int] = []
    for column in range(rows.shape[1]):
        rank = len(pivot_columns)
        if rank == len(rows):
            break
        pivot_row = rank + int(np.argmax(np.abs(rows[rank:, column])))
        size = abs(rows[pivot_row, column])
        if size <= error:
            continue
        if size < MIN_PIVOT:
            raise ValueError(
                f"a leading coefficient {size:.3g} of a Casimir is neither round-off (below {error:.3g}) nor above "
                f"{MIN_PIVOT:.3g}; give constants that are rational or more exact"
            )
        rows[[rank, pivot_row]] = rows[[pivot_row, rank]]
        rows[rank] /= rows[rank, column]
        other_rows = np.arange(len(rows)) != rank
        rows[other_rows] -= np.outer(rows[other_rows, column], rows[rank])
        pivot_columns.append(column)
        error *= max(1.0, 1.0 / size)
    return pivot_columns, rows, error


def _snap_to_integers(row: Floats, error: float) -> Floats:
    """Round coefficients that are within their error of a whole number (often zero) to it."""
    nearest = np.round(row)
    return np.where(np.abs(row - nearest) <= error * np.maximum(1.0, np.abs(nearest)), nearest, row)


def _numerical_block_kernel(linear_equations: CasimirEquations) -> list[Vector]:
    """Return the kernel of one block in reduced row echelon form, cleaned and checked against the equations."""
    order, starts = groups(linear_equations.along, linear_equations.target)
    row = np.repeat(np.arange(starts.size), np.diff(np.append(starts, order.size)))
    matrix = np.zeros((starts.size, linear_equations.unknowns))
    matrix[row, linear_equations.columns[order]] = linear_equations.values[order]
    if starts.size > linear_equations.unknowns:
        matrix = np.asarray(np.linalg.qr(matrix, mode="r"), dtype=np.float64)
    _, singular, basis = np.linalg.svd(matrix)
    # every entry is known to 64 u times the largest one
    roundoff = (
        DEFECT_FACTOR
        * UNIT_ROUNDOFF
        * float(np.abs(linear_equations.values).max())
        * math.sqrt(linear_equations.values.size)
    )
    rank = rank_from_gap(singular, roundoff, "the equations for Casimirs")
    if rank == linear_equations.unknowns:
        return []
    error = roundoff / singular[rank - 1] if rank else DEFECT_FACTOR * UNIT_ROUNDOFF
    pivot_columns, rows, error = _row_echelon_form(basis[rank:], error)
    vectors: list[Vector] = []
    for pivot, coefficients in zip(pivot_columns, rows, strict=True):
        clean = _snap_to_integers(coefficients, error)
        clean[:pivot] = 0.0
        residual = np.add.reduceat((linear_equations.values * clean[linear_equations.columns])[order], starts)
        allowed = error * float(np.abs(linear_equations.values).max()) * float(np.abs(clean).sum()) + roundoff
        if np.abs(residual).max() > allowed:
            raise ArithmeticError(
                f"a Casimir found in floats has the residual {np.abs(residual).max():.3g} in J(x) grad C(x) = 0, above "
                f"the {allowed:.3g} of round-off"
            )
        vectors.append({index: float(clean[index]) for index in np.flatnonzero(clean).tolist()})
    return vectors


def numerical_kernel(linear_equations: CasimirEquations, largest: int = MAX_NUMERICAL_UNKNOWNS) -> list[Vector]:
    """Return the solutions of floating-point equations; ValueError if singular values leave no clear gap."""
    # With F the Frobenius norm of entry errors of 64 u times the largest entry (u = 2^-53), singular values up to F are
    # zero and the others must exceed 2^10 F; pivots must exceed 2^-20 or be round-off.
    return solutions(linear_equations, largest, 1.0, _numerical_block_kernel)


def numerical_pivots(rows: Sequence[Sequence[Any]], width: int) -> list[int]:
    """Return the pivot columns of the reduced row echelon form if they are unambiguous."""
    if not rows:
        return []
    matrix = np.array(rows, dtype=np.float64)
    _, singular, basis = np.linalg.svd(matrix, full_matrices=False)
    roundoff = DEFECT_FACTOR * UNIT_ROUNDOFF * float(np.linalg.norm(matrix))
    rank = rank_from_gap(singular, roundoff, "the products of Casimirs")
    return _row_echelon_form(basis[:rank], roundoff / singular[rank - 1])[0]
