"""Which polynomial is the piece of the Hamiltonian that belongs to a part?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from coadjoint.algebra.exact import exact_number, fraction, rational
from coadjoint.algebra.exact_polynomials import Exact, ExactPolynomials
from coadjoint.algebra.monomials import Exponents
from coadjoint.algebra.polynomial import Polynomial
from coadjoint.program.parts import FunctionShare, Parts, PolynomialShare

# A completed square may have numerators of thousands of digits. Then the floats are taken, as in a run.
MOST_BITS = 512


def part_polynomials(ring: ExactPolynomials, parts: Parts) -> list[Exact]:
    """Return the pieces of the Hamiltonian that belong to parts, as polynomials.

    Parameters
    ----------
    ring : ExactPolynomials
        On the dual of the algebra.
    parts : Parts
        Their forms l_a and angle rules.

    Returns
    -------
    list of fmpq_mpoly
        One for each part; its gradient is sum_a l_a theta_a.

    Raises
    ------
    TypeError
        If a part is a function of Python.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.program.split import split
    >>> top = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.25], linear=[0.0, 3.0, 0.0]))
    >>> ring = ExactPolynomials(top.algebra)
    >>> [ring.polynomial(piece) for piece in part_polynomials(ring, split(top, "coordinates"))]
    [(1/2)*x1^2, 3*x2 + (1/4)*x2^2, (1/8)*x3^2]
    """
    found = [ring.zero for _ in range(len(parts))]
    for angle, p in enumerate(parts.part_of_angle.tolist()):
        found[p] += _linear_angle(ring, parts, angle)
    for s, share in parts.special.items():
        if isinstance(share, FunctionShare):
            raise TypeError("a part of the Hamiltonian is a function of Python, not a polynomial")
        if isinstance(share, PolynomialShare):
            found[int(parts.part_of_angle[parts.row[s]])] += ring.of(share.polynomial)
    return found


def _linear_angle(ring: ExactPolynomials, parts: Parts, angle: int) -> Exact:
    """Return (l.x) (offset + weights.x / 2) of an angle."""
    form = form_of(ring, *row_of(parts.forms, angle))
    weights = form_of(ring, *row_of(parts.weights, angle))
    return form * (weights / 2 + number_of(parts.offset[angle]))


def row_of(rows: Any, r: int) -> tuple[list[int], list[Any]]:
    """Return the coordinates and values of a sparse row."""
    entries = slice(int(rows.start[r]), int(rows.start[r + 1]))
    return rows.coordinate[entries].tolist(), rows.value[entries].tolist()


def form_of(ring: ExactPolynomials, coordinates: list[int], values: list[Any]) -> Exact:
    """Return a linear form as a polynomial."""
    total = ring.zero
    for i, value in zip(coordinates, values, strict=True):
        total += ring.coordinates[i] * number_of(value)
    return total


def number_of(value: Any) -> Any:
    """Return a number of the table as a rational one; a number of too many digits is rounded to the float of a run."""
    exact = Fraction(exact_number(value))
    long = exact.numerator.bit_length() + exact.denominator.bit_length() > MOST_BITS
    return rational(float(exact) if long else exact)


def with_given_coefficients(
    ring: ExactPolynomials, parts: Parts, pieces: Sequence[Exact], H: Polynomial, factors: Mapping[Exponents, Exact]
) -> list[Exact]:
    """Return the pieces of parts with the coefficients of H as given, or with symbols, in place of those of a run.

    Parameters
    ----------
    ring : ExactPolynomials
        On the dual of the algebra.
    parts : Parts
        Parts of H itself, without a Casimir taken off. Each depends on coordinates, not on other linear forms.
    pieces : sequence of fmpq_mpoly
        The polynomials of the parts.
    H : Polynomial
        The Hamiltonian, whose coefficients may be fractions.
    factors : mapping
        Exponents of some monomials of H -> the polynomial in symbols that stands for the coefficient.

    Returns
    -------
    list of fmpq_mpoly
        The polynomials of the parts. A part that is not made of monomials of H is returned as it is.

    Raises
    ------
    ValueError
        There are symbols, and a part is not made of monomials of H.
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
