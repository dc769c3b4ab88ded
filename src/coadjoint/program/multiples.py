"""Multiples: the linear map from numbers, as coefficients or parameters, to the constants that depend on them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.systems.energy_derivatives import EnergyDerivative

Floats = NDArray[np.float64]


class Multiples(NamedTuple):
    """The constants at `position`, which are, or contain, `factor` times the numbers `number`; None: equal to them.

    Members of a batch may have factors of their own, (members, count).
    """

    position: Integers
    number: Integers
    factor: Any

    @classmethod
    def of_triplets(cls, triplets: Sequence[tuple[int, int, float]]) -> Multiples:
        """Construct from (position, number, factor)."""
        table = np.array(triplets, dtype=object).reshape(-1, 3)
        return cls(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2].astype(np.float64))

    def of(self, values: Floats) -> Floats:
        """Return these constants for the values (m,) of the numbers, or (members, constants) for (members, m)."""
        chosen = values.take(self.number, -1)
        return chosen if self.factor is None else np.asarray(chosen * self.factor)

    def at(self, constants: NDArray[Any], values: Floats) -> NDArray[Any]:
        """Return the array for other values of all numbers: (count,) for (m,), (count, members) for (m, members)."""
        filled = np.repeat(constants, values[0].size).reshape(len(constants), *values.shape[1:])
        filled[self.position] = self.of(values.T).T
        return filled

    def take(self, chosen: NDArray[Any]) -> Multiples:
        """Select entries."""
        return Multiples(*(column[chosen] for column in self))

    def among(self, numbers: Integers, renumbered: Integers) -> Multiples:
        """Return the multiples of some numbers, ascending, with other ones."""
        chosen = self.take(np.isin(self.number, numbers))
        return chosen._replace(number=renumbered[np.searchsorted(numbers, chosen.number)])

    def split(self, sizes: Mapping[str, int]) -> dict[str, Multiples]:
        """Return the multiples of the entries of parameters of these sizes, which are numbered one after the other."""
        found, start = {}, 0
        for name, size in sizes.items():
            chosen = self.take((self.number >= start) & (self.number < start + size))
            found[name] = chosen._replace(number=chosen.number - start)
            start += size
        return found

    def of_energies(self, energies: Sequence[EnergyDerivative]) -> Multiples:
        """Return the multiples of the entries of members, from those of monomials that are `apart`."""
        factors = np.stack([one.coefficients for one in energies])
        return Multiples(self.position, energies[0].entries[self.number], self.factor * factors[:, self.number])

    def of_energy(self, energy: EnergyDerivative) -> Multiples:
        """Return the multiples of the entries of one system, from those of monomials that are `apart`."""
        of_one = self.of_energies([energy])
        return of_one._replace(factor=of_one.factor[0])

    def of_entries(self, by_constant: Floats, entries: int) -> Floats:
        """Return derivatives by the numbers, (..., entries), of derivatives by constants (..., count)."""
        return _sums(self.factor * by_constant[..., self.position], self.number, entries)

    def of_directions(self, directions: Floats, count: int) -> Floats:
        """Return directions of the constants (..., k, count) for directions of the numbers (..., k, entries)."""
        return _sums(self.factor[..., None, :] * directions[..., self.number], self.position, count)


def concatenated(found: Sequence[Multiples]) -> Multiples:
    """Return the multiples of an array together."""
    return Multiples(*map(np.concatenate, zip(NO_MULTIPLES, *found, strict=True)))


NO_MULTIPLES = Multiples(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0))


def _sums(numbers: Floats, index: Integers, count: int) -> Floats:
    """Return the sums (..., count) of the numbers (..., k) of each index, in their order."""
    rows = prod(numbers.shape[:-1])
    positions = index + count * np.arange(rows)[:, None]
    sums = np.bincount(positions.ravel(), numbers.ravel(), minlength=count * rows)
    return sums.astype(np.float64).reshape(*numbers.shape[:-1], count)
