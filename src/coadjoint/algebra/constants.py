"""Sparse structure constants and their validation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from coadjoint.algebra import brackets as bracket_text
from coadjoint.algebra.exact.sparse_sums import Floats, Integers
from coadjoint.memory import check_available_memory
from coadjoint.short_repr import short
from coadjoint.validation import read_integer, read_list, read_numbers, read_title

# Peak during construction: names and their lookup table; four columns, three times; and parts of them, up to a size.
BYTES_PER_DIMENSION = 140
BYTES_PER_CONSTANT = 130
BYTES_OF_PARTS, MAX_BYTES_OF_PARTS = 100, 10**8


class Triples(NamedTuple):
    """Structure constants c_ij^k in sparse form, [e_i, e_j] = sum_k c e_k: four arrays (m,), indices from 0."""

    i: Integers
    j: Integers
    k: Integers
    c: Floats

    def rows(self, chosen: Any) -> Triples:
        """Return the chosen rows: a slice, indices, or a mask."""
        return Triples(self.i[chosen], self.j[chosen], self.k[chosen], self.c[chosen])


def triple_name(indices: Sequence[int], names: Sequence[str]) -> str:
    """Format basis elements for a message.

    Examples
    --------
    >>> triple_name((0, 1, 3), ("e1", "e2", "e3", "e4"))
    '(e1, e2, e4) = indices (0, 1, 3)'
    """
    return f"({', '.join(names[q] for q in indices)}) = indices ({', '.join(str(q) for q in indices)})"


def check_algebra_memory(name: str, dim: int, constants: int) -> None:
    """Raise a ValueError if an algebra with about `constants` nonzero c_ij^k (i < j) does not fit in memory.

    Examples
    --------
    >>> check_algebra_memory("so(3)", 3, 3)
    """
    parts = min(BYTES_OF_PARTS * constants, MAX_BYTES_OF_PARTS)
    need = BYTES_PER_DIMENSION * dim + BYTES_PER_CONSTANT * constants + parts
    check_available_memory(need, f"{name}, of dimension {short(dim)},", "take a smaller one")


def parse_constants(constants: Any, dim: int | None) -> tuple[int, Triples, bool]:
    """Parse structure constants in any accepted form; return dim, unsorted triples, and whether they are complete.

    Complete (dense input): constants not listed are zero. Otherwise (sparse input) they follow from antisymmetry.

    Examples
    --------
    >>> dim, triples, complete = parse_constants([(0, 1, 1, 1.0)], 2)
    >>> dim, triples.c, complete
    (2, array([1.]), False)
    """
    if dim is not None:
        dim = read_integer(dim, "dim")
        check_algebra_memory("the Lie algebra", dim, 0)
    if isinstance(constants, Triples):
        columns = [
            read_numbers(column, f"column {name} of the triples") for name, column in constants._asdict().items()
        ]
        if any(column.shape != columns[3].shape or column.ndim != 1 for column in columns):
            raise ValueError("the four columns i, j, k, c of the triples must be one-dimensional and of equal length")
        return _from_columns(columns, dim)
    if isinstance(constants, list | tuple) and any(isinstance(v, str) for row in constants[:1] for v in _entries(row)):
        raise TypeError("structure constants use indices from 0; give brackets by names to LieAlgebra.from_brackets")
    numbers = read_numbers(constants, "structure constants")
    if numbers.ndim == 3:
        return _from_dense(numbers, dim)
    if numbers.size == 0 and numbers.ndim <= 2:
        numbers = numbers.reshape(0, 4)
    if numbers.ndim != 2 or numbers.shape[1] != 4:
        raise ValueError(
            f"structure constants must have shape (n, n, n) or be rows (i, j, k, c); their shape is {numbers.shape}"
        )
    return _from_columns(list(numbers.T), dim)


def _from_dense(numbers: Floats, dim: int | None) -> tuple[int, Triples, bool]:
    n = numbers.shape[0]
    if numbers.shape != (n, n, n) or n == 0:
        raise ValueError(f"dense structure constants must have shape (n, n, n) with n >= 1, not {numbers.shape}")
    if dim is not None and dim != n:
        raise ValueError(f"dim = {dim} does not fit dense structure constants of shape {numbers.shape}")
    i, j, k = (index.astype(np.int64) for index in np.nonzero(numbers))
    values = numbers[i, j, k]
    _check_finite_constants(i, j, k, values)
    return n, Triples(i, j, k, values), True


def _entries(row: Any) -> tuple[Any, ...]:
    return tuple(row) if isinstance(row, list | tuple) else ()


def _from_columns(columns: list[Floats], dim: int | None) -> tuple[int, Triples, bool]:
    if dim is None:
        raise ValueError("dim must be given with sparse structure constants, which do not determine it")
    for name, column in zip("ijk", columns, strict=False):
        wrong = np.flatnonzero(~((column >= 0) & (column < dim) & (column == np.floor(column))))
        if wrong.size:
            row = int(wrong[0])
            raise ValueError(
                f"index {name} = {column[row]:g} in row {row} of the structure constants must be an integer "
                f"from 0 to {dim - 1}"
            )
    i, j, k = (column.astype(np.int64) for column in columns[:3])
    _check_finite_constants(i, j, k, columns[3])
    return int(dim), Triples(i, j, k, columns[3]), False


def _check_finite_constants(i: Integers, j: Integers, k: Integers, c: Floats) -> None:
    wrong = np.flatnonzero(~np.isfinite(c))
    if wrong.size:
        row = int(wrong[0])
        raise ValueError(
            f"structure constant (i, j, k) = ({i[row]}, {j[row]}, {k[row]}) is {c[row]}; it must be finite"
        )


def parse_brackets(dim: int, brackets: Any, basis: Sequence[str] | None = None) -> list[tuple[Any, Any, Any, Any]]:
    """Convert ``{(i, j): {k: c}}`` to rows (i, j, k, c); basis names may replace indices.

    An empty bracket is retained: the pair commutes, which contradicts a nonzero bracket in the opposite order.
    """
    if isinstance(brackets, list | tuple) and brackets and all(isinstance(line, str) for line in brackets):
        brackets = bracket_text.parse_brackets(brackets, read_basis(basis, dim))
    if not isinstance(brackets, Mapping):
        raise TypeError(
            f"brackets must be a mapping {{(i, j): {{k: c}}}}, or lines such as '[e1, e2] = e3', not "
            f"{type(brackets).__name__}"
        )
    rows: list[tuple[Any, Any, Any, Any]] = []
    for pair, components in brackets.items():
        if not (isinstance(pair, tuple) and len(pair) == 2):
            raise TypeError(f"each key of brackets must be a pair of indices (i, j), not {short(pair)}")
        if not isinstance(components, Mapping):
            raise TypeError(f"bracket {short(pair)} must be a mapping {{k: c}}, not {short(components)}")
        rows.extend((*pair, k, c) for k, c in components.items())
        if not components:
            rows.append((*pair, 0, 0.0))
    if any(isinstance(entry, str) for row in rows for entry in row[:3]):
        names = read_basis(basis, dim)
        rows = [(*(_basis_index(entry, names) for entry in row[:3]), row[3]) for row in rows]
    numbers = [entry for row in rows for entry in row[:3] if isinstance(entry, int)]
    if numbers and min(numbers) == 1 and max(numbers) == dim:
        raise ValueError(f"brackets use indices from 0, and these go from 1 to {dim}; subtract 1 from each")
    return rows


def _basis_index(argument: Any, names: Sequence[str]) -> Any:
    """Return the index of a basis element given by name."""
    if not isinstance(argument, str):
        return argument
    if argument not in names:
        raise ValueError(
            f"brackets name {short(argument)}, which is not in the basis {short(tuple(names))}; give basis="
        )
    return names.index(argument)


def read_basis(basis: Sequence[str] | None, dim: int) -> tuple[str, ...]:
    """Validate the names of the basis elements; the default is ``e1, e2, ...``.

    Examples
    --------
    >>> read_basis(None, 2)
    ('e1', 'e2')
    """
    if basis is None:
        return tuple(f"e{i}" for i in range(1, dim + 1))
    names = (basis,) if isinstance(basis, str) else read_list(basis, "basis", "it must be a sequence of names")
    if len(names) != dim:
        raise ValueError(f"basis must have {dim} names, one for each dimension, not {len(names)}")
    for position, label in enumerate(names):
        read_title(label, f"name {position} of the basis")
    seen: set[str] = set()
    for label in names:
        if label in seen:
            raise ValueError(f"basis name {short(label)} is given twice; names must differ")
        seen.add(label)
    return names
