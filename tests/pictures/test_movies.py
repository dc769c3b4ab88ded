"""Movies show the saved states, one after the other, and are refused where there is nothing to show."""

import os
import stat
import sys
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from drawn_runs import made
from matplotlib.figure import Figure
from PIL import Image

import coadjoint as co
from coadjoint import cli
from coadjoint.files.output.movie_file import check_speed, write_movie
from coadjoint.files.output.output_files import OutputError
from coadjoint.pictures.movie import default_picture, frames_of
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import kinds, read_picture
from coadjoint.systems.gallery_entry import Picture
from coadjoint.systems.registry import gallery_entry_of

SMALL = {"size": (96, 64)}

# Keeps what it is given: its arguments, and how many bytes came.
KEEPER = """#!{python}
import sys
came = sys.stdin.buffer.read()
open(sys.argv[-1], "w").write(" ".join(sys.argv[1:-1]) + "|" + str(len(came)))
"""
# Keeps its arguments.
NAMER = """#!{python}
import sys
sys.stdin.buffer.read()
open(sys.argv[-1], "w").write(" ".join(sys.argv[1:]))
"""
FAILING = """#!{python}
import sys
print("no such encoder", file=sys.stderr)
sys.exit(3)
"""


@pytest.fixture(scope="module")
def fluid():
    s = co.systems.torus_euler(N=9)
    return co.integrate(s, s.random(2, degrees=(1, 3)), (0.0, 1.0), 0.05, co.IsospectralGauss())


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


MOVING = {
    "vorticity": lambda: telling_short("torus_euler"),
    "field": lambda: telling_short("fluid_triad"),
    "sphere field": lambda: telling_short("rigid_body"),
    "body": lambda: co.integrate(co.systems.rigid_body((1, 2, 3)), (0.3, 1.0, 0.2), (0.0, 1.0), 0.1, attitude=True),
    "spins": lambda: co.integrate(co.systems.spin_lattice("chain", 4), np.cos(np.arange(12.0)), (0.0, 1.0), 0.1),
}


def telling_short(name):
    """Return a short run of a system."""
    if name == "torus_euler":
        s = co.systems.torus_euler(N=9)
        return co.integrate(s, s.random(2, degrees=(1, 3)), (0.0, 1.0), 0.1, co.IsospectralGauss())
    told = gallery_entry_of(name)
    return co.integrate(co.systems.get(name), told.start(), (0.0, 1.0), 0.1)


def values(system, x):
    return np.add.outer(x[0] * np.arange(5.0), np.cos(np.arange(8.0) + x[1]))


def test_every_kind_that_shows_one_time_is_tried():
    assert {name for name, kind in kinds().items() if kind.moves and kind.shows_one_time} == set(MOVING)


@pytest.mark.parametrize("name", ["heavy_top", "rigid_body", "kirchhoff_body"])
def test_the_movie_of_a_body_has_the_axis_and_the_vertical_of_its_picture(name):
    entry = gallery_entry_of(name)
    declared = next(picture for picture in entry.pictures if picture.kind == "body axis")
    run = co.integrate(co.systems.get(name), entry.start(), (0.0, 1.0), 0.1, attitude=True)
    found = default_picture(PlottedRun(run))
    assert found.kind == "body" and found.options == declared.options and set(found.options) >= {"axis", "up"}


