"""Components of the state, or functions of them, over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import MemberColours, draw_members, draw_series, from_start
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import Paint, Update, kind
from coadjoint.pictures.style import colour, coordinate, ink, legend, plain_axes, setting, thickness

MAX_COMPONENTS = 8  # as many as there are colours
BISECTIONS = 52  # halvings of an interval, to the last bit of its length

Floats = npt.NDArray[np.float64]
Function = Callable[[Any], Any]


@kind("components", over_time=True, moves=True)
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
    n, saved, drawn = drawn.n, drawn, drawn.refined
    chosen = chosen(n) if callable(chosen) else chosen
    functions = functions(n) if callable(functions) else functions
    indices = [drawn.index_of(i) for i in chosen or ()]
    if chosen is None and functions is None:
        indices = spread(n, MAX_COMPONENTS).tolist()
    lines = {drawn.label(i): drawn.x[..., i] for i in indices}
    for name, function in (functions or {}).items():
        with np.errstate(all="ignore"):  # nonfinite values are not drawn
            lines[coordinate(name)] = np.asarray(function(drawn.x))
    lines, note = from_start(lines)
    flip_index = None if flips is None else drawn.index_of(flips)

    def paint(axes: Any) -> Update:
        shades = MemberColours(saved)
        by_member = len(drawn.x) > 1 and len(lines) == 1
        for line, (label, members) in enumerate(lines.items()):
            if by_member:
                for m, values in enumerate(members):
                    draw_series(axes, drawn.t, values, drawn.dense, color=shades[m], linewidth=thickness(0.7))
            else:
                draw_members(axes, drawn.t, members, drawn.dense, colour(line), label)
        name = drawn.quantity if quantity is None else quantity
        title = f"components of the {name}"
        if quantity is not None or functions is not None or by_member:
            title = f"{name} over time"
        if chosen is None and functions is None and len(indices) < n:
            title += f" ({len(indices)} of {n})"
        ylabel = name
        if by_member:
            ylabel = f"{name} {next(iter(lines))}"
        elif all(label.startswith("$x_{") for label in lines):
            ylabel = f"{name} $x_i$"
        axes.set(xlabel="time $t$", ylabel=ylabel + note, title=title)
        plain_axes(axes)
        if by_member:
            shades.add_bar(axes)
        else:
            legend(axes, beside=True)
        if flip_index is not None:
            _mark_flips(axes, drawn, flip_index)
        return _cursor(axes, saved, title)

    return paint


def _cursor(axes: Any, drawn: PlottedRun, title: str) -> Update:
    """Return the update of a picture over time: a line at the time, added by the first call."""
    lines: list[Any] = []

    def update(k: int) -> None:
        if not lines:
            lines.append(axes.axvline(drawn.t[k], color=ink(), linewidth=thickness(0.8)))
        lines[0].set_xdata([drawn.t[k], drawn.t[k]])
        axes.title.set_text(f"{title}, $t$ = {drawn.t[k]:.4g}")

    return update


def _mark_flips(axes: Any, drawn: PlottedRun, i: int) -> None:
    if len(drawn.x) > 1 or not drawn.dense:
        return
    times = flip_times(drawn.slope, drawn.t, drawn.x[0], i, max_count=2)
    # An arrow between closer times would not be visible.
    if len(times) < 2 or abs(times[1] - times[0]) < 0.05 * abs(drawn.t[-1] - drawn.t[0]):
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.22 * (high - low))
    height = high + 0.07 * (high - low)
    for time in times:
        axes.plot([time, time], [0.0, height], color=ink(), linewidth=0.6, linestyle=":")
    arrow = {"arrowstyle": "<->", "color": ink(), "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=(times[1], height), xytext=(times[0], height), arrowprops=arrow)
    text = f"{drawn.label(i)} changes sign after {abs(times[1] - times[0]):.6g}"
    left, right = axes.get_xlim()
    middle = (times.mean() - left) / (right - left)
    side = "left" if middle < 0.3 else "right" if middle > 0.7 else "center"
    position = {"left": times.min(), "right": times.max(), "center": times.mean()}[side]
    axes.text(position, height, text, ha=side, va="bottom", fontsize=setting("legend.fontsize"), color=ink())


def flip_times(
    field: Callable[[Floats, float], Floats], t: Floats, x: Floats, i: int, max_count: int | None = None
) -> Floats:
    """Return the first `max_count` times at which coordinate i of a motion crosses zero, by cubic interpolation."""
    values = x[:, i]
    intervals = np.flatnonzero((values[:-1] != 0.0) & (np.sign(values[:-1]) * np.sign(values[1:]) <= 0.0))
    times = []
    for p in intervals[:max_count]:
        dt = float(t[p + 1] - t[p])
        before, after = (dt * float(field(x[q], float(t[q]))[i]) for q in (p, p + 1))
        times.append(float(t[p]) + dt * _root(float(values[p]), float(values[p + 1]), before, after))
    return np.array(times)


def _root(a: float, b: float, slope: float, end_slope: float) -> float:
    """Return the zero in [0, 1] of a cubic Hermite polynomial with a change of sign, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        s = 0.5 * (low + high)
        r = 1.0 - s
        value = a * r * r * (1 + 2 * s) + b * s * s * (3 - 2 * s) + s * r * (slope * r - end_slope * s)
        low, high = (s, high) if (value > 0.0) == (a > 0.0) else (low, s)
    return 0.5 * (low + high)
