"""Figures of results of the analysis: phase errors, structure factors, modified energies, and certificates."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.pictures.style import (
    colour,
    colour_bar,
    ink,
    legend,
    new_figure,
    plain_axes,
    set_title,
    setting,
    symbol,
    with_figure_settings,
    write_note,
)
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.validation import read_integer, read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DECADES = 4.0
"""Range of intensities shown, in powers of ten."""
BRIGHTEST = 10.0
"""Largest intensity shown, in units of the median of the maxima of the wave vectors."""
MARGIN = 1.15
"""Highest frequency shown, in units of the highest visible one."""
LARGEST_DENOMINATOR = 64  # of wave vectors written as fractions

MAX_POINTS = 5000
"""Largest number of points drawn; a printed line does not resolve more."""

PASS_COLOUR, FAIL_COLOUR, UNDECIDED_COLOUR = "#009E73", "#D55E00", "#7F7F7F"
DEFECT_LABELS = {"symmetry": "step back", "reversibility": "reflected step", "poisson": "Poisson bracket"}


@with_figure_settings
def draw_phase_drift(drift: Any, predicted: float | None = None) -> Figure:
    """Return a figure of a `PhaseDrift`; `predicted` is a slope drawn in addition to the fitted line."""
    figure = new_figure("drawing a phase error", 7.2, 5.4)
    lead, rest = figure.subplots(2, 1, sharex=True)
    line = drift.intercept + drift.slope * drift.t
    lead.plot(drift.t, drift.lead, color=colour(0), linewidth=0.9, label="measured")
    label = f"slope {with_error(drift.slope, drift.uncertainty)}"
    lead.plot(drift.t, line, color=colour(1), linewidth=1.1, linestyle="--", label=label)
    if predicted is not None:
        predicted_line = line.mean() + predicted * (drift.t - drift.t.mean())
        lead.plot(
            drift.t, predicted_line, color=colour(2), linewidth=1.4, linestyle=":", label=f"predicted {predicted:.6g}"
        )
    unit = "rad" if drift.unit == "radians" else "unit of time"
    lead.set(ylabel=f"lead [{unit}]")
    lead.set_title(f"phase error: {drift.growth}")
    legend(lead)
    rest.plot(drift.t, drift.lead - line, color=colour(0), linewidth=0.7)
    rest.set(xlabel="time $t$", ylabel="lead - line")
    rest.set_title(f"rest without the line: rms {drift.deviation:.2g}, growing like $t^{{{drift.exponent:.2f}}}$")
    for axes in (lead, rest):
        plain_axes(axes)
        axes.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4), useMathText=True)
    return figure


def with_error(value: float, error: float) -> str:
    """Format a value with its error as mathematical text, with two digits of the error."""
    scale = max(abs(value), error)
    if not scale > 0.0 or not np.isfinite(scale):
        return f"${value:.3g}$"
    power = int(np.floor(np.log10(scale)))
    digits = power - int(np.floor(np.log10(error))) + 1 if error > 0.0 else 6
    return rf"$({value / 10.0**power:.{digits}f} \pm {error / 10.0**power:.{digits}f}) \times 10^{{{power}}}$"


@with_figure_settings
def draw_structure_factor(spectrum: Any) -> Figure:
    """Return a figure of a `StructureFactor`: intensity on a logarithmic scale, corners of the path as ticks."""
    figure = new_figure("drawing a structure factor", 7.2, 4.2)
    from matplotlib.colors import LogNorm

    axes = figure.add_subplot()
    shown = spectrum.omega >= 0.0
    intensity = spectrum.intensity[:, shown].T
    # Elastic lines may be stronger by orders of magnitude than all others.
    top = BRIGHTEST * float(np.median(intensity.max(axis=0))) or 1.0
    lowest, omega = top * 10.0**-DECADES, spectrum.omega[shown]
    mesh = axes.pcolormesh(
        _edges(spectrum.distance),
        _edges(omega),
        np.clip(intensity, lowest, top),
        norm=LogNorm(lowest, top),
        cmap="viridis",
        rasterized=True,
    )
    colour_bar(axes, mesh, r"$S(q, \omega)$", extend="both")
    visible = omega[np.any(intensity > lowest, axis=1)]
    axes.set_ylim(0.0, min(omega[-1], MARGIN * visible.max(initial=omega[1])))
    names = [corner_name(spectrum.q[corner]) for corner in spectrum.corners]
    axes.set_xticks(spectrum.distance[spectrum.corners], names)
    for corner in spectrum.corners[1:-1]:
        axes.axvline(spectrum.distance[corner], color="white", linewidth=0.6)
    axes.set(
        xlabel="wave vector $q$ [reciprocal edges]", ylabel=r"frequency $\omega$", title="dynamic structure factor"
    )
    plain_axes(axes)
    axes.grid(False)
    return figure


def corner_name(q: Any) -> str:
    """Return the components of a wave vector as fractions, such as '(1/2, 0)'."""
    parts = [str(Fraction(float(part)).limit_denominator(LARGEST_DENOMINATOR)) for part in q]
    return parts[0] if len(parts) == 1 else f"({', '.join(parts)})"


def _edges(centres: Any) -> Any:
    """Return the borders between cells around values; a single value has a width of one."""
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2.0 * centres[0] - middle[0]], middle, [2.0 * centres[-1] - middle[-1]]])


@suggest_keywords
@with_figure_settings
def draw_modified_energy(solution: Solution, orders: Sequence[int] = (4, 6, 8)) -> Figure:
    r"""Return a figure of the deviations of the energy and of modified energies from their initial values.

    If the run is the motion of a nearby Hamiltonian system, the deviation of each order is below that of the previous
    one by a factor of about the square of the step, down to round-off, and none grows.

    Parameters
    ----------
    solution : Solution
        By a splitting; of an ensemble the first member is drawn.
    orders : sequence of int
        Orders of the modified Hamiltonians; see `coadjoint.modified_hamiltonian`.

    Returns
    -------
    matplotlib.figure.Figure
        Neither shown nor saved.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
    >>> [line.get_label() for line in draw_modified_energy(sol, orders=(4, 6)).axes[0].lines]
    ['energy $H$', '$\\tilde H$ of order 4', '$\\tilde H$ of order 6']
    """
    check_solution(solution)
    listed = read_list(orders, "orders", "give whole numbers such as (4, 6)")
    checked = [read_integer(order, "an order") for order in listed]
    figure = new_figure("drawing modified energies", 7.2, 4.2)
    axes = figure.add_subplot()
    draw_deviations(axes, solution, checked)
    axes.set_title(f"{solution.system.name}, {solution.method}, step {solution.step:g}".replace("$", r"\$"))
    legend(axes, beside=True)
    return figure


def draw_deviations(axes: Any, solution: Solution, orders: Sequence[int]) -> None:
    """Draw the deviations of energy and modified energies of the first member from their initial values into axes."""
    series = {"energy $H$": solution.energy}
    series |= {rf"$\tilde H$ of order {order}": solution.modified_energy(order) for order in orders}
    at_start = [values.reshape(len(values), -1)[0, 0] for values in series.values()]
    if solution.t[0] != solution.t_span[0]:  # t_eval does not save the start
        at_start = _energies_at_start(solution, orders)
    every = max(1, -(-len(solution.t) // MAX_POINTS))
    for line, ((label, values), initial) in enumerate(zip(series.items(), at_start, strict=True)):
        energy = values.reshape(len(values), -1)[:, 0]
        deviation = np.abs(energy - initial)[::every]
        # Zero deviations have no logarithm, and leave gaps.
        visible = np.where(deviation > 0.0, deviation, np.nan)
        axes.plot(solution.t[::every], visible, color=colour(line), linewidth=0.9, label=label)
    axes.set(yscale="log", xlabel="time $t$", ylabel="absolute deviation from start")
    plain_axes(axes)


def _energies_at_start(solution: Solution, orders: Sequence[int]) -> list[Any]:
    """Return the energy and the modified energies of the initial state of the first member."""
    # As if it were the only saved point.
    start = type(solution)({**vars(solution), "x": np.asarray(solution.x0)[None]})
    return [np.ravel(solution.initial["energy"])[0], *(np.ravel(start.modified_energy(order))[0] for order in orders)]


@with_figure_settings
def draw_certificate(certificate: Any) -> Figure:
    """Return a figure of a certificate: the convergence, the defects, the invariants, and the verdicts."""
    figure = new_figure("drawing a certificate", 11.0, 7.6)
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
        declared = row.declared if len(row.declared) <= 22 else f"{row.declared[:19]}..."
        for x, text, style in (
            (-0.04, name.replace("$", r"\$"), {"color": ink()}),
            (0.40, declared, {"color": UNDECIDED_COLOUR}),
            (0.68, row.verdict, {"color": verdict_colour, "weight": "bold"}),
        ):
            axes.text(x, height, text, fontsize=setting("legend.fontsize"), transform=axes.transAxes, **style)


def _write_note(axes: Any, text: str) -> None:
    axes.set(xticks=[], yticks=[])
    write_note(axes, text)
