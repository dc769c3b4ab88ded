"""Settings, colours and axes shared by all figures."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from coadjoint.algebra.polynomials.monomials import GREEK, latex_name
from coadjoint.errors import in_one_line, nearest
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Function = TypeVar("Function", bound=Callable[..., Any])

# Okabe and Ito's colours, distinct for colour-blind readers and in grey print; yellow is omitted as too light.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
INK = "#333333"
GRID = "#DDDDDD"
NARROW = 5.0
"""Figures of smaller width (inches) have smaller text."""

SIZES = {
    "figure.titlesize": 10.5,
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
}
"""Sizes of text in points, used unless the user has changed ``font.size``."""
NARROW_SIZE = 0.84
"""Factor of the sizes of text in narrow figures: labels of 7.5 points."""
SETTINGS: dict[str, Any] = {
    "axes.edgecolor": INK,
    "axes.formatter.useoffset": False,
    "axes.labelcolor": INK,
    "axes.labelpad": 3.0,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlepad": 5.0,
    "grid.color": GRID,
    "grid.linewidth": 0.4,
    "legend.frameon": False,
    "legend.handlelength": 1.8,
    "lines.linewidth": 1.0,
    "text.color": INK,
    "xtick.color": INK,
    "xtick.major.size": 3.0,
    "xtick.major.width": 0.6,
    "ytick.color": INK,
    "ytick.major.size": 3.0,
    "ytick.major.width": 0.6,
}
"""Settings of Matplotlib for figures; those that the user has changed from Matplotlib's default remain."""


@contextmanager
def figure_settings(style: Any = None, width: float | None = None) -> Iterator[None]:
    """Apply a style of Matplotlib and the settings of figures, below those of the user, and restore them at the end."""
    import matplotlib
    from matplotlib import style as styles

    try:
        context = styles.context([] if style is None else style)
        context.__enter__()
    except (OSError, TypeError, AttributeError):
        near = nearest(style, styles.available) if isinstance(style, str) else None
        hint = f"did you mean {near!r}?" if near else "give the name of a style of Matplotlib, or a mapping of rcParams"
        raise ValueError(f"style is {short(style)}, which Matplotlib does not know; {hint}") from None
    except (KeyError, ValueError) as reason:
        message = in_one_line(str(reason.args[0]))
        raise ValueError(f"style is {short(style)}, which Matplotlib refuses: {message}") from None
    try:
        with matplotlib.rc_context(cast(Any, _unchanged_settings(width))):
            yield
    finally:
        context.__exit__(None, None, None)


def _unchanged_settings(width: float | None) -> dict[str, Any]:
    current, default = _parameters()
    scale = NARROW_SIZE if width is not None and width < NARROW else 1.0
    sizes = {key: size * scale for key, size in SIZES.items()}
    # Other sizes are relative to this one.
    settings = {**SETTINGS, **(sizes if current["font.size"] == default["font.size"] else {})}
    return {key: value for key, value in settings.items() if current[key] == default[key]}


def _parameters() -> tuple[Any, Any]:
    from matplotlib import rcParams, rcParamsDefault

    return rcParams, rcParamsDefault


def with_figure_settings(function: Function) -> Function:
    """Decorate a function that draws a figure, to apply the settings of figures."""

    @wraps(function)
    def drawing(*args: Any, **keywords: Any) -> Any:
        with figure_settings():
            return function(*args, **keywords)

    return cast(Function, drawing)


def new_figure(what: str, width: float, height: float, dpi: float | None = None, compress: bool = False) -> Figure:
    """Return a figure of a size in inches; raise an error that names `what` needs Matplotlib if it is missing."""
    require_packages(what, "matplotlib")
    from coadjoint.pictures.artists import PanelLayout, ShownFigure

    return ShownFigure(figsize=(width, height), dpi=dpi, layout=PanelLayout(compress=compress))


def setting(key: str) -> Any:
    """Return a setting of Matplotlib as figures use it, also outside of `figure_settings`."""
    current, default = _parameters()
    own = {**SETTINGS, **(SIZES if current["font.size"] == default["font.size"] else {})}
    return own[key] if key in own and current[key] == default[key] else current[key]


def ink() -> str:
    """Return the colour of text and of marks: dark, or that of the user."""
    return cast(str, setting("text.color"))


def paper() -> Any:
    """Return the colour of the background of axes."""
    return setting("axes.facecolor")


def on_paper(colour: str, strength: float) -> Any:
    """Return a pale colour for white paper; on other paper a mixture of paper and `strength` of ink."""
    from matplotlib.colors import to_rgb

    below, above = np.array(to_rgb(paper())), np.array(to_rgb(ink()))
    return colour if below.min() == 1.0 else tuple(((1.0 - strength) * below + strength * above).tolist())


def colour(i: int) -> str:
    """Return the colour of line i, cyclically: of the user's ``axes.prop_cycle``, otherwise of `COLOURS`."""
    current, default = _parameters()
    cycle = current["axes.prop_cycle"]
    colours = COLOURS if cycle == default["axes.prop_cycle"] else cycle.by_key().get("color", COLOURS)
    return cast(str, colours[i % len(colours)])


