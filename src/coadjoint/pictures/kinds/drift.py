"""How far the energy and the Casimirs stray from their values at the start."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.drawn import Drawn
from coadjoint.pictures.register import Paint, kind
from coadjoint.pictures.series import draw_series
from coadjoint.pictures.style import colour, key, plain_axes, symbol

MOST_CASIMIRS = 5
"""Casimirs with a line of their own; of more, the worst four, and a band that holds all."""
BAND = "#9AA7B5"


@kind("drift", over_time=True)
def drift(drawn: Drawn) -> Paint:
    """Show the absolute deviations from the start on a logarithmic scale.

    Where the Hamiltonian depends on time, or forces move the system, they are meant to change, and the picture says so.
    Of many Casimirs the worst four have lines, and a band reaches from the smallest to the largest deviation of all.

    Parameters
    ----------
    drawn : Drawn
        The run.

    Returns
    -------
    Paint
    """
    deviations = {name: np.abs(values - values[:, :1]) for name, values in drawn.invariants.items()}
    energy = deviations.pop("energy")
    lines, others = {"energy": energy, **_worst(deviations)}, len(deviations)

    def paint(axes: Any) -> None:
        if others > MOST_CASIMIRS:
            _draw_band(axes, drawn, np.stack(list(deviations.values())))
        several = len(drawn.x) > 1
        style = {"linewidth": 0.5, "alpha": 0.5} if several else {"linewidth": 0.9, "alpha": 1.0}
        for i, (name, members) in enumerate(lines.items()):
            for m, values in enumerate(members):
                # Zero has no logarithm: the line has gaps where nothing has changed in any bit.
                visible = np.where(values > 0.0, values, np.nan)
                label = symbol(name) if m == 0 else None
                if name == "energy" and drawn.driven and m == 0:
                    label = "$H$, driven"
                draw_series(axes, drawn.t, visible, drawn.close, label=label, color=colour(i), **style)
        axes.set(yscale="log", ylabel="absolute deviation from start")
        followed = "the energy $H$ and the Casimirs"
        if drawn.solution.work:
            title = f"change of {followed}, which forces move, at the saved points"
        elif drawn.driven:
            title = "change of the driven energy $H$, drift of the Casimirs, at the saved points"
        else:
            title = f"drift of {followed}, at the saved points"
        axes.set_title(title)
        if not any(np.any(values > 0.0) for values in (energy, *deviations.values())):
            axes.text(0.5, 0.5, "no deviation in any bit", transform=axes.transAxes, ha="center", fontsize=9)
        _at_least_two_decades(axes)
        plain_axes(axes)
        key(axes, loc="upper left", bbox_to_anchor=(1.0, 1.0))

    return paint


def _worst(deviations: dict[str, npt.NDArray[np.float64]]) -> dict[str, npt.NDArray[np.float64]]:
    """Return all Casimirs where they are few, else those with the largest deviations."""
    if len(deviations) <= MOST_CASIMIRS:
        return dict(deviations)
    size = {name: float(np.nanmax(values, initial=0.0)) for name, values in deviations.items()}
    worst = sorted(deviations, key=lambda name: -size[name])[: MOST_CASIMIRS - 1]
    return {name: deviations[name] for name in worst}


def _at_least_two_decades(axes: Any) -> None:
    low, high = axes.get_ylim()
    if 0.0 < low < high < 100.0 * low:
        middle = (low * high) ** 0.5
        axes.set_ylim(middle / 10.0, middle * 10.0)


def _draw_band(axes: Any, drawn: Drawn, deviations: npt.NDArray[np.float64]) -> None:
    every = deviations.reshape(-1, deviations.shape[-1])
    every = np.where(every > 0.0, every, np.nan)
    some: npt.NDArray[np.bool_] = np.isfinite(every).any(axis=0)  # type: ignore[assignment]
    low, high = np.full((2, every.shape[1]), np.nan)
    low[some], high[some] = np.nanmin(every[:, some], axis=0), np.nanmax(every[:, some], axis=0)
    label = f"all {len(deviations)} Casimirs"
    axes.fill_between(drawn.t, low, high, color=BAND, alpha=0.4, linewidth=0.5, label=label)
