"""Recorded functions as sums, by the coordinates of each summand, and as functions of polynomials."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np

from coadjoint.algebra.exact.numbers import is_finite, quotient
from coadjoint.algebra.polynomials.monomials import exponents_of
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, Polynomial
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, Term
from coadjoint.systems.hamiltonians.traced_function import (
    Graph,
    Traced,
    TracedFunction,
    TracingError,
    constant_of,
    traced,
)
from coadjoint.systems.user_functions import check_derivative

Pair = tuple[int, int]
Monomials = dict[tuple[int, ...], Any]
"""The coordinates of each monomial, with multiplicity, to its coefficient."""

MAX_MONOMIALS = 1000
"""Of a polynomial that is multiplied out."""
MAX_COORDINATES = 64  # of a function of polynomials; the search for them takes the third power of their number


class RecordedPolynomials:
    """The monomials of the recorded operations that are polynomials of the coordinates."""

    def __init__(self, recorded: TracedFunction) -> None:
        self._graph, self._n = recorded.graph, len(recorded.variables)
        self._expanded: dict[int, Monomials | None] = {}

    def monomials(self, node: int) -> Monomials | None:
        """Return the monomials of a node, or None if it is no polynomial of the coordinates, or a large one."""
        # Earlier nodes come first, so that there is no recursion.
        for index in self._graph.needed([node], self._expanded):
            found = self._expand(index)
            usable = found is not None and len(found) <= MAX_MONOMIALS and all(map(is_finite, found.values()))
            self._expanded[index] = found if usable else None
        return self._expanded[node]

    def _expand(self, index: int) -> Monomials | None:
        operation, arguments = self._graph.nodes[index]
        if operation == "variable":
            return {(index,): 1} if index < self._n else None
        if operation not in ("add", "sub", "neg", "mul", "div", "pow"):
            return None
        parts: list[Monomials | None] = [
            self._expanded[a.index] if isinstance(a, Traced) else {(): a} for a in arguments
        ]
        if any(part is None for part in parts):
            return None
        first, *others = [part for part in parts if part is not None]
        if operation == "neg":
            return {key: -value for key, value in first.items()}
        (second,) = others
        if operation in ("add", "sub"):
            total = dict(first)
            for key, value in second.items():
                total[key] = total.get(key, 0) + (value if operation == "add" else -value)
            return total
        if operation == "mul":
            return _product(first, second)
        number = constant_of(arguments[1])
        if number is None:
            return None
        if operation == "div":
            return {key: quotient(value, number) for key, value in first.items()} if number != 0 else None
        degree = max(map(len, first), default=0)
        if number != int(number) or not 0 <= number or degree * number > MAX_DEGREE:
            return None
        power: Monomials | None = {(): 1}
        for _ in range(int(number)):
            power = None if power is None else _product(power, first)
        return power


def _product(left: Monomials, right: Monomials) -> Monomials | None:
    if len(left) * len(right) > 16 * MAX_MONOMIALS:
        return None
    total: Monomials = {}
    for first, a in left.items():
        for second, b in right.items():
            key = tuple(sorted(first + second))
            total[key] = total.get(key, 0) + a * b
    return total if len(total) <= MAX_MONOMIALS and max(map(len, total), default=0) <= MAX_DEGREE else None


class NotSeparable(ValueError):
    """A summand of a function depends on coordinates that do not commute, and is no polynomial of them."""

    def __init__(self, noncommuting: Pair) -> None:
        super().__init__("a summand of a function depends on coordinates that do not commute")
        self.noncommuting = noncommuting


def separated(
    term: FunctionTerm, n: int, first_noncommuting: Callable[[Collection[int]], Pair | None]
) -> tuple[Term, ...]:
    """Return a function of n coordinates as a polynomial and functions of commuting coordinates, which add up to it."""
    # Constants and functions of the time alone are omitted. Monomials, quadratic functions, and summands of
    # noncommuting coordinates are part of the polynomial.
    recorded = traced(term.value, len(term.coordinates), term.timed)
    places = term.coordinates.tolist()
    summands = _Summands(recorded)
    total: Monomials = {}
    functions: dict[tuple[int, ...], list[tuple[Any, Traced]]] = {}
    for factor, summand in summands.collect():
        local = summands.coordinates(summand)
        coordinates = [places[k] for k in local]
        noncommuting = first_noncommuting(coordinates)
        monomials = summands.monomials(summand.index)
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
            part.add_gradients(total[None, None], x[None, None], [t])
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
        inputs = recorded.graph.inputs
        self._n = len(recorded.variables)
        self._depends: list[frozenset[int]] = []
        for index, (operation, _) in enumerate(self._nodes):
            inner = [self._depends[k] for k in inputs[index]]
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
        numbers = [constant_of(a) for a in arguments]
        if operation == "mul" and numbers != [None, None]:
            inner, scaled = (arguments[1], numbers[0]) if numbers[1] is None else (arguments[0], numbers[1])
            scaled = factor * scaled
        elif operation == "div" and numbers[1] not in (None, 0):
            inner, scaled = arguments[0], quotient(factor, numbers[1])
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
    needed = recorded.graph.needed([node.index for _, node in summands], copies)
    for index in needed:
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


class PolynomialArguments:
    """A function as F(q_1, ..., q_k, t) of polynomials q in its coordinates."""

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
        """Return the function with its gradient as one vector for each set of polynomials, which add up to it."""
        # The coordinates are repeated, once for each set.
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
    pending, seen = [recorded.result.index] if isinstance(recorded.result, Traced) else [], set[int]()
    while pending:
        index = pending.pop()
        if index in seen:
            continue
        seen.add(index)
        monomials = polynomials.monomials(index)
        if monomials is None:
            pending += recorded.graph.inputs[index]
        else:
            found[index] = monomials
    return dict(sorted(found.items()))