def thickness(width: float) -> float:
    """Return the width of a line (points) relative to the user's ``lines.linewidth``, if that was changed."""
    return width * float(setting("lines.linewidth"))


def path_style(count: int, joined: bool, width: float) -> dict[str, Any]:
    """Return the style of a path of `count` points: a line or, unless `joined`, dots, smaller for many points."""
    if joined:
        return {"linewidth": thickness(width)}
    size = 3.0 if count <= 500 else max(1.0, 3.0 * (500 / count) ** 0.5)
    return {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0}


def plain_axes(axes: Axes) -> None:
    """Set thin lines, a light grid and no box on flat axes, also on those that the user has made."""
    for side, spine in axes.spines.items():
        spine.set(linewidth=setting("axes.linewidth"), color=setting("axes.edgecolor"))
        spine.set_visible(setting(f"axes.spines.{side}"))
    for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        width, length = (setting(f"{name}tick.major.{part}") for part in ("width", "size"))
        axis.set_tick_params(width=width, length=length, labelsize=setting(f"{name}tick.labelsize"))
        axis.set_tick_params(color=setting(f"{name}tick.color"), labelcolor=setting(f"{name}tick.color"))
        axis.label.set(fontsize=setting("axes.labelsize"), color=setting("axes.labelcolor"))
    axes.grid(True, linewidth=setting("grid.linewidth"), color=setting("grid.color"))
    axes.set_axisbelow(True)
    axes.title.set_fontsize(setting("axes.titlesize"))


def set_title(axes: Any, text: str) -> Any:
    """Set the title of axes in the size of figures, also on those that the user has made; return it."""
    return axes.set_title(text, fontsize=setting("axes.titlesize"), color=ink())


def colour_scale(values: Any, colours: Any = "viridis") -> Any:
    """Return what maps numbers between the extremes of some values to colours, for `colour_bar`."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    return ScalarMappable(Normalize(float(np.min(values)), float(np.max(values))), colours)


def write_note(axes: Any, text: str) -> None:
    """Write a text, wrapped, into the middle of axes."""
    size = setting("axes.labelsize")
    axes.text(0.5, 0.5, "\n".join(textwrap.wrap(text, 50)), transform=axes.transAxes, ha="center", fontsize=size)


def colour_bar(axes: Any, mappable: Any, label: str, **options: Any) -> Any:
    """Add a colour bar as high as the axes, also where their aspect is equal; options are those of `colorbar`."""
    place = axes.inset_axes((1.03, 0.0, 0.035, 1.0), label="<colorbar>")
    bar = axes.figure.colorbar(mappable, cax=place, **options)
    bar.set_label(label, fontsize=setting("axes.labelsize"))
    bar.ax.tick_params(labelsize=setting("ytick.labelsize"))
    bar.ax.grid(False)
    bar.outline.set_linewidth(setting("axes.linewidth"))
    return bar


MAX_LABEL_LENGTH = 100
"""Largest number of characters of a label in a legend; of longer ones the middle is left out."""


def legend(axes: Axes, beside: bool = False, **options: Any) -> None:
    """Add a small legend of the artists that show anything, if there are any, in the axes or `beside` them."""
    entries = [(handle, label) for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)]
    entries = [(handle, label) for handle, label in entries if _is_drawn(handle)]
    if not entries:
        return
    handles, labels = zip(*entries, strict=True)
    labels = tuple(label if "$" in label else in_one_line(label, MAX_LABEL_LENGTH) for label in labels)
    place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2} if beside else {"loc": "best"}
    settings = {key: setting(f"legend.{key}") for key in ("fontsize", "frameon", "handlelength")}
    created = axes.legend(handles, labels, **{**settings, **place, **options})
    for line in created.get_lines():
        line.set(linewidth=max(1.0, line.get_linewidth()), alpha=1.0)


def _is_drawn(artist: Any) -> bool:
    if hasattr(artist, "get_xydata"):
        xy = np.asarray(artist.get_xydata(), dtype=np.float64)
        return bool(np.isfinite(xy).all(axis=-1).any())
    if hasattr(artist, "get_paths"):
        return any(np.isfinite(path.vertices).any() for path in artist.get_paths())
    return True


def symbol(name: str) -> str:
    """Return the name of an invariant, such as ``"energy"``, ``"|x|^2"`` or ``"log C"``, as mathematical text."""
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

    >>> print(coordinate("x12"), coordinate("gamma3"), coordinate("S1[7]"), coordinate("E"), coordinate("zonal wind"))
    $x_{12}$ $\gamma_{3}$ $S_{1}^{[7]}$ $E$ zonal wind
    """
    match = re.fullmatch(r"([A-Za-z]+?)_?([\d,]*)(\[\d+\])?", name)
    if match is None or (len(match[1]) > 2 and match[1] not in GREEK):
        return name.replace("$", r"\$")
    return f"${latex_name(name)}$"
