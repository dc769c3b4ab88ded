"""Python functions as sums: the summands of a recorded function, by the coordinates that each depends on."""

from __future__ import annotations

from collections.abc import Callable, Collection
from fractions import Fraction
from typing import Any

import numpy as np

from coadjoint.algebra.exact.numbers import is_finite, quotient
from coadjoint.algebra.polynomials.monomials import exponents_of
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.systems.hamiltonians.recorded_polynomials import Monomials, RecordedPolynomials
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, Term
from coadjoint.systems.hamiltonians.traced_function import Graph, Traced, TracedFunction, TracingError, traced
from coadjoint.systems.user_functions import check_derivative

Pair = tuple[int, int]


class NotSeparable(ValueError):
    """A summand of a function depends on coordinates that do not commute, and is no polynomial of them."""

    def __init__(self, noncommuting: Pair) -> None:
        super().__init__("a summand of a function depends on coordinates that do not commute")
        self.noncommuting = noncommuting


def separated(
    term: FunctionTerm, n: int, first_noncommuting: Callable[[Collection[int]], Pair | None]
) -> tuple[Term, ...]:
    """Return a function of n coordinates as a polynomial and functions of commuting coordinates, which add up to it.

    `first_noncommuting` returns two of given coordinates that do not commute, or None. Constants and functions of the
    time alone are omitted. Monomials, quadratic functions, and summands of noncommuting coordinates are part of the
    polynomial. Raises TracingError if the function cannot be recorded, and NotSeparable.
    """
    recorded = traced(term.value, len(term.coordinates), term.timed)
    places = term.coordinates.tolist()
    summands = _Summands(recorded)
    total: Monomials = {}
    functions: dict[tuple[int, ...], list[tuple[Any, Traced]]] = {}
    for factor, summand in summands.collect():
        local = summands.coordinates(summand)
        coordinates = [places[k] for k in local]
        noncommuting = first_noncommuting(coordinates)
        monomials = summands.monomials(summand)
        simple = monomials is not None and (len(monomials) == 1 or max(map(len, monomials)) <= 2)
        if monomials is not None and (simple or noncommuting is not None):
            for key, value in monomials.items():
                placed = tuple(sorted(places[k] for k in key))
                total[placed] = total.get(placed, 0) + factor * value
        elif noncommuting is not None:
            raise NotSeparable(noncommuting)
        elif coordinates:
            functions.setdefault(local, []).append((factor, summand))
    terms: list[Term] = []
    polynomial = {exponents_of(key, n): value for key, value in total.items() if key and value != 0}
    if polynomial:
        terms.append(PolynomialTerm(Polynomial(polynomial, dim=n)))
    for local, members in _joined(functions).items():
        value, gradient, hessian, timed = _alone(recorded, local, members)
        where = np.array([places[k] for k in local], dtype=np.int64)
        terms.append(FunctionTerm(where, value, gradient, hessian, timed=timed))
    _check_sum(term, terms, n)
    return tuple(terms)


def _check_sum(term: FunctionTerm, terms: list[Term], n: int) -> None:
    """Raise TracingError if terms do not add up to a function, which may treat recorded numbers differently."""

    def gradient(y: Any, t: float = 0.0) -> Any:
        x, total = np.zeros(n), np.zeros(n)
        x[term.coordinates] = y
        for part in terms:
            if isinstance(part, FunctionTerm):
                inside = x[part.coordinates]
                total[part.coordinates] += part.gradient(inside, t) if part.timed else part.gradient(inside)
            elif isinstance(part, PolynomialTerm):
                total += part.polynomial.gradient(x)
        return total[term.coordinates]

    m = len(term.coordinates)
    try:
        names = ("a function in it", "its recorded operations")
        check_derivative(term.value, gradient, names=names, shapes=((), (m,)), n=m, timed=term.timed)
    except ValueError:
        raise TracingError("it is another function where its operations are recorded") from None


