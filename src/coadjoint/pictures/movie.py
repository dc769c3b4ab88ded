"""Frames of movies of runs: one picture at many saved times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from coadjoint.optional_packages import need
from coadjoint.pictures.plot_data import PlottedRun, spread
from coadjoint.pictures.register import CannotShow, Kind, kinds, read_picture
from coadjoint.pictures.style import INK
from coadjoint.runs.solution import Solution, check_solution
from coadjoint.systems.gallery_entry import Picture
from coadjoint.systems.registry import gallery_entry_of
from coadjoint.validation import read_integer, read_list

MAX_FRAMES = 5000
PIXELS = (64, 4096)
"""Smallest and largest number of pixels along a side."""
MIN_WIDTH, MIN_HEIGHT = 8.0, 4.5
"""Smallest size of the figure in inches; text scales with the pixels."""


class SavedFrames:
    """Iterator over `count` frames of a run: one picture at the saved points `places`, `size` (width, height) in
    pixels.
    """

    def __init__(
        self, drawn: PlottedRun, kind: Kind, picture: Picture, places: Sequence[int], size: tuple[int, int]
    ) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.count, self.size, self._places = len(places), size, places
        width, height = size
        dots = min(width / MIN_WIDTH, height / MIN_HEIGHT)
        figure = Figure(figsize=(width / dots, height / dots), dpi=dots, layout="compressed", facecolor="white")
        self._canvas = FigureCanvasAgg(figure)
        figure.suptitle(drawn.solution.system.name.replace("$", r"\$"), fontsize=9, color=INK)
        update = kind.prepare(drawn, **picture.options)(figure.add_subplot(projection=kind.projection))
        assert update is not None, f"the picture {kind.name!r} is said to move"
        self._update = update
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # keeps the layout constant between frames

    def __iter__(self) -> Iterator[memoryview]:
        for k in self._places:
            self._update(k)
            self._canvas.draw()  # type: ignore[no-untyped-call]
            yield self._canvas.buffer_rgba()  # type: ignore[no-untyped-call]


def frames_of(
    solution: Solution, picture: str | Picture | None = None, frames: int = 240, size: tuple[int, int] = (960, 540)
) -> SavedFrames:
    """Return the frames of a movie of the first member of a run, drawn lazily.

    `picture` is a kind that shows one time, by name or with options, such as ``Picture("vorticity", part="large")``; by
    default the first such kind that the system declares. Colour scales are constant in time. At most `frames` (2 to
    5000) saved times, evenly spread, are shown, without interpolation; `size` (width, height) is in pixels, even.
    Raises TypeError or ValueError for wrong values, or if nothing can be shown.
    """
    check_solution(solution)
    need("a movie", "matplotlib")
    count, sides = read_integer(frames, "frames", 2, MAX_FRAMES), _read_size(size)
    drawn = PlottedRun(solution)
    kind, read = _moving(drawn, picture)
    places = spread(len(drawn.t), count).tolist()
    if len(places) < 2:
        raise ValueError("the run has only one saved state, and a movie needs two; integrate with a smaller save_every")
    return SavedFrames(drawn, kind, read, places, sides)


def _read_size(size: Any) -> tuple[int, int]:
    sides = [read_integer(side, "a side of size", *PIXELS) for side in read_list(size, "size", "give width and height")]
    if len(sides) != 2 or any(side % 2 for side in sides):
        raise ValueError(f"size is {size}; give width and height in pixels, even numbers")
    return sides[0], sides[1]


def declared_picture(name: str) -> Picture:
    """Return the first picture of a single time that a system declares; raise CannotShow if there is none.

    Examples
    --------
    >>> declared_picture("spin_lattice").kind
    'spins'
    """
    gallery_entry = gallery_entry_of(name)
    moving = _moving_kinds()
    found = next((p for p in (gallery_entry.pictures if gallery_entry else ()) if p.kind in moving), None)
    if found is None:
        raise CannotShow(f"{name} declares no picture that a movie can show; give one: {', '.join(moving)}")
    return found


def _moving_kinds() -> list[str]:
    return [name for name, kind in kinds().items() if kind.moves]


def _moving(drawn: PlottedRun, wanted: Any) -> tuple[Kind, Picture]:
    """Return the picture of a movie and its kind, at the start."""
    if wanted is None:
        wanted = declared_picture(drawn.family.name)
    elif isinstance(wanted, str) and drawn.gallery_entry is not None:
        wanted = next((p for p in drawn.gallery_entry.pictures if p.kind == wanted), wanted)
    kind, read = read_picture(wanted)
    if not kind.moves:
        moving = ", ".join(_moving_kinds())
        raise CannotShow(f"the picture {kind.name!r} shows no single time; a movie shows one of: {moving}")
    return kind, Picture(kind.name, **{**read.options, "at": 0.0})
