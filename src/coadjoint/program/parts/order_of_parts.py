"""Order of parts with the smallest h^2 term, by enumeration or by moving single parts."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.modified_energy.second_order import Samples
from coadjoint.program.parts.part import Parts
from coadjoint.program.parts.split import separated_functions
from coadjoint.systems.hamiltonians.terms import Term
from coadjoint.systems.lie_poisson import LiePoissonSystem

MAX_PERMUTED = 5  # parts of which all 120 orders are compared; of more, exchanges of neighbours
# Above this number parts keep their order: comparing orders could take longer than a run.
MAX_ORDERED = 8
# Differences by rounding must not matter, so that the choice is the same on every machine.
IMPROVEMENT_FACTOR = 1.0 - 1e-9


def best_order(
    system: LiePoissonSystem, parts: Parts, points: NDArray[np.float64], t: float = 0.0
) -> tuple[tuple[int, ...], float]:
    """Return the order with the smallest root mean square of the h^2 term at `points` (k, n), and that value.

    Up to five parts are permuted in all ways, up to eight moved one by one as long as that helps; more keep their
    order. The natural order and zero are returned if the term is not available (no second derivatives, or no points).
    """
    return best_orders([(system, parts)], points, t)[0]


def best_orders(
    pairs: Sequence[tuple[LiePoissonSystem, Parts]], points: NDArray[np.float64], t: float = 0.0
) -> list[tuple[tuple[int, ...], float]]:
    """Return `best_order` of several systems of one dimension, each with its parts."""
    result = [(tuple(range(len(parts))), 0.0) for _, parts in pairs]
    batches: dict[Hashable, list[int]] = {}
    for m, (system, parts) in enumerate(pairs):
        terms = system.hamiltonian.terms()
        if len(parts) > 1 and len(points) and _has_hessians(system, terms):
            pattern = tuple(column.tobytes() for column in system.algebra.triples[:3])
            quadratic = all(term.form is not None for term in terms)
            # Many parts are moved one by one, separately for each set.
            key: Hashable = (len(parts), quadratic, pattern) if len(parts) <= MAX_PERMUTED else m
            batches.setdefault(key, []).append(m)
    for members in batches.values():
        samples = Samples([pairs[m][0].algebra for m in members], [pairs[m][1] for m in members], points, t)
        for m, best in zip(members, _smallest_orders(samples, result[members[0]][0]), strict=True):
            result[m] = best
    return result


def _smallest_orders(samples: Samples, natural: tuple[int, ...]) -> list[tuple[tuple[int, ...], float]]:
    """Return for each set of parts the order with the smallest h^2 term, and its size."""
    if len(natural) > MAX_ORDERED:
        return [(natural, float(size)) for size in samples.sizes([natural])[:, 0]]
    if len(natural) > MAX_PERMUTED:
        return [smallest_order(natural, lambda orders: samples.sizes(orders)[0].tolist())]
    orders = list(permutations(natural))
    return [_first_clearly_smallest(orders, sizes) for sizes in samples.sizes(orders).tolist()]


def smallest_order(
    natural: tuple[int, ...], sizes: Callable[[Sequence[tuple[int, ...]]], Sequence[float]]
) -> tuple[tuple[int, ...], float]:
    """Minimise a measure over the orders of few parts; return the order and its measure.

    The search starts from `natural`, which is kept unless another order is clearly better.
    """
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


def _has_hessians(system: LiePoissonSystem, terms: Sequence[Term]) -> bool:
    """Return whether the second derivatives of all parts are known; those of functions that are sums are."""
    if all(term.differentiable for term in terms):
        return True
    separated = separated_functions(system)
    return all(part.differentiable for k, term in enumerate(terms) for part in separated.get(k, (term,)))
