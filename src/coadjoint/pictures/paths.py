"""Paths of members: their colours, by the energy or one for all, and movies of lines up to a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.style import colour, colour_bar

Floats = npt.NDArray[np.float64]
BAR_LABEL = "<colorbar of members>"
DARKEST, LIGHTEST = 0.0, 0.88
"""Part of the colour map viridis that is dark enough for lines on white."""
EQUAL_ENERGIES = 1e-6
"""Relative difference of energies below which all members have one colour."""


class MemberColours:
    """Colours of the drawn members: one for equal energies at the start, otherwise by the energy."""

    def __init__(self, drawn: PlottedRun) -> None:
        from matplotlib import colormaps
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LinearSegmentedColormap, Normalize

        energies = drawn.initial_energies if len(drawn.x) > 1 else np.zeros(1)
        finite = energies[np.isfinite(energies)]
        self.differ = finite.size > 1 and float(np.ptp(finite)) > EQUAL_ENERGIES * float(np.abs(finite).max())
        self._energies, self._shades = energies, None
        if self.differ:
            part = colormaps["viridis"](np.linspace(DARKEST, LIGHTEST, 256))
            shades = LinearSegmentedColormap.from_list("energies", part)
            self._shades = ScalarMappable(Normalize(float(finite.min()), float(finite.max())), shades)

    def __getitem__(self, m: int) -> Any:
        """Return the colour of a drawn member."""
        if self._shades is None or not np.isfinite(self._energies[m]):
            return colour(0)
        return self._shades.to_rgba(self._energies[m])

    def add_bar(self, axes: Any) -> None:
        """Add a colour bar to axes if the colours differ, unless the figure has one."""
        children = [child for other in axes.figure.axes for child in other.child_axes]
        if self._shades is not None and all(child.get_label() != BAR_LABEL for child in children):
            bar = colour_bar(axes, self._shades, "energy $H$ at the start")
            bar.ax.set_label(BAR_LABEL)


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
