"""The derivative of a step that is a function: by complex steps, or by differences."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

# With so small a step terms of second order vanish, and its products do not underflow.
COMPLEX_STEP = 2.0**-300
# The cube root of the unit round-off. Rounding and truncation of a central difference are then of one size.
DIFFERENCE = 2.0**-17
# A difference shows that a step is no analytic function of x. The error of the difference is at least this.
AGREEMENT = 2.0**-20


class Derivative(NamedTuple):
    """A function and its derivative at a point, and how that was found: "complex step" or "differences"."""

    value: NDArray[np.float64]
    derivative: NDArray[np.float64]
    by: str


def derivative_of(function: Callable[[NDArray[Any]], Any], x: NDArray[np.float64]) -> Derivative:
    """Return a function at x with its derivative.

    A complex step is exact to round-off where the function is analytic and written for complex numbers. In one
    direction it is compared with a difference. Where it cannot be taken, or differs, central differences are taken,
    with some nine digits.

    Parameters
    ----------
    function : callable
        (n,) -> (n,)
    x : ndarray, shape (n,)
        The point.

    Returns
    -------
    Derivative

    Examples
    --------
    >>> import numpy as np
    >>> found = derivative_of(lambda x: np.array([x[0] * x[1], x[1] ** 2]), np.array([2.0, 3.0]))
    >>> found.by, found.derivative.tolist()
    ('complex step', [[3.0, 2.0], [0.0, 6.0]])
    >>> derivative_of(lambda x: abs(x) * x, np.array([2.0, -3.0])).by
    'differences'
    """
    value = np.array(function(x.copy()), dtype=np.float64)
    exact = _by_complex_steps(function, x)
    if exact is not None:
        direction = np.cos(1.0 + np.arange(len(x)))
        seen = _difference(function, x, direction)
        if np.all(np.abs(exact @ direction - seen) <= AGREEMENT * (1.0 + np.abs(exact) @ np.abs(direction))):
            return Derivative(value, exact, "complex step")
    columns = [_difference(function, x, unit) for unit in np.eye(len(x))]
    return Derivative(value, np.stack(columns, axis=1), "differences")


def _by_complex_steps(function: Callable[[NDArray[Any]], Any], x: NDArray[np.float64]) -> NDArray[np.float64] | None:
    columns = []
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as a part that is discarded
            for unit in np.eye(len(x)):
                moved = np.asarray(function(x + 1j * COMPLEX_STEP * unit))
                if moved.dtype.kind != "c":
                    return None
                columns.append(moved.imag / COMPLEX_STEP)
    except Exception:
        return None
    return np.stack(columns, axis=1)


def _difference(
    function: Callable[[NDArray[Any]], Any], x: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    size = float(np.max(np.abs(x))) or 1.0
    h = DIFFERENCE * size
    ahead, behind = (np.asarray(function(x + side * h * direction), dtype=np.float64) for side in (1.0, -1.0))
    return np.asarray((ahead - behind) / (2.0 * h))
