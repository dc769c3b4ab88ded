"""Pictures that are updated to another time show that time; files of movies have the colours of their frames."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from PIL import Image

import coadjoint as co
from coadjoint.files.output.output_files import check_speed, write_movie
from coadjoint.pictures.curves import Globe
from coadjoint.pictures.kinds import bodies as module
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import kinds, read_picture
from coadjoint.pictures.solution import default_picture, frames_of
from coadjoint.systems.gallery_entry import Picture
from coadjoint.systems.registry import gallery_entry_of
from refusals import refused

T0 = 7.3


MOVING = ("field", "sphere field", "spins", "vorticity")


def moving(name: str) -> tuple[co.Solution, Picture, Any]:
    """Return a run, a picture that moves, and the values that it shows at a saved point."""
    if name == "vorticity":
        system = co.systems.torus_euler(7)
        run = co.integrate(system, system.random(5, degrees=(1, 3)), (T0, T0 + 2.0), 0.0625, save_every=3)
        return run, Picture("vorticity"), lambda k: run.system.to_grid(run.system.relative(run.x[k]), (128, 128)).T
    if name == "spins":
        lattice = co.systems.spin_lattice("square", (3, 4), tensor=(1.0, 1.0, 0.5))
        run = co.integrate(lattice, np.random.default_rng(4).normal(size=36), (T0, T0 + 2.0), 0.1)
        size = np.linalg.norm(run.x[0].reshape(-1, 3), axis=1).max()
        return run, Picture("spins", at=0.0), lambda k: run.x[k].reshape(-1, 3) / size
    run = co.integrate(co.systems.rigid_body((1.0, 2.0, 3.0)), (1.0, 0.2, 0.5), (T0, T0 + 2.0), 0.1)
    grid = np.add.outer(np.arange(5.0), 10.0 * np.arange(6.0)) - 20.0
    if name == "field":
        options = {"values": lambda body, x: x[0] * grid, "width": lambda body: 1.0}
        return run, Picture("field", **options), lambda k: run.x[k, 0] * grid
    ball = np.broadcast_to(np.linspace(-1.0, 1.0, 7)[:, None], (7, 8))
    options = {"values": lambda body, x: x[0] * ball, "view": (0.0, 0.0)}
    return run, Picture("sphere field", **options), lambda k: run.x[k, 0]


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", MOVING)
def test_every_frame_shows_its_own_time(name):
    run, picture, values = moving(name)
    axes = Figure().add_subplot()
    kind = kinds()[name]
    update = kind.prepare(PlottedRun(run), **picture.options)(axes)
    for k in (3, len(run.t) - 1, 0, 7):
        update(k)
        time = f"{run.t[k]:g}" if name == "spins" else f"{run.t[k]:.4g}"
        assert f"$t$ = {time}" in axes.get_title()
        if name == "vorticity":
            np.testing.assert_array_equal(np.asarray(axes.images[0].get_array())[:-1, :-1], values(k))
        elif name == "spins":
            (arrows,) = (drawn for drawn in axes.collections if isinstance(drawn, Quiver))
            np.testing.assert_allclose(np.stack([arrows.U, arrows.V, arrows.get_array()], axis=-1), values(k))
        elif name == "sphere field":
            project = np.ma.filled(axes.images[0].get_array(), np.nan)
            latitude = np.arcsin(np.linspace(-1.0, 1.0, len(project)))[10:-10]
            column = project[10:-10, len(project) // 2]
            np.testing.assert_allclose(column, values(k) * latitude * 2.0 / np.pi, rtol=0, atol=1e-9)
        else:
            (levels,) = axes.collections
            np.testing.assert_allclose(levels.zmax, values(k).max(), rtol=1e-12)
            np.testing.assert_allclose(levels.zmin, values(k).min(), rtol=1e-12)


def pixels(axes: Any) -> np.ndarray:
    canvas = FigureCanvasAgg(axes.figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", MOVING)
def test_a_picture_that_is_updated_is_the_picture_of_that_time(name):
    """Every mark of it: no dot, arrow or text of another time is left."""
    run, picture, _ = moving(name)
    last, k = len(run.t) - 1, 4
    updated, drawn = Figure((4, 3)).add_subplot(), Figure((4, 3)).add_subplot()
    update = kinds()[name].prepare(PlottedRun(run), **(picture.options | {"at": 1.0}))(updated)
    before = pixels(updated)
    update(k)
    kinds()[name].prepare(PlottedRun(run), **(picture.options | {"at": k / last}))(drawn)
    assert (pixels(updated) == pixels(drawn)).all() and (pixels(updated) != before).any()


@pytest.mark.parametrize("view", [(30.0, 20.0), (-140.0, -35.0)])
def test_the_box_turns_with_the_body_in_every_frame(view):
    """Its corners are those of the box in the attitude of the time; nearer faces are those seen, lit from one side."""
    sides = np.array([1.0, 2.0, 3.0])
    box = co.systems.rigid_body((sides**2).sum() - sides**2)
    starts = np.array([(0.3, 1.0, 0.2), (2.0, 0.3, -1.0)])
    run = co.integrate(box, starts, (7.3, 10.3), 0.1, attitude=True)
    axes = Figure().add_subplot()
    globe = Globe(Figure().add_subplot(), ("", "", ""), view)
    update = kinds()["body"].prepare(PlottedRun(run, [1]), at=1.0, view=view, axis=1)(axes)
    half = module.BOX_SIZE * sides / np.linalg.norm(sides)
    light = module.LIGHT
    for k in (len(run.t) - 1, 12, 0, 5):
        update(k)
        A = run.attitude[k, 1]
        normals = np.concatenate([A.T, -A.T])
        seen = normals[(normals @ globe.frame.T)[:, 2] > 0]
        faces = next(part for part in axes.collections if isinstance(part, PolyCollection))
        found = {tuple(np.round(face.vertices[:4].mean(axis=0), 9)) for face in faces.get_paths()}
        extents = np.abs(seen @ A) @ half
        assert found == {tuple(np.round(globe.project(n * d)[0], 9)) for n, d in zip(seen, extents, strict=True)}
        signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        corners = globe.project((signs * half) @ A.T)[0]
        for face, colour in zip(faces.get_paths(), faces.get_facecolor(), strict=True):
            gaps = np.linalg.norm(face.vertices[:4, None] - corners, axis=-1)
            assert np.all(gaps.min(axis=1) < 1e-12) and len(set(gaps.argmin(axis=1))) == 4
            n = seen[np.argmin([np.linalg.norm(globe.project(n * d)[0] - face.vertices[:4].mean(axis=0))
                                for n, d in zip(seen, extents, strict=True)])]  # fmt: skip
            brightness = 0.55 + 0.45 * max(0.0, globe.frame @ n @ light)
            np.testing.assert_allclose(colour[:3], brightness * module.BOX_COLOUR, rtol=1e-12)
        shaft, tip = axes.lines[-1].get_xydata(), globe.project(A[:, 1])[0]
        np.testing.assert_allclose(shaft, [[0.0, 0.0], tip], atol=1e-12)


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


def states_at(t, x):
    """Return the data of a body without integration."""
    body, start = co.systems.rigid_body((1, 2, 3)), {"energy": 0.0}
    known = {"failed": None, "incomplete": None, "events": None, "carried": None, "attitude": None}
    return SimpleNamespace(t=t, x=x, x0=x[0], system=body, initial=start, energy=0.0 * t, casimirs={}, **known)


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
    run, axes = states_at(np.linspace(0.0, 2.0, len(sizes)), x), Figure().add_subplot()
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


# Movies, written from frames of one colour each.


class Solid:
    """Frames of one colour each, below a bar with all colours, (height, width) = (20, 30)."""

    def __init__(self, shades):
        self.shades = np.array(shades, dtype=np.uint8)
        self.count, self.size = len(shades), (30, 20)

    def samples(self):
        yield next(iter(self))

    def __iter__(self):
        for shade in self.shades:
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


def test_speeds_and_sizes_of_movies(tmp_path):
    assert check_speed(50, Path("run.gif")) == 50.0 and check_speed(120, Path("run.mp4")) == 120.0
    for rate in (0.0, -1.0, np.nan, np.inf, 50.5):
        with pytest.raises(ValueError, match="fps"):
            check_speed(rate, Path("run.gif"))
    huge = Solid(SHADES)
    huge.count, huge.size = 10**6, (4096, 4096)
    with refused(ValueError, "GIF", "frames"):
        write_movie(huge, tmp_path / "run.gif", 10.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["heavy_top", "rigid_body", "kirchhoff_body"])
def test_the_movie_of_a_body_has_the_axis_and_the_vertical_of_its_picture(name):
    entry = gallery_entry_of(name)
    declared = next(picture for picture in entry.pictures if picture.kind == "body axis")
    run = co.integrate(co.systems.get(name), entry.start(), (0.0, 1.0), 0.1, attitude=True)
    found = default_picture(PlottedRun(run))
    assert found.kind == "body" and found.options == declared.options and set(found.options) >= {"axis", "up"}


@pytest.mark.parametrize("name", ["gyrostat", "spin_lattice"])
def test_components_by_name_are_those_that_the_system_declares(name):
    system, entry = co.systems.get(name), gallery_entry_of(name)
    run = co.integrate(system, np.reshape(entry.start(), (-1, system.dim))[0], (0.0, 1.0), 0.1)
    by_name, declared, every = (
        [bytes(frame) for frame in frames_of(run, picture, frames=2, size=(320, 180))]
        for picture in ("components", entry.components, Picture("components"))
    )
    assert by_name == declared and by_name != every
