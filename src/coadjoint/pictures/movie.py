"""Frames of movies of runs: one picture at many saved times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from coadjoint.optional_packages import require_packages
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Kind, kinds, read_picture
from coadjoint.pictures.style import figure_settings, new_figure, setting
from coadjoint.runs.results.solution import Solution, check_solution
from coadjoint.runs.results.solution_output import extent_text
from coadjoint.systems.gallery_entry import Picture
from coadjoint.validation import read_integer, read_list

MAX_FRAMES = 5000  # some minutes at the usual speed
PIXELS = (64, 4096)
"""Smallest and largest number of pixels along a side."""
MIN_WIDTH, MIN_HEIGHT = 8.0, 4.5
"""Smallest size of the figure in inches; text scales with the pixels."""


class SavedFrames:
    """Iterator over `count` frames of a run: a picture at saved points, `size` (width, height) in pixels."""

    def __init__(
        self, drawn: PlottedRun, kind: Kind, picture: Picture, indices: Sequence[int], size: tuple[int, int]
    ) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.count, self.size, self._indices = len(indices), size, indices
        width, height = size
        dpi = min(width / MIN_WIDTH, height / MIN_HEIGHT)
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
