"""Decisions that many systems of a batch must make alike to share one table."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.bounded import Bounded


class Undecided(ArithmeticError):
    """A decision about the first system is within rounding, or of a kind that is not made for many systems."""


class Agreement:
    """Systems, as the last axis of arrays, that decide like the first one: `alike` (members,)."""

    def __init__(self, count: int) -> None:
        self.alike = np.ones(count, dtype=bool)

    def require(self, held: NDArray[Any]) -> None:
        """Keep the systems for which all of (..., members) hold; raise `Undecided` unless they do for the first."""
        every: NDArray[np.bool_] = np.all(held.reshape(-1, len(self.alike)), axis=0)
        if not every[0]:
            raise Undecided
        self.alike &= every

    def decide(self, values: NDArray[Any], certain: Any = True) -> NDArray[Any]:
        """Return the values (...) of the first system; others are kept if theirs are equal and certain."""
        self.require((values == values[..., :1]) & certain)
        return np.asarray(values[..., 0])

    def present(self, numbers: Bounded) -> NDArray[Any]:
        """Return which numbers are not zero."""
        signs, certain = numbers.signs()
        return self.decide(signs != 0.0, certain)

    def rounded(self, numbers: Bounded) -> NDArray[np.float64]:
        """Return the nearest floats, without negative zeros."""
        values, certain = numbers.rounded()
        self.require(certain)
        return values + 0.0

    def largest(self, numbers: Bounded) -> int:
        """Return the first one of the largest numbers (count, members)."""
        chosen = int(np.argmax(numbers.high[:, 0]))
        for others, least in ((numbers[:chosen], 1.0), (numbers[chosen + 1 :], 0.0)):
            if len(others.high):
                signs, certain = numbers[chosen].signs_of_difference(others)
                self.require(certain & (signs >= least))
        return chosen
