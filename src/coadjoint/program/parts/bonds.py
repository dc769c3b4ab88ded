"""Bonds as parts: exact flows of isotropic couplings between the momenta of two copies of so(3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.algebra.polynomials.quadratic_forms import casimirs_fit, quadratic
from coadjoint.memory import check_available_memory
from coadjoint.program.commutation import Commutation
from coadjoint.program.parts.few_parts import few_parts
from coadjoint.program.parts.free_bodies import Triple, fixed_axis, terms_by_degree, triples_of
from coadjoint.program.parts.part import BodyShare, Parts
from coadjoint.program.parts.split import NotSplittable, atoms_of
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.terms import QuadraticTerm
from coadjoint.systems.lie_poisson import LiePoissonSystem

MAX_BONDS = 100_000
BYTES_PER_BOND = 8000  # peak memory of building the tables


class Bond(NamedTuple):
    """The energy strength z.w of two triples with momenta z and w, in units of their scale."""

    first: int
    second: int
    strength: float


class Bonds(NamedTuple):
    """Parts that add up to H - sum c C, and the Casimirs C subtracted; None if too long to write."""

    parts: Parts
    shift: tuple[tuple[Polynomial, float], ...] | None


def bonds(system: LiePoissonSystem) -> Bonds:
    """Split a Hamiltonian into exact flows of single bonds and a remainder.

    A bond c z.w couples the momenta z, w of two copies of so(3). Up to Casimirs it equals c |z + w|^2/2, so both
    momenta rotate about the constant z + w by the angle c tau |z + w|. Bonds without a common momentum commute: edge
    colouring by first fit makes each colour one part. A field with several components is a rotation about its axis. The
    remainder is split as with ``"auto"``. Raises NotSplit if there are no bonds, too many, or the remainder does not
    split.
    """
    commutation = Commutation(system.algebra)
    terms = terms_by_degree(system)
    place = next((k for k, term in enumerate(terms) if term.form is not None and term.piece is None), None)
    form = None if place is None else terms[place].form
    spins = [] if form is None else _ideals(system.algebra)
    found = _isotropic(form, spins) if form is not None and spins else []
    if form is None or place is None or not found:
        raise NotSplittable(
            "it has no isotropic coupling c z.w between the momenta z, w of two copies of so(3) that are ideals; take "
            'parts="auto"'
        )
    if len(found) > MAX_BONDS:
        raise NotSplittable(
            f'it has {len(found)} bonds, and {MAX_BONDS} are the most for parts="bonds"; take parts="auto"'
        )
    check_available_memory(
        BYTES_PER_BOND * len(found), f"a splitting of {system.name} into {len(found)} bonds", 'take parts="auto"'
    )
    colour = colours([(bond.first, bond.second) for bond in found], len(spins))
    coloured = _shares(found, spins, colour)
    axes = [triple for triple in spins if np.count_nonzero(form.linear[list(triple.coordinates)]) > 1]
    left = _remainder(form, found, spins, axes)
    others = [*terms[:place], *([left] if left is not None else []), *terms[place + 1 :]]
    rest = Parts.concatenate([*(fixed_axis(form, triple) for triple in axes), atoms_of(system, others, commutation)])
    parts = Parts.concatenate([coloured, few_parts(rest, commutation)]) if len(rest) else coloured
    if not casimirs_fit(3 * len(spins), system.dim):
        return Bonds(parts, None)
    taken = _squares(found, spins, system.dim)
    return Bonds(parts, ((taken, 1.0),) if taken.monomials else ())


def colours(edges: Sequence[tuple[int, int]], count: int) -> list[int]:
    """Colour edges by first fit in the order given; needs fewer than twice the largest degree of a node."""
    used = [0] * count  # bit mask of the colours used at each node
    found = []
    for i, j in edges:
        free = ~(used[i] | used[j])
        bit = free & -free
        used[i], used[j] = used[i] | bit, used[j] | bit
        found.append(bit.bit_length() - 1)
    return found


def _ideals(algebra: LieAlgebra) -> list[Triple]:
    """Return the triples that span so(3) and commute with all other coordinates."""
    start, every = algebra.actions
    return [
        triple
        for triple in triples_of(algebra)
        if all(np.isin(every.j[start[i] : start[i + 1]], triple.coordinates).all() for i in triple.coordinates)
    ]


def _isotropic(form: QuadraticTerm, spins: Sequence[Triple]) -> list[Bond]:
    """Return the couplings between two triples of equal scale that are multiples of the identity."""
    home, axis = _places(spins, len(form.linear))
    one, two = home[form.rows], home[form.indices]
    between = np.flatnonzero((one >= 0) & (one < two))
    order = between[np.lexsort((axis[form.rows[between]], two[between], one[between]))]
    pair = np.stack([one[order], two[order]], axis=1)
    begins = np.flatnonzero(np.any(np.diff(pair, axis=0, prepend=-1) != 0, axis=1))
    counts = np.diff(np.append(begins, len(order)))
    found = []
    for begin in begins[counts == 3].tolist():
        entries = order[begin : begin + 3]
        rows, columns = axis[form.rows[entries]], axis[form.indices[entries]]
        first, second = pair[begin].tolist()
        scale = spins[first].scale
        rounding = 0.0 if scale == (1.0, 1.0, 1.0) else 8 * UNIT_ROUNDOFF  # scales are square roots, hence rounded
        strengths = form.values[entries] / np.array(scale) ** 2
        alike = np.array_equal(rows, [0, 1, 2]) and np.array_equal(columns, rows)
        if alike and spins[second].scale == scale and np.ptp(strengths) <= rounding * abs(strengths[0]):
            found.append(Bond(first, second, float(strengths[0])))
    return found


def _places(spins: Sequence[Triple], dim: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the triple of each coordinate (-1 if none), and its index in the triple."""
    home, axis = np.full(dim, -1), np.full(dim, -1)
    inside = np.array([triple.coordinates for triple in spins])
    home[inside], axis[inside] = np.arange(len(spins))[:, None], np.arange(3)
    return home, axis


