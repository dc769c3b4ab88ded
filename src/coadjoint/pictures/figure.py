"""Figure with a PNG representation, which notebooks display without a Matplotlib backend."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

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
