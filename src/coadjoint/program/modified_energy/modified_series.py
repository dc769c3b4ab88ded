"""Modified Hamiltonian of a splitting: polynomials of the parts, inserted into the universal Lie series."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

from coadjoint.algebra.exact.free_algebra import Word, factors
from coadjoint.algebra.polynomials.exact_polynomials import Exact
from coadjoint.program.modified_energy.composition_logarithm import BALL_BITS, Coordinates, Letter
from coadjoint.program.modified_energy.sweep_logarithm import Commutators, Flow, sweep_logarithm

MIN_BITS = 60


class Balls(NamedTuple):
    """Polynomial with coefficients known up to rounding, as floats.

    `radius` is the largest radius of a ball relative to its midpoint, `neglected` a bound of coefficients dropped
    because they are zero up to rounding.
    """

    coefficients: Mapping[tuple[int, ...], float]
    radius: float
    neglected: float


class ModifiedSeries:
    """Terms of h Y_1 + h^2 Y_2 + ... for a step: its Lie series, with polynomials for the letters.

    `flows` are the parts in the order of a forward sweep, each a mapping j -> polynomial (see `sweep_logarithm`), and
    `highest` is the largest weight available.
    """

    def __init__(self, commutators: Commutators, flows: Sequence[Flow], highest: int) -> None:
        self._commutators, self._flows, self._highest = commutators, flows, highest
        self._known: dict[Word, Exact] = {}

    @cached_property
    def _sweep(self) -> list[Exact]:
        return sweep_logarithm(self._commutators, self._flows, self._highest)

    def of(self, word: Word) -> Exact:
        """Return the nested bracket of a Lyndon word of letters, as a polynomial."""
        if word not in self._known:
            if len(word) > 1:
                left, right = factors(word)
                self._known[word] = self._commutators(self.of(left), self.of(right))
            else:
                self._known[word] = self._letter(word[0])
        return self._known[word]

    def _letter(self, letter: Letter) -> Exact:
        if letter.place == "sweep":
            return self._sweep[letter.weight - 1]
        flow = self._flows[0 if letter.place == "first" else -1]
        return flow.get(letter.weight, self._commutators.ring.zero)

    def term(self, coordinates: Coordinates, weight: int) -> Exact | Balls:
        """Return the term of one weight (power of h, >= 2): exact for rational coefficients, else balls."""
        from flint import arb, ctx

        own = coordinates.of_weight[weight]
        ring = self._commutators.ring
        if not any(isinstance(value, arb) for value in own.values()):
            total = ring.zero
            for word, value in own.items():
                total += self.of(word) * value
            return total
        sums: dict[tuple[int, ...], Any] = {}
        largest = 0.0
        with ctx.workprec(BALL_BITS):
            for word, value in own.items():
                for exponents, factor in self.of(word).to_dict().items():
                    sums[exponents] = sums.get(exponents, 0) + (added := value * factor)
                    largest = max(largest, float(abs(added).upper()))
            return _rounded({tuple(map(int, exponents)): value for exponents, value in sums.items()}, largest)


def _rounded(balls: Mapping[tuple[int, ...], Any], largest: float) -> Balls:
    found, radius, neglected = {}, 0.0, 0.0
    for exponents, ball in balls.items():
        size = float(ball.rad())
        if size > largest * 2.0**-MIN_BITS:
            raise ValueError(
                "the coefficients of the scheme are known to too few digits: a coefficient of the modified Hamiltonian "
                f"is known up to {size:.1e} only, from products of size {largest:.1e}"
            )
        if ball.contains(0):
            neglected = max(neglected, float(abs(ball).upper()))
        else:
            found[exponents] = float(ball.mid())
            radius = max(radius, float((ball.rad() / abs(ball).lower()).upper()))
    return Balls(found, radius, neglected)
