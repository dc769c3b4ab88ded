"""The h^2 term of the modified Hamiltonian of a splitting at given points, and the order of parts that minimizes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from itertools import combinations, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.split import separated_functions
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


def part_derivatives(parts: Parts, points: Floats) -> tuple[Floats, Floats]:
    """Return by part gradients (parts, k, n) and Hessians (parts, k or 1, n, n) of its piece of H at points (k, n)."""
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
    """Return {H_i, {H_j, H_k}}, j < k, at points, (sets, parts, pairs, k), with {F, G} = (grad F)^T J(x) grad G.

    With `order_weights` they add up to H2: ``X1(h/2) ... Xn(h) ... X1(h/2)`` is the time-h flow of H + h^2 H2 + O(h^4).
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
    """Return the coefficients of `nested_brackets` in H2, (parts, pairs), for an order of a forward sweep.

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
    """Return for sets of as many parts the order with the smallest RMS of the h^2 term at `points` (k, n), and that.

    Up to five parts are permuted in all ways, up to eight moved one by one while that helps; more keep their order.
    Without the term (no second derivatives, or no points) it is the natural order and zero.
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
