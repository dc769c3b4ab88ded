"""Output files: datasets, figures, movies (GIF by Pillow, MP4 by ffmpeg) and texts.

They are validated before a run rather than after it, and written atomically.
"""

from __future__ import annotations

import errno
import io
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.errors import OneLineError
from coadjoint.files.datasets.writers import INDEX_FILE, foreign_file, with_checksum, write_netcdf, write_zarr
from coadjoint.files.output.atomic_output import PendingOutput, remove_leftovers
from coadjoint.optional_packages import require_packages
from coadjoint.regular_files import open_regular
from coadjoint.validation import read_path, read_positive

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


class OutputError(OneLineError):
    """A result cannot be written to its target."""


DATASETS = (".nc", ".zarr")
FIGURES = (".png", ".pdf", ".svg")
MOVIES = (".mp4", ".gif")
TEXTS = (".json",)
PAGES = (".html",)
HEADERS = (".h", ".hpp")
LOGS = (".csv", ".tum", ".aem", ".tsc")
OVFS = (".ovf", ".omf")
VTKS = (".vti",)
GIF_WHITE_THRESHOLD = 248
"""In a GIF, shades from here on become white."""
MAX_GIF_FPS = 50
"""Frames per second; viewers slow down faster GIFs."""
OWN_HEADER, MOST_OF_A_TITLE = b"coadjoint", 400
"""What the first bytes of a header that the library has written contain."""
REQUIRED_PACKAGES = {
    ".nc": ("xarray", "h5netcdf", "h5py"),
    ".zarr": ("xarray", "zarr"),
    **dict.fromkeys((*FIGURES, ".mp4"), ("matplotlib",)),
    ".gif": ("matplotlib", "PIL"),
    ".json": (),
    ".csv": (),
    ".html": (),
    **dict.fromkeys((*HEADERS, *LOGS, *OVFS, *VTKS), ()),
    ".bc": ("spiceypy",),
}
FORMAT_NAMES = {
    ".nc": "NetCDF",
    ".zarr": "Zarr",
    ".json": "JSON",
    ".csv": "CSV",
    ".html": "a page",
    **dict.fromkeys(HEADERS, "a header"),
    **dict.fromkeys(LOGS, "a log of attitudes"),
    **dict.fromkeys((*OVFS, *VTKS), "a vector field"),
    ".bc": "a C-kernel of SPICE",
    **dict.fromkeys(FIGURES, "a figure"),
    **dict.fromkeys(MOVIES, "a movie"),
}


def check_target(path: str | Path, suffixes: Iterable[str] = DATASETS) -> Path:
    """Validate the path of a result: suffix, required packages, folder, and a target that may be replaced."""
    target, allowed = read_path(path, "path"), tuple(suffixes)
    if target.suffix not in allowed:
        choices = " or ".join(part for part in (", ".join(allowed[:-1]), allowed[-1]) if part)
        raise OutputError(f"{path}: the suffix sets the format; it must be {choices}")
    require_packages(f"{path}: {FORMAT_NAMES[target.suffix]}", *REQUIRED_PACKAGES[target.suffix])
    try:
        if not target.parent.is_dir():
            raise OutputError(f"{path}: the folder {target.parent} does not exist; create it first")
        remove_leftovers(target)
        _check_replaceable(target)
        _try_target(target)
    except OutputError:
        raise
    except (OSError, ValueError) as reason:
        advice = "a shorter name" if getattr(reason, "errno", None) == errno.ENAMETOOLONG else "another folder"
        reason_text = getattr(reason, "strerror", None) or reason
        raise OutputError(f"{path}: cannot be written ({reason_text}); give {advice}") from None
    return target


def _check_replaceable(target: Path) -> None:
    """Refuse to replace anything that is not a result."""
    if target.suffix != ".zarr":
        if target.is_dir():
            raise OutputError(f"{target}: is a folder; give the name of a file")
        if target.suffix in HEADERS and target.exists() and OWN_HEADER not in _title_of(target):
            raise OutputError(
                f"{target}: is a header that coadjoint did not write, so it is not replaced; give another name"
            )
    elif os.path.lexists(target):
        if not any((target / name).exists() for name in (".zgroup", "zarr.json")):
            raise OutputError(f"{target}: exists and is not a Zarr store, so it is not replaced; give another name")
        other = foreign_file(target)
        if other:
            raise OutputError(
                f"{target}: holds {other}, which coadjoint did not write, so it is not replaced; give another name"
            )


def _title_of(header: Path) -> bytes:
    with open_regular(header) as file:
        return file.read(MOST_OF_A_TITLE)


def _try_target(target: Path) -> None:
    """Create and remove the output once: the name may be too long, the disk full, or the folder not writable."""
    with PendingOutput(target) as trial:
        if target.suffix == ".zarr":
            trial.path.mkdir()
            (trial.path / INDEX_FILE).touch()
        else:
            trial.path.touch()


@contextmanager
def pending(target: Path) -> Iterator[PendingOutput]:
    """Write to a target atomically in the context; OutputError with its path if that fails, as on a full disk."""
    try:
        with PendingOutput(target) as unfinished:
            yield unfinished
            unfinished.finish()
    except OSError as reason:
        raise OutputError(f"{target}: cannot be written ({reason.strerror or reason}); give another folder") from None


