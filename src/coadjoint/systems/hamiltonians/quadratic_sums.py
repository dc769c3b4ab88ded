"""Sums and multiples of quadratic Hamiltonians, by entries; fractions stay exact."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.polynomials.product_sums import Coefficient
from coadjoint.memory import check_available_memory
from coadjoint.systems.evaluation import ignore_overflow
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.matrix_entries import BYTES_PER_ENTRY


@ignore_overflow
def add_quadratics(first: Quadratic, second: Quadratic) -> Quadratic:
    """Return the sum of two quadratic Hamiltonians; raise ValueError on different dimensions or overflow.

    Examples
    --------
    >>> add_quadratics(Quadratic([1.0, 2.0]), Quadratic([[0.0, 1.0], [1.0, 0.0]], linear=[3.0, 0.0]))
    Quadratic([[1.0, 1.0], [1.0, 2.0]], linear=[3.0, 0.0])
    """
    dim = first.dim if first.dim is not None else second.dim
    if dim is None:
        return Quadratic(first.scalar + second.scalar, constant=first.constant + second.constant)
    if second.dim not in (None, dim):
        raise ValueError(f"Hamiltonians of {dim} and {second.dim} coordinates cannot be added")
    one, other = first.bind(dim).as_given(), second.bind(dim).as_given()
    count = len(one.entries) + len(other.entries)
    check_available_memory(BYTES_PER_ENTRY * count, f"a sum of matrices with {count} entries")
    rows, columns = np.r_[one.rows, other.rows], np.r_[one.columns, other.columns]
    entries = np.concatenate([one.entries, other.entries])
    order = np.lexsort((columns, rows))
    rows, columns, entries = rows[order], columns[order], entries[order]
    begins = np.flatnonzero(np.r_[True, (np.diff(rows) != 0) | (np.diff(columns) != 0)][: len(rows)])
    if len(begins):
        rows, columns, entries = rows[begins], columns[begins], np.add.reduceat(entries, begins)
    return Quadratic.from_entries(
        dim, rows, columns, _plain(entries), _plain(one.linear + other.linear), first.constant + second.constant
    )


@ignore_overflow
def scale_quadratic(H: Quadratic, factor: Coefficient) -> Quadratic:
    """Return a multiple of a quadratic Hamiltonian, bound or not; raise ValueError on overflow."""
    if H.dim is None:
        return Quadratic(H.scalar * factor, constant=H.constant * factor)
    own = H.as_given()
    entries, linear = _plain(own.entries * _like(factor, own.entries)), _plain(own.linear * _like(factor, own.linear))
    return Quadratic.from_entries(H.dim, own.rows, own.columns, entries, linear, H.constant * factor)


def _like(factor: Coefficient, numbers: npt.NDArray[Any]) -> Any:
    return factor if numbers.dtype == object else float(factor)


def _plain(numbers: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return an array of objects as float64 if all are floats."""
    if numbers.dtype == object and all(isinstance(one, float) for one in numbers):
        return numbers.astype(np.float64)
    return numbers
