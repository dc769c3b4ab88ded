"""Figure of a run: the pictures declared by its system, its components, and the drift of its invariants."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from coadjoint.optional_packages import require_packages
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Kind, Paint, read_picture
from coadjoint.runs.results.solution import check_solution
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import Picture
from coadjoint.validation import read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coadjoint.runs.results.solution import Solution

FIGURE_HEIGHT = 5.6
COLUMN_WIDTHS = {True: 6.0, False: 5.4}  # a column of panels over time, or one picture


def draw_solution(
    solution: Solution, panels: Any = None, components: Any = None, axes: Any = None, members: Any = None
) -> Figure:
    """Return a figure of a run: drift, components, and the pictures that its system declares; see `Solution.plot`.

    If the run can show none of the default pictures, the orbit is drawn on its coadjoint orbit for three coordinates.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
    >>> [axes.get_ylabel() for axes in draw_solution(sol).axes[:2]]
    ['absolute deviation from start', 'angular momentum $x_i$']
    """
    check_solution(solution)
    require_packages("drawing a solution", "matplotlib")
    drawn = PlottedRun(solution, members)
    series = _components_picture(drawn, components)
    prepared = _declared(drawn, series) if panels is None else _requested(drawn, panels, series)
    if axes is not None:
        return _draw_into(axes, prepared)
    return _figure(solution, drawn, prepared)


def _components_picture(drawn: PlottedRun, chosen: Any) -> Picture:
    """Return the picture of the components requested, else of those that the system declares."""
    if chosen is not None:
        rule = "give numbers or names of coordinates"
        listed = read_list(chosen, "components", rule)
        if not listed:
            raise ValueError(f"components is empty; {rule}")
        return Picture("components", chosen=listed)
    return Picture("components") if drawn.gallery_entry is None else drawn.gallery_entry.components


def _declared(drawn: PlottedRun, series: Picture) -> list[tuple[Kind, Paint]]:
    """Prepare drift, components and observed quantities, and the declared pictures that this run can show."""
    declared = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    is_declared = drawn.gallery_entry is not None and series is drawn.gallery_entry.components
    # The declared coordinates may not exist for these parameters of the system.
    components = _prepare_possible(drawn, (series,)) if is_declared else []
    components = components or [_prepare(drawn, Picture("components") if is_declared else series)]
    drift, observed = (_prepare_possible(drawn, (Picture(name),)) for name in ("drift", "observed"))
    default = (Picture("coadjoint orbit"), Picture("eigenvalues"))
    return drift + components + observed + (_prepare_possible(drawn, declared) or _prepare_possible(drawn, default))


def _prepare_possible(drawn: PlottedRun, pictures: Sequence[Picture]) -> list[tuple[Kind, Paint]]:
    prepared = []
    for picture in pictures:
        with suppress(CannotShow):
            prepared.append(_prepare(drawn, picture))
    return prepared


def _prepare(drawn: PlottedRun, picture: str | Picture) -> tuple[Kind, Paint]:
    kind, read = read_picture(picture)
    return kind, kind.prepare(drawn, **read.options)


def _requested(drawn: PlottedRun, panels: Any, series: Picture) -> list[tuple[Kind, Paint]]:
    rule = "give kinds of pictures, such as ['drift', 'coadjoint orbit']"
    listed = (panels,) if isinstance(panels, str | Picture) else read_list(panels, "panels", rule)
    if not listed:
        raise ValueError(f"panels is empty; {rule}")
    return [_prepare(drawn, _as_declared(drawn, series, panel)) for panel in listed]


def _as_declared(drawn: PlottedRun, series: Picture, panel: Any) -> Any:
    """Replace the name of a kind by the picture of this kind that the system declares, if any."""
    declared = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    return next((p for p in (series, *declared) if isinstance(panel, str) and p.kind == panel), panel)


def _draw_into(axes: Any, prepared: list[tuple[Kind, Paint]]) -> Figure:
    listed = (axes,) if hasattr(axes, "plot") else read_list(axes, "axes", "give the axes of each panel")
    if len(listed) != len(prepared):
        names = ", ".join(kind.name for kind, _ in prepared)
        raise ValueError(f"axes has {len(listed)} entries, and there are {len(prepared)} panels to draw: {names}")
    for panel_axes, (kind, paint) in zip(listed, prepared, strict=True):
        if not hasattr(panel_axes, "plot"):
            raise TypeError(f"axes holds {short(panel_axes)}; give axes of Matplotlib")
        if (getattr(panel_axes, "name", "") == "3d") != (kind.projection == "3d"):
            needed = 'axes with projection="3d"' if kind.projection else "flat axes"
            raise ValueError(f"the picture {kind.name!r} needs {needed}")
        paint(panel_axes)
    figure: Figure = listed[0].figure
    return figure


def _figure(solution: Solution, drawn: PlottedRun, prepared: list[tuple[Kind, Paint]]) -> Figure:
    from coadjoint.pictures.figure import ShownFigure

    rows = [(kind, paint) for kind, paint in prepared if kind.over_time]
    columns = _columns([(kind, paint) for kind, paint in prepared if not kind.over_time])
    widths = [COLUMN_WIDTHS[True]] * bool(rows) + [COLUMN_WIDTHS[False]] * len(columns)
    figure = ShownFigure(figsize=(max(7.2, sum(widths)), max(FIGURE_HEIGHT, 2.4 * len(rows))), layout="constrained")
    grid = figure.add_gridspec(1, len(widths), width_ratios=widths)
    row_grid = grid[0].subgridspec(max(1, len(rows)), 1)
    first: Any = None
    for row, (_, paint) in enumerate(rows):
        axes = figure.add_subplot(row_grid[row], sharex=first)
        first = first or axes
        paint(axes)
        if row < len(rows) - 1:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
    for index, column in enumerate(columns, start=int(bool(rows))):
        column_grid = grid[index].subgridspec(len(column), 1)
        for k, (kind, paint) in enumerate(column):
            paint(figure.add_subplot(column_grid[k], projection=kind.projection))
    figure.suptitle(_headline(solution, drawn, int(16 * sum(widths)) - 60), fontsize=10.5)
    return figure


def _columns(pictures: list[tuple[Kind, Paint]]) -> list[list[tuple[Kind, Paint]]]:
    """Arrange one picture per column, or two low ones."""
    columns: list[list[tuple[Kind, Paint]]] = []
    for picture in pictures:
        if picture[0].low and columns and len(columns[-1]) == 1 and columns[-1][0][0].low:
            columns[-1].append(picture)
        else:
            columns.append([picture])
    return columns


def _headline(solution: Solution, drawn: PlottedRun, letters: int) -> str:
    parts = [solution.system.name, str(solution.method), f"step {solution.step:g}"]
    if len(drawn.x) < drawn.member_count:
        parts.append(f"{len(drawn.x)} of {drawn.member_count} members")
    elif drawn.member_count > 1:
        parts.append(f"{drawn.member_count} members")
    text = ",  ".join(parts).replace("$", r"\$")
    return "\n".join(textwrap.wrap(text, max(letters, 75)))