@pytest.mark.thinned(2)
@pytest.mark.parametrize("name", MOVING)
def test_another_time_in_the_same_picture_is_the_picture_of_that_time(name):
    run = MOVING[name]()
    options = {"sphere field": {"values": values}}.get(name, {})
    declared = next((p for p in gallery_entry_of(run.system.name).pictures if p.kind == name), Picture(name))
    options = {**declared.options, **options}
    drawn, (kind, _) = PlottedRun(run), read_picture(Picture(name, **options))
    moved, direct = (Figure().add_subplot() for _ in range(2))
    update = kind.prepare(drawn, **{**options, "at": 0.0})(moved)
    before = canvas_of(moved)
    update(7)
    kind.prepare(drawn, **{**options, "at": 0.7})(direct)
    assert moved.get_title() == direct.get_title()
    # the scale of colours may differ, as it holds start, end and the time that is shown
    for one, other in zip((*moved.images, *moved.collections), (*direct.images, *direct.collections), strict=True):
        one.set_clim(-1.0, 1.0)
        other.set_clim(-1.0, 1.0)
    assert not np.array_equal(before, canvas_of(moved))
    difference = np.abs(canvas_of(moved).astype(int) - canvas_of(direct))[:, :480]
    assert np.mean(difference > 8) < 0.01


def canvas_of(axes):
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas = FigureCanvasAgg(axes.figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba()).copy()


def test_ffmpeg_is_given_every_frame(fluid, tmp_path, ffmpeg):
    ffmpeg(KEEPER)
    fluid.movie(tmp_path / "run.mp4", frames=5, fps=12.5, **SMALL)
    said, _, came = (tmp_path / "run.mp4").read_text().partition("|")
    assert int(came) == 5 * 96 * 64 * 4
    for part in ("-pix_fmt rgba", "-s 96x64", "-framerate 12.5", "-pix_fmt yuv420p"):
        assert part in said


@pytest.mark.parametrize("name", ["...gif", ".a.gif", "-y.gif"])
def test_a_name_does_not_decide_the_format(tmp_path, name):
    write_movie(Solid(SHADES), tmp_path / name, 10.0)
    with Image.open(tmp_path / name) as movie:
        assert movie.format == "GIF" and movie.n_frames == len(SHADES)


def test_names_are_no_options_and_no_protocols_of_ffmpeg(tmp_path, ffmpeg, monkeypatch):
    """ffmpeg reads "-y/run.mp4" as an option, and "http:run.mp4" as an address."""
    ffmpeg(NAMER)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "-y").mkdir()
    for target in (Path("-y", "run.mp4"), Path("http:run.mp4"), Path("...mp4")):
        write_movie(Solid(SHADES), target, 10.0)
        options, _, path = target.read_text().rpartition(" ")
        assert options.endswith("-f mp4") and Path(path).is_absolute() and Path(path).name == target.name


def test_no_ffmpeg_and_one_that_fails(fluid, tmp_path, monkeypatch, ffmpeg):
    (tmp_path / "old.mp4").write_text("kept")
    monkeypatch.setattr("coadjoint.files.output.movie_file.shutil.which", lambda name: None)
    with pytest.raises(OutputError, match=r"MP4 needs the program ffmpeg.*\.gif"):
        fluid.movie(tmp_path / "old.mp4")
    monkeypatch.undo()
    ffmpeg(FAILING)
    monkeypatch.setenv("PATH", f"{tmp_path / 'programs'}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(OutputError, match="no such encoder"):
        fluid.movie(tmp_path / "old.mp4", frames=3, **SMALL)
    assert (tmp_path / "old.mp4").read_text() == "kept"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["old.mp4", "programs"]


def test_what_is_wrong_is_refused_and_nothing_is_left(fluid, tmp_path):
    body = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.1, 1.0, 0.2), (0.0, 1.0), 0.1)
    single = co.integrate(fluid.system, fluid.x[0], (0.0, 0.0), 0.05, co.IsospectralGauss())
    for run, options, said in [
        (body, {"picture": "vorticity"}, "rigid_body has no vorticity"),
        (fluid, {"picture": "drift"}, "'drift' does not change in time; a movie shows one of: body, body axis"),
        (fluid, {"picture": "vorticty"}, "did you mean 'vorticity'"),
        (fluid, {"frames": 1}, "frames"),
        (fluid, {"frames": 10**6}, "5000"),
        (fluid, {"fps": 0}, "fps"),
        (fluid, {"fps": 100}, "at most 50"),
        (fluid, {"size": (101, 64)}, "even"),
        (fluid, {"size": (100, 10**6)}, "4096"),
        (single, {}, "only one saved state"),
    ]:
        with pytest.raises(ValueError, match=said):
            run.movie(tmp_path / "run.gif", **options)
    with pytest.raises(OutputError, match=r"\.mp4 or \.gif"):
        fluid.movie(tmp_path / "run.avi")
    with pytest.raises(TypeError, match="Solution"):
        frames_of(3)
    assert list(tmp_path.iterdir()) == []


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


