"""The h^2 term of the modified Hamiltonian of a splitting at given points, and the order of parts that minimizes it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import expand
from coadjoint.algebra.lie_algebra import LieAlgebra
from coadjoint.program.parts.part import BodyShare, FunctionShare, Parts, PolynomialShare
from coadjoint.program.parts.split import separated_functions
from coadjoint.program.term_table import derivative_of
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


def part_derivatives(parts: Parts, points: Floats, t: float = 0.0) -> tuple[Floats, Floats]:
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
    hessian = np.repeat(quadratic, count, axis=1) if parts.nonlinear_shares else quadratic
    for s, share in parts.nonlinear_shares.items():
        if isinstance(share, BodyShare):
            continue
        coordinates = share.term.coordinates if isinstance(share, FunctionShare) else np.array(share.coordinates)
        p = part[parts.row[s]]
        for k, x in enumerate(points):
            share_gradient, share_hessian = _share_derivatives(share, coordinates, x, t)
            gradient[p, k, coordinates] += share_gradient
            hessian[p, k][np.ix_(coordinates, coordinates)] += share_hessian
    return gradient, hessian


def _share_derivatives(
    share: PolynomialShare | FunctionShare, coordinates: NDArray[Any], x: Floats, t: float
) -> tuple[Floats, Floats]:
    """Return gradient and Hessian of a share with respect to its own coordinates."""
    if isinstance(share, FunctionShare):
        gradient, hessian = (derivative_of(share.term, order, x[coordinates], t) for order in (1, 2))
    else:
        gradient, hessian = (
            share.polynomial.gradient(x)[coordinates],
            share.polynomial.hessian(x)[np.ix_(coordinates, coordinates)],
        )
    return np.asarray(gradient, dtype=np.float64), np.asarray(hessian, dtype=np.float64)


def _matrix_vector(matrices: Floats, vectors: Floats) -> Floats:
    """Multiply matrices by vectors (..., n), summed in order, since bits of einsum depend on the batch."""
    total = matrices[..., 0] * vectors[..., :1]
    for j in range(1, matrices.shape[-1]):
        total = total + matrices[..., j] * vectors[..., j : j + 1]
    return total


class DerivativeSamples:
    """Gradients and Hessians of several sets of parts at points (k, n), computed once to compare many orders."""

    def __init__(self, algebra: LieAlgebra, sets: Sequence[Parts], points: Floats, t: float = 0.0) -> None:
        derivatives = part_derivatives(Parts.concatenate(sets), points, t)
        shape = (len(sets), len(sets[0]))
        self._gradients, self._hessians = (array.reshape(*shape, *array.shape[1:]) for array in derivatives)
        count, n = points.shape
        self._i, self._j, self._k, self._c = algebra.triples
        flat = np.zeros((n * n, count))
        products = (self._c * points[:, self._k]).T
        np.add.at(flat, self._i * n + self._j, products)
        np.subtract.at(flat, self._j * n + self._i, products)
        self._structure = flat.T.reshape(count, n, n)

    def second_order_terms(self, orders: Sequence[Sequence[int]]) -> Floats:
        """Return H2, shape (sets, orders, k), for orders of parts in a forward sweep. ``X1(h/2) ... Xn(h) ... X1(h/2)``
        is the time-h flow of H + h^2 H2 + O(h^4). For a pair, A outside and D inside, H2 = -{A, {A, D}}/24 + {D, {D,
        A}}/12; several parts are nested pairs.
        """
        order_array = np.array(orders)
        inside, inside_hessian = self._gradients[:, order_array[:, -1]], self._hessians[:, order_array[:, -1]]
        total = np.zeros(inside.shape[:3])
        for position in range(order_array.shape[1] - 2, -1, -1):
            outside, outside_hessian = (
                self._gradients[:, order_array[:, position]],
                self._hessians[:, order_array[:, position]],
            )
            rotated = self._apply_structure(self._bracket_gradient(outside, outside_hessian, inside, inside_hessian))
            weights = outside / 24.0 + inside / 12.0
            for i in range(inside.shape[-1]):
                total -= weights[..., i] * rotated[..., i]
            inside, inside_hessian = outside + inside, outside_hessian + inside_hessian
        return total

    def sizes(self, orders: Sequence[Sequence[int]]) -> Floats:
        """Return the root mean square of H2 over the points, shape (sets, orders)."""
        # Terms that overflow float64 count as larger than all others.
        with np.errstate(over="ignore", invalid="ignore"):
            terms = self.second_order_terms(orders)
            squares = np.zeros(terms.shape[:2])
            for k in range(terms.shape[2]):
                squares += terms[..., k] ** 2
            root_mean_squares = np.sqrt(squares / terms.shape[2])
        return np.where(np.isnan(root_mean_squares), np.inf, root_mean_squares)

    def nested_brackets(self, j: NDArray[np.int64], k: NDArray[np.int64]) -> Floats:
        """Return {H_i, {H_j, H_k}} of the first set, all parts i and pairs (j, k), shape (parts, pairs, k)."""
        inner = self._bracket_gradient(
            self._gradients[:1, j], self._hessians[:1, j], self._gradients[:1, k], self._hessians[:1, k]
        )
        rotated = self._apply_structure(inner)[0]
        brackets = np.zeros((len(self._gradients[0]), *rotated.shape[:2]))
        for i, gradient in enumerate(self._gradients[0]):
            for a in range(gradient.shape[-1]):
                brackets[i] += gradient[:, a] * rotated[..., a]
        return brackets

    def _apply_structure(self, u: Floats) -> Floats:
        return _matrix_vector(self._structure, u)

    def _bracket_gradient(self, a: Floats, a_hessian: Floats, d: Floats, d_hessian: Floats) -> Floats:
        """Return the gradient of {A, D}: A'' J grad D - D'' J grad A + [grad A, grad D], J being linear in x."""
        result = _matrix_vector(a_hessian, self._apply_structure(d)) - _matrix_vector(
            d_hessian, self._apply_structure(a)
        )
        products = self._c * (a[..., self._i] * d[..., self._j] - a[..., self._j] * d[..., self._i])
        np.add.at(np.moveaxis(result, -1, 0), self._k, np.moveaxis(products, -1, 0))
        return result


def second_order_term(algebra: LieAlgebra, parts: Parts, points: Floats, t: float = 0.0) -> Floats:
    """Return H2 of parts in the order of a forward sweep at points (k, n), shape (k,); see `DerivativeSamples`."""
    return DerivativeSamples(algebra, [parts], points, t).second_order_terms([range(len(parts))])[0, 0]


class NestedBrackets:
    """Brackets {H_i, {H_j, H_k}}, j < k, of the pieces of at least two parts; {F, G} = (grad F)^T J(x) grad G."""

    def __init__(self, algebra: LieAlgebra, parts: Parts) -> None:
        self.algebra, self.parts = algebra, parts
        self.pairs = list(combinations(range(len(parts)), 2))

    def values(self, points: Floats, t: float = 0.0) -> Floats:
        """Return the brackets at points (k, n), shape (parts, pairs, k)."""
        samples = DerivativeSamples(self.algebra, [self.parts], points, t)
        j, k = np.array(self.pairs).T
        return samples.nested_brackets(j, k)

    def gradients(self, points: Floats, t: float = 0.0) -> Floats:
        """Return the gradients at points (k, n), shape (parts, pairs, k, n), by central differences."""
        size = np.max(np.abs(points), axis=1, keepdims=True)
        offset = DIFFERENCE_STEP * np.where(size > 0.0, size, 1.0)
        columns = []
        for i in range(points.shape[1]):
            ahead, behind = points.copy(), points.copy()
            ahead[:, i : i + 1] += offset
            behind[:, i : i + 1] -= offset
            columns.append((self.values(ahead, t) - self.values(behind, t)) / (ahead - behind)[:, i])
        return np.stack(columns, axis=-1)

    def weights(self, order: Sequence[int]) -> Floats:
        """Return the coefficients of the brackets in H2, shape (parts, pairs), for an order of a forward sweep.

        A part A followed by the sum D of all later ones contributes -{A, {A, D}}/24 + {D, {D, A}}/12.
        """
        column = {pair: number for number, pair in enumerate(self.pairs)}
        weights = np.zeros((len(self.parts), len(self.pairs)))

        def add(i: int, j: int, k: int, factor: float) -> None:
            weights[i, column[min(j, k), max(j, k)]] += factor if j < k else -factor

        for first, a in enumerate(order):
            later = order[first + 1 :]
            for d in later:
                add(a, a, d, -1.0 / 24.0)
                for e in later:
                    add(e, d, a, 1.0 / 12.0)
        return weights


def best_order(
    system: LiePoissonSystem, parts: Parts, points: NDArray[np.float64], t: float = 0.0
) -> tuple[tuple[int, ...], float]:
    """Return the order with the smallest root mean square of the h^2 term at `points` (k, n), and that value. Up to
    five parts are permuted in all ways, up to eight moved one by one as long as that helps; more keep their order. The
    natural order and zero are returned if the term is not available (no second derivatives, or no points).
    """
    return best_orders(system, [parts], points, t)[0]


def best_orders(
    system: LiePoissonSystem, sets: Sequence[Parts], points: NDArray[np.float64], t: float = 0.0
) -> list[tuple[tuple[int, ...], float]]:
    """Return `best_order` of several sets of as many parts."""
    natural = tuple(range(len(sets[0])))
    if len(natural) < 2 or not len(points) or not has_hessians(system, system.hamiltonian.terms()):
        return [(natural, 0.0) for _ in sets]
    if len(natural) > MAX_PERMUTED and len(sets) > 1:
        return [best_order(system, parts, points, t) for parts in sets]
    samples = DerivativeSamples(system.algebra, sets, points, t)
    if len(natural) > MAX_ORDERED:
        return [(natural, float(samples.sizes([natural])[0, 0]))]
    if len(natural) > MAX_PERMUTED:
        return [smallest_order(natural, lambda orders: samples.sizes(orders)[0].tolist())]
    orders = list(permutations(natural))
    return [_first_clearly_smallest(orders, sizes) for sizes in samples.sizes(orders).tolist()]


def smallest_order(
    natural: tuple[int, ...], sizes: Callable[[Sequence[tuple[int, ...]]], Sequence[float]]
) -> tuple[tuple[int, ...], float]:
    """Return the order that minimises a measure, and it; the `natural` one is kept unless another is clearly better."""
    if len(natural) <= MAX_PERMUTED:
        orders = list(permutations(natural))
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
