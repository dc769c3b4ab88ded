"""Figure of the errors of a comparison over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from coadjoint.checkcases.comparison import Comparison
from coadjoint.optional_packages import require_packages

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMALLEST = 1e-17  # of a logarithmic axis: below the rounding of relative errors


def draw_comparison(comparison: Comparison) -> Figure:
    """Return the errors over time, with the tolerance and the accuracy of the reference."""
    require_packages("a picture of the errors", "matplotlib")
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    for errors in comparison.errors:
        label = f"{errors.name} [rad]" if errors.unit == "rad" else f"{errors.name}, relative"
        axes.semilogy(comparison.t, np.maximum(errors.relative, SMALLEST), label=label)
    axes.axhline(comparison.tolerance, color="0.3", linestyle="--", label=f"tolerance, {comparison.tolerance:g}")
    axes.axhspan(SMALLEST, comparison.case.accuracy, color="0.9", label="uncertain in the reference")
    axes.set(xlabel="time [s]", ylabel="error", title=comparison.case.title)
    axes.legend(loc="best", fontsize="small")
    return figure