def _shares(found: Sequence[Bond], spins: Sequence[Triple], colour: Sequence[int]) -> Parts:
    """Build one share per bond, and one part per colour."""
    order = np.argsort(colour, kind="stable").tolist()
    own = [found[k] for k in order]
    ends = np.array([(spins[b.first].coordinates, spins[b.second].coordinates) for b in own])  # (bonds, 2, 3)
    pairs = np.sort(ends, axis=1).transpose(0, 2, 1)[:, [2, 0, 1, 2]]  # rows of a free body: axes 3, 1, 2, 3
    count = len(own)
    squares = np.array([np.square(spins[b.first].scale) for b in own])
    strengths = np.array([b.strength for b in own])[:, None] * squares
    values = np.repeat(strengths[:, [0, 1, 2]], 2, axis=1)
    weights = SparseRows(
        np.append(0, np.cumsum(np.tile([0, 2, 2, 2], count))),
        pairs[:, 1:].reshape(-1).astype(np.uint32),
        values.reshape(-1),
    )
    shares = {
        s: BodyShare(
            spins[b.first].coordinates,
            tuple(tuple(v if i == j else 0.0 for j in range(3)) for i, v in enumerate(strengths[s].tolist())),
            spins[b.first].scale,
            spins[b.second].coordinates,
        )
        for s, b in enumerate(own)
    }
    begins = np.searchsorted(np.sort(colour), np.arange(max(colour) + 2))
    return Parts(
        SparseRows(2 * np.arange(4 * count + 1), pairs.reshape(-1).astype(np.uint32), np.ones(8 * count)),
        np.zeros(4 * count),
        weights,
        4 * np.arange(count + 1),
        shares,
        begins,
        np.zeros(len(begins) - 1, dtype=bool),
    )


def _remainder(
    form: QuadraticTerm, found: Sequence[Bond], spins: Sequence[Triple], axes: Sequence[Triple]
) -> QuadraticTerm | None:
    """Return a quadratic term without the bonds and the fixed axes; None if nothing is left."""
    home, _ = _places(spins, len(form.linear))
    count = len(spins)
    bonded = np.array([k for b in found for k in (b.first * count + b.second, b.second * count + b.first)])
    one, two = home[form.rows], home[form.indices]
    kept = ~((one >= 0) & (two >= 0) & np.isin(one * count + two, bonded))
    linear = form.linear.copy()
    linear[[i for triple in axes for i in triple.coordinates]] = 0.0
    if not np.any(kept) and not np.any(linear):
        return None
    indptr = np.searchsorted(form.rows[kept], np.arange(len(linear) + 1))
    return QuadraticTerm(indptr, form.indices[kept], form.values[kept], linear, form.constant)


def _squares(found: Sequence[Bond], spins: Sequence[Triple], dim: int) -> Polynomial:
    """Return the Casimir subtracted by the bonds: the sum of -c (|z|^2 + |w|^2)/2."""
    total = np.zeros(len(spins))
    for bond in found:
        total[[bond.first, bond.second]] -= 0.5 * bond.strength
    return quadratic(
        (
            (i, i, factor * length**2)
            for triple, factor in zip(spins, total.tolist(), strict=True)
            for i, length in zip(triple.coordinates, triple.scale, strict=True)
            if factor != 0.0
        ),
        dim,
    )
