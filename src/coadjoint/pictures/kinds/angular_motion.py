"""Angular velocities and momenta of bodies over time."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.series import draw_members, from_start
from coadjoint.pictures.style import colour, legend, plain_axes
from coadjoint.systems.bodies.body_states import FRAMES
from coadjoint.validation import read_choice

MAX_LINES = 8  # as many as there are colours


@kind("angular velocity", over_time=True)
def angular_velocity(drawn: PlottedRun, frame: str = "body") -> Paint:
    """Show the components of the angular velocity of bodies, at most eight.

    Parameters
    ----------
    frame : {"body", "space"}
        Frame of the components; space needs the attitude.
    """
    return _paint(drawn, "angular_velocity", r"\Omega", frame)


@kind("angular momentum", over_time=True)
def angular_momentum(drawn: PlottedRun, frame: str = "body") -> Paint:
    """Show the components of the angular momentum of bodies, at most eight.

    Parameters
    ----------
    frame : {"body", "space"}
        Frame of the components; space needs the attitude.
    """
    return _paint(drawn, "angular_momentum", "L", frame)


def _paint(drawn: PlottedRun, name: str, letter: str, frame: str) -> Paint:
    chosen, solution, title = read_choice(frame, "frame", FRAMES), drawn.solution, name.replace("_", " ")
    try:
        vectors = getattr(solution, name)
        if chosen == "space":
            vectors = solution.in_space(vectors)
    except (TypeError, ValueError) as error:
        raise CannotShow(str(error)) from None
    series = drawn.select(vectors)
    series = series.reshape(*series.shape[:2], -1, 3)
    several = series.shape[2] > 1
    components = list(product(range(series.shape[2]), range(3)))
    lines = {
        f"${letter}_{i + 1}$" + (f" [{k + 1}]" if several else ""): np.asarray(series[:, :, k, i])
        for k, i in components[:MAX_LINES]
    }
    lines, note = from_start(lines)

    def paint(axes: Any) -> None:
        for number, (label, members) in enumerate(lines.items()):
            draw_members(axes, drawn.t, members, drawn.dense, colour(number), label)
        shown = f" ({len(lines)} of {len(components)})" if len(lines) < len(components) else ""
        where = "the body" if chosen == "body" else "space"
        axes.set(xlabel="time $t$", ylabel=title + note, title=f"{title} in the frame of {where}{shown}")
        plain_axes(axes)
        legend(axes, beside=True)

    return paint
