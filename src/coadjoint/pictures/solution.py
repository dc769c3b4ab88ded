"""Figure of a run: the pictures declared by its system, its components, and the drift of its invariants."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from coadjoint.optional_packages import need
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, Kind, Paint, read_picture
from coadjoint.runs.solution import check_solution
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import Picture
from coadjoint.validation import read_list

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from coadjoint.runs.solution import Solution

FIGURE_HEIGHT = 5.6
COLUMN_WIDTHS = {True: 6.0, False: 5.4}  # a column of panels over time, or one picture


def draw_solution(
    solution: Solution, panels: Any = None, components: Any = None, axes: Any = None, members: Any = None
) -> Figure:
    """Return a figure of a run: drift, components, and the pictures that its system declares.

    Parameters
    ----------
    solution : Solution
        One run or an ensemble. At most 20 members and 8 coordinates are drawn, evenly spread; the figure states the
        numbers.
    panels : sequence of str or Picture, optional
        Kinds of pictures, by name or with options; `coadjoint.pictures.register.kinds` lists them. By default the
        drift, the components, the observed quantities, and the pictures that the system declares; if this run can show
        none of these, for three coordinates the orbit on its coadjoint orbit.
    components : sequence of int or str, optional
        The coordinates that are drawn over time, by number from 0 or by name.
    axes : Axes or sequence of Axes, optional
        Where to draw, one for each panel.
    members : sequence of int, optional
        Which members of an ensemble are drawn, from 0; at most 20.

    Returns
    -------
    matplotlib.figure.Figure
        Neither shown nor saved; use ``figure.savefig("run.png")``.

    Raises
    ------
    TypeError, ValueError
        An unknown kind or option, with the nearest name; a picture that this run cannot show, with the reason; or
        different numbers of axes and panels.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.rigid_body(inertia=(1, 2, 3)), (1.0, 0.2, 0.1), t_span=(0, 10), step=0.1)
    >>> [axes.get_ylabel() for axes in draw_solution(sol).axes[:2]]
    ['absolute deviation from start', 'angular momentum $x_i$']
    """
    check_solution(solution)
    need("drawing a solution", "matplotlib")
    drawn = PlottedRun(solution, members)
    plain = _components(drawn, components)
    prepared = _declared(drawn, plain) if panels is None else _requested(drawn, panels, plain)
    if axes is not None:
        return _drawn_into(axes, prepared)
    return _figure(solution, drawn, prepared)


def _components(drawn: PlottedRun, chosen: Any) -> Picture:
    """Return the picture of components: those requested, else those that the system declares."""
    if chosen is not None:
        rule = "give numbers or names of coordinates"
        listed = read_list(chosen, "components", rule)
        if not listed:
            raise ValueError(f"components is empty; {rule}")
        return Picture("components", chosen=listed)
    return Picture("components") if drawn.gallery_entry is None else drawn.gallery_entry.components


def _declared(drawn: PlottedRun, plain: Picture) -> list[tuple[Kind, Paint]]:
    """Return drift, components and observed quantities, and the declared pictures that this run can show."""
    wanted = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    own = drawn.gallery_entry is not None and plain is drawn.gallery_entry.components
    # The declared coordinates may not exist for these parameters of the system.
    series = (_shown(drawn, (plain,)) if own else []) or [_prepared(drawn, Picture("components") if own else plain)]
    first = _shown(drawn, (Picture("drift"),)) + series + _shown(drawn, (Picture("observed"),))
    unnamed = (Picture("coadjoint orbit"), Picture("eigenvalues"))
    return first + (_shown(drawn, wanted) or _shown(drawn, unnamed))


def _shown(drawn: PlottedRun, pictures: Sequence[Picture]) -> list[tuple[Kind, Paint]]:
    found = []
    for picture in pictures:
        with suppress(CannotShow):
            found.append(_prepared(drawn, picture))
    return found


def _prepared(drawn: PlottedRun, picture: str | Picture) -> tuple[Kind, Paint]:
    kind, read = read_picture(picture)
    return kind, kind.prepare(drawn, **read.options)


def _requested(drawn: PlottedRun, panels: Any, plain: Picture) -> list[tuple[Kind, Paint]]:
    rule = "give kinds of pictures, such as ['drift', 'coadjoint orbit']"
    given = (panels,) if isinstance(panels, str | Picture) else read_list(panels, "panels", rule)
    if not given:
        raise ValueError(f"panels is empty; {rule}")
    return [_prepared(drawn, _as_declared(drawn, plain, panel)) for panel in given]


def _as_declared(drawn: PlottedRun, plain: Picture, panel: Any) -> Any:
    """Replace a kind given by name by the picture that the system declares of it, if any."""
    told = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    return next((p for p in (plain, *told) if isinstance(panel, str) and p.kind == panel), panel)


def _drawn_into(axes: Any, prepared: list[tuple[Kind, Paint]]) -> Figure:
    given = (axes,) if hasattr(axes, "plot") else read_list(axes, "axes", "give the axes of each panel")
    if len(given) != len(prepared):
        names = ", ".join(kind.name for kind, _ in prepared)
        raise ValueError(f"axes has {len(given)} entries, and there are {len(prepared)} panels to draw: {names}")
    for into, (kind, paint) in zip(given, prepared, strict=True):
        if not hasattr(into, "plot"):
            raise TypeError(f"axes holds {short(into)}; give axes of Matplotlib")
        if (getattr(into, "name", "") == "3d") != (kind.projection == "3d"):
            wanted = 'axes with projection="3d"' if kind.projection else "flat axes"
            raise ValueError(f"the picture {kind.name!r} needs {wanted}")
        paint(into)
    found: Figure = given[0].figure
    return found


def _figure(solution: Solution, drawn: PlottedRun, prepared: list[tuple[Kind, Paint]]) -> Figure:
    from coadjoint.pictures.figure import ShownFigure

    rows = [(kind, paint) for kind, paint in prepared if kind.over_time]
    columns = _columns([(kind, paint) for kind, paint in prepared if not kind.over_time])
    widths = [COLUMN_WIDTHS[True]] * bool(rows) + [COLUMN_WIDTHS[False]] * len(columns)
    figure = ShownFigure(figsize=(max(7.2, sum(widths)), max(FIGURE_HEIGHT, 2.4 * len(rows))), layout="constrained")
    grid = figure.add_gridspec(1, len(widths), width_ratios=widths)
    over = grid[0].subgridspec(max(1, len(rows)), 1)
    first: Any = None
    for place, (_, paint) in enumerate(rows):
        axes = figure.add_subplot(over[place], sharex=first)
        first = first or axes
        paint(axes)
        if place < len(rows) - 1:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
    for place, column in enumerate(columns, start=int(bool(rows))):
        below = grid[place].subgridspec(len(column), 1)
        for k, (kind, paint) in enumerate(column):
            paint(figure.add_subplot(below[k], projection=kind.projection))
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
    if len(drawn.x) < drawn.of_members:
        parts.append(f"{len(drawn.x)} of {drawn.of_members} members")
    elif drawn.of_members > 1:
        parts.append(f"{drawn.of_members} members")
    text = ",  ".join(parts).replace("$", r"\$")
    return "\n".join(textwrap.wrap(text, max(letters, 75)))
