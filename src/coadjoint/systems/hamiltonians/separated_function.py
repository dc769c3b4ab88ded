"""Recorded functions as sums, by the coordinates of each summand, and as functions of polynomials."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import is_finite, quotient
from coadjoint.algebra.polynomials.monomials import exponents_of
from coadjoint.algebra.polynomials.polynomial import MAX_DEGREE, Polynomial
from coadjoint.systems.hamiltonians.terms import FunctionTerm, PolynomialTerm, Term
from coadjoint.systems.hamiltonians.traced_function import Graph, TracingError, traced

Floats = NDArray[np.float64]
Pair = tuple[int, int]
Monomials = dict[tuple[int, ...], Any]
"""The coordinates of each monomial, with multiplicity, to its coefficient."""
Summands = dict[tuple[int, ...], list[tuple[Any, int]]]
"""Coordinates to summands of them, with their factors."""

MAX_MONOMIALS = 1000
"""Of a polynomial that is multiplied out."""
MAX_COORDINATES = 64  # of a function of polynomials; the search for them takes the third power of their number


def _product(left: Monomials, right: Monomials) -> Monomials | None:
    if len(left) * len(right) > 16 * MAX_MONOMIALS:
        return None
    total: Monomials = {}
    for first, a in left.items():
        for second, b in right.items():
            key = tuple(sorted(first + second))
            total[key] = total.get(key, 0) + a * b
    return total if len(total) <= MAX_MONOMIALS and max(map(len, total), default=0) <= MAX_DEGREE else None


class RecordedFunction:
    """A function of n coordinates by its recorded operations: as a sum, and as F(q_1, ..., q_k, t) of polynomials q."""

    def __init__(self, value: Callable[..., Any], n: int, timed: bool, constants: Floats | None = None) -> None:
        self.graph, self.n = traced(value, n, timed, constants=constants), n
        self.constants = constants
        self._numbers: dict[int, Any] = {**self.graph.numbers, **self.graph.fixed}
        self._last = self.graph.entry(self.graph.result)
        self._expanded: dict[int, Monomials | None] = {}
        self._divided: dict[Any, tuple[Any, ...] | None] = {}
        self.omissions: dict[Any, dict[frozenset[int], list[int]]] = {}

    @cached_property
    def _depends(self) -> list[frozenset[int]]:
        """The variables on which each entry depends."""
        found: list[frozenset[int]] = []
        for index, operation in enumerate(self.graph.operations):
            inner = (found[k] for k in self.graph.inputs[index])
            found.append(frozenset([index]) if operation == "variable" else frozenset().union(*inner))
        return found

    def coordinates(self, index: int) -> tuple[int, ...]:
        """Return the coordinates that an entry depends on, sorted; the time, the last variable, is none of them."""
        return tuple(sorted(k for k in self._depends[index] if k < self.n))

    def monomials(self, index: int) -> Monomials | None:
        """Return the monomials of an entry, or None if it is no polynomial of the coordinates, or a large one."""
        # Earlier entries come first, so that there is no recursion.
        for k in self.graph.needed([index], self._expanded):
            found = self._expand(k)
            usable = found is not None and len(found) <= MAX_MONOMIALS and all(map(_is_finite, found.values()))
            self._expanded[k] = found if usable else None
        return self._expanded[index]

    def _expand(self, index: int) -> Monomials | None:
        operation, inputs = self.graph.operations[index], self.graph.inputs[index]
        if index in self._numbers:
            return {(): self._numbers[index]}
        if operation == "variable":
            return {(index,): 1} if index < self.n else None
        parts = [part for k in inputs if (part := self._expanded[k]) is not None]
        if operation not in ("add", "sub", "neg", "mul", "div", "pow") or len(parts) < len(inputs):
            return None
        first, *others = parts
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
        number = self._numbers.get(inputs[1])
        if number is None:
            return None
        if operation == "div":
            return {key: _quotient(value, number) for key, value in first.items()} if np.all(number != 0) else None
        if np.ndim(number):
            return None
        degree = max(map(len, first), default=0)
        if number != int(number) or not 0 <= number or degree * number > MAX_DEGREE:
            return None
        power: Monomials | None = {(): 1}
        for _ in range(int(number)):
            power = None if power is None else _product(power, first)
        return power

    def summands(self) -> list[tuple[Any, int]]:
        """Return the summands with their factors, in the order in which they were recorded; constants are omitted."""
        found: list[tuple[Any, int]] = []
        factors: dict[int, Any] = {self._last: 1}
        # Each entry comes after all that use it, so that its factor is complete.
        for index in range(self._last, -1, -1):
            factor = factors.get(index, 0)
            if factor == 0 or not self._depends[index]:
                continue
            if not is_finite(factor):
                raise TracingError("it multiplies a summand by a number beyond float64")
            inner = self._inner(factor, index)
            if inner is None:
                found.append((factor, index))
            for part, k in inner or ():
                factors[k] = factors.get(k, 0) + part
        return found[::-1]

    def _inner(self, factor: Any, index: int) -> list[tuple[Any, int]] | None:
        """Return the summands of an entry with their factors, or None if it is no sum or multiple."""
        operation, inputs = self.graph.operations[index], self.graph.inputs[index]
        if operation in ("add", "sub"):
            return [(factor, inputs[0]), (factor if operation == "add" else -factor, inputs[1])]
        if operation == "neg":
            return [(-factor, inputs[0])]
        numbers: list[Any] = [self.graph.numbers.get(k) for k in inputs]
        if operation == "mul" and numbers != [None, None]:
            inner, scaled = (inputs[1], numbers[0]) if numbers[1] is None else (inputs[0], numbers[1])
            scaled = factor * scaled
        elif operation == "div" and numbers[1] not in (None, 0):
            inner, scaled = inputs[0], quotient(factor, numbers[1])
        else:
            return None
        return [(scaled, inner)] if is_finite(scaled) else None

    @cached_property
    def _ends(self) -> tuple[int, ...]:
        """The polynomials that other operations, or the result, take, in order."""
        found, pending, seen = [], [self._last], set[int]()
        while pending:
            index = pending.pop()
            if index in seen or index in self._numbers:
                continue
            seen.add(index)
            if self.monomials(index) is None:
                pending += self.graph.inputs[index]
            else:
                found.append(index)
        return tuple(sorted(found))

    def coefficients_at(self, constants: Floats) -> list[Monomials] | None:
        """Return the monomials of the polynomials q at constants (k, members), or None if these are no polynomials."""
        other = copy.copy(self)
        other._expanded, other._numbers = {}, self.graph.numbers | self.graph.fixed_at(constants)
        found = [other.monomials(index) for index in self._ends]
        return None if any(one is None for one in found) else [one for one in found if one is not None]

    @cached_property
    def polynomials(self) -> tuple[Polynomial, ...]:
        """The polynomials q."""
        return tuple(
            Polynomial({exponents_of(key, self.n): c for key, c in (self.monomials(k) or {}).items() if c}, dim=self.n)
            for k in self._ends
        )

    def divided(self, term: FunctionTerm, sets: Sequence[Sequence[int]]) -> FunctionTerm:
        """Return the function with its gradient as one vector for each set of polynomials, which add up to it."""
        # The coordinates are repeated, once for each set.
        key = tuple(map(tuple, sets)), term.hessian is None
        if key not in self._divided:
            self._divided[key] = None
            self._divided[key] = self._functions(*key)
        if (found := self._divided[key]) is None:
            raise TracingError("its derivatives take too many operations")
        value, gradient, hessian = found
        if self.constants is not None:
            made = (one and one.of_constants.make(term.constants) for one in (value, gradient, hessian))
            value, gradient, hessian = made
        coordinates = np.tile(term.coordinates, len(sets))
        return replace(term, coordinates=coordinates, value=value, gradient=gradient, hessian=hessian)

    def _functions(self, sets: Sequence[Sequence[int]], without_hessian: bool) -> tuple[Any, ...]:
        graph, n = self.graph, self.n
        variables = [one.index for one in graph.variables]
        ends = [graph.at(index) for index in self._ends]
        slopes = graph.gradient(graph.result, self._ends, frozenset(self._ends))
        gradient: list[Any] = []
        for numbers in sets:
            rows = [graph.gradient(ends[k], variables) for k in numbers]
            gradient += [sum(slopes[k] * row[a] for k, row in zip(numbers, rows, strict=True)) for a in range(n)]
        value, first = graph.value(), graph.function(gradient, "{array}")
        if without_hessian:
            return value, first, None
        # Derivatives by the first of the repeated coordinates.
        rest = [0] * (len(gradient) - n)
        curvatures = [entry for one in gradient for entry in (*graph.gradient(one, variables), *rest)]
        shape = (len(gradient),) * 2
        return value, first, graph.function(curvatures, f"{{array}}.reshape({shape})")


def _is_finite(value: Any) -> bool:
    return bool(np.isfinite(value).all()) if _of_members(value) else is_finite(value)


def _quotient(numerator: Any, denominator: Any) -> Any:
    of_members = _of_members(numerator) or _of_members(denominator)
    return numerator / denominator if of_members else quotient(numerator, denominator)


def _of_members(value: Any) -> bool:
    return bool(getattr(value, "ndim", 0))


def separated(
    term: FunctionTerm,
    n: int,
    first_noncommuting: Callable[[Collection[int]], Pair | None],
    refusal: Callable[[Pair], ValueError],
) -> tuple[Term, ...]:
    """Return a function as a polynomial and functions of commuting coordinates, which add up to it, or `refusal`."""
    # Constants and functions of the time alone are omitted. Monomials, quadratic functions, and summands of
    # noncommuting coordinates are part of the polynomial.
    recorded = RecordedFunction(term.value, len(term.coordinates), term.timed)
    places = term.coordinates.tolist()
    total: Monomials = {}
    functions: Summands = {}
    for factor, summand in recorded.summands():
        local = recorded.coordinates(summand)
        coordinates = [places[k] for k in local]
        noncommuting = first_noncommuting(coordinates)
        monomials = recorded.monomials(summand)
        simple = monomials is not None and (len(monomials) == 1 or max(map(len, monomials)) <= 2)
        if monomials is not None and (simple or noncommuting is not None):
            for key, value in monomials.items():
                placed = tuple(sorted(places[k] for k in key))
                total[placed] = total.get(placed, 0) + factor * value
        elif noncommuting is not None:
            raise refusal(noncommuting)
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
    return tuple(terms)


def _joined(functions: Summands) -> Summands:
    """Join functions of some coordinates to one of all of these and more, so that fewer are called."""
    joined: Summands = {}
    for coordinates in sorted(functions, key=lambda names: (-len(names), names)):
        larger = next((names for names in joined if set(coordinates) <= set(names)), coordinates)
        joined.setdefault(larger, []).extend(functions[coordinates])
    return joined


def _alone(
    recorded: RecordedFunction, coordinates: tuple[int, ...], summands: list[tuple[Any, int]]
) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any] | None, bool]:
    """Return value, gradient and Hessian of a sum as functions of its coordinates, and whether they take the time."""
    source = recorded.graph
    needed = source.needed([index for _, index in summands], {*coordinates, *source.numbers})
    timed = source.timed and recorded.n in needed
    graph = Graph(len(coordinates), timed)
    copies: dict[int, Any] = dict(zip(coordinates, graph.variables, strict=True)) | source.numbers
    for index in needed:
        inputs = [copies[k] for k in source.inputs[index]]
        copies[index] = graph.record(source.operations[index], *inputs) if inputs else graph.time
    for factor, index in summands:
        number = float(factor) if isinstance(factor, Fraction) else factor
        graph.result = graph.result + number * copies[index]
    value, gradient, hessian = graph.derivatives()
    return value, gradient, hessian, timed


@lru_cache(maxsize=256)
def recorded_function(value: Callable[..., Any], n: int, timed: bool) -> RecordedFunction | None:
    """Return a function by its recorded operations; None if it cannot be recorded, or has many coordinates."""
    try:
        return RecordedFunction(value, n, timed) if n <= MAX_COORDINATES else None
    except TracingError:
        return None


@lru_cache(maxsize=64)
def recorded_for_constants(function: Callable[..., Any], n: int, pattern: bytes) -> RecordedFunction | None:
    """Return a function of (y, c) by its recorded operations, for all c of this pattern; None as above."""
    first = np.frombuffer(pattern, dtype=np.int64)
    # No products of these numbers cancel by chance.
    constants = np.where(first < 0, 0.0, 1.5 + 0.5 * np.cos(1.0 + first))
    try:
        return RecordedFunction(function, n, False, constants) if n <= MAX_COORDINATES else None
    except TracingError:
        return None
