"""Cost model of steps by Taylor series, which counts vectors of rows in the layout of the kernels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.methods.protocol.cost_model import LANES, TERMS_PER_INVARIANT, Operations
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.system import System

# Sums of up to UNROLLED_VECTORS vectors of rows are unrolled, if no products are stored behind the coordinates. Others
# are slower by TABLE_FACTOR per vector.
UNROLLED_VECTORS, TABLE_FACTOR = 3, 2.0
# Dependent operations per vector of entries of the sums around factored products; one per vector of coordinates.
ENTRY_LATENCY = 0.5
# When products are factored, as in ``series_field.hpp``.
PRODUCT_COST, GRADIENT_COST, FACTORED_COST, ENTRY_COST, CHAIN_COST, MEMORY_COST = 11.4, 2.9, 6.0, 2.5, 10.0, 18.0


def series_operations(system: System, order: int, invariants: Iterable[HamiltonianLike]) -> Operations:
    """Return the operations of a step: products of series, dependent operations, and the projection.

    Examples
    --------
    A rigid body has one product per row, and four rows fill half a vector:

    >>> import coadjoint as co
    >>> series_operations(co.systems.rigid_body(inertia=(1, 2, 3)), 8, []).vectors
    16.0
    """
    lanes = 4 if system.dim <= 4 else LANES
    blocks = -(-system.dim // lanes)
    factored, waiting = factored_products(system, lanes), float(blocks)
    if factored is not None:
        products, entries = factored
        vectors = products * lanes / LANES
        waiting += ENTRY_LATENCY * entries
    else:
        product_blocks = vectors_of_gradient(system.hamiltonian)
        vectors = vectors_of_products(system, lanes) * lanes / LANES + product_blocks
        vectors *= TABLE_FACTOR if product_blocks or blocks > UNROLLED_VECTORS else 1.0
    rows = [vectors_of_invariant(C, system.dim, lanes) for C in invariants]
    invariant_terms = TERMS_PER_INVARIANT * len(rows) + sum(rows) / LANES
    return Operations(0.5 * order**2 * vectors, order * waiting, invariant_terms)


def vectors_of_products(system: System, lanes: int) -> float:
    """Return the number of vectors of rows that multiply series, in the layout of ``series_field.hpp``."""
    assert system.algebra is not None
    i, j, k, _ = system.algebra.triples
    row, state, factor = np.concatenate([i, j]), np.concatenate([k, k]), np.concatenate([j, i])
    terms = system.hamiltonian.terms()
    form = terms[0].form if len(terms) == 1 else None
    if form is not None and np.all(form.rows == form.indices):
        # Products are unrolled, each once; products with a coordinate that H does not contain are omitted.
        included = np.isin(factor, form.indices)
        pairs = np.stack([row, np.minimum(state, factor), np.maximum(state, factor)], axis=1)[included]
        row = np.unique(pairs, axis=0)[:, 0] if len(pairs) else pairs[:, 0]
    return _longest_of_blocks(np.bincount(row, minlength=system.dim), lanes)


def factored_products(system: System, lanes: int) -> tuple[int, float] | None:
    """Return the vectors of factored products of a quadratic energy, each of a coordinate and a sum of coordinates, and
    of the entries of the sums around them; None where the kernel does not factor.
    """
    assert system.algebra is not None
    terms, n = system.hamiltonian.terms(), system.dim
    most = 2 * lanes if lanes == LANES else lanes
    if n > most or not all(term.form is not None for term in terms):
        return None
    gradient, rows = np.zeros((n, n)), np.zeros((n, n, n))
    for form in filter(None, (term.form for term in terms)):
        np.add.at(gradient, (form.rows, form.indices), form.values)
    i, j, k, value = system.algebra.triples
    np.add.at(rows, (i, k, j), value)
    np.add.at(rows, (j, k, i), -value)
    pairs = rows @ gradient
    pairs += pairs.transpose(0, 2, 1).copy()
    written = PRODUCT_COST * _longest_of_blocks(np.count_nonzero(np.triu(pairs), axis=(1, 2)), lanes)
    apart = PRODUCT_COST * _longest_of_blocks(np.count_nonzero(rows, axis=(1, 2)), lanes)
    apart += GRADIENT_COST * _longest_of_blocks(np.count_nonzero(gradient, axis=1), lanes)
    lengths: dict[Hashable, int] = {}
    counts = [_count_factors(found, lengths) for found in pairs]
    products = -(-len(lengths) // lanes)
    entries = sum(_longest_of_blocks(np.array(each), lanes) for each in (counts, list(lengths.values())))
    in_memory = len(lengths) > most
    cost = (PRODUCT_COST if in_memory else FACTORED_COST) * products + ENTRY_COST * entries + CHAIN_COST
    worthwhile = cost + MEMORY_COST * in_memory < min(written, apart)
    return (products, entries) if worthwhile else None


def _count_factors(pairs: NDArray[np.float64], lengths: dict[Hashable, int]) -> int:
    """Return the number of factored products in a row, and add the lengths of new sums; `pairs` is set to zero."""
    pairs[np.diag_indices(len(pairs))] /= 2.0
    count = 0
    while np.any(pairs):
        common = int(np.argmax(np.count_nonzero(pairs, axis=0)))
        others = np.flatnonzero(pairs[common])
        weights = pairs[common, others]
        scale = weights[0] if len(weights) == 1 else np.copysign(2.0 ** np.floor(np.log2(abs(weights[0]))), weights[0])
        lengths[common, others.tobytes(), (weights / scale).tobytes()] = len(others)
        pairs[common] = pairs[:, common] = 0.0
        count += 1
    return count


def _monomials_of(H: HamiltonianLike) -> Iterator[tuple[int, ...]]:
    """Yield the exponents of the monomials in the polynomial terms of a Hamiltonian."""
    for term in H.terms():
        polynomial = getattr(term, "polynomial", None)
        yield from () if polynomial is None else polynomial.monomials


def vectors_of_gradient(H: HamiltonianLike) -> int:
    """Return the number of vectors of products, stored behind the coordinates, for the gradient of a Hamiltonian."""
    products: set[tuple[int, ...]] = set()
    for exponents in _monomials_of(H):
        factors = factors_of(exponents)
        for i in set(factors):
            remaining = list(factors)
            remaining.remove(i)
            products.update(tuple(remaining[:count]) for count in range(2, len(remaining) + 1))
    # Products with equal numbers of factors share vectors.
    return sum(-(-count // LANES) for count in Counter(map(len, products)).values())


def vectors_of_invariant(C: HamiltonianLike, dim: int, lanes: int) -> float:
    """Return the number of vectors of rows of the gradient of an invariant, per factor, as in ``product_rows.hpp``."""
    rows = [(1, term.form.rows) for term in C.terms() if term.form is not None]
    rows += [(max(1, sum(exponents) - 1), np.flatnonzero(exponents)) for exponents in _monomials_of(C)]
    counts: dict[int, NDArray[np.int64]] = {}
    for factors, of_term in rows:
        counts[factors] = counts.get(factors, 0) + np.bincount(of_term, minlength=dim)
    return sum((factors * _longest_of_blocks(each, lanes) for factors, each in counts.items()), 0.0)


def _longest_of_blocks(counts: NDArray[np.int64], lanes: int) -> float:
    """Return the number of vectors for rows with these counts of entries: each block is as long as its longest row."""
    padded = np.zeros(-(-len(counts) // lanes) * lanes)
    padded[: len(counts)] = counts
    return float(np.max(padded.reshape(-1, lanes), axis=1).sum())
