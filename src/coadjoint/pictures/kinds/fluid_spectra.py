"""Distribution of the energy and enstrophy of a fluid over its scales, at one time and over time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, thickness
from coadjoint.systems.fluids.reduced_mhd import fluid_of as fluid_of_system
from coadjoint.systems.matrices.fluid_system import FluidSystem

Floats = npt.NDArray[np.float64]

AXIS_LABELS = {"sphere": "degree $l$", "torus": "wave number $|n|$"}
DECADES = 8.0
"""Range of values shown below the largest one, in powers of ten."""

MAX_TIMES = 200  # points of a curve; a spectrum each, which takes time
MAX_SCALES = 6  # curves that can be distinguished
LETTER = {"sphere": "l", "torus": "|n|"}


def fluid_of(drawn: PlottedRun) -> FluidSystem:
    """Return the fluid system of a run (of two fields, that of the vorticity); raise CannotShow for other systems."""
    found = fluid_of_system(drawn.unforced)
    if found is None:
        raise CannotShow(f"{drawn.unforced.name} has no vorticity to show; sphere_euler and torus_euler have")
    return found


def vorticity_of(state: Any) -> npt.NDArray[Any]:
    """Return the vorticity matrix: the state, or the second of two fields."""
    W = np.asarray(state)
    return W[1] if W.ndim == 3 else W


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
