"""In which order do parts move? In that of the smallest h^2 term, of all orders or by moving parts one by one."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.parts import Parts
from coadjoint.program.second_order import Samples
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.terms import Term

MOST_PERMUTED = 5
# More parts than this keep their order: comparing them would take longer than many a run.
MOST_ORDERED = 8
# Sizes that differ by rounding alone must not decide; so every machine chooses the same order.
CLEARLY = 1.0 - 1e-9


def best_order(
    system: LiePoissonSystem, parts: Parts, points: NDArray[np.float64], t: float = 0.0
) -> tuple[tuple[int, ...], float]:
    """Return the order of the parts with the smallest root mean square of the h^2 term at some points, and that size.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    parts : Parts
        At most five are permuted in every way, up to eight are moved one by one while that helps, and more keep
        their order.
    points : ndarray, shape (k, n)
        Where the term is taken; none for a system too large to compare.
    t : float
        Time.

    Returns
    -------
    order : tuple of int
        The natural order where the term cannot be computed (no second derivatives, or a system too large).
    size : float
        Root mean square of the h^2 term; zero where it cannot be computed.
    """
    return best_orders([(system, parts)], points, t)[0]


def best_orders(
    pairs: Sequence[tuple[LiePoissonSystem, Parts]], points: NDArray[np.float64], t: float = 0.0
) -> list[tuple[tuple[int, ...], float]]:
    """Return `best_order` of several systems of one dimension, each with its parts."""
    result = [(tuple(range(len(parts))), 0.0) for _, parts in pairs]
    alike: dict[Hashable, list[int]] = {}
    for m, (system, parts) in enumerate(pairs):
        terms = system.hamiltonian.terms()
        if len(parts) > 1 and len(points) and _has_hessians(terms):
            pattern = tuple(column.tobytes() for column in system.algebra.triples[:3])
            quadratic = all(term.form is not None for term in terms)
            # Many parts are moved one by one, for each set on its own.
            key: Hashable = (len(parts), quadratic, pattern) if len(parts) <= MOST_PERMUTED else m
            alike.setdefault(key, []).append(m)
    for members in alike.values():
        samples = Samples([pairs[m][0].algebra for m in members], [pairs[m][1] for m in members], points, t)
        for m, found in zip(members, _least(samples, result[members[0]][0]), strict=True):
            result[m] = found
    return result


def _least(samples: Samples, natural: tuple[int, ...]) -> list[tuple[tuple[int, ...], float]]:
    """Return for each set of parts the order with the smallest h^2 term, and its size."""
    if len(natural) > MOST_ORDERED:
        return [(natural, float(size)) for size in samples.sizes([natural])[:, 0]]
    if len(natural) > MOST_PERMUTED:
        return [least_of_orders(natural, lambda orders: samples.sizes(orders)[0].tolist())]
    orders = list(permutations(natural))
    return [_first_clearly_least(orders, sizes) for sizes in samples.sizes(orders).tolist()]


def least_of_orders(
    natural: tuple[int, ...], sizes: Callable[[Sequence[tuple[int, ...]]], Sequence[float]]
) -> tuple[tuple[int, ...], float]:
    """Return the order of few parts that is least by a measure, and how much that is.

    Parameters
    ----------
    natural : tuple of int
        Numbers of the parts: the order to begin with, which is kept unless another one is clearly less.
    sizes : callable
        The measure of several orders.

    Returns
    -------
    order : tuple of int
    size : float
    """
    if len(natural) <= MOST_PERMUTED:
        orders = list(permutations(natural))
        return _first_clearly_least(orders, sizes(orders))
    best = natural
    while True:
        orders = [best, *_neighbours(best)]
        found, size = _first_clearly_least(orders, sizes(orders))
        if found == best:
            return best, size
        best = found


def _first_clearly_least(orders: Sequence[tuple[int, ...]], sizes: Sequence[float]) -> tuple[tuple[int, ...], float]:
    best, least = orders[0], sizes[0]
    for order, size in zip(orders[1:], sizes[1:], strict=True):
        if size < least * CLEARLY:
            best, least = order, size
    return best, least


def _neighbours(order: tuple[int, ...]) -> list[tuple[int, ...]]:
    moved = []
    for source in range(len(order)):
        rest = order[:source] + order[source + 1 :]
        moved += [rest[:k] + order[source : source + 1] + rest[k:] for k in range(len(order)) if k != source]
    return moved


def _has_hessians(terms: Iterable[Term]) -> bool:
    return all(term.differentiable for term in terms)
