"""Checks at sample points: values and differences of functions, and whether functions are invariants."""

from __future__ import annotations

from collections.abc import Callable
from contextvars import ContextVar
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short

Floats = npt.NDArray[np.float64]

SEED = 1993  # of sample points; any other would do
SAMPLE_TIME = 0.625  # where functions of the time are evaluated: not zero, and exact in binary
MANY_COORDINATES = 1 << 16
"""Dimension above which one point is a sample."""
VALID = ContextVar("invariants that are valid by construction", default=False)
"""Whether this library makes a system, of which tests check the invariants in place of each construction."""
DIRECTIONS = 2  # along which a function is differenced at a sample point; one finds almost every error


def sample_points(n: int) -> list[npt.NDArray[np.float64]]:
    """Return seeded sample points of different kinds: mixed signs, all positive, small, and larger than one."""
    # Of many coordinates, which are a sample themselves, only the first.
    count = 1 if n > MANY_COORDINATES else 4
    draw = np.random.default_rng(SEED).uniform(0.25, 1.0, size=(count, n))
    signs = np.where(np.random.default_rng(SEED + 1).uniform(size=n) < 0.5, -1.0, 1.0)
    return [draw[0] * signs, draw[1], 0.125 * draw[2], 1.0 + 7.0 * draw[3]] if count > 1 else [draw[0] * signs]


def evaluate(
    function: Callable[..., Any], x: Any, timed: bool, *, convert: bool = True, failures: list[Exception] | None = None
) -> Any:
    """Return the value of a function at a sample point; None if it fails there, which may lie outside its domain."""
    with np.errstate(all="ignore"):
        try:
            result = function(x, SAMPLE_TIME) if timed else function(x)
            if result is None:
                raise TypeError("it returns None")
            if isinstance(result, bool | np.bool_):
                raise TypeError("it returns a truth value, as a comparison does")
            return np.asarray(result, dtype=np.float64) if convert else result
        except (ArithmeticError, ValueError, TypeError, IndexError, RuntimeError) as reason:
            if failures is not None:
                failures.append(reason)
            return None


def difference_along(
    function: Callable[..., Any],
    value: Any,
    x: Floats,
    direction: Floats,
    timed: bool = False,
    *,
    vector: bool = True,
) -> tuple[Any, float] | None:
    """Return the central difference of a function along a unit vector and its error; None if it is not finite."""
    # `value` is that at x; without `vector` the argument is the first component.
    # The difference of the central differences for steps e and e/2 estimates 3/4 of the truncation error; round-off is
    # u |f| / e. Factors 16 and 2^10 allow for higher orders and a loss of ten bits.
    step = UNIT_ROUNDOFF ** (1.0 / 3.0) * float(np.linalg.norm(x)) / np.sqrt(x.size)
    differences, size = [], np.abs(value).max(initial=0.0)
    for h in (step, 0.5 * step):
        right, left = (
            evaluate(function, end if vector else float(end[0]), timed)
            for end in (x + h * direction, x - h * direction)
        )
        if right is None or left is None:
            return None
        size = max(size, np.abs(right).max(initial=0.0), np.abs(left).max(initial=0.0))
        with np.errstate(all="ignore"):
            differences.append((right - left) / (2.0 * h))
    coarse, fine = differences
    if not (np.all(np.isfinite(coarse)) and np.all(np.isfinite(fine))):
        return None
    return fine, 16.0 * np.abs(coarse - fine).max(initial=0.0) + 2.0**10 * UNIT_ROUNDOFF * size / step


@np.errstate(all="ignore")
def rate_along(function: Callable[..., Any], x: Floats, field: Floats, sizes: Floats) -> tuple[float, float] | None:
    """Return the rate of a function of x along a field at x, by differences, and its error; None where undefined."""
    # `sizes` are the sums of the absolute products in the components of the field.
    value, length = evaluate(function, x, False), float(np.linalg.norm(field))
    if value is None or value.shape or not np.isfinite(value) or not np.isfinite(length):
        return None
    if length == 0.0:
        return 0.0, 0.0
    across = np.random.default_rng(SEED + 2).standard_normal(x.size)
    slope = difference_along(function, value, x, across / np.linalg.norm(across))
    rate = difference_along(function, value, x, field / length)
    if slope is None or rate is None:
        return None
    # Arguments and the field are rounded too. A random direction has a share n^(-1/2) of the gradient; 2^10 as above.
    gradient = x.size * (abs(float(slope[0])) + slope[1])
    rounding = UNIT_ROUNDOFF ** (2.0 / 3.0) * length + UNIT_ROUNDOFF * float(np.linalg.norm(sizes))
    return float(rate[0]) * length, rate[1] * length + 2.0**10 * gradient * rounding


def gradient_and_scale(
    name: str, invariant: Any, x: npt.NDArray[np.float64], kind: str = "Casimir"
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], int] | None:
    """Return gradient (n,) at a point, sums of its absolute products (n,), and their number; None if not finite."""
    n = x.size
    with np.errstate(all="ignore"):
        gradient, size, operations = invariant.gradient_and_size(x)
    if gradient.shape != (n,):
        raise ValueError(f"the gradient of the {kind} {short(name)} has shape {gradient.shape}; it must have ({n},)")
    if not np.all(np.isfinite(gradient)):
        return None
    return np.asarray(gradient, dtype=np.float64), np.asarray(size, dtype=np.float64), operations


@np.errstate(all="ignore")
def check_casimir(
    name: str,
    casimir: Any,
    dim: int,
    product: Callable[[Floats, Floats], Floats],
    absolute_product: Callable[[Floats, Floats], Floats],
) -> None:
    """Raise ValueError unless J(x) grad C(x), or the rate of C along J(x) w without a gradient, vanishes at samples."""
    # `product` returns J(x) u for x and u, `absolute_product` the sums of the absolute values of its terms.
    # The tolerance is u times the number of operations times the sum of absolute products in each component for
    # polynomials; gradients of an `Invariant` may lose 20 bits.
    draws = np.random.default_rng(SEED + 3).standard_normal((DIRECTIONS, dim))
    for x in sample_points(dim):
        if casimir.gradient is None:
            for w in draws:
                found = rate_along(casimir.value, x, product(x, w), absolute_product(x, np.abs(w)))
                if found is not None and abs(found[0]) > found[1]:
                    raise ValueError(
                        f"{short(name)} is not a Casimir: its rate along J(x) w is {found[0]:.3g} at a sample point, "
                        f"above {found[1]:.1g} of differences, and it must vanish for every w"
                    )
            continue
        scaled = gradient_and_scale(name, casimir, x)
        if scaled is None:
            continue
        gradient, bound, operations = scaled
        defect = np.abs(product(x, gradient))
        tolerance = operations * UNIT_ROUNDOFF * absolute_product(x, bound).max(initial=0.0)
        if defect.max(initial=0.0) > tolerance:
            i = int(np.argmax(defect))
            raise ValueError(
                f"{short(name)} is not a Casimir: component {i} of J(x) grad C(x) is {defect[i]:.3g} at a sample "
                "point, and it must vanish everywhere"
            )
