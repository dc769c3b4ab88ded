"""Classes derived from those of Matplotlib: figures that show themselves, layouts that wrap text, and fading lines."""

from __future__ import annotations

import bisect
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from mpl_toolkits.mplot3d.art3d import Line3D
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

SAME_LENGTH = 0.02
"""Relative change of the length available to a text below which it is not wrapped anew."""
SAME_PLACE = 0.5
"""Panels that move by less than this (pixels) stay."""
MAX_PASSES = 6
"""Largest number of layouts of one drawing."""
LABEL_SHARE, LABEL_SHARE_BESIDE = 0.8, 0.4
"""Largest widths of labels of legends, relative to the panel, and relative to its column if beside the panel."""
MIN_WRAPPED = 60.0
"""Texts are not wrapped to less than this (points)."""
VECTOR_FORMATS = ("pdf", "svg", "eps", "ps")
VECTOR_DPI = 300.0
"""Resolution of those parts of vector files that are images, such as surfaces."""


class ShownFigure(Figure):
    """Matplotlib figure that represents itself as PNG; no global state is changed."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Save the figure; parts of vector files that are images have 300 dots per inch unless `dpi` is given."""
        named = options.get("format") or (Path(fname).suffix[1:] if isinstance(fname, str | Path) else "")
        if str(named).lower() in VECTOR_FORMATS:
            options.setdefault("dpi", VECTOR_DPI)
        super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=self.dpi)
        return buffer.getvalue()


