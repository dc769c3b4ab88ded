"""Movie files: GIF by Pillow, MP4 by ffmpeg, written frame by frame."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np

from coadjoint.files.output.atomic_output import PendingOutput
from coadjoint.files.output.output_files import MOVIES, OutputError, check_target
from coadjoint.memory import check_available_memory
from coadjoint.validation import read_positive

GIF_WHITE_THRESHOLD = 248
"""In a GIF, shades from here on become white."""
MAX_GIF_FPS = 50
"""Frames per second; viewers slow down faster GIFs."""


class Frames(Protocol):
    """Pictures of one size, drawn lazily."""

    count: int
    size: tuple[int, int]

    def __iter__(self) -> Iterator[memoryview]:
        """Yield each frame as RGBA bytes, (height, width, 4)."""

    def samples(self) -> Iterator[memoryview]:
        """Yield a few frames that have the colours of all."""


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


def write_movie(frames: Frames, target: Path, fps: float) -> None:
    """Write a movie atomically, to a target of `check_movie` and at a rate of `check_speed`."""
    with PendingOutput(target) as unfinished:
        (_write_gif if target.suffix == ".gif" else _write_mp4)(frames, unfinished.path, fps)
        unfinished.finish()


def _ffmpeg() -> str | None:
    from matplotlib import rcParams

    return shutil.which(str(rcParams["animation.ffmpeg_path"]))


def _write_gif(frames: Frames, path: Path, fps: float) -> None:
    """Write a GIF with one palette, of the colours of a few frames, each counted once."""
    from PIL import Image

    width, height = frames.size
    check_available_memory(
        2 * frames.count * width * height, "a GIF of so many frames", "take fewer, or a smaller size"
    )

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


def _write_mp4(frames: Frames, path: Path, fps: float) -> None:
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
