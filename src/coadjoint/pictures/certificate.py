"""Figure of a certificate: errors and defects over the step, and invariants over time."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.optional_packages import require_packages
from coadjoint.pictures.style import colour, ink, legend, plain_axes, set_title, setting, symbol, with_figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PASS_COLOUR, FAIL_COLOUR, UNDECIDED_COLOUR = "#009E73", "#D55E00", "#7F7F7F"
DEFECT_LABELS = {"symmetry": "step back", "reversibility": "reflected step", "poisson": "Poisson bracket"}


@with_figure_settings
def draw_certificate(certificate: Any) -> Figure:
    """Return a figure of a certificate: the convergence, the defects, the invariants, and the verdicts."""
    require_packages("drawing a certificate", "matplotlib")
    from coadjoint.pictures.layout import PanelLayout, ShownFigure

    figure = ShownFigure(figsize=(11.0, 7.6), layout=PanelLayout())
    grid = figure.add_gridspec(2, 2, height_ratios=[1.0, 1.0])
    rows = {row.key: row for row in certificate.rows}
    _draw_errors(figure.add_subplot(grid[0, 0]), rows["order"], certificate.subject["step"])
    _draw_defects(figure.add_subplot(grid[0, 1]), rows)
    _draw_invariants(figure.add_subplot(grid[1, 0]), certificate.rows)
    _draw_verdicts(figure.add_subplot(grid[1, 1]), certificate.rows)
    subject = certificate.subject
    result = "passed" if certificate.passed else "not passed"
    if not certificate.declares:
        result = "nothing declared"
    text = f"{subject['system']['name']},  {subject['scheme']['shown']},  step {subject['step']:g}:  {result}"
    figure.suptitle(text.replace("$", r"\$"))
    return figure


def _draw_errors(axes: Any, row: Any, step: float) -> None:
    axes.set(xlabel="step $h$", ylabel="relative error", title="errors against the reference")
    plain_axes(axes)
    if "steps" not in row.evidence:
        return _write_note(axes, row.reason)
    steps, errors, rounding = (np.asarray(row.evidence[name]) for name in ("steps", "errors", "round-off"))
    axes.set(xscale="log", yscale="log")
    axes.plot(steps, errors, "o-", color=colour(0), markersize=4, linewidth=0.9, label="error")
    axes.plot(steps, rounding, ":", color=UNDECIDED_COLOUR, linewidth=0.9, label="round-off, at most")
    if "fitted steps" in row.evidence and row.value is not None:
        h, e = np.asarray(row.evidence["fitted steps"]), np.asarray(row.evidence["fitted errors"])
        single_steps = row.evidence["fitted of"] == "of single steps"
        power = row.value + (1.0 if single_steps else 0.0)
        if single_steps:
            axes.plot(h, e, "s", color=colour(3), markersize=4, label="error of a step")
        axes.plot(h, e[-1] * (h / h[-1]) ** power, "--", color=ink(), linewidth=0.9, label=f"$h^{{{power:.2f}}}$")
    axes.axvline(abs(step), color=UNDECIDED_COLOUR, linewidth=0.6)
    legend(axes)


def _draw_defects(axes: Any, rows: dict[str, Any]) -> None:
    axes.set(xlabel="step $h$", ylabel="defect", title="defects")
    plain_axes(axes)
    drawn = 0
    for number, (name, label) in enumerate(DEFECT_LABELS.items()):
        evidence = rows[name].evidence
        if "steps" not in evidence:
            continue
        drawn += 1
        style = {"color": colour(number), "markersize": 4, "linewidth": 0.9}
        label = f"{label}, $h^{{{evidence['slope']:.1f}}}$"
        axes.plot(evidence["steps"], evidence["defects"], "o-", label=label, **style)
    if not drawn:
        return _write_note(axes, "no defect above round-off")
    axes.set(xscale="log", yscale="log")
    legend(axes)


def _draw_invariants(axes: Any, rows: Any) -> None:
    title = "deviations of the invariants, root mean square"
    axes.set(xlabel="time since the start", ylabel="absolute deviation", title=title)
    plain_axes(axes)
    shown = [row for row in rows if "deviations" in row.evidence]
    for number, row in enumerate(shown):
        times = np.abs(np.asarray(row.evidence["times"]))[1:]
        sizes = np.sqrt(np.mean(np.asarray(row.evidence["deviations"])[1:] ** 2, axis=1))
        name = symbol(row.key.removeprefix("casimir "))
        axes.plot(times, np.where(sizes > 0.0, sizes, np.nan), color=colour(number), linewidth=0.9, label=name)
    if not any(np.any(np.asarray(row.evidence["deviations"])) for row in shown):
        return _write_note(axes, "no deviation in any bit" if shown else "no invariant is followed")
    axes.set(xscale="log", yscale="log")
    legend(axes, beside=True)


def _draw_verdicts(axes: Any, rows: Any) -> None:
    axes.axis("off")
    set_title(axes, "asked, declared, and found")
    line_height = 1.0 / max(1, len(rows))
    for number, row in enumerate(rows):
        height = 1.0 - (number + 0.6) * line_height
        verdict_colour = {"holds": PASS_COLOUR, "fails": FAIL_COLOUR}.get(
            row.verdict, FAIL_COLOUR if row.claimed and "not dec" in row.verdict else UNDECIDED_COLOUR
        )
        name = row.what if len(row.what) <= 30 else f"{row.what[:27]}..."
        axes.text(
            -0.04,
            height,
            name.replace("$", r"\$"),
            fontsize=setting("legend.fontsize"),
            color=ink(),
            transform=axes.transAxes,
        )
        declared = row.declared if len(row.declared) <= 22 else f"{row.declared[:19]}..."
        axes.text(
            0.40,
            height,
            declared,
            fontsize=setting("legend.fontsize"),
            color=UNDECIDED_COLOUR,
            transform=axes.transAxes,
        )
        axes.text(
            0.68,
            height,
            row.verdict,
            fontsize=setting("legend.fontsize"),
            color=verdict_colour,
            weight="bold",
            transform=axes.transAxes,
        )


def _write_note(axes: Any, text: str) -> None:
    axes.set(xticks=[], yticks=[])
    axes.text(
        0.5,
        0.5,
        "\n".join(textwrap.wrap(text, 50)),
        transform=axes.transAxes,
        ha="center",
        fontsize=setting("axes.labelsize"),
    )