class _Summands:
    """The summands of a recorded function, their coordinates, and their monomials if they are polynomials."""

    def __init__(self, recorded: TracedFunction) -> None:
        self._nodes, self._result = recorded.graph.nodes, recorded.result
        self._n = len(recorded.variables)
        self._depends: list[frozenset[int]] = []
        for index, (operation, arguments) in enumerate(self._nodes):
            inner = [self._depends[a.index] for a in arguments if isinstance(a, Traced)]
            self._depends.append(frozenset([index]) if operation == "variable" else frozenset().union(*inner))
        self.monomials = RecordedPolynomials(recorded).monomials

    def coordinates(self, node: Traced) -> tuple[int, ...]:
        """Return the coordinates that a node depends on, sorted; the time, the last variable, is none of them."""
        return tuple(sorted(k for k in self._depends[node.index] if k < self._n))

    def collect(self) -> list[tuple[Any, Traced]]:
        """Return the summands with their factors, in the order in which they were recorded; constants are omitted."""
        if not isinstance(self._result, Traced):
            return []
        found: list[tuple[Any, Traced]] = []
        factors: dict[int, Any] = {self._result.index: 1}
        # Each node comes after all that use it, so that its factor is complete.
        for index in range(self._result.index, -1, -1):
            factor = factors.get(index, 0)
            if factor == 0 or not self._depends[index]:
                continue
            if not is_finite(factor):
                raise TracingError("it multiplies a summand by a number beyond float64")
            inner = self._inner(factor, *self._nodes[index])
            if inner is None:
                found.append((factor, Traced(self._result.graph, index)))
            for part, node in inner or ():
                if isinstance(node, Traced):
                    factors[node.index] = factors.get(node.index, 0) + part
        return found[::-1]

    @staticmethod
    def _inner(factor: Any, operation: str, arguments: tuple[Any, ...]) -> list[tuple[Any, Any]] | None:
        """Return the summands of a node with their factors, or None if it is no sum or multiple."""
        if operation in ("add", "sub"):
            return [(factor, arguments[0]), (factor if operation == "add" else -factor, arguments[1])]
        if operation == "neg":
            return [(-factor, arguments[0])]
        numbers = [a for a in arguments if not isinstance(a, Traced)]
        if operation == "mul" and numbers:
            inner, scaled = next(a for a in arguments if isinstance(a, Traced)), factor * numbers[0]
        elif operation == "div" and not isinstance(arguments[1], Traced) and arguments[1] != 0:
            inner, scaled = arguments[0], quotient(factor, arguments[1])
        else:
            return None
        return [(scaled, inner)] if is_finite(scaled) else None


def _joined(
    functions: dict[tuple[int, ...], list[tuple[Any, Traced]]],
) -> dict[tuple[int, ...], list[tuple[Any, Traced]]]:
    """Join functions of some coordinates to one of all of these and more, so that fewer are called."""
    joined: dict[tuple[int, ...], list[tuple[Any, Traced]]] = {}
    for coordinates in sorted(functions, key=lambda names: (-len(names), names)):
        larger = next((names for names in joined if set(coordinates) <= set(names)), coordinates)
        joined.setdefault(larger, []).extend(functions[coordinates])
    return joined


def _alone(
    recorded: TracedFunction, coordinates: tuple[int, ...], summands: list[tuple[Any, Traced]]
) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any] | None, bool]:
    """Return value, gradient and Hessian of a sum as functions of its coordinates, and whether they take the time."""
    n, nodes, graph = len(recorded.variables), recorded.graph.nodes, Graph()
    variables = tuple(graph.record("variable", f"x[{j}]") for j in range(len(coordinates)))
    copies: dict[int, Any] = dict(zip(coordinates, variables, strict=True))
    needed, pending = set[int](), [node.index for _, node in summands]
    while pending:
        index = pending.pop()
        if index not in needed and index not in copies:
            needed.add(index)
            pending += [a.index for a in nodes[index][1] if isinstance(a, Traced)]
    for index in sorted(needed):
        operation, arguments = nodes[index]
        copied = (copies[a.index] if isinstance(a, Traced) else a for a in arguments)
        copies[index] = graph.record(operation, *copied)
    total: Any = 0
    for factor, node in summands:
        number = float(factor) if isinstance(factor, Fraction) else factor
        total = total + number * copies[node.index]
    timed = recorded.timed and n in needed
    value, gradient, hessian = TracedFunction(graph, variables, total, timed).derivatives()
    return value, gradient, hessian, timed
