"""Quantities over time: drifts of invariants, velocities of bodies, observed quantities, errors of a closed form."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.pictures.curves import draw_members, from_start
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Paint, kind
from coadjoint.pictures.style import colour, legend, plain_axes, symbol, thickness, write_note
from coadjoint.systems.bodies.body_systems import FRAMES
from coadjoint.validation import read_choice

Floats = npt.NDArray[np.float64]

MAX_LINES = 8  # as many as there are colours

MAX_TIMES = 400  # points of a curve; a closed form each, which takes time

MAX_CASIMIRS = 5
"""Largest number of Casimirs drawn as lines; of more, the worst four are drawn, with a band of all."""
BAND_COLOUR = "#9AA7B5"


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


def _draw_dotted(axes: Any, drawn: PlottedRun, members: Floats, shade: str, label: str | None) -> None:
    for m, values in enumerate(members):
        visible = np.where(values > 0.0, values, np.nan)
        axes.plot(drawn.t, visible, ":", color=shade, linewidth=thickness(0.8), label=label if m == 0 else None)


def _worst(deviations: dict[str, Floats]) -> dict[str, Floats]:
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


def _draw_band(axes: Any, drawn: PlottedRun, deviations: Floats) -> None:
    series = deviations.reshape(-1, deviations.shape[-1])
    series = np.where(series > 0.0, series, np.nan)
    finite: npt.NDArray[np.bool_] = np.isfinite(series).any(axis=0)  # type: ignore[assignment]
    low, high = np.full((2, series.shape[1]), np.nan)
    low[finite], high[finite] = np.nanmin(series[:, finite], axis=0), np.nanmax(series[:, finite], axis=0)
    label = f"all {len(deviations)} Casimirs"
    axes.fill_between(drawn.t, low, high, color=BAND_COLOUR, alpha=0.4, linewidth=0.5, label=label)


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
