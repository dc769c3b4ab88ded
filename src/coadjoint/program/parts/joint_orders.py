"""The h^2 terms of the orders of parts of many systems that differ in coefficients, with bounds of their rounding."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations, permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.part import GradientShare, Parts
from coadjoint.program.parts.second_order import (
    IMPROVEMENT_FACTOR,
    order_weights,
    part_derivatives,
)
from coadjoint.program.sources import Sources
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.rounding import UNIT_ROUNDOFF

Floats = NDArray[np.float64]

# Operations of an h^2 term beside the sum over triples of pieces, each of which may round the sum of absolute terms.
OPERATIONS = 512
MAX_ATOMS = 40  # pieces of all parts; brackets of all triples are stored


def joint_sizes(
    algebra: LieAlgebra, parts: Parts, sources: Sources, coefficients: Floats, points: Floats
) -> tuple[Floats, Floats]:
    """Return the RMS of the h^2 term (orders, members), and its rounding; infinite if it cannot be computed."""
    members, orders = coefficients.shape[1], list(permutations(range(len(parts))))
    atoms = _atoms(parts, sources, coefficients, points)
    if len(atoms) > MAX_ATOMS:
        return np.full((len(orders), members), np.inf), np.full((len(orders), members), np.inf)
    weights = np.array([order_weights(order) for order in orders]).reshape(len(orders), -1)
    with np.errstate(over="ignore", invalid="ignore"):
        terms, bounds = (_brackets(algebra, atoms, len(parts), points, absolute) for absolute in (False, True))
        sizes, errors = (
            np.sqrt(np.mean((w @ one.reshape(w.shape[1], -1)).reshape(len(orders), members, -1) ** 2, axis=-1))
            for w, one in ((weights, terms), (np.abs(weights), bounds))
        )
    failed = ~np.isfinite(sizes + errors)
    sizes[failed] = errors[failed] = np.inf
    return sizes, (OPERATIONS + len(atoms) ** 3) * UNIT_ROUNDOFF * errors


def _atoms(
    parts: Parts, sources: Sources, coefficients: Floats, points: Floats
) -> list[tuple[int, Floats, Floats, Floats]]:
    """Return the pieces of the parts: part, factors of the members, gradient and Hessian."""
    numbers = np.unique(np.concatenate([one.number for one in sources.multiples.values()]))
    varying = numbers[np.any(coefficients[numbers] != coefficients[numbers, :1], axis=1)]
    constant = coefficients[:, 0].copy()
    constant[varying] = 0.0
    pieces = [_derivatives(parts, sources, constant, points, True)]
    for number in varying.tolist():
        unit = np.zeros(len(coefficients))
        unit[number] = 1.0
        pieces.append(_derivatives(parts, sources, unit, points, False))
    weights = [np.ones(coefficients.shape[1]), *coefficients[varying]]
    return [
        (p, weight, gradients[p], np.broadcast_to(hessians[p], (len(points), *hessians.shape[2:])))
        for p in range(len(parts))
        for weight, (gradients, hessians) in zip(weights, pieces, strict=True)
        if np.any(gradients[p]) or np.any(hessians[p])
    ]


def _brackets(algebra: LieAlgebra, atoms: list[Any], count: int, points: Floats, absolute: bool) -> Floats:
    """Return {H_i, {H_j, H_k}} of the parts, (parts, pairs, members, points), or sums of absolute terms."""
    owner = np.array([p for p, *_ in atoms])
    weight, gradient, hessian = (np.stack([atom[k] for atom in atoms]) for k in (1, 2, 3))
    if absolute:
        weight = np.abs(weight)
    of_atoms = _nested(algebra, gradient, hessian, points, absolute)
    own, pairs = [np.flatnonzero(owner == p) for p in range(count)], list(combinations(range(count), 2))
    result = np.zeros((count, len(pairs), weight.shape[1], len(points)))
    for i, (number, (j, k)) in product(range(count), enumerate(pairs)):
        products = weight[own[i]][:, None, None] * weight[own[j]][:, None] * weight[own[k]]
        values = of_atoms[np.ix_(own[i], own[j], own[k])]
        result[i, number] = products.reshape(-1, weight.shape[1]).T @ values.reshape(-1, len(points))
    return result


def _nested(algebra: LieAlgebra, gradient: Floats, hessian: Floats, points: Floats, absolute: bool) -> Floats:
    """Return {A, {B, C}} of all atoms at points, (a, b, c, points), or with all terms and signs positive."""
    i, j, k, c = algebra.triples
    sign = 1.0 if absolute else -1.0
    if absolute:
        gradient, hessian, points, c = map(np.abs, (gradient, hessian, points, c))
    n, count = points.shape[1], len(points)
    structure = np.zeros((n, n, count))
    np.add.at(structure, (i, j), c[:, None] * points[:, k].T)
    np.add.at(structure, (j, i), sign * c[:, None] * points[:, k].T)
    rotated = np.einsum("pqx,bxq->bxp", structure, gradient, optimize=True)
    inner = np.einsum("axpq,bxq->abxp", hessian, rotated, optimize=True)
    inner = inner + sign * np.swapaxes(inner, 0, 1)
    pairs = gradient[:, None, :, i] * gradient[None, :, :, j] + sign * gradient[:, None, :, j] * gradient[None, :, :, i]
    np.add.at(np.moveaxis(inner, -1, 0), k, np.moveaxis(c * pairs, -1, 0))
    outer = np.einsum("pqx,bcxq->bcxp", structure, inner, optimize=True)
    return np.einsum("axp,bcxp->abcx", gradient, outer, optimize=True)


def _derivatives(
    parts: Parts, sources: Sources, coefficients: Floats, points: Floats, others: bool
) -> tuple[Floats, Floats]:
    """Return `part_derivatives` for other coefficients; numbers and functions that have none are kept if `others`."""

    def filled(name: str, constants: NDArray[Any]) -> NDArray[Any]:
        return sources.multiples[name].at(constants if others else 0.0 * constants, coefficients)

    shares: dict[int, GradientShare] = {}
    given = sorted(parts.gradients.items())
    own = [float(c) for _, share in given if share.polynomial is not None for c in share.polynomial.monomials.values()]
    values = iter(filled("coefficient", np.array(own)).tolist())
    for s, share in given:
        if share.polynomial is not None:
            monomials = {e: next(values) for e in share.polynomial.monomials}
            shares[s] = GradientShare(share.coordinates, Polynomial(monomials, dim=share.polynomial.dim))
        elif others:
            shares[s] = share
    weights = SparseRows(parts.weights.start, parts.weights.coordinate, filled("weight", parts.weights.value))
    offset = filled("offset", parts.offset)
    return part_derivatives(replace(parts, offset=offset, weights=weights, gradients=shares), points)


def smallest(sizes: Floats, errors: Floats) -> tuple[Integers, Floats, Floats, NDArray[np.bool_]]:
    """Choose orders (members,) as by exact sizes, with sizes and errors; the mask is False if rounding decides."""
    best = np.zeros(sizes.shape[1], dtype=np.int64)
    least, error = sizes[0].copy(), errors[0].copy()
    clear = np.isfinite(least)
    for k in range(1, len(sizes)):
        bound = least * IMPROVEMENT_FACTOR
        with np.errstate(invalid="ignore"):
            clear &= np.abs(sizes[k] - bound) > errors[k] + error
        smaller = sizes[k] < bound
        best[smaller] = k
        least, error = np.where(smaller, sizes[k], least), np.where(smaller, errors[k], error)
    return best, least, error, clear
