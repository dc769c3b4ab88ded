"""Files of movies, written from frames of one colour each."""

import os
import stat
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image

import coadjoint as co
from coadjoint.files.output.movie_file import check_speed, write_movie
from coadjoint.pictures.movie import default_picture, frames_of
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.systems.gallery_entry import Picture
from coadjoint.systems.registry import gallery_entry_of

# Keeps what it is given: its arguments, and how many bytes came.
KEEPER = """#!{python}
import sys
came = sys.stdin.buffer.read()
open(sys.argv[-1], "w").write(" ".join(sys.argv[1:-1]) + "|" + str(len(came)))
"""


@pytest.fixture
def ffmpeg(tmp_path, monkeypatch):
    def put(script):
        file = tmp_path / "programs" / "ffmpeg"
        file.parent.mkdir()
        file.write_text(script.format(python=sys.executable))
        file.chmod(file.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("PATH", f"{file.parent}{os.pathsep}{os.environ['PATH']}")

    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", "ffmpeg")
    return put


class Solid:
    """Frames of one colour each, below a bar with all colours, (height, width) = (20, 30)."""

    def __init__(self, shades, broken=None):
        self.shades, self.broken = np.array(shades, dtype=np.uint8), broken
        self.count, self.size = len(shades), (30, 20)

    def samples(self):
        yield next(iter(self))

    def __iter__(self):
        for k, shade in enumerate(self.shades):
            if k == self.broken:
                raise ArithmeticError("a frame cannot be drawn")
            frame = np.full((20, 30, 4), 255, dtype=np.uint8)
            frame[:10, :, :3] = shade
            frame[10:, : len(self.shades), :3] = self.shades
            yield memoryview(frame)


SHADES = [(200, 30, 40), (255, 120, 0), (20, 120, 210), (0, 0, 0), (90, 200, 10), (247, 247, 247), (252, 252, 252)]


def test_a_gif_has_the_colours_of_its_frames_and_repeats(tmp_path):
    path = tmp_path / "run.gif"
    write_movie(Solid(SHADES), path, 12.5)
    with Image.open(path) as movie:
        assert (movie.n_frames, movie.size, movie.info["loop"]) == (7, (30, 20), 0)
        for k, shade in enumerate(SHADES):
            movie.seek(k)
            assert movie.info["duration"] == 80
            seen = np.asarray(movie.convert("RGB"))
            wanted = (255, 255, 255) if min(shade) >= 248 else shade
            np.testing.assert_array_equal(seen[:10], np.broadcast_to(wanted, (10, 30, 3)))
            assert (seen[10:, 7:] == 255).all()


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
@pytest.mark.parametrize("broken", [0, 3])
def test_a_frame_that_cannot_be_drawn_leaves_the_old_movie(tmp_path, ffmpeg, suffix, broken):
    ffmpeg(KEEPER)
    path = tmp_path / f"run{suffix}"
    path.write_text("kept")
    with pytest.raises(ArithmeticError, match="cannot be drawn"):
        write_movie(Solid(SHADES, broken), path, 10.0)
    assert path.read_text() == "kept" and sorted(file.name for file in tmp_path.iterdir()) == ["programs", path.name]


def test_speeds_and_sizes_of_movies(tmp_path):
    assert check_speed(50, Path("run.gif")) == 50.0 and check_speed(120, Path("run.mp4")) == 120.0
    for rate in (0.0, -1.0, np.nan, np.inf, 50.5):
        with pytest.raises(ValueError, match="fps"):
            check_speed(rate, Path("run.gif"))
    huge = Solid(SHADES, broken=0)
    huge.count, huge.size = 10**6, (4096, 4096)
    with pytest.raises(ValueError, match="a GIF of so many frames needs about"):
        write_movie(huge, tmp_path / "run.gif", 10.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["heavy_top", "rigid_body", "kirchhoff_body"])
def test_the_movie_of_a_body_has_the_axis_and_the_vertical_of_its_picture(name):
    entry = gallery_entry_of(name)
    declared = next(picture for picture in entry.pictures if picture.kind == "body axis")
    run = co.integrate(co.systems.get(name), entry.start(), (0.0, 1.0), 0.1, attitude=True)
    found = default_picture(PlottedRun(run))
    assert found.kind == "body" and found.options == declared.options and set(found.options) >= {"axis", "up"}


@pytest.mark.parametrize("name", ["gyrostat", "lorenz_1960", "spin_lattice"])
def test_components_by_name_are_those_that_the_system_declares(name):
    system, entry = co.systems.get(name), gallery_entry_of(name)
    run = co.integrate(system, np.reshape(entry.start(), (-1, system.dim))[0], (0.0, 1.0), 0.1)
    by_name, declared, every = (
        [bytes(frame) for frame in frames_of(run, picture, frames=3, size=(320, 180))]
        for picture in ("components", entry.components, Picture("components"))
    )
    assert by_name == declared and by_name != every
