"""Kernels over the rational numbers: elimination modulo primes, rational reconstruction, and exact verification."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.exact.ranks import random_prime, residues
from coadjoint.algebra.exact.sparse_sums import groups
from coadjoint.algebra.invariants.casimir_equations import CasimirEquations, Vector, solutions
from coadjoint.long_operations import note_progress

if TYPE_CHECKING:
    from flint import nmod_mat

MAX_UNKNOWNS = 3000  # of a block; at most a minute


def _row_echelon_form(rows: nmod_mat) -> tuple[tuple[int, ...], list[list[int]]]:
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
    return _row_echelon_form(kernel.transpose())


def fraction_modulo(residue: int, modulus: int) -> Fraction | None:
    """Return the fraction p/q with p^2, q^2 <= modulus/2 that has this residue, or None (Wang's algorithm)."""
    bound = math.isqrt(modulus // 2)
    previous, current = (modulus, 0), (residue, 1)
    while current[0] > bound:
        quotient = previous[0] // current[0]
        previous, current = current, (previous[0] - quotient * current[0], previous[1] - quotient * current[1])
    if current[1] == 0 or abs(current[1]) > bound or math.gcd(current[0], current[1]) != 1:
        return None
    return Fraction(current[0], current[1])


def annihilated(linear_equations: CasimirEquations, vector: Vector) -> bool:
    """Return whether a rational vector fulfils the equations exactly."""
    common = math.lcm(*(Fraction(value).denominator for value in vector.values()))
    dense = np.zeros(linear_equations.unknowns, dtype=object)
    for column, value in vector.items():
        dense[column] = int(value * common)
    touched = np.isin(linear_equations.columns, list(vector))
    terms = linear_equations.values[touched].astype(object) * dense[linear_equations.columns[touched]]
    order, starts = groups(linear_equations.along[touched], linear_equations.target[touched])
    return not (order.size and np.any(np.add.reduceat(terms[order], starts) != 0))


def _block_kernel(linear_equations: CasimirEquations, rng: np.random.Generator) -> list[Vector]:
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
            vector = {index: fraction_modulo(value, modulus) for index, value in enumerate(row) if value}
            if None in vector.values() or not annihilated(linear_equations, vector):
                break
            vectors.append(vector)
        if len(vectors) == len(pivots):
            return vectors


def kernel(linear_equations: CasimirEquations, largest: int = MAX_UNKNOWNS) -> list[Vector]:
    """Return the solutions of integer equations as Fractions; every one fulfils its block in exact arithmetic."""
    rng = np.random.default_rng(0)
    return solutions(linear_equations, largest, 1, lambda block: _block_kernel(block, rng))


def pivots(rows: Sequence[Sequence[Any]], width: int) -> list[int]:
    """Return the pivot columns of the exact reduced row echelon form."""
    from flint import fmpq_mat

    if not rows:
        return []
    flat = [rational(value) for row in rows for value in row]
    reduced, rank = fmpq_mat(len(rows), width, flat).rref()
    entries = reduced.entries()
    return [next(column for column in range(width) if entries[row * width + column] != 0) for row in range(rank)]
