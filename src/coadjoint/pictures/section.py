"""Plot of the crossings of a surface as dots: two components of the states, one colour per member."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.optional_packages import need
from coadjoint.pictures.style import COLOURS, coordinate, plain_axes
from coadjoint.runs.events import Events
from coadjoint.validation import read_choice, read_integer, read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_LARGE_DOTS = 2000
"""Number of crossings drawn with dots of full size; larger numbers have smaller dots."""


def draw_crossings(events: Events, components: Any = None, axes: Any = None) -> Figure:
    """Draw the crossings found by events, for two coordinates (right, up); by default those that vary most.

    Raises TypeError or ValueError without crossings, for matrix states, or for unknown coordinates.
    """
    need("pictures", "matplotlib")
    from coadjoint.pictures.figure import ShownFigure

    names = events.coordinates
    across, up = places(events, components)
    if axes is None:
        axes = ShownFigure(figsize=(5.2, 4.8), layout="constrained").add_subplot()
    plain_axes(axes)
    size = 2.0 if len(events) <= MAX_LARGE_DOTS else max(0.15, 2.0 * (MAX_LARGE_DOTS / len(events)) ** 0.5)
    for i, colour in enumerate(COLOURS):
        own = events.member % len(COLOURS) == i
        if own.any():
            x = events.x[own]
            style = {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0}
            axes.plot(x[:, across], x[:, up], color=colour, rasterized=True, **style)
    axes.set(xlabel=coordinate(names[across]), ylabel=coordinate(names[up]))
    axes.set_title(f"{len(events)} crossings of {', '.join(events.names)}")
    found: Figure = axes.figure
    return found


def places(events: Events, components: Any = None) -> tuple[int, int]:
    """Return the indices of the coordinates drawn (right, up); arguments and errors of `draw_crossings`."""
    names = events.coordinates
    if len(names) < 2:
        raise TypeError("crossings of matrix states cannot be drawn; plot two quantities computed from the states")
    if not len(events):
        raise ValueError("there are no crossings to draw; take a longer run, or another event")
    if components is None:
        most = np.argsort(-np.std(events.x, axis=0), kind="stable")[:2]
        across, up = sorted(most.tolist())
        return across, up
    chosen = read_list(components, "components", "give two numbers or names of coordinates")
    if len(chosen) != 2:
        raise ValueError(f"components has {len(chosen)} entries; give two numbers or names of coordinates")
    across, up = (
        names.index(read_choice(one, "coordinate", names))
        if isinstance(one, str)
        else read_integer(one, "a coordinate", 0, len(names) - 1)
        for one in chosen
    )
    return across, up
