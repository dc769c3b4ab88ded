"""The flow of free bodies read in any number type: the Taylor series of the motion, with its exact tangent map."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.program.blocks import MOST_SUBSTEPS

if TYPE_CHECKING:
    from coadjoint.program.actions import Action
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
        for start, *more in zip(*terms, strict=True):
            if start is not None:
                start[...] = sum(reversed(more), 0 * start) + start


class _Entries(NamedTuple):
    """Entries of a matrix, or of several, one after the other: `owner` is the generator that each belongs to."""

    owner: NDArray[np.int64]
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    value: NDArray[Any]

    def times(self, rates: NDArray[Any], vectors: Vectors) -> Vectors:
        """Return sum_a rate_a D_a on vectors (n,) or (n, m)."""
        factors = rates[self.owner] * self.value
        moved = vectors[self.column] * (factors if vectors.ndim == 1 else factors[:, None])
        result = 0 * vectors
        np.add.at(result, self.row, moved)
        return result


class _Bodies:
    """The generators and the angular velocities of one part."""

    def __init__(self, reading: Reading, part: int) -> None:
        program = reading.program
        first, last = (program.terms.row[program.share[p]] for p in (part, part + 1))
        self.terms = program.terms
        # The first turn of a body has no weights.
        self.rows = [r for r in range(int(first), int(last)) if self.terms.entry[r] < self.terms.entry[r + 1]]
        angles = [r - int(first) for r in self.rows]
        self.state = _entries(reading, program.state, part, angles)
        self.group = None if program.group is None else _entries(reading, program.group, part, angles)

    def speed(self, x: Vectors) -> Any:
        """Return a bound of how fast vectors turn."""
        return sum(abs(rate) * max(abs(self.state.value), default=0) for rate in self.rates(x))

    def rates(self, x: Vectors) -> NDArray[Any]:
        """Return the angular velocities along the generators, or their changes by the columns of x."""
        terms, found = self.terms, np.empty((len(self.rows), *x.shape[1:]), dtype=x.dtype)
        for a, r in enumerate(self.rows):
            entries = range(terms.entry[r], terms.entry[r + 1])
            found[a] = sum((terms.weight[e] * x[terms.column[e]] for e in entries), 0 * x[0])
        return found

    def next_term(self, terms: Sequence[Moving], tau: Any) -> Moving:
        """Return the term of one order more, with its power of the time."""
        n = len(terms)
        sums: list[Any] = [None if item is None else 0 * item for item in terms[0]]
        for k, term in enumerate(terms):
            before, rates = terms[n - 1 - k], self.rates(term.x)
            for place, entries in enumerate((self.state, self.group, self.state)):
                vectors = before[place]
                if vectors is not None and entries is not None:
                    sums[place] = sums[place] + entries.times(rates, vectors)
            if term.tangent is not None:
                changes, state = self.rates(term.tangent), self.state
                np.add.at(sums[2], state.row, (state.value * before.x[state.column])[:, None] * changes[state.owner])
        x, group, tangent = (None if item is None else item * tau / n for item in sums)
        assert x is not None
        return Moving(x, group, tangent)


def _entries(reading: Reading, action: Action, part: int, angles: Sequence[int]) -> _Entries:
    matrices = [reading.generator(action, part, q) for q in angles]
    found = [(a, *place, value) for a, matrix in enumerate(matrices) for place, value in matrix.items()]
    owner, row, column = (np.array([entry[k] for entry in found], dtype=np.int64) for k in range(3))
    return _Entries(owner, row, column, np.array([entry[3] for entry in found]))


def largest_of(term: Iterable[Vectors | None]) -> Any:
    """Return the largest entry of each array of a term."""
    return [np.max(np.abs(item), initial=0) for item in term if item is not None]


def pieces(reach: Any, ceil: Callable[[Any], int]) -> int:
    """Return in how many pieces a flow goes that reaches so far; one that reaches too far is refused."""
    if not reach <= MOST_SUBSTEPS:
        raise ValueError(
            f"a free body turns too far in one step: it would take {float(reach):.3g} pieces, and at most "
            f"{MOST_SUBSTEPS} are allowed; take a smaller step, or start nearer to the origin"
        )
    return max(1, ceil(reach))
