"""Polynomials through which a function of the user depends on its coordinates, found by recording it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.terms import FunctionTerm
from coadjoint.systems.hamiltonians.traced_function import Graph, Traced, TracingError, recorded

MAX_COORDINATES = 64
MAX_DEGREE = 8
MAX_MONOMIALS = 256


class PolynomialArguments:
    """A function as F(q_1, ..., q_k, t) of polynomials q in its coordinates.

    >>> arguments = PolynomialArguments(lambda x: 1 / np.sqrt(x[0] ** 2 + x[1] ** 2) + 0.5 * x[0], 2, False)
    >>> arguments.polynomials
    (x1^2 + x2^2, 1/2*x1)
    """

    def __init__(self, value: Callable[..., Any], n: int, timed: bool) -> None:
        self._graph, self._variables, self._result = recorded(value, n, timed)
        self._timed = timed
        self._separated: dict[Any, tuple[Any, ...]] = {}
        by_node = _polynomials_of(self._graph, self._variables, self._result)
        self._ends = _outermost(self._graph, self._result, by_node)
        self.polynomials = tuple(Polynomial(by_node[index], dim=n) for index in self._ends)

    def separated(self, term: FunctionTerm, sets: Sequence[Sequence[int]]) -> FunctionTerm:
        """Return the function with its gradient as one vector for each set of polynomials, which add up to it.

        The coordinates are repeated, once for each set. Raise TracingError if derivatives take too many operations.
        """
        key = tuple(map(tuple, sets)), term.hessian is None
        if key not in self._separated:
            self._separated[key] = self._functions(*key)
        value, gradient, hessian = self._separated[key]
        coordinates = np.tile(term.coordinates, len(sets))
        return replace(term, coordinates=coordinates, value=value, gradient=gradient, hessian=hessian)

    def _functions(self, sets: Sequence[Sequence[int]], without_hessian: bool) -> tuple[Any, ...]:
        graph, variables, n = self._graph, self._variables, len(self._variables)
        ends = [Traced(graph, index) for index in self._ends]
        slopes = graph.gradient(self._result, ends, frozenset(self._ends))
        gradient: list[Any] = []
        for numbers in sets:
            rows = [graph.gradient(ends[k], variables) for k in numbers]
            gradient += [sum(slopes[k] * row[a] for k, row in zip(numbers, rows, strict=True)) for a in range(n)]
        value = graph.function([self._result], "{0}", self._timed)
        first = graph.function(gradient, "np.array(({0},))", self._timed)
        if without_hessian:
            return value, first, None
        # Derivatives by the first of the repeated coordinates.
        rest = [0] * (len(gradient) - n)
        curvatures = [entry for one in gradient for entry in (*graph.gradient(one, variables), *rest)]
        shape = (len(gradient),) * 2
        return value, first, graph.function(curvatures, f"np.array(({{0}},)).reshape({shape})", self._timed)


@lru_cache(maxsize=256)
def polynomial_arguments(value: Callable[..., Any], n: int, timed: bool) -> PolynomialArguments | None:
    """Return the polynomials through which a function depends on its coordinates; None if it cannot be recorded."""
    if n > MAX_COORDINATES:
        return None
    try:
        return PolynomialArguments(value, n, timed)
    except TracingError:
        return None


def _polynomials_of(graph: Graph, variables: Sequence[Traced], result: Any) -> dict[int, dict[Any, Fraction]]:
    """Return the recorded operations that are polynomials, as monomials."""
    n = len(variables)
    found: dict[int, dict[Any, Fraction]] = {
        variable.index: {tuple(int(a == k) for a in range(n)): Fraction(1)} for k, variable in enumerate(variables)
    }
    last = result.index if isinstance(result, Traced) else -1
    for index in range(last + 1):
        operation, arguments = graph.nodes[index]
        if index in found or operation == "variable":
            continue
        operands = [
            found.get(a.index) if isinstance(a, Traced) else {(0,) * n: Fraction(a)} if a else {} for a in arguments
        ]
        if any(operand is None for operand in operands):
            continue
        polynomial = _combined(operation, operands, arguments)
        if polynomial is not None and len(polynomial) <= MAX_MONOMIALS:
            found[index] = polynomial
    return found


def _combined(operation: str, operands: Sequence[Any], arguments: Sequence[Any]) -> dict[Any, Fraction] | None:
    a, b = operands[0], operands[-1]
    if operation == "neg":
        return {e: -c for e, c in a.items()}
    if operation in ("add", "sub"):
        total = dict(a)
        for e, c in b.items():
            total[e] = total.get(e, Fraction(0)) + (c if operation == "add" else -c)
        return {e: c for e, c in total.items() if c}
    if operation == "mul":
        return _product(a, b)
    if operation == "div" and not isinstance(arguments[1], Traced) and arguments[1]:
        return {e: c / Fraction(arguments[1]) for e, c in a.items()}
    if operation == "pow" and not isinstance(arguments[1], Traced) and arguments[1] in range(1, MAX_DEGREE + 1):
        power: dict[Any, Fraction] | None = a
        for _ in range(int(arguments[1]) - 1):
            power = None if power is None else _product(power, a)
        return power
    return None


def _product(a: dict[Any, Fraction], b: dict[Any, Fraction]) -> dict[Any, Fraction] | None:
    if len(a) * len(b) > MAX_MONOMIALS:
        return None
    total: dict[Any, Fraction] = {}
    for e, c in a.items():
        for f, d in b.items():
            powers = tuple(p + q for p, q in zip(e, f, strict=True))
            if sum(powers) > MAX_DEGREE:
                return None
            total[powers] = total.get(powers, Fraction(0)) + c * d
    return {e: c for e, c in total.items() if c}


def _outermost(graph: Graph, result: Any, polynomials: dict[int, Any]) -> tuple[int, ...]:
    """Return the polynomials that other operations, or the result, take."""
    if not isinstance(result, Traced):
        return ()
    found, pending, seen = set[int](), [result.index], set[int]()
    while pending:
        index = pending.pop()
        if index in seen:
            continue
        seen.add(index)
        if index in polynomials:
            found.add(index)
        else:
            pending += [a.index for a in graph.nodes[index][1] if isinstance(a, Traced)]
    return tuple(sorted(found))
