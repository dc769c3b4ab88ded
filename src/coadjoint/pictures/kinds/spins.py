"""Spins where they stand: arrows for what lies in the plane, colours for what points out of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.given import read_choice
from coadjoint.pictures.drawn import Drawn
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.sites import places_of_sites
from coadjoint.pictures.style import INK

FLAT = ("plane", "side")
SHADES = ("#0072B2", "#8A8A8A", "#D55E00")
"""Down, in the plane, up: the middle is dark enough for arrows on white."""


@kind("spins")
def spins(drawn: Drawn, at: float = 1.0, seen: str = "plane") -> Paint:
    """Show the spins of a lattice at one time.

    Parameters
    ----------
    drawn : Drawn
        The run; of several members the first.
    at : float
        The time, as a part of the span: 0 is the start, 1 the end.
    seen : {"plane", "side"}
        Arrows are the first two components and colours the third one; or arrows are the first and the third one and
        colours the second, as for a chain seen from the side.

    Returns
    -------
    Paint
    """
    n = drawn.n
    if n % 3:
        raise CannotShow(f"the state has {n} coordinates, which are no spins of three")
    parameters = drawn.family.parameters or {}
    places = places_of_sites(parameters.get("lattice"), parameters.get("shape"), n // 3)
    if len(places) != n // 3:
        raise CannotShow(f"the lattice has {len(places)} sites, and there are {n // 3} spins")
    flat, out = ((0, 1), 2) if read_choice(seen, "way to see spins", FLAT) == "plane" else ((0, 2), 1)
    k = drawn.at(at)
    S = drawn.x[0, k].reshape(-1, 3)
    size = float(np.linalg.norm(S, axis=1).max()) or 1.0

    def paint(axes: Any) -> None:
        from matplotlib.colors import LinearSegmentedColormap

        u, v = S[:, flat[0]] / size, S[:, flat[1]] / size
        shades = LinearSegmentedColormap.from_list("out of the plane", SHADES)
        style = {"angles": "xy", "scale_units": "xy", "scale": 1.05, "pivot": "mid", "cmap": shades}
        drawn_arrows = axes.quiver(
            *places.T, u, v, S[:, out] / size, clim=(-1.0, 1.0), width=0.006, headwidth=4.0, minlength=0.0, **style
        )
        axes.plot(*places.T, ".", markersize=1.5, color=INK, zorder=0)
        bar = axes.figure.colorbar(drawn_arrows, ax=axes, shrink=0.7, pad=0.02)
        bar.set_label(f"$S_{out + 1}$ over the largest $|S|$", fontsize=9)
        bar.ax.tick_params(labelsize=8)
        low, high = places.min(axis=0) - 0.8, places.max(axis=0) + 0.8
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
        axes.set_aspect("equal")
        axes.spines[:].set_visible(False)
        axes.set_title(
            f"spins at $t$ = {drawn.t[k]:g}: arrows $(S_{flat[0] + 1}, S_{flat[1] + 1})$", fontsize=9.5, color=INK
        )

    return paint
