"""Movies show the saved states, one after the other, and are refused where there is nothing to show."""

import itertools
import os
import stat
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from drawn_runs import BODY, Picture
from PIL import Image

import coadjoint as co
from command import command
from refusals import refused

SMALL = {"size": (96, 64)}


# Keeps what it is given: its arguments, and how many bytes came.
KEEPER = """#!{python}
import sys
came = sys.stdin.buffer.read()
open(sys.argv[-1], "w").write(" ".join(sys.argv[1:]) + "|" + str(len(came)))
"""


# Programs that fail, at once or after every frame, and what is said of them.
FAILING = {
    'print("no such encoder", file=sys.stderr); sys.exit(3)': "no such encoder",
    "sys.stdin.buffer.read(); sys.exit(3)": "it ended with status 3",
    'print("first\\nthe reason is last", file=sys.stderr); sys.stdin.buffer.read(); sys.exit(1)': "the reason is last",
}


@pytest.fixture(scope="module")
def fluid():
    s = co.systems.torus_euler(N=9)
    return co.integrate(s, s.random(2, degrees=(1, 3)), (0.0, 1.0), 0.05, co.IsospectralGauss())


@pytest.fixture
def ffmpeg(tmp_path, monkeypatch):
    def put(script):
        file = tmp_path / "programs" / "ffmpeg"
        file.parent.mkdir()
        file.write_text(script.replace("{python}", sys.executable))
        file.chmod(file.stat().st_mode | stat.S_IXUSR)
        monkeypatch.setenv("PATH", f"{file.parent}{os.pathsep}{os.environ['PATH']}")

    monkeypatch.setitem(matplotlib.rcParams, "animation.ffmpeg_path", "ffmpeg")
    return put


def test_a_gif_has_the_saved_states_in_order(fluid, tmp_path):
    path = fluid.movie(tmp_path / "run.gif", frames=6, fps=10, **SMALL)
    assert path == tmp_path / "run.gif" and [file.name for file in tmp_path.iterdir()] == ["run.gif"]
    with Image.open(path) as movie:
        assert movie.n_frames == 6 and movie.size == (96, 64)
        frames = []
        for k in range(6):
            movie.seek(k)
            assert movie.info["duration"] == 100
            frames.append(np.asarray(movie.convert("RGB"), dtype=float))
    # neighbours are alike, and the bar of colours at the right stays
    far, near = np.abs(frames[5] - frames[0]).mean(), np.abs(frames[1] - frames[0]).mean()
    assert far > near > 0.0
    assert np.abs(frames[5] - frames[0])[:, -8:].max() == 0.0
    assert (frames[0][0, 0] == 255).all(), "the paper is white"


def test_ffmpeg_is_given_every_frame(fluid, tmp_path, ffmpeg):
    ffmpeg(KEEPER)
    fluid.movie(tmp_path / "run.mp4", frames=5, fps=12.5, **SMALL)
    said, _, came = (tmp_path / "run.mp4").read_text().partition("|")
    assert int(came) == 5 * 96 * 64 * 4
    for part in ("-pix_fmt rgba", "-s 96x64", "-framerate 12.5", "-pix_fmt yuv420p"):
        assert part in said


@pytest.mark.long
def test_names_are_no_options_and_no_protocols_of_ffmpeg(fluid, tmp_path, ffmpeg, monkeypatch):
    """ffmpeg reads "-y/run.mp4" as an option, and "http:run.mp4" as an address; a name does not decide the format."""
    ffmpeg(KEEPER)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "-y").mkdir()
    for target in (Path("-y", "run.mp4"), Path("http:run.mp4"), Path("...mp4")):
        fluid.movie(target, frames=2, **SMALL)
        options, _, path = target.read_text().partition("|")[0].rpartition(" ")
        assert options.endswith("-f mp4") and Path(path).is_absolute() and Path(path).name == target.name
    for name in ("...gif", ".a.gif", "-y.gif"):
        fluid.movie(tmp_path / name, frames=2, **SMALL)
        with Image.open(tmp_path / name) as movie:
            assert movie.format == "GIF" and movie.n_frames == 2


