"""Figure of a dynamic structure factor: colours over wave vectors and frequencies."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.optional_packages import require_packages
from coadjoint.pictures.style import colour_bar, plain_axes, with_figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DECADES = 4.0
"""Range of intensities shown, in powers of ten."""
BRIGHTEST = 10.0
"""Largest intensity shown, in units of the median of the maxima of the wave vectors."""
MARGIN = 1.15
"""Highest frequency shown, in units of the highest visible one."""
LARGEST_DENOMINATOR = 64  # of wave vectors written as fractions


@with_figure_settings
def draw_structure_factor(spectrum: Any) -> Figure:
    """Return a figure of a `StructureFactor`: intensity on a logarithmic scale, corners of the path as ticks."""
    require_packages("drawing a structure factor", "matplotlib")
    from matplotlib.colors import LogNorm

    from coadjoint.pictures.figure import ShownFigure
    from coadjoint.pictures.layout import PanelLayout

    figure = ShownFigure(figsize=(7.2, 4.2), layout=PanelLayout())
    axes = figure.add_subplot()
    shown = spectrum.omega >= 0.0
    intensity = spectrum.intensity[:, shown].T
    # Elastic lines may be stronger by orders of magnitude than all others.
    top = BRIGHTEST * float(np.median(intensity.max(axis=0))) or 1.0
    lowest, omega = top * 10.0**-DECADES, spectrum.omega[shown]
    mesh = axes.pcolormesh(
        _edges(spectrum.distance),
        _edges(omega),
        np.clip(intensity, lowest, top),
        norm=LogNorm(lowest, top),
        cmap="viridis",
        rasterized=True,
    )
    colour_bar(axes, mesh, r"$S(q, \omega)$", extend="both")
    visible = omega[np.any(intensity > lowest, axis=1)]
    axes.set_ylim(0.0, min(omega[-1], MARGIN * visible.max(initial=omega[1])))
    names = [corner_name(spectrum.q[corner]) for corner in spectrum.corners]
    axes.set_xticks(spectrum.distance[spectrum.corners], names)
    for corner in spectrum.corners[1:-1]:
        axes.axvline(spectrum.distance[corner], color="white", linewidth=0.6)
    axes.set(
        xlabel="wave vector $q$ [reciprocal edges]", ylabel=r"frequency $\omega$", title="dynamic structure factor"
    )
    plain_axes(axes)
    axes.grid(False)
    return figure


def corner_name(q: Any) -> str:
    """Return the components of a wave vector as fractions.

    >>> corner_name([0.5, 0.0]), corner_name([1 / 3]), corner_name([-2 / 3, 1.0])
    ('(1/2, 0)', '1/3', '(-2/3, 1)')
    """
    parts = [str(Fraction(float(part)).limit_denominator(LARGEST_DENOMINATOR)) for part in q]
    return parts[0] if len(parts) == 1 else f"({', '.join(parts)})"


def _edges(centres: Any) -> Any:
    """Return the borders between cells around values; a single value has a width of one."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2.0 * centres[0] - middle[0]], middle, [2.0 * centres[-1] - middle[-1]]])
