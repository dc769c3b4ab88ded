"""Arithmetic of pictures: envelopes, times between saved points, changes of sign, spheres, maps and hidden lines."""

from __future__ import annotations

from types import SimpleNamespace

import mpmath
import numpy as np
import pytest
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3D

import coadjoint as co
from coadjoint.pictures.artists import FadingLine
from coadjoint.pictures.curves import FAR_ALPHA, draw_series, unit_vectors
from coadjoint.pictures.kinds.quantities import flip_times
from coadjoint.pictures.kinds.vorticity import PROJECTIONS
from coadjoint.pictures.plot_data import REFINED_TOLERANCE, REFINED_TURN, PlottedRun, _chord_duration

T0, FADING = 7.3, {"faint": FAR_ALPHA, "hollow": "white"}
SENSES = [1.0, -1.0]
BODY = co.systems.rigid_body((1.0, 2.0, 3.0))


def drawn_with(t, values, joined):
    axes = Figure().add_subplot()
    draw_series(axes, t, values, joined, color="C0", linewidth=1.0)
    return axes


@pytest.mark.parametrize("turns", [3, 290, 310])
@pytest.mark.parametrize("joined", [True, False])
@pytest.mark.parametrize("points", [4000, 5000])
def test_long_series_are_lines_where_they_are_smooth_and_envelopes_where_they_are_dense(points, joined, turns):
    """A column resolves eight dots; half a column resolves a turning point."""
    t = np.linspace(2.0, 9.0, points)
    axes = drawn_with(t, np.sin(np.pi * turns * (t - 2.0) / 7.0), joined)
    if turns > 300 or (points > 4800 and not joined):
        assert not axes.lines and len(axes.collections) == 1
        return
    (line,) = axes.lines
    assert (line.get_linestyle() == "-") == joined and len(line.get_xdata()) == points


def test_an_attitude_turns_where_the_momentum_rests():
    """A body that spins about its axis has a momentum that never moves, and an attitude that always does."""
    run = co.integrate(BODY, (0.0, 0.0, 3.0), (0.0, 20.0), 0.1, save_every=20, attitude=True)
    filled = PlottedRun(run).refined
    first = filled.rotation[0][:, :, 0]
    turned = np.arccos(np.clip(np.sum(first[1:] * first[:-1], axis=1), -1.0, 1.0))
    # It turns by one radian in a unit of time.
    assert 0.9 * REFINED_TURN < turned.max() <= REFINED_TURN * (1 + 1e-9)


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


@pytest.mark.parametrize("sense", SENSES)
def test_the_longest_chord_is_that_of_the_member_and_time_that_turn_most(sense):
    """x' = a (cos(w t^2), sin(w t^2)) has the acceleration 2 a w |t|, at fixed times none."""
    t = T0 + sense * np.linspace(0.0, 3.0, 33)
    rates, sizes = (1.0, 5.0, 2.0), np.array([3.0, 1.0, 0.5])
    x = sizes[:, None, None] * np.stack([0.0 * t, np.linspace(0.0, 4.0, 33)], axis=-1)

    def slope(x, t, m):
        return 0.7 * np.array([np.cos(rates[m] * t**2), np.sin(rates[m] * t**2)])

    for members in ([0, 1, 2], [1, 0], [2], [0]):
        run = SimpleNamespace(t=t, x=x[members], slope=lambda x, t, m, members=members: slope(x, t, members[m]))
        turning = [2.0 * 0.7 * rates[m] * np.abs(t).max() / (4.0 * sizes[m]) for m in members]
        wanted = (8.0 * REFINED_TOLERANCE / max(turning)) ** 0.5
        # The difference over 1e-5 of the path leaves the third derivative, of relative size w t dt.
        assert _chord_duration(run) == pytest.approx(wanted, rel=2e-2)


@pytest.mark.parametrize("name", PROJECTIONS)
def test_maps_are_inverted_and_keep_areas(name):
    rng = np.random.default_rng(1)
    map_ = PROJECTIONS[name]
    longitude = rng.uniform(-3.0, 3.0, 400) / (1 if map_.half_width == 2.0 else 2)
    latitude = rng.uniform(-1.4, 1.4, 400)
    x, y = map_.project(longitude, latitude)
    assert ((x / map_.half_width) ** 2 + y**2).max() < 1.0
    east, north = map_.unproject(x, y)
    # Matplotlib's iteration for the angle of Mollweide's map ends at a correction of 0.001 in twice the angle.
    np.testing.assert_allclose([east, north], [longitude, latitude], atol=5e-3 if name == "mollweide" else 2e-12)
    if name == "outside":
        np.testing.assert_allclose([x, y], [np.cos(latitude) * np.sin(longitude), np.sin(latitude)], atol=1e-15)
        return
    h = 1e-5
    along, up = (
        (np.array(map_.unproject(x + a, y + b)) - np.array(map_.unproject(x - a, y - b))) / (2 * h)
        for a, b in ((h, 0), (0, h))
    )
    # 4 pi of the sphere over 2 pi of the ellipse; central differences err by h^2 times third derivatives
    area = (along[0] * up[1] - along[1] * up[0]) * np.cos(north)
    np.testing.assert_allclose(area, 2.0, atol=1e-4)


