"""Exact dependence of completed squares on the linear term; a new linear term needs no new squares.

The forms l_r of the squares of x.M.x/2 do not depend on the linear term b; the beta_r solve sum_r beta_r l_r = b.
"""

from __future__ import annotations

from math import isfinite, lcm
from operator import mul
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.components import connected
from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.part import NonlinearShare, Parts, PolynomialShare
from coadjoint.program.parts.squares import MAX_RATIONAL_SIZE, split_linear
from coadjoint.systems.hamiltonians.linear_term import PLACEHOLDER_COEFFICIENT


class ExactSums(NamedTuple):
    """Sums over k of factors[r][k] b[coordinates[k]], divided by denominators[r], rounded once."""

    coordinates: tuple[int, ...]
    factors: tuple[tuple[int, ...], ...]
    denominators: tuple[int, ...]

    def at(self, b: NDArray[np.float64]) -> list[float]:
        """Evaluate the sums for finite floats b, correctly rounded; raise OverflowError beyond float64.

        Examples
        --------
        >>> ExactSums((0, 1), ((1, -2), (1, 0)), (3, 4)).at(np.array([1.0, 0.25]))
        [0.16666666666666666, 0.25]
        """
        exact = [value.as_integer_ratio() for value in b.take(self.coordinates).tolist()]
        # Denominators of floats are powers of two, so the largest is a common denominator.
        common = max([denominator for _, denominator in exact])
        scaled = [numerator * (common // denominator) for numerator, denominator in exact]
        return [
            sum(map(mul, factors, scaled)) / (denominator * common)
            for factors, denominator in zip(self.factors, self.denominators, strict=True)
        ]


class ReductionSteps(NamedTuple):
    """Linear terms of squares with forms in floats, by the operations of the reduction in their order.

    Each step has its pivots and its forms (coordinate -> value); `order` gives the position of each among the angles.
    """

    steps: tuple[tuple[tuple[int, ...], tuple[dict[int, float], ...]], ...]
    order: tuple[int, ...]

    def at(self, b: NDArray[np.float64]) -> list[float]:
        """Evaluate the linear terms bitwise as for newly completed squares; raise OverflowError beyond float64."""
        residual, offsets = b.tolist(), []
        for pivots, forms in self.steps:
            betas = split_linear([residual[p] for p in pivots], [[form.get(p, 0.0) for p in pivots] for form in forms])
            for beta, form in zip(betas, forms, strict=True):
                for k, value in form.items():
                    residual[k] -= beta * value
            offsets += betas
        if not all(map(isfinite, offsets)):
            raise OverflowError("a completed square is too large for float64")
        return [offsets[position] for position in self.order]


def offsets_of_squares(parts: Parts) -> list[tuple[list[int], ExactSums | ReductionSteps]]:
    """Return (angles, offsets) for each set of coupled coordinates, as functions of the linear term.

    Forms of up to 16 coupled coordinates are exact (`ExactSums`), others floats (`ReductionSteps`). Uncoupled
    coordinates are omitted: their offset is the coefficient itself.
    """
    forms = parts.forms
    linear = np.ones(len(parts.offset), dtype=bool)
    for s in parts.nonlinear_shares:
        linear[parts.row[s] : parts.row[s + 1]] = False
    owner = forms.owner
    # The angle of a coordinate that depends on others is no square, but a derivative of products.
    alone, weights = np.diff(forms.start) == 1, parts.weights
    own = np.zeros(len(alone), dtype=np.uint32)
    own[alone] = forms.coordinate[forms.start[:-1][alone]]
    linear[weights.owner[alone[weights.owner] & (weights.coordinate != own[weights.owner])]] = False
    angles = np.flatnonzero(linear)
    entries = np.flatnonzero(linear[owner])
    # Nodes are the angles, then the coordinates.
    count, coordinate = len(parts.offset), forms.coordinate[entries].astype(np.int64)
    label = connected(count + int(coordinate.max(initial=-1)) + 1, owner[entries], count + coordinate)
    clusters: dict[int, list[int]] = {}
    for angle in angles.tolist():
        clusters.setdefault(int(label[angle]), []).append(angle)
    result: list[tuple[list[int], ExactSums | ReductionSteps]] = []
    for cluster in clusters.values():
        rows = [_row(parts, angle) for angle in cluster]
        coordinates = sorted({k for row in rows for k in row})
        if len(coordinates) > MAX_RATIONAL_SIZE and parts.pivots is not None:
            result.append((cluster, _reduced(rows, parts.pivots[cluster])))
        elif 1 < len(coordinates) <= MAX_RATIONAL_SIZE and len(cluster) <= len(coordinates):
            result.append((cluster, _inverse(rows, coordinates)))
    return result


def _reduced(rows: list[dict[int, Any]], pivots: NDArray[np.int64]) -> ReductionSteps:
    """Recover the steps of the reduction from its forms."""
    steps: dict[int, tuple[tuple[int, ...], list[dict[int, float]]]] = {}
    inverse = np.argsort(pivots[:, 0], kind="stable")
    for position in inverse.tolist():
        step, first, last = pivots[position].tolist()
        pivot_pair = (first,) if first == last else (first, last)
        steps.setdefault(step, (pivot_pair, []))[1].append(rows[position])
    order = np.argsort(inverse).tolist()
    return ReductionSteps(tuple((pivot_pair, tuple(forms)) for pivot_pair, forms in steps.values()), tuple(order))


def with_linear_offsets(parts: Parts, linear: NDArray[np.float64]) -> Parts:
    """Replace `PLACEHOLDER_COEFFICIENT` (zero coefficients kept as structure) by the linear term, shape (n,), in parts.

    The forms are unchanged; some angles may be identically zero.
    """
    offset = parts.offset.copy()
    for angles, sums in offsets_of_squares(parts):
        offset[angles] = sums.at(linear)
    offset[parts.offset == PLACEHOLDER_COEFFICIENT] = 0.0
    nonlinear_shares = {s: _without_placeholders(share) for s, share in parts.nonlinear_shares.items()}
    return Parts(parts.forms, offset, parts.weights, parts.row, nonlinear_shares, parts.share, parts.timed)


def _without_placeholders(share: NonlinearShare) -> NonlinearShare:
    if not isinstance(share, PolynomialShare):
        return share
    monomials = {e: c for e, c in share.polynomial.monomials.items() if c != PLACEHOLDER_COEFFICIENT}
    return PolynomialShare(share.coordinates, Polynomial(monomials, dim=share.polynomial.dim))


def _row(parts: Parts, angle: int) -> dict[int, Any]:
    entries = slice(int(parts.forms.start[angle]), int(parts.forms.start[angle + 1]))
    return dict(zip(parts.forms.coordinate[entries].tolist(), parts.forms.value[entries].tolist(), strict=True))


def _inverse(rows: list[dict[int, Any]], coordinates: list[int]) -> ExactSums:
    """Return beta of sum_r beta_r l_r = b, for linearly independent forms."""
    from flint import fmpq_mat

    r, m = len(rows), len(coordinates)
    # [L^T | 1], reduced, is [1 | B] in its first rows, with B L^T = 1.
    augmented = [
        [rational(row.get(k, 0)) for row in rows] + [rational(int(i == j)) for j in range(m)]
        for i, k in enumerate(coordinates)
    ]
    reduced, _ = fmpq_mat(m, r + m, [entry for line in augmented for entry in line]).rref()
    factors, denominators = [], []
    for a in range(r):
        exact = [reduced[a, r + j] for j in range(m)]
        denominators.append(lcm(*(int(value.denominator) for value in exact)))
        factors.append(tuple(int(value.numerator) * (denominators[-1] // int(value.denominator)) for value in exact))
    return ExactSums(tuple(coordinates), tuple(factors), tuple(denominators))
