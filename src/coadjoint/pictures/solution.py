"""Figures of runs: pictures declared by the system, components, and drifts, arranged in panels; frames of movies."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from coadjoint.keyword_hints import unknown_picture
from coadjoint.optional_packages import require_packages
from coadjoint.pictures.kinds.control import CONTROL_PICTURES, controllers
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Kind, Paint, kinds, read_picture
from coadjoint.pictures.style import figure_settings, new_figure, setting
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.runs.results.solution_output import extent_text
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import Picture
from coadjoint.validation import read_integer, read_list, read_number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MIN_WIDTH, MAX_WIDTH = 2.0, 100.0
"""Widths of figures in inches."""

MIN_HEIGHT, MAX_HEIGHT = 5.6, 8.0
"""Smallest height of a figure with several columns, and its largest where the width is not given (inches)."""
LEAST_WIDTH = 7.2
"""Smallest width of a figure whose width is not given (inches)."""
TIME_WIDTH, PICTURE_WIDTH = 6.0, 5.4
"""Widths of a column of panels over time, and of the others (inches)."""
MIN_COLUMN_WIDTH = 3.2
"""Smallest width of one of several columns (inches)."""
MAX_COLUMNS = 3  # panels beside each other
TIME_HEIGHT, LOW_HEIGHT, FULL_HEIGHT = 0.46, 0.5, 0.96
"""Heights of panels relative to their widths."""
TIME_INCHES, MOST_TIME_INCHES = 1.9, 2.8
"""Smallest height of panels over time, for legends of eight lines, and the largest of those without other pictures."""
HEADLINE_HEIGHT = 0.3  # inches of a line of text
MAX_FRAMES = 5000  # of a movie; some minutes at the usual speed
PIXELS = (64, 4096)
"""Smallest and largest number of pixels along a side of a movie."""
MOVIE_WIDTH, MOVIE_HEIGHT = 8.0, 4.5
"""Smallest size of the figure of a movie in inches; text scales with the pixels."""


def draw_solution(
    solution: Solution,
    panels: Any = None,
    components: Any = None,
    axes: Any = None,
    members: Any = None,
    width: Any = None,
    style: Any = None,
) -> Figure:
    """Return a figure of a run: drift, components, and the pictures that its system declares; see `Solution.plot`."""
    check_solution(solution)
    require_packages("drawing a solution", "matplotlib")
    if width is not None:
        width = read_number(width, "width")
        if not MIN_WIDTH <= width <= MAX_WIDTH:
            raise ValueError(f"width is {width:g}; give inches, from {MIN_WIDTH:g} to {MAX_WIDTH:g}")
        if axes is not None:
            raise ValueError("width is that of a new figure, and axes are given; give one of them")
    drawn = PlottedRun(solution, members)
    series = _components_picture(drawn, components)
    with figure_settings(style, width):
        if axes is not None:
            listed = _read_axes(axes)
            pictures = _declared(drawn, series) if panels is None else _requested(drawn, panels, series, len(listed))
            return _draw_into(listed, pictures)
        pictures = _declared(drawn, series) if panels is None else _requested(drawn, panels, series)
        if panels is None:
            pictures.sort(key=lambda panel: not panel.kind.over_time)
        return arrange(pictures, _headline(solution, drawn), width)


def _components_picture(drawn: PlottedRun, chosen: Any) -> Picture:
    """Return the picture of the components requested, else of those that the system declares."""
    if chosen is not None:
        rule = "give numbers or names of coordinates"
        listed = read_list(chosen, "components", rule)
        if not listed:
            raise ValueError(f"components is empty; {rule}")
        return Picture("components", chosen=listed)
    return Picture("components") if drawn.gallery_entry is None else drawn.gallery_entry.components


def _declared(drawn: PlottedRun, series: Picture) -> list[Panel]:
    """Prepare drift, components and observed quantities, and the declared pictures that this run can show."""
    declared = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    is_declared = drawn.gallery_entry is not None and series is drawn.gallery_entry.components
    # The declared coordinates may not exist for these parameters of the system.
    components = _prepare_possible(drawn, (series,)) if is_declared else []
    if (is_declared or drawn.gallery_entry is None) and controllers(drawn.system):
        components = _prepare_possible(drawn, [Picture(name) for name in CONTROL_PICTURES])
    components = components or [_prepare(drawn, Picture("components") if is_declared else series)]
    drift, observed = (_prepare_possible(drawn, (Picture(name),)) for name in ("drift", "observed"))
    default = (Picture("coadjoint orbit"), Picture("eigenvalues"))
    return drift + components + observed + (_prepare_possible(drawn, declared) or _prepare_possible(drawn, default))


def _prepare_possible(drawn: PlottedRun, pictures: Sequence[Picture]) -> list[Panel]:
    prepared = []
    for picture in pictures:
        with suppress(CannotShow):
            prepared.append(_prepare(drawn, picture))
    return prepared


def _prepare(drawn: PlottedRun, picture: str | Picture) -> Panel:
    kind, read = read_picture(picture)
    height = TIME_HEIGHT if kind.over_time else LOW_HEIGHT if kind.is_low(drawn) else FULL_HEIGHT
    return Panel(kind, kind.prepare(drawn, **read.options), height)


def _requested(drawn: PlottedRun, panels: Any, series: Picture, count: int | None = None) -> list[Panel]:
    """Prepare the requested panels, one for each name if `count` says so, else single times at the declared times."""
    rule = "give kinds of pictures, such as ['drift', 'coadjoint orbit']"
    listed = (panels,) if isinstance(panels, str | Picture) else read_list(panels, "panels", rule)
    if not listed:
        raise ValueError(f"panels is empty; {rule}")
    pictures = [_as_declared(drawn, series, panel) for panel in listed]
    if count == len(pictures):
        pictures = [listed[:1] for listed in pictures]
    return [_prepare(drawn, picture) for listed in pictures for picture in listed]


def _as_declared(drawn: PlottedRun, series: Picture, panel: Any) -> list[Any]:
    """Return the declared pictures of a named kind; other kinds that show a single time are shown at start and end."""
    if not isinstance(panel, str):
        return [panel]
    declared = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    found: list[Any] = [p for p in (series, *declared) if p.kind == panel]
    if found:
        return found
    check_picture_name(drawn, panel)
    kind = kinds()[panel]
    needs_more = any(option.default is option.empty for option in kind.options.values())
    return [Picture(panel, at=at) for at in (0.0, 1.0)] if kind.shows_one_time and not needs_more else [panel]


def check_picture_name(drawn: PlottedRun, name: str) -> None:
    """Raise ValueError for an unknown kind, with the panel that shows what was meant, such as a coordinate."""
    if name in kinds():
        return
    if name in drawn.names:
        raise ValueError(f"unknown kind of picture {short(name)}; this is a coordinate: give components=[{name!r}]")
    if name in (getattr(drawn.solution, "observed", None) or {}):
        raise ValueError(f"unknown kind of picture {short(name)}; observed quantities are in 'observed'")
    if name in (getattr(drawn.solution, "casimirs", None) or {}):
        raise ValueError(f"unknown kind of picture {short(name)}; the energy and the Casimirs are in 'drift'")
    raise unknown_picture(name, kinds())


def _read_axes(axes: Any) -> Any:
    return (axes,) if hasattr(axes, "plot") else read_list(axes, "axes", "give the axes of each panel")


def _draw_into(listed: Any, prepared: list[Panel]) -> Figure:
    if len(listed) != len(prepared):
        names = ", ".join(panel.kind.name for panel in prepared)
        raise ValueError(f"axes has {len(listed)} entries, and there are {len(prepared)} panels to draw: {names}")
    for panel_axes, panel in zip(listed, prepared, strict=True):
        kind = panel.kind
        if not hasattr(panel_axes, "plot"):
            raise TypeError(f"axes holds {short(panel_axes)}; give axes of Matplotlib")
        if (getattr(panel_axes, "name", "") == "3d") != (kind.projection == "3d"):
            needed = 'axes with projection="3d"' if kind.projection else "flat axes"
            raise ValueError(f"the picture {kind.name!r} needs {needed}")
        panel.paint(panel_axes)
    figure: Figure = listed[0].figure
    return figure


def _headline(solution: Solution, drawn: PlottedRun) -> str:
    parts = [solution.system.name, str(solution.method), f"step {solution.step:g}"]
    if len(drawn.x) < drawn.member_count:
        parts.append(f"{len(drawn.x)} of {drawn.member_count} members")
    elif drawn.member_count > 1:
        parts.append(f"{drawn.member_count} members")
    if solution.incomplete:
        parts.append(extent_text(solution))
    return ",  ".join(parts)


@dataclass(frozen=True)
class Panel:
    """A prepared picture of a kind, with its height relative to its width."""

    kind: Kind
    paint: Paint
    height: float


def arrange(panels: Sequence[Panel], headline: str, width: float | None) -> Figure:
    """Return a figure of the panels, `width` inches wide; by default as wide as its columns need."""
    columns = columns_of(
        panels, MAX_COLUMNS if width is None else max(1, min(MAX_COLUMNS, int(width / MIN_COLUMN_WIDTH)))
    )
    heights = [sum(panel.height for panel in column) for column in columns]
    over_time = [all(panel.kind.over_time for panel in column) for column in columns]
    widths = [TIME_WIDTH if timed else PICTURE_WIDTH for timed in over_time]
    if width is None:
        # Columns of stacked pictures are narrower, so that the figure is not too high.
        widths = [
            size if timed else min(size, MAX_HEIGHT / height)
            for size, timed, height in zip(widths, over_time, heights, strict=True)
        ]
        widths = widths if sum(widths) > LEAST_WIDTH else [LEAST_WIDTH * size / sum(widths) for size in widths]
    else:
        widths = [width * size / sum(widths) for size in widths]
    rows = max(sum(panel.kind.over_time for panel in column) for column in columns)
    height = max(size * part for size, part in zip(widths, heights, strict=True))
    if all(over_time):
        height = min(height, MOST_TIME_INCHES * rows)
    height = max(height, TIME_INCHES * rows) + HEADLINE_HEIGHT
    if width is None:
        height = max(MIN_HEIGHT, height)
    figure = new_figure("drawing a solution", sum(widths), height)
    figure.suptitle(headline.replace("$", r"\$"))
    grid = figure.add_gridspec(1, len(columns), width_ratios=widths)
    first: Any = None
    for index, column in enumerate(columns):
        parts = parts_of(column)
        part_heights = [sum(panel.height for panel in part) for part in parts]
        column_grid = grid[index].subgridspec(len(parts), 1, height_ratios=part_heights)
        for k, part in enumerate(parts):
            # Panels over time are aligned; the margins of the others depend on their own labels only.
            part_grid = column_grid[k].subgridspec(len(part), 1)
            for row, panel in enumerate(part):
                is_timed = panel.kind.over_time
                sharex = first if is_timed else None
                axes = figure.add_subplot(part_grid[row], projection=panel.kind.projection, sharex=sharex)
                first = first or (axes if is_timed else None)
                panel.paint(axes)
                if row < len(part) - 1:
                    axes.tick_params(labelbottom=False)
                    axes.set_xlabel("")
    return figure


def columns_of(panels: Sequence[Panel], count: int) -> list[list[Panel]]:
    """Distribute panels over at most `count` columns in their order; consecutive ones over time share a column."""
    parts = parts_of(panels)
    best: list[list[list[Panel]]] = []
    for k in range(1, min(count, len(parts)) + 1):
        splits = (
            [parts[i:j] for i, j in itertools.pairwise((0, *cuts, len(parts)))]
            for cuts in itertools.combinations(range(1, len(parts)), k - 1)
        )
        best = min(splits, key=_cost)
        # Two low pictures share a column.
        if _cost(best) <= (0, 2 * LOW_HEIGHT):
            break
    return [[panel for part in column for panel in part] for column in best]


def parts_of(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Return panels in stacks of consecutive ones over time, and each of the others by itself."""
    grouped = ((timed, list(group)) for timed, group in itertools.groupby(panels, lambda panel: panel.kind.over_time))
    return [part for timed, group in grouped for part in ([group] if timed else [[panel] for panel in group])]


