"""Figures of results that have a method `plot`: phase errors, structure factors, crossings, certificates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.pictures.register import coordinate_index
from coadjoint.pictures.style import (
    COLOURS,
    colour,
    colour_bar,
    colour_scale,
    coordinate,
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
from coadjoint.validation import read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DECADES = 4.0
"""Range of intensities shown, in powers of ten."""
BRIGHTEST = 10.0
"""Largest intensity shown, in units of the median of the maxima of the wave vectors."""
MARGIN = 1.15
"""Highest frequency shown, in units of the highest visible one."""
LARGEST_DENOMINATOR = 64  # of wave vectors written as fractions
CHARACTERS_ACROSS = 85  # of labels side by side below a path


LARGEST_DOT = 60.0  # area of the brightest mode, in square points
MAX_LARGE_DOTS = 2000
"""Largest number of crossings drawn with dots of full size."""
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
def draw_structure_factor(spectrum: Any, energies: Any = None, modes: Any = None) -> Figure:
    """Return a figure of a `StructureFactor`: intensity over a path or shells, with modes, or over a plane."""
    figure = new_figure("drawing a structure factor", 7.2, 4.2)
    axes = figure.add_subplot()
    if len(spectrum.shape) > 1:
        _draw_plane(axes, spectrum, energies, modes)
        return figure
    if modes is not None and not (
        modes.q.shape[1] == spectrum.q.shape[1] > 1
        and np.array_equal(modes.corners.shape, spectrum.corners.shape)
        and np.allclose(modes.q[modes.corners], spectrum.q[spectrum.corners], atol=1e-9)
    ):
        raise ValueError(f"modes are {modes!r}, of another path; compute them along that of {spectrum!r}")
    shown = spectrum.omega >= 0.0
    if energies is not None:
        shown = (spectrum.energies >= energies[0]) & (spectrum.energies <= energies[1])
    intensity, heights = spectrum.density[:, shown].T, spectrum.energies[shown]
    if not len(heights):
        raise ValueError(f"energies is {energies}, between two of {spectrum!r}; give a wider range")
    # Elastic lines may be stronger by orders of magnitude than all others.
    top = BRIGHTEST * float(np.median(intensity.max(axis=0))) or 1.0
    lowest = top * 10.0**-DECADES
    name = r"$S(q, \omega)$" if spectrum.hbar == 1.0 else r"$S(q, \hbar\omega)$ [1/meV]"
    _draw_colours(axes, _edges(spectrum.distance), _edges(heights), intensity, lowest, top, name)
    if energies is None:
        visible = heights[np.any(intensity > lowest, axis=1)]
        axes.set_ylim(0.0, min(heights[-1], MARGIN * visible.max(initial=heights[1])))
    if modes is not None:
        axes.plot(modes.distance, modes.energies, color="white", linewidth=0.8, linestyle=(0, (4, 3)))
    _name_corners(axes, spectrum, "white")
    axes.set(ylabel=_energy_label(spectrum), title="dynamic structure factor")
    plain_axes(axes)
    axes.grid(False)
    return figure


@with_figure_settings
def draw_linear_modes(modes: Any) -> Figure:
    """Return a figure of `LinearModes`: frequencies over the path, dots whose area is the intensity, and growth."""
    if len(modes.shape) > 1:
        raise ValueError(f"modes are {modes!r}, of a plane; give a path, or draw modes.spectrum(...)")
    figure = new_figure("drawing linear modes", 7.2, 4.2)
    axes = figure.add_subplot()
    axes.plot(modes.distance, modes.energies, color=ink(), linewidth=0.6)
    finite = np.where(np.isfinite(modes.intensity), modes.intensity, 0.0)
    top = min(float(finite.max()), BRIGHTEST * float(np.median(finite.max(axis=1)))) or 1.0
    area = LARGEST_DOT * np.minimum(1.0, finite / top)
    distance = np.broadcast_to(modes.distance[:, None], finite.shape)
    axes.scatter(distance, modes.energies, s=area, color=colour(0), alpha=0.6, linewidths=0, label="intensity")
    if not modes.stable:
        growth = modes.hbar * np.where(modes.growth > 0.0, modes.growth, np.nan)
        lines = axes.plot(modes.distance, growth, color=FAIL_COLOUR, linewidth=1.2, linestyle="--")
        lines[-1].set_label("growth")
        legend(axes)
    _name_corners(axes, modes, ink())
    axes.set_ylim(bottom=min(0.0, float(axes.get_ylim()[0])) if modes.frequencies.min() < 0.0 else 0.0)
    axes.set(ylabel=_energy_label(modes), title="linear modes")
    plain_axes(axes)
    return figure


def _energy_label(result: Any) -> str:
    return r"frequency $\omega$" if result.hbar == 1.0 else r"energy $\hbar\omega$ [meV]"


def _draw_plane(axes: Any, spectrum: Any, energies: Any, modes: Any) -> None:
    if modes is not None:
        raise ValueError(f"modes are given for {spectrum!r}, of a plane; they are drawn on paths")
    low, high = (0.0, float(spectrum.energies[-1])) if energies is None else energies
    grid = spectrum.integrated(low, high).reshape(spectrum.shape).T
    first, second = (spectrum.q[spectrum.corners[corner]] - spectrum.q[0] for corner in (2, 1))
    top = float(grid.max()) or 1.0
    u, v = (_edges(np.linspace(0.0, 1.0, count)) for count in spectrum.shape)
    # The angle of the edges, from their lengths and the diagonal.
    side, width, diagonal = spectrum.distance[spectrum.corners[1:]].tolist()
    shear = (diagonal**2 - width**2 - side**2) / (2.0 * width**2)
    _draw_colours(axes, u + shear * v[:, None], v[:, None] + 0.0 * u, grid, top * 10.0**-DECADES, top, r"$S(q)$")
    axes.set_aspect(np.sqrt(max(0.0, (side / width) ** 2 - shear**2)))
    origin = corner_name(spectrum.q[0])
    axes.set(xlabel=f"{origin} + x {corner_name(first)}", ylabel=f"{origin} + y {corner_name(second)}")
    axes.set_title(f"structure factor, energies from {low:.4g} to {high:.4g}")
    axes.grid(False)


def _draw_colours(axes: Any, x: Any, y: Any, values: Any, lowest: float, top: float, name: str) -> None:
    from matplotlib.colors import LogNorm

    shown = np.clip(values, lowest, top)
    mesh = axes.pcolormesh(x, y, shown, norm=LogNorm(lowest, top), cmap="viridis", rasterized=True)
    colour_bar(axes, mesh, name, extend="both")


def _name_corners(axes: Any, spectrum: Any, line: str) -> None:
    """Write the corners of a path below it, or the lengths of shells."""
    if spectrum.q.shape[1] == 1 and np.array_equal(spectrum.q[:, 0], spectrum.distance):
        axes.set_xlabel(r"$\vert q \vert$")
        return
    names = [corner_name(spectrum.q[corner]) for corner in spectrum.corners]
    corners, widths = spectrum.distance[spectrum.corners], np.array([len(name) + 2 for name in names])
    crowded = 0.5 * (widths[1:] + widths[:-1]) * corners[-1] > CHARACTERS_ACROSS * np.diff(corners)
    slanted: dict[str, Any] = {"rotation": 30.0, "ha": "right", "rotation_mode": "anchor"} if np.any(crowded) else {}
    axes.set_xticks(corners, names, **slanted)
    for corner in corners[1:-1]:
        axes.axvline(corner, color=line, linewidth=0.6)
    axes.set_xlabel("wave vector $q$ [reciprocal lattice units]")


def corner_name(q: Any) -> str:
    """Return the components of a wave vector as fractions, such as '(1/2, 0)'."""
    parts = [str(Fraction(float(part)).limit_denominator(LARGEST_DENOMINATOR)) for part in q]
    return parts[0] if len(parts) == 1 else f"({', '.join(parts)})"


def _edges(centres: Any) -> Any:
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    middle = 0.5 * (centres[1:] + centres[:-1])
    return np.concatenate([[2.0 * centres[0] - middle[0]], middle, [2.0 * centres[-1] - middle[-1]]])


@with_figure_settings
def draw_crossings(events: Any, components: Any = None, axes: Any = None) -> Figure:
    """Draw the crossings of events in two coordinates (right, up), by default those that vary most."""
    names = events.coordinates
    across, up = drawn_coordinates(events, components)
    if axes is None:
        axes = new_figure("pictures", 5.2, 4.8).add_subplot()
    plain_axes(axes)
    size = 2.0 if len(events) <= MAX_LARGE_DOTS else max(0.15, 2.0 * (MAX_LARGE_DOTS / len(events)) ** 0.5)
    style = {"linestyle": "none", "marker": "o", "markersize": size, "markeredgewidth": 0.0, "rasterized": True}
    members = np.unique(events.member)
    shades, bar = _colours_of(members)
    for m in members:
        x = events.x[events.member == m]
        axes.plot(x[:, across], x[:, up], color=shades(m), label=f"member {m}", **style)
    axes.set(xlabel=coordinate(names[across]), ylabel=coordinate(names[up]))
    set_title(axes, f"{len(events)} crossings of {', '.join(events.names)}")
    if bar is not None:
        colour_bar(axes, bar, "member")
    elif len(members) > 1:
        legend(axes, beside=True, markerscale=4.0 / size)
    figure: Figure = axes.figure
    return figure


def _colours_of(members: Any) -> tuple[Callable[[int], Any], Any]:
    """Return the colours of members by number, and what a colour bar shows if they are too many for a legend."""
    if len(members) <= len(COLOURS):
        return lambda m: colour(int(np.searchsorted(members, m))), None
    shades = colour_scale(members)
    return lambda m: shades.to_rgba(np.array(float(m))), shades


def drawn_coordinates(events: Any, components: Any = None) -> tuple[int, int]:
    """Return the indices of the coordinates (right, up); arguments and errors are those of `draw_crossings`."""
    names = events.coordinates
    if len(names) < 2:
        raise TypeError("crossings of matrix states cannot be drawn; plot two quantities computed from the states")
    if not len(events):
        raise ValueError("there are no crossings to draw; take a longer run, or another event")
    if components is None:
        widest = np.argsort(-np.std(events.x, axis=0), kind="stable")[:2]
        across, up = sorted(widest.tolist())
        return across, up
    chosen = read_list(components, "components", "give two numbers or names of coordinates")
    if len(chosen) != 2:
        raise ValueError(f"components has {len(chosen)} entries; give two numbers or names of coordinates")
    across, up = (coordinate_index(names, one) for one in chosen)
    return across, up


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


FIGURES: Mapping[str, Callable[..., Figure]] = {
    "certificate": draw_certificate,
    "crossings": draw_crossings,
    "linear modes": draw_linear_modes,
    "phase drift": draw_phase_drift,
    "structure factor": draw_structure_factor,
}


def draw_result(kind: str, result: Any, *options: Any) -> Figure:
    """Return the figure of a result of one of these kinds."""
    return FIGURES[kind](result, *options)
