"""Distance of a run from a closed form, if one is known."""

from __future__ import annotations

from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.series import draw_members
from coadjoint.pictures.style import colour, plain_axes

MAX_TIMES = 400  # points of a curve; a closed form each, which takes time


@kind("error", over_time=True)
def error(drawn: PlottedRun) -> Paint:
    """Show the distance from the closed form, relative to the size of the initial state, at up to 400 times.

    For a motion that stays on its orbit it is the phase error. Batches are not supported.
    """
    system = drawn.system
    if system.closed_form is None or drawn.solution.system.is_batch:
        raise CannotShow(f"no closed form is known for {drawn.solution.system.name}")
    indices = spread(len(drawn.t), MAX_TIMES)
    t = drawn.t[indices]
    errors_of_members = []
    for states, x0 in zip(drawn.x, drawn.x0, strict=True):
        exact = np.asarray(system.exact(x0, t - drawn.solution.t_span[0]))
        size = float(np.linalg.norm(x0)) or 1.0
        errors_of_members.append(np.linalg.norm(states[indices] - exact, axis=-1) / size)
    errors = np.array(errors_of_members)

    def paint(axes: Any) -> None:
        # Zero errors have no logarithm, and leave gaps.
        draw_members(axes, t, np.where(errors > 0.0, errors, np.nan), drawn.dense, colour(0), None)
        axes.set(xlabel="time $t$", ylabel="relative error", title="distance from the closed form")
        if np.any(errors > 0.0):
            axes.set_yscale("log")
        plain_axes(axes)

    return paint
