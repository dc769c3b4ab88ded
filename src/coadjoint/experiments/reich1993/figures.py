"""Reproductions of figures 1 to 5 of Reich (1993)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.experiments.reich1993.body_runs import MODIFIED, RUNGE, SPLITTING, BodyRun, body_run
from coadjoint.experiments.reich1993.section5_spiral import MODIFIED as MODIFIED_ON_SPIRAL
from coadjoint.experiments.reich1993.section5_spiral import spiral_run
from coadjoint.experiments.reich1993.systems import (
    BODY_END,
    BODY_LATER,
    BODY_START,
    BODY_STEP,
    COORDINATES,
    SPIRAL_END,
    SPIRAL_STEP,
)
from coadjoint.methods.protocol.method import Method
from coadjoint.pictures.style import INK, colour, key, plain_axes
from coadjoint.runs.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 160  # dots per inch
DENSE_SPACING = 1e-3  # time spacing of the exact motion in plots


def write_figures(folder: Path) -> list[Path]:
    """Draw figures 1 to 5 and write them to an existing folder as figure1.png ... figure5.png."""
    figures = [
        drift_figure(spiral_run(COORDINATES), 1, "Lie-Poisson integrator"),
        drift_figure(spiral_run(MODIFIED_ON_SPIRAL), 2, "$M$-orthogonal integrator"),
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
    """Plot the drift of the Hamiltonian (dotted) and the Casimir (solid) on A3,7; every step must be saved.

    Left: signed deviations, as in the paper; right: absolute values on a logarithmic scale.
    """
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
    key(signed)
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
    drawn = figure.legend(handles, labels, loc="outside lower center", ncols=2, fontsize=8.5, frameon=False)
    for line in drawn.get_lines():
        line.set_linewidth(1.4)
    _caption(
        figure,
        f"Fig. {number}. Numerical values of $A(1,1)$ for the {scheme} (solid line)\ncompared to the exact "
        "solution (dotted line).",
        rf"rigid body, $M = \mathrm{{diag}}(1, 1/2, 1/3)$, $x(0) = (1, 10, 1)$, $A(0) = I$, $h = {BODY_STEP:g}$",
    )
    return figure


def _draw_attitude(axes: Any, run: BodyRun, end: float, scheme: str) -> None:
    from coadjoint.systems.examples.paper_examples import paper_rigid_body

    attitude = run.solution.attitude
    assert attitude is not None
    last = run.at(end) + 1
    times = np.arange(0.0, end + DENSE_SPACING / 2, DENSE_SPACING)
    exact = paper_rigid_body().exact(BODY_START, times, attitude=True)[1][:, 0, 0]
    long = end > BODY_END
    axes.plot(
        run.solution.t[:last],
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
