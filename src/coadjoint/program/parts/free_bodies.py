"""Parts that rotate momenta by an attitude: free rigid bodies, on triples of coordinates that span so(3), and bonds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.families.matrix_bases import casimirs_fit, quadratic
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial, SparsePolynomial
from coadjoint.program.commutation import few_parts
from coadjoint.program.generators import NotSplittable
from coadjoint.program.parts.casimir_shifts import quadratic_position
from coadjoint.program.parts.part import BodyShare, Parts
from coadjoint.program.parts.split import atoms_of
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.terms import PolynomialTerm, QuadraticTerm, Term
from coadjoint.systems.lie_poisson import LiePoissonSystem

MAX_BONDS = 100_000  # whose tables take about 1 GB
NO_BONDS = np.zeros((0, 2), dtype=np.int64), np.zeros(0)


Triple = tuple[int, int, int]
"""Three coordinates whose basis elements span so(3)."""
Triples = dict[Triple, tuple[float, float, float]]
"""Triples with their scales; see `BodyShare`."""


def free_bodies(system: LiePoissonSystem) -> Parts:
    """Split H into the exact flow of free bodies (so(3) triples with quadratic energy), first, and the rest as "auto".

    The order is independent of the linear term, which may be an input.
    """
    form, before, after = _quadratic_term(system)
    chosen = {} if form is None else _select_triples(system.algebra, form)
    if form is None or not chosen:
        raise NotSplittable(
            'it has no rigid body that turns freely, as parts="free_body" needs: an energy quadratic in at least two '
            'components of an angular momentum, which points do not have; take parts="auto"'
        )
    bodies = [_body(form, triple, scale) for triple, scale in chosen.items()]
    body = Parts.concatenate(bodies).joined(np.zeros(len(bodies), dtype=np.int64))
    triple_of = np.full(system.dim, -1)
    for number, triple in enumerate(chosen):
        triple_of[list(triple)] = number
    axes = [fixed_axis(form, triple) for triple in chosen if np.any(form.linear[list(triple)] != 0)]
    remaining = ~((triple_of[form.rows] >= 0) & (triple_of[form.rows] == triple_of[form.indices]))
    remainder = _remainder(form, remaining, np.where(triple_of >= 0, 0.0, form.linear))
    rest = Parts.concatenate([*axes, atoms_of(system, [*before, *remainder, *after])])
    return Parts.concatenate([body, few_parts(rest, system.algebra)]) if len(rest) else body


def _quadratic_term(system: LiePoissonSystem) -> tuple[QuadraticTerm | None, list[Term], list[Term]]:
    """Return the quadratic term outside of pieces, or None, and those before and after it; polynomials are split."""
    terms = [piece for term in system.hamiltonian.terms() for piece in by_degree(term)]
    position = quadratic_position(terms)
    return (None, terms, []) if position is None else (terms[position].form, terms[:position], terms[position + 1 :])


def _remainder(form: QuadraticTerm, remaining: NDArray[np.bool_], linear: NDArray[np.float64]) -> list[Term]:
    """Return the quadratic term of some entries of M with another linear term, in a list; empty if it vanishes."""
    if not np.any(remaining) and not np.any(linear):
        return []
    indptr = np.searchsorted(form.rows[remaining], np.arange(len(linear) + 1))
    return [QuadraticTerm(indptr, form.indices[remaining], form.values[remaining], linear, form.constant)]


def by_degree(term: Term) -> Iterable[Term]:
    """Yield the piece of degree two or less of a polynomial and the rest; other terms unchanged."""
    if not isinstance(term, PolynomialTerm) or term.piece is not None:
        yield term
        return
    polynomial = term.polynomial
    degrees = {tuple(factors.items()): sum(factors.values()) for _, _, factors in polynomial._factors}
    values = {tuple(factors.items()): c for _, c, factors in polynomial._factors}
    low, high = ({key: c for key, c in values.items() if (degrees[key] > 2) is above} for above in (False, True))
    if not low or not high:
        yield term
        return
    yield from Quadratic.from_polynomial(SparsePolynomial(low, polynomial.dim)).terms()
    yield replace(term, polynomial=SparsePolynomial(high, polynomial.dim))


def _triples_of(algebra: LieAlgebra) -> Triples:
    """Return the triples of basis elements that span so(3), sorted by coordinates."""
    bracket: dict[tuple[int, int], list[tuple[int, float]]] = {}
    for i, j, k, c in zip(*(column.tolist() for column in algebra.triples), strict=True):
        if c != 0:
            bracket.setdefault((i, j), []).append((k, c))
            bracket.setdefault((j, i), []).append((k, -c))
    single = {pair: sorted(set(entries))[0] for pair, entries in bracket.items() if len({k for k, _ in entries}) == 1}
    triples: Triples = {}
    for (i, j), (k, p) in sorted(single.items()):
        if not i < j < k:
            continue
        (target_i, q), (target_j, r) = single.get((j, k), (-1, 0.0)), single.get((k, i), (-1, 0.0))
        if (target_i, target_j) == (i, j) and min(p * q, q * r) > 0:
            first, second = 1.0 / math.sqrt(p * r), 1.0 / math.sqrt(p * q)
            triples[i, j, k] = first, second, math.copysign(1.0 / math.sqrt(q * r), p)
    return triples


def _select_triples(algebra: LieAlgebra, form: QuadraticTerm) -> Triples:
    """Choose commuting triples with a quadratic energy, those with the most entries of M first."""
    triples = _triples_of(algebra)
    ranked = [(-np.count_nonzero(_block(form, triple)), triple) for triple in triples]
    chosen: list[Triple] = []
    start, entries = algebra.actions
    for count, triple in sorted(ranked):
        if count > -2:
            continue
        coordinates = set(triple)
        coupled = {int(j) for i in coordinates for j in entries.j[start[i] : start[i + 1]]} | coordinates
        if all(coupled.isdisjoint(other) for other in chosen):
            chosen.append(triple)
    return {triple: triples[triple] for triple in sorted(chosen)}


def _block(form: QuadraticTerm, triple: Triple) -> np.ndarray[Any, np.dtype[np.float64]]:
    block = np.zeros((3, 3))
    for a, i in enumerate(triple):
        for entry in range(int(form.indptr[i]), int(form.indptr[i + 1])):
            if int(form.indices[entry]) in triple:
                block[a, triple.index(int(form.indices[entry]))] = form.values[entry]
    return block


def _body(form: QuadraticTerm, triple: Triple, scale: tuple[float, float, float]) -> Parts:
    block, (i, j, k) = _block(form, triple), triple
    columns = [np.flatnonzero(row) for row in block]
    weights = SparseRows.of_lists(
        [[], *([triple[b] for b in column] for column in columns)],
        [[], *([float(block[a, b]) for b in column] for a, column in enumerate(columns))],
    )
    matrix = tuple(tuple(row) for row in block.tolist())
    return Parts(
        SparseRows.units(np.array([k, i, j, k])),
        np.zeros(4),
        weights,
        np.array([0, 4]),
        {},
        np.array([0, 1]),
        np.array([False]),
        bodies={0: BodyShare(triple, matrix, scale)},
    )


def fixed_axis(form: QuadraticTerm, triple: Triple) -> Parts:
    """Build the part of a linear term on a triple: a rotation about its axis."""
    axis = [(i, float(form.linear[i])) for i in triple if form.linear[i] != 0]
    coordinates, values = zip(*axis, strict=True)
    return Parts.linear(SparseRows.of_lists([coordinates], [values]), np.ones(1), SparseRows.empty(1), np.array([0, 1]))


Bonds = tuple[NDArray[np.int64], NDArray[np.float64]]
"""The energies strength z.w of pairs of triples with momenta z and w, in units of their scale: (bonds, 2), (bonds,)."""


def bonds(system: LiePoissonSystem) -> tuple[Parts, tuple[tuple[Polynomial, float], ...] | None]:
    """Split H into exact flows of bonds and a remainder; also return the Casimirs subtracted, None if too many terms.

    A bond c z.w is c |z + w|^2/2 up to Casimirs: both momenta rotate about z + w by c tau |z + w|. Edge colouring joins
    bonds without a common momentum into parts.
    """
    form, before, after = _quadratic_term(system)
    spins = {} if form is None else _ideals(system.algebra)
    ends, strengths = _isotropic_couplings(form, spins) if form is not None and spins else NO_BONDS
    if form is None or not len(ends):
        raise NotSplittable(
            "it has no isotropic coupling c z.w between the momenta z, w of two copies of so(3) that are ideals; take "
            'parts="auto"'
        )
    if len(ends) > MAX_BONDS:
        raise NotSplittable(f'it has {len(ends)} bonds; parts="bonds" allows at most {MAX_BONDS}; take parts="auto"')
    colour = np.array(colours(ends.tolist(), len(spins)))
    coloured = _shares(ends, strengths, spins, colour)
    axes = [triple for triple in spins if np.count_nonzero(form.linear[list(triple)]) > 1]
    remainder = _remainder_of_bonds(form, ends, spins, axes)
    rest = Parts.concatenate(
        [*(fixed_axis(form, triple) for triple in axes), atoms_of(system, [*before, *remainder, *after])]
    )
    parts = Parts.concatenate([coloured, few_parts(rest, system.algebra)]) if len(rest) else coloured
    if not casimirs_fit(3 * len(spins), system.dim):
        return parts, None
    casimir = _subtracted_casimir(ends, strengths, spins, system.dim)
    return parts, ((casimir, 1.0),) if casimir.monomials else ()


def colours(edges: Sequence[Sequence[int]], count: int) -> list[int]:
    """Colour edges by first fit in the order given; needs fewer than twice the largest degree of a node."""
    used = [0] * count  # bit mask of the colours used at each node
    assigned = []
    for i, j in edges:
        free = ~(used[i] | used[j])
        bit = free & -free
        used[i], used[j] = used[i] | bit, used[j] | bit
        assigned.append(bit.bit_length() - 1)
    return assigned


def _ideals(algebra: LieAlgebra) -> Triples:
    """Return the triples that span so(3) and commute with all other coordinates."""
    start, entries = algebra.actions
    return {
        triple: scale
        for triple, scale in _triples_of(algebra).items()
        if all(np.isin(entries.j[start[i] : start[i + 1]], triple).all() for i in triple)
    }


def _isotropic_couplings(form: QuadraticTerm, spins: Triples) -> Bonds:
    """Return the isotropic couplings, multiples of the identity, between two triples of equal scale."""
    (triple_of, axis), scales = _triple_of_coordinates(spins, len(form.linear)), list(spins.values())
    first_triple, second_triple = triple_of[form.rows], triple_of[form.indices]
    between = np.flatnonzero((first_triple >= 0) & (first_triple < second_triple))
    order = between[np.lexsort((axis[form.rows[between]], second_triple[between], first_triple[between]))]
    pair = np.stack([first_triple[order], second_triple[order]], axis=1)
    begins = np.flatnonzero(np.any(np.diff(pair, axis=0, prepend=-1) != 0, axis=1))
    counts = np.diff(np.append(begins, len(order)))
    found: list[tuple[list[int], float]] = []
    for begin in begins[counts == 3].tolist():
        entries = order[begin : begin + 3]
        rows, columns = axis[form.rows[entries]], axis[form.indices[entries]]
        first, second = pair[begin].tolist()
        scale = scales[first]
        rounding = 0.0 if scale == (1.0, 1.0, 1.0) else 8 * UNIT_ROUNDOFF  # scales are square roots, hence rounded
        strengths = form.values[entries] / np.array(scale) ** 2
        diagonal = np.array_equal(rows, [0, 1, 2]) and np.array_equal(columns, rows)
        if diagonal and scales[second] == scale and np.ptp(strengths) <= rounding * abs(strengths[0]):
            found.append(([first, second], float(strengths[0])))
    ends = np.array([pair for pair, _ in found], dtype=np.int64).reshape(-1, 2)
    return ends, np.array([strength for _, strength in found], dtype=np.float64)


def _triple_of_coordinates(spins: Triples, dim: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the triple of each coordinate (-1 if none), and its index in the triple."""
    triple_of, axis = np.full(dim, -1), np.full(dim, -1)
    inside = np.array(list(spins))
    triple_of[inside], axis[inside] = np.arange(len(spins))[:, None], np.arange(3)
    return triple_of, axis


