"""Quantities over time: velocities and momenta of bodies, observed quantities, and the distance from a closed form."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import draw_members, from_start
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, symbol
from coadjoint.systems.bodies.body_states import FRAMES
from coadjoint.validation import read_choice

Floats = npt.NDArray[np.float64]

MAX_LINES = 8  # as many as there are colours

MAX_TIMES = 400  # points of a curve; a closed form each, which takes time


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
    vectors_by_name = {
        f"${letter}_{i + 1}$" + (f" [{k + 1}]" if several else ""): np.asarray(series[:, :, k, i])
        for k, i in product(range(series.shape[2]), range(3))
    }
    where = "the body" if chosen == "body" else "space"
    return _paint_lines(drawn, vectors_by_name, title, f"{title} in the frame of {where}")


def _paint_lines(drawn: PlottedRun, series: Mapping[str, Floats], ylabel: str, title: str) -> Paint:
    """Return what draws the first `MAX_LINES` series (members, k) over time."""
    lines, note = from_start(dict(list(series.items())[:MAX_LINES]))
    shown = f" ({len(lines)} of {len(series)})" if len(lines) < len(series) else ""

    def paint(axes: Any) -> None:
        for number, (label, members) in enumerate(lines.items()):
            draw_members(axes, drawn.t, members, drawn.dense, colour(number), label)
        axes.set(xlabel="time $t$", ylabel=ylabel + note, title=title + shown)
        plain_axes(axes)
        legend(axes, beside=True)

    return paint


@kind("observed", over_time=True)
def observed(drawn: PlottedRun) -> Paint:
    """Show the observed quantities (``observe=``) that are numbers, at most the first eight."""
    series = {name: drawn.select(values) for name, values in drawn.solution.observed.items()}
    numbers = {name: values for name, values in series.items() if values.ndim == 2 and values.dtype.kind in "fiub"}
    if not numbers:
        raise CannotShow("nothing was observed; integrate with observe={name: function}")
    lines = {symbol(name): values.astype(np.float64) for name, values in numbers.items()}
    return _paint_lines(drawn, lines, "observed quantity", "observed")


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
