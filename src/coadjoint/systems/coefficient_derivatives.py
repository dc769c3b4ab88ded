"""Coefficients of Hamiltonians, and their derivatives by arguments of the functions that make systems."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.polynomials.monomials import factors_of
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.hamiltonians.terms import PolynomialTerm

Floats = NDArray[np.float64]
Coefficients = dict[tuple[int, ...], float]

# Nodes of the interpolation by which coefficients are differentiated, and its first radius relative to the parameter.
# The nearest pole of a reciprocal is at four radii: the truncation is 7.9^-20, and rounding is amplified by 80.
NODES = 20
RADIUS = 0.25
# Nodes, the middle one at zero, with which interpolation begins: enough if the coefficients, or their reciprocals,
# have at most the second degree in the parameter.
FEW_NODES = 5
# Smaller radii are tried where values are refused, or a pole is near.
MAX_REDUCTIONS = 6
# Entries below this part of the largest one are changed on the scale of that one first.
SMALL_ENTRY = 0.125
# Last terms of the series of such coefficients are below this multiple of their rounding.
LOW_DEGREE = 32 * UNIT_ROUNDOFF
# Changes of the coefficients below this multiple of their rounding are zero.
ZERO_DERIVATIVE = 256 * UNIT_ROUNDOFF


def coefficients_of(system: Any) -> Coefficients:
    """Return the coefficients of the monomials of H, each by its coordinates; functions of the user have none."""
    found: Coefficients = {}
    for term in system.hamiltonian.terms():
        found[()] = found.get((), 0.0) + term.constant
        if term.form is not None:
            for i, value in enumerate(term.form.linear.tolist()):
                if value:
                    found[i,] = found.get((i,), 0.0) + value
            pairs = zip(term.form.rows.tolist(), term.form.indices.tolist(), term.form.values.tolist(), strict=True)
            for i, j, value in pairs:
                if i <= j:
                    found[i, j] = found.get((i, j), 0.0) + (0.5 * value if i == j else value)
        elif isinstance(term, PolynomialTerm):
            for exponents, value in term.polynomial.monomials.items():
                key = coordinates_of(exponents)
                found[key] = found.get(key, 0.0) + float(value)
    return found


def coordinates_of(exponents: tuple[int, ...]) -> tuple[int, ...]:
    """Return the coordinates of a monomial, each as often as its exponent."""
    return tuple(factors_of(exponents))


def largest_entry(value: Floats) -> float:
    """Return the size of the largest entry, or one."""
    return float(np.max(np.abs(value))) or 1.0


def radii_of_entry(value: Floats, index: tuple[int, ...]) -> list[float]:
    """Return the radii of interpolation for an entry, in the order in which they are tried.

    Within a radius relative to a much smaller entry the coefficients change by little more than their rounding.
    """
    largest, entry = largest_entry(value), abs(float(value[index]))
    sizes = [entry] if entry > SMALL_ENTRY * largest else [largest, entry] if entry else [largest]
    return [RADIUS * size * 0.25**reduction for size in sizes for reduction in range(MAX_REDUCTIONS)]


def derivatives_by_entries(
    coefficients_at: Callable[[Floats], Coefficients], value: Floats
) -> list[tuple[Coefficients, float] | None]:
    """Return the derivatives of all coefficients by each entry of a parameter, and the radii of the interpolations.

    `coefficients_at` takes the changes of all entries, and is called as rarely as the coefficients allow. None for an
    entry near which all values are refused.
    """
    unmoved = cache(lambda: coefficients_at(np.zeros(value.shape)))
    entries, units = list(np.ndindex(value.shape)), np.eye(value.size).reshape(-1, *value.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        radii = np.reshape([radii_of_entry(value, index)[0] for index in entries], value.shape)
        separate = _derivatives_together(coefficients_at, unmoved, radii, units) if len(entries) > 1 else None
        if separate is not None:
            return list(zip(separate, radii.ravel().tolist(), strict=True))

        def along(unit: Floats) -> Callable[[float], Coefficients]:
            return lambda shift: coefficients_at(shift * unit) if shift else unmoved()

        return [
            _derivatives_by_interpolation(along(unit), radii_of_entry(value, index))
            for index, unit in zip(entries, units, strict=True)
        ]


def _derivatives_together(
    coefficients_at: Callable[[Floats], Coefficients], unmoved: Callable[[], Coefficients], radii: Floats, units: Floats
) -> list[Coefficients] | None:
    """Return the derivatives by all entries, from samples where these change together.

    This needs coefficients that depend on one entry each: those that change with it alone, and then take the same
    values as when all entries change. None if there are others, if they have no low degree, or values are refused.
    """
    nodes, _, _ = _chebyshev(FEW_NODES)
    owners: dict[tuple[int, ...], int] = {}
    alone: Coefficients = {}
    try:
        start = unmoved()
        for entry, direction in enumerate(units):
            found = coefficients_at(nodes[0] * radii * direction)
            changed = {key for key in found.keys() | start.keys() if found.get(key, 0.0) != start.get(key, 0.0)}
            if not owners.keys().isdisjoint(changed):
                return None
            owners |= dict.fromkeys(changed, entry)
            alone |= {key: found.get(key, 0.0) for key in changed}
        samples = _Samples.of(lambda node: coefficients_at(node * radii) if node else start, 1.0, FEW_NODES)
    except (TypeError, ValueError):
        return None
    if any(
        first != alone.get(key, start.get(key, 0.0)) or (key not in owners and np.ptp(column))
        for key, column, first in zip(samples.keys, samples.table.T, samples.table[0].tolist(), strict=True)
    ):
        return None
    slopes = samples.exact_slopes()
    if not np.isfinite(slopes).all():
        return None
    derivatives: list[Coefficients] = [{} for _ in units]
    for key, slope in zip(samples.keys, slopes.tolist(), strict=True):
        if key in owners:
            derivatives[owners[key]][key] = slope / radii.flat[owners[key]]
    return derivatives


def _derivatives_by_interpolation(
    coefficients_at: Callable[[float], Coefficients], radii: Iterable[float]
) -> tuple[Coefficients, float] | None:
    """Return the derivatives of all coefficients at zero, by interpolation in Chebyshev nodes, and its radius.

    The first radius decides for which no value is refused and the last terms of the series are below rounding; if there
    is none, the smallest last terms. None if all radii are refused.
    """
    found, least = None, np.inf
    for radius in radii:
        try:
            few = _Samples.of(coefficients_at, radius, FEW_NODES)
            slopes = few.exact_slopes()
            if np.isfinite(slopes).all():
                return few.by_key(slopes), radius
            many = _Samples.of(coefficients_at, radius, NODES)
        except (TypeError, ValueError):
            continue
        slopes, last = _slopes(many.table)
        if (error := float(np.sum(last)) / radius) < least:
            found, least = (many.by_key(slopes), radius), error
        if np.all(last <= ZERO_DERIVATIVE * many.sizes):
            break
    return found


class _Samples(NamedTuple):
    """Values `table` (nodes, coefficients) at the nodes, which are `radius` times those of `_chebyshev`."""

    keys: Sequence[tuple[int, ...]]
    radius: float
    table: Floats

    @classmethod
    def of(cls, coefficients_at: Callable[[float], Coefficients], radius: float, count: int) -> _Samples:
        nodes, _, _ = _chebyshev(count)
        samples = [coefficients_at(radius * node) for node in nodes.tolist()]
        keys = sorted(set().union(*samples), key=lambda key: (len(key), key))
        return cls(keys, radius, np.array([[sample.get(key, 0.0) for key in keys] for sample in samples]))

    @property
    def sizes(self) -> Floats:
        return np.asarray(np.max(np.abs(self.table), axis=0))

    def exact_slopes(self) -> Floats:
        """Return the slopes of coefficients that are polynomials of low degree, or reciprocals of some; NaN for others.

        The last two terms of their series vanish.
        """
        slopes, last = _slopes(self.table)
        curved = last > LOW_DEGREE * self.sizes
        invertible = curved & np.all(self.table != 0.0, axis=0)
        slopes[curved] = np.nan
        inverse = 1.0 / self.table[:, invertible]
        of_inverse, last = _slopes(inverse)
        of_inverse[last > LOW_DEGREE * np.max(np.abs(inverse), axis=0)] = np.nan
        slopes[invertible] = -of_inverse * self.table[FEW_NODES // 2, invertible] ** 2
        return slopes

    def by_key(self, slopes: Floats) -> Coefficients:
        return dict(zip(self.keys, (slopes / self.radius).tolist(), strict=True))


@cache
def _chebyshev(count: int) -> tuple[Floats, Floats, Floats]:
    """Return nodes, the terms of the series from values at them, and the derivative at zero."""
    nodes = np.cos((np.arange(count) + 0.5) * np.pi / count)
    if count % 2:
        nodes[count // 2] = 0.0
    series = 2.0 / count * np.cos(np.outer(np.arange(count), np.arccos(nodes)))
    orders = np.arange(1, count, 2)
    # Of odd order, T_j has the derivative j (-1)^((j - 1) / 2) at zero.
    return nodes, series, (orders * (-1.0) ** (orders // 2)) @ series[orders]


def _slopes(table: Floats) -> tuple[Floats, Floats]:
    """Return derivatives at zero of functions (nodes, functions) on [-1, 1], and the last two terms of their series."""
    nodes, series, weights = _chebyshev(len(table))
    sizes, rise, run = np.max(np.abs(table), axis=0), table[-1] - table[0], nodes[-1] - nodes[0]
    straight = table[0] + np.outer((nodes - nodes[0]) / run, rise)
    affine = np.all(np.abs(table - straight) <= 4 * UNIT_ROUNDOFF * sizes, axis=0)
    slopes = np.where(affine, rise / run, weights @ table)
    slopes[np.abs(slopes) <= ZERO_DERIVATIVE * sizes] = 0.0
    return slopes, np.sum(np.abs(series[-2:] @ table), axis=0)
