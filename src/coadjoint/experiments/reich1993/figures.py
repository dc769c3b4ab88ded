"""Figures 1 to 5 of Reich (1993), modified energies along the runs of section 5, and long-time behaviour."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.experiments.reich1993.section5 import spiral_run
from coadjoint.experiments.reich1993.statements import (
    BODY_END,
    BODY_LATER,
    BODY_START,
    BODY_STEP,
    CALM_START,
    CALM_STEP,
    COORDINATES,
    M_ORTHOGONAL,
    MIDPOINT,
    MODIFIED,
    RUNGE,
    SPIRAL_END,
    SPIRAL_STEP,
    SPLITTING,
    attitude_error,
    attitude_of,
    body_run,
    index_of_time,
    precession_drift,
    precession_lead,
)
from coadjoint.methods.protocol.method import Method
from coadjoint.pictures.analysis_figures import with_error
from coadjoint.pictures.kinds.quantities import draw_deviations
from coadjoint.pictures.style import INK, colour, legend, plain_axes
from coadjoint.runs.integrate import integrate
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.examples.paper_examples import paper_rigid_body

if TYPE_CHECKING:
    from matplotlib.figure import Figure


RESOLUTION = 160  # dots per inch
DENSE_SPACING = 1e-3  # time spacing of the exact motion in plots

LONG_RUN_SCHEMES: dict[str, tuple[Method, str]] = {
    "implicit midpoint rule": (MIDPOINT, "--"),
    "modified midpoint rule": (MODIFIED, "-."),
    "splitting": (SPLITTING, "-"),
}
LONG_RUN_POINTS = 10_000  # saved points of the longest runs

MODIFIED_ENERGY_ORDERS = (4, 6, 8)
# At the paper's step of 0.1 the body turns by a radian or more per step, too much for the series in h.
MODIFIED_ENERGY_STEP = 0.025


def write_figures(folder: Path) -> list[Path]:
    """Draw figures 1 to 5 and write them to an existing folder as figure1.png ... figure5.png."""
    figures = [
        drift_figure(spiral_run(COORDINATES), 1, "Lie-Poisson integrator"),
        drift_figure(spiral_run(M_ORTHOGONAL), 2, "$M$-orthogonal integrator"),
        attitude_figure(RUNGE, 3, "explicit Runge method of order 2"),
        attitude_figure(MODIFIED, 4, "modified midpoint rule"),
        attitude_figure(SPLITTING, 5, "Lie-Poisson integrator of order 2"),
    ]
    paths = []
    for number, figure in enumerate(figures, 1):
        paths.append(folder / f"figure{number}.png")
        figure.savefig(paths[-1], dpi=RESOLUTION)
    return paths


def drift_figure(run: Solution, number: int, scheme: str) -> Figure:
    """Plot the drift of H (dotted) and the Casimir (solid) on A3,7: signed, as in the paper, and logarithmic."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.9), layout="constrained")
    signed, size = figure.subplots(1, 2)
    styles: dict[str, tuple[Any, dict[str, Any]]] = {
        "Hamiltonian, $H - H(0)$": (run.energy, {"color": colour(1), "linestyle": ":", "linewidth": 1.8}),
        r"Casimir, $\log C - \log C(0)$": (
            run.casimirs["log C"],
            {"color": colour(0), "linestyle": "-", "linewidth": 1.1},
        ),
    }
    for label, (values, style) in styles.items():
        change = values - values[0]
        signed.plot(run.t, change, label=label, **style)
        # Zero deviations have no logarithm.
        size.plot(run.t, np.where(change != 0.0, np.abs(change), np.nan), label=label, **style)
    signed.set(xlabel="time $t$", ylabel="drift")
    signed.ticklabel_format(axis="y", style="sci", scilimits=(0, 0), useMathText=True)
    signed.yaxis.get_offset_text().set_fontsize(8)
    size.set(xlabel="time $t$", ylabel="size of the drift", yscale="log", ylim=(1e-17, 1e-3))
    for axes in (signed, size):
        axes.set(xlim=(0.0, SPIRAL_END), xticks=np.arange(0.0, SPIRAL_END + 1.0, 5.0))
        plain_axes(axes)
    legend(signed)
    _caption(
        figure,
        f"Fig. {number}. Drift in the Hamiltonian (dotted line) and in the Casimir function (solid line) for "
        f"the {scheme}.",
        rf"$A_{{3,7}}^a$, $a = 2$, $M = \mathrm{{diag}}(1, 2, 0.01)$, $x(0) = (1, 1, 1)$, $h = {SPIRAL_STEP:g}$",
    )
    return figure


