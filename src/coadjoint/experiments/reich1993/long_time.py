"""Long-time behaviour, not shown in the figures of Reich (1993)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.experiments.reich1993.body_runs import MIDPOINT, MODIFIED, SPLITTING, body_run
from coadjoint.experiments.reich1993.figures import RESOLUTION
from coadjoint.experiments.reich1993.systems import CALM_START, CALM_STEP
from coadjoint.methods.protocol.method import Method
from coadjoint.pictures.phase_drift import with_error
from coadjoint.pictures.style import INK, colour, plain_axes
from coadjoint.runs.integrate import integrate
from coadjoint.systems.examples.paper_examples import paper_rigid_body

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMES: dict[str, tuple[Method, str]] = {
    "implicit midpoint rule": (MIDPOINT, "--"),
    "modified midpoint rule": (MODIFIED, "-."),
    "splitting": (SPLITTING, "-"),
}
POINTS = 10_000  # saved points of the longest runs


def write_long_time(folder: Path, phase_end: float, steps: int) -> Path:
    """Draw long_time.png in an existing folder and return its path; parameters as in `reproduce`."""
    path = folder / "long_time.png"
    long_time_figure(phase_end, steps).savefig(path, dpi=RESOLUTION)
    return path


def long_time_figure(phase_end: float, steps: int) -> Figure:
    """Plot phase errors against time, and the drift of energy and Casimir over many steps, in four panels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.2, 6.6), layout="constrained")
    (angle, phase), (energy, casimir) = figure.subplots(2, 2)
    for number, (name, (method, style)) in enumerate(SCHEMES.items()):
        line: dict[str, Any] = {"color": colour(number), "linestyle": style, "linewidth": 1.2, "label": name}
        run = body_run(method, CALM_START, phase_end, CALM_STEP, 10)
        angle.plot(run.solution.t[1:], run.angle[1:], **line)
        if method is SPLITTING:
            drift = run.drift
            phase.plot(run.solution.t, run.phase, **{**line, "linewidth": 0.9})
            phase.plot(drift.t, drift.intercept + drift.slope * drift.t, color=INK, linestyle=":", linewidth=1.2)
            fitted = f"{drift.growth}, slope {with_error(drift.slope, drift.uncertainty)}"
        _draw_drift(energy, casimir, method, steps, line)
    angle.set(xlabel="time $t$", ylabel="attitude error [rad]", xscale="log", yscale="log")
    angle.set_title("angle between computed and exact attitude")
    phase.set(xlabel="time $t$", ylabel="phase error [rad]")
    phase.axhline(0.0, color=INK, linewidth=0.6)
    phase.ticklabel_format(axis="y", style="sci", scilimits=(0, 0), useMathText=True)
    phase.set_title(f"splitting: signed angle about the spatial momentum $A\\,x$\n{fitted}")
    energy.set(xlabel="steps", ylabel="largest $|H - H(0)|$ so far", xscale="log", yscale="log")
    energy.set_title("drift of the energy")
    casimir.set(xlabel="steps", ylabel="largest change of $|x|^2$ so far", xscale="log", yscale="log")
    casimir.set_title("drift of the Casimir $|x|^2 = 5.25$")
    for axes in (angle, phase, energy, casimir):
        plain_axes(axes)
    handles, labels = angle.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9, frameon=False, handlelength=3.0)
    figure.suptitle(
        "Rigid body over long times\n"
        rf"$M = \mathrm{{diag}}(1, 1/2, 1/3)$, $x(0) = (1, 2, 1/2)$, $A(0) = I$, $h = {CALM_STEP:g}$",
        fontsize=10,
        color=INK,
    )
    return figure


def _draw_drift(energy: Any, casimir: Any, method: Method, steps: int, line: dict[str, Any]) -> None:
    save_every = steps // POINTS
    run = integrate(paper_rigid_body(), CALM_START, (0.0, steps * CALM_STEP), CALM_STEP, method, save_every=save_every)
    for axes, values in ((energy, run.energy), (casimir, run.casimirs["|x|^2"])):
        largest = np.maximum.accumulate(np.abs(values - values[0]))
        seen = largest > 0.0
        axes.plot(run.t[seen] / CALM_STEP, largest[seen], **line)
