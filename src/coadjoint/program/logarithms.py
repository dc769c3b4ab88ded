"""Logarithms of compositions of sweeps as Lie series, the same for all systems, and of one sweep in polynomials.

A forward sweep is exp(h Y1 + h^2 Y2 + ...) in free letters, a backward one its adjoint, with (-1)^(k+1) Yk. A `turn`
merges two rational rotations of one part; its difference from the two has letters of its own. H stands for
F -> sign {F, H}: flows of H_1, then H_2, map F to exp(h H_1) exp(h H_2) F, and [F, G] = sign {G, F}.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from functools import cache
from math import comb, factorial
from operator import mul
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
from coadjoint.algebra.exact.numbers import rational as to_rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.long_operations import note_progress
from coadjoint.program.sweeps import Sweep, Swept
from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.short_repr import short

BALL_BITS = 320
"""Precision (bits) of balls: 1.5 times that of the longest coefficients."""

MAX_EXACT_DIGITS = 30
"""Decimal texts with fewer digits are exact; longer ones were rounded, to half a unit in the last digit."""


class Coordinates(NamedTuple):
    """Lie series of a step: of_weight[w] maps Lyndon words of letters to nonzero `flint.fmpq` or `flint.arb`.

    `neglected`: largest coefficient dropped since an order condition holds up to rounding; `exact`: all are rational. A
    letter (k, origin) is h^k Y of a "sweep", or of the "first" or "last" part, where two sweeps meet.
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
    """Return the Lie series of P K P^-1, with `sweeps` of K and `after` of P, up to h^highest.

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
        letters = {letter: letter[0] for term in element for word in term for letter in word}
        count, scale = len(sweeps) + len(after), max([1.0, *(abs(float(s.coefficient)) for s in (*sweeps, *after))])
        of_weight: list[Mapping[Word, Any]] = [{}, {((1, "sweep"),): 1}]
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

    ball = arb(value)
    size = float(abs(ball).upper())
    return size if size <= least or ball.contains(0) else None


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
    return [{((k, origin),): coefficients[k]} if k in coefficients else {} for k in range(highest + 1)]


def _inverse(series: Series) -> Series:
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
                return arb(to_rational(midpoint)) + arb(0, arb(to_rational(half_ulp)).upper())
        return to_rational(Fraction(value))
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int | float | Fraction):
        return to_rational(value)
    raise TypeError(f"the coefficient {short(value)} of a sweep is neither a rational number nor a float")


MAX_PRODUCTS = 10**8
"""Largest number of products of monomials in all brackets: about 20 s, more with long numerators."""

WARN_PRODUCTS = MAX_PRODUCTS // 100
"""Number of products above which the remaining ones are estimated."""

SECONDS_PER_PRODUCT = 2e-7  # measured


Flow = Mapping[int, Exact]
"""Flow of sum_j h^j W_j with commuting W_j: j -> W_j. An exact flow has j = 1 alone."""


class Commutators:
    """The bracket [F, G] = sign {G, F} of polynomials; `sign` is that of x' = sign J(x) grad H(x)."""

    def __init__(self, ring: ExactPolynomials, sign: int) -> None:
        self.ring, self.sign = ring, sign
        self.spent = 0

    def __call__(self, F: Exact, G: Exact) -> Exact:
        return self.adjoint_operator(F)(G)

    def adjoint_operator(self, F: Exact) -> Callable[[Exact], Exact]:
        """Return the derivation G -> [F, G] along the field sign J(x) grad F, for many G."""
        components = enumerate(self.sign * entry for entry in self.ring.field(F))
        moving = [(i, component) for i, component in components if component != 0]

        def bracket(G: Exact) -> Exact:
            slopes = [G.derivative(i) for i, _ in moving]
            count = sum(len(slope) * len(component) for slope, (_, component) in zip(slopes, moving, strict=True))
            self.count_products(count)
            products = (component * slope for slope, (_, component) in zip(slopes, moving, strict=True) if slope != 0)
            return self.ring.truncated(_sum_in_pairs(products, self.ring.zero))

        return bracket

    def count_products(self, count: int) -> None:
        """Count the products of monomials of a bracket; raise ValueError if there are too many."""
        self.spent += count
        check_products(self.spent)
        note_progress("the brackets of a modified Hamiltonian")

    def check_cost(self, lengths: Sequence[Sequence[int]], series: Sequence[Exact]) -> None:
        """Raise ValueError if brackets of fields of these `lengths` with a series are too many."""
        slopes = [[len(term.derivative(i)) for i in range(self.ring.dim)] for term in series if term != 0]
        expected = sum(sum(map(mul, field, slope)) for field in lengths for slope in slopes)
        check_products(self.spent + expected)


