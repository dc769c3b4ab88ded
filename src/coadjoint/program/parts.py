"""Parts: commuting linear forms and the piece of the Hamiltonian that depends on them alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.systems.terms import FunctionTerm


@dataclass(frozen=True)
class LinearShare:
    """Angles offset_a + weight_a . x, one for each of the forms of the share (sparse rows)."""

    offset: NDArray[Any]
    indptr: NDArray[Any]
    columns: NDArray[Any]
    weights: NDArray[Any]


@dataclass(frozen=True)
class PolynomialShare:
    """Angles are the derivatives of a polynomial with respect to the given coordinates."""

    coordinates: tuple[int, ...]
    polynomial: Polynomial


@dataclass(frozen=True)
class FunctionShare:
    """Angles are the gradient of a user function of the term's coordinates."""

    term: FunctionTerm


Share = LinearShare | PolynomialShare | FunctionShare


@dataclass(frozen=True)
class Part:
    """One exact flow: commuting forms l_a and the shares that give dH/d(l_a.x), in the same order.

    Parameters
    ----------
    forms : tuple of (coordinates, values)
        The linear forms, sparse.
    shares : tuple of Share
        Their angle rules.
    """

    forms: tuple[tuple[tuple[int, ...], tuple[Any, ...]], ...]
    shares: tuple[Share, ...]
    timed: bool = field(default=False)


def unit_forms(coordinates: Iterable[int]) -> tuple[tuple[tuple[int, ...], tuple[Any, ...]], ...]:
    """Return the forms x_i for the given coordinates."""
    return tuple(((int(i),), (1,)) for i in coordinates)


class Commutation:
    """Which coordinates and forms of an algebra commute."""

    def __init__(self, algebra: LieAlgebra) -> None:
        self._algebra = algebra
        self._indptr, self._indices = algebra.neighbours()

    @property
    def key(self) -> tuple[bytes, bytes]:
        """Which coordinates commute: equal for algebras that differ in the sizes of their constants alone."""
        return self._indptr.tobytes(), self._indices.tobytes()

    def neighbours(self, i: int) -> NDArray[Any]:
        """Return the coordinates that do not commute with coordinate i."""
        return self._indices[self._indptr[i] : self._indptr[i + 1]]

    def first_clash(self, coordinates: Iterable[int]) -> tuple[int, int] | None:
        """Return two of the coordinates whose basis elements do not commute, or None."""
        chosen = set(coordinates)
        for i in sorted(chosen):
            for j in self.neighbours(i):
                if int(j) in chosen:
                    return i, int(j)
        return None

    def forms_commute(self, first: Part, second: Part) -> bool:
        """Return whether every form of one part commutes with every form of the other, up to rounding of the forms."""
        return all(self._commute(f, g) for f in first.forms for g in second.forms)

    def _commute(self, f: Any, g: Any) -> bool:
        i, j, k, c = self._algebra.triples
        u, v = self._dense(f), self._dense(g)
        terms, swapped = c * u[i] * v[j], c * u[j] * v[i]
        bracket = np.bincount(k, weights=terms - swapped, minlength=self._algebra.dim)
        size = np.bincount(k, weights=abs(terms) + abs(swapped), minlength=self._algebra.dim)
        return bool(np.all(np.abs(bracket) <= 16 * 2.0**-53 * size))

    def _dense(self, form: tuple[Sequence[int], Sequence[Any]]) -> NDArray[np.float64]:
        coordinates, values = form
        dense = np.zeros(self._algebra.dim)
        dense[list(coordinates)] = [float(value) for value in values]
        return dense


# Larger sets of parts are joined in one order alone: a lattice has thousands, and comes in a good one.
MOST_REORDERED = 64


def few_parts(parts: Sequence[Part], commutation: Commutation) -> tuple[Part, ...]:
    """Join parts that commute: few, in a fixed order, not always the fewest (a clique cover is NP-hard).

    First fit in the given order and, where that leaves more than two, in the orders of most and of fewest clashes.

    Parameters
    ----------
    parts : sequence of Part
        Sorted by their first coordinates.
    commutation : Commutation
        Of the algebra.

    Returns
    -------
    tuple of Part
        Sorted by their first coordinates.
    """
    best = _first_fit(range(len(parts)), parts, commutation)
    if 2 < len(best) and len(parts) <= MOST_REORDERED:
        own = [{i for form, _ in part.forms for i in form} for part in parts]
        near = [{int(j) for i in mine for j in commutation.neighbours(i)} for mine in own]
        clashes = [sum(not mine.isdisjoint(other) for other in own) for mine in near]
        for sign in (-1, 1):
            found = _first_fit(sorted(range(len(parts)), key=lambda k: (sign * clashes[k], k)), parts, commutation)
            best = found if len(found) < len(best) else best
    return tuple(joined([parts[k] for k in group]) for group in sorted(sorted(group) for group in best))


def _first_fit(order: Iterable[int], parts: Sequence[Part], commutation: Commutation) -> list[list[int]]:
    groups: list[list[int]] = []
    coordinates: list[set[int]] = []
    for k in order:
        ours = {i for form, _ in parts[k].forms for i in form}
        near = {int(j) for i in ours for j in commutation.neighbours(i)}
        for group, theirs in zip(groups, coordinates, strict=True):
            if near.isdisjoint(theirs) or _combined_commute(parts[k], [parts[m] for m in group], commutation):
                group.append(k)
                theirs |= ours
                break
        else:
            groups.append([k])
            coordinates.append(ours)
    return groups


def _combined_commute(part: Part, group: list[Part], commutation: Commutation) -> bool:
    """Coordinates that do not commute settle it, unless forms of several coordinates cancel them."""
    single = all(len(form) == 1 for member in (part, *group) for form, _ in member.forms)
    return not single and all(commutation.forms_commute(part, member) for member in group)


def joined(parts: Sequence[Part]) -> Part:
    """Return several parts as one; their forms must commute."""
    return Part(
        tuple(form for part in parts for form in part.forms),
        tuple(share for part in parts for share in part.shares),
        any(part.timed for part in parts),
    )
