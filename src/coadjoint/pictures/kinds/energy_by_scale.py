"""Energy of a fluid in its largest scales over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.fluids import fluid_of, vorticity_of
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, thickness

MAX_TIMES = 200  # points of a curve; a spectrum each, which takes time
MAX_SCALES = 6  # curves that can be distinguished
LETTER = {"sphere": "l", "torus": "|n|"}


@kind("energy by scale", over_time=True)
def energy_by_scale(drawn: PlottedRun) -> Paint:
    """Show the fractions of the energy in the most energetic scales, at up to 200 saved times.

    Scales are degrees on the sphere, or wave numbers on the torus; the first member is shown.
    """
    fluid = fluid_of(drawn)
    times = spread(len(drawn.t), MAX_TIMES)
    spectra = [fluid.energy_spectrum(vorticity_of(drawn.state(int(k)))) for k in times]
    scales = np.asarray(spectra[0][0])
    energies = np.stack([np.asarray(values, dtype=np.float64) for _, values in spectra])
    total = energies.sum(axis=1, keepdims=True)
    # Failed members leave gaps; a fluid at rest has no shares.
    shares = np.divide(energies, total, out=0.0 * energies, where=total > 0.0)
    largest = np.sort(np.argsort(-np.nanmax(shares, axis=0), kind="stable")[:MAX_SCALES])

    def paint(axes: Any) -> None:
        for line, i in enumerate(largest):
            label = f"${LETTER[fluid.surface]} = {scales[i]:g}$"
            axes.plot(drawn.t[times], shares[:, i], color=colour(line), linewidth=thickness(0.9), label=label)
        axes.set(xlabel="time $t$", ylabel="share of the energy", title=f"energy by scale{drawn.of_member}")
        axes.set_ylim(0.0, None)
        plain_axes(axes)
        legend(axes, beside=True)

    return paint