def check_products(count: float) -> None:
    """Raise ValueError if brackets have too many products of monomials."""
    if count > MAX_PRODUCTS:
        raise ValueError(
            f"the brackets of a modified Hamiltonian take {count:.0e} products of monomials or more, about "
            f"{SECONDS_PER_PRODUCT * count:.0e} s, and at most {MAX_PRODUCTS:.0e} are allowed; take a lower order or "
            "a system of fewer coordinates, or measure the energy error of a run"
        )


def _sum_in_pairs(polynomials: Iterable[Exact], zero: Exact) -> Exact:
    """Add polynomials in pairs of like numbers of summands: one after the other, each sum would copy all before it."""
    sums: list[tuple[int, Exact]] = []
    for polynomial in polynomials:
        count, total = 1, polynomial
        while sums and sums[-1][0] == count:
            total = sums.pop()[1] + total
            count *= 2
        sums.append((count, total))
    total = zero
    for _, partial in reversed(sums):
        total += partial
    return total


def sweep_logarithm(commutators: Commutators, flows: Sequence[Flow], highest: int) -> list[Exact]:
    """Return Y_1, ..., Y_highest: the given flows, the first one first, are the flow of h Y_1 + h^2 Y_2 + ...

    With E(h) = exp(W(h)) ... in order, R = E' E^-1 has a plain series, and Y = log E obeys Y' = sum_k B_k/k! ad_Y^k R
    with the Bernoulli numbers B_k, B_1 = -1/2.
    """
    ring = commutators.ring
    R = [ring.zero] * highest
    lengths: list[list[list[int]]] | None = None
    for number, flow in enumerate(reversed(flows)):
        if lengths is None and commutators.spent > WARN_PRODUCTS:
            lengths = [[list(map(len, ring.field(W))) for W in remaining.values()] for remaining in reversed(flows)]
        if lengths is not None:
            commutators.check_cost([counts for remaining in lengths[number:] for counts in remaining], R[:-1])
        for j, W in flow.items():
            R = _transported(commutators.adjoint_operator(W), j, R)
        for j, W in flow.items():
            if j <= highest:
                R[j - 1] += j * W
    terms: list[Exact] = []
    adjoint_powers: list[list[Exact]] = []  # turned[k][q]: the h^q of ad_Y^k R
    for n in range(1, highest + 1):
        total = R[n - 1]
        for k in range(1, n):
            if len(adjoint_powers) < k:
                adjoint_powers.append([ring.zero] * k)
            previous = R if k == 1 else adjoint_powers[k - 2]
            sum_of_brackets = ring.zero
            for m in range(1, n - k + 1):
                factor = previous[n - 1 - m]
                if factor != 0 and terms[m - 1] != 0:
                    sum_of_brackets += commutators(terms[m - 1], factor)
            adjoint_powers[k - 1].append(sum_of_brackets)
            total += sum_of_brackets * to_rational(_bernoulli(k) / factorial(k))
        terms.append(total / n)
    return terms


def _transported(ad: Callable[[Exact], Exact], j: int, series: list[Exact]) -> list[Exact]:
    """Return exp(h^j ad) of a series in h."""
    result, current = list(series), list(series)
    for m in range(1, len(series) // j + 1):
        current = [
            ad(current[k - j]) / m if k >= j and current[k - j] != 0 else 0 * series[0] for k in range(len(series))
        ]
        result = [a + b for a, b in zip(result, current, strict=True)]
    return result


@cache
def _bernoulli(k: int) -> Fraction:
    if k == 0:
        return Fraction(1)
    return -sum((comb(k + 1, j) * _bernoulli(j) for j in range(k)), Fraction(0)) / (k + 1)