def write_dataset(dataset: xarray.Dataset, path: str | Path) -> None:
    """Write a dataset as NetCDF (``.nc``) or Zarr (``.zarr``) atomically, with a checksum of its content."""
    # A Zarr store is a folder: when one is replaced, there is a moment without either.
    target = check_target(path)
    dataset = with_checksum(dataset)
    write = write_netcdf if target.suffix == ".nc" else write_zarr
    with pending(target) as unfinished:
        _run_in_thread(lambda: write(dataset, unfinished.path, unfinished.writing), unfinished.abandon)


def _run_in_thread(work: Callable[[], None], abandon: Callable[[], None]) -> None:
    """Run uninterruptibly, since HDF5 does not survive interrupts; only the main thread receives them."""
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(work)
        try:
            done.result()
        except BaseException:
            abandon()
            raise


def write_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, PDF or SVG, atomically; errors as for `check_target`."""
    target = check_target(path, FIGURES)
    buffer = io.BytesIO()
    figure.savefig(buffer, format=target.suffix[1:])
    with pending(target) as unfinished:
        unfinished.path.write_bytes(buffer.getbuffer())


def write_text(text: str, path: str | Path, suffixes: Iterable[str] = TEXTS) -> None:
    """Write text (JSON, CSV, a page or a header) to a file with one of the suffixes, atomically; see `check_target`."""
    target = check_target(path, suffixes)
    with pending(target) as unfinished:
        unfinished.path.write_text(text, encoding="utf-8")


def check_movie(path: str | Path) -> Path:
    """Validate the path of a movie, ``.mp4`` or ``.gif``, as `check_target`; OutputError if ffmpeg is missing."""
    target = check_target(path, MOVIES)
    if target.suffix == ".mp4" and _ffmpeg() is None:
        raise OutputError(f"{path}: MP4 needs the program ffmpeg, which was not found; install it, or give a .gif")
    return target


def check_speed(fps: float, target: Path) -> float:
    """Validate the frames per second, at most 50 for a GIF."""
    rate = read_positive(fps, "fps")
    if target.suffix == ".gif" and rate > MAX_GIF_FPS:
        raise ValueError(f"fps is {rate:g}; a GIF shows at most {MAX_GIF_FPS} frames per second")
    return rate


def write_movie(frames: Any, target: Path, fps: float) -> None:
    """Write a movie atomically, to a target of `check_movie` and at a rate of `check_speed`.

    `frames` are drawn lazily: they have a `count`, a `size` (width, height), and `samples()`, a few that have the
    colours of all. Iteration over both yields RGBA bytes, (height, width, 4).
    """
    with pending(target) as unfinished:
        (_write_gif if target.suffix == ".gif" else _write_mp4)(frames, unfinished.path, fps)


def save_movie(path: str | Path, fps: float, draw: Callable[[], Any]) -> Path:
    """Validate the path and the rate of a movie, then draw its frames and write it."""
    target = check_movie(path)
    rate = check_speed(fps, target)
    write_movie(draw(), target, rate)
    return target


def _ffmpeg() -> str | None:
    from matplotlib import rcParams

    return shutil.which(str(rcParams["animation.ffmpeg_path"]))


def _write_gif(frames: Any, path: Path, fps: float) -> None:
    """Write a GIF with one palette, of the colours of a few frames, each counted once."""
    from PIL import Image

    def images() -> Iterator[Image.Image]:
        samples = [np.unique(np.asarray(frame)[..., :3].reshape(-1, 3), axis=0) for frame in frames.samples()]
        shades = np.unique(np.concatenate(samples), axis=0)
        shades = shades[(shades < GIF_WHITE_THRESHOLD).any(axis=1)]
        colours = Image.fromarray(shades[None]).quantize(255).getpalette() or []
        palette = Image.new("P", (1, 1))
        palette.putpalette([*colours[: 3 * 255], *3 * [255]])
        for frame in frames:
            image = Image.fromarray(np.ascontiguousarray(np.asarray(frame)[..., :3]))
            yield image.quantize(palette=palette, dither=Image.Dither.NONE)

    image_iterator = images()
    options = {"append_images": image_iterator, "duration": round(1000 / fps), "loop": 0}
    # Pillow does not take the end of a name such as "...gif" for a suffix.
    next(image_iterator).save(path, format="GIF", save_all=True, **options)


def _write_mp4(frames: Any, path: Path, fps: float) -> None:
    width, height = frames.size
    input_options = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgba",
        "-s",
        f"{width}x{height}",
        "-framerate",
        f"{fps:g}",
        "-i",
        "pipe:",
    ]
    output_options = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]
    # ffmpeg could read a relative path as an option, or what precedes a colon in it as a protocol.
    command = [str(_ffmpeg()), "-loglevel", "error", "-y", *input_options, *output_options, str(path.absolute())]
    with (
        tempfile.TemporaryFile() as error_file,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=error_file) as writer,
    ):
        assert writer.stdin is not None
        try:
            for frame in frames:
                writer.stdin.write(frame)
            writer.stdin.close()
        except BrokenPipeError:
            pass  # ffmpeg has exited; its messages are reported below
        except BaseException:
            writer.kill()
            raise
        status = writer.wait()
        error_file.seek(0)
        error_text = error_file.read().decode(errors="replace").strip()
    if status != 0:
        reason = error_text.splitlines()[-1] if error_text else f"it ended with status {status}"
        raise OutputError(f"{path.name}: ffmpeg could not write it ({reason})")
