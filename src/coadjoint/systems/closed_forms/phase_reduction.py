"""Phases over long times: whole periods and remainders without loss of digits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

PHASE_BITS = 96
"""Bits of a phase below one period."""

MAX_SWEEPS = 24  # of rotations; each squares the small entries, and some five suffice


def working_bits(t: Floats, rate: float, period: float) -> int:
    """Return the number of bits needed for phases at times t (k,), from the magnitudes of rate and period."""
    sizes = [float(np.abs(t).max(initial=0.0)), abs(rate), 1.0 / period]
    return 2 * PHASE_BITS + sum(max(0, math.frexp(size)[1]) for size in sizes if math.isfinite(size))


def remainders(
    rate: Any, period: Any, t: Floats, bits: int, jump: Any = None, jumps: Sequence[int] = ()
) -> tuple[list[int], Floats]:
    """Return the whole periods, nearest integers, in rate * t + jumps * jump for each time, and the remainders (k,)."""
    # `rate`, `jump` and `period` are `arb` of at least `working_bits`; `bits` counts fractional bits.
    rate_units, period_units = (math.floor(fraction_of(value) * 2**bits) for value in (rate, period))
    jump_units = 0 if jump is None else math.floor(fraction_of(jump) * 2**bits)
    counts, fractions = [], []
    for time, jump_count in zip(t.tolist(), jumps or [0] * t.size, strict=True):
        numerator, denominator = time.as_integer_ratio()
        phase = rate_units * numerator // denominator + jump_units * jump_count
        counts.append((2 * phase + period_units) // (2 * period_units))
        fractions.append((phase - counts[-1] * period_units) / 2**bits)
    return counts, np.array(fractions)


def fraction_of(value: Any) -> Fraction:
    """Return the midpoint of a ball as a fraction."""
    digits, exponent = value.mid().man_exp()
    return Fraction(int(digits)) * Fraction(2) ** int(exponent)


def ball(value: Fraction) -> Any:
    """Return a fraction as a ball of the current precision."""
    from flint import arb, fmpq

    return arb(fmpq(value.numerator, value.denominator))


def exact_principal_axes(M: Floats, bits: int) -> tuple[list[Fraction], list[list[Fraction]]]:
    """Return principal moments and axes (columns of a rotation) of a symmetric (3, 3) matrix by Jacobi rotations."""
    # Moments that agree to three quarters of the bits are treated as equal.
    from flint import ctx

    with ctx.workprec(bits + 32):
        A = [[ball(Fraction(v)) for v in row] for row in M.tolist()]
        Q = [[ball(Fraction(int(i == j))) for j in range(3)] for i in range(3)]
        size = max((abs(fraction_of(v)) for row in A for v in row), default=Fraction(0))
        for _ in range(MAX_SWEEPS):
            if all(abs(fraction_of(A[p][q])) <= size / 2**bits for p, q in ((0, 1), (0, 2), (1, 2))):
                break
            for p, q in ((0, 1), (0, 2), (1, 2)):
                if fraction_of(A[p][q]) != 0:
                    _jacobi_rotation(A, Q, p, q)
        moments = [fraction_of(A[i][i]) for i in range(3)]
        axes = [[fraction_of(v) for v in row] for row in Q]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if abs(moments[i] - moments[j]) <= size / 2 ** (3 * bits // 4):
            moments[j] = moments[i]
    return moments, axes


def _jacobi_rotation(A: list[list[Any]], Q: list[list[Any]], p: int, q: int) -> None:
    """Make entry (p, q) zero by a Jacobi rotation; radii of balls are discarded."""
    slope = (A[q][q] - A[p][p]) / (2 * A[p][q])
    t = 1 / (abs(slope) + (slope * slope + 1).sqrt())
    t = (-t if fraction_of(slope) < 0 else t).mid()
    c = (1 / (t * t + 1).sqrt()).mid()
    s, r = (t * c).mid(), 3 - p - q
    A[p][p], A[q][q] = (A[p][p] - t * A[p][q]).mid(), (A[q][q] + t * A[p][q]).mid()
    A[p][q] = A[q][p] = A[p][q] * 0
    new_pr, new_qr = (c * A[p][r] - s * A[q][r]).mid(), (s * A[p][r] + c * A[q][r]).mid()
    A[p][r], A[q][r], A[r][p], A[r][q] = new_pr, new_qr, new_pr, new_qr
    for row in Q:
        row[p], row[q] = (c * row[p] - s * row[q]).mid(), (s * row[p] + c * row[q]).mid()


def components_along(axes: Sequence[Sequence[Fraction]], x: Sequence[Fraction]) -> list[Fraction]:
    """Return the components of a vector along the axes."""
    return [sum((axes[i][c] * x[i] for i in range(3)), Fraction(0)) for c in range(3)]
