"""Kernels of floating-point equations by singular values, accepted only if they leave a clear gap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from coadjoint.algebra.exact.ranks import rank_from_gap
from coadjoint.algebra.exact.sparse_sums import DEFECT_FACTOR, Floats, groups
from coadjoint.algebra.invariants.casimir_equations import CasimirEquations, Vector, solutions
from coadjoint.rounding import UNIT_ROUNDOFF

MAX_UNKNOWNS = 1000  # of a block; at most a minute
MIN_PIVOT = 2.0**-20  # pivots of unit vectors must be above this or below round-off


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


def _block_kernel(linear_equations: CasimirEquations) -> list[Vector]:
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


def kernel(linear_equations: CasimirEquations, largest: int = MAX_UNKNOWNS) -> list[Vector]:
    """Return the solutions of floating-point equations.

    With F the Frobenius norm of entry errors of 64 u times the largest entry (u = 2^-53), singular values up to F are
    zero and the others must exceed 2^10 F; pivots must exceed 2^-20 or be round-off. ValueError without a clear gap.
    """
    return solutions(linear_equations, largest, 1.0, _block_kernel)


def pivots(rows: Sequence[Sequence[Any]], width: int) -> list[int]:
    """Return the pivot columns of the reduced row echelon form if they are unambiguous."""
    if not rows:
        return []
    matrix = np.array(rows, dtype=np.float64)
    _, singular, basis = np.linalg.svd(matrix, full_matrices=False)
    roundoff = DEFECT_FACTOR * UNIT_ROUNDOFF * float(np.linalg.norm(matrix))
    rank = rank_from_gap(singular, roundoff, "the products of Casimirs")
    return _row_echelon_form(basis[:rank], roundoff / singular[rank - 1])[0]
