"""Movies of paths: lines up to a time, and a mark at their ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun

Floats = npt.NDArray[np.float64]


class PathUpdate:
    """Update of a picture of paths to another saved point, as movies need it; it shows the whole paths first."""

    def __init__(self, drawn: PlottedRun, axes: Any, title: str) -> None:
        self._axes, self._title, self._t = axes, title, drawn.t
        self._paths: list[tuple[Floats, Floats | None, list[tuple[Any, Any]], Any]] = []

    def add(self, lines: list[Any], times: Floats, points: Floats | None = None, head: Any = None) -> None:
        """Add lines of k points with their times (k,), and the points of a mark that moves with them (or a new one)."""
        full = [(line, line.get_data_3d() if hasattr(line, "get_data_3d") else line.get_data()) for line in lines]
        self._paths.append((times, points, full, head))

    def __call__(self, k: int) -> None:
        """Show the paths up to a saved point."""
        time, forward = self._t[k], 1.0 if self._t[-1] >= self._t[0] else -1.0
        for i, (times, points, lines, head) in enumerate(self._paths):
            count = int(np.count_nonzero(forward * (times - time) <= 0.0))
            for line, data in lines:
                _set_points(line, [np.asarray(values)[:count] for values in data])
            if points is None:
                continue
            if head is None:
                style = {"linestyle": "none", "marker": "o", "markersize": 5.0, "zorder": 7}
                (head,) = self._axes.plot(*points[:1].T, color=lines[0][0].get_color(), **style)
                self._paths[i] = (times, points, lines, head)
            _set_points(head, points[max(count - 1, 0) : max(count, 1)].T)
        self._axes.title.set_text(f"{self._title}, $t$ = {time:.4g}")


def _set_points(line: Any, data: Any) -> None:
    if len(data) == 3:
        line.set_data_3d(*data)
    else:
        line.set_data(*data)
