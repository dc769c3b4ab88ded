"""Pieces of the Hamiltonian of each part as polynomials, and the terms that rational rotations add to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import exact_number, fraction, rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.polynomials.monomials import Exponents
from coadjoint.algebra.polynomials.polynomial import Polynomial
from coadjoint.program.parts.part import FunctionShare, Parts, PolynomialShare
from coadjoint.program.sparse_rows import sparse_row

# Completed squares may have numerators of thousands of digits; above this size floats are used, as in a run.
MAX_BITS = 512


def part_polynomials(ring: ExactPolynomials, parts: Parts) -> list[Exact]:
    """Return the piece of the Hamiltonian of each part, whose gradient is sum_a l_a theta_a."""
    pieces = [ring.zero for _ in range(len(parts))]
    for angle, p in enumerate(parts.part_of_angle.tolist()):
        pieces[p] += _linear_angle(ring, parts, angle)
    for s, share in parts.nonlinear_shares.items():
        if isinstance(share, FunctionShare):
            raise TypeError("a part of the Hamiltonian is a function of Python, not a polynomial")
        if isinstance(share, PolynomialShare):
            pieces[int(parts.part_of_angle[parts.row[s]])] += ring.from_polynomial(share.polynomial)
    return pieces


def _linear_angle(ring: ExactPolynomials, parts: Parts, angle: int) -> Exact:
    """Return (l.x) (offset + weights.x / 2) of an angle."""
    form = linear_form(ring, *sparse_row(parts.forms, angle))
    weights = linear_form(ring, *sparse_row(parts.weights, angle))
    return form * (weights / 2 + to_rational(parts.offset[angle]))


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
    """Replace the coefficients in the pieces of parts of coordinates by those of H, without Casimirs subtracted, or by
    the polynomials `factors` in symbols. Parts not made of monomials of H are unchanged; with symbols they raise
    ValueError.
    """
    lengths, values = np.diff(parts.forms.start), parts.forms.value
    unit_forms = bool(np.all(lengths == 1) and np.all(np.asarray(values == 1, dtype=bool)))
    n = ring.dim
    replaced = []
    for piece in pieces:
        total = ring.zero
        for exponents, value in piece.to_dict().items():
            powers = tuple(map(int, exponents[:n]))
            coefficient = H.monomials.get(powers)
            matches = unit_forms and coefficient is not None and float(coefficient) == float(fraction(value))
            if powers in factors and not matches:
                raise ValueError(
                    "symbols stand for the coefficients of H, but a part is made of completed squares or shares a "
                    "monomial with another part; give M a diagonal, or parts of commuting coordinates"
                )
            if matches and coefficient is not None:
                total += ring.monomial(powers) * (factors[powers] if powers in factors else rational(coefficient))
            else:
                total += ring.monomial(powers) * value
        replaced.append(total)
    return replaced


def rational_pieces(
    ring: ExactPolynomials, parts: Parts, frequency: NDArray[Any], highest: int
) -> list[dict[int, Exact]]:
    """Return for each part {j: coefficient of h^j}, j = 3, 5, ..., added to its piece by rational rotations: they are
    the exact flow over h of K(s; h) with the derivative theta - (h w/2)^2 theta^3/3 + ..., for angles theta of s = l.x
    alone.
    """
    terms: list[dict[int, Exact]] = [{} for _ in range(len(parts))]
    share_of_angle = {
        int(parts.row[s]) + k: (share, i)
        for s, share in parts.nonlinear_shares.items()
        if isinstance(share, PolynomialShare)
        for k, i in enumerate(share.coordinates)
    }
    for angle, p in enumerate(parts.part_of_angle.tolist()):
        w = rational(frequency[angle])
        if w == 0:
            continue
        s = linear_form(ring, *sparse_row(parts.forms, angle))
        theta = _angle(ring, parts, angle, *share_of_angle.get(angle, (None, 0)))
        power = theta
        for j in range(3, highest + 1, 2):
            power = _times(_times(power, theta), theta)
            factor = (-1) ** (j // 2) * (w / 2) ** (j - 1) / j
            K = ring.zero
            for k, c in enumerate(power):
                if c != 0:
                    K += s ** (k + 1) * (c * factor / (k + 1))
            terms[p][j] = terms[p].get(j, ring.zero) + K
    return terms


def _angle(
    ring: ExactPolynomials, parts: Parts, angle: int, share: PolynomialShare | None, coordinate: int
) -> list[Any]:
    """Return the coefficients of an angle as a polynomial in its own form."""
    if share is not None:
        coefficients = [rational(0)] * share.polynomial.degree
        for exponents, value in share.polynomial.monomials.items():
            if exponents[coordinate]:
                coefficients[exponents[coordinate] - 1] += rational(value) * exponents[coordinate]
        return coefficients
    _, form = sparse_row(parts.forms, angle)
    _, weights = sparse_row(parts.weights, angle)
    slope = to_rational(weights[0]) / to_rational(form[0]) if weights else rational(0)
    return [to_rational(parts.offset[angle]), slope]


def _times(left: list[Any], right: list[Any]) -> list[Any]:
    result = [rational(0)] * (len(left) + len(right) - 1)
    for i, x in enumerate(left):
        for j, y in enumerate(right):
            result[i + j] += x * y
    return result
