"""Phase portraits: one quantity over another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.paths import MemberColours, PathUpdate
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import dots, plain_axes, set_title, thickness

Floats = npt.NDArray[np.float64]


@kind("phase portrait", moves=True)
def phase_portrait(
    drawn: PlottedRun,
    across: int | str | Callable[[Any], Any] = 0,
    up: int | str | Callable[[Any], Any] = 1,
    labels: tuple[str, str] | None = None,
    cyclic: float = 0.0,
    equal: bool = False,
    title: str = "phase portrait",
) -> Paint:
    """Show a coordinate or function of the state over another one, with one colour per member.

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
    """
    for chosen in (across, up):
        if isinstance(chosen, int) and chosen >= drawn.n:
            raise CannotShow(f"coordinate {chosen} is drawn, and the state has {drawn.n}")
    saved, drawn = drawn, drawn.refined
    values = [_evaluate(drawn, chosen) for chosen in (across, up)]
    names = labels or tuple("" if callable(chosen) else drawn.label(drawn.index_of(chosen)) for chosen in (across, up))

    def paint(axes: Any) -> Update:
        shades, update = MemberColours(saved), PathUpdate(saved, axes, title)
        for m, (x, y) in enumerate(zip(*values, strict=True)):
            times, shown_x, shown_y = drawn.t[drawn.curve_indices], x, y
            if cyclic > 0.0:
                x = _wrap(x, cyclic)
                # NaN interrupts the curve where it wraps around.
                jumps = np.flatnonzero(np.abs(np.diff(x)) > 0.5 * cyclic) + 1
                shown_x, shown_y = np.insert(x, jumps, np.nan), np.insert(y, jumps, np.nan)
                times = np.insert(times, jumps, times[jumps])
            style: dict[str, Any] = {"linewidth": thickness(0.9)} if drawn.joined else dots(len(x))
            lines = axes.plot(shown_x, shown_y, color=shades[m], **style)
            axes.plot(x[:1], y[:1], "o", markersize=4, color=shades[m])
            update.add(lines, times, np.stack([shown_x, shown_y], axis=-1))
        axes.set(xlabel=names[0], ylabel=names[1])
        set_title(axes, f"{title} (dot: start)")
        if cyclic > 0.0:
            axes.set_xlim(-0.5 * cyclic, 0.5 * cyclic)
        plain_axes(axes)
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
