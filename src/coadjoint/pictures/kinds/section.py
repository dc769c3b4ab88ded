"""Poincare section: crossings of the surfaces of events."""

from __future__ import annotations

from typing import Any

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.section import draw_crossings, places


@kind("section")
def section(drawn: PlottedRun, event: str | int | None = None, components: Any = None) -> Paint:
    """Show the crossings of an event: two components of the states, with one colour per member.

    Parameters
    ----------
    event : str or int, optional
        The event, by name or number; by default all events of the run.
    components : (int or str, int or str), optional
        Components to the right and upwards; by default the two that vary most.
    """
    found = drawn.solution.events
    if found is None:
        raise CannotShow("the run has no events; integrate with events=co.Event(...)")
    try:
        chosen = found if event is None else found[event]
        places(chosen, components)
    except (TypeError, ValueError) as reason:
        raise CannotShow(str(reason)) from None

    def paint(axes: Any) -> None:
        draw_crossings(chosen, components, axes)

    return paint
