"""Distribution of the energy and enstrophy of a fluid over its scales."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.fluids import fluid_of, vorticity_of
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, thickness

AXIS_LABELS = {"sphere": "degree $l$", "torus": "wave number $|n|$"}
DECADES = 8.0
"""Range of values shown below the largest one, in powers of ten."""


@kind("field spectra", low=True)
def field_spectra(drawn: PlottedRun, at: float = 1.0) -> Paint:
    """Show energy and enstrophy of the first member over the degree on the sphere, or wave number on the torus.

    Thin dashed lines show the start.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    """
    fluid, k = fluid_of(drawn), drawn.index_at(at)
    spectra = {"energy": fluid.energy_spectrum, "enstrophy": fluid.enstrophy_spectrum}
    points = {
        (name, j): [np.asarray(values, dtype=np.float64) for values in spectrum(vorticity_of(drawn.state(j)))]
        for name, spectrum in spectra.items()
        for j in dict.fromkeys((k, 0))
    }

    def paint(axes: Any) -> None:
        for line, name in enumerate(spectra):
            for j, style in {
                0: {"linestyle": "--", "linewidth": thickness(0.8)},
                k: {"linestyle": "-", "linewidth": thickness(1.2)},
            }.items():
                scales, values = points[name, j]
                label = f"{name}, $t$ = {drawn.t[j]:.4g}"
                axes.plot(scales, np.where(values > 0.0, values, np.nan), color=colour(line), label=label, **style)
        axes.set(xscale="log", xlabel=AXIS_LABELS[fluid.surface])
        axes.set(ylabel="energy and enstrophy", title=f"spectra of energy and enstrophy{drawn.of_member}")
        top = max(float(values.max()) for _, values in points.values())
        if top > 0.0:  # a fluid at rest has no logarithms
            low = min(float(values[values > top * 10.0**-DECADES].min(initial=top)) for _, values in points.values())
            axes.set(yscale="log", ylim=(low / 2, top * 3))
        plain_axes(axes)
        legend(axes, beside=True)

    return paint
