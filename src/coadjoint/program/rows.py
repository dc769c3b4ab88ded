"""Rows of a program: the flows in order of application, from the sweeps of a method."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.program.numbers import Number, array_of, convert
from coadjoint.program.parts.part import Parts
from coadjoint.program.pattern_cache import MAX_PATTERN_SIZE, Pattern
from coadjoint.program.sweeps import Sweep, Swept


class Rows(NamedTuple):
    """Rows of a program, section by section.

    Row r applies part[r] over the time coefficient[r] * h, with functions of time evaluated at t + moment[r] * h.
    Section s (0 start, 1 step, 2 finish) has the rows section[s] to section[s + 1]: *start* is the first step, *step*
    every other one, and *finish* completes a state for output. For a processed scheme P K P^-1, *start* is P^-1 and K,
    *step* K, *finish* P.
    """

    part: NDArray[np.uint32]
    coefficient: NDArray[Any]
    moment: NDArray[Any]
    section: NDArray[np.uint32]


class Flows(NamedTuple):
    """Sequence of flows of parts, over coefficient[r] * h at moment[r] of the step.

    turn[r] marks a rational rotation that may be joined with the previous one.
    """

    part: Integers
    coefficient: NDArray[Any]
    moment: NDArray[Any]
    turn: NDArray[np.bool_]

    def take(self, chosen: Any) -> Flows:
        """Select flows."""
        return Flows(*(column[chosen] for column in self))

    def followed_by(self, other: Flows) -> Flows:
        """Append other flows."""
        return Flows(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


class JoinRules(NamedTuple):
    """Rules for joining consecutive flows of one part, from its time dependence and rational rotations."""

    timed: NDArray[np.bool_]
    rational: NDArray[np.bool_]

    @classmethod
    def of(cls, parts: Parts, frequency: NDArray[Any]) -> JoinRules:
        """Construct the rules from the parts of a program and the frequencies of their angles."""
        rational = np.zeros(len(parts), dtype=bool)
        rational[parts.part_of_angle[np.asarray(frequency != 0, dtype=bool)]] = True
        return cls(parts.timed, rational)

    def joins(self, part: int, moment: Any, later: Any, turn: bool) -> bool:
        """Test whether two flows of one part, at `moment` and then `later`, can be joined.

        Not if a time-dependent part has different moments, nor for rational rotations: two halves are not a whole.
        """
        return not (self.timed[part] and moment != later) and (not self.rational[part] or turn)

    def joined(self, flows: Flows) -> Flows:
        """Join consecutive flows of one part wherever possible."""
        kept = np.ones(len(flows.part), dtype=bool)
        coefficient, turn = flows.coefficient.copy(), flows.turn.copy()
        # The second of two joined flows is kept. Long chains occur only in systems of a single part.
        for r in (np.flatnonzero(flows.part[1:] == flows.part[:-1]) + 1).tolist():
            if self.joins(int(flows.part[r]), flows.moment[r - 1], flows.moment[r], bool(turn[r])):
                coefficient[r] = coefficient[r - 1] + coefficient[r]
                kept[r - 1], turn[r] = False, False
        return Flows(flows.part, coefficient, flows.moment, turn).take(kept)


def rows_of(method: Swept, joining: JoinRules, sign: int, number: Number) -> Rows:
    """Return the rows of a method, with consecutive flows of one part joined, also across steps.

    The coefficients include the `sign` of the equation.
    """
    sweeps, after = tuple(method.sweeps(number)), tuple(method.processor(number))
    if len(joining.timed) <= MAX_PATTERN_SIZE:
        return _cached_rows(sweeps, after, Pattern(joining, *joining), sign, number)
    return _rows(sweeps, after, joining, sign, number)


@lru_cache(maxsize=64)
def _cached_rows(
    sweeps: tuple[Sweep, ...], after: tuple[Sweep, ...], joining: Pattern[JoinRules], sign: int, number: Number
) -> Rows:
    return _rows(sweeps, after, joining.source, sign, number)


def _rows(sweeps: Sequence[Sweep], after: Sequence[Sweep], joining: JoinRules, sign: int, number: Number) -> Rows:
    kernel = joining.joined(_flows(sweeps, len(joining.timed), number))
    processor = joining.joined(_flows(after, len(joining.timed), number))
    undone = processor.take(slice(None, None, -1))
    start = undone._replace(coefficient=-undone.coefficient).followed_by(kernel)
    step, finish = kernel, processor._replace(moment=processor.moment + 1)
    size = len(kernel.part)
    # The last row belongs to the previous step, so its moment is a whole step earlier.
    if size > 1 and kernel.part[-1] == kernel.part[0]:
        before, turn = kernel.moment[-1] - 1, bool(kernel.turn[0])
        if joining.joins(int(kernel.part[0]), before, kernel.moment[0], turn):
            last = kernel.take(slice(-1, None))
            step = kernel.take(slice(0, -1))
            step.coefficient[0] = last.coefficient[0] + step.coefficient[0]
            start, finish = start.take(slice(0, -1)), last.followed_by(finish)
    start, finish = joining.joined(start), joining.joined(finish)
    rows = start.followed_by(step).followed_by(finish)
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
