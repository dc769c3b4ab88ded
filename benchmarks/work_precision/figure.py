"""The work-precision diagrams: one panel for each system."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from work_precision.report import OURS, STEPPING, TARGETS, by_solver, front

SAMPLED_PARTS = {
    OURS: dict(color="black", marker="o", linewidth=2.2, zorder=5),
    STEPPING: dict(color="black", marker="", linewidth=1.4, linestyle=":", zorder=5),
    "coadjoint, not projected": dict(color="black", marker="", linewidth=1.0, linestyle="--", zorder=5),
    "coadjoint, scanned": dict(color="tab:orange", marker="."),
    "heyoka": dict(color="tab:red", marker="s"),
    "numbalsoda dop853": dict(color="tab:blue", marker="^"),
    "numbalsoda lsoda": dict(color="tab:cyan", marker="v"),
    "diffrax Dopri8": dict(color="tab:green", marker="D"),
    "SciPy DOP853": dict(color="tab:purple", marker="<"),
    "SciPy LSODA": dict(color="tab:pink", marker=">"),
    "NumPy RK4": dict(color="tab:gray", marker="x"),
}


def draw(measured: dict[str, Any], path: Path) -> None:
    """Save the figure; accuracy grows to the right, and lower is faster."""
    problems = measured["problems"]
    columns = min(3, len(problems))
    rows = -(-len(problems) // columns)
    figure = Figure(figsize=(4.4 * columns, 3.7 * rows + 0.9), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False)
    for panel in panels.flat[len(problems) :]:
        panel.axis("off")
    shown: dict[str, Any] = {}
    for panel, (name, found) in zip(panels.flat, problems.items(), strict=False):
        for solver, runs in by_solver(found["runs"]).items():
            curve = front(runs)
            look = SAMPLED_PARTS[solver]
            panel.plot([run["error"] for run in curve], [1e3 * run["cpu"] for run in curve], markersize=4.5, **look)
            shown[solver] = Line2D([], [], markersize=4.5, **look)
        panel.set(xscale="log", yscale="log", xlim=(1.0, 1e-14), title=f"{name}, t = {found['span']:g}")
        panel.set_xticks(TARGETS)
        panel.grid(alpha=0.3)
    for panel in panels[-1]:
        panel.set_xlabel("relative error at the end, worst state")
    for row in panels:
        row[0].set_ylabel("CPU time of one trajectory, ms")
    figure.legend(
        shown.values(),
        shown.keys(),
        loc="outside lower center",
        ncols=2 * columns - 1 if columns > 1 else 2,
        frameon=False,
    )
    figure.savefig(path, dpi=130)
