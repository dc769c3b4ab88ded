"""Where the run crosses the surfaces of its events: a Poincare section."""

from __future__ import annotations

from typing import Any

from coadjoint.pictures.drawn import Drawn
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.section import draw_crossings, places


@kind("section")
def section(drawn: Drawn, event: str | int | None = None, components: Any = None) -> Paint:
    """Show the crossings of an event: two components of the states, a colour for each member.

    Parameters
    ----------
    drawn : Drawn
        The run.
    event : str or int, optional
        Which one, by name or number; by default all that were looked for.
    components : (int or str, int or str), optional
        Which are drawn, to the right and upwards; by default the two that vary most.

    Returns
    -------
    Paint
    """
    found = drawn.solution.events
    if found is None:
        raise CannotShow("no events were looked for; integrate with events=co.Event(...)")
    try:
        chosen = found if event is None else found[event]
        places(chosen, components)
    except (TypeError, ValueError) as reason:
        raise CannotShow(str(reason)) from None

    def paint(axes: Any) -> None:
        draw_crossings(chosen, components, axes)

    return paint
