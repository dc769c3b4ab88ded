"""Memory estimates for runs."""

from __future__ import annotations

from coadjoint import memory
from coadjoint.kernels.arrays import Layout
from coadjoint.memory import SMALL, in_words
from coadjoint.runs.times import Times
from coadjoint.short_repr import short

BYTES = 8
PER_POINT = 24  # time, number and observed quantities


def bytes_of_run(layout: Layout, times: Times) -> int:
    """Estimate the memory of a run's arrays, in bytes."""
    return BYTES * (layout.saved.size + layout.state.size) + PER_POINT * times.points


def check_room_of_run(layout: Layout, times: Times, members: int) -> None:
    """Raise ValueError if a run's arrays exceed the free memory; suggest a `save_every` that fits, if any."""
    need = bytes_of_run(layout, times)
    if need <= SMALL:
        return
    free = memory.available()
    if need <= free:
        return
    one = BYTES * (layout.saved.size // times.points) + PER_POINT
    points = (free - (need - one * times.points)) // one
    # The start and the end are always saved.
    every = -(-times.steps // (points - 1)) if points >= 2 else 0
    fewer = f"give save_every={every} or more" if times.marks is None else "give fewer times in t_eval"
    right = fewer if every else "run fewer members at a time"
    raise ValueError(
        f"{short(times.points)} saved points of {members} member{'s' if members > 1 else ''} need about "
        f"{in_words(need)}; this machine has {in_words(free)} free; {right}"
    )
