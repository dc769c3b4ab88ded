"""Derivatives of the functions of torques by the state and by the numbers in them, from their recorded operations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.invariants.sampled_checks import SAMPLE_TIME, sample_points
from coadjoint.systems.hamiltonians.created_arrays import with_new_arrays
from coadjoint.systems.hamiltonians.traced_function import Graph, Traced, TracingError
from coadjoint.systems.user_functions import first_difference

Floats = NDArray[np.float64]


def _larger(operation: str, numbers: Any) -> Any:
    """Return a function of NumPy of two arguments, of arrays of numbers and of `Traced` ones."""

    def apply(a: Any, b: Any) -> Any:
        if isinstance(a, Traced):
            return getattr(a, operation)(b)
        return getattr(b, operation)(a) if isinstance(b, Traced) else numbers(a, b)

    return np.frompyfunc(apply, 2, 1)


REPLACED = {np.maximum: _larger("maximum", np.maximum), np.minimum: _larger("minimum", np.minimum)}
"""Functions whose results for objects NumPy finds by comparing them."""


class TracedLaw(NamedTuple):
    """A function of (x) or (x, t), x (n,), with n results: its operations, and the entries of these results."""

    graph: Graph
    results: tuple[Any, ...]

    @property
    def numbers(self) -> Floats:
        """The floats in it, in the order of their entries."""
        return np.array([value for value in self.graph.numbers.values() if isinstance(value, float)])

    def form(self) -> Any:
        """Return what functions with other floats have in common."""
        numbers = {k: value if isinstance(value, int) else None for k, value in self.graph.numbers.items()}
        results = [one.index if isinstance(one, Traced) else one for one in self.results]
        return self.graph.operations, self.graph.inputs, numbers, results

    def entries(self, moving: Sequence[int]) -> list[int] | None:
        """Return the entries of some of its `numbers`; None if one of them is an exponent."""
        graph = self.graph
        floats = [k for k, value in graph.numbers.items() if isinstance(value, float)]
        found = [floats[number] for number in moving]
        powers = {k[1] for name, k in zip(graph.operations, graph.inputs, strict=True) if name == "pow"}
        return None if powers & {*found} else found

    def derivatives(self, moving: Sequence[int]) -> tuple[Callable[..., Any], Callable[..., Any]]:
        """Return the transposed derivative of (x, w), and the derivative of (x, v, changes of the moving numbers).

        The former has derivatives by x, and by the moving numbers, of the sum of w times the results.
        """
        n, graph = len(self.results), self.graph
        entries = self.entries(moving) or []
        # Weights of the second one are no arguments: it is the derivative by them.
        weights = [graph.variable(f"x[{n + k}]") for k in range(n)]
        places = [graph.variable(f"w[{k}]") for k in range(n)]
        variables = [one.index for one in graph.variables] + entries
        pulled = graph.gradient(_combined(weights, self.results), variables)
        along = [graph.variable(f"x[{n + k}]") for k in range(n + len(entries))]
        pushed = _combined(along, graph.gradient(_combined(places, self.results), variables))
        slopes = graph.gradient(pushed, [one.index for one in places])
        return graph.function(pulled, "{array}"), graph.function(slopes, "{array}")


def _combined(weights: Sequence[Any], values: Sequence[Any]) -> Any:
    total: Any = 0
    for weight, value in zip(weights, values, strict=True):
        total = total + weight * value
    return total


def traced_law(function: Callable[..., Any], n: int, timed: bool) -> TracedLaw:
    """Record a function of (x) or (x, t) with n results; TracingError if impossible."""
    graph, x = Graph(n, timed, folds=False), np.empty(n, dtype=object)
    x[:] = graph.variables
    arguments = (x, graph.time) if timed else (x,)
    function = getattr(function, "py_func", function)
    try:
        found = _recorded(function, arguments)
    except Exception as reason:  # functions of users raise anything
        raise TracingError(str(reason)) from reason
    results = tuple(np.asarray(found, dtype=object).ravel().tolist())
    if len(results) != n:
        raise TracingError(f"it has {len(results)} results")
    graph.folds = True
    law = TracedLaw(graph, tuple(map(graph.operand, results)))
    _compare(law, function)
    return law


def _recorded(function: Any, arguments: tuple[Any, ...]) -> Any:
    try:
        return function(*arguments)
    except (TypeError, ValueError):  # of arrays of floats that it fills, and of comparisons by NumPy
        return with_new_arrays(function, lambda found: found.astype(object), REPLACED)(*arguments)


def _compare(law: TracedLaw, function: Callable[..., Any]) -> None:
    """Raise TracingError if the recorded operations have other values than the function, as where it tests types."""
    graph, n = law.graph, len(law.results)
    recorded, compared = graph.function(law.results, "{array}"), 0

    def at(one: Callable[..., Any], x: Any, t: Any) -> Any:
        try:
            return np.asarray(one(x.copy(), t) if graph.timed else one(x.copy()), dtype=np.float64).ravel()
        except (ArithmeticError, ValueError):  # outside its domain
            return np.full(n, np.nan)

    with np.errstate(all="ignore"):
        for x in sample_points(n):
            values = at(recorded, x, SAMPLE_TIME)
            compared += bool(np.isfinite(values).all())
            if first_difference(lambda x, t: at(function, x, t), values, x, SAMPLE_TIME) is not None:
                raise TracingError("it is another function where its operations are recorded")
    if not compared:
        raise TracingError("it has no finite values at sample points")
