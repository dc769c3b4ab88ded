"""What pictures show, read back from the artists: members, times, angles beyond 90 degrees, edges, last points.

Runs are of several members with different systems, start at a time other than 0, and go forward and backward. Values
are computed here from the solution, by other formulas than in the pictures.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from drawn_runs import SENSES, T0, data, shown
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

import coadjoint as co
from coadjoint.pictures.globe import Globe
from coadjoint.pictures.members import MemberColours
from coadjoint.pictures.modified_energy import draw_modified_energy
from coadjoint.pictures.phase_drift import draw_phase_drift
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.projections import PROJECTIONS, unit_vectors
from coadjoint.pictures.register import kinds
from coadjoint.pictures.series import COLUMNS, envelope
from coadjoint.pictures.style import colour
from coadjoint.systems.gallery_entry import Picture

INERTIAS = ((1.0, 2.0, 3.0), (1.0, 2.0, 2.5), (1.5, 2.0, 3.2))
STARTS = np.array([[1.0, 0.2, 0.5], [0.4, 0.1, 1.1], [1.3, -0.3, 0.2]])


@cache
def bodies(sense: float = 1.0, count: int = 3, steps: int = 240) -> co.Solution:
    """Return a batch of different bodies, saved so densely that no state between is needed."""
    systems = [co.systems.rigid_body(INERTIAS[m % 3]) for m in range(count)]
    starts = np.array([STARTS[m % 3] * (1.0 + 0.01 * m) for m in range(count)])
    span = (T0, T0 + sense * steps * 0.0625)
    observe = {"first": lambda x: x[..., 0], "sum": lambda x: x[..., 1] + 2.0 * x[..., 2]}
    return co.integrate(co.batch(systems), starts, span, 0.0625, attitude=True, observe=observe)


def curves(axes: Any, shade: Any | None = None, least: int = 20) -> list[Any]:
    """Return the lines of an axes with many points, of one colour."""
    found = [line for line in axes.lines if len(line.get_xdata()) >= least]
    return [line for line in found if shade is None or to_hex(line.get_color()) == to_hex(shade)]


COMPARED = {
    "body",
    "body axis", "coadjoint orbit", "components", "directions", "drift", "eigenvalues", "energy by scale", "error",
    "field spectra", "nutation", "observed", "path in space", "phase ellipse", "phase portrait", "section",
    "space-time", "spins", "vorticity", "field", "sphere field",
}  # fmt: skip


def test_every_kind_of_picture_is_read_back():
    assert set(kinds()) == COMPARED
    single = {name for name, kind in kinds().items() if kind.moves and kind.shows_one_time}
    assert single == {*MOVING, "body"}, "and every kind that shows one time is read back at several times"


@pytest.mark.parametrize("sense", SENSES)
def test_each_member_has_its_own_curve_and_colour_over_time(sense):
    run = bodies(sense)
    axes = shown(run, Picture("components", chosen=[1]))
    shades = MemberColours(PlottedRun(run))
    for m in range(3):
        (line,) = curves(axes, shades[m])
        np.testing.assert_array_equal(data(line), [run.t, run.x[:, m, 1]])
    assert axes.get_xlabel() == "time $t$" and "x_{2}" in axes.get_ylabel()
    several = shown(run, Picture("components", chosen=[2, 0]))
    for place, i in enumerate((2, 0)):
        lines = curves(several, colour(place))
        assert [line.get_label().startswith("$x_{") for line in lines] == [True, False, False]
        assert lines[0].get_label() == f"$x_{{{i + 1}}}$"
        for m, line in enumerate(lines):
            np.testing.assert_array_equal(data(line), [run.t, run.x[:, m, i]])


def test_members_that_are_chosen_are_those_that_are_shown():
    """Of 24 members, and of a few that are named, in their order."""
    run = bodies(1.0, 24, 40)
    chosen = {None: np.linspace(0, 23, 20).round().astype(int), (5, 2, 11): np.array([5, 2, 11])}
    for members, numbers in chosen.items():
        drawn = PlottedRun(run, members)
        np.testing.assert_array_equal(drawn.x, np.swapaxes(run.x[:, numbers], 0, 1))
        np.testing.assert_array_equal(drawn.attitude, np.swapaxes(run.attitude[:, numbers], 0, 1))
        np.testing.assert_array_equal(drawn.invariants["energy"], run.energy[:, numbers].T)
        for place, m in enumerate(numbers):
            assert drawn.system_of(place) is run.system[int(m)]
            field = run.system[int(m)].vector_field(run.x[3, m])
            np.testing.assert_array_equal(drawn.slope(run.x[3, m], run.t[3], place), field)
        axes = shown(run, "observed", members)
        for m, line in zip(numbers, curves(axes, colour(1)), strict=True):
            np.testing.assert_array_equal(line.get_ydata(), run.observed["sum"][:, m])


def shown_on_globe(axes: Any, shade: Any, view: tuple[float, float], path: np.ndarray) -> None:
    """Check a path on a sphere: each point on its side, near or far, and none left out."""
    around, above = np.radians(view)
    towards = np.array([np.cos(above) * np.cos(around), np.cos(above) * np.sin(around), np.sin(above)])
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    flat = np.stack([path @ right, path @ np.cross(towards, right)])
    lines = sorted(curves(axes, shade), key=lambda line: -(line.get_alpha() or 1.0))
    front = path @ towards >= 0.0
    sides = [front, ~front] if front.any() and not front.all() else [front if front.any() else ~front]
    assert len(lines) == len(sides)
    for line, side in zip(lines, sides, strict=True):
        found = data(line)
        np.testing.assert_allclose(found[:, side], flat[:, side], rtol=0, atol=1e-12)
        project = np.isfinite(found[0])
        # A side begins one point before the points that lie on it, where the path comes from the other one.
        np.testing.assert_array_equal(project, side | np.append(side[1:], False))


@pytest.mark.parametrize("sense", SENSES)
def test_axes_and_directions_of_each_member_are_where_they_point(sense):
    run, view = bodies(sense), (35.0, 22.0)
    axes = shown(run, Picture("body axis", axis=0, up=[0, 1, 2], view=view))
    direction = shown(run, Picture("directions", vectors={"x": [0, 1, 2]}, view=view))
    marks = {line.get_label(): line for line in axes.lines if line.get_label() in ("start", "end")}
    globe, shades = Globe(Figure().add_subplot(), ("", "", ""), view), MemberColours(PlottedRun(run))
    for m in range(3):
        momentum = run.attitude[0, m] @ run.x[0, m]
        k = momentum / np.linalg.norm(momentum)
        # The shortest rotation of the momentum to the third axis, by the formula of Rodrigues.
        axis, angle = np.cross(k, [0.0, 0.0, 1.0]), np.arccos(k[2])
        axis /= np.linalg.norm(axis)
        p = run.attitude[:, m, :, 0]
        path = p * np.cos(angle) + np.cross(axis, p) * np.sin(angle)
        path += np.outer(p @ axis, axis) * (1.0 - np.cos(angle))
        shown_on_globe(axes, shades[m], view, path)
        unit = run.x[:, m] / np.linalg.norm(run.x[:, m], axis=1)[:, None]
        shown_on_globe(direction, shades[m], view, unit)
        dot = [line for line in direction.lines if len(line.get_xdata()) == 1 and line.get_color() == shades[m]]
        np.testing.assert_allclose(data(dot[0])[:, 0], globe.project(unit[0])[0], atol=1e-12)
        if m == 0:
            for label, k in (("start", 0), ("end", -1)):
                np.testing.assert_allclose(data(marks[label])[:, 0], globe.project(path[k])[0], atol=1e-9)


def test_portraits_on_a_circle_have_no_line_across_and_every_point():
    run = bodies(1.0, 3, 699)
    axes = shown(run, Picture("phase portrait", across=lambda x: 40.0 * np.arctan2(x[..., 0], x[..., 1]), cyclic=2.0))
    shades = MemberColours(PlottedRun(run))
    for m in range(3):
        (line,) = curves(axes, shades[m])
        x, y = data(line)
        wanted = 40.0 * np.arctan2(run.x[:, m, 0], run.x[:, m, 1])
        kept = np.isfinite(x)
        np.testing.assert_array_equal(y[kept], run.x[:, m, 1])
        np.testing.assert_allclose(np.exp(1j * np.pi * x[kept]), np.exp(1j * np.pi * wanted), rtol=0, atol=1e-9)
        assert np.nanmax(np.abs(np.diff(x))) <= 1.0, "no line from one side to the other"
        assert np.nanmax(np.abs(x)) <= 1.0
    assert axes.get_xlim() == (-1.0, 1.0)


@pytest.mark.parametrize("points", [601, 3000, 6001, 7777])
def test_envelopes_hold_every_point_in_its_own_stretch(points):
    rng = np.random.default_rng(points)
    t, values = T0 + np.sort(rng.random(points)), rng.normal(size=points)
    values[-1], values[0] = 9.0, -9.0
    middle, low, high = envelope(t, values, COLUMNS)
    # The stretches, one after the other: their ends are the points of a new column.
    edges = np.linspace(0, points, COLUMNS + 1).astype(int)
    for k, (first, last) in enumerate(pairwise(edges)):
        own = values[first:last]
        assert (low[k], high[k]) == (own.min(), own.max())
        inside = (t[0], t[-1])[k > 0] if k in (0, COLUMNS - 1) else 0.5 * (t[first] + t[last - 1])
        assert middle[k] == inside
    assert high[-1] == 9.0 and low[0] == -9.0


@pytest.mark.thinned(1)
@pytest.mark.parametrize("name", sorted(PROJECTIONS))
@pytest.mark.parametrize("seed", range(4))
def test_no_line_of_a_map_crosses_its_edge(name, seed):
    """A meridian is at most as long as the map is high; every visible point stays."""
    rng = np.random.default_rng(seed)
    across, centre = PROJECTIONS[name], (rng.uniform(-180, 180), rng.uniform(-80, 80))
    turn = np.radians(np.linspace(-180.0, 180.0, 361))
    for latitude in np.radians(np.arange(-75.0, 76.0, 15.0)):
        x, y = across.line(turn, np.full_like(turn, latitude), centre)
        steps = np.hypot(np.diff(x), np.diff(y))
        # A degree of a great circle, stretched at most sixfold near the edge of an equal-area map.
        assert np.nanmax(steps, initial=0.0) < 6.0 * np.radians(1.0) * across.half_width
        known = np.isfinite(x)
        if known.any():
            assert np.all((x[known] / across.half_width) ** 2 + y[known] ** 2 <= 1.0 + 1e-6)
            assert known.sum() >= (355 if name != "outside" else 1)
    # What a point of the map shows is the point of the sphere that is drawn there.
    directions = across.directions(120, centre)
    project = np.isfinite(directions[..., 0])
    rows, columns = project.shape
    longitude = np.arctan2(directions[..., 1], directions[..., 0])[project]
    latitude = np.arcsin(np.clip(directions[..., 2], -1.0, 1.0))[project]
    np.testing.assert_allclose(unit_vectors(longitude, latitude), directions[project], atol=1e-12)
    for p in rng.integers(0, len(longitude), 30):
        x, y = across.line(np.full(2, longitude[p]), np.full(2, latitude[p]), centre)
        row, column = np.argwhere(project)[p]
        wanted = across.half_width * ((2 * column + 1) / columns - 1), (2 * row + 1) / rows - 1
        np.testing.assert_allclose((x[0], y[0]), wanted, atol=2e-3)


@cache
def fluid(surface: str, sense: float = 1.0) -> co.Solution:
    system = co.systems.sphere_euler(7) if surface == "sphere" else co.systems.torus_euler(7)
    rng = np.random.default_rng(5)
    W = system.algebra.projected(rng.normal(size=(7, 7)) + 1j * rng.normal(size=(7, 7)))
    return co.integrate(system, 2.0 * W, (T0, T0 + sense * 2.0), 0.0625, save_every=3)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize("surface", ["sphere", "torus"])
def test_spectra_and_shares_are_those_of_their_times(surface, sense):
    run = fluid(surface, sense)
    system, k = run.system, int(np.argmin(np.abs(run.t - run.t[[0, -1]].mean())))
    axes = shown(run, Picture("field spectra", at=0.5))
    for place, spectrum in enumerate((system.energy_spectrum, system.enstrophy_spectrum)):
        lines = {line.get_linestyle(): line for line in axes.lines if line.get_color() == colour(place)}
        for style, j in (("--", 0), ("-", k)):
            scales, values = (np.asarray(part, dtype=np.float64) for part in spectrum(run.x[j]))
            np.testing.assert_array_equal(data(lines[style]), [scales, np.where(values > 0.0, values, np.nan)])
            assert lines[style].get_label().endswith(f"$t$ = {run.t[j]:.4g}")
    drawn = np.concatenate([line.get_ydata() for line in axes.lines])
    drawn = drawn[drawn > 1e-8 * np.nanmax(drawn)]
    np.testing.assert_allclose(axes.get_ylim(), [drawn.min() / 2, 3 * drawn.max()], rtol=1e-12)
    shares = shown(run, "energy by scale")
    scales = np.asarray(system.energy_spectrum(run.x[0])[0])
    energies = np.array([system.energy_spectrum(x)[1] for x in run.x])
    for line in shares.lines:
        assert line.get_label().startswith("$l" if surface == "sphere" else "$|n|")
        scale = float(line.get_label().strip("$").split("=")[1])
        own = energies[:, np.flatnonzero(np.isclose(scales, scale))[0]] / energies.sum(axis=1)
        np.testing.assert_allclose(data(line), [run.t, own], rtol=1e-12)
    spectrum = shown(run, Picture("eigenvalues", at=0.5))
    size = np.abs(system.spectrum(run.x[0])).max()
    for line, j in zip(spectrum.lines, (0, k), strict=True):
        assert line.get_label() == f"$t$ = {run.t[j]:.4g}"
        np.testing.assert_allclose(line.get_ydata(), system.spectrum(run.x[j]) / size, rtol=1e-12)


def moving(name: str) -> tuple[co.Solution, Picture, Any]:
    """Return a run, a picture that moves, and the values that it shows at a saved point."""
    if name == "vorticity":
        run = fluid("torus")
        return run, Picture("vorticity"), lambda k: run.system.to_grid(run.system.relative(run.x[k]), (128, 128)).T
    if name == "spins":
        lattice = co.systems.spin_lattice("square", (3, 4), tensor=(1.0, 1.0, 0.5))
        run = co.integrate(lattice, np.random.default_rng(4).normal(size=36), (T0, T0 + 2.0), 0.1)
        size = np.linalg.norm(run.x[0].reshape(-1, 3), axis=1).max()
        return run, Picture("spins", at=0.0), lambda k: run.x[k].reshape(-1, 3) / size
    run = co.integrate(co.systems.rigid_body(INERTIAS[0]), STARTS[0], (T0, T0 + 2.0), 0.1)
    grid = np.add.outer(np.arange(5.0), 10.0 * np.arange(6.0)) - 20.0
    if name == "field":
        options = {"values": lambda body, x: x[0] * grid, "width": lambda body: 1.0}
        return run, Picture("field", **options), lambda k: run.x[k, 0] * grid
    ball = np.broadcast_to(np.linspace(-1.0, 1.0, 7)[:, None], (7, 8))
    options = {"values": lambda body, x: x[0] * ball, "view": (0.0, 0.0)}
    return run, Picture("sphere field", **options), lambda k: run.x[k, 0]


MOVING = ("field", "sphere field", "spins", "vorticity")


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


def test_movies_show_saved_times_from_the_first_to_the_last():
    from coadjoint.pictures.movie import frames_of

    run = fluid("torus")
    frames = frames_of(run, frames=4, size=(128, 96))
    shown = []
    update = frames._update
    frames._update = lambda k: (shown.append(k), update(k))
    assert len(list(frames)) == frames.count == 4
    assert shown == np.linspace(0, len(run.t) - 1, 4).round().astype(int).tolist()


@pytest.mark.parametrize("sense", SENSES)
def test_figures_of_analyses_show_their_numbers(sense):
    run = bodies(sense, 3, 1200)
    drift = co.phase_drift(run)[1]
    lead, rest = draw_phase_drift(drift, predicted=2.0 * drift.slope).axes
    line = np.polyval(np.polyfit(drift.t, drift.lead, 1), drift.t)
    size = np.abs(drift.lead).max()
    np.testing.assert_array_equal(data(lead.lines[0]), [drift.t, drift.lead])
    np.testing.assert_allclose(lead.lines[1].get_ydata(), line, rtol=0, atol=1e-9 * size)
    predicted = line.mean() + 2.0 * drift.slope * (drift.t - drift.t.mean())
    np.testing.assert_allclose(lead.lines[2].get_ydata(), predicted, rtol=0, atol=1e-9 * size)
    np.testing.assert_allclose(rest.lines[0].get_ydata(), drift.lead - line, rtol=0, atol=1e-9 * size)
    (axes,) = draw_modified_energy(run, (4, 6)).axes
    for drawn, series in zip(axes.lines, (run.energy, run.modified_energy(4), run.modified_energy(6)), strict=True):
        own = np.abs(series[:, 0] - series[0, 0])
        np.testing.assert_array_equal(data(drawn), [run.t, np.where(own > 0.0, own, np.nan)])
    assert axes.get_yscale() == "log" and axes.get_xlabel() == "time $t$"
    with pytest.raises(TypeError, match="must be a Solution"):
        draw_modified_energy(run.system)
