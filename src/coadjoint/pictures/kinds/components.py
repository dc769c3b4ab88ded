"""Components of the state, or functions of them, over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import Paint, kind
from coadjoint.pictures.series import draw_members
from coadjoint.pictures.sign_changes import flips as flips_of
from coadjoint.pictures.style import INK, colour, coordinate, key, plain_axes

MAX_COMPONENTS = 8

Function = Callable[[Any], Any]


@kind("components", over_time=True)
def components(
    drawn: PlottedRun,
    chosen: Sequence[int | str] | Callable[[int], Sequence[int]] | None = None,
    functions: Mapping[str, Function] | Callable[[int], Mapping[str, Function]] | None = None,
    flips: int | str | None = None,
    quantity: str | None = None,
) -> Paint:
    """Show components over time; at most eight, evenly spread.

    Parameters
    ----------
    chosen : sequence of int or str, or callable, optional
        The components, by number from 0 or by name; or a function of the dimension that returns them.
    functions : mapping of str to callable, or callable, optional
        Name to function of the states, (..., n) to (...): drawn in place of components, or in addition to those that
        are `chosen`. Or a function of the dimension that returns them.
    flips : int or str, optional
        A component whose changes of sign are marked, with the time between them.
    quantity : str, optional
        Label of the axis; by default the quantity of the coordinates of the system.
    """
    n, drawn = drawn.n, drawn.between
    chosen = chosen(n) if callable(chosen) else chosen
    functions = functions(n) if callable(functions) else functions
    places = [drawn.place(i) for i in chosen or ()]
    if chosen is None and functions is None:
        places = spread(n, MAX_COMPONENTS).tolist()
    lines = {drawn.label(i): drawn.x[..., i] for i in places}
    for name, function in (functions or {}).items():
        with np.errstate(all="ignore"):  # nonfinite values are not drawn
            lines[coordinate(name)] = np.asarray(function(drawn.x))
    flipping = None if flips is None else drawn.place(flips)

    def paint(axes: Any) -> None:
        by_member = len(drawn.x) > 1 and len(lines) == 1
        for place, (label, members) in enumerate(lines.items()):
            if by_member:
                for m, values in enumerate(members):
                    draw_members(axes, drawn.t, values[None], drawn.close, colour(m), None)
            else:
                draw_members(axes, drawn.t, members, drawn.close, colour(place), label)
        what = drawn.quantity if quantity is None else quantity
        title = f"components of the {what}"
        if quantity is not None or functions is not None or by_member:
            title = f"{what} over time"
        if chosen is None and functions is None and len(places) < n:
            title += f" ({len(places)} of {n})"
        symbol = what
        if by_member:
            symbol = f"{what} {next(iter(lines))}"
        elif all(name.startswith("$x_{") for name in lines):
            symbol = f"{what} $x_i$"
        axes.set(xlabel="time $t$", ylabel=symbol, title=title)
        plain_axes(axes)
        if not by_member:
            key(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        if flipping is not None:
            _mark_flips(axes, drawn, flipping)

    return paint


def _mark_flips(axes: Any, drawn: PlottedRun, i: int) -> None:
    if len(drawn.x) > 1 or not drawn.close:
        return
    times = flips_of(drawn.slope, drawn.t, drawn.x[0], i, most=2)
    # Too close for a visible arrow between them.
    if len(times) < 2 or abs(times[1] - times[0]) < 0.05 * abs(drawn.t[-1] - drawn.t[0]):
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.22 * (high - low))
    height = high + 0.07 * (high - low)
    for time in times:
        axes.plot([time, time], [0.0, height], color=INK, linewidth=0.6, linestyle=":")
    arrow = {"arrowstyle": "<->", "color": INK, "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=(times[1], height), xytext=(times[0], height), arrowprops=arrow)
    text = f"{drawn.label(i)} changes sign after {abs(times[1] - times[0]):.6g}"
    left, right = axes.get_xlim()
    middle = (times.mean() - left) / (right - left)
    side = "left" if middle < 0.3 else "right" if middle > 0.7 else "center"
    where = {"left": times.min(), "right": times.max(), "center": times.mean()}[side]
    axes.text(where, height, text, ha=side, va="bottom", fontsize=8, color=INK)
