"""Polynomials through which a function of the user depends on its coordinates, found by recording it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from coadjoint.algebra.polynomials.monomials import exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.recorded_polynomials import Monomials, RecordedPolynomials
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.hamiltonians.traced_function import Traced, TracedFunction, TracingError, traced

MAX_COORDINATES = 64  # of a function; the search takes the third power of their number


class PolynomialArguments:
    """A function as F(q_1, ..., q_k, t) of polynomials q in its coordinates.

    >>> arguments = PolynomialArguments(lambda x: 1 / np.sqrt(x[0] ** 2 + x[1] ** 2) + 0.5 * x[0], 2, False)
    >>> arguments.polynomials
    (x1^2 + x2^2, 0.5*x1)
    """

    def __init__(self, value: Callable[..., Any], n: int, timed: bool) -> None:
        self._recorded = traced(value, n, timed)
        self._divided: dict[Any, tuple[Any, ...]] = {}
        by_node = _outermost(self._recorded)
        self._ends = tuple(by_node)
        self.polynomials = tuple(
            Polynomial({exponents_of(key, n): c for key, c in monomials.items() if c != 0}, dim=n)
            for monomials in by_node.values()
        )

    def divided(self, term: FunctionTerm, sets: Sequence[Sequence[int]]) -> FunctionTerm:
        """Return the function with its gradient as one vector for each set of polynomials, which add up to it.

        The coordinates are repeated, once for each set. Raise TracingError if derivatives take too many operations.
        """
        key = tuple(map(tuple, sets)), term.hessian is None
        if key not in self._divided:
            self._divided[key] = self._functions(*key)
        value, gradient, hessian = self._divided[key]
        coordinates = np.tile(term.coordinates, len(sets))
        return replace(term, coordinates=coordinates, value=value, gradient=gradient, hessian=hessian)

    def _functions(self, sets: Sequence[Sequence[int]], without_hessian: bool) -> tuple[Any, ...]:
        graph, variables, result, timed = self._recorded
        n, ends = len(variables), [Traced(graph, index) for index in self._ends]
        slopes = graph.gradient(result, ends, frozenset(self._ends))
        gradient: list[Any] = []
        for numbers in sets:
            rows = [graph.gradient(ends[k], variables) for k in numbers]
            gradient += [sum(slopes[k] * row[a] for k, row in zip(numbers, rows, strict=True)) for a in range(n)]
        value, first = self._recorded.value(), graph.function(gradient, "np.array(({0},))", timed)
        if without_hessian:
            return value, first, None
        # Derivatives by the first of the repeated coordinates.
        rest = [0] * (len(gradient) - n)
        curvatures = [entry for one in gradient for entry in (*graph.gradient(one, variables), *rest)]
        shape = (len(gradient),) * 2
        return value, first, graph.function(curvatures, f"np.array(({{0}},)).reshape({shape})", timed)


@lru_cache(maxsize=256)
def polynomial_arguments(value: Callable[..., Any], n: int, timed: bool) -> PolynomialArguments | None:
    """Return the polynomials through which a function depends on its coordinates; None if it cannot be recorded."""
    if n > MAX_COORDINATES:
        return None
    try:
        return PolynomialArguments(value, n, timed)
    except TracingError:
        return None


def _outermost(recorded: TracedFunction) -> dict[int, Monomials]:
    """Return the polynomials that other operations, or the result, take."""
    polynomials, found = RecordedPolynomials(recorded), dict[int, Monomials]()
    pending, seen = [recorded.result] if isinstance(recorded.result, Traced) else [], set[int]()
    while pending:
        node = pending.pop()
        if node.index in seen:
            continue
        seen.add(node.index)
        monomials = polynomials.monomials(node)
        if monomials is None:
            pending += [a for a in recorded.graph.nodes[node.index][1] if isinstance(a, Traced)]
        else:
            found[node.index] = monomials
    return dict(sorted(found.items()))
