"""Colours of the members of an ensemble: by their energy, or one for all."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.style import colour, colour_bar

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
