"""What does a movie of a run show? One picture, at many of its times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from coadjoint.extras import need
from coadjoint.given import read_list, read_whole
from coadjoint.pictures.drawn import Drawn, spread
from coadjoint.pictures.register import CannotShow, Kind, kinds, read_picture
from coadjoint.pictures.style import INK
from coadjoint.runs.solution import Solution, check_solution
from coadjoint.systems.ready_made import telling_of
from coadjoint.systems.telling import Picture

MOST_FRAMES = 5000
PIXELS = (64, 4096)
"""Fewest and most along a side."""
WIDE, HIGH = 8.0, 4.5
"""Of the figure in inches, at least: letters grow with the pixels."""


class SavedFrames:
    """Frames of a run: a picture at some of its saved times.

    Parameters
    ----------
    drawn : Drawn
        The run.
    kind : Kind
        Of the picture.
    picture : Picture
        At the start.
    places : sequence of int
        Which saved points.
    size : (int, int)
        Width and height in pixels.

    Attributes
    ----------
    count : int
    size : (int, int)
    """

    def __init__(
        self, drawn: Drawn, kind: Kind, picture: Picture, places: Sequence[int], size: tuple[int, int]
    ) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self.count, self.size, self._places = len(places), size, places
        width, height = size
        dots = min(width / WIDE, height / HIGH)
        figure = Figure(figsize=(width / dots, height / dots), dpi=dots, layout="compressed", facecolor="white")
        self._canvas = FigureCanvasAgg(figure)
        figure.suptitle(drawn.solution.system.name.replace("$", r"\$"), fontsize=9, color=INK)
        update = kind.prepare(drawn, **picture.options)(figure.add_subplot(projection=kind.projection))
        assert update is not None, f"the picture {kind.name!r} is said to move"
        self._update = update
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # nothing moves but what the picture shows

    def __iter__(self) -> Iterator[memoryview]:
        for k in self._places:
            self._update(k)
            self._canvas.draw()  # type: ignore[no-untyped-call]
            yield self._canvas.buffer_rgba()  # type: ignore[no-untyped-call]


def frames_of(
    solution: Solution, picture: str | Picture | None = None, frames: int = 240, size: tuple[int, int] = (960, 540)
) -> SavedFrames:
    """Return the frames of a movie of a run, drawn one by one when they are asked for.

    Parameters
    ----------
    solution : Solution
        The run; of an ensemble the first member is shown.
    picture : str or Picture, optional
        What is shown: a kind of picture that shows one time, with its options, such as ``Picture("vorticity",
        part="large")``. By default the first of its kind that the system declares. Its colours do not change with time.
    frames : int
        How many at most, from 2 to 5000: saved times, evenly spread. No time is invented between them.
    size : (int, int)
        Width and height in pixels, even numbers.

    Returns
    -------
    SavedFrames

    Raises
    ------
    TypeError, ValueError
        The system has nothing that a movie shows, or a value is wrong.

    Examples
    --------
    >>> import coadjoint as co
    >>> sol = co.integrate(co.systems.fluid_triad(), (0.02, 1.0, 0.02), (0, 4), 0.5)
    >>> [frame.shape for frame in frames_of(sol, frames=2, size=(128, 96))]
    [(96, 128, 4), (96, 128, 4)]
    """
    check_solution(solution)
    need("a movie", "matplotlib")
    count, sides = read_whole(frames, "frames", 2, MOST_FRAMES), _read_size(size)
    drawn = Drawn(solution)
    kind, read = _moving(drawn, picture)
    places = spread(len(drawn.t), count).tolist()
    if len(places) < 2:
        raise ValueError("the run has only one saved state, and a movie needs two; integrate with a smaller save_every")
    return SavedFrames(drawn, kind, read, places, sides)


def _read_size(size: Any) -> tuple[int, int]:
    sides = [read_whole(side, "a side of size", *PIXELS) for side in read_list(size, "size", "give width and height")]
    if len(sides) != 2 or any(side % 2 for side in sides):
        raise ValueError(f"size is {size}; give width and height in pixels, even numbers")
    return sides[0], sides[1]


def declared_picture(name: str) -> Picture:
    """Return the first picture of one time that a system declares, by its name.

    Raises
    ------
    CannotShow
        It declares none.

    Examples
    --------
    >>> declared_picture("spin_lattice").kind
    'spins'
    """
    telling = telling_of(name)
    moving = _moving_kinds()
    found = next((p for p in (telling.pictures if telling else ()) if p.kind in moving), None)
    if found is None:
        raise CannotShow(f"{name} declares no picture that a movie can show; give one: {', '.join(moving)}")
    return found


def _moving_kinds() -> list[str]:
    return [name for name, kind in kinds().items() if kind.moves]


def _moving(drawn: Drawn, wanted: Any) -> tuple[Kind, Picture]:
    """Return what is shown, at the start."""
    if wanted is None:
        wanted = declared_picture(drawn.family.name)
    elif isinstance(wanted, str) and drawn.telling is not None:
        wanted = next((p for p in drawn.telling.pictures if p.kind == wanted), wanted)
    kind, read = read_picture(wanted)
    if not kind.moves:
        moving = ", ".join(_moving_kinds())
        raise CannotShow(f"the picture {kind.name!r} shows no single time; a movie shows one of: {moving}")
    return kind, Picture(kind.name, **{**read.options, "at": 0.0})
