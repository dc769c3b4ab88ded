"""Sparse structure constants, validated: antisymmetry and the Jacobi identity; direct summands of an algebra."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from coadjoint.algebra.exact.sparse_sums import (
    DEFECT_FACTOR,
    Floats,
    Integers,
    chunks,
    connected,
    expand,
    group_max_abs,
    groups,
    largest_violation,
    parts_and_rows,
    positions,
)
from coadjoint.memory import check_available_memory
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short
from coadjoint.validation import read_integer, read_list, read_numbers, read_title

# Peak during construction: names and their lookup table; four columns, three times; and parts of them, up to a size.
BYTES_PER_DIMENSION = 140
BYTES_PER_NAME = 260  # with its place in mappings of names; measured, with a margin
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
    """Format basis elements for a message: "(e1, e2) = indices (0, 1)"."""
    return f"({', '.join(names[q] for q in indices)}) = indices ({', '.join(str(q) for q in indices)})"


def check_algebra_memory(name: str, dim: int, constants: int) -> None:
    """Raise a ValueError if an algebra with about `constants` nonzero c_ij^k (i < j) does not fit in memory."""
    parts = min(BYTES_OF_PARTS * constants, MAX_BYTES_OF_PARTS)
    need = BYTES_PER_DIMENSION * dim + BYTES_PER_CONSTANT * constants + parts
    check_available_memory(need, f"{name}, of dimension {short(dim)},", "take a smaller one")


def parse_constants(constants: Any, dim: int | None) -> tuple[int, Triples, bool]:
    """Parse structure constants in any accepted form to dim, unsorted triples, and whether they are complete."""
    # Complete (dense input): constants not listed are zero; otherwise they follow from antisymmetry.
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
    first = constants[0] if isinstance(constants, list | tuple) and constants else None
    if isinstance(first, list | tuple) and any(isinstance(entry, str) for entry in first):
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


def read_basis(basis: Sequence[str] | None, dim: int) -> tuple[str, ...]:
    """Validate the names of the basis elements; the default is ``e1, e2, ...``."""
    if basis is None:
        check_available_memory(BYTES_PER_NAME * dim, f"the basis of an algebra of dimension {short(dim)}")
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


def antisymmetric(triples: Triples, dim: int, names: Sequence[str], complete: bool) -> Triples:
    """Check antisymmetry and return the constants with i < j, sorted, unique and nonzero."""
    # Opposite values may differ by 64 u times the largest constant that involves e_i, or e_j if that is smaller.
    # If not `complete`, a pair listed in one order only defines the other; otherwise unlisted constants are zero.
    order, starts = groups(triples.i, triples.j, triples.k)
    i, j, k, c = triples.rows(order)
    first = np.repeat(starts, np.diff(np.append(starts, order.size)))
    wrong = np.flatnonzero(c != c[first])
    if wrong.size:
        row = int(wrong[0])
        where = triple_name((int(i[row]), int(j[row]), int(k[row])), names)
        raise ValueError(
            f"structure constant {where} is given twice, as {c[first[row]]:g} and as {c[row]:g}; give it once"
        )
    i, j, k, c = i[starts], j[starts], k[starts], c[starts]
    size = np.zeros(dim)
    np.maximum.at(size, i, np.abs(c))
    np.maximum.at(size, j, np.abs(c))
    allowed = DEFECT_FACTOR * UNIT_ROUNDOFF * np.minimum(size[i], size[j])
    diagonal = np.flatnonzero((i == j) & ((np.abs(c) > allowed) | (not complete and c != 0.0)))
    if diagonal.size:
        row = int(diagonal[0])
        raise ValueError(
            f"[{names[i[row]]}, {names[i[row]]}] (index {i[row]}) must be zero, but has component {c[row]:g} "
            f"along {names[k[row]]}"
        )
    off_diagonal = i != j
    i, j, k, c, allowed = i[off_diagonal], j[off_diagonal], k[off_diagonal], c[off_diagonal], allowed[off_diagonal]
    forward = i < j
    low, high = np.minimum(i, j), np.maximum(i, j)
    order, starts = groups(low * dim + high, k)
    ahead, behind = (
        np.add.reduceat(np.where(side, c, 0.0)[order], starts) if order.size else c[:0] for side in (forward, ~forward)
    )
    allowed = allowed[order[starts]] if order.size else allowed
    low, high, k = low[order[starts]], high[order[starts]], k[order[starts]]
    paired = np.full(low.size, complete)
    if not complete and not forward.all():
        pairs = (i * dim + j)[forward], (j * dim + i)[~forward]
        paired = np.isin(low * dim + high, np.intersect1d(*pairs))
    wrong = np.flatnonzero(paired & (np.abs(0.5 * ahead + 0.5 * behind) > 0.5 * allowed))
    if wrong.size:
        row = int(wrong[0])
        pair = int(low[row]), int(high[row])
        raise ValueError(
            f"antisymmetry violated for {triple_name(pair, names)}: component {names[k[row]]} is {ahead[row]:g} in "
            f"[{names[pair[0]]}, {names[pair[1]]}] and {behind[row]:g} in the opposite order; they must be opposite"
        )
    exact = ahead == -behind
    value = np.where(paired, np.where(exact, ahead, 0.5 * ahead - 0.5 * behind), ahead - behind)
    nonzero = value != 0.0
    return Triples(low[nonzero], high[nonzero], k[nonzero], value[nonzero])


def both_orders(triples: Triples) -> Triples:
    """Return the constants of i < j followed by those of i > j."""
    i, j, k, c = triples
    return Triples(np.concatenate([i, j]), np.concatenate([j, i]), np.concatenate([k, k]), np.concatenate([c, -c]))


def check_jacobi(triples: Triples, dim: int, names: Sequence[str]) -> None:
    """Check the Jacobi identity sum_m (c_ab^m c_md^l + c_bd^m c_ma^l + c_da^m c_mb^l) = 0 for all a < b < d and l."""
    # The tolerance is 64 u times the sum of the absolute products, each constant taken as the largest in its bracket.
    # Products of nonzero constants are formed in runs of bounded memory; the first bad run is reported.
    both = both_orders(triples)
    order, _ = groups(both.i, both.j, both.k)
    outer = both.rows(order)  # by first, then second index
    outer_size = group_max_abs(outer.i * dim + outer.j, outer.c)
    order, _ = groups(triples.k, triples.i)
    inner = triples.rows(order)  # by component, then first index
    inner_size = group_max_abs(inner.i * dim + inner.j, inner.c)
    outer_key, inner_key = outer.i * dim + outer.j, inner.k * dim + inner.i
    # The free indices of the other factor must exceed a: a contiguous range of the sorted rows.
    outer_start = np.searchsorted(outer_key, outer.k * dim + outer.i, side="right")
    outer_stop = np.searchsorted(outer_key, (outer.k + 1) * dim)
    outer_stop = np.where(outer.j > outer.i, np.maximum(outer_stop, outer_start), outer_start)
    inner_start = np.searchsorted(inner_key, outer.j * dim + outer.i, side="right")
    inner_stop = np.maximum(np.searchsorted(inner_key, (outer.j + 1) * dim), inner_start)
    costs = (outer_stop - outer_start) + (inner_stop - inner_start)
    for part in chunks(outer.i, costs.astype(np.int64)):
        a, b, m, c = outer.rows(part)
        row, position = expand(outer_start[part], outer_stop[part])  # +-c_ab^m c_md^l
        third = outer.j[position]
        row, position, third = (column[third != b[row]] for column in (row, position, third))
        low, high = np.minimum(b[row], third), np.maximum(b[row], third)
        inner_row, inner_position = expand(inner_start[part], inner_stop[part])  # c_bd^m c_ma^l = -c_am^l c_bd^m
        first = np.concatenate([np.where(b[row] < third, c[row], -c[row]), -c[inner_row]])
        second = np.concatenate([outer.c[position], inner.c[inner_position]])
        size = outer_size[part]
        sizes = (
            np.concatenate([size[row], size[inner_row]]),
            np.concatenate([outer_size[position], inner_size[inner_position]]),
        )
        pair = np.concatenate([a[row] * dim + low, a[inner_row] * dim + inner.i[inner_position]])
        rest = np.concatenate([high * dim + outer.k[position], inner.j[inner_position] * dim + m[inner_row]])
        violation = largest_violation((pair, rest), (first, second), sizes)
        if violation is not None:
            (a_, b_), (d_, l_) = divmod(int(pair[violation[0]]), dim), divmod(int(rest[violation[0]]), dim)
            raise ValueError(
                f"Jacobi identity violated for {triple_name((a_, b_, d_), names)}: defect {violation[1]:.3g} in "
                f"component {names[l_]}, where it must be zero to {DEFECT_FACTOR} units of round-off of its products"
            )


def summands(triples: Triples, dim: int) -> Iterator[tuple[Integers, Triples]]:
    """Yield the direct summands visible in the basis: sorted coordinates, and their constants renumbered from 0."""
    # Casimirs of a direct sum are generated by those of its summands, and its rank is the sum of theirs.
    i, j, k, _ = triples
    label = connected(dim, np.concatenate([i, i]), np.concatenate([j, k]))
    position = positions(label)
    for members, rows in parts_and_rows(label, i):
        yield members, Triples(position[i[rows]], position[j[rows]], position[k[rows]], triples.c[rows])
