"""Poincare section: crossings of the surfaces of events."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import (
    COLOURS,
    colour,
    colour_bar,
    coordinate,
    legend,
    new_figure,
    plain_axes,
    set_title,
    with_figure_settings,
)
from coadjoint.runs.events import RecordedEvents
from coadjoint.validation import read_choice, read_integer, read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_LARGE_DOTS = 2000
"""Largest number of crossings drawn with dots of full size."""


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
    events = drawn.solution.events
    if events is None:
        raise CannotShow("the run has no events; integrate with events=co.Event(...)")
    try:
        chosen = events if event is None else events[event]
        drawn_coordinates(chosen, components)
    except (TypeError, ValueError) as reason:
        raise CannotShow(str(reason)) from None

    def paint(axes: Any) -> None:
        draw_crossings(chosen, components, axes)

    return paint


@with_figure_settings
def draw_crossings(events: RecordedEvents, components: Any = None, axes: Any = None) -> Figure:
    """Draw the crossings of events in two coordinates (right, up), by default those that vary most."""
    names = events.coordinates
    across, up = drawn_coordinates(events, components)
    if axes is None:
        axes = new_figure("pictures", 5.2, 4.8).add_subplot()
    plain_axes(axes)
    size = 2.0 if len(events) <= MAX_LARGE_DOTS else max(0.15, 2.0 * (MAX_LARGE_DOTS / len(events)) ** 0.5)
    style = {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0, "rasterized": True}
    members = np.unique(events.member)
    shades, bar = _colours_of(members)
    for m in members:
        x = events.x[events.member == m]
        axes.plot(x[:, across], x[:, up], color=shades(m), label=f"member {m}", **style)
    axes.set(xlabel=coordinate(names[across]), ylabel=coordinate(names[up]))
    set_title(axes, f"{len(events)} crossings of {', '.join(events.names)}")
    if bar is not None:
        colour_bar(axes, bar, "member")
    elif len(members) > 1:
        legend(axes, beside=True, markerscale=4.0 / size)
    figure: Figure = axes.figure
    return figure


def _colours_of(members: Any) -> tuple[Callable[[int], Any], Any]:
    """Return the colours of members by number, and what a colour bar shows if they are too many for a legend."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    if len(members) <= len(COLOURS):
        return lambda m: colour(int(np.searchsorted(members, m))), None
    shades = ScalarMappable(Normalize(float(members[0]), float(members[-1])), colormaps["viridis"])
    return lambda m: shades.to_rgba(np.array(float(m))), shades


def drawn_coordinates(events: RecordedEvents, components: Any = None) -> tuple[int, int]:
    """Return the indices of the coordinates (right, up); arguments and errors are those of `draw_crossings`."""
    names = events.coordinates
    if len(names) < 2:
        raise TypeError("crossings of matrix states cannot be drawn; plot two quantities computed from the states")
    if not len(events):
        raise ValueError("there are no crossings to draw; take a longer run, or another event")
    if components is None:
        widest = np.argsort(-np.std(events.x, axis=0), kind="stable")[:2]
        across, up = sorted(widest.tolist())
        return across, up
    chosen = read_list(components, "components", "give two numbers or names of coordinates")
    if len(chosen) != 2:
        raise ValueError(f"components has {len(chosen)} entries; give two numbers or names of coordinates")
    across, up = (
        names.index(read_choice(name, "coordinate", names))
        if isinstance(name, str)
        else read_integer(name, "a coordinate", 0, len(names) - 1)
        for name in chosen
    )
    return across, up