def _cost(columns: list[list[list[Panel]]]) -> tuple[int, float]:
    """Return the number of columns where panels over time share with others, and the greatest height of the others."""
    mixed = sum(len({panel.kind.over_time for part in column for panel in part}) > 1 for column in columns)
    others = ([panel.height for part in column for panel in part if not panel.kind.over_time] for column in columns)
    return mixed, max(sum(heights) for heights in others)


class SavedFrames:
    """Iterator over `count` frames of a run: a picture at saved points, `size` (width, height) in pixels."""

    def __init__(
        self, drawn: PlottedRun, kind: Kind, picture: Picture, indices: Sequence[int], size: tuple[int, int]
    ) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.count, self.size, self._indices = len(indices), size, indices
        width, height = size
        dpi = min(width / MOVIE_WIDTH, height / MOVIE_HEIGHT)
        with figure_settings():
            figure = new_figure("a movie", width / dpi, height / dpi, dpi, compress=True)
            self._canvas = FigureCanvasAgg(figure)
            name = drawn.solution.system.name
            cut = f", {extent_text(drawn.solution)}" if drawn.solution.incomplete else ""
            figure.suptitle(f"{name}{cut}".replace("$", r"\$"), fontsize=setting("axes.titlesize"))
            update = kind.prepare(drawn, **picture.options)(figure.add_subplot(projection=kind.projection))
            assert update is not None, f"the kind {kind.name!r} is registered with moves=True, but returns no update"
            self._update = update
            update(indices[-1])
            figure.draw_without_rendering()
        figure.set_layout_engine("none")  # keeps the layout constant between frames

    def __iter__(self) -> Iterator[memoryview]:
        return self._frames(self._indices)

    def samples(self) -> Iterator[memoryview]:
        """Yield the first, the middle and the last frame, which together have the colours of all."""
        return self._frames([self._indices[i] for i in (0, self.count // 2, -1)])

    def _frames(self, indices: Sequence[int]) -> Iterator[memoryview]:
        for k in indices:
            self._update(k)
            self._canvas.draw()  # type: ignore[no-untyped-call]
            yield self._canvas.buffer_rgba()  # type: ignore[no-untyped-call]


def frames_of(
    solution: Solution, picture: str | Picture | None = None, frames: int = 240, size: tuple[int, int] = (960, 540)
) -> SavedFrames:
    """Return the frames of a movie, drawn lazily: at most `frames` saved times, with scales constant in time."""
    check_solution(solution)
    require_packages("a movie", "matplotlib")
    count, pixels = read_integer(frames, "frames", 2, MAX_FRAMES), _read_size(size)
    drawn = PlottedRun(solution)
    kind, initial = _read_moving(drawn, picture)
    indices = spread(len(drawn.t), count).tolist()
    if len(indices) < 2:
        raise ValueError("the run has only one saved state, and a movie needs two; integrate with a smaller save_every")
    return SavedFrames(drawn, kind, initial, indices, pixels)


def _read_size(size: Any) -> tuple[int, int]:
    sides = [read_integer(side, "a side of size", *PIXELS) for side in read_list(size, "size", "give width and height")]
    if len(sides) != 2 or any(side % 2 for side in sides):
        raise ValueError(f"size is {size}; give width and height in pixels, even numbers")
    return sides[0], sides[1]


def default_picture(drawn: PlottedRun) -> Picture:
    """Return the first moving picture that the run can show: of one time, the body in space, others, components."""
    declared = () if drawn.gallery_entry is None else drawn.gallery_entry.pictures
    known = kinds()
    moving = [picture for picture in declared if known[picture.kind].moves]
    axis = next((picture for picture in moving if picture.kind == "body axis"), Picture("body axis"))
    candidates = [
        *(picture for picture in moving if known[picture.kind].shows_one_time),
        Picture("body", **axis.options),
        *moving,
        Picture("coadjoint orbit"),
        Picture("eigenvalues"),
    ]
    for picture in candidates:
        with suppress(CannotShow):
            known[picture.kind].prepare(drawn, **picture.options)
            return picture
    return Picture("components") if drawn.gallery_entry is None else drawn.gallery_entry.components


def _read_moving(drawn: PlottedRun, picture: Any) -> tuple[Kind, Picture]:
    """Parse the picture of a movie; return its kind and the picture at the start."""
    if picture is None:
        picture = default_picture(drawn)
    elif isinstance(picture, str) and drawn.gallery_entry is not None:
        entry = drawn.gallery_entry
        picture = next((p for p in (entry.components, *entry.pictures) if p.kind == picture), picture)
    kind, read = read_picture(picture)
    if not kind.moves:
        moving = ", ".join(name for name, known in kinds().items() if known.moves)
        raise CannotShow(f"the picture {kind.name!r} does not change in time; a movie shows one of: {moving}")
    return kind, Picture(kind.name, **{**read.options, **({"at": 0.0} if kind.shows_one_time else {})})
