"""Observed quantities of a run over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.series import draw_members, from_start
from coadjoint.pictures.style import colour, legend, plain_axes, symbol

MAX_OBSERVED = 8  # as many as there are colours


@kind("observed", over_time=True)
def observed(drawn: PlottedRun) -> Paint:
    """Show the observed quantities (``observe=``) that are numbers, at most the first eight."""
    series = {name: drawn.select(values) for name, values in drawn.solution.observed.items()}
    numbers = {name: values for name, values in series.items() if values.ndim == 2 and values.dtype.kind in "fiub"}
    if not numbers:
        raise CannotShow("nothing was observed; integrate with observe={name: function}")
    lines = {name: values.astype(np.float64) for name, values in list(numbers.items())[:MAX_OBSERVED]}
    lines, note = from_start(lines)

    def paint(axes: Any) -> None:
        for i, (name, members) in enumerate(lines.items()):
            draw_members(axes, drawn.t, members, drawn.dense, colour(i), symbol(name))
        title = "observed" + (f" ({len(lines)} of {len(numbers)})" if len(lines) < len(numbers) else "")
        axes.set(xlabel="time $t$", ylabel="observed quantity" + note, title=title)
        plain_axes(axes)
        legend(axes, beside=True)

    return paint
