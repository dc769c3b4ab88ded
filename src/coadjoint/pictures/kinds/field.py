"""A field in the plane whose amplitudes are the state: the vorticity of a fluid kept to a few waves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from coadjoint.given import read_number, read_positive
from coadjoint.pictures.drawn import Drawn
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import INK

CELLS = 160
LEVELS = 21


@kind("field")
def field(
    drawn: Drawn, modes: Callable[..., Any], width: Callable[[Any], float], at: float = 0.0, label: str = "field"
) -> Paint:
    """Show the sum of the modes, each times its coordinate, at one time.

    Parameters
    ----------
    drawn : Drawn
        The run; of several members the first.
    modes : callable
        Function of the system and of places X, Y, (k, k), that returns the modes, (n, k, k).
    width : callable
        Function of the system that returns how wide the square is that is shown.
    at : float
        The time, as a part of the span: 0 is the start, 1 the end.
    label : str
        What the field is.

    Returns
    -------
    Paint
    """
    part = min(max(read_number(at, "at"), 0.0), 1.0)
    k = round(part * (len(drawn.t) - 1))
    edge = np.linspace(0.0, read_positive(width(drawn.family), "width"), CELLS + 1)
    waves = np.asarray(modes(drawn.family, *np.meshgrid(edge, edge)))
    if len(waves) != drawn.n:
        raise CannotShow(f"the field has {len(waves)} modes, and the state has {drawn.n} coordinates")
    values = np.tensordot(drawn.x[0, k], waves, axes=1)
    # One scale for all times: no wave is larger than 1, so that this is never left.
    size = float(np.abs(np.tensordot(np.abs(drawn.x[0]), np.abs(waves).max(axis=(1, 2)), axes=1)).max()) or 1.0

    def paint(axes: Any) -> None:
        from matplotlib.ticker import MaxNLocator

        levels = np.linspace(-size, size, LEVELS)
        drawn_field = axes.contourf(edge, edge, values, levels, cmap="RdBu_r")
        bar = axes.figure.colorbar(drawn_field, ax=axes, shrink=0.7, pad=0.02, ticks=MaxNLocator(5))
        bar.set_label(label, fontsize=9)
        bar.ax.tick_params(labelsize=8)
        axes.tick_params(width=0.6, length=3.0, labelsize=8, colors=INK)
        axes.set(xlabel="$X$", ylabel="$Y$")
        axes.set_aspect("equal")
        axes.set_title(f"{label} at $t$ = {drawn.t[k]:.4g}", fontsize=9.5, color=INK)

    return paint
