"""Piecewise Hermite polynomials of the time, as functions for Numba whose samples are data of the machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.memory import check_available_memory
from coadjoint.systems.time_spans import Span, known_in, refuse_time, slack_of

Floats = NDArray[np.float64]
OfTime = Callable[..., Any]

DEGREES = 3, 7, 11


class Spline(NamedTuple):
    """A piecewise polynomial: ends of the pieces, (pieces + 1,), and coefficients (pieces, degree + 1, k) by powers of
    the time from the middle of a piece over its length, the constant one first.
    """

    ends: Floats
    coefficients: Floats

    @property
    def span(self) -> Span:
        return float(self.ends[0]), float(self.ends[-1])

    def functions(self) -> tuple[OfTime, OfTime, OfTime]:
        """Return the value and its first two derivatives as functions of the time."""
        # Machine code is for arrays of one shape: splines share it if the powers of two above their pieces are equal.
        pieces = len(self.coefficients)
        padding = (1 << (pieces - 1).bit_length()) - pieces
        begins = np.concatenate([self.ends[:-1], np.full(padding, np.inf)])
        middles = np.concatenate([0.5 * (self.ends[:-1] + self.ends[1:]), np.zeros(padding)])
        lengths = np.concatenate([np.diff(self.ends), np.ones(padding)])
        c = np.concatenate([self.coefficients, np.zeros((padding, *self.coefficients.shape[1:]))])
        value, first, second = _functions(begins, middles, lengths, c, *self.span, slack_of(self.span))
        return known_in(value, self.span), known_in(first, self.span), known_in(second, self.span)


def _functions(
    begins: Floats, middles: Floats, lengths: Floats, c: Floats, first: float, last: float, slack: float
) -> tuple[OfTime, OfTime, OfTime]:
    def value(t: Any) -> Any:
        if not (first - slack <= t <= last + slack):
            refuse_time(t, first, last)
        k = piece_at(begins, t)
        s, result = (t - middles[k]) / lengths[k], c[k, -1].copy()
        for power in range(c.shape[1] - 2, -1, -1):
            result = result * s + c[k, power]
        return result

    def derivative(t: Any) -> Any:
        if not (first - slack <= t <= last + slack):
            refuse_time(t, first, last)
        k = piece_at(begins, t)
        s, result = (t - middles[k]) / lengths[k], (c.shape[1] - 1) * c[k, -1]
        for power in range(c.shape[1] - 2, 0, -1):
            result = result * s + power * c[k, power]
        return result / lengths[k]

    def second_derivative(t: Any) -> Any:
        if not (first - slack <= t <= last + slack):
            refuse_time(t, first, last)
        k = piece_at(begins, t)
        s, result = (t - middles[k]) / lengths[k], (c.shape[1] - 1) * (c.shape[1] - 2) * c[k, -1]
        for power in range(c.shape[1] - 2, 1, -1):
            result = result * s + power * (power - 1) * c[k, power]
        return result / lengths[k] ** 2

    return value, derivative, second_derivative


def piece_at(begins: Any, t: Any) -> Any:
    """Return the last piece that begins at t or before, or the first one, by bisection; Numba compiles it."""
    low, high = 0, len(begins)
    while high - low > 1:
        middle = (low + high) // 2
        if begins[middle] <= t:
            low = middle
        else:
            high = middle
    return low


def hermite_spline(t: Floats, values: Floats, derivatives: Floats | None, degree: int) -> Spline:
    """Return the spline through samples (n, k) at ascending times and their derivatives; each piece takes these at the
    (degree + 1)/2 samples around it. Without derivatives these are those of polynomials through nearby samples.
    """
    # Divided differences, whose bits are the same on every machine, which those of a linear solver are not.
    n, width = len(t), values.shape[1]
    nodes = min((degree + 1) // 2, n)
    check_available_memory(8 * 3 * n * 2 * nodes * width, f"the spline of {n} samples")
    slopes = _slopes(t, values, min(2 * nodes, n - 1)) if derivatives is None else derivatives
    starts = np.clip(np.arange(n - 1) - (nodes - 1) // 2, 0, n - nodes)
    middles, lengths = 0.5 * (t[:-1] + t[1:]), np.diff(t)
    # Each node twice, with times in units of the piece.
    chosen = starts[:, None] + np.repeat(np.arange(nodes), 2)
    z = (t[chosen] - middles[:, None]) / lengths[:, None]
    table = values[chosen]
    newton = [table[:, 0]]
    for order in range(1, 2 * nodes):
        gaps = z[:, order:] - z[:, :-order]
        rows = table[:, 1:] - table[:, :-1]
        same = gaps == 0.0
        table = rows / np.where(same, 1.0, gaps)[..., None]
        if order == 1:  # the difference of a node with itself is the derivative
            table = np.where(same[..., None], lengths[:, None, None] * slopes[chosen[:, :-1]], table)
        newton.append(table[:, 0])
    c = np.zeros((n - 1, 2 * nodes, width))
    for order in range(2 * nodes - 1, -1, -1):
        c[:, 1:] = c[:, :-1] - z[:, order, None, None] * c[:, 1:]
        c[:, 0] = newton[order] - z[:, order, None] * c[:, 0]
    return Spline(t, np.ascontiguousarray(c))


def _slopes(t: Floats, values: Floats, degree: int) -> Floats:
    """Return the derivatives at samples of the polynomials of a degree through the samples around each one."""
    n, result = len(t), np.zeros_like(values)
    starts = np.clip(np.arange(n) - degree // 2, 0, n - degree - 1)
    chosen = starts[:, None] + np.arange(degree + 1)
    length = t[chosen[:, -1]] - t[chosen[:, 0]]
    z = (t[chosen] - t[:, None]) / length[:, None]
    own = np.arange(n) - starts
    # The barycentric formula: at a node, which is at z = 0 here, the derivative is a sum of differences.
    weights = np.ones((n, degree + 1))
    for j in range(degree + 1):
        for other in range(degree + 1):
            weights[:, j] *= z[:, j] - z[:, other] if other != j else 1.0
    of_own = weights[np.arange(n), own]
    for j in range(degree + 1):
        other = j != own
        factor = np.where(other, of_own / (weights[:, j] * np.where(other, z[:, j], 1.0)), 0.0)
        result += factor[:, None] * (values - values[chosen[:, j]])
    return np.asarray(result / length[:, None])
