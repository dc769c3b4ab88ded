"""Draw `docs/layers.svg`, the layers of the library: ``python docs/draw_layers.py``."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

PICTURE = Path(__file__).with_name("layers.svg")
LAYERS = {
    "algebra": ("where does\nthe state live?", 0.0, 0.0),
    "systems": ("what moves?", 1.0, 0.0),
    "program": ("as which\nexact flows?", 2.0, 0.0),
    "kernels": ("how fast?", 3.0, 0.0),
    "methods": ("by which\nscheme?", 4.0, 0.0),
    "runs": ("for how long?", 5.0, 0.0),
    "choosing": ("with which\nscheme and step?", 6.2, 1.95),
    "files": ("saved where,\nread from what?", 6.2, 0.65),
    "analysis": ("what is it worth?", 6.2, -0.65),
    "pictures": ("what does\nit look like?", 6.2, -1.95),
    "experiments": ("does it hold?", 7.4, -1.3),
    "checkcases": ("do others\nagree?", 7.4, 1.95),
}
"""Layer: its question, and its place. A layer uses layers to its left, and those above it in this list."""
SHORTCUTS = {"choosing": "accuracy=", "files": "to_xarray", "analysis": "modified_energy", "pictures": "plot"}
"""Shortcuts of `runs` into later layers, through `coadjoint.shortcuts`: layer -> label of the arrow."""
NEIGHBOURS = {("analysis", "pictures"): "plot"}
"""Shortcuts between layers at one place, such as `Certificate.plot`."""
WIDE, HIGH = 0.84, 0.92
INK, FILL, COMPILED = "#1f2d3d", "#eef3f8", "#f7e7cf"


def draw() -> Any:
    """Return the figure."""
    import matplotlib
    from matplotlib.figure import Figure

    matplotlib.rcParams["svg.hashsalt"] = "layers"
    figure = Figure(figsize=(12.2, 5.2), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1), xlim=(-0.6, 8.0), ylim=(-2.95, 2.6))
    axes.axis("off")
    for name, (question, x, y) in LAYERS.items():
        _box(axes, name, question, x, y, COMPILED if name == "kernels" else FILL)
    chain = list(LAYERS)[:6]
    for left, right in pairwise(chain):
        _arrow(axes, (LAYERS[left][1] + WIDE / 2, 0), (LAYERS[right][1] - WIDE / 2, 0))
    for name in ("choosing", "files", "analysis", "pictures"):
        _, x, y = LAYERS[name]
        _arrow(axes, (5 + WIDE / 2, 0.12 * y), (x - WIDE / 2, y))
        if name in SHORTCUTS:
            side = 1 if y > 0 else -1
            end = (4.85 + 0.3 * (abs(y) < 1), side * HIGH / 2)
            _arrow(axes, (x - WIDE / 2, y + 0.3 * side), end, dashed=True, bend=0.3 * side)
            label = {"ha": "right", "va": "center", "color": INK, "size": 8.5}
            paper = {"facecolor": "white", "edgecolor": "none", "pad": 1}
            axes.text(x - WIDE / 2 - 0.08, y + 0.43 * side, SHORTCUTS[name], **label, bbox=paper)
    for (above, below), said in NEIGHBOURS.items():
        x, top, bottom = LAYERS[above][1] - 0.2, LAYERS[above][2] - HIGH / 2, LAYERS[below][2] + HIGH / 2
        _arrow(axes, (x, bottom), (x, top), dashed=True)
        axes.text(x + 0.06, (top + bottom) / 2, said, ha="left", va="center", color=INK, size=8.5)
    for name in ("analysis", "pictures"):
        _arrow(axes, (6.2 + WIDE / 2, LAYERS[name][2]), (7.4 - WIDE / 2, -1.3))
    _box(axes, "source", "the loops,\nin C++", 3.0, -1.5, COMPILED)
    _arrow(axes, (3.0 - 0.12, -HIGH / 2), (3.0 - 0.12, -1.5 + HIGH / 2))
    _arrow(axes, (3.0 + 0.12, -1.5 + HIGH / 2), (3.0 + 0.12, -HIGH / 2))
    _box(axes, "cli.py", "the command\ncoadjoint", 7.4, 0.65, "white")
    for y, end in ((0.65, 0.65), (-0.5, 0.5)):
        _arrow(axes, (6.2 + WIDE / 2, y), (7.4 - WIDE / 2, end))
    _arrow(axes, (7.4, -1.3 + HIGH / 2), (7.4, 0.65 - HIGH / 2))
    _arrow(axes, (6.2 + WIDE / 2, 0.9), (7.4 - WIDE / 2, 1.8))
    _arrow(axes, (7.4, 1.95 - HIGH / 2), (7.4, 0.65 + HIGH / 2))
    notes = ("algebra, energy, state go in at the left", "solid: the results of a layer go to the right")
    for line, said in enumerate((*notes, "dashed: imported only when asked")):
        axes.text(-0.43, 2.2 - 0.3 * line, said, ha="left", va="center", color=INK, size=11, style="italic")
    return figure


def _box(axes: Any, name: str, question: str, x: float, y: float, fill: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    style = "round,pad=0,rounding_size=0.08"
    corner = (x - WIDE / 2, y - HIGH / 2)
    axes.add_patch(FancyBboxPatch(corner, WIDE, HIGH, boxstyle=style, facecolor=fill, edgecolor=INK, linewidth=1.2))
    axes.text(x, y + 0.2, name, ha="center", va="center", color=INK, size=11, weight="bold")
    axes.text(x, y - 0.17, question, ha="center", va="center", color=INK, size=8.5, linespacing=1.15)


def _arrow(
    axes: Any, start: tuple[float, float], end: tuple[float, float], *, dashed: bool = False, bend: float = 0
) -> None:
    from matplotlib.patches import FancyArrowPatch

    line = "dashed" if dashed else "solid"
    how = {"arrowstyle": "-|>", "mutation_scale": 13, "shrinkA": 2, "shrinkB": 2, "color": INK}
    width = 0.9 if dashed else 1.3
    axes.add_patch(
        FancyArrowPatch(start, end, connectionstyle=f"arc3,rad={bend}", linestyle=line, linewidth=width, **how)
    )


if __name__ == "__main__":
    draw().savefig(PICTURE, format="svg", metadata={"Date": None, "Creator": None})
