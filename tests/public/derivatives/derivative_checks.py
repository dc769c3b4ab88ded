"""Derivatives of a prepared run, compared with each other and with differences of whole runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

import coadjoint as co
from rounding import UNIT_ROUNDOFF

WEIGHTS = (2 / 3, -1 / 12)
DISTANCE = 2.0**-11
"""So small that neither the choice of the parts nor the number of crossings changes."""
ADJOINT_ERROR = 2.0**12 * UNIT_ROUNDOFF
DIFFERENCE_ERROR = 2.0**12 * UNIT_ROUNDOFF / DISTANCE
"""Rounding of some hundred flows of size one over the distance; truncation, 2^-49 fifth derivatives, is below it."""


def difference(function: Callable[[float], Any], distance: float = DISTANCE) -> Any:
    """Return the derivative at zero of a function of a number, by central differences of order 4."""
    return sum(w * (function(k * distance) - function(-k * distance)) for k, w in enumerate(WEIGHTS, 1)) / distance


def outputs(result: Any) -> dict[str, np.ndarray]:
    """Return the arrays of a solution, or of tangents, by name."""
    found = {name: getattr(result, name) for name in ("x", "energy", "attitude")}
    events = result.events
    if events is not None:
        events = events if isinstance(events, dict) else {name: getattr(events, name) for name in ("t", "x")}
        found |= {f"events {name}": value for name, value in events.items()}
    return {name: value for name, value in found.items() if value is not None}


def pulled(pullback: Any, weights: Mapping[str, np.ndarray]) -> Any:
    """Return the gradient for the cotangents of all outputs."""
    given: dict[str, Any] = {name: w for name, w in weights.items() if not name.startswith("events ")}
    events = {name.removeprefix("events "): w for name, w in weights.items() if name.startswith("events ")}
    return pullback(**given, **({"events": events} if events else {}))


def real_sum(first: Any, second: Any) -> float:
    return float(np.sum(np.real(np.conj(first) * second)))


def weighted(weights: Mapping[str, np.ndarray], found: Mapping[str, np.ndarray]) -> float:
    """Return the sum of weights times outputs; members that have ended, with NaN, have the weight zero."""
    return sum(real_sum(w, np.where(w == 0.0, 0.0, found[name])) for name, w in weights.items())


def assert_derivatives(
    build: Callable[[dict[str, Any]], Any],
    method: Any,
    x0: Any,
    span: Sequence[float],
    step: float = 0.05,
    *,
    inputs: Mapping[str, Any] | None = None,
    values: Mapping[str, Any] | None = None,
    attitude: Any = False,
    draw: Callable[[np.random.Generator], Any] | None = None,
    error: float = DIFFERENCE_ERROR,
    **points: Any,
) -> Any:
    """Compare the gradient of a random sum of all outputs with tangents and with differences; return it.

    `build` returns the system for changed values of parameters. Parameters whose rule is an added part are those of
    another map than the one of the run, so that only gradients and tangents are compared. `values` are those of the
    inputs, and `draw` returns directions in the space of the states.
    """
    rng = np.random.default_rng(7)
    given, options = {**points, **(values or {})}, {"attitude": attitude} | ({"inputs": inputs} if inputs else {})
    ready = co.prepare(build({}), method, step, **options)
    sol, pullback = ready.vjp(x0, span, **given)
    series, plain = outputs(sol), outputs(ready.run(x0, span, **given))
    assert all(np.array_equal(one, plain[name], equal_nan=True) for name, one in series.items())
    weights = {name: np.where(np.isfinite(one), rng.standard_normal(one.shape), 0.0) for name, one in series.items()}
    if draw is not None:
        weights["x"] = np.array([draw(rng) for _ in sol.x]).reshape(sol.x.shape)
    gradient = pulled(pullback, weights)
    dx0 = rng.standard_normal(np.shape(x0)) if draw is None else draw(rng)
    directions = {"x0": dx0} | {name: rng.standard_normal(value.shape) for name, value in ready.parameters.items()}
    # Metrics of dampings along orbits, and of energies, stay symmetric.
    directions |= {k: v + v.T for k, v in directions.items() if k.endswith(("metric", "M")) and v.ndim == 2}
    of_inputs = {name: rng.standard_normal(np.shape(value)) for name, value in (values or {}).items()}

    def products(names: Any) -> np.ndarray:
        found = [np.real(np.conj(gradient[name]) * directions[name]).ravel() for name in names]
        found += [(gradient["inputs"][name] * d).ravel() for name, d in of_inputs.items()]
        return np.concatenate(found)

    along = directions | ({"inputs": of_inputs} if of_inputs else {})
    followed, tangents = ready.jvp(x0, span, along, **given)
    assert all(np.array_equal(one, series[name], equal_nan=True) for name, one in outputs(followed).items())
    assert tangents.rule == gradient.rule and set(gradient) - {"attitude0"} == set(along)
    both = products(directions)
    assert abs(both.sum() - weighted(weights, outputs(tangents))) <= ADJOINT_ERROR * np.abs(both).sum()
    moving = [name for name in directions if gradient.rule.get(name) != "added part"]

    def moved(by: float) -> float:
        parameters = {name: ready.parameters[name] + by * directions[name] for name in moving if name != "x0"}
        other = co.prepare(build(parameters), method, step, **options)
        at = given | {name: values[name] + by * d for name, d in of_inputs.items()}
        return weighted(weights, outputs(other.run(x0 + by * dx0, span, **at)))

    same_map = products(moving)
    assert abs(same_map.sum() - difference(moved)) <= error * np.abs(same_map).sum()
    return gradient