def _shares(
    ends: NDArray[np.int64], strengths: NDArray[np.float64], spins: Triples, colour: NDArray[np.int64]
) -> Parts:
    """Build one share per bond, and one part per colour."""
    order = np.argsort(colour, kind="stable")
    count, bonded = len(order), ends[order].tolist()
    triples, scales = list(spins), list(spins.values())
    bonded_triples = np.array(triples)[ends[order]]  # (bonds, 2, 3)
    pairs = np.sort(bonded_triples, axis=1).transpose(0, 2, 1)[:, [2, 0, 1, 2]]  # rows of a body: axes 3, 1, 2, 3
    squares = np.square(scales)[ends[order, 0]]
    diagonals = strengths[order, None] * squares
    values = np.repeat(diagonals, 2, axis=1)
    weights = SparseRows(
        np.append(0, np.cumsum(np.tile([0, 2, 2, 2], count))),
        pairs[:, 1:].reshape(-1).astype(np.uint32),
        values.reshape(-1),
    )
    bodies = {
        s: BodyShare(triples[first], tuple(map(tuple, np.diag(diagonals[s]).tolist())), scales[first], triples[second])
        for s, (first, second) in enumerate(bonded)
    }
    begins = np.searchsorted(np.sort(colour), np.arange(int(colour.max()) + 2))
    return Parts(
        SparseRows(2 * np.arange(4 * count + 1), pairs.reshape(-1).astype(np.uint32), np.ones(8 * count)),
        np.zeros(4 * count),
        weights,
        4 * np.arange(count + 1),
        {},
        begins,
        np.zeros(len(begins) - 1, dtype=bool),
        bodies=bodies,
    )


