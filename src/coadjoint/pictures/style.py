"""Colours and axes shared by all figures; no global state is changed."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from coadjoint.algebra.polynomials.polynomial_format import GREEK, latex_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's colours, distinct for colour-blind readers and in grey print; yellow is omitted as too light.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
INK = "#333333"
GRID = "#DDDDDD"


def colour(i: int) -> str:
    """Return the colour of line i, cyclically."""
    return COLOURS[i % len(COLOURS)]


def dots(count: int) -> dict[str, Any]:
    """Return the style of `count` unconnected points: smaller for many points, so that curves stay thin.

    Examples
    --------
    >>> dots(50)["markersize"], dots(20_000)["markersize"]
    (3.0, 1.0)
    """
    size = 3.0 if count <= 500 else max(1.0, 3.0 * (500 / count) ** 0.5)
    return {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0}


def plain_axes(axes: Axes) -> None:
    """Set thin lines, a light grid and no box on flat axes."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set(linewidth=0.6, color=INK)
    axes.tick_params(width=0.6, length=3.0, labelsize=8, colors=INK)
    axes.grid(True, linewidth=0.4, color=GRID)
    axes.set_axisbelow(True)
    axes.xaxis.label.set_fontsize(9)
    axes.yaxis.label.set_fontsize(9)
    axes.title.set_fontsize(9.5)


def legend(axes: Axes, **options: Any) -> None:
    """Add a legend, small and without a frame; `options` are those of `Axes.legend`."""
    created = axes.legend(**{"fontsize": 8, "frameon": False, "loc": "best", "handlelength": 2.2, **options})
    for line in created.get_lines():
        line.set(linewidth=max(1.0, line.get_linewidth()), alpha=1.0)


def symbol(name: str) -> str:
    r"""Return the name of an invariant, such as ``"energy"``, ``"|x|^2"`` or ``"log C"``, as mathematical text.

    Examples
    --------
    >>> print(symbol("|x|^2"), symbol("energy"), symbol("log C"), symbol("x1*x3 + x2^2"), symbol("my integral"))
    $|x|^2$ $H$ $\log C$ $x_{1}\,x_{3} + x_{2}^2$ my integral
    >>> print(symbol("|x|^2 [12]"), symbol("|total L|^2"), symbol("tr W Theta^3"))
    $|x|^2$ [12] |total L|^2 $\mathrm{tr}\,W\,\Theta^3$
    """
    if name == "energy":
        return "$H$"
    if name.startswith("tr "):
        return rf"$\mathrm{{tr}}\,{name[3:]}$".replace(" ", r"\,").replace("Theta", r"\Theta")
    if re.fullmatch(r"log \w", name):
        return rf"$\log {name[4:]}$"
    copy = re.fullmatch(r"(.+) (\[\d+\])", name)
    if copy is not None:
        return f"{symbol(copy[1])} {copy[2]}"
    has_words = re.search(r"[A-Za-z]{3}", name) is not None
    if re.fullmatch(r"[\w|^*+. -]*[|^*][\w|^*+. -]*", name) and not has_words:
        return "$" + re.sub(r"([a-z])(\d+)", r"\1_{\2}", name).replace("*", r"\,") + "$"
    return name.replace("$", r"\$")


def coordinate(name: str) -> str:
    r"""Return the name of a coordinate as mathematical text; long names stay plain text.

    Examples
    --------
    >>> print(coordinate("x12"), coordinate("gamma3"), coordinate("S1[7]"), coordinate("E"), coordinate("zonal wind"))
    $x_{12}$ $\gamma_{3}$ $S_{1}^{[7]}$ $E$ zonal wind
    """
    match = re.fullmatch(r"([A-Za-z]+?)_?([\d,]*)(\[\d+\])?", name)
    if match is None or (len(match[1]) > 2 and match[1] not in GREEK):
        return name.replace("$", r"\$")
    return f"${latex_name(name)}$"
