"""Spectra: eigenvalues of matrix states, and the energy and enstrophy of fluids over their scales."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import draw_over_time
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, thickness
from coadjoint.systems.matrices.fluid_system import FluidSystem

Floats = npt.NDArray[np.float64]

AXIS_LABELS = {"sphere": "degree $l$", "torus": "wave number $|n|$"}
DECADES = 8.0
"""Range of values shown below the largest one, in powers of ten."""

MAX_TIMES = 200  # points of a curve; a spectrum each, which takes time
MAX_SCALES = 6  # curves that can be distinguished
MAX_MARKED = 40  # eigenvalues drawn with markers
LETTER = {"sphere": "l", "torus": "|n|"}


def fluid_of(drawn: PlottedRun) -> FluidSystem:
    """Return the fluid system of a run (of two fields, that of the vorticity); raise CannotShow for other systems."""
    system = drawn.unforced
    if not system.has_matrices or system.fluid is None:
        raise CannotShow(
            f"{system.name} has no vorticity to show; fluids such as sphere_euler, torus_euler and sphere_qg have"
        )
    found: FluidSystem = system.fluid
    return found


def spectrum_of(system: Any, spectrum: Callable[[Any], Any], state: Any) -> tuple[Floats, Floats]:
    """Return scales and the spectrum of a vorticity, summed over layers of a fluid by their thicknesses."""
    if not system.independent_layers:
        scales, values = spectrum(system.fluid_state(state))
    else:
        scales, of_layers = spectrum(system.relative(state))
        values = system.thicknesses @ of_layers
    return np.asarray(scales, dtype=np.float64), np.asarray(values, dtype=np.float64)


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
        (name, j): spectrum_of(drawn.unforced, spectrum, drawn.state(j))
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
    spectra = [spectrum_of(drawn.unforced, fluid.energy_spectrum, drawn.state(int(k))) for k in times]
    scales = spectra[0][0]
    energies = np.stack([values for _, values in spectra])
    total = energies.sum(axis=1, keepdims=True)
    # Failed members leave gaps; a fluid at rest has no shares.
    shares = np.divide(energies, total, out=0.0 * energies, where=total > 0.0)
    largest = np.sort(np.argsort(-np.nanmax(shares, axis=0), kind="stable")[:MAX_SCALES])

    lines = {f"${LETTER[fluid.surface]} = {scales[i]:g}$": shares[None, :, i] for i in largest}

    def paint(axes: Any) -> None:
        draw_over_time(axes, drawn.t[times], lines, True, "share of the energy", f"energy by scale{drawn.of_member}")
        axes.set_ylim(0.0, None)

    return paint


@kind("eigenvalues", low=True)
def eigenvalues(drawn: PlottedRun, at: float = 1.0) -> Paint:
    """Show the eigenvalues of a matrix of the first member at the start and at another time, and their displacement.

    For a skew-Hermitian W, the eigenvalues of -i W are drawn in ascending order, otherwise those of W in the complex
    plane. For a fluid they are the distribution of absolute vorticity over area. For two fields, the matrix is the
    carried one; of layers all eigenvalues are shown.

    Parameters
    ----------
    at : float
        The time as a fraction of the span: 0 is the start, 1 the end.
    """
    if not drawn.unforced.has_matrices:
        raise CannotShow(f"the state of {drawn.unforced.name} is not a matrix, and has no eigenvalues")
    k = drawn.index_at(at)
    if not np.isfinite(drawn.x[0, k]).all():
        raise CannotShow(f"the first member has failed before t = {drawn.t[k]:g}, and has no eigenvalues there")
    first, last = (np.asarray(drawn.unforced.spectrum(drawn.state(j))) for j in (0, k))
    if first.ndim == 2:
        first, last = np.sort(first.ravel()), np.sort(last.ravel())
    size = float(np.abs(first).max()) or 1.0
    moved = float(np.abs(last - first).max()) / size
    two = len(drawn.unforced.matrix_shape) == 3 and not drawn.unforced.independent_layers
    name = r"\Theta" if two else "W"
    fraction = (np.arange(len(first)) + 0.5) / len(first)

    def paint(axes: Any) -> None:
        for values, j, line, width in ((first, 0, 4, 3.0), (last, k, 6, 0.9)):
            style = {"color": colour(line), "linewidth": thickness(width), "label": f"$t$ = {drawn.t[j]:.4g}"}
            if np.iscomplexobj(values):
                style |= {"linestyle": "none", "marker": "o", "markersize": 3.0 * width}
                axes.plot(values.real / size, values.imag / size, **style)
            else:
                style |= {"marker": "o", "markersize": 2.0 * width} if len(values) <= MAX_MARKED else {}
                axes.plot(fraction, values / size, **style)
        if np.iscomplexobj(first):
            axes.set(xlabel="real part over the largest", ylabel="imaginary part over the largest")
        else:
            axes.set(xlabel="part of the eigenvalues below", ylabel=f"eigenvalues of $-i{name}$ over the largest")
        axes.set_title(f"spectrum of ${name}${drawn.of_member}: moved by {moved:.1e} of the largest")
        plain_axes(axes)
        legend(axes, beside=True)

    return paint
