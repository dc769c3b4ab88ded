"""A run as a movie: one picture at many of its times, written frame by frame."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from coadjoint.files.output import MOVIES, OutputError, check_target
from coadjoint.files.unfinished import Unfinished
from coadjoint.given import read_list, read_positive, read_whole
from coadjoint.memory import check_room
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
NEARLY_WHITE = 248
"""In a GIF such shades are the white of the paper."""
FASTEST_GIF = 50
"""Frames a second: viewers slow down what is faster."""


def write_movie(
    solution: Solution,
    path: str | Path,
    picture: str | Picture | None = None,
    frames: int = 240,
    fps: float = 24.0,
    size: tuple[int, int] = (960, 540),
) -> Path:
    """Write a run as a movie, whole or not at all.

    Parameters
    ----------
    solution : Solution
        The run; of an ensemble the first member is shown.
    path : str or Path
        ``.mp4``, which the program ffmpeg writes, or ``.gif``. A file there is replaced.
    picture : str or Picture, optional
        What is shown: a kind of picture that shows one time, with its options, such as ``Picture("vorticity",
        part="large")``. By default the first of its kind that the system declares. Its colours do not change with time.
    frames : int
        How many at most, from 2 to 5000: saved times, evenly spread. No time is invented between them.
    fps : float
        Frames a second; for a GIF no more than 50.
    size : (int, int)
        Width and height in pixels, even numbers.

    Returns
    -------
    Path

    Raises
    ------
    TypeError, ValueError
        The system has nothing that a movie shows, or a value is wrong.
    OutputError
        The file cannot be written, or ffmpeg is missing.

    Examples
    --------
    >>> import coadjoint as co, tempfile
    >>> sol = co.integrate(co.systems.fluid_triad(), (0.02, 1.0, 0.02), (0, 4), 0.5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_movie(sol, f"{folder}/waves.gif", size=(128, 96)).name
    'waves.gif'
    """
    check_solution(solution)
    target = check_movie(path)
    count, rate = read_whole(frames, "frames", 2, MOST_FRAMES), read_positive(fps, "fps")
    width, height = _read_size(size)
    gif = target.suffix == ".gif"
    if gif and rate > FASTEST_GIF:
        raise ValueError(f"fps is {rate:g}; a GIF shows no more than {FASTEST_GIF} frames a second")
    drawn = Drawn(solution)
    kind, read = _moving(drawn, picture)
    places = spread(len(drawn.t), count).tolist()
    if len(places) < 2:
        raise ValueError("the run has only one saved state, and a movie needs two; integrate with a smaller save_every")
    pictures = _drawn(drawn, kind, read, places, width, height)
    with Unfinished(target) as unfinished:
        if gif:
            check_room(2 * len(places) * width * height, "a GIF of so many frames", "take fewer, or a smaller size")
            _write_gif(pictures, unfinished.place, rate)
        else:
            _write_mp4(pictures, unfinished.place, rate, width, height, target)
        unfinished.finish()
    return target


def check_movie(path: str | Path) -> Path:
    """Return the path of a movie if it can be written, before anything is drawn.

    Raises
    ------
    OutputError
        As `coadjoint.files.output.check_target`; or it ends in .mp4, and there is no program ffmpeg.
    """
    target = check_target(path, MOVIES)
    if target.suffix == ".mp4" and _ffmpeg() is None:
        raise OutputError(f"{path}: MP4 needs the program ffmpeg, which is not there; install it, or give a .gif")
    return target


def _ffmpeg() -> str | None:
    from matplotlib import rcParams

    return shutil.which(str(rcParams["animation.ffmpeg_path"]))


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


def _drawn(
    drawn: Drawn, kind: Kind, read: Picture, places: list[int], width: int, height: int
) -> Callable[[], Iterator[memoryview]]:
    """Return what draws one frame after the other, as bytes of red, green, blue and opacity."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    dots = min(width / WIDE, height / HIGH)
    figure = Figure(figsize=(width / dots, height / dots), dpi=dots, layout="compressed", facecolor="white")
    canvas = FigureCanvasAgg(figure)
    figure.suptitle(drawn.solution.system.name.replace("$", r"\$"), fontsize=9, color=INK)
    update = kind.prepare(drawn, **read.options)(figure.add_subplot(projection=kind.projection))
    assert update is not None, f"the picture {kind.name!r} is said to move"
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # nothing moves but what the picture shows

    def frames() -> Iterator[memoryview]:
        for k in places:
            update(k)
            canvas.draw()  # type: ignore[no-untyped-call]
            yield canvas.buffer_rgba()  # type: ignore[no-untyped-call]

    return frames


def _write_gif(frames: Callable[[], Iterator[memoryview]], place: Path, fps: float) -> None:
    """Write with the colours of the first frame, each counted once: its bar of colours has all that may come."""
    from PIL import Image

    def images() -> Iterator[Image.Image]:
        palette = None
        for frame in frames():
            image = Image.fromarray(np.ascontiguousarray(np.asarray(frame)[..., :3]))
            if palette is None:
                shades = np.unique(np.asarray(image).reshape(-1, 3), axis=0)
                shades = shades[(shades < NEARLY_WHITE).any(axis=1)]
                found = Image.fromarray(shades[None]).quantize(255).getpalette() or []
                palette = Image.new("P", (1, 1))
                palette.putpalette([*found[: 3 * 255], *3 * [255]])
            yield image.quantize(palette=palette, dither=Image.Dither.NONE)

    each = images()
    next(each).save(place, save_all=True, append_images=each, duration=round(1000 / fps), loop=0)


def _write_mp4(
    frames: Callable[[], Iterator[memoryview]], place: Path, fps: float, width: int, height: int, target: Path
) -> None:
    given = ["-f", "rawvideo", "-pix_fmt", "rgba", "-s", f"{width}x{height}", "-framerate", f"{fps:g}", "-i", "pipe:"]
    made = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    command = [str(_ffmpeg()), "-loglevel", "error", "-y", *given, *made, str(place)]
    with (
        tempfile.TemporaryFile() as complaints,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=complaints) as writer,
    ):
        assert writer.stdin is not None
        try:
            for frame in frames():
                writer.stdin.write(frame)
            writer.stdin.close()
        except BrokenPipeError:
            pass  # it has ended, and says why
        except BaseException:
            writer.kill()
            raise
        status = writer.wait()
        complaints.seek(0)
        said = complaints.read().decode(errors="replace").strip()
    if status != 0:
        last = said.splitlines()[-1] if said else f"it ended with status {status}"
        raise OutputError(f"{target}: ffmpeg could not write it ({last})")
