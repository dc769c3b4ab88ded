"""Logarithm of a composition of sweeps as a Lie series, the same for all systems.

A forward sweep over the step h is exp(h Y1 + h^2 Y2 + ...) with free letters Y1, Y2, ...; a backward one is its
adjoint, with (-1)^(k+1) Yk. A `turn` merges two adjacent rational rotations of one part into one. The merged rotation
differs from the two separate ones, and the difference has letters of its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from coadjoint.algebra.exact.free_algebra import (
    Series,
    Word,
    add_series,
    exponential,
    lie_coordinates,
    logarithm,
    lyndon_words,
    product,
    unit_series,
)
from coadjoint.algebra.exact.numbers import rational as rational_number
from coadjoint.program.sweeps import Sweep, Swept
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short

BALL_BITS = 320
"""Precision (bits) of balls: 1.5 times that of the longest coefficients."""

MAX_EXACT_DIGITS = 30
"""Decimal texts with fewer digits are exact; longer ones were rounded, to half a unit in the last digit."""


class Letter(NamedTuple):
    """A letter h^weight Y: of a sweep, or of the first or last part where two sweeps meet."""

    weight: int
    origin: str = "sweep"


class Coordinates(NamedTuple):
    """Lie series of a step: of_weight[w] maps Lyndon words of `Letter` to nonzero `flint.fmpq` or `flint.arb`;
    `neglected` is the largest coefficient set to zero because an order condition holds only up to rounding; `exact`:
    all are rational.
    """

    of_weight: tuple[Mapping[Word, Any], ...]
    neglected: float
    exact: bool

    @property
    def leading(self) -> int | None:
        """The smallest weight above 1 with a nonzero coefficient; None if there is none."""
        return next((w for w, terms in enumerate(self.of_weight) if w > 1 and terms), None)


def composition_logarithm(
    sweeps: Sequence[Sweep],
    after: Sequence[Sweep],
    highest: int,
    *,
    order: int = 1,
    parts: int = 2,
    rational: bool = False,
) -> Coordinates:
    """Return the Lie series of one step P K P^-1, with the `sweeps` of K and `after` of P, up to h^highest.
    Coefficients of order conditions that vanish up to rounding are zero. With `rational`, two flows of one part are not
    its flow over the sum.
    """
    from flint import ctx, fmpq

    single_part = parts == 1
    with ctx.workprec(BALL_BITS):
        series = _sweep_product(sweeps, highest, single_part, rational)
        if after:
            processor = _sweep_product(after, highest, single_part, rational)
            series = product(product(_inverse(processor), series), processor)
        element = logarithm(series)
        letters = {letter: letter.weight for term in element for word in term for letter in word}
        count, scale = len(sweeps) + len(after), max([1.0, *(abs(float(s.coefficient)) for s in (*sweeps, *after))])
        of_weight: list[Mapping[Word, Any]] = [{}, {(Letter(1),): 1}]
        neglected, exact = 0.0, True
        for weight in range(2, highest + 1):
            # Rounding of the coefficients changes a condition by u times the sum of its terms.
            least = UNIT_ROUNDOFF * 8 * count * scale**weight if weight <= order else 0.0
            coefficients, rest = lie_coordinates(element[weight], lyndon_words(letters, weight))
            assert all(_size_if_zero(value, 0.0) is not None for value in rest.values()), "the series is no Lie series"
            nonzero = {}
            for word, value in coefficients.items():
                size = _size_if_zero(value, least)
                if size is None:
                    nonzero[word], exact = value, exact and isinstance(value, fmpq)
                else:
                    neglected = max(neglected, size)
            of_weight.append(nonzero)
    return Coordinates(tuple(of_weight), neglected, exact)


def _size_if_zero(value: Any, least: float) -> float | None:
    """Return an upper bound of a number that counts as zero, and None for any other."""
    from flint import arb

    size = float(
        abs(value).upper() if isinstance(value, arb) else abs(Fraction(int(value.numer()), int(value.denom())))
    )
    zero = size <= least or (isinstance(value, arb) and value.contains(0))
    return size if zero else None


def _sweep_product(sweeps: Sequence[Sweep], highest: int, single_part: bool, rational: bool) -> Series:
    result = unit_series(highest)
    flow_time: Any = 0  # total time of the flow of the part at which the previous sweep ended
    previous: Sweep | None = None
    for sweep in sweeps:
        c = sweep.coefficient
        merges = previous is not None and sweep.turn and (single_part or previous.forward != sweep.forward)
        if rational and merges and previous is not None:
            origin = "last" if single_part or previous.forward else "first"
            difference = {k: (flow_time + c) ** k - flow_time**k - c**k for k in range(3, highest + 1, 2)}
            result = product(result, exponential(_letters(difference, origin, highest)))
        sign = 1 if sweep.forward else -1
        result = product(
            result, exponential(_letters({k: sign * (sign * c) ** k for k in range(1, highest + 1)}, "sweep", highest))
        )
        flow_time, previous = (flow_time + c if merges and single_part else c), sweep
    return result


def _letters(coefficients: Mapping[int, Any], origin: str, highest: int) -> Series:
    return [{(Letter(k, origin),): coefficients[k]} if k in coefficients else {} for k in range(highest + 1)]


def _inverse(series: Series) -> Series:
    """Invert a series: 1/(1 + r) = 1 - r + r^2 - ..."""
    remainder: Series = [{}, *({word: -value for word, value in term.items()} for term in series[1:])]
    result = power = unit_series(len(series) - 1)
    for _ in series[1:]:
        power = product(power, remainder)
        result = add_series(result, power)
    return result


def exact_sweeps(method: Swept) -> tuple[list[Sweep], list[Sweep]]:
    """Return the sweeps and the processor of a scheme, with rational coefficients, or balls if irrational."""
    from flint import ctx

    with ctx.workprec(BALL_BITS):
        try:
            return _sweeps_in(method, exact_or_ball)
        except (TypeError, ValueError, ZeroDivisionError):
            from flint import arb

            return _sweeps_in(method, lambda value: arb(exact_or_ball(value)))


def _sweeps_in(method: Swept, number: Callable[[Any], Any]) -> tuple[list[Sweep], list[Sweep]]:
    result = []
    for sweeps in (method.sweeps(number), method.processor(number)):
        result.append([sweep._replace(coefficient=exact_or_ball(sweep.coefficient), moment=0) for sweep in sweeps])
    return result[0], result[1]


def exact_or_ball(value: Any) -> Any:
    """Convert a coefficient to `flint.fmpq` if exact, else to a ball (`flint.arb`) that contains it."""
    from flint import arb, ctx, fmpq

    if isinstance(value, fmpq | arb):
        return value
    if isinstance(value, str):
        match = re.fullmatch(r"\s*[+-]?(\d*)\.?(\d*)\s*", value)
        if match and len((match[1] + match[2]).lstrip("0")) >= MAX_EXACT_DIGITS:
            midpoint = Fraction(value)
            half_ulp = Fraction(1, 2 * 10 ** len(match[2]))
            with ctx.workprec(BALL_BITS):
                return arb(rational_number(midpoint)) + arb(0, arb(rational_number(half_ulp)).upper())
        return rational_number(Fraction(value))
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int | float | Fraction):
        return rational_number(value)
    raise TypeError(f"the coefficient {short(value)} of a sweep is neither a rational number nor a float")