@pytest.mark.parametrize("script", [None, *FAILING])
def test_no_ffmpeg_and_one_that_fails_leave_the_old_movie(fluid, tmp_path, monkeypatch, ffmpeg, script):
    (tmp_path / "old.mp4").write_text("kept")
    if script:
        ffmpeg(f"#!{{python}}\nimport sys; {script}")
    else:
        monkeypatch.setenv("PATH", str(tmp_path))
    with refused((ValueError, OSError), *(["old.mp4", FAILING[script]] if script else ["ffmpeg", ".gif"])):
        fluid.movie(tmp_path / "old.mp4", frames=3, **SMALL)
    assert (tmp_path / "old.mp4").read_text() == "kept"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["old.mp4", *(["programs"] if script else [])]


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_frame_that_cannot_be_drawn_leaves_the_old_movie(tmp_path, ffmpeg, suffix):
    ffmpeg(COPYING)
    run, path = moving("field"), tmp_path / f"run{suffix}"
    path.write_text("kept")

    def values(body, x):
        if (x == run.x[len(run.t) // 2]).all():
            raise ArithmeticError("not drawn")
        return x[0] * np.eye(5)

    with pytest.raises(ArithmeticError, match="not drawn"):
        run.movie(path, picture=Picture("field", values=values, width=lambda body: 1.0), frames=3, **SMALL)
    assert path.read_text() == "kept" and sorted(file.name for file in tmp_path.iterdir()) == ["programs", path.name]


FLUID = """
[system]
name = "torus_euler"
parameters = {N = 9}
[initial]
kind = "random"
seed = 1
degrees = [1, 3]
[method]
name = "IsospectralGauss"
[run]
t_span = [0.0, 1.0]
step = 0.1
save_every = 5
"""


COPYING = """#!/bin/sh
for last; do :; done
cat > "$last"
"""


def frames_of(run, path, **options):
    """Return the frames that a program called ffmpeg is given, as arrays."""
    raw = np.fromfile(run.movie(path, **options), dtype=np.uint8)
    width, height = options["size"]
    return raw.reshape(-1, height, width, 4).astype(int)


MOVING = {
    "vorticity": {},
    "field": {"values": lambda body, x: x[0] * np.add.outer(np.arange(5.0), np.arange(6.0)), "width": lambda body: 1.0},
    "sphere field": {"values": lambda body, x: x[0] * np.broadcast_to(np.linspace(-1, 1, 7)[:, None], (7, 8))},
    "spins": {},
    "bodies": {},
    "body": {},
    "components": {},
    "phase portrait": {},
    "coadjoint orbit": {},
    "path in space": {},
    "body axis": {},
}


def moving(name):
    if name == "vorticity":
        s = co.systems.torus_euler(N=9)
        return co.integrate(s, s.random(2, degrees=(1, 3)), (3.0, -1.0), 0.1, co.IsospectralGauss())
    if name == "spins":
        return co.integrate(co.systems.spin_lattice("chain", 4), np.cos(np.arange(12.0)), (3.0, -1.0), 0.05)
    if name == "bodies":
        pair = co.systems.bodies()
        x0 = pair.state([[0, 0, 0], [3, 1, 0]], [[1, 0, 0], [0, 0, -1]], angular_velocities=[[1, 1, 1], [1, 0, 0]])
        return co.integrate(pair, x0, (3.0, -1.0), 0.05)
    if name == "path in space":
        return co.integrate(co.systems.kirchhoff_body(), 0.5 + 0.1 * np.arange(6.0), (3.0, -1.0), 0.05, attitude=True)
    return co.integrate(BODY, (0.3, 1.0, 0.2), (3.0, -1.0), 0.05, attitude=True)


def test_every_kind_that_moves_is_tried():
    moves = {name for name, kind in co.plotting.kinds().items() if kind.moves}
    assert {name for name in moves if "at" in co.plotting.kinds()[name].options} <= set(MOVING) <= moves


@pytest.mark.thinned(6)
@pytest.mark.parametrize("name", MOVING)
def test_frames_are_the_pictures_of_their_times(name, tmp_path, ffmpeg):
    """Whatever the number of frames, and whatever time the picture has; each frame differs from the one before."""
    ffmpeg(COPYING)
    run, picture = moving(name), Picture(name, **MOVING[name])
    frames = frames_of(run, tmp_path / "run.mp4", picture=picture, frames=3, size=(192, 128))
    assert len(frames) == 3
    assert all(np.abs(one - other).max() > 32 for one, other in itertools.pairwise(frames))
    again = frames_of(run, tmp_path / "again.mp4", picture=picture, frames=2, size=(192, 128))
    np.testing.assert_array_equal(again[0], frames[0])
    np.testing.assert_array_equal(again[1], frames[2])
    if "at" in co.plotting.kinds()[name].options:
        late = Picture(name, **MOVING[name], at=1.0)
        begun = frames_of(run, tmp_path / "late.mp4", picture=late, frames=2, size=(192, 128))
        np.testing.assert_array_equal(begun[0], frames[0], "movies begin at the start whatever time a picture has")


@pytest.mark.long
def test_the_command_makes_movies_of_forced_systems_too(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    forces = '[[forces]]\nname = "Viscosity"\nnu = 0.1\n'
    (tmp_path / "fluid.toml").write_text(FLUID + forces + '[output]\nmovie = "named.gif"\n')
    found = command(capsys, "run", "fluid.toml")
    assert found.status == 0 and found.out.endswith("written: named.gif\n")
    assert command(capsys, "run", "fluid.toml", "--movie", "other.gif", "--quiet") == (0, "", "")
    assert {path.name for path in tmp_path.iterdir()} == {"fluid.toml", "named.gif", "other.gif"}
    with Image.open("other.gif") as movie:
        assert movie.n_frames == 3 and movie.size == (960, 540)
    monkeypatch.setenv("PATH", str(tmp_path))
    found = command(capsys, "run", "fluid.toml", "--movie", "x.mp4")
    assert found.status == 2 and "x.mp4: " in found.err and "ffmpeg" in found.err
