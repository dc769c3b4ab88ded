"""Matrix Lie algebras: exact structure constants from a sparse basis and its coordinate functions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction

import numpy as np

from coadjoint.algebra.constants import Triples, read_basis
from coadjoint.algebra.exact.sparse_sums import Floats, Integers, expand, groups
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.monomials import Coefficient, exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.representation import commutator_products

MAX_REPRESENTATION_NUMBERS = 2**24  # in a representation of the catalogue: 128 MB; so(60) has 1770 * 60^2
MAX_STORED_EXPONENTS = 2**22  # exponents in all the known Casimirs of an algebra: 32 MB; so(60) has 1770^2

Entry = tuple[int, int, int, float]
Form = list[tuple[int, int, int | Fraction]]


def sparse_matrices(entries: Iterable[Entry]) -> Triples:
    """Return entries (number, row, column, value) of a list of sparse matrices as arrays, matrix after matrix."""
    table = np.array(list(entries), dtype=np.float64).reshape(-1, 4)
    table = table[np.argsort(table[:, 0], kind="stable")]
    number, row, column = (each.astype(np.int64) for each in table.T[:3])
    return Triples(number, row, column, table[:, 3].copy())


def commutator_constants(basis: Triples, coordinates: Triples, size: int) -> Triples:
    """Return the constants of [X_a, X_b] = sum_k c_ab^k X_k for a < b, unique and nonzero, of a sparse `basis`."""
    # Coordinate k of a matrix M is the sum of w_k[r, c] M[r, c], with w_k from `coordinates`. Exact if entries and
    # weights are small multiples of a power of two.
    position = coordinates.j * size + coordinates.k
    weights, _ = groups(position)
    position = position[weights]
    blocks: list[Triples] = []
    for _, (p, q), (r, s) in commutator_products(basis, int(basis.i.max(initial=0)) + 1):
        first = np.concatenate([basis.i[p], basis.i[r]])
        second = np.concatenate([basis.i[q], basis.i[s]])
        target = np.concatenate([basis.j[p] * size + basis.k[q], basis.j[s] * size + basis.k[r]])
        value = np.concatenate([basis.c[p] * basis.c[q], -basis.c[s] * basis.c[r]])
        entry, match = expand(np.searchsorted(position, target), np.searchsorted(position, target, side="right"))
        weight = weights[match]
        k, c = coordinates.i[weight], value[entry] * coordinates.c[weight]
        blocks.append(_summed(first[entry], second[entry], k, c))
    return Triples(*(np.concatenate(column) for column in zip(*blocks, strict=True)))


def _summed(i: Integers, j: Integers, k: Integers, c: Floats) -> Triples:
    order, starts = groups(i, j, k)
    if not order.size:
        return Triples(i, j, k, c)
    total = np.add.reduceat(c[order], starts)
    nonzero = total != 0.0
    representatives = order[starts][nonzero]
    return Triples(i[representatives], j[representatives], k[representatives], total[nonzero])


def matrices(basis: Triples, count: int, size: int) -> Floats | None:
    """Return the matrices as an array (count, size, size), or None above 128 MB."""
    if count * size**2 > MAX_REPRESENTATION_NUMBERS:
        return None
    result = np.zeros((count, size, size))
    np.add.at(result, (basis.i, basis.j, basis.k), basis.c)
    return result


def real_form(real: Sequence[Entry], imaginary: Sequence[Entry], size: int) -> list[Entry]:
    """Return complex matrices A + i B as real ones (A, -B; B, A) of twice the size."""
    entries: list[Entry] = []
    for number, row, column, value in real:
        entries += [(number, row, column, value), (number, row + size, column + size, value)]
    for number, row, column, value in imaginary:
        entries += [(number, row, column + size, -value), (number, row + size, column, value)]
    return entries


def matrix_algebra(
    name: str,
    basis: Sequence[Entry],
    coordinates: Sequence[Entry],
    size: int,
    forms: Mapping[str, Form],
    sums: Mapping[str, Iterable[int]] | None = None,
) -> LieAlgebra:
    """Return the algebra spanned by matrices, given as sparse entries (number, row, column, value)."""
    # `coordinates` are those of `commutator_constants`; `forms` quadratic Casimirs, name -> (i, j, c) for sums of c x_i
    # x_j; `sums` linear ones, name -> indices. Casimirs and representations above 32 and 128 MB are omitted.
    sparse = sparse_matrices(basis)
    dim = int(sparse.i.max()) + 1
    casimirs = {}
    if casimirs_fit(sum(map(len, forms.values())), dim):
        casimirs = {key: linear(dict.fromkeys(indices, 1), dim) for key, indices in (sums or {}).items()}
        casimirs |= {key: quadratic(form, dim) for key, form in forms.items()}
    # Matrix commutators satisfy all identities, and the matrices are a representation: no check is needed.
    constants = commutator_constants(sparse, sparse_matrices(coordinates), size)
    return LieAlgebra._from_valid(constants, dim, read_basis(None, dim), name, matrices(sparse, dim, size), casimirs)


def casimirs_fit(monomials: int, dim: int) -> bool:
    """Return whether polynomials with this many monomials in `dim` coordinates are small enough to be stored."""
    return monomials * dim <= MAX_STORED_EXPONENTS


def quadratic(entries: Iterable[tuple[int, int, Coefficient]], dim: int) -> Polynomial:
    """Return the sum of c x_i x_j over the entries (i, j, c)."""
    total: dict[tuple[int, ...], Coefficient] = {}
    for i, j, value in entries:
        exponents = exponents_of((i, j), dim)
        total[exponents] = total.get(exponents, 0) + value
    return Polynomial._from_valid(total, dim)


def linear(entries: Mapping[int, Coefficient], dim: int) -> Polynomial:
    """Return the sum of c_i x_i."""
    return Polynomial._from_valid({exponents_of((i,), dim): value for i, value in entries.items()}, dim)


def traceless(n: int, begin: int, scale: int) -> Form:
    """Return the inverse of the trace form on E_kk - E_(k+1)(k+1), the Cartan matrix of sl(n), times `scale`."""
    return [
        (begin + a, begin + b, Fraction(scale * (min(a, b) + 1) * (n - 1 - max(a, b)), n))
        for a in range(n - 1)
        for b in range(n - 1)
    ]
