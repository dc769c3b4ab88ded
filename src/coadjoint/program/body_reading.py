"""The flow of free bodies read in any number type: the Taylor series of the motion, with its exact tangent map."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.blocks import MOST_SUBSTEPS

if TYPE_CHECKING:
    from coadjoint.program.reading import Reading

Vectors = NDArray[Any]
PIECE = 0.25  # radians and logarithms in one series
MOST_TERMS = 4096


class Moving(NamedTuple):
    """What a flow moves, or one term of its series: the momentum, and the rows of a group element and tangent vectors
    where there are any.
    """

    x: Vectors
    group: Vectors | None
    tangent: Vectors | None


def flow_of_bodies(reading: Reading, part: int, tau: Any, moving: Moving) -> None:
    """Move everything by the flow of a part that is made of free bodies, in place.

    Along x' = sum_a theta_a(x) D_a x with linear theta_a, every term of the series in time is bilinear in those before.

    Parameters
    ----------
    reading : Reading
        Of the program.
    part : int
        The part.
    tau : number
        The time.
    moving : Moving
        What is moved.

    Raises
    ------
    ValueError
        The body turns too far.
    """
    body = _Bodies(reading, part)
    count = reading.pieces(lambda: abs(tau) * body.speed(moving.x) / PIECE)
    for _ in range(count):
        terms = [moving]
        while len(terms) <= MOST_TERMS:
            terms.append(body.next_term(terms, tau / count))
            if reading.negligible(terms):
                break
        for k, sums in enumerate(zip(*terms, strict=True)):
            if sums[0] is not None:
                moving[k][...] = sum(reversed(sums[1:]), 0 * sums[0]) + sums[0]


class _Bodies:
    """The generators and the angular velocities of one part."""

    def __init__(self, reading: Reading, part: int) -> None:
        program = reading.program
        first, last = (program.terms.row[program.share[p]] for p in (part, part + 1))
        self.rows = range(int(first), int(last))
        self.terms = program.terms
        self.state = [reading.generator(program.state, part, a) for a in range(len(self.rows))]
        self.group = [reading.generator(program.group, part, a) for a in range(len(self.rows))] if program.group else []

    def speed(self, x: Vectors) -> Any:
        """Return a bound of how fast vectors turn."""
        largest = [max([abs(value) for value in own.values()], default=0) for own in self.state]
        return sum(abs(rate) * most for rate, most in zip(self.rates(x), largest, strict=True))

    def rates(self, x: Vectors) -> list[Any]:
        """Return the angular velocities along the generators, or their changes by the columns of x."""
        terms = self.terms
        return [
            sum((terms.weight[e] * x[terms.column[e]] for e in range(terms.entry[r], terms.entry[r + 1])), 0 * x[0])
            for r in self.rows
        ]

    def next_term(self, terms: Sequence[Moving], tau: Any) -> Moving:
        """Return the term of one order more, with its power of the time."""
        n = len(terms)
        x, group, tangent = 0 * terms[0].x, terms[0].group, terms[0].tangent
        group, tangent = (None if item is None else 0 * item for item in (group, tangent))
        for k, term in enumerate(terms):
            before = terms[n - 1 - k]
            for a, rate in enumerate(self.rates(term.x)):
                x = x + rate * _applied(self.state[a], before.x)
                if group is not None and before.group is not None:
                    group = group + rate * _applied(self.group[a], before.group)
                if tangent is not None and before.tangent is not None:
                    tangent = tangent + rate * _applied(self.state[a], before.tangent)
            if tangent is not None and term.tangent is not None:
                for a, change in enumerate(self.rates(term.tangent)):
                    tangent = tangent + np.multiply.outer(_applied(self.state[a], before.x), change)
        return Moving(*(None if item is None else item * tau / n for item in (x, group, tangent)))  # type: ignore[arg-type]


def _applied(entries: dict[tuple[int, int], Any], vectors: Vectors) -> Vectors:
    result = 0 * vectors
    for (i, j), value in entries.items():
        result[i] = result[i] + value * vectors[j]
    return result


def largest_of(term: Iterable[Vectors | None]) -> Any:
    """Return the largest entry of each array of a term."""
    return [np.max(np.abs(item), initial=0) for item in term if item is not None]


def pieces(reach: Any, ceil: Callable[[Any], int]) -> int:
    """Return in how many pieces a flow goes that reaches so far; one that reaches too far is refused."""
    if not reach <= MOST_SUBSTEPS:
        raise ValueError(
            f"a free body turns {float(reach):.3g} times as far as one piece of its flow reaches, and "
            f"{MOST_SUBSTEPS} times is the most; take a smaller step, or start nearer to the origin"
        )
    return max(1, ceil(reach))
