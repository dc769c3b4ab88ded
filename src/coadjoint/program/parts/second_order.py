"""The h^2 term of the modified Hamiltonian of a splitting at given points, and the order of parts that minimizes it.

For one system, or for all members of a stack at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import combinations, permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers, expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.part import GradientShare, Parts
from coadjoint.program.parts.split import separated_functions
from coadjoint.program.sources import Sources
from coadjoint.program.sparse_rows import SparseRows
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.terms import Term
from coadjoint.systems.lie_poisson import LiePoissonSystem

Floats = NDArray[np.float64]

# Relative step of the central differences; brackets are smooth, so the relative error is about (2^-14)^2.
DIFFERENCE_STEP = 2.0**-14
MAX_PERMUTED = 5  # parts of which all 120 orders are compared; of more, exchanges of neighbours
# Above this number parts keep their order: comparing orders could take longer than a run.
MAX_ORDERED = 8
# Differences by rounding must not matter, so that the choice is the same on every machine.
IMPROVEMENT_FACTOR = 1.0 - 1e-9
# Operations of an h^2 term beside the sum over triples of pieces, each of which may round the sum of absolute terms.
OPERATIONS = 512
MAX_ATOMS = 40  # pieces of all parts; brackets of all triples are stored


def part_derivatives(parts: Parts, points: Floats) -> tuple[Floats, Floats]:
    """Return gradient and Hessian of the piece of the Hamiltonian of each part at points (k, n). The gradients sum_a
    l_a theta_a have shape (parts, k, n), the Hessians (parts, k, n, n), or (parts, 1, n, n) if all are constant.
    """
    count, n = points.shape
    constant, quadratic = np.zeros((len(parts), 1, n)), np.zeros((len(parts), 1, n, n))
    forms, weights, part = parts.forms, parts.weights, parts.part_of_angle
    angle, value = forms.owner, forms.value.astype(np.float64)
    index: Any = (part[angle], 0, forms.coordinate)
    np.add.at(constant, index, value * parts.offset[angle].astype(np.float64))
    entry, weight_entry = expand(weights.start[angle], weights.start[angle + 1])
    index = (part[angle[entry]], 0, forms.coordinate[entry], weights.coordinate[weight_entry])
    np.add.at(quadratic, index, value[entry] * weights.value[weight_entry].astype(np.float64))
    gradient = constant + _matrix_vector(quadratic, points)
    hessian = np.repeat(quadratic, count, axis=1) if parts.gradients else quadratic
    for s, share in parts.gradients.items():
        coordinates, p = np.array(share.coordinates), part[parts.row[s]]
        for k, x in enumerate(points):
            share_gradient, share_hessian = share.derivatives(x)
            gradient[p, k, coordinates] += share_gradient
            hessian[p, k][np.ix_(coordinates, coordinates)] += share_hessian
    return gradient, hessian


def _matrix_vector(matrices: Floats, vectors: Floats) -> Floats:
    """Multiply matrices by vectors (..., n), summed in order, since bits of einsum depend on the batch."""
    total = matrices[..., 0] * vectors[..., :1]
    for j in range(1, matrices.shape[-1]):
        total = total + matrices[..., j] * vectors[..., j : j + 1]
    return total


def nested_brackets(algebra: LieAlgebra, sets: Sequence[Parts], points: Floats) -> Floats:
    """Return {H_i, {H_j, H_k}}, j < k, of the pieces of several sets of as many parts at points (k, n), shape (sets,
    parts, pairs, k), with {F, G} = (grad F)^T J(x) grad G. With `order_weights` they add up to H2 of parts in the order
    of a forward sweep: ``X1(h/2) ... Xn(h) ... X1(h/2)`` is the time-h flow of H + h^2 H2 + O(h^4).
    """
    shape = len(sets), len(sets[0])
    derivatives = part_derivatives(Parts.concatenate(sets), points)
    gradients, hessians = (array.reshape(*shape, *array.shape[1:]) for array in derivatives)
    first, second = np.array(list(combinations(range(shape[1]), 2)), dtype=np.int64).reshape(-1, 2).T
    i, j, k, c = algebra.triples
    count, n = points.shape
    flat = np.zeros((n * n, count))
    products = (c * points[:, k]).T
    np.add.at(flat, i * n + j, products)
    np.subtract.at(flat, j * n + i, products)
    structure = flat.T.reshape(count, n, n)
    # The gradient of {A, D} is A'' J grad D - D'' J grad A + [grad A, grad D], J being linear in x.
    a, d = gradients[:, first], gradients[:, second]
    inner = _matrix_vector(hessians[:, first], _matrix_vector(structure, d))
    inner -= _matrix_vector(hessians[:, second], _matrix_vector(structure, a))
    products = c * (a[..., i] * d[..., j] - a[..., j] * d[..., i])
    np.add.at(np.moveaxis(inner, -1, 0), k, np.moveaxis(products, -1, 0))
    rotated = _matrix_vector(structure, inner)
    brackets = np.zeros((*shape, *rotated.shape[1:3]))
    for coordinate in range(n):
        brackets += gradients[:, :, None, :, coordinate] * rotated[:, None, ..., coordinate]
    return brackets


def bracket_gradients(algebra: LieAlgebra, parts: Parts, points: Floats) -> Floats:
    """Return the gradients of `nested_brackets` at points (k, n), (parts, pairs, k, n), by central differences."""
    size = np.max(np.abs(points), axis=1, keepdims=True)
    offset = DIFFERENCE_STEP * np.where(size > 0.0, size, 1.0)
    columns = []
    for i in range(points.shape[1]):
        ahead, behind = points.copy(), points.copy()
        ahead[:, i : i + 1] += offset
        behind[:, i : i + 1] -= offset
        change = np.subtract(*(nested_brackets(algebra, [parts], side)[0] for side in (ahead, behind)))
        columns.append(change / (ahead - behind)[:, i])
    return np.stack(columns, axis=-1)


def order_sizes(brackets: Floats, orders: Sequence[tuple[int, ...]]) -> list[float]:
    """Return the root mean square of H2 over the points, for `nested_brackets` of one set and orders of its parts."""
    weights = np.array([order_weights(order).ravel() for order in orders])
    count = brackets.shape[2]
    terms = np.zeros((len(orders), count))
    # Terms that overflow float64 count as larger than all others.
    with np.errstate(over="ignore", invalid="ignore"):
        for weight, bracket in zip(weights.T, brackets.reshape(-1, count), strict=True):
            terms += weight[:, None] * bracket
        root_mean_squares = np.sqrt(np.cumsum(terms**2, axis=1)[:, -1] / count)  # summed in order
    return np.where(np.isnan(root_mean_squares), np.inf, root_mean_squares).tolist()


@lru_cache(maxsize=1024)
def order_weights(order: tuple[int, ...]) -> Floats:
    """Return the coefficients of `nested_brackets` in H2, shape (parts, pairs), for an order of a forward sweep.

    A part A followed by the sum D of all later ones contributes -{A, {A, D}}/24 + {D, {D, A}}/12.
    """
    column = {pair: number for number, pair in enumerate(combinations(range(len(order)), 2))}
    weights = np.zeros((len(order), len(column)))

    def add(i: int, j: int, k: int, factor: float) -> None:
        weights[i, column[min(j, k), max(j, k)]] += factor if j < k else -factor

    for first, a in enumerate(order):
        later = order[first + 1 :]
        for d in later:
            add(a, a, d, -1.0 / 24.0)
            for e in later:
                add(e, d, a, 1.0 / 12.0)
    weights.flags.writeable = False
    return weights


def best_orders(
    system: LiePoissonSystem, sets: Sequence[Parts], points: NDArray[np.float64]
) -> list[tuple[tuple[int, ...], float]]:
    """Return for several sets of as many parts the order with the smallest root mean square of the h^2 term at `points`
    (k, n), and that value. Up to five parts are permuted in all ways, up to eight moved one by one as long as that
    helps; more keep their order. The natural order and zero are returned if the term is not available (no second
    derivatives, or no points).
    """
    natural = tuple(range(len(sets[0])))
    if len(natural) < 2 or not len(points) or not has_hessians(system, system.hamiltonian.terms()):
        return [(natural, 0.0) for _ in sets]
    with np.errstate(over="ignore", invalid="ignore"):
        each = nested_brackets(system.algebra, sets, points)
    if len(natural) > MAX_ORDERED:
        return [(natural, order_sizes(brackets, [natural])[0]) for brackets in each]
    return [smallest_order(natural, partial(order_sizes, brackets)) for brackets in each]


def smallest_order(
    natural: tuple[int, ...], sizes: Callable[[Sequence[tuple[int, ...]]], Sequence[float]]
) -> tuple[tuple[int, ...], float]:
    """Return the order that minimises a measure, and it; the `natural` one is kept unless another is clearly better."""
    if len(natural) <= MAX_PERMUTED:
        orders: list[tuple[int, ...]] = list(permutations(natural))
        return _first_clearly_smallest(orders, sizes(orders))
    best = natural
    while True:
        orders = [best, *_neighbours(best)]
        order, size = _first_clearly_smallest(orders, sizes(orders))
        if order == best:
            return best, size
        best = order


def _first_clearly_smallest(orders: Sequence[tuple[int, ...]], sizes: Sequence[float]) -> tuple[tuple[int, ...], float]:
    best, least = orders[0], sizes[0]
    for order, size in zip(orders[1:], sizes[1:], strict=True):
        if size < least * IMPROVEMENT_FACTOR:
            best, least = order, size
    return best, least


def _neighbours(order: tuple[int, ...]) -> list[tuple[int, ...]]:
    neighbours = []
    for source in range(len(order)):
        rest = order[:source] + order[source + 1 :]
        neighbours += [rest[:k] + order[source : source + 1] + rest[k:] for k in range(len(order)) if k != source]
    return neighbours


def has_hessians(system: LiePoissonSystem, terms: Sequence[Term]) -> bool:
    """Return whether the second derivatives of all parts are known; those of functions that are sums are."""
    if all(term.differentiable for term in terms):
        return True
    separated = separated_functions(system)
    return all(part.differentiable for k, term in enumerate(terms) for part in separated.get(k, (term,)))


def joint_sizes(
    algebra: LieAlgebra, parts: Parts, sources: Sources, coefficients: Floats, points: Floats
) -> tuple[Floats, Floats]:
    """Return the root mean square of the h^2 term for each order of parts, (orders, members), and its rounding.

    Both are infinite if they overflow, or there are too many pieces. All members share the brackets.
    """
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
    """Choose an order (members,) as by exact sizes, with its size and the bound of its rounding.

    The last array is False where rounding may decide.
    """
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
