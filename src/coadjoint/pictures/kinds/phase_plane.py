"""Planes of two quantities: phase portraits, Poincare sections, and second moments as ellipses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.analysis_figures import draw_crossings, drawn_coordinates
from coadjoint.pictures.curves import MemberColours, PathUpdate
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import (
    colour,
    colour_bar,
    colour_scale,
    ink,
    legend,
    path_style,
    plain_axes,
    set_title,
    thickness,
)
from coadjoint.validation import read_integer, read_number

Floats = npt.NDArray[np.float64]

Lump = tuple[Any, Any, Any, Any, Any]


@kind("phase portrait", moves=True)
def phase_portrait(
    drawn: PlottedRun,
    across: int | str | Callable[[Any], Any] = 0,
    up: int | str | Callable[[Any], Any] = 1,
    labels: tuple[str, str] | None = None,
    cyclic: float = 0.0,
    equal: bool = False,
    title: str = "phase portrait",
    curves: Callable[[int], Sequence[str]] | None = None,
) -> Paint:
    """Show a coordinate or function of the state over another one, with one colour per member, or per curve.

    Parameters
    ----------
    across, up : int, str or callable
        Coordinate by number or name, or function of the states, (..., n) to (...).
    labels : (str, str), optional
        Labels of the axes.
    cyclic : float
        Positive: period of the horizontal quantity; the curve wraps around.
    equal : bool
        Whether both axes have the same scale.
    title : str
        Title of the picture.
    curves : callable, optional
        Function of the dimension that returns the names of several curves; `across` and `up` return (..., curves).
    """
    saved, drawn = drawn, drawn.refined
    values = [_evaluate(drawn, chosen) for chosen in (across, up)]
    shown = (None,) if curves is None else tuple(curves(drawn.n))
    if not shown:
        raise CannotShow(f"the state of {drawn.unforced.name} has no second body or part for this picture")
    names = labels or tuple("" if callable(chosen) else drawn.label(drawn.index_of(chosen)) for chosen in (across, up))

    def paint(axes: Any) -> Update:
        shades, update, several = MemberColours(saved), PathUpdate(saved, axes, title), len(shown) > 1
        # (members, k, curves)
        series = [array if curves is not None else array[..., None] for array in values]
        for m, i in np.ndindex(len(drawn.x), len(shown)):
            x, y = (array[m, :, i] for array in series)
            times, shown_x, shown_y = drawn.t[drawn.curve_indices], x, y
            if cyclic > 0.0:
                x = _wrap(x, cyclic)
                # NaN interrupts the curve where it wraps around.
                jumps = np.flatnonzero(np.abs(np.diff(x)) > 0.5 * cyclic) + 1
                shown_x, shown_y = np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)
                times = np.insert(times, jumps, times[jumps])
            shade, label = (colour(i), shown[i] if m == 0 else None) if several else (shades[m], None)
            lines = axes.plot(shown_x, shown_y, color=shade, label=label, **path_style(len(x), drawn.joined, 0.9))
            axes.plot(x[:1], y[:1], "o", markersize=4, color=shade)
            update.add(lines, times, np.stack([shown_x, shown_y], axis=-1))
        axes.set(xlabel=names[0], ylabel=names[1])
        set_title(axes, f"{title} (dot: start)")
        if cyclic > 0.0:
            axes.set_xlim(-0.5 * cyclic, 0.5 * cyclic)
        plain_axes(axes)
        if several:
            legend(axes, beside=True)
        else:
            shades.add_bar(axes)
        if equal:
            axes.set_aspect("equal", adjustable="datalim")
        return update

    return paint


def _evaluate(drawn: PlottedRun, chosen: Any) -> Floats:
    x = drawn.x[:, drawn.curve_indices]
    with np.errstate(all="ignore"):  # nonfinite values are not drawn
        return np.asarray(chosen(x)) if callable(chosen) else x[..., drawn.index_of(chosen)]


def _wrap(values: Floats, cyclic: float) -> Floats:
    return values - cyclic * np.rint(values / cyclic)


@kind("phase ellipse")
def phase_ellipse(
    drawn: PlottedRun,
    moments: Sequence[int | str] | None = None,
    lumps: Callable[[Any, int], Sequence[Lump]] | None = None,
    times: int = 9,
    until: float | None = None,
    labels: tuple[str, str] = ("position $q$", "momentum $p$"),
) -> Paint:
    """Show the ellipse of one standard deviation at evenly spaced times, for the first member.

    Parameters
    ----------
    moments : sequence of three ints or str
        The coordinates ``<qq>``, ``<qp>`` and ``<pp>`` of one distribution about the origin.
    lumps : callable
        Alternative: function of the states (k, n) and of the system that returns, for each of several distributions,
        its centre (q, p) and its second moments qq, qp, pp, each (k,).
    times : int
        Number of ellipses of each distribution.
    until : float, optional
        The last time drawn, as a fraction of the span.
    labels : (str, str)
        Labels of the axes.
    """
    count, x = read_integer(times, "times", 2), drawn.x[0]
    if moments is not None:
        qq, qp, pp = (x[:, drawn.index_of(i)] for i in moments)
        distributions: Sequence[Lump] = [(0.0 * qq, 0.0 * qq, qq, qp, pp)]
    elif lumps is not None:
        distributions = lumps(x, drawn.unforced)
    else:
        raise TypeError("a phase ellipse needs `moments`, the coordinates of second moments, or a function `lumps`")
    end = drawn.index_at(1.0 if until is None else read_number(until, "until")) + 1

    def paint(axes: Any) -> None:
        indices = spread(end, count)
        shades, width = colour_scale(drawn.t[indices], "plasma"), thickness(1.2)
        for q, p, qq, qp, pp in distributions:
            axes.plot(q[:end], p[:end], color=ink(), linewidth=thickness(0.4), alpha=0.6)
            for k in indices:
                axes.plot(
                    *_ellipse(q[k], p[k], qq[k], qp[k], pp[k]),
                    color=shades.to_rgba(drawn.t[k]),
                    linewidth=width,
                )
        colour_bar(axes, shades, "time $t$")
        axes.set(xlabel=labels[0], ylabel=labels[1], title=f"ellipses of one standard deviation{drawn.of_member}")
        plain_axes(axes)

    return paint


def _ellipse(q: float, p: float, qq: float, qp: float, pp: float) -> Any:
    """Return the curve (q, p) + L (cos, sin), with L L^T the matrix of moments; NaN if that is not positive."""
    turn = np.linspace(0.0, 2.0 * np.pi, 121)
    if not (qq > 0.0 and qq * pp - qp * qp >= 0.0):
        return np.full((2, 1), np.nan)
    first, second = np.sqrt(qq), np.sqrt(max(pp - qp * qp / qq, 0.0))
    return q + first * np.cos(turn), p + (qp / first) * np.cos(turn) + second * np.sin(turn)


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