def test_the_command_makes_movies(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fluid.toml").write_text(FLUID + '[output]\nmovie = "named.gif"\n')
    made = []
    monkeypatch.setattr(co.Solution, "movie", lambda run, path: made.append((run, path)))
    assert cli.main(["run", "fluid.toml"]) == 0
    assert capsys.readouterr().out.endswith("written: named.gif\n")
    assert cli.main(["run", "fluid.toml", "--movie", "other.gif", "--quiet"]) == 0
    assert [path.name for _, path in made] == ["named.gif", "other.gif"]
    assert [run.t.tolist() for run, _ in made] == [[0.0, 0.5, 1.0]] * 2


def test_the_command_refuses_before_the_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("coadjoint.runs.run.Run.advance", None)
    monkeypatch.setattr("coadjoint.files.output.movie_file.shutil.which", lambda name: None)
    (tmp_path / "fluid.toml").write_text(FLUID)
    body = '[system]\nname = "rigid_body"\n[initial]\nx = [1.0, 0.1, 0.5]\n[run]\nt_span = [0, 1]\nstep = 0.1\n'
    (tmp_path / "body.toml").write_text(body)
    for file, movie, said in [
        ("fluid.toml", "x.mp4", "x.mp4: MP4 needs the program ffmpeg"),
        ("fluid.toml", "x.avi", "must be .mp4 or .gif"),
        ("body.toml", "x.mp4", "x.mp4: MP4 needs the program ffmpeg"),
    ]:
        assert cli.main(["run", file, "--movie", movie]) == 2
        assert said in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["body.toml", "fluid.toml"]


@pytest.mark.long
def test_an_ensemble_shows_its_first_member(tmp_path):
    s = co.systems.sphere_euler(N=6)
    ensemble = np.stack([s.random(seed, degrees=(2, 3)) for seed in (1, 2)])
    run = co.integrate(s, ensemble, (0.0, 0.5), 0.1, co.IsospectralGauss())
    single = co.integrate(s, ensemble[0], (0.0, 0.5), 0.1, co.IsospectralGauss())
    for name, each in (("ensemble", run), ("one", single)):
        each.movie(tmp_path / f"{name}.gif", frames=2, **SMALL)
    frames = [next(iter(frames_of(each, frames=2, size=(96, 64)))) for each in (run, single)]
    # All but the title, which names the member.
    np.testing.assert_array_equal(*(np.asarray(frame)[20:, :80] for frame in frames))


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


SILENT = """#!{python}
import sys
sys.stdin.buffer.read()
sys.exit(3)
"""
WORDY = """#!{python}
import sys
print("first of all\\nthe reason is the last line", file=sys.stderr)
sys.stdin.buffer.read()
sys.exit(1)
"""


@pytest.mark.parametrize(
    ("script", "said"),
    [
        (SILENT, r"run\.mp4: .*\(it ended with status 3\)"),
        (WORDY, r"could not write it \(the reason is the last line\)"),
    ],
)
def test_a_program_that_reads_every_frame_and_fails_is_reported(tmp_path, ffmpeg, script, said):
    ffmpeg(script)
    with pytest.raises(OutputError, match=said):
        write_movie(Solid(SHADES), tmp_path / "run.mp4", 10.0)
    assert [file.name for file in tmp_path.iterdir()] == ["programs"]


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


def test_movies_begin_at_the_start_whatever_time_a_picture_has():
    """Lengths are relative to those of the first frame, also if the picture is given for another time."""
    lattice = co.systems.spin_lattice("square", (2, 2), tensor=(1.0, 1.0, 0.5))
    damped = lattice.with_forces(co.forces.LinearDamping(0.5))
    run = co.integrate(damped, np.random.default_rng(3).normal(size=12), (0.0, 2.0), 0.1)
    pictures = [Picture("spins", at=at) for at in (0.0, 0.5, 1.0)]
    first = [bytes(next(iter(frames_of(run, picture, frames=2, size=(320, 180))))) for picture in pictures]
    assert first[0] == first[1] == first[2]


@pytest.mark.parametrize("name", ["gyrostat", "lorenz_1960", "spin_lattice"])
def test_components_by_name_are_those_that_the_system_declares(name):
    system, entry = co.systems.get(name), gallery_entry_of(name)
    run = co.integrate(system, np.reshape(entry.start(), (-1, system.dim))[0], (0.0, 1.0), 0.1)
    by_name, declared, every = (
        [bytes(frame) for frame in frames_of(run, picture, frames=3, size=(320, 180))]
        for picture in ("components", entry.components, Picture("components"))
    )
    assert by_name == declared and by_name != every


@pytest.mark.parametrize("span", [(0.0, 4.0), (3.0, -1.0)])
def test_paths_grow_from_the_start_in_the_direction_of_the_run(span):
    run = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.3, 1.0, 0.2), span, 0.1)
    kind, picture = read_picture(Picture("phase portrait", across=0, up=1))
    axes = Figure().add_subplot()
    update = kind.prepare(PlottedRun(run), **picture.options)(axes)
    for k in (0, 7, 40, 20):
        update(k)
        x, y = axes.lines[0].get_data()
        np.testing.assert_array_equal([x[0], y[0]], run.x[0, :2])
        np.testing.assert_array_equal([x[-1], y[-1]], run.x[k, :2])


