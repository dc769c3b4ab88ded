"""Sweeps through the parts of a Hamiltonian, and the stages of a flow table: its flows in order of application."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from coadjoint.algebra.exact.sparse_sums import Integers
from coadjoint.program.numbers import Number, array_of, convert, precision_of
from coadjoint.program.parts.part import Parts
from coadjoint.program.sparse_rows import MAX_PATTERN_SIZE, Pattern


class Sweep(NamedTuple):
    """One pass through the parts over a fraction of the step, forward or backward.

    Parameters
    ----------
    forward : bool
        Whether the parts are applied in their order, or in reverse.
    coefficient : number
        The fraction of the step.
    moment : number
        The moment of the step, as a fraction, at which functions of time are evaluated.
    turn : bool
        Whether the sweep forms a second-order step with the previous one: the part at which they meet flows once over
        both.
    """

    forward: bool
    coefficient: Any
    moment: Any
    turn: bool = False


class Swept(Protocol):
    """Protocol of schemes composed of exact flows of parts."""

    @property
    def parts(self) -> Any:
        """Choice of the parts: "auto", "coordinates", or sets of coordinates."""

    @property
    def rotation(self) -> str:
        """Rotations by the angle itself ("exact"), or by tan(angle/2) := half the angle ("rational")."""

    def sweeps(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of one step, first to last, with coefficients in the given number type."""

    def processor(self, number: Callable[[Any], Any] = float) -> Sequence[Sweep]:
        """Return the sweeps of the processor P of a step P K P^-1, whose `sweeps` are the kernel K."""


class FlowStages(NamedTuple):
    """Stage r applies part[r] over coefficient[r] * h, at the time t + moment[r] * h.

    Section s has stages section[s] to section[s + 1]: first step, every other step, and the finish before output.
    """

    part: NDArray[np.uint32]
    coefficient: NDArray[Any]
    moment: NDArray[Any]
    section: NDArray[np.uint32]


class Flows(NamedTuple):
    """Flows of parts over coefficient[r] * h at moment[r]; turn[r]: a rotation that may join the previous one."""

    part: Integers
    coefficient: NDArray[Any]
    moment: NDArray[Any]
    turn: NDArray[np.bool_]

    def take(self, chosen: Any) -> Flows:
        return Flows(*(column[chosen] for column in self))

    def followed_by(self, other: Flows) -> Flows:
        return Flows(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


class JoinRules(NamedTuple):
    """Rules for joining consecutive flows of one part, from its time dependence and rational rotations."""

    timed: NDArray[np.bool_]
    rational: NDArray[np.bool_]

    @classmethod
    def from_parts(cls, parts: Parts, frequency: NDArray[Any]) -> JoinRules:
        """Construct the rules from the parts of a flow table and the frequencies of their angles."""
        rational = np.zeros(len(parts), dtype=bool)
        if np.any(frequency):
            rational[parts.part_of_angle[np.asarray(frequency != 0, dtype=bool)]] = True
        return cls(parts.timed, rational)

    def joins(self, part: int, moment: Any, later: Any, turn: bool) -> bool:
        """Test whether flows of one part can be joined: not timed ones at other moments, nor half-turns alone."""
        return not (self.timed[part] and moment != later) and (not self.rational[part] or turn)

    def joined(self, flows: Flows) -> Flows:
        """Join consecutive flows of one part wherever possible."""
        keep = np.ones(len(flows.part), dtype=bool)
        coefficient, turn = flows.coefficient.copy(), flows.turn.copy()
        # The second of two joined flows is kept. Long chains occur only in systems of a single part.
        for r in (np.flatnonzero(flows.part[1:] == flows.part[:-1]) + 1).tolist():
            if self.joins(int(flows.part[r]), flows.moment[r - 1], flows.moment[r], bool(turn[r])):
                coefficient[r] = coefficient[r - 1] + coefficient[r]
                keep[r - 1], turn[r] = False, False
        return Flows(flows.part, coefficient, flows.moment, turn).take(keep)


def stages_of(method: Swept, joining: JoinRules, sign: int, number: Number) -> FlowStages:
    """Return the stages of a method, with consecutive flows of one part joined, also across steps."""
    sweeps, processor = tuple(method.sweeps(number)), tuple(method.processor(number))
    if len(joining.timed) <= MAX_PATTERN_SIZE:
        return _cached_rows(sweeps, processor, Pattern(joining, *joining), sign, number, precision_of(number))
    return _rows(sweeps, processor, joining, sign, number)


@lru_cache(maxsize=64)
def _cached_rows(
    sweeps: tuple[Sweep, ...],
    processor: tuple[Sweep, ...],
    joining: Pattern[JoinRules],
    sign: int,
    number: Number,
    precision: int | None,
) -> FlowStages:
    return _rows(sweeps, processor, joining.source, sign, number)


def _rows(
    sweeps: Sequence[Sweep], processor_sweeps: Sequence[Sweep], joining: JoinRules, sign: int, number: Number
) -> FlowStages:
    kernel = joining.joined(_flows(sweeps, len(joining.timed), number))
    processor = joining.joined(_flows(processor_sweeps, len(joining.timed), number))
    inverse_processor = processor.take(slice(None, None, -1))
    start = inverse_processor._replace(coefficient=-inverse_processor.coefficient).followed_by(kernel)
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
    return FlowStages(rows.part.astype(np.uint32), sign * rows.coefficient, rows.moment, ends.astype(np.uint32))


def _flows(sweeps: Sequence[Sweep], parts: int, number: Number) -> Flows:
    empty = array_of(number, [])
    start = Flows(np.zeros(0, dtype=np.int64), empty, empty, np.zeros(0, dtype=bool))
    pieces = [start]
    for sweep in sweeps:
        part = np.arange(parts) if sweep.forward else np.arange(parts)[::-1]
        coefficient, moment = (array_of(number, [convert(number, v)]) for v in (sweep.coefficient, sweep.moment))
        turn = np.zeros(parts, dtype=bool)
        turn[:1] = sweep.turn
        pieces.append(Flows(part, np.repeat(coefficient, parts), np.repeat(moment, parts), turn))
    return Flows(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))