def attitude_figure(method: Method, number: int, scheme: str) -> Figure:
    """Plot A(1,1) of the rigid body (solid) and the exact one (dotted), up to t = 5 as in the paper and t = 50."""
    from matplotlib.figure import Figure

    run = body_run(method, BODY_START, BODY_LATER, BODY_STEP)
    figure = Figure(figsize=(8.2, 5.4), layout="constrained")
    for axes, end in zip(figure.subplots(2, 1), (BODY_END, BODY_LATER), strict=True):
        _draw_attitude(axes, run, end, scheme)
        plain_axes(axes)
    axes.set_xlabel("time $t$")
    handles, labels = axes.get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    for line in legend.get_lines():
        line.set_linewidth(1.4)
    _caption(
        figure,
        f"Fig. {number}. Numerical values of $A(1,1)$ for the {scheme} (solid line)\ncompared to the exact "
        "solution (dotted line).",
        rf"rigid body, $M = \mathrm{{diag}}(1, 1/2, 1/3)$, $x(0) = (1, 10, 1)$, $A(0) = I$, $h = {BODY_STEP:g}$",
    )
    return figure


def _draw_attitude(axes: Any, run: Solution, end: float, scheme: str) -> None:
    attitude, last = attitude_of(run), index_of_time(run, end) + 1
    times = np.arange(0.0, end + DENSE_SPACING / 2, DENSE_SPACING)
    exact = paper_rigid_body().exact(BODY_START, times, attitude=True)[1][:, 0, 0]
    long = end > BODY_END
    axes.plot(
        run.t[:last],
        attitude[:last, 0, 0],
        color=colour(0),
        linestyle="-",
        linewidth=0.8 if long else 1.1,
        marker=None if long else ".",
        markersize=4.0,
        label=scheme,
    )
    axes.plot(times, exact, color=colour(1), linestyle=":", linewidth=1.0 if long else 1.8, label="exact solution")
    highest = max(1.0, float(np.max(np.abs(attitude[:last, 0, 0]))))
    axes.set(xlim=(0.0, end), ylabel="$A(1,1)$")
    if highest > 10.0:
        # The matrix is no longer a rotation: linear axis within [-1, 1], logarithmic beyond.
        axes.set_yscale("symlog", linthresh=2.0, linscale=1.0)
        axes.set_yticks([-1000, -100, -10, -1, 1, 10, 100, 1000])
    axes.set_ylim(-1.08 * highest, 1.08 * highest)


def _caption(figure: Any, title: str, setting: str) -> None:
    figure.suptitle(f"{title}\n{setting}", fontsize=9.5, color=INK)


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
    for number, (name, (method, style)) in enumerate(LONG_RUN_SCHEMES.items()):
        line: dict[str, Any] = {"color": colour(number), "linestyle": style, "linewidth": 1.2, "label": name}
        run = body_run(method, CALM_START, phase_end, CALM_STEP, 10)
        angle.plot(run.t[1:], attitude_error(run)[1:], **line)
        if method is SPLITTING:
            drift = precession_drift(run)
            phase.plot(run.t, precession_lead(run), **{**line, "linewidth": 0.9})
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
    save_every = steps // LONG_RUN_POINTS
    run = integrate(paper_rigid_body(), CALM_START, (0.0, steps * CALM_STEP), CALM_STEP, method, save_every=save_every)
    for axes, values in ((energy, run.energy), (casimir, run.casimirs["|x|^2"])):
        largest = np.maximum.accumulate(np.abs(values - values[0]))
        seen = largest > 0.0
        axes.plot(run.t[seen] / CALM_STEP, largest[seen], **line)


def write_modified_energies(folder: Path) -> Path:
    """Draw modified_energies.png in an existing folder and return its path."""
    path = folder / "modified_energies.png"
    modified_energy_figure().savefig(path, dpi=RESOLUTION)
    return path


def modified_energy_figure() -> Figure:
    """Plot the deviation of H and of the modified Hamiltonians of orders 4, 6 and 8 along three runs of a splitting."""
    from matplotlib.figure import Figure

    body = paper_rigid_body()
    runs = {
        "$A_{3,7}^a$ as in figure 1, $h = 0.01$": spiral_run(COORDINATES),
        f"rigid body, $x(0) = (1, 10, 1)$, $h = {MODIFIED_ENERGY_STEP:g}$": integrate(
            body, BODY_START, (0.0, BODY_LATER), MODIFIED_ENERGY_STEP, COORDINATES
        ),
        f"rigid body, $x(0) = (1, 2, 1/2)$, $h = {MODIFIED_ENERGY_STEP:g}$": integrate(
            body, CALM_START, (0.0, BODY_LATER), MODIFIED_ENERGY_STEP, COORDINATES
        ),
    }
    figure = Figure(figsize=(12.0, 4.2), layout="constrained")
    panels = figure.subplots(1, 3, sharey=True)
    for axes, (title, run) in zip(panels, runs.items(), strict=True):
        draw_deviations(axes, run, MODIFIED_ENERGY_ORDERS)
        axes.set_title(title, fontsize=9.5, color=INK)
        axes.set(ylim=(1e-18, 1e1))
        axes.label_outer()
    legend(panels[0])
    figure.suptitle(
        "Section 6. The Lie-Poisson integrator solves a nearby system: energy $H$ and modified energies $\\tilde H$",
        fontsize=9.5,
        color=INK,
    )
    return figure