@pytest.mark.parametrize("span", [(7.0, 11.0), (3.0, -1.0)])
def test_pictures_over_time_have_a_line_at_the_time_of_the_frame(span):
    run = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.3, 1.0, 0.2), span, 0.1)
    kind, picture = read_picture("components")
    axes = Figure().add_subplot()
    update = kind.prepare(PlottedRun(run), **picture.options)(axes)
    before = len(axes.lines)
    for k in (3, 0, 40, 20):
        update(k)
        assert len(axes.lines) == before + 1
        assert list(axes.lines[-1].get_xdata()) == [run.t[k], run.t[k]] and list(axes.lines[-1].get_ydata()) == [0, 1]
        assert axes.get_title().endswith(f"$t$ = {run.t[k]:.4g}")


@pytest.mark.parametrize("span", [(7.0, 9.0), (3.0, 1.0)])
@pytest.mark.parametrize("name", ["path in space", "coadjoint orbit"])
def test_paths_in_space_grow_for_every_member(name, span):
    """Up to the time of the frame, with a mark at its end, and strokes along the path in space up to there."""
    if name == "path in space":
        body = co.systems.kirchhoff_body()
        x0 = 0.5 * np.random.default_rng(3).normal(size=(2, 6))
        run = co.integrate(body, x0, span, 0.02, attitude=True, save_every=5)
    else:
        x0 = np.array([(0.3, 1.0, 0.2), (1.0, 0.2, -0.4)])
        run = co.integrate(co.systems.rigid_body((1, 2, 3)), x0, span, 0.02, save_every=5)
    kind, picture = read_picture(name)
    axes = Figure().add_subplot(projection=kind.projection)
    drawn = PlottedRun(run)
    update = kind.prepare(drawn, **picture.options)(axes)
    fine = drawn.refined
    whole = fine.attitude[..., :3, 3] if name == "path in space" else fine.x
    before = len(axes.lines)
    for k in (0, 7, 20, 13):
        update(k)
        assert len(axes.lines) == before + 2, "one mark for each member"
        for m, mark in enumerate(axes.lines[before:]):
            path = axes.lines[m * (before // 2)]
            shown = np.array(path.get_data_3d(), dtype=float).T
            done = (run.t[k] - fine.t) * np.sign(span[1] - span[0]) >= 0
            np.testing.assert_array_equal(shown, whole[m][done])
            np.testing.assert_array_equal(np.ravel(mark.get_data_3d()), whole[m][done][-1])
            assert mark.get_color() == path.get_color()
            if name == "path in space":
                strokes = np.array(axes.lines[3 * m + 1].get_data_3d()).T.reshape(-1, 3, 3)
                starts = strokes[:, 0]
                assert np.abs(starts[:, None] - shown).sum(axis=-1).min(axis=1).max() == 0.0
                assert len(strokes) == min(40, len(fine.t)) or k < 20
        assert axes.get_title().endswith(f"$t$ = {run.t[k]:.4g}")


def area(polygon):
    X, Y = polygon.T
    return 0.5 * abs(np.sum(X * np.roll(Y, -1) - Y * np.roll(X, -1)))


WIDE = 6.0
RAMPS = {
    "values": lambda system, x: np.broadcast_to(x[0] * np.linspace(-1.0, 1.0, 41), (5, 41)),
    "modes": lambda system, X, Y: np.stack([2.0 * X / WIDE - 1.0, 0.0 * X, 0.0 * X]),
}


@pytest.mark.thinned(1)
@pytest.mark.parametrize("sizes", [(1.0, 3.0, 0.5, -2.0, 1.0), (-0.5, 4.0, -4.0, 0.2, 1.0), (0.0, 2.0, 1.0, -3.0, 0.0)])
@pytest.mark.parametrize("given", list(RAMPS))
def test_each_frame_of_a_field_covers_the_square(given, sizes):
    """The field is a ramp, s (2 X / width - 1): each band is a strip along Y, the outermost ones reach the edges."""
    x = np.outer(sizes, [1.0, 0.0, 0.0])
    run, axes = made(np.linspace(0.0, 2.0, len(sizes)), x, co.systems.rigid_body((1, 2, 3))), Figure().add_subplot()
    kind, options = kinds()["field"], {"width": lambda system: WIDE, given: RAMPS[given]}
    update = kind.prepare(PlottedRun(run), **options)(axes)
    # Values of a function have the scale of start and end, sums of modes that of all times.
    scale = max(map(abs, sizes)) if given == "modes" else max(abs(sizes[0]), abs(sizes[-1])) or 1.0
    for j in (0, 1, 2, 3, 4, 1):
        update(j)
        (field,) = axes.collections
        levels, bands = field.levels, [path.to_polygons() for path in field.get_paths()]
        assert levels[0] == -scale and levels[-1] == scale
        # Products and sums of a few numbers below 6, for each corner of the strips.
        assert sum(area(polygon) for band in bands for polygon in band) == pytest.approx(WIDE**2, rel=1e-12)
        assert axes.get_title() == f"field at $t$ = {run.t[j]:.4g}"
        if not sizes[j]:
            continue
        ends = np.array([-np.inf, *levels[1:-1], np.inf]) / sizes[j]
        for k, band in enumerate(bands):
            wanted = np.clip(0.5 * WIDE * (1.0 + np.sort(ends[k : k + 2])), 0.0, WIDE)
            corners = np.concatenate([np.empty((0, 2)), *band])
            if wanted[1] > wanted[0]:
                # Between points of the grid, 41 or more, values are linear.
                assert np.abs([corners[:, 0].min(), corners[:, 0].max()] - wanted).max() <= WIDE / 40
                assert [corners[:, 1].min(), corners[:, 1].max()] == pytest.approx([0.0, WIDE], rel=1e-12)
            else:
                assert sum(map(area, band)) < 1e-12 * WIDE**2
