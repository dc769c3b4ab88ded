"""Steps with their derivatives: as linear maps, and of functions by complex steps or differences."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import COMPLEX_STEP

Floats = NDArray[np.float64]

# Cube root of the unit round-off, for which rounding and truncation of a central difference are of equal size.
DIFFERENCE_STEP = 2.0**-17
# Largest deviation of a complex step from a difference for an analytic function; differences are more accurate.
AGREEMENT = 2.0**-20


def derivative_of(function: Callable[[NDArray[Any]], Any], x: NDArray[np.float64]) -> tuple[Floats, Floats, str]:
    """Return a function (n,) -> (n,) at x, its derivative, and how: by a "complex step", or else by "differences"."""
    # A complex step, exact for analytic functions, is compared with a difference in one direction.
    value = np.array(function(x.copy()), dtype=np.float64)
    exact = _by_complex_steps(function, x)
    if exact is not None:
        direction = np.cos(1.0 + np.arange(len(x)))
        difference = _difference(function, x, direction)
        if np.all(np.abs(exact @ direction - difference) <= AGREEMENT * (1.0 + np.abs(exact) @ np.abs(direction))):
            return value, exact, "complex step"
    columns = [_difference(function, x, unit) for unit in np.eye(len(x))]
    return value, np.stack(columns, axis=1), "differences"


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


Stages = list[tuple[Floats, Floats]]


class LinearizedStep(NamedTuple):
    """A step and its derivative: `tangents` maps (k, n) forward, `cotangent` (n,) back; `by` says how.

    Of `stages()`, pairs of a state y and a matrix (n, n), the matrix takes a change of grad H at y to that of the end.
    """

    end: Floats
    tangents: Callable[[Floats], Floats]
    cotangent: Callable[[Floats], Floats]
    by: str = "formula"
    stages: Callable[[], Stages] = list


def dense_step(end: Floats, derivative: Floats, by: str = "formula") -> LinearizedStep:
    """Return a step whose derivative is a number, a diagonal (n,), or a matrix (n, n)."""
    if derivative.ndim < 2:
        return LinearizedStep(end, lambda rows: derivative * rows, lambda row: derivative * row, by)
    return LinearizedStep(
        end, lambda rows: np.asarray((derivative @ rows.T).T), lambda row: np.asarray(row @ derivative), by
    )


def joined_steps(steps: Sequence[LinearizedStep]) -> LinearizedStep:
    """Return several steps, one after the other, as one."""

    def tangents(rows: Floats) -> Floats:
        for step in steps:
            rows = step.tangents(rows)
        return rows

    def cotangent(row: Floats) -> Floats:
        for step in reversed(steps):
            row = step.cotangent(row)
        return row

    def stages() -> Stages:
        found: Stages = []
        for step in steps:
            found = [(y, np.asarray(step.tangents(S.T).T)) for y, S in found] + step.stages()
        return found

    return LinearizedStep(steps[-1].end, tangents, cotangent, stages=stages)
