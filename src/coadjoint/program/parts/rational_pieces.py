"""Polynomials whose exact flows are rational rotations, as power series in the step."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from coadjoint.algebra.exact.numbers import rational
from coadjoint.algebra.polynomials.exact_polynomials import Exact, ExactPolynomials
from coadjoint.program.parts.part import Parts, PolynomialShare
from coadjoint.program.parts.part_polynomials import linear_form, sparse_row, to_rational


def rational_pieces(
    ring: ExactPolynomials, parts: Parts, frequency: NDArray[Any], highest: int
) -> list[dict[int, Exact]]:
    """Return for each part {j: coefficient of h^j}, j = 3, 5, ..., added to its piece by rational rotations.

    The rational rotation of frequency w over the time h rotates by 2/w atan(h w theta/2) in place of h theta. If theta
    is a function of s = l.x alone, it is the exact flow over h of a function K(s; h) with the derivative theta - (h
    w/2)^2 theta^3/3 + (h w/2)^4 theta^5/5 - ... `frequency`, shape (angles,), is 0 for exact rotations; `highest` is
    the largest power of h in h K.
    """
    found: list[dict[int, Exact]] = [{} for _ in range(len(parts))]
    of_share = {
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
        theta = _angle(ring, parts, angle, *of_share.get(angle, (None, 0)))
        power = theta
        for j in range(3, highest + 1, 2):
            power = _times(_times(power, theta), theta)
            factor = (-1) ** (j // 2) * (w / 2) ** (j - 1) / j
            K = ring.zero
            for k, c in enumerate(power):
                if c != 0:
                    K += s ** (k + 1) * (c * factor / (k + 1))
            found[p][j] = found[p].get(j, ring.zero) + K
    return found


def _angle(
    ring: ExactPolynomials, parts: Parts, angle: int, share: PolynomialShare | None, coordinate: int
) -> list[Any]:
    """Return the coefficients of an angle as a polynomial in its own form."""
    if share is not None:
        found = [rational(0)] * share.polynomial.degree
        for exponents, value in share.polynomial.monomials.items():
            if exponents[coordinate]:
                found[exponents[coordinate] - 1] += rational(value) * exponents[coordinate]
        return found
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
