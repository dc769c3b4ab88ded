"""Sparse exact linear algebra over the rational numbers: spans, membership, inverses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Any

from coadjoint.algebra.exact.numbers import fraction, read_exact
from coadjoint.validation import read_list, reject_lossy_conversion

Number = int | Fraction
Vector = dict[int, Number]


def read_vector(argument: Any, dim: int, what: str) -> Vector:
    """Return the nonzero components of a vector as exact rational numbers; floats are converted exactly."""
    reject_lossy_conversion(argument, what)
    values = read_list(argument, what, "it must be a sequence of numbers")
    if len(values) != dim:
        raise ValueError(f"{what} must have {dim} components, not {len(values)}")
    vector: Vector = {}
    for i, value in enumerate(values):
        number = read_exact(value, f"component {i} of {what}")
        if number:
            vector[i] = number
    return vector


def add_multiple(left: Vector, factor: Number, right: Mapping[int, Number]) -> None:
    """Add factor * right to left in place, dropping entries that cancel."""
    for i, value in right.items():
        total = left.get(i, 0) + factor * value
        if total:
            left[i] = total
        else:
            left.pop(i, None)


class Span:
    """The span of independent sparse vectors {index: number}; a dependent vector raises ValueError."""

    def __init__(self, vectors: Iterable[Mapping[int, Number]] = ()) -> None:
        self._rows: dict[int, tuple[Vector, Vector]] = {}  # pivot -> row with 1 there, and its combination
        for number, vector in enumerate(vectors):
            if not self.add(vector):
                raise ValueError(f"vector {number} is a combination of the vectors before it")

    def add(self, vector: Mapping[int, Number]) -> bool:
        """Add a vector unless it is in the span; return whether it was added."""
        rest, used = self._reduced(vector)
        if not rest:
            return False
        pivot = min(rest)
        scale = Fraction(1) / rest[pivot]
        combination: Vector = {len(self._rows): scale}
        add_multiple(combination, -scale, used)
        row: Vector = {i: value * scale for i, value in rest.items()}
        for earlier_row, coordinates in self._rows.values():
            factor = earlier_row.get(pivot, 0)
            if factor:
                add_multiple(earlier_row, -factor, row)
                add_multiple(coordinates, -factor, combination)
        self._rows[pivot] = row, combination
        return True

    def _reduced(self, vector: Mapping[int, Number]) -> tuple[Vector, Vector]:
        """Return the remainder of a vector modulo the span, and the combination that was subtracted."""
        rest, used = dict(vector), dict[int, Number]()
        for pivot in [i for i in vector if i in self._rows]:  # rows have zeros at the other pivots
            row, combination = self._rows[pivot]
            factor = rest[pivot]
            add_multiple(rest, -factor, row)
            add_multiple(used, factor, combination)
        return rest, used

    def combination(self, vector: Mapping[int, Number]) -> Vector | None:
        """Return the coefficients of a vector in the given ones, by their number; None if it is outside the span."""
        rest, used = self._reduced(vector)
        return None if rest else {i: fraction(used[i]) for i in sorted(used)}

    def remainder(self, vector: Mapping[int, Number]) -> Vector:
        """Return the representative of a vector modulo the span that is zero at the pivots."""
        return self._reduced(vector)[0]

    @property
    def pivots(self) -> frozenset[int]:
        """Pivot indices, one per vector."""
        return frozenset(self._rows)
