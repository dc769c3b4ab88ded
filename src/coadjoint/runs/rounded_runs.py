"""Runs with other directions of rounding, which show what rounding changes: up, or up and down in turns."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

from coadjoint.kernels.library import kernels
from coadjoint.runs.run import Run

# Largest number of calls of the compiled loop in a run that is rounded in turns.
TURNS = 1024


@contextmanager
def rounding(direction: int) -> Iterator[None]:
    """Let this thread round up (1) or down (-1) in the block."""
    if kernels().set_rounding(ctypes.c_int64(direction)):
        raise RuntimeError("this processor rounds to nearest only")
    try:
        yield
    finally:
        kernels().set_rounding(ctypes.c_int64(0))


def advance_up(run: Run) -> None:
    """Take all steps of a run in one thread, rounded up."""
    with rounding(1):
        run.advance()


def advance_in_turns(run: Run, first: int = 1) -> None:
    """Take all steps of a run in one thread, some of them rounded up and as many down, in turns; `first` up or down.

    Errors that rounding always commits in the same direction then remain, such as those of a small term in a sum, and
    those of the directions themselves cancel.
    """
    steps = run.times.steps
    turns = min(steps, TURNS)
    for turn in range(turns):
        with rounding(first if turn % 2 == 0 else -first):
            run.advance(until=steps * (turn + 1) // turns)
