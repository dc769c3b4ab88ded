"""Figure of a phase error: the lead with its fitted line, and the remainder."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.optional_packages import require_packages
from coadjoint.pictures.style import colour, legend, plain_axes, with_figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@with_figure_settings
def draw_phase_drift(drift: Any, predicted: float | None = None) -> Figure:
    """Return a figure of a `PhaseDrift`; `predicted` is a slope drawn in addition to the fitted line.

    Examples
    --------
    >>> from coadjoint.analysis.phase_drift import drift_of_series
    >>> t = np.arange(400) * 0.5
    >>> [axes.get_ylabel() for axes in draw_phase_drift(drift_of_series(t, 0.1 * t + np.cos(t))).axes]
    ['lead [unit of time]', 'lead - line']
    """
    require_packages("drawing a phase error", "matplotlib")
    from coadjoint.pictures.figure import ShownFigure
    from coadjoint.pictures.layout import PanelLayout

    figure = ShownFigure(figsize=(7.2, 5.4), layout=PanelLayout())
    lead, rest = figure.subplots(2, 1, sharex=True)
    line = drift.intercept + drift.slope * drift.t
    lead.plot(drift.t, drift.lead, color=colour(0), linewidth=0.9, label="measured")
    label = f"slope {with_error(drift.slope, drift.uncertainty)}"
    lead.plot(drift.t, line, color=colour(1), linewidth=1.1, linestyle="--", label=label)
    if predicted is not None:
        predicted_line = line.mean() + predicted * (drift.t - drift.t.mean())
        lead.plot(
            drift.t, predicted_line, color=colour(2), linewidth=1.4, linestyle=":", label=f"predicted {predicted:.6g}"
        )
    unit = "rad" if drift.unit == "radians" else "unit of time"
    lead.set(ylabel=f"lead [{unit}]")
    lead.set_title(f"phase error: {drift.growth}")
    legend(lead)
    rest.plot(drift.t, drift.lead - line, color=colour(0), linewidth=0.7)
    rest.set(xlabel="time $t$", ylabel="lead - line")
    rest.set_title(f"rest without the line: rms {drift.deviation:.2g}, growing like $t^{{{drift.exponent:.2f}}}$")
    for axes in (lead, rest):
        plain_axes(axes)
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4), useMathText=True)
    return figure


def with_error(value: float, error: float) -> str:
    r"""Format a value with its (nonnegative) error as mathematical text, with two digits of the error.

    Examples
    --------
    >>> with_error(-0.00123456, 1.2e-6)
    '$(-1.2346 \\pm 0.0012) \\times 10^{-3}$'
    """
    scale = max(abs(value), error)
    if not scale > 0.0 or not np.isfinite(scale):
        return f"${value:.3g}$"
    power = int(np.floor(np.log10(scale)))
    digits = power - int(np.floor(np.log10(error))) + 1 if error > 0.0 else 6
    return rf"$({value / 10.0**power:.{digits}f} \pm {error / 10.0**power:.{digits}f}) \times 10^{{{power}}}$"
