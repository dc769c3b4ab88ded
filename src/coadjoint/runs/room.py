"""Does what a run saves fit in memory?"""

from __future__ import annotations

from coadjoint import memory
from coadjoint.kernels.arrays import Layout
from coadjoint.memory import SMALL, in_words
from coadjoint.runs.times import Times
from coadjoint.wording import short

BYTES = 8
PER_POINT = 24  # its time, its number, and what was asked to be observed


def bytes_of_run(layout: Layout, times: Times) -> int:
    """Return how many bytes a run holds."""
    return BYTES * (layout.saved.size + layout.state.size) + PER_POINT * times.points


def check_room_of_run(layout: Layout, times: Times, members: int) -> None:
    """Refuse a run whose arrays do not fit in memory, and say how many of its points would.

    Parameters
    ----------
    layout : Layout
        Of its arrays, which are not made yet.
    times : Times
        Its steps, and how many of them are saved.
    members : int
        How many there are.

    Raises
    ------
    ValueError
        With the memory that is estimated and that is free, and a `save_every` that fits, where there is one.
    """
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
    right = f"give save_every={every} or more" if every else "run fewer members at a time"
    raise ValueError(
        f"{short(times.points)} saved points of {members} member{'s' if members > 1 else ''} need about "
        f"{in_words(need)}; this machine has {in_words(free)} free; {right}"
    )
