"""Commutators of matrices as combinations of them: structure constants of Lie algebras given by matrices."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from numbers import Rational
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.rational_constants import as_fraction
from coadjoint.algebra.exact.sparse_sums import Floats
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import read_list

MAX_NUMBERS = 1 << 22
"""Largest number of entries of all commutators together."""
PRECISION = 256
"""Bits of numbers that are not rational."""
EXACT_ZERO = 2.0**-128
"""Numbers of `PRECISION` bits below this, relative to their terms, are zero."""
ROUNDOFF = 64 * UNIT_ROUNDOFF
"""Defects of entries in floating point below this, times N, relative to their terms, are rounding."""
MAX_ROOT_PRODUCT = 2**20
"""Largest product of numerator and denominator of the square of a float that is read as a square root."""
CLEARLY_INDEPENDENT = 1e-6
"""Distance of a matrix of length 1 from the span of others from which on it needs no further test."""
LARGEST = 2.0**200
"""Range of the largest entries, whose products must stay in that of floats."""
MAX_SHOWN = 400
"""Characters of a matrix in a message."""
RULE = "give a list of square matrices of one size, as nested lists or arrays"


def read_matrices(matrices: Any) -> list[NDArray[Any]]:
    """Validate matrices; return them as object arrays of real numbers (Fraction or float), complex ones as real ones.

    A + iB becomes [[A, -B], [B, A]].
    """
    if hasattr(matrices, "toarray") or (isinstance(matrices, np.ndarray) and matrices.ndim != 3):
        raise TypeError(f"matrices is a single array of shape {matrices.shape}; {RULE}")
    listed = [one.toarray() if hasattr(one, "toarray") else one for one in read_list(matrices, "matrices", RULE)]
    arrays: list[NDArray[Any]] = []
    for number, one in enumerate(listed):
        try:
            array = np.array(one, dtype=object)
        except ValueError:
            raise ValueError(f"matrix {number} has rows of different lengths; {RULE}") from None
        if array.ndim != 2 or array.shape[0] != array.shape[1] or not array.size:
            raise ValueError(f"matrix {number} has shape {array.shape}; {RULE}")
        if array.shape != (arrays[0].shape if arrays else array.shape):
            raise ValueError(f"matrix {number} has shape {array.shape}, and matrix 0 {arrays[0].shape}; {RULE}")
        arrays.append(array)
    if not arrays:
        raise ValueError(f"matrices is empty; {RULE}")
    parts = [[_real_and_imaginary(value, number) for value in one.ravel()] for number, one in enumerate(arrays)]
    real, imaginary = (
        [_object_array([pair[k] for pair in one]).reshape(arrays[0].shape) for one in parts] for k in (0, 1)
    )
    for number, values in enumerate(parts):
        size = max(abs(part) for pair in values for part in pair)
        if size and not 1 / LARGEST <= size <= LARGEST:
            raise ValueError(
                f"the largest entry of matrix {number} is {float(size):.3g}; take units in which it is between "
                f"{1 / LARGEST:.1g} and {LARGEST:.1g}"
            )
    if not any(np.any(B != 0) for B in imaginary):
        return real
    return [np.block([[A, -B], [B, A]]) for A, B in zip(real, imaginary, strict=True)]


def _real_and_imaginary(value: Any, number: int) -> tuple[Any, Any]:
    if isinstance(value, Rational):
        return Fraction(int(value.numerator), int(value.denominator)), Fraction(0)
    try:
        if isinstance(value, str | bytes):
            raise TypeError
        found = complex(value)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"matrix {number} contains {short(value)}; give numbers") from None
    if not (math.isfinite(found.real) and math.isfinite(found.imag)):
        raise ValueError(f"matrix {number} contains {short(value)}; every entry must be finite")
    return found.real, found.imag


def _object_array(values: Sequence[Any]) -> NDArray[Any]:
    result = np.empty(len(values), dtype=object)
    result[:] = values
    return result


def square_root(value: float) -> Fraction | None:
    """Return the simple fraction q with value = sqrt(q) or -sqrt(q), up to two units in the last place; None if none.

    Examples
    --------
    >>> square_root(-math.sqrt(2) / 3), square_root(0.1234567)
    (Fraction(2, 9), None)
    """
    square = Fraction(value * value).limit_denominator(2**10)
    if square <= 0 or square.numerator * square.denominator > MAX_ROOT_PRODUCT:
        return None
    return square if abs(math.sqrt(square) - abs(value)) <= 4 * UNIT_ROUNDOFF * abs(value) else None


class MatrixSpan:
    """Linearly independent matrices, and the coordinates of their commutators.

    Rational entries, also floats that round simple fractions, are computed with exactly. So are, to 2^-128, square
    roots of simple fractions. Other entries are taken as they are, with commutators by least squares. Raises ValueError
    if the matrices are dependent.
    """

    def __init__(self, matrices: Sequence[NDArray[Any]], names: Sequence[str]) -> None:
        entries = {value for matrix in matrices for value in matrix.ravel().tolist()}
        self.names = tuple(names)
        self._numbers = _read_entries(entries)
        self.rational = all(isinstance(value, Fraction) for value in self._numbers.values())
        self.exact = self.rational or not any(isinstance(value, float) for value in self._numbers.values())
        self._size = matrices[0].shape[0]
        self._check_size(len(matrices))
        self._matrices: list[Any] = []
        self._sizes: list[float] = []
        with _precision():
            exact = [self._matrix(matrix) for matrix in matrices]
            if _clearly_independent(exact):
                self._set(exact)
            else:
                for number, matrix in enumerate(exact):
                    self._append(matrix, self.names[number])

    def _matrix(self, matrix: NDArray[Any]) -> Any:
        from flint import arb, arb_mat, fmpq, fmpq_mat

        found: list[Any] = []
        for value in matrix.ravel().tolist():
            number = self._numbers[value]
            if isinstance(number, tuple):
                root = (arb(number[1].numerator) / arb(number[1].denominator)).sqrt()
                found.append(root if number[0] > 0 else -root)
            elif isinstance(number, Fraction):
                ratio = fmpq(number.numerator, number.denominator)
                found.append(ratio if self.rational else arb(ratio))
            else:
                found.append(arb(number))
        return (fmpq_mat if self.rational else arb_mat)(self._size, self._size, found)

    def _flat(self, matrices: Sequence[Any]) -> Any:
        """Return matrices as the rows of one matrix."""
        kind = type(self._matrices[0]) if self._matrices else type(matrices[0])
        entries = [entry for matrix in matrices for entry in matrix.entries()]
        return kind(len(matrices), self._size**2, entries)

    def _check_size(self, count: int) -> None:
        pairs = count * (count - 1) // 2
        if pairs * self._size**2 > MAX_NUMBERS:
            raise ValueError(
                f"{count} matrices of size {self._size} have {pairs} commutators, too many to be computed exactly; "
                "take a family, such as co.algebras.su(N), or give the structure constants"
            )

    def _append(self, matrix: Any, name: str) -> None:
        self._check_size(len(self) + 1)
        size = _largest(matrix.entries())
        if size == 0.0:
            raise ValueError(f"{name} is zero; give linearly independent matrices")
        if self._matrices:
            coordinates, (defect,) = self._coordinates([matrix])
            if self._is_zero(defect, size):
                shown = _combination(coordinates.entries(), self.names)
                raise ValueError(f"{name} is {shown}; give linearly independent matrices")
        self._set([*self._matrices, matrix])

    def _set(self, matrices: list[Any]) -> None:
        self._matrices, self._sizes = matrices, [_largest(matrix.entries()) for matrix in matrices]
        self._rows = self._flat(matrices)
        columns = self._rows.transpose()
        self._weights = columns * (self._rows * columns).inv()

    def _coordinates(self, matrices: Sequence[Any]) -> tuple[Any, list[float]]:
        """Return the coordinates of the nearest combinations, and the largest entries of what remains."""
        flat = self._flat(matrices)
        coordinates = flat * self._weights
        remainder = (flat - coordinates * self._rows).entries()
        width = self._size**2
        return coordinates, [_largest(remainder[k * width : (k + 1) * width]) for k in range(len(matrices))]

    def _is_zero(self, defect: float, size: float) -> bool:
        if self.rational:
            return defect == 0.0
        return defect <= (EXACT_ZERO if self.exact else ROUNDOFF * self._size) * size

    def __len__(self) -> int:
        return len(self._matrices)

    @property
    def matrices(self) -> Floats:
        """The matrices in floating point, shape (n, N, N)."""
        flat = [[float(value) for value in matrix.entries()] for matrix in self._matrices]
        return np.array(flat).reshape(len(self), self._size, self._size)

    def _commutator(self, i: int, j: int) -> tuple[Any, float]:
        """Return a commutator, and the size of its terms."""
        A, B = self._matrices[i], self._matrices[j]
        return A * B - B * A, self._size * self._sizes[i] * self._sizes[j]

    def constants(self) -> list[tuple[int, int, int, float]]:
        """Return the structure constants (i, j, k, c), i < j; raise ValueError if a commutator is no combination."""
        found: list[tuple[int, int, int, float]] = []
        with _precision():
            for i in range(len(self)):
                later = range(i + 1, len(self))
                if not later:
                    break
                commutators = [self._commutator(i, j) for j in later]
                coordinates, defects = self._coordinates([commutator for commutator, _ in commutators])
                values = coordinates.entries()
                for number, (j, (commutator, size), defect) in enumerate(zip(later, commutators, defects, strict=True)):
                    if not self._is_zero(defect, size):
                        raise ValueError(self._open(i, j, commutator, defect / size))
                    row = values[number * len(self) : (number + 1) * len(self)]
                    for k, value in enumerate(row):
                        if not self._is_zero(abs(float(value)) * self._sizes[k], size):
                            found.append((i, j, k, _rounded(value)))
        return found

    def _open(self, i: int, j: int, commutator: Any, defect: float) -> str:
        shown = [float(value) for value in commutator.entries()]
        rows = [shown[r * self._size : (r + 1) * self._size] for r in range(self._size)]
        text = short([[f"{value:.6g}" for value in row] for row in rows], MAX_SHOWN).replace("'", "")
        return (
            f"[{self.names[i]}, {self.names[j]}] is no combination of the matrices, by {defect:.1g} of its terms; "
            f"add the matrix {text}, or let LieAlgebra.closure add what is missing"
        )

    def close(self, largest: int) -> None:
        """Append commutators that are no combinations, until there are none; raise ValueError above a dimension."""
        with _precision():
            for i, j in self._pairs():
                commutator, size = self._commutator(i, j)
                _, (defect,) = self._coordinates([commutator])
                if self._is_zero(defect, size):
                    continue
                if len(self) >= largest:
                    raise ValueError(
                        f"the matrices generate an algebra of more than {largest} dimensions, which is too large; "
                        "give fewer or smaller matrices"
                    )
                self.names = (*self.names, f"e{len(self) + 1}")
                self._append(commutator, self.names[-1])

    def _pairs(self) -> Iterator[tuple[int, int]]:
        """Yield all pairs i < j, also of matrices that are appended meanwhile."""
        j = 1
        while j < len(self):
            for i in range(j):
                yield i, j
            j += 1


def _combination(coordinates: Sequence[Any], names: Sequence[str]) -> str:
    """Return a linear combination as text.

    >>> _combination([1, 0, -2.5], ("A", "B", "C"))
    'A - 2.5 C'
    """
    text = ""
    for c, name in zip(map(float, coordinates), names, strict=False):
        if abs(c) > ROUNDOFF:
            factor = "" if f"{abs(c):.6g}" == "1" else f"{abs(c):.6g} "
            text += (" - " if c < 0 else " + ") + factor + name
    return text.removeprefix(" + ").replace(" - ", "-", 1) if text.startswith(" - ") else text.removeprefix(" + ")


def _clearly_independent(matrices: Sequence[Any]) -> bool:
    """Return whether matrices are far from dependent in floating point."""
    directions: list[Floats] = []
    for matrix in matrices:
        row = np.array([float(value) for value in matrix.entries()])
        size = float(np.sqrt(np.sum(row**2)))
        if not 0.0 < size < math.inf:
            return False
        rest = row / size
        for direction in (*directions, *directions):
            rest = rest - np.sum(rest * direction) * direction
        distance = float(np.sqrt(np.sum(rest**2)))
        if distance < CLEARLY_INDEPENDENT:
            return False
        directions.append(rest / distance)
    return True


def _read_entries(entries: set[Any]) -> dict[Any, Any]:
    """Return for each entry a Fraction, (sign, square of a root), or the float itself if some entry is neither."""
    found: dict[Any, Any] = {}
    for value in entries:
        simple = value if isinstance(value, Fraction) else as_fraction(value)
        if simple is None and (square := square_root(value)) is not None:
            found[value] = (1 if value > 0 else -1), square
        else:
            found[value] = value if simple is None else simple
    if any(isinstance(value, float) for value in found.values()):
        return {value: value for value in entries}
    return found


def _largest(values: Sequence[Any]) -> float:
    return max((abs(float(value)) for value in values), default=0.0)


def _rounded(value: Any) -> float:
    """Return the float nearest to a number of flint."""
    if hasattr(value, "p"):
        return float(Fraction(int(value.p), int(value.q)))
    return float(value)


def _precision() -> Any:
    from flint import ctx

    return ctx.workprec(PRECISION)