def _remainder_of_bonds(
    form: QuadraticTerm, ends: NDArray[np.int64], spins: Triples, axes: Sequence[Triple]
) -> list[Term]:
    triple_of, _ = _triple_of_coordinates(spins, len(form.linear))
    count = len(spins)
    bonded = np.concatenate([ends @ [count, 1], ends @ [1, count]])
    first_triple, second_triple = triple_of[form.rows], triple_of[form.indices]
    remaining = ~((first_triple >= 0) & (second_triple >= 0) & np.isin(first_triple * count + second_triple, bonded))
    linear = form.linear.copy()
    linear[[i for triple in axes for i in triple]] = 0.0
    return _remainder(form, remaining, linear)


def _subtracted_casimir(
    ends: NDArray[np.int64], strengths: NDArray[np.float64], spins: Triples, dim: int
) -> Polynomial:
    """Return the Casimir subtracted by the bonds: the sum of -c (|z|^2 + |w|^2)/2."""
    total = np.zeros(len(spins))
    np.subtract.at(total, ends, 0.5 * strengths[:, None])
    return quadratic(
        (
            (i, i, factor * length**2)
            for (triple, scale), factor in zip(spins.items(), total.tolist(), strict=True)
            for i, length in zip(triple, scale, strict=True)
            if factor != 0.0
        ),
        dim,
    )