def space(elevation, around):
    """Return orthographic axes with unequal limits and sides."""
    axes = Figure().add_subplot(projection="3d")
    axes.set_proj_type("ortho")
    axes.view_init(elevation, around)
    axes.set(xlim=(-1.0, 3.0), ylim=(0.0, 1.5), zlim=(5.0, 6.0))
    axes.set_box_aspect((2.0, 1.0, 3.0))
    return axes


@pytest.mark.parametrize("joined", [True, False])
@pytest.mark.parametrize("alpha", [None, 0.5])
def test_hidden_points_are_faint_and_gaps_between_the_parts_are_closed(joined, alpha, monkeypatch):
    points = np.random.default_rng(1).normal(size=(8, 3))
    hidden = np.array([False, False, True, True, True, False, False, True])
    seen = []

    def recorded(self, renderer):
        seen.append((np.array(self.get_data_3d()).T, self.get_alpha(), self.get_markerfacecolor()))

    monkeypatch.setattr(Line3D, "draw", recorded)
    axes = space(20.0, 35.0)
    style = {} if joined else {"linestyle": "none", "marker": "o"}
    line = FadingLine(points, lambda points, _: hidden[: len(points)], alpha=alpha, color="red", **FADING, **style)
    axes.add_line(line)
    line.draw(RendererAgg(10, 10, 72))
    assert [opacity for _, opacity, _ in seen] == [FAR_ALPHA * (alpha or 1.0), alpha or 1.0]
    for (drawn, _, _), part in zip(seen, (hidden, ~hidden), strict=True):
        # A part of a line begins at the last point of the other one.
        shown = part | np.append(part[1:], False) if joined else part
        np.testing.assert_array_equal(drawn, np.where(shown[:, None], points, np.nan))
    np.testing.assert_array_equal(np.array(line.get_data_3d()).T, points)
    assert line.get_alpha() == alpha


def half_period(inertia, x0):
    """Return 2 K(k) / lambda, after which the middle component has changed its sign, to 30 digits.

    By the axes sorted: with a, b, c such that b is the middle one and the motion goes around c.
    """
    with mpmath.workdps(30):
        m = sorted((1 / mpmath.mpf(moment) for moment in inertia), reverse=True)
        order = np.argsort(inertia)
        x = [mpmath.mpf(float(x0[i])) for i in order]
        energy2, size2 = sum(k * v * v for k, v in zip(m, x, strict=True)), sum(v * v for v in x)
        a, b, c = (m[2], m[1], m[0]) if energy2 > m[1] * size2 else (m[0], m[1], m[2])
        rate2 = (b - c) * (a * size2 - energy2)
        k2 = (a - b) * (energy2 - c * size2) / rate2
        return float(2 * mpmath.ellipk(k2) / mpmath.sqrt(rate2))


@pytest.mark.thinned(4)
@pytest.mark.parametrize(
    ("inertia", "x0"),
    [
        ((1, 2, 3), (0.01, 1.0, 0.01)),
        ((1, 2, 3), (0.03, 1.0, 0.01)),
        ((1, 2, 3), (0.01, -1.0, 0.05)),
        ((3.0, 1.0, 2.2), (0.02, -0.01, 1.3)),
    ],
)
def test_the_flip_comes_after_half_the_period_of_the_elliptic_functions(inertia, x0):
    body = co.systems.rigid_body(inertia)
    middle = int(np.argsort(inertia)[1])
    wanted = half_period(inertia, x0)
    run = co.integrate(body, x0, (0.0, 128.0), 2.0**-5, co.GaussLegendre(4))
    times = flip_times(body.vector_field, run.t, run.x, middle)
    assert len(times) >= 3
    # The cubic between two points misses by h^4 x'''' / 384 over the slope at the flip; all rates are below one.
    np.testing.assert_allclose(np.diff(times), wanted, rtol=0, atol=2.0**-20 / 16)
    # The other components have the period, or half of it; both are whole numbers of flips.
    flipped = co.analysis.period(body.vector_field, x0).time / wanted
    assert flipped == pytest.approx(2.0, abs=1e-9)
