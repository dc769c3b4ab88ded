"""Memory estimates for runs."""

from __future__ import annotations

from coadjoint import memory
from coadjoint.kernels.arrays import Layout
from coadjoint.memory import UNCHECKED_BYTES, format_bytes
from coadjoint.runs.times import Times
from coadjoint.short_repr import short

BYTES_PER_NUMBER = 8  # of float64
BYTES_PER_POINT = 24  # time, number and observed quantities


def bytes_of_run(layout: Layout, times: Times) -> int:
    """Estimate the memory of a run's arrays, in bytes."""
    return BYTES_PER_NUMBER * (layout.saved.size + layout.state.size) + BYTES_PER_POINT * times.points


def check_run_memory(layout: Layout, times: Times, members: int) -> None:
    """Raise ValueError if a run's arrays exceed the free memory; suggest a `save_every` that fits, if any."""
    required = bytes_of_run(layout, times)
    if required <= UNCHECKED_BYTES:
        return
    free = memory.available()
    if required <= free:
        return
    bytes_per_point = BYTES_PER_NUMBER * (layout.saved.size // times.points) + BYTES_PER_POINT
    points = (free - (required - bytes_per_point * times.points)) // bytes_per_point
    # The start and the end are always saved.
    every = -(-times.steps // (points - 1)) if points >= 2 else 0
    reduction = f"give save_every={every} or more" if times.marks is None else "give fewer times in t_eval"
    advice = reduction if every else "run fewer members at a time"
    raise ValueError(
        f"{short(times.points)} saved points of {members} member{'s' if members > 1 else ''} need about "
        f"{format_bytes(required)}; this machine has {format_bytes(free)} free; {advice}"
    )
