"""Arrangement of pictures in a figure, in their order: panels over time are stacked, with the others beside them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from coadjoint.pictures.register import Kind, Paint

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MIN_HEIGHT, MAX_HEIGHT = 5.6, 8.0
"""Smallest height of a figure with several columns, and its largest where the width is not given (inches)."""
LEAST_WIDTH = 7.2
"""Smallest width of a figure whose width is not given (inches)."""
TIME_WIDTH, PICTURE_WIDTH = 6.0, 5.4
"""Widths of a column of panels over time, and of the others (inches)."""
MIN_WIDTH = 3.2
"""Smallest width of one of several columns (inches)."""
MAX_COLUMNS = 3  # panels beside each other
TIME_HEIGHT, LOW_HEIGHT, FULL_HEIGHT = 0.46, 0.5, 0.96
"""Heights of panels relative to their widths."""
TIME_INCHES, MOST_TIME_INCHES = 1.9, 2.8
"""Smallest height of panels over time, for legends of eight lines, and the largest of those without other pictures."""
HEADLINE_HEIGHT = 0.3  # inches of a line of text


@dataclass(frozen=True)
class Panel:
    """A prepared picture of a kind, with its height relative to its width."""

    kind: Kind
    paint: Paint
    height: float

    @classmethod
    def of(cls, kind: Kind, paint: Paint, drawn: Any) -> Panel:
        """Return the panel of a prepared picture of a `PlottedRun`."""
        return cls(kind, paint, TIME_HEIGHT if kind.over_time else LOW_HEIGHT if kind.is_low(drawn) else FULL_HEIGHT)


def arrange(panels: Sequence[Panel], headline: str, width: float | None) -> Figure:
    """Return a figure of the panels, `width` inches wide; by default as wide as its columns need."""
    from coadjoint.pictures.figure import ShownFigure
    from coadjoint.pictures.layout import PanelLayout

    columns = columns_of(panels, MAX_COLUMNS if width is None else max(1, min(MAX_COLUMNS, int(width / MIN_WIDTH))))
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
    figure = ShownFigure(figsize=(sum(widths), height), layout=PanelLayout())
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
