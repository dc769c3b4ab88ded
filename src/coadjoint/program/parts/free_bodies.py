"""Free rigid bodies as parts: triples of coordinates that span so(3), each with a quadratic energy."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.commutation import Commutation
from coadjoint.program.parts.few_parts import few_parts
from coadjoint.program.parts.part import BodyShare, Parts
from coadjoint.program.parts.split import NotSplittable, atoms_of
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.systems.hamiltonians.quadratic import Quadratic
from coadjoint.systems.hamiltonians.terms import PolynomialTerm, QuadraticTerm, Term
from coadjoint.systems.lie_poisson import LiePoissonSystem


class Triple(NamedTuple):
    """Three coordinates whose basis elements span so(3); for the scale see `BodyShare`."""

    coordinates: tuple[int, int, int]
    scale: tuple[float, float, float]


def free_bodies(system: LiePoissonSystem) -> Parts:
    """Split a Hamiltonian into the exact flow of free rigid bodies and a remainder.

    A free body is a triple of basis elements that spans so(3), with the energy quadratic in its coordinates; its flow
    rotates all other momenta by its attitude. Bodies that commute are one part. A linear term on a triple (rotors) is a
    rotation about a fixed axis, and a part of its own. The remainder is split as with ``"auto"``. The bodies come
    first: for parts A, D the h^2 term is {A, {A, D}}/24 and {D, {D, A}}/12, and D is the weak part. The order is
    independent of the linear term, which may be an input. Raises NotSplittable if no triple has an energy quadratic in
    two coordinates or more, or the remainder does not split.
    """
    commutation = Commutation(system.algebra)
    terms = terms_by_degree(system)
    position = next((k for k, term in enumerate(terms) if term.form is not None and term.piece is None), None)
    form = None if position is None else terms[position].form
    chosen = [] if form is None else _select_triples(system.algebra, form)
    if form is None or position is None or not chosen:
        raise NotSplittable(
            "no three coordinates that span so(3) have an energy that is quadratic in at least two of them; take "
            'parts="auto"'
        )
    bodies = [_body(form, triple) for triple in chosen]
    body = Parts.concatenate(bodies).joined(np.zeros(len(bodies), dtype=np.int64))
    triple_of = np.full(system.dim, -1)
    for number, triple in enumerate(chosen):
        triple_of[list(triple.coordinates)] = number
    axes = [fixed_axis(form, triple) for triple in chosen if np.any(form.linear[list(triple.coordinates)] != 0)]
    remainder = _remainder(form, triple_of)
    other_terms = [*terms[:position], *([remainder] if remainder is not None else []), *terms[position + 1 :]]
    rest = Parts.concatenate([*axes, atoms_of(system, other_terms, commutation)])
    return Parts.concatenate([body, few_parts(rest, commutation)]) if len(rest) else body


def terms_by_degree(system: LiePoissonSystem) -> list[Term]:
    """Return the terms of a Hamiltonian, with each polynomial split at degree two."""
    return [piece for term in system.hamiltonian.terms() for piece in _by_degree(term)]


def _by_degree(term: Term) -> Iterable[Term]:
    """Yield the piece of degree two or less of a polynomial and the rest; other terms unchanged."""
    if not isinstance(term, PolynomialTerm) or term.piece is not None:
        yield term
        return
    low = {e: c for e, c in term.polynomial.monomials.items() if sum(e) <= 2}
    high = {e: c for e, c in term.polynomial.monomials.items() if sum(e) > 2}
    if not low or not high:
        yield term
        return
    yield from Quadratic.from_polynomial(Polynomial(low)).terms()
    yield replace(term, polynomial=Polynomial(high))


def triples_of(algebra: LieAlgebra) -> list[Triple]:
    """Return the triples of basis elements that span so(3), sorted by coordinates."""
    bracket: dict[tuple[int, int], list[tuple[int, float]]] = {}
    for i, j, k, c in zip(*(column.tolist() for column in algebra.triples), strict=True):
        if c != 0:
            bracket.setdefault((i, j), []).append((k, c))
            bracket.setdefault((j, i), []).append((k, -c))
    single = {pair: sorted(set(entries))[0] for pair, entries in bracket.items() if len({k for k, _ in entries}) == 1}
    triples = []
    for (i, j), (k, p) in sorted(single.items()):
        if not i < j < k:
            continue
        (target_i, q), (target_j, r) = single.get((j, k), (-1, 0.0)), single.get((k, i), (-1, 0.0))
        if (target_i, target_j) == (i, j) and min(p * q, q * r) > 0:
            first, second = 1.0 / math.sqrt(p * r), 1.0 / math.sqrt(p * q)
            triples.append(Triple((i, j, k), (first, second, math.copysign(1.0 / math.sqrt(q * r), p))))
    return triples


def _select_triples(algebra: LieAlgebra, form: QuadraticTerm) -> list[Triple]:
    """Choose commuting triples with a quadratic energy, those with the most entries of M first."""
    ranked = [(-np.count_nonzero(_block(form, triple)), triple) for triple in triples_of(algebra)]
    chosen: list[Triple] = []
    start, entries = algebra.actions
    for count, triple in sorted(ranked):
        if count > -2:
            continue
        coordinates = set(triple.coordinates)
        coupled = {int(j) for i in coordinates for j in entries.j[start[i] : start[i + 1]]} | coordinates
        if all(coupled.isdisjoint(other.coordinates) for other in chosen):
            chosen.append(triple)
    return sorted(chosen)


def _block(form: QuadraticTerm, triple: Triple) -> np.ndarray[Any, np.dtype[np.float64]]:
    block = np.zeros((3, 3))
    for a, i in enumerate(triple.coordinates):
        for entry in range(int(form.indptr[i]), int(form.indptr[i + 1])):
            if int(form.indices[entry]) in triple.coordinates:
                block[a, triple.coordinates.index(int(form.indices[entry]))] = form.values[entry]
    return block


def _body(form: QuadraticTerm, triple: Triple) -> Parts:
    block, (i, j, k) = _block(form, triple), triple.coordinates
    columns = [np.flatnonzero(row) for row in block]
    weights = SparseRows.of_lists(
        [[], *([triple.coordinates[b] for b in column] for column in columns)],
        [[], *([float(block[a, b]) for b in column] for a, column in enumerate(columns))],
    )
    matrix = tuple(tuple(row) for row in block.tolist())
    return Parts(
        SparseRows.units(np.array([k, i, j, k])),
        np.zeros(4),
        weights,
        np.array([0, 4]),
        {0: BodyShare((i, j, k), matrix, triple.scale)},
        np.array([0, 1]),
        np.array([False]),
    )


def fixed_axis(form: QuadraticTerm, triple: Triple) -> Parts:
    """Build the part of a linear term on a triple: a rotation about its axis."""
    axis = [(i, float(form.linear[i])) for i in triple.coordinates if form.linear[i] != 0]
    coordinates, values = zip(*axis, strict=True)
    return Parts.linear(SparseRows.of_lists([coordinates], [values]), np.ones(1), SparseRows.empty(1), np.array([0, 1]))


def _remainder(form: QuadraticTerm, triple_of: Any) -> QuadraticTerm | None:
    """Return the quadratic term without the bodies; None if it vanishes."""
    remaining = ~((triple_of[form.rows] >= 0) & (triple_of[form.rows] == triple_of[form.indices]))
    linear = np.where(triple_of >= 0, 0.0, form.linear)
    if not np.any(remaining) and not np.any(linear):
        return None
    rows = form.rows[remaining]
    indptr = np.searchsorted(rows, np.arange(len(linear) + 1))
    return QuadraticTerm(indptr, form.indices[remaining], form.values[remaining], linear, form.constant)
