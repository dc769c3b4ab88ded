"""How do completed squares depend on the linear term? Exactly, so that another linear term needs no new squares.

The forms l_r of the squares of x.M.x/2 do not depend on the linear term b; sum_r beta_r l_r = b gives the beta_r.
"""

from __future__ import annotations

from math import lcm
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.connected import connected
from coadjoint.algebra.exact import rational
from coadjoint.program.parts import Parts
from coadjoint.program.squares import LARGEST_RATIONAL


class ExactSum(NamedTuple):
    """The number sum of factor[k] b[coordinate[k]], over `denominator`, rounded once."""

    coordinate: tuple[int, ...]
    factor: tuple[int, ...]
    denominator: int

    def at(self, b: NDArray[np.float64]) -> float:
        """Return the sum for finite floats b, correctly rounded.

        Raises
        ------
        OverflowError
            It is too large for float64.

        Examples
        --------
        >>> ExactSum((0, 1), (1, -2), 3).at(np.array([1.0, 0.25]))
        0.16666666666666666
        """
        exact = [b[k].item().as_integer_ratio() for k in self.coordinate]
        # The denominators of floats are powers of two, so that the largest is a multiple of all.
        common = max((below for _, below in exact), default=1)
        total = sum(
            factor * above * (common // below) for factor, (above, below) in zip(self.factor, exact, strict=True)
        )
        return total / (self.denominator * common)


def offsets_of_squares(parts: Parts) -> dict[int, ExactSum]:
    """Return for the angles of completed squares how their offsets follow from the linear term of the Hamiltonian.

    Parameters
    ----------
    parts : Parts
        Of a Hamiltonian; its forms are exact numbers, as those of up to 16 coupled coordinates are.

    Returns
    -------
    dict
        Angle -> the exact sum. Angles of single coordinates that no square holds are left out.

    Examples
    --------
    >>> import coadjoint as co
    >>> from coadjoint.program.split import split
    >>> M = [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 2.0]]
    >>> parts = split(co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(M, linear=[1.0, 2.0, 3.0])))
    >>> {angle: (rule.coordinate, rule.factor, rule.denominator) for angle, rule in offsets_of_squares(parts).items()}
    {0: ((0,), (1,), 1), 1: ((0, 1), (-1, 2), 2)}
    """
    forms = parts.forms
    linear = np.ones(len(parts.offset), dtype=bool)
    for s in parts.special:
        linear[parts.row[s] : parts.row[s + 1]] = False
    angles = np.flatnonzero(linear)
    owner = np.repeat(np.arange(len(parts.offset)), np.diff(forms.start))
    entries = np.flatnonzero(linear[owner])
    # Nodes are the angles, then the coordinates.
    count, coordinate = len(parts.offset), forms.coordinate[entries].astype(np.int64)
    label = connected(count + int(coordinate.max(initial=-1)) + 1, owner[entries], count + coordinate)
    found: dict[int, ExactSum] = {}
    clusters: dict[int, list[int]] = {}
    for angle in angles.tolist():
        clusters.setdefault(int(label[angle]), []).append(angle)
    for own in clusters.values():
        rows = [_row(parts, angle) for angle in own]
        coordinates = sorted({k for row in rows for k in row})
        if 1 < len(coordinates) <= LARGEST_RATIONAL and len(own) <= len(coordinates):
            found |= zip(own, _inverse(rows, coordinates), strict=True)
    return found


def _row(parts: Parts, angle: int) -> dict[int, object]:
    entries = slice(int(parts.forms.start[angle]), int(parts.forms.start[angle + 1]))
    return dict(zip(parts.forms.coordinate[entries].tolist(), parts.forms.value[entries].tolist(), strict=True))


def _inverse(rows: list[dict[int, object]], coordinates: list[int]) -> list[ExactSum]:
    """Return beta of sum_r beta_r l_r = b, for linearly independent forms."""
    from flint import fmpq_mat

    r, m = len(rows), len(coordinates)
    # [L^T | 1], reduced, is [1 | B] in its first rows, with B L^T = 1.
    augmented = [
        [rational(row.get(k, 0)) for row in rows] + [rational(int(i == j)) for j in range(m)]
        for i, k in enumerate(coordinates)
    ]
    reduced, _ = fmpq_mat(m, r + m, [entry for line in augmented for entry in line]).rref()
    found = []
    for a in range(r):
        entries = [(coordinates[j], reduced[a, r + j]) for j in range(m) if reduced[a, r + j] != 0]
        below = lcm(*(int(value.denominator) for _, value in entries)) if entries else 1
        factors = tuple(int(value.numerator) * (below // int(value.denominator)) for _, value in entries)
        found.append(ExactSum(tuple(k for k, _ in entries), factors, below))
    return found
