"""Spins at their lattice sites: arrows for the components in the plane, colours for the third one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, Update, kind
from coadjoint.pictures.style import INK
from coadjoint.validation import read_choice

Floats = npt.NDArray[np.float64]

FLAT = ("plane", "side")
SHADES = ("#0072B2", "#8A8A8A", "#D55E00")
"""Colours for down, in the plane, and up; the middle one is dark enough for arrows on white."""

COS_60, SIN_60 = 0.5, math.sqrt(0.75)
# Edges of a cell, and positions of its sites.
CELL_GEOMETRY: dict[str, tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]] = {
    "chain": (((1.0, 0.0),), ((0.0, 0.0),)),
    "square": (((1.0, 0.0), (0.0, 1.0)), ((0.0, 0.0),)),
    "triangular": (((1.0, 0.0), (COS_60, SIN_60)), ((0.0, 0.0),)),
    "honeycomb": (((2 * SIN_60, 0.0), (SIN_60, 1.5)), ((0.0, 0.0), (SIN_60, COS_60))),
    "kagome": (((2.0, 0.0), (1.0, 2 * SIN_60)), ((0.0, 0.0), (1.0, 0.0), (COS_60, SIN_60))),
}

SITES_PER_ROW = 30
"""Largest number of sites in one row; longer chains are folded into rows, like text."""


@kind("spins", moves=True)
def spins(drawn: PlottedRun, at: float = 1.0, seen: str = "plane") -> Paint:
    """Show the spins of a lattice at one time, for the first member.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    seen : {"plane", "side"}
        "plane": arrows show the first two components, and colours the third. "side": arrows show the first and the
        third component, and colours the second.
    """
    n = drawn.n
    if n % 3:
        raise CannotShow(f"the state has {n} coordinates, which are not spins of three components")
    layout = getattr(drawn.unforced, "layout", None) or drawn.unforced.parameters or {}
    lattice = layout.get("lattice")
    positions = site_positions(lattice, layout.get("shape"), n // 3)
    if len(positions) != n // 3:
        raise CannotShow(f"the lattice has {len(positions)} sites, and there are {n // 3} spins")
    row = sites_of_row(lattice, n // 3)
    folded = "" if row == n // 3 else f"\nrows of {row} sites, the first one above"
    if n > 3 and lattice is None:
        folded = "\non a circle, since the lattice is not known"
    flat, out = ((0, 1), 2) if read_choice(seen, "way to see spins", FLAT) == "plane" else ((0, 2), 1)
    k = drawn.index_at(at)
    size = float(np.linalg.norm(drawn.x[0, k].reshape(-1, 3), axis=1).max()) or 1.0

    def arrows(j: int) -> tuple[Any, ...]:
        S = drawn.x[0, j].reshape(-1, 3) / size
        return S[:, flat[0]], S[:, flat[1]], S[:, out]

    def title_at(j: int) -> str:
        return f"spins at $t$ = {drawn.t[j]:g}: arrows $(S_{flat[0] + 1}, S_{flat[1] + 1})${folded}"

    def paint(axes: Any) -> Update:
        from matplotlib.colors import LinearSegmentedColormap

        shades = LinearSegmentedColormap.from_list("out of the plane", SHADES)
        style = {"angles": "xy", "scale_units": "xy", "scale": 1.05, "pivot": "mid", "cmap": shades}
        drawn_arrows = axes.quiver(
            *positions.T, *arrows(k), clim=(-1.0, 1.0), width=0.006, headwidth=4.0, minlength=0.0, **style
        )
        axes.plot(*positions.T, ".", markersize=1.5, color=INK, zorder=0)
        bar = axes.figure.colorbar(drawn_arrows, ax=axes, shrink=0.7, pad=0.02)
        bar.set_label(f"$S_{out + 1}$ over the largest $|S|$", fontsize=9)
        bar.ax.tick_params(labelsize=8)
        low, high = positions.min(axis=0) - 0.8, positions.max(axis=0) + 0.8
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xticks=[], yticks=[])
        axes.set_aspect("equal")
        axes.spines[:].set_visible(False)
        title = axes.set_title(title_at(k), fontsize=9.5, color=INK)

        def update(j: int) -> None:
            drawn_arrows.set_UVC(*arrows(j))
            title.set_text(title_at(j))

        return update

    return paint


def sites_of_row(lattice: Any, count: int) -> int:
    """Return the number of sites per row of a folded chain, `count` if it is not folded.

    Examples
    --------
    >>> sites_of_row("chain", 20), sites_of_row("chain", 100), sites_of_row("square", 100)
    (20, 15, 100)
    """
    return count if lattice != "chain" or count <= SITES_PER_ROW else math.ceil((2.0 * count) ** 0.5)


def site_positions(lattice: Any, shape: Any, count: int) -> Floats:
    """Return the positions (count, 2) of sites in the plane, cell by cell, along the last axis of `shape` first.

    Long chains are folded into rows, the first on top; rings and general graphs are drawn as a circle. Raises
    CannotShow for three-dimensional lattices.
    """
    if lattice == "cubic":
        raise CannotShow("the lattice is three-dimensional, and spins are drawn in a plane")
    if not isinstance(lattice, str) or lattice not in CELL_GEOMETRY or shape is None:
        turn = 2.0 * np.pi * np.arange(count) / count
        return np.stack([np.sin(turn), np.cos(turn)], axis=-1) * max(1.0, count / 6.0)
    row = sites_of_row(lattice, count)
    if row < count:
        site = np.arange(count)
        return np.stack([site % row, -1.4 * (site // row)], axis=-1)
    edges, sites = (np.array(part) for part in CELL_GEOMETRY[lattice])
    sizes = np.atleast_1d(shape).tolist()
    cells = np.indices(sizes).reshape(len(sizes), -1).T @ edges
    return (cells[:, None] + sites[None]).reshape(-1, 2)
