"""Hamiltonian noise on matrices, dX = sum_k [A_k, X] o dB_k: two exponentials on one side of each step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.rounding import UNIT_ROUNDOFF
from coadjoint.systems.forces.base import normal_deviates
from coadjoint.systems.matrices.conjugation import exponential, times, with_layers

Floats = NDArray[np.float64]
Matrix = NDArray[Any]

QUANTA = 2.0**20
"""Times are counted in this fraction of the shortest increment: rounded times of equal increments have equal counts."""
COMMUTING = 64 * UNIT_ROUNDOFF  # of the products: commutators below it are those of rounding


class Increments(NamedTuple):
    """The increments of Brownian motions in a step, whether they act before it, and further normal deviates."""

    sums: Floats
    before: bool
    further: Floats


def brownian_increments(noise: Any, count: int, t: float, h: float, further: int = 0) -> Increments:
    """Return the increments of a step for the first member, as ``forces/increments.hpp``."""
    parts = 2**noise.levels
    length, total, before, rest = h / parts, np.zeros(count), False, np.zeros(further)
    for k in range(parts):
        number = float(np.floor((t + k * length) / (length / QUANTA) + 0.5))
        drawn = normal_deviates(noise.seed, noise.stream, number, 0, count + 1 + (0 if k else further))
        total += drawn[:count]
        if k == 0:
            before, rest = bool(drawn[count] < 0.0), drawn[count + 1 :]
    return Increments(np.sqrt(length) * total, before, rest)


class MatrixNoise(NamedTuple):
    """The elements A_k of a noise: the sum of multiples of them, a function of the factors, and their number."""

    combined: Callable[[Floats], Matrix]
    size: int
    commuting: bool = False

    def unitaries(self, system: Any, noise: Any, t: float, h: float, side: int) -> Iterator[Matrix]:
        """Yield what conjugates a state on a side of a step, the first to act first; nothing on the other side."""
        found = brownian_increments(noise, self.size, t, h, 0 if self.commuting else self.size)
        if found.before != (side == 0):
            return
        factors = [found.sums]
        if not self.commuting:
            factors = [0.5 * found.sums + sign * np.sqrt(0.5 * h) * found.further for sign in (-1.0, 1.0)]
        for each in factors:
            yield exponential(system, with_layers(system, self.combined(each)))

    def ito_drift(self, system: Any, X: Matrix) -> Matrix:
        """Return ``sum_k [A_k, [A_k, X]]/2``."""
        drift = np.zeros_like(X)
        for unit in np.eye(self.size):
            A = with_layers(system, self.combined(unit))
            drift = drift + 0.5 * system.bracket(A, system.bracket(A, X))
        return drift


def of_elements(system: Any, elements: Matrix) -> MatrixNoise:
    """Return the noise of given elements, (d, N, N) or (d, 2, N, N)."""
    sizes = np.linalg.norm(elements.reshape(len(elements), -1), axis=1)
    commuting = True
    for A, size in zip(elements, sizes, strict=True):
        brackets = A @ elements - elements @ A
        if elements.ndim == 4:
            brackets = times(system, A, elements) - times(system, elements, A)
        left = np.linalg.norm(brackets.reshape(len(elements), -1), axis=1)
        commuting = commuting and bool(np.all(left <= COMMUTING * system.algebra.N * size * sizes))
    return MatrixNoise(lambda factors: np.tensordot(factors, elements, axes=1), len(elements), commuting)
