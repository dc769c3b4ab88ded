"""Decomposition of many systems with completed squares at once: those for which `decompose` makes the same choices.

A first system is decomposed alone. For the others the numbers that it was decided by are computed in arrays, bit for
bit where they are floats and with bounds where they are exact; what is not certainly decided alike is left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.memory import check_available_memory
from coadjoint.program.modified_energy.second_order import (
    IMPROVEMENT_FACTOR,
    MAX_ORDERED,
    MAX_PERMUTED,
    Samples,
    derivatives_of_members,
    has_hessians,
    neighbouring_orders,
)
from coadjoint.program.parts.agreement import Agreement, Undecided
from coadjoint.program.parts.decompose import (
    Candidate,
    decompose,
    fewest_parts,
    remember,
    sample_points,
    tried_candidates,
)
from coadjoint.program.parts.joint_squares import (
    Numbers,
    RoundedSquare,
    numbers_of_parts,
    require_commutators,
    squares_of_term,
)
from coadjoint.program.parts.part import COMPUTED, Parts
from coadjoint.program.parts.split import NotSplittable
from coadjoint.program.shifts.joint_shifts import ShiftedEnergies, factors_of, shifted_term
from coadjoint.program.shifts.joint_singular_factors import joint_singular_factors
from coadjoint.program.shifts.shift import (
    MAX_SINGULAR_DIMENSION,
    candidate_shifts,
    dense_matrix,
    quadratic_casimirs,
    shift_rules,
    shifted_terms,
    singular_factors,
)
from coadjoint.systems.system_stacks import SystemStack, counts_of
from coadjoint.systems.vanishing_products import without_cancelling

Floats = NDArray[np.float64]
Factors = dict[str, Floats]
"""Factors of Casimirs by name, (members,)."""

MAX_STRUCTURES = 32  # first systems that are compared with all others
MAX_FAILURES = 2  # first systems in a row with which no other agrees
MAX_STACKED = 4096  # systems compared at once
MAX_NUMBERS = 1 << 23  # numbers in memory at once
MAX_SAMPLED = 1 << 17  # numbers in an array of samples, so that it stays in the cache


def squared_choices(stack: SystemStack, choice: Any) -> list[SystemStack]:
    """Return systems with completed squares by their decompositions, with the numbers of their parts."""
    found: list[SystemStack] = []
    remaining, failures = np.arange(stack.size), 0
    for _ in range(MAX_STRUCTURES):
        if len(remaining) < 2 or failures == MAX_FAILURES:
            break
        try:
            chosen, left = _like_first(stack.take(remaining), choice)
        except (Undecided, NotSplittable):
            chosen, left = [], np.arange(1, len(remaining))
        found += chosen
        failures = 0 if len(left) < len(remaining) - 1 else failures + 1
        remaining = remaining[left]
    return found


def _like_first(stack: SystemStack, choice: Any) -> tuple[list[SystemStack], Integers]:
    """Return systems that are decomposed like the first one, and which others are left."""
    model = _Model(stack.first, choice)
    check_available_memory(8 * stack.size * model.kept, f"the completed squares of {stack.size} systems")
    found: dict[Any, list[SystemStack]] = {}
    left = [np.zeros(0, dtype=np.int64)]
    step = max(1, min(MAX_STACKED, MAX_NUMBERS // model.numbers))
    for first in range(1, stack.size, step):
        # The first system is always there, to compare with.
        members = np.append(0, np.arange(first, min(first + step, stack.size)))
        agreement = Agreement(len(members))
        with np.errstate(all="ignore"):  # overflow, after which nothing is certain
            groups = model.groups(stack.take(members), agreement)
        for key, chosen in groups:
            keep = chosen.numbers != stack.numbers[0] if first > 1 else np.ones(chosen.size, dtype=bool)
            if keep.any():
                found.setdefault(key, []).append(chosen.take(np.flatnonzero(keep)))
        left.append(members[~agreement.alike])
    return [SystemStack.joined(pieces) for pieces in found.values()], np.concatenate(left)


class _Alternative(NamedTuple):
    """Parts of the first system after a shift, and the squares, energies and numbers of all systems."""

    candidate: Candidate
    stack: SystemStack
    terms: tuple[Any, ...]
    squares: list[RoundedSquare]
    numbers: Numbers

    def ordered(self, order: Sequence[int]) -> SystemStack:
        """Return the systems with the numbers of the parts in this order."""
        parts = self.candidate.parts.take(np.array(order, dtype=np.int64))
        numbers = numbers_of_parts(parts, self.squares, self.terms, self.stack.split)
        return self.stack._replace(squares=np.concatenate(numbers))


class _Model:
    """The decomposition of a first system, and of others like it."""

    def __init__(self, system: Any, choice: Any) -> None:
        self._system, self._choice, self._algebra = system, choice, system.algebra
        self._terms, self._casimirs = system.hamiltonian.terms(), quadratic_casimirs(system)
        self._number = shifted_term(self._terms)
        self._points = sample_points(system.dim)
        if choice == "auto":
            if not len(self._points):
                raise Undecided
            self._tried, self._joins = tried_candidates(system), True
        else:
            decomposition = decompose(system, choice)
            self._joins = decomposition.choice is choice
            self._tried = [Candidate(decomposition.choice.shift, decomposition.parts)]
        if not any(np.any(candidate.parts.source == COMPUTED) for candidate in self._tried):
            raise Undecided
        parts, n = [candidate.parts for candidate in fewest_parts(self._tried)], system.dim
        self.kept = max(_count(one) for one in parts)
        # Pairs of floats with errors while squares are completed, and derivatives of all parts.
        self.numbers = 20 * n**2 + len(parts) * len(parts[0]) * n * (n + len(self._points)) + self.kept * len(parts)

    def groups(self, stack: SystemStack, agreement: Agreement) -> list[tuple[Any, SystemStack]]:
        """Return the systems of a stack that decide like its first one, by what was decided otherwise."""
        if self._choice != "auto":
            (candidate,) = self._tried
            factors = {name: np.full(stack.size, factor) for name, factor in candidate.shift}
            alternative = self._alternative(stack, candidate, factors, agreement)
            chosen = alternative.ordered(range(len(candidate.parts)))
            return [((), chosen.take(np.flatnonzero(agreement.alike)))]
        shifts = self._shifts(stack, agreement)
        tried = [
            self._alternative(stack, candidate, factors, agreement)
            for candidate, factors in zip(self._tried, shifts, strict=True)
        ]
        fewest = fewest_parts(self._tried)
        alternatives = [one for one in tried if any(one.candidate is candidate for candidate in fewest)]
        best, order, orders = self._best(alternatives, agreement)
        result = []
        for b, o in sorted({*zip(best[agreement.alike].tolist(), order[agreement.alike].tolist(), strict=True)}):
            members = np.flatnonzero(agreement.alike & (best == b) & (order == o))
            if members[0] == 0:
                remember(self._system, alternatives[b].candidate, orders[b][o])
            result.append(((b, orders[b][o]), alternatives[b].ordered(orders[b][o]).take(members)))
        return result

    def _shifts(self, stack: SystemStack, agreement: Agreement) -> list[Factors]:
        """Return the factors of all systems for the shifts that were tried, as by `candidate_shifts`."""
        found: list[Factors] = [{}]
        unshifted = self._tried[0].parts
        if len(unshifted) > 1 and self._number is not None and self._casimirs:
            for rule in shift_rules(unshifted, self._casimirs):
                factors = factors_of(stack, rule, self._number)
                present = {name: agreement.decide(one != 0.0) for name, one in factors.items()}
                self._add(found, {name: one for name, one in factors.items() if present[name]}, agreement)
            if len(self._casimirs) == 1 and self._system.dim <= MAX_SINGULAR_DIMENSION:
                known = len(found)
                for name, factor in self._singular(stack, agreement):
                    self._add(found, {name: factor}, agreement, known)
        shifts = [tuple((name, float(one[0])) for name, one in factors.items()) for factors in found]
        if shifts != [(), *candidate_shifts(self._system, unshifted, self._casimirs)][: len(self._tried)]:
            raise Undecided
        return found

    def _add(self, found: list[Factors], factors: Factors, agreement: Agreement, known: int | None = None) -> None:
        """Add a shift that is not among those before, of which the first `known` count."""
        for other in found[:known]:
            if other.keys() == factors.keys():
                equal = np.ones(len(agreement.alike), dtype=bool)
                for name, values in factors.items():
                    equal &= values == other[name]
                if agreement.decide(equal):
                    return
        found.append(factors)

    def _singular(self, stack: SystemStack, agreement: Agreement) -> list[tuple[str, Floats]]:
        assert self._number is not None
        ((name, casimir),) = self._casimirs.items()
        term, n = self._terms[self._number].form, self._system.dim
        first = sum(counts_of(self._terms)[: self._number]) + n
        matrix = np.zeros((n, n, stack.size))
        matrix[term.rows, term.indices] = stack.coefficients[first : first + len(term.values)]
        C = dense_matrix(n, *casimir[1:])
        factors = joint_singular_factors(matrix, C, agreement)
        if tuple(factors[:, 0].tolist()) != singular_factors(matrix[..., 0], C):
            raise Undecided
        return [(name, factor) for factor in factors]

    def _alternative(
        self, stack: SystemStack, candidate: Candidate, factors: Factors, agreement: Agreement
    ) -> _Alternative:
        """Return the parts of all systems after a shift; keep those with parts like those of the first one."""
        shifted = ShiftedEnergies(stack, self._casimirs, factors)
        agreement.require(shifted.present == shifted.present[:, :1])
        chosen = shifted.chosen(np.arange(stack.size))
        terms = shifted_terms(self._terms, self._casimirs, candidate.shift)
        agreement.require(without_cancelling(self._algebra, terms, chosen.split))
        squares: list[RoundedSquare] = []
        if np.any(candidate.parts.source == COMPUTED):
            forms = [k for k, term in enumerate(terms) if term.form is not None]
            if len(forms) != 1 or terms[forms[0]].piece is not None:
                raise Undecided
            term, first = terms[forms[0]].form, sum(counts_of(terms)[: forms[0]])
            assert term is not None
            n, separate = self._system.dim, self._choice == "coordinates"
            linear, values = np.split(chosen.split[first : first + n + len(term.values)], [n])
            squares = squares_of_term(term, values, linear, self._algebra, separate, agreement)
        numbers = numbers_of_parts(candidate.parts, squares, terms, chosen.split)
        if self._joins:
            require_commutators(self._algebra, candidate.parts, numbers.forms, agreement)
        return _Alternative(candidate, chosen, terms, squares, numbers)

    def _best(
        self, alternatives: list[_Alternative], agreement: Agreement
    ) -> tuple[Integers, Integers, list[list[tuple[int, ...]]]]:
        """Choose alternative and order of each system as `best_decomposition`, and return the orders of each."""
        found = [self._orders(one, agreement) for one in alternatives]
        best = np.zeros(len(agreement.alike), dtype=np.int64)
        _, order, least = found[0]
        for k in range(1, len(alternatives)):
            _, other, size = found[k]
            for b in range(k):
                _require_more(alternatives[k], alternatives[b], agreement)
                _require_more(alternatives[b], alternatives[k], agreement)
            taken = size < least * IMPROVEMENT_FACTOR
            best = np.where(taken, k, best)
            order, least = np.where(taken, other, order), np.where(taken, size, least)
        return best, order, [orders for orders, _, _ in found]

    def _orders(
        self, alternative: _Alternative, agreement: Agreement
    ) -> tuple[list[tuple[int, ...]], Integers, Floats]:
        """Return orders of the parts, the best one of each system, and its h^2 term, as `best_orders`."""
        parts, members = alternative.candidate.parts, len(agreement.alike)
        natural = tuple(range(len(parts)))
        none = np.zeros(members, dtype=np.int64)
        if len(parts) < 2 or not has_hessians(self._system, self._terms):
            return [natural], none, np.zeros(members)
        sizes = self._sizes(parts, alternative.numbers)
        if len(parts) > MAX_ORDERED:
            return [natural], none, sizes([natural])[:, 0]
        if len(parts) <= MAX_PERMUTED:
            orders = list(permutations(natural))
            return orders, *_clearly_smallest(sizes(orders))
        best = natural
        while True:
            orders = [best, *neighbouring_orders(best)]
            chosen, least = _clearly_smallest(sizes(orders))
            index = int(agreement.decide(chosen))
            if not index:
                return [best], none, least
            best = orders[index]

    def _sizes(self, parts: Parts, numbers: Numbers) -> Callable[[Sequence[tuple[int, ...]]], Floats]:
        """Return a function for the sizes (members, orders) of h^2 terms."""
        members, (count, n) = numbers.forms.shape[1], self._points.shape

        def sizes(orders: Sequence[tuple[int, ...]]) -> Floats:
            step = max(1, MAX_SAMPLED // (count * n * max(len(orders), n if parts.nonlinear_shares else 1)))
            found = []
            for first in range(0, members, step):
                own = [np.ascontiguousarray(one[:, first : first + step]) for one in numbers]
                derivatives = derivatives_of_members(parts, own, self._points)
                found.append(Samples(self._algebra, derivatives, self._points).sizes(orders))
            return np.concatenate(found)

        return sizes


def _count(parts: Parts) -> int:
    return len(parts.forms.value) + len(parts.offset) + len(parts.weights.value)


def _clearly_smallest(sizes: Floats) -> tuple[Integers, Floats]:
    """Return the first clearly smallest of sizes (members, orders), and its size."""
    best, least = np.zeros(len(sizes), dtype=np.int64), sizes[:, 0]
    for k in range(1, sizes.shape[1]):
        smaller = sizes[:, k] < least * IMPROVEMENT_FACTOR
        best, least = np.where(smaller, k, best), np.where(smaller, sizes[:, k], least)
    return best, least


def _require_more(fewer: _Alternative, more: _Alternative, agreement: Agreement) -> None:
    """Keep the systems for which the angles of the first alternative are certainly not all among those of the other."""
    if len(fewer.candidate.parts.offset) >= len(more.candidate.parts.offset):
        return
    held = np.ones(len(agreement.alike), dtype=bool)
    for own in _angles(fewer):
        equal = np.zeros_like(held)
        for other in _angles(more):
            if own[0] == other[0]:
                equal |= np.all(own[1] == other[1], axis=0)
        held &= equal
    agreement.require(~held)


def _angles(one: _Alternative) -> list[tuple[Any, Floats]]:
    """Return the angles of an alternative: their coordinates, and their numbers (count, members)."""
    (forms, weights), numbers, found = (one.candidate.parts.forms, one.candidate.parts.weights), one.numbers, []
    for a in range(len(numbers.offset)):
        own, other = (slice(int(rows.start[a]), int(rows.start[a + 1])) for rows in (forms, weights))
        key = forms.coordinate[own].tolist(), weights.coordinate[other].tolist()
        found.append((key, np.concatenate([numbers.forms[own], numbers.offset[a : a + 1], numbers.weights[other]])))
    return found
