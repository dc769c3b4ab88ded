"""What is applied in which order: the rows of a program, from the sweeps of a method."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.joins import Integers
from coadjoint.program.numbers import Number, array_of, convert
from coadjoint.program.parts import Parts
from coadjoint.program.pattern import LARGEST_PATTERN, Pattern
from coadjoint.program.sweeps import Sweep, Swept


class Rows(NamedTuple):
    """The rows, section after section.

    Row r moves by part[r] over the time coefficient[r] * h, with functions of time taken at t + moment[r] * h. Section
    s (0 start, 1 step, 2 finish) has the rows section[s] to section[s + 1]. The first step is *start*, every other one
    *step*; *finish* completes a state for output. Of a processed scheme P K P^-1, *start* is P^-1 and K, *step* is K,
    and *finish* is P.
    """

    part: NDArray[np.uint32]
    coefficient: NDArray[Any]
    moment: NDArray[Any]
    section: NDArray[np.uint32]


class Flows(NamedTuple):
    """Flows of parts, one after the other: over coefficient[r] * h, at the moment[r] of the step.

    turn[r] marks a rational rotation that the one before it may be joined with.
    """

    part: Integers
    coefficient: NDArray[Any]
    moment: NDArray[Any]
    turn: NDArray[np.bool_]

    def take(self, chosen: Any) -> Flows:
        """Return the chosen flows."""
        return Flows(*(column[chosen] for column in self))

    def then(self, other: Flows) -> Flows:
        """Return these flows followed by others."""
        return Flows(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


class Joining(NamedTuple):
    """Whether two flows of one part, one after the other, can be joined. It depends on which parts depend on time, and
    on which turn rationally.
    """

    timed: NDArray[np.bool_]
    rational: NDArray[np.bool_]

    @classmethod
    def of(cls, parts: Parts, frequency: NDArray[Any]) -> Joining:
        """Return it for the parts of a program and the frequencies of their angles."""
        rational = np.zeros(len(parts), dtype=bool)
        rational[parts.part_of_angle[np.asarray(frequency != 0, dtype=bool)]] = True
        return cls(parts.timed, rational)

    def joins(self, part: int, moment: Any, later: Any, turn: bool) -> bool:
        """Return whether two flows of one part can be joined, the first at `moment`, the second at the moment `later`.

        They cannot where each has a moment of its own, nor where they turn rationally: two halves are not a whole.
        """
        return not (self.timed[part] and moment != later) and (not self.rational[part] or turn)

    def joined(self, flows: Flows) -> Flows:
        """Return the flows after neighbours of one part were joined where they can be."""
        kept = np.ones(len(flows.part), dtype=bool)
        coefficient, turn = flows.coefficient.copy(), flows.turn.copy()
        # Of two that are joined the second stays. Long chains of one part are met in systems of a single part alone.
        for r in (np.flatnonzero(flows.part[1:] == flows.part[:-1]) + 1).tolist():
            if self.joins(int(flows.part[r]), flows.moment[r - 1], flows.moment[r], bool(turn[r])):
                coefficient[r] = coefficient[r - 1] + coefficient[r]
                kept[r - 1], turn[r] = False, False
        return Flows(flows.part, coefficient, flows.moment, turn).take(kept)


def rows_of(method: Swept, joining: Joining, sign: int, number: Number) -> Rows:
    """Return the rows of a method.

    Parameters
    ----------
    method : Swept
        Its sweeps and processor.
    joining : Joining
        Of the parts.
    sign : int
        Sign of the equation, which the coefficients include.
    number : callable
        Number type.

    Returns
    -------
    Rows
        Neighbouring flows of one part joined, those of consecutive steps too.
    """
    sweeps, after = tuple(method.sweeps(number)), tuple(method.processor(number))
    if len(joining.timed) <= LARGEST_PATTERN:
        return _remembered_rows(sweeps, after, Pattern(joining, *joining), sign, number)
    return _rows(sweeps, after, joining, sign, number)


@lru_cache(maxsize=64)
def _remembered_rows(
    sweeps: tuple[Sweep, ...], after: tuple[Sweep, ...], joining: Pattern[Joining], sign: int, number: Number
) -> Rows:
    return _rows(sweeps, after, joining.given, sign, number)


def _rows(sweeps: Sequence[Sweep], after: Sequence[Sweep], joining: Joining, sign: int, number: Number) -> Rows:
    kernel = joining.joined(_flows(sweeps, len(joining.timed), number))
    processor = joining.joined(_flows(after, len(joining.timed), number))
    undone = processor.take(slice(None, None, -1))
    start = undone._replace(coefficient=-undone.coefficient).then(kernel)
    step, finish = kernel, processor._replace(moment=processor.moment + 1)
    size = len(kernel.part)
    # The last row belongs to the step before, so that its moment lies a whole step earlier.
    if size > 1 and kernel.part[-1] == kernel.part[0]:
        before, turn = kernel.moment[-1] - 1, bool(kernel.turn[0])
        if joining.joins(int(kernel.part[0]), before, kernel.moment[0], turn):
            last = kernel.take(slice(-1, None))
            step = kernel.take(slice(0, -1))
            step.coefficient[0] = last.coefficient[0] + step.coefficient[0]
            start, finish = start.take(slice(0, -1)), last.then(finish)
    start, finish = joining.joined(start), joining.joined(finish)
    rows = start.then(step).then(finish)
    ends = np.cumsum([0, len(start.part), len(step.part), len(finish.part)])
    return Rows(rows.part.astype(np.uint32), sign * rows.coefficient, rows.moment, ends.astype(np.uint32))


def _flows(sweeps: Sequence[Sweep], parts: int, number: Number) -> Flows:
    none = array_of(number, [])
    found = Flows(np.zeros(0, dtype=np.int64), none, none, np.zeros(0, dtype=bool))
    pieces = [found]
    for sweep in sweeps:
        part = np.arange(parts) if sweep.forward else np.arange(parts)[::-1]
        coefficient, moment = (array_of(number, [convert(number, v)]) for v in (sweep.coefficient, sweep.moment))
        turn = np.zeros(parts, dtype=bool)
        turn[:1] = sweep.turn
        pieces.append(Flows(part, np.repeat(coefficient, parts), np.repeat(moment, parts), turn))
    return Flows(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))
