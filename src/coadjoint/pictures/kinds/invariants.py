"""Invariants: the drift of the energy and the Casimirs, and the eigenvalues of a matrix state."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import draw_members
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, symbol, thickness, write_note

MAX_CASIMIRS = 5
"""Largest number of Casimirs drawn as lines; of more, the worst four are drawn, with a band of all."""
BAND_COLOUR = "#9AA7B5"

MAX_MARKED = 40
"""Largest number of eigenvalues drawn with markers."""


@kind("drift", over_time=True)
def drift(drawn: PlottedRun) -> Paint:
    """Show the deviations from the start, relative as in `Solution.drift`, on a logarithmic scale.

    If the Hamiltonian depends on time, the title states that the energy is driven. Of many Casimirs the worst four are
    drawn as lines, and a band spans the deviations of all. With forces, dotted lines show the change minus the work of
    the forces: the error of the run.
    """
    sizes = drawn.scales
    deviations = {name: np.abs(change) / sizes[name] for name, change in drawn.changes.items()}
    energy = deviations.pop("energy")
    lines = {"energy": energy, **_worst(deviations)}

    def paint(axes: Any) -> None:
        if len(deviations) > MAX_CASIMIRS:
            _draw_band(axes, drawn, np.stack(list(deviations.values())))
        for i, (name, members) in enumerate(lines.items()):
            # Zero deviations have no logarithm, and leave gaps.
            visible = np.where(members > 0.0, members, np.nan)
            label = "$H$, driven" if name == "energy" and drawn.driven else symbol(name)
            draw_members(axes, drawn.t, visible, drawn.dense, colour(i), label)
            if drawn.unexplained_change is not None:
                change = np.abs(drawn.unexplained_change[name]) / sizes[name]
                _draw_dotted(axes, drawn, change, colour(i), None if i else "$H$ less their work")
        axes.set(yscale="log", xlabel="time $t$", ylabel="relative deviation from start")
        title = "drift of the energy $H$ and the Casimirs"
        if drawn.unexplained_change is not None:
            title = "change of the energy $H$ and the Casimirs by forces"
        elif drawn.driven:
            title = "change of the driven energy $H$, drift of the Casimirs"
        axes.set_title(f"{title}, at the saved points")
        if not any(np.any(values > 0.0) for values in (energy, *deviations.values())):
            write_note(axes, "no deviation in any bit")
        _widen_to_two_decades(axes)
        plain_axes(axes)
        legend(axes, beside=True)

    return paint


def _draw_dotted(axes: Any, drawn: PlottedRun, members: npt.NDArray[np.float64], shade: str, label: str | None) -> None:
    for m, values in enumerate(members):
        visible = np.where(values > 0.0, values, np.nan)
        axes.plot(drawn.t, visible, ":", color=shade, linewidth=thickness(0.8), label=label if m == 0 else None)


def _worst(deviations: dict[str, npt.NDArray[np.float64]]) -> dict[str, npt.NDArray[np.float64]]:
    """Return all Casimirs, or of many those with the largest deviations."""
    if len(deviations) <= MAX_CASIMIRS:
        return dict(deviations)
    size = {name: float(np.nanmax(values, initial=0.0)) for name, values in deviations.items()}
    worst = sorted(deviations, key=lambda name: -size[name])[: MAX_CASIMIRS - 1]
    return {name: deviations[name] for name in worst}


def _widen_to_two_decades(axes: Any) -> None:
    low, high = axes.get_ylim()
    if 0.0 < low < high < 100.0 * low:
        middle = (low * high) ** 0.5
        axes.set_ylim(middle / 10.0, middle * 10.0)


def _draw_band(axes: Any, drawn: PlottedRun, deviations: npt.NDArray[np.float64]) -> None:
    series = deviations.reshape(-1, deviations.shape[-1])
    series = np.where(series > 0.0, series, np.nan)
    finite: npt.NDArray[np.bool_] = np.isfinite(series).any(axis=0)  # type: ignore[assignment]
    low, high = np.full((2, series.shape[1]), np.nan)
    low[finite], high[finite] = np.nanmin(series[:, finite], axis=0), np.nanmax(series[:, finite], axis=0)
    label = f"all {len(deviations)} Casimirs"
    axes.fill_between(drawn.t, low, high, color=BAND_COLOUR, alpha=0.4, linewidth=0.5, label=label)


@kind("eigenvalues", low=True)
def eigenvalues(drawn: PlottedRun, at: float = 1.0) -> Paint:
    """Show the eigenvalues of a matrix of the first member at the start and at another time, and their displacement.

    For a skew-Hermitian W, the eigenvalues of -i W are drawn in ascending order, otherwise those of W in the complex
    plane. For a fluid they are the distribution of vorticity over area. For two fields, the matrix is the carried one.

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
    first, last = (drawn.unforced.spectrum(drawn.state(j)) for j in (0, k))
    size = float(np.abs(first).max()) or 1.0
    moved = float(np.abs(last - first).max()) / size
    name = r"\Theta" if len(drawn.unforced.matrix_shape) == 3 else "W"
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
