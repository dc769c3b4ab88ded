"""Layout of figures: Matplotlib's constrained layout, with titles and labels wrapped to their panels."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from matplotlib.layout_engine import ConstrainedLayoutEngine

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAME_LENGTH = 0.02
"""Relative change of the length available to a text below which it is not wrapped anew."""
MIN_WRAPPED = 60.0
"""Texts are not wrapped to less than this (points)."""


class PanelLayout(ConstrainedLayoutEngine):
    """Constrained layout at each drawing, after which titles and labels are wrapped to the sizes of their panels.

    Figures can therefore be resized. Texts that are set later are wrapped as well.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._wrapped: dict[Any, tuple[str, str, float]] = {}

    def execute(self, fig: Figure) -> None:
        """Compute the layout of a figure."""
        super().execute(fig)
        if self._wrap_texts(fig):
            super().execute(fig)

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

    def _wrap(self, text: Any, length: float, renderer: Any) -> bool:
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

        wrapped = full if fits(full) else "\n".join(_lines(full, fits))
        text.set_text(wrapped)
        self._wrapped[text] = (full, wrapped, length)
        return wrapped != shown


def _lines(full: str, fits: Any) -> list[str]:
    """Break a text into lines that fit, between words; formulas are not broken."""
    lines = []
    for given in full.split("\n"):
        line = ""
        for word in re.findall(r"(?:\$[^$]*\$|\\\$|[^\s$])+", given):
            longer = f"{line} {word}" if line else word
            if line and not fits(longer):
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
    return lines
