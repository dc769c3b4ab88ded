"""Derivatives of the functions of torques by the state and by the numbers in them, from their recorded operations."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME, sample_points
from coadjoint.systems.forces.actuators import rotated
from coadjoint.systems.hamiltonians.created_arrays import with_new_arrays
from coadjoint.systems.hamiltonians.traced_function import Graph, TracingError, constant_of
from coadjoint.systems.user_functions import first_difference

Floats = NDArray[np.float64]


def _by_method(operation: str, numbers: Any) -> Any:
    """Return a function of NumPy of two arguments, of arrays of numbers and of `Traced` ones."""

    def apply(a: Any, b: Any) -> Any:
        if constant_of(a) is None:
            return getattr(a, operation)(b)
        return getattr(b, operation)(a) if constant_of(b) is None else numbers(a, b)

    return np.frompyfunc(apply, 2, 1)


def _chosen(condition: Any, one: Any, other: Any) -> Any:
    return one if condition else other  # a branch: the other value may be infinite


def _with_sign(size: Any, sign: Any) -> Any:
    return np.abs(size) * (1 - 2 * (sign < 0.0))


def _turned(c: Any, s: Any, angle: Any) -> Any:
    cosine, sine = np.cos(angle), np.sin(angle)
    return c * cosine - s * sine, s * cosine + c * sine


REPLACED = (
    (np.maximum, _by_method("maximum", np.maximum)),
    (np.minimum, _by_method("minimum", np.minimum)),
    (np.greater_equal, np.frompyfunc(operator.ge, 2, 1)),
    (np.where, np.frompyfunc(_chosen, 3, 1)),
    (np.copysign, np.frompyfunc(_with_sign, 2, 1)),
    (rotated, _turned),
)
"""Functions that NumPy computes for objects by comparing them, or not at all, and one with a loop of conditions."""


class Branch(NamedTuple):
    """The operations of a function where its conditions have some outcomes, and the entries of its results."""

    graph: Graph
    results: tuple[Any, ...]

    @property
    def numbers(self) -> Floats:
        """The floats in it, in the order of their entries."""
        return np.array([value for value in self.graph.numbers.values() if type(value) is float])

    def form(self) -> Any:
        """Return what functions with other floats have in common."""
        graph = self.graph
        numbers = {k: value if type(value) is int else None for k, value in graph.numbers.items()}
        results = [one.index if constant_of(one) is None else one for one in self.results]
        return graph.operations, graph.inputs, numbers, results, graph.conditions, graph.decided

    def entries(self, moving: Sequence[int]) -> list[int]:
        """Return the entries of some of its `numbers`; TracingError if one of them is an exponent."""
        graph = self.graph
        floats = [k for k, value in graph.numbers.items() if type(value) is float]
        found = [floats[number] for number in moving]
        powers = {k[1] for name, k in zip(graph.operations, graph.inputs, strict=True) if name == "pow"}
        if powers & {*found}:
            raise TracingError("an exponent changes with a parameter")
        return found

    def test(self) -> Callable[..., Any]:
        """Return the function that is positive where the conditions have these outcomes."""
        graph, total = self.graph, 1
        for index, outcome in zip(graph.conditions, graph.decided, strict=True):
            total = total * (graph.at(index) if outcome else 1 - graph.at(index))
        return graph.function([total], "{array}")

    def derivatives(self, moving: Sequence[int], before: int, after: int) -> list[Callable[..., Any]]:
        """Return the derivatives as `TracedLaw.derivatives`, of moving numbers among those of all branches."""
        n, graph, entries = len(self.results), self.graph, self.entries(moving)
        k = len(graph.variables)
        weights = [graph.variable(f"x[{k + i}]") for i in range(n)]
        variables = [one.index for one in graph.variables[:n]] + entries
        pulled = graph.gradient(_combined(weights, self.results), variables)
        pulled = [*pulled[:n], *[0] * before, *pulled[n:], *[0] * after]
        changes = [*weights, *(graph.variable(f"x[{k + n + before + i}]") for i in range(len(entries)))]
        pushed = graph.along(self.results, dict(zip(variables, changes, strict=True)))
        return [graph.function(one, "{array}") for one in (pulled, pushed)]


class TracedLaw(NamedTuple):
    """A function of (x) or (x, t) with n results, the first n of x the state, by its branches."""

    branches: tuple[Branch, ...]

    @property
    def timed(self) -> bool:
        """Whether it takes the time."""
        return self.branches[0].graph.timed

    @property
    def numbers(self) -> Floats:
        """The floats in all branches."""
        return np.concatenate([one.numbers for one in self.branches])

    def form(self) -> Any:
        """Return what functions with other floats have in common."""
        return [one.form() for one in self.branches]

    def derivatives(self, moving: Sequence[int]) -> list[Callable[..., Any]]:
        """Return the transposed derivative of (x, w), and the derivative of (x, v, changes of the moving numbers).

        The former has derivatives by the state, and by the moving numbers, of the sum of w times the results.
        """
        pairs, first = list[list[Callable[..., Any]]](), 0
        for one in self.branches:
            last = first + len(one.numbers)
            own = [number - first for number in moving if first <= number < last]
            before = sum(number < first for number in moving)
            pairs.append(one.derivatives(own, before, len(moving) - before - len(own)))
            first = last
        tests = [one.test() for one in self.branches[:-1]]
        return [_of_branches(tests, [pair[k] for pair in pairs], self.timed) for k in range(2)]


def _of_branches(
    tests: Sequence[Callable[..., Any]], functions: Sequence[Callable[..., Any]], timed: bool
) -> Callable[..., Any]:
    """Return the function of the first branch whose test is positive, or else the last one."""
    *others, found = functions
    for test, function in zip(reversed(tests), reversed(others), strict=True):
        found = _either(test, function, found, timed)
    return found


def _either(test: Any, one: Any, other: Any, timed: bool) -> Callable[..., Any]:
    if timed:
        return lambda x, t: one(x, t) if test(x, t)[0] > 0.5 else other(x, t)
    return lambda x: one(x) if test(x)[0] > 0.5 else other(x)


def _combined(weights: Sequence[Any], values: Sequence[Any]) -> Any:
    total: Any = 0
    for weight, value in zip(weights, values, strict=True):
        total = total + weight * value
    return total


MAX_BRANCHES = 8


def traced_law(function: Callable[..., Any], size: int, n: int, timed: bool) -> TracedLaw:
    """Record a function of (x) or (x, t) with n results, x (size,); TracingError if impossible."""
    function = getattr(function, "py_func", function)
    branches, pending = list[Branch](), [list[bool]()]
    while pending:
        if len(branches) == MAX_BRANCHES:
            raise TracingError(f"it has more than {MAX_BRANCHES} branches")
        decided = pending.pop()
        branches.append(_branch(function, size, n, timed, decided))
        made = branches[-1].graph.decided
        pending += [[*made[:k], True] for k in range(len(decided), len(made))]
    law = TracedLaw(tuple(branches))
    _compare(law, function, size, n)
    return law


def _branch(function: Callable[..., Any], size: int, n: int, timed: bool, decided: list[bool]) -> Branch:
    try:
        try:
            changed = with_new_arrays(function, lambda found: found.astype(object), REPLACED)
            graph, found = _recorded(changed, size, timed, decided)
        except (TypeError, ValueError):  # arrays of objects have fewer functions
            graph, found = _recorded(function, size, timed, decided)
        results = [graph.operand(one) for one in np.asarray(found, dtype=object).ravel().tolist()]
    except Exception as reason:  # functions of users raise anything
        raise TracingError(str(reason)) from reason
    if len(results) != n:
        raise TracingError(f"it has {len(results)} results")
    graph.folds = True
    return Branch(graph, tuple(results))


def _recorded(function: Any, size: int, timed: bool, decided: list[bool]) -> tuple[Graph, Any]:
    graph, x = Graph(size, timed, folds=False), np.empty(size, dtype=object)
    graph.decided, x[:] = decided.copy(), graph.variables
    return graph, function(x, graph.time) if timed else function(x)


def _compare(law: TracedLaw, function: Callable[..., Any], size: int, n: int) -> None:
    """Raise TracingError if the recorded operations have other values than the function, as where it tests types."""
    tests = [one.test() for one in law.branches[:-1]]
    values_of = [one.graph.function(one.results, "{array}") for one in law.branches]
    recorded, compared = _of_branches(tests, values_of, law.timed), 0

    def at(one: Callable[..., Any], x: Any, t: Any) -> Any:
        try:
            return np.asarray(one(x.copy(), t) if law.timed else one(x.copy()), dtype=np.float64).ravel()
        except (ArithmeticError, ValueError):  # outside its domain
            return np.full(n, np.nan)

    with np.errstate(all="ignore"):
        for x, t in product(sample_points(size), (SAMPLE_TIME, 0.0) if law.timed else (0.0,)):
            values = at(recorded, x, t)
            compared += bool(np.isfinite(values).all())
            if first_difference(lambda x, t: at(function, x, t), values, x, t) is not None:
                raise TracingError("it is another function where its operations are recorded")
    if not compared:
        raise TracingError("it has no finite values at sample points")