class PanelLayout(ConstrainedLayoutEngine):
    """Constrained layout at each drawing, after which titles and labels are wrapped to the sizes of their panels."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._wrapped: dict[Any, tuple[str, str, float]] = {}

    def execute(self, fig: Figure) -> None:
        """Compute the layout of a figure, until its panels no longer move: the first drawing is as the later ones."""
        # A layout is impossible beside legends that are wider than the figure.
        self._wrap_legends(fig)
        before = _corners(fig)
        for _ in range(MAX_PASSES):
            super().execute(fig)
            wrapped, after = self._wrap_texts(fig) | self._wrap_legends(fig), _corners(fig)
            if not wrapped and np.abs(after - before).max(initial=0.0) < SAME_PLACE:
                break
            before = after

    def _wrap_texts(self, figure: Figure) -> bool:
        """Wrap titles and labels; return whether any text has changed."""
        renderer = figure._get_renderer()  # type: ignore[attr-defined]
        changed = False
        suptitle = getattr(figure, "_suptitle", None)
        if suptitle is not None:
            changed |= self._wrap(suptitle, 0.98 * figure.bbox.width, renderer)
        for axes in figure.axes:
            cell = axes.get_position(original=True)
            width, height = cell.width * figure.bbox.width, cell.height * figure.bbox.height
            box = axes.get_tightbbox(renderer, for_layout_only=True)
            # A centred title may reach as far as the nearer of the decorations at both sides.
            left, right = cell.x0 * figure.bbox.width, cell.x1 * figure.bbox.width
            beside = 0.0 if box is None else 2.0 * max(0.0, min(left - box.x0, box.x1 - right))
            changed |= self._wrap(axes.title, width + beside, renderer)
            if axes.name == "3d":
                continue
            changed |= self._wrap(axes.xaxis.label, width, renderer)
            for part in (axes, *axes.child_axes):
                changed |= self._wrap(part.yaxis.label, height, renderer)
        return changed

    def _wrap_legends(self, figure: Figure) -> bool:
        """Wrap labels of legends; return whether any text has changed."""
        renderer = figure._get_renderer()  # type: ignore[attr-defined]
        changed = False
        for axes in figure.axes:
            legend = axes.get_legend()
            if legend is None:
                continue
            # The anchor of a legend in its axes is all of them, and beside them a point.
            if legend.get_bbox_to_anchor().width > 0.0:
                most = LABEL_SHARE * axes.get_position(original=True).width * figure.bbox.width
            else:
                most = LABEL_SHARE_BESIDE * _column_width(axes, figure)
            for label in legend.get_texts():
                changed |= self._wrap(label, most, renderer, anywhere=True)
        return changed

    def _wrap(self, text: Any, length: float, renderer: Any, anywhere: bool = False) -> bool:
        """Wrap a text to a length in pixels, between words, or `anywhere` if a word is too long; report a change."""
        shown = text.get_text()
        if not shown or not text.get_visible():
            return False
        length = max(length, MIN_WRAPPED * renderer.points_to_pixels(1.0))
        full, wrapped, before = self._wrapped.get(text, (shown, "", 0.0))
        if wrapped != shown:
            full = shown
        elif abs(length - before) <= SAME_LENGTH * length:
            return False
        vertical = text.get_rotation() == 90.0

        def fits(part: str) -> bool:
            text.set_text(part)
            box = text.get_window_extent(renderer)
            return bool((box.height if vertical else box.width) <= length)

        wrapped = full if fits(full) else "\n".join(_lines(full, fits, anywhere))
        text.set_text(wrapped)
        self._wrapped[text] = (full, wrapped, length)
        return wrapped != shown


def _column_width(axes: Axes, figure: Figure) -> float:
    """Return the width of the column of a panel, in pixels."""
    cell = axes.get_subplotspec()
    if cell is None:
        return float(figure.bbox.width)
    return float(cell.get_topmost_subplotspec().get_position(figure).width * figure.bbox.width)


def _corners(figure: Figure) -> Floats:
    return np.array([axes.get_position(original=True).transformed(figure.transFigure).extents for axes in figure.axes])


def _lines(full: str, fits: Any, anywhere: bool) -> list[str]:
    """Break a text into lines that fit, between words, or `anywhere` if a word is too long; formulas are not broken."""
    lines = []
    for given in full.split("\n"):
        line = ""
        for word in re.findall(r"(?:\$[^$]*\$|\\\$|[^\s$])+", given):
            longer = f"{line} {word}" if line else word
            if line and not fits(longer):
                lines.append(line)
                longer = word
            while anywhere and len(longer) > 1 and "$" not in longer and not fits(longer):
                count = bisect.bisect(range(2, len(longer)), False, key=lambda k: not fits(longer[:k])) + 1
                lines.append(longer[:count])
                longer = longer[count:]
            line = longer
        lines.append(line)
    return lines


class FadingLine(Line3D):  # type: ignore[misc]
    """Line in space with the opacity `faint` where `hides(points, axes)`; a mark has the colour `hollow` there."""

    def __init__(
        self, points: Floats, hides: Callable[[Floats, Any], Any], *, faint: float, hollow: Any, **style: Any
    ) -> None:
        super().__init__(*points.T, **style)
        self._hides, self._faint, self._hollow = hides, faint, hollow

    def draw(self, renderer: Any) -> None:
        data, alpha, face = self.get_data_3d(), self.get_alpha(), self.get_markerfacecolor()
        points = np.stack([np.asarray(values, dtype=np.float64) for values in data], axis=-1)
        hidden = self._hides(points, self.axes) if len(points) else np.zeros(0, dtype=bool)
        is_mark = len(points) == 1
        for part, opacity in ((hidden, self._faint), (~hidden, 1.0)):
            if not part.any():
                continue
            # Segments across the edge belong to both parts, to avoid gaps.
            shown = part if self.get_linestyle() == "None" else part | np.append(part[1:], False)
            self.set_data_3d(*np.where(shown[:, None], points, np.nan).T)
            self.set_alpha((1.0 if is_mark else opacity) * (1.0 if alpha is None else alpha))
            self.set_markerfacecolor(self._hollow if is_mark and hidden[0] else face)
            super().draw(renderer)
        self.set_data_3d(*data)
        self.set_alpha(alpha)
        self.set_markerfacecolor(face)
        self.stale = False
