"""Which splitting? Parts, their order, and how much of each quadratic Casimir is taken off the Hamiltonian first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomial import Polynomial
from coadjoint.methods.chosen_parts import ChosenParts
from coadjoint.program.parts import Part, Parts
from coadjoint.program.second_order import Samples
from coadjoint.program.shift import QuadraticCasimir, Shift, candidate_shifts, quadratic_casimirs, shifted_terms
from coadjoint.program.shift_counts import numbers_of_parts
from coadjoint.program.split import split
from coadjoint.systems.lie_poisson import LiePoissonSystem
from coadjoint.systems.terms import FunctionTerm, Term

SEED = 1993
SAMPLES = 16
# Larger systems keep the order that they come in: comparing orders costs n^3 for each of them.
LARGEST_COMPARED = 24
MOST_PERMUTED = 5
# More parts than this keep their order: comparing them would take longer than many a run.
MOST_ORDERED = 8
# Sizes that differ by rounding alone must not decide, so that every machine chooses the same.
CLEARLY = 1.0 - 1e-9


@dataclass(frozen=True)
class Decomposition:
    """Parts in the order of a forward sweep, and the Casimirs taken off H; the momentum moves as without.

    Parameters
    ----------
    parts : Parts
        The exact flows.
    shift : tuple of (Polynomial, float)
        Quadratic Casimirs C and factors c: the parts add up to H - sum c C.
    choice : ChosenParts
        What to pass as `parts` to get the same again.
    """

    parts: Parts
    shift: tuple[tuple[Polynomial, float], ...]
    choice: ChosenParts


def decompose(system: LiePoissonSystem, choice: Any) -> Decomposition:
    """Take the Hamiltonian of a system apart, by the algebra and H alone.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    choice : "auto", "coordinates", sequence of sequences of int, or ChosenParts
        ``"auto"``: few parts, after taking off multiples of quadratic Casimirs where that removes a part or lowers the
        h^2 term, in the order with the smallest h^2 term over a fixed sample. All else is taken as it stands.

    Returns
    -------
    Decomposition
        The same system gives the same one, always.

    Raises
    ------
    ValueError
        If the Hamiltonian does not split, or the choice does not fit the system.
    """
    if isinstance(choice, ChosenParts):
        return _chosen(system, choice)
    if not isinstance(choice, str) or choice != "auto":
        parts = split(system, choice)
        return Decomposition(parts, (), ChosenParts(tuple(range(len(parts)))))
    if system not in _FOUND:
        _FOUND[system] = best_decomposition(system, _sample(system.dim))
    return _FOUND[system]


# Systems do not change: what was found for one serves all of its runs, as long as it lives.
_FOUND: WeakKeyDictionary[LiePoissonSystem, Decomposition] = WeakKeyDictionary()


def best_decomposition(system: LiePoissonSystem, points: NDArray[np.float64], t: float = 0.0) -> Decomposition:
    """Return the decomposition with the fewest parts and, among those, the smallest h^2 term at some points.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    points : ndarray, shape (k, n)
        Where the term is compared.
    t : float
        Time.

    Returns
    -------
    Decomposition
        With its shift and order.
    """
    terms, casimirs = system.hamiltonian.terms(), quadratic_casimirs(system)
    best = split(system, "auto", terms)
    shift: Shift = ()
    order, least = best_order(system, best, points, t)
    candidates = list(candidate_shifts(system, best, casimirs)) if len(best) > 1 else []
    # Without points to compare at, only fewer parts count, and many shifts can be told to leave as many.
    counts = [0] * len(candidates) if len(points) else numbers_of_parts(system, casimirs, candidates)
    for candidate, count in zip(candidates, counts, strict=True):
        if count >= len(best):
            continue
        parts = split(system, "auto", shifted_terms(terms, casimirs, candidate))
        if len(parts) > len(best):
            continue
        own, size = best_order(system, parts, points, t)
        if len(parts) < len(best) or size < least * CLEARLY:
            shift, order, least, best = candidate, own, size, parts
    return _arranged(best, ChosenParts(order, shift), casimirs)


def _chosen(system: LiePoissonSystem, choice: ChosenParts) -> Decomposition:
    casimirs = quadratic_casimirs(system)
    parts = split(system, "auto", shifted_terms(system.hamiltonian.terms(), casimirs, choice.shift))
    if len(parts) != len(choice.order):
        raise ValueError(
            f"parts orders {len(choice.order)} parts, but {system.name} has {len(parts)} of them; "
            "choose again with Splitting.tuned"
        )
    return _arranged(parts, choice, casimirs)


def _arranged(parts: Parts, choice: ChosenParts, casimirs: Mapping[str, QuadraticCasimir]) -> Decomposition:
    taken = tuple((casimirs[name].polynomial, factor) for name, factor in choice.shift)
    return Decomposition(parts.take(np.array(choice.order, dtype=np.int64)), taken, choice)


def best_order(
    system: LiePoissonSystem, parts: Sequence[Part], points: NDArray[np.float64], t: float = 0.0
) -> tuple[tuple[int, ...], float]:
    """Return the order of the parts with the smallest root mean square of the h^2 term at some points, and that size.

    Parameters
    ----------
    system : LiePoissonSystem
        The system.
    parts : sequence of Part
        At most five are permuted in every way, up to eight are moved one by one while that helps, and more keep
        their order.
    points : ndarray, shape (k, n)
        Where the term is taken; none for a system too large to compare.
    t : float
        Time.

    Returns
    -------
    order : tuple of int
        The natural order where the term cannot be had (no second derivatives, or too large).
    size : float
        Zero there.
    """
    natural = tuple(range(len(parts)))
    if len(parts) < 2 or not len(points) or not _has_hessians(system.hamiltonian.terms()):
        return natural, 0.0

    samples = Samples(system.algebra, parts, points, t)

    def size(order: tuple[int, ...]) -> float:
        return float(np.sqrt(np.mean(samples.second_order_term(order) ** 2)))

    best, least, improved = natural, size(natural), len(parts) <= MOST_ORDERED
    while improved:
        improved = False
        for order in _neighbours(best):
            error = size(order)
            if error < least * CLEARLY:
                best, least, improved = order, error, len(parts) > MOST_PERMUTED
    return best, least


def _neighbours(order: tuple[int, ...]) -> Iterable[tuple[int, ...]]:
    if len(order) <= MOST_PERMUTED:
        return permutations(sorted(order))
    moved = []
    for source in range(len(order)):
        rest = order[:source] + order[source + 1 :]
        moved += [rest[:k] + order[source : source + 1] + rest[k:] for k in range(len(order)) if k != source]
    return moved


def _has_hessians(terms: Iterable[Term]) -> bool:
    return all(not isinstance(term, FunctionTerm) or term.hessian is not None for term in terms)


def _sample(size: int) -> NDArray[np.float64]:
    """Return fixed points of unit length: the choice must not depend on a state."""
    if size > LARGEST_COMPARED:
        return np.zeros((0, size))
    points = np.random.default_rng(SEED).standard_normal((SAMPLES, size))
    return np.asarray(points / np.sqrt(np.sum(points**2, axis=1, keepdims=True)))
