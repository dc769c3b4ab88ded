"""Derivatives of coefficients of Hamiltonians by arguments of the functions that make systems."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.coefficients import Coefficients, Monomials
from coadjoint.systems.energy_derivatives import EnergyDerivative

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

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
# Entries are numbered with digits of this base, and those with the same digit change together.
BASE = 4


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
) -> tuple[EnergyDerivative, Floats]:
    """Return the derivatives of all coefficients by the entries of a parameter, and the radii of the interpolations.

    `coefficients_at` takes the changes of all entries, and is called as rarely as the coefficients allow. The radius is
    NaN for an entry near which all values are refused.
    """
    unmoved = cache(lambda: coefficients_at(np.zeros(value.shape)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sizes, largest = np.abs(value), largest_entry(value)
        radii = np.asarray(RADIUS * np.where(sizes > SMALL_ENTRY * largest, sizes, largest))
        together = _derivatives_together(coefficients_at, unmoved, radii) if value.size > 1 else None
        if together is not None:
            return EnergyDerivative.of_coefficients(value.size, [together]), radii

        def along(index: tuple[int, ...]) -> Callable[[float], Coefficients]:
            def moved(shift: float) -> Coefficients:
                shifts = np.zeros(value.shape)
                shifts[index] = shift
                return coefficients_at(shifts) if shift else unmoved()

            return moved

        pieces, radii = [], np.full(value.shape, np.nan)
        for entry, index in enumerate(np.ndindex(value.shape)):
            found = _derivatives_by_interpolation(along(index), radii_of_entry(value, index))
            if found is not None:
                derivatives, radii[index] = found
                pieces.append((np.full(derivatives.values.shape, entry), derivatives))
        return EnergyDerivative.of_coefficients(value.size, pieces), radii


def _derivatives_together(
    coefficients_at: Callable[[Floats], Coefficients], unmoved: Callable[[], Coefficients], radii: Floats
) -> tuple[Integers, Coefficients] | None:
    """Return the entry of each coefficient and its derivative by it, from samples where entries change together.

    This needs coefficients that depend on one entry each: those that change with one block of entries for each digit,
    and then take the same values as when all entries change. None if there are others, if they have no low degree, or
    values are refused.
    """
    nodes, _, _ = _chebyshev(FEW_NODES)
    changes: list[tuple[int, Coefficients]] = []
    rounds = 0
    try:
        start = unmoved()
        for blocks in _blocks(radii.size):
            changed = Monomials.joined([])
            for number, block in blocks:
                found = coefficients_at(nodes[0] * radii * block.reshape(radii.shape)).changed_from(start)
                joined = Monomials.joined([changed, found.monomials])
                if joined.size < changed.size + found.monomials.size:
                    return None
                changed = joined
                changes.append((number, found))
            rounds += 1
        samples = _Samples.of(
            lambda node: coefficients_at(node * radii) if node else start,
            1.0,
            FEW_NODES,
            [found.monomials for _, found in changes],
        )
    except (TypeError, ValueError):
        return None
    entry, count = np.zeros((2, samples.monomials.size), dtype=np.int64)
    for number, found in changes:
        at = samples.monomials.positions(found.monomials)
        if not np.array_equal(samples.table[0, at], found.values):
            return None
        entry[at] += number
        count[at] += 1
    owned, slopes = count > 0, samples.exact_slopes()
    if (
        np.any(count[owned] < rounds)
        or np.any(entry >= radii.size)
        or np.any(np.ptp(samples.table[:, ~owned], axis=0))
        or not np.isfinite(slopes).all()
    ):
        return None
    entry = entry[owned]
    return entry, Coefficients(samples.monomials.where(owned), slopes[owned] / radii.ravel()[entry])


def _blocks(count: int) -> Iterator[Iterator[tuple[int, NDArray[np.bool_]]]]:
    """Yield the blocks of entries with the same digit, for each digit of their numbers, with its value."""
    entries, place = np.arange(count), 1
    while place < count:
        digits = entries // place % BASE
        yield ((digit * place, digits == digit) for digit in range(int(digits.max()) + 1))
        place *= BASE


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
                return few.derivatives(slopes), radius
            many = _Samples.of(coefficients_at, radius, NODES)
        except (TypeError, ValueError):
            continue
        slopes, last = _slopes(many.table)
        if (error := float(np.sum(last)) / radius) < least:
            found, least = (many.derivatives(slopes), radius), error
        if np.all(last <= ZERO_DERIVATIVE * many.sizes):
            break
    return found


class _Samples(NamedTuple):
    """Values `table` (nodes, coefficients) at the nodes, which are `radius` times those of `_chebyshev`."""

    monomials: Monomials
    radius: float
    table: Floats

    @classmethod
    def of(
        cls,
        coefficients_at: Callable[[float], Coefficients],
        radius: float,
        count: int,
        further: Sequence[Monomials] = (),
    ) -> _Samples:
        nodes, _, _ = _chebyshev(count)
        samples = [coefficients_at(radius * node) for node in nodes.tolist()]
        monomials = Monomials.joined([*(sample.monomials for sample in samples), *further])
        return cls(monomials, radius, np.array([sample.at(monomials) for sample in samples]))

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

    def derivatives(self, slopes: Floats) -> Coefficients:
        return Coefficients(self.monomials, slopes / self.radius)


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
