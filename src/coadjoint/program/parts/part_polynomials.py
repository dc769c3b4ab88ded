"""Pieces of the Hamiltonian that belong to parts, as polynomials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from coadjoint.algebra.exact.numbers import exact_number, fraction, rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.part import FunctionShare, Parts, PolynomialShare

# Completed squares may have numerators of thousands of digits; above this size floats are used, as in a run.
MAX_BITS = 512


def part_polynomials(ring: ExactPolynomials, parts: Parts) -> list[Exact]:
    """Return the piece of the Hamiltonian of each part, whose gradient is sum_a l_a theta_a.

    Raises TypeError if a part is a Python function.
    """
    found = [ring.zero for _ in range(len(parts))]
    for angle, p in enumerate(parts.part_of_angle.tolist()):
        found[p] += _linear_angle(ring, parts, angle)
    for s, share in parts.nonlinear_shares.items():
        if isinstance(share, FunctionShare):
            raise TypeError("a part of the Hamiltonian is a function of Python, not a polynomial")
        if isinstance(share, PolynomialShare):
            found[int(parts.part_of_angle[parts.row[s]])] += ring.of(share.polynomial)
    return found


def _linear_angle(ring: ExactPolynomials, parts: Parts, angle: int) -> Exact:
    """Return (l.x) (offset + weights.x / 2) of an angle."""
    form = linear_form(ring, *sparse_row(parts.forms, angle))
    weights = linear_form(ring, *sparse_row(parts.weights, angle))
    return form * (weights / 2 + to_rational(parts.offset[angle]))


def sparse_row(rows: Any, r: int) -> tuple[list[int], list[Any]]:
    """Return the coordinates and values of a sparse row."""
    entries = slice(int(rows.start[r]), int(rows.start[r + 1]))
    return rows.coordinate[entries].tolist(), rows.value[entries].tolist()


def linear_form(ring: ExactPolynomials, coordinates: list[int], values: list[Any]) -> Exact:
    """Return a linear form as a polynomial."""
    total = ring.zero
    for i, value in zip(coordinates, values, strict=True):
        total += ring.coordinates[i] * to_rational(value)
    return total


def to_rational(value: Any) -> Any:
    """Convert a number to a rational one; above `MAX_BITS` it is first rounded to float64, as in a run."""
    exact = Fraction(exact_number(value))
    long = exact.numerator.bit_length() + exact.denominator.bit_length() > MAX_BITS
    return rational(float(exact) if long else exact)


def with_hamiltonian_coefficients(
    ring: ExactPolynomials, parts: Parts, pieces: Sequence[Exact], H: Polynomial, factors: Mapping[Exponents, Exact]
) -> list[Exact]:
    """Replace the coefficients in the pieces of parts by those of H as given, or by symbols.

    H, without Casimirs subtracted, may have fractions; `factors` maps exponents of its monomials to polynomials in
    symbols. Each part must depend on coordinates, not on other linear forms. Parts not made of monomials of H are
    returned unchanged; with symbols they raise ValueError.
    """
    lengths, values = np.diff(parts.forms.start), parts.forms.value
    whole = bool(np.all(lengths == 1) and np.all(np.asarray(values == 1, dtype=bool)))
    n = ring.dim
    found = []
    for piece in pieces:
        total = ring.zero
        for exponents, value in piece.to_dict().items():
            own = tuple(map(int, exponents[:n]))
            given = H.monomials.get(own)
            same = whole and given is not None and float(given) == float(fraction(value))
            if own in factors and not same:
                raise ValueError(
                    "symbols stand for the coefficients of H, but a part is made of completed squares or shares a "
                    "monomial with another part; give M a diagonal, or parts of commuting coordinates"
                )
            if same and given is not None:
                total += ring.monomial(own) * (factors[own] if own in factors else rational(given))
            else:
                total += ring.monomial(own) * value
        found.append(total)
    return found
