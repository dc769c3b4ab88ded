"""Steps with their derivatives: as linear maps, and of functions by complex steps or differences."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Second-order terms vanish, and products do not underflow.
COMPLEX_STEP = 2.0**-300
# Cube root of the unit round-off, for which rounding and truncation of a central difference are of equal size.
DIFFERENCE_STEP = 2.0**-17
# Largest deviation of a complex step from a difference for an analytic function; differences are more accurate.
AGREEMENT = 2.0**-20


class Derivative(NamedTuple):
    """Value and derivative of a function at a point, and the way it was computed: "complex step" or "differences"."""

    value: NDArray[np.float64]
    derivative: NDArray[np.float64]
    by: str


def derivative_of(function: Callable[[NDArray[Any]], Any], x: NDArray[np.float64]) -> Derivative:
    """Return a function (n,) -> (n,) at x with its derivative, by complex steps or else by central differences."""
    # A complex step, exact for analytic functions, is compared with a difference in one direction.
    value = np.array(function(x.copy()), dtype=np.float64)
    exact = _by_complex_steps(function, x)
    if exact is not None:
        direction = np.cos(1.0 + np.arange(len(x)))
        difference = _difference(function, x, direction)
        if np.all(np.abs(exact @ direction - difference) <= AGREEMENT * (1.0 + np.abs(exact) @ np.abs(direction))):
            return Derivative(value, exact, "complex step")
    columns = [_difference(function, x, unit) for unit in np.eye(len(x))]
    return Derivative(value, np.stack(columns, axis=1), "differences")


def _by_complex_steps(function: Callable[[NDArray[Any]], Any], x: NDArray[np.float64]) -> NDArray[np.float64] | None:
    columns = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as ComplexWarning for a discarded imaginary part
            for unit in np.eye(len(x)):
                value = np.asarray(function(x + 1j * COMPLEX_STEP * unit))
                if value.dtype.kind != "c":
                    return None
                columns.append(value.imag / COMPLEX_STEP)
    except Exception:
        return None
    return np.stack(columns, axis=1)


def _difference(
    function: Callable[[NDArray[Any]], Any], x: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    size = float(np.max(np.abs(x))) or 1.0
    h = DIFFERENCE_STEP * size
    ahead, behind = (np.asarray(function(x + side * h * direction), dtype=np.float64) for side in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * h))


class LinearizedStep(Protocol):
    """A step and its derivative at a state: `end` is the state (n,) after it."""

    @property
    def end(self) -> Floats:
        """State after the step."""

    def tangents(self, rows: Floats) -> Floats:
        """Return the tangents (k, n) after the step for those before it."""

    def cotangent(self, row: Floats) -> Floats:
        """Return the cotangent (n,) before the step for that after it."""


class DenseStep(NamedTuple):
    """A step with the matrix (n, n) of its derivative."""

    end: Floats
    matrix: Floats

    def tangents(self, rows: Floats) -> Floats:
        """Return the tangents (k, n) after the step."""
        return np.asarray((self.matrix @ rows.T).T)

    def cotangent(self, row: Floats) -> Floats:
        """Return the cotangent (n,) before the step."""
        return np.asarray(row @ self.matrix)


class JoinedSteps(NamedTuple):
    """Several steps, one after the other."""

    steps: Sequence[LinearizedStep]

    @property
    def end(self) -> Floats:
        """State after the last step."""
        return self.steps[-1].end

    def tangents(self, rows: Floats) -> Floats:
        """Return the tangents (k, n) after the step."""
        for step in self.steps:
            rows = step.tangents(rows)
        return rows

    def cotangent(self, row: Floats) -> Floats:
        """Return the cotangent (n,) before the step."""
        for step in reversed(self.steps):
            row = step.cotangent(row)
        return row
