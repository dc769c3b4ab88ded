"""Cost model of steps by Taylor series, which counts vectors of rows in the layout of the kernels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from coadjoint.methods.protocol.cost_model import Operations
from coadjoint.systems.hamiltonians.hamiltonian import HamiltonianLike
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, QuadraticTerm
from coadjoint.systems.system_checks import System

LANES = 8
# Sums of up to UNROLLED_VECTORS vectors of rows are unrolled, if no products are stored behind the coordinates. Others
# are slower by TABLE_FACTOR per vector, and have a longer chain of dependent operations for each coefficient, and for
# each vector of rows.
UNROLLED_VECTORS = 3
TABLE_FACTOR, TABLE_LATENCY, BLOCK_LATENCY = 3.5, 6.5, 2.0
# Dependent operations per product in the sum of a coefficient.
PRODUCT_LATENCY = 1.4
# Up to REGISTER_INVARIANTS invariants of two vectors of coordinates stay in registers; others are slower by a factor.
REGISTER_INVARIANTS, SPILL_FACTOR = 4, 1.5


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
    products, product_blocks = (
        vectors_of_products(system, lanes) * lanes / LANES,
        ProductVectors(system.hamiltonian).blocks,
    )
    if product_blocks or blocks > UNROLLED_VECTORS:
        vectors = TABLE_FACTOR * (products + product_blocks)
        waiting = TABLE_LATENCY + BLOCK_LATENCY * blocks + products + product_blocks
    else:
        vectors, waiting = products, 1.0 + PRODUCT_LATENCY * products
    rows = [Rows(C, system.dim, lanes).vectors for C in invariants]
    invariant_terms = len(rows) + sum(rows) / LANES
    if len(rows) > REGISTER_INVARIANTS or blocks > 2:
        invariant_terms *= SPILL_FACTOR
    return Operations(float(0.5 * order**2 * vectors), float(order * waiting), float(invariant_terms))


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
    return _longest_of_blocks(np.bincount(row, minlength=-(-system.dim // lanes) * lanes), lanes)


class ProductVectors:
    """Number of vectors of products, stored behind the coordinates, for the gradient of a Hamiltonian."""

    def __init__(self, H: HamiltonianLike) -> None:
        self._products: set[tuple[int, ...]] = set()
        for term in H.terms():
            term.describe_to(self)

    @property
    def blocks(self) -> int:
        """Number of vectors; products with equal numbers of factors share vectors."""
        return sum(-(-count // LANES) for count in Counter(map(len, self._products)).values())

    def quadratic(self, term: QuadraticTerm) -> None:
        """Do nothing: the gradient is linear."""

    def polynomial(self, term: PolynomialTerm) -> None:
        """Count the products in the derivatives of a polynomial."""
        for exponents in term.polynomial.monomials:
            factors = [i for i, exponent in enumerate(exponents) for _ in range(exponent)]
            for i in set(factors):
                remaining = list(factors)
                remaining.remove(i)
                self._products.update(tuple(remaining[:count]) for count in range(2, len(remaining) + 1))

    def function(self, term: FunctionTerm) -> None:
        """Do nothing: functions are not supported by series."""


class Rows:
    """Number of vectors of rows of the gradient of an invariant, per factor, as in ``product_rows.hpp``."""

    def __init__(self, C: HamiltonianLike, dim: int, lanes: int) -> None:
        self._lanes, self._size = lanes, -(-dim // lanes) * lanes
        self._counts: dict[int, NDArray[np.int64]] = {}
        for term in C.terms():
            term.describe_to(self)

    @property
    def vectors(self) -> float:
        """Number of vectors."""
        vectors = (factors * _longest_of_blocks(counts, self._lanes) for factors, counts in self._counts.items())
        return sum(vectors, 0.0)

    def quadratic(self, term: QuadraticTerm) -> None:
        """Count entries of M."""
        self._add(1, term.rows)

    def polynomial(self, term: PolynomialTerm) -> None:
        """Count the products in the derivatives of a polynomial."""
        for exponents in term.polynomial.monomials:
            self._add(max(1, sum(exponents) - 1), np.flatnonzero(exponents))

    def function(self, term: FunctionTerm) -> None:
        """Do nothing: functions are not restored."""

    def _add(self, factors: int, rows: NDArray[np.int64]) -> None:
        counts = self._counts.setdefault(factors, np.zeros(self._size, dtype=np.int64))
        counts += np.bincount(rows, minlength=self._size)


def _longest_of_blocks(counts: NDArray[np.int64], lanes: int) -> float:
    """Return the number of vectors for rows with these counts of entries: each block is as long as its longest row."""
    return float(np.max(counts.reshape(-1, lanes), axis=1).sum())
