"""Spins at their lattice sites: arrows for the components in the plane, colours for the third one."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.site_positions import places_of_sites, sites_of_row
from coadjoint.pictures.style import INK
from coadjoint.validation import read_choice

FLAT = ("plane", "side")
SHADES = ("#0072B2", "#8A8A8A", "#D55E00")
"""Down, in the plane, up; the middle is dark enough for arrows on white."""


@kind("spins", moves=True)
def spins(drawn: PlottedRun, at: float = 1.0, seen: str = "plane") -> Paint:
    """Show the spins of a lattice at one time, for the first member.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    seen : {"plane", "side"}
        Arrows are the first two components and colours the third one; or arrows are the first and the third one and
        colours the second, as for a chain seen from the side.
    """
    n = drawn.n
    if n % 3:
        raise CannotShow(f"the state has {n} coordinates, which are not spins of three components")
    layout = getattr(drawn.family, "layout", None) or drawn.family.parameters or {}
    lattice = layout.get("lattice")
    places = places_of_sites(lattice, layout.get("shape"), n // 3)
    if len(places) != n // 3:
        raise CannotShow(f"the lattice has {len(places)} sites, and there are {n // 3} spins")
    row = sites_of_row(lattice, n // 3)
    folded = "" if row == n // 3 else f"\nrows of {row} sites, the first one above"
    if n > 3 and lattice is None:
        folded = "\non a circle, since the lattice is not known"
    flat, out = ((0, 1), 2) if read_choice(seen, "way to see spins", FLAT) == "plane" else ((0, 2), 1)
    k = drawn.at(at)
    size = float(np.linalg.norm(drawn.x[0, k].reshape(-1, 3), axis=1).max()) or 1.0

    def arrows(j: int) -> tuple[Any, ...]:
        S = drawn.x[0, j].reshape(-1, 3) / size
        return S[:, flat[0]], S[:, flat[1]], S[:, out]

    def titled(j: int) -> str:
        return f"spins at $t$ = {drawn.t[j]:g}: arrows $(S_{flat[0] + 1}, S_{flat[1] + 1})${folded}"

    def paint(axes: Any) -> Update:
        from matplotlib.colors import LinearSegmentedColormap

        shades = LinearSegmentedColormap.from_list("out of the plane", SHADES)
        style = {"angles": "xy", "scale_units": "xy", "scale": 1.05, "pivot": "mid", "cmap": shades}
        drawn_arrows = axes.quiver(
            *places.T, *arrows(k), clim=(-1.0, 1.0), width=0.006, headwidth=4.0, minlength=0.0, **style
        )
        axes.plot(*places.T, ".", markersize=1.5, color=INK, zorder=0)
        bar = axes.figure.colorbar(drawn_arrows, ax=axes, shrink=0.7, pad=0.02)
        bar.set_label(f"$S_{out + 1}$ over the largest $|S|$", fontsize=9)
        bar.ax.tick_params(labelsize=8)
        low, high = places.min(axis=0) - 0.8, places.max(axis=0) + 0.8
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
        axes.set_aspect("equal")
        axes.spines[:].set_visible(False)
        title = axes.set_title(titled(k), fontsize=9.5, color=INK)

        def update(j: int) -> None:
            drawn_arrows.set_UVC(*arrows(j))
            title.set_text(titled(j))

        return update

    return paint
