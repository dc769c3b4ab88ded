"""Marks, limits, labels and scales of pictures, read back from the artists."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import drawn_runs
import numpy as np
import pytest
from drawn_runs import BARE, BODY, SENSES, SPIN, T0, axes_of, data
from matplotlib import colormaps
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.gallery import _describe
from coadjoint.pictures.globe import VIEW, Globe, view_of
from coadjoint.pictures.kinds.body_axis import _rotation_to_vertical, axis_in_space
from coadjoint.pictures.kinds.section import draw_crossings
from coadjoint.pictures.level_surface import level_surface
from coadjoint.pictures.members import LIGHTEST
from coadjoint.pictures.modified_energy import draw_modified_energy
from coadjoint.pictures.movie import frames_of
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.projections import PROJECTIONS
from coadjoint.pictures.refinement_times import REFINED_TOLERANCE, _chord_duration
from coadjoint.pictures.register import CannotShow
from coadjoint.pictures.style import INK, colour
from coadjoint.systems.gallery_entry import Picture

TURN = 2.0 * np.pi * np.arange(200) / 200


def made(x: np.ndarray, system: Any = BODY, t: Any = None, **series: Any) -> Any:
    return drawn_runs.made(T0 + 0.01 * np.arange(len(x)) if t is None else t, x, system, **series)


def spinning(phase: np.ndarray, t: np.ndarray, sense: float = 1.0) -> Any:
    """Return the data of a spin that turns at the rate 1."""
    rising = np.sign(SPIN.vector_field(np.array([1.0, 0.0, 0.0]))[1])
    return made(np.stack([np.cos(phase), sense * rising * np.sin(phase), 0.0 * t + 0.5], axis=-1), SPIN, t)


# Axes and labels of the time between changes of sign


@pytest.mark.thinned(1)
@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize(
    ("side", "first", "last", "span"), [("center", 0.0, 5.0, 5.0), ("left", 0.0, 4.0, 12.0), ("right", 8.0, 12.0, 12.0)]
)
def test_changes_of_sign_are_marked_at_their_times(sense, side, first, last, span):
    """A spin turns between two times, and rests before and after; it is at right angles half a unit after the first."""
    tau = np.linspace(0.0, span, 2001)
    run = spinning(np.pi / 2 - 0.5 + np.clip(tau, first, last) - first, T0 + sense * tau, sense)
    axes = axes_of(run, "components", chosen=[0], flips=0)
    times = T0 + sense * (first + 0.5 + np.array([0.0, np.pi]))
    dotted = [line for line in axes.lines if line.get_linestyle() == ":"]
    np.testing.assert_allclose([line.get_xdata() for line in dotted], np.stack([times] * 2, axis=1), rtol=0, atol=1e-9)
    (text,) = (found for found in axes.texts if found.get_text())
    assert float(text.get_text().rpartition(" ")[2]) == pytest.approx(np.pi, abs=1e-5)
    (arrow,) = (found for found in axes.texts if not found.get_text())
    ends = np.array([arrow.xyann, arrow.xy])
    np.testing.assert_allclose(np.sort(ends[:, 0]), np.sort(times), rtol=0, atol=1e-9)
    low, high = axes.get_ylim()
    assert ends[0, 1] == ends[1, 1] == text.get_position()[1] == dotted[0].get_ydata()[1]
    assert low < run.x[:, 0].min() and run.x[:, 0].max() < ends[0, 1] < high
    shown = side if sense > 0 or side == "center" else {"left": "right", "right": "left"}[side]
    assert text.get_ha() == shown
    where = {"left": times.min(), "right": times.max(), "center": times.mean()}[shown]
    assert text.get_position()[0] == pytest.approx(where, abs=1e-9)


@pytest.mark.parametrize("sense", SENSES)
def test_short_times_between_changes_of_sign_are_not_marked(sense):
    tau = np.linspace(0.0, 80.0, 8001)
    run = spinning(tau, T0 + sense * tau, sense)
    assert not axes_of(run, "components", chosen=[0], flips=0).texts
    several = made(np.stack([run.x, run.x], axis=1)[:1000], SPIN, run.t[:1000])
    assert not axes_of(several, "components", chosen=[0], flips=0).texts
    one = axes_of(several, "components", [1], chosen=[0], flips=0).texts
    assert any("changes sign after 3.14159" in text.get_text() for text in one)


def test_changes_of_sign_are_those_of_the_member_that_is_chosen():
    """Each member of a batch has a field of its own, by which the cubic between two points is made."""
    systems = [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, w])) for w in (-5.0, 1.0)]
    tau = 0.2 * np.arange(30)
    rising = np.sign(systems[1].vector_field(np.array([1.0, 0.0, 0.0]))[1])
    x = np.stack([np.cos(tau), rising * np.sin(tau), 0.0 * tau], axis=-1)
    run = made(np.stack([x, x], axis=1), co.batch(systems), T0 + tau)
    texts = axes_of(run, "components", [1], chosen=[0], flips=0).texts
    (said,) = (float(text.get_text().rpartition(" ")[2]) for text in texts if text.get_text())
    # Both cubics are wrong by h^4 / 384; with the other field by a fifth of the interval.
    assert said == pytest.approx(np.pi, abs=2 * 0.2**4 / 384 + 1e-5)


# Components, portraits, directions


@pytest.mark.long
def test_components_functions_and_titles():
    x = np.random.default_rng(1).normal(size=(40, 2, 3))
    run = made(x)
    axes = axes_of(run, "components", functions={"E": lambda x: x[..., 0] + 2.0 * x[..., 2]}, chosen=[1], quantity="q")
    for line, values in zip(axes.lines, [x[:, 0, 1], x[:, 1, 1], *(x[:, :, 0] + 2.0 * x[:, :, 2]).T], strict=True):
        np.testing.assert_array_equal(data(line), [run.t, values])
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["$x_{2}$", "$E$"]
    assert (axes.get_title(), axes.get_ylabel()) == ("q over time", "q")
    alone = axes_of(run, "components", functions=lambda n: {"E": lambda x: n * x[..., 1]})
    for m, line in enumerate(alone.lines):
        np.testing.assert_array_equal(line.get_ydata(), 3.0 * x[:, m, 1])
        assert line.get_color() == colour(0), "all have the same energy"
    assert alone.get_ylabel() == "angular momentum $E$" and alone.get_legend() is None
    named = axes_of(run, "components", chosen=lambda n: [n - 1, 0])
    assert [line.get_ydata()[0] for line in named.lines] == [x[0, 0, 2], x[0, 1, 2], x[0, 0, 0], x[0, 1, 0]]
    assert (named.get_title(), named.get_ylabel()) == (
        "components of the angular momentum",
        "angular momentum $x_i$",
    )


def test_portraits_have_a_dot_at_each_start_and_the_scales_asked_for():
    starts = np.array([0.2, -0.4])
    x = np.stack(
        [np.cos(TURN)[:, None] + starts, np.sin(TURN)[:, None] * (1 + starts), 0.5 + 0 * starts * TURN[:, None]], -1
    )
    run = made(x)
    options = {"labels": ("a", "b"), "equal": True, "title": "an orbit"}
    axes = axes_of(run, "phase portrait", [1, 0], across=lambda x: 2.0 * x[..., 1], up=0, **options)
    for place, m in enumerate((1, 0)):
        curve, dot = axes.lines[2 * place : 2 * place + 2]
        np.testing.assert_array_equal(data(curve), [2.0 * x[:, m, 1], x[:, m, 0]])
        np.testing.assert_array_equal(data(dot)[:, 0], [2.0 * x[0, m, 1], x[0, m, 0]])
        assert curve.get_color() == dot.get_color() == colour(0)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("a", "b", 1.0)
    assert axes.get_title() == "an orbit (dot: start)"
    free = axes_of(run, "phase portrait")
    assert free.get_aspect() == "auto" and (free.get_xlabel(), free.get_ylabel()) == ("$x_{1}$", "$x_{2}$")
    with pytest.raises(CannotShow, match="coordinate 3 is drawn, and the state has 3"):
        axes_of(run, "phase portrait", up=3)


def test_vectors_have_colours_labels_and_gaps_of_their_own():
    run = spinning(TURN, T0 + TURN)
    run.x[60], x = 0.0, run.x
    forms = np.array([[0.0, 2.0, 0.0], [0.0, 0.0, -1.0], [3.0, 0.0, 0.0]])
    view = (35.0, 22.0)
    axes = axes_of(run, "directions", vectors={"first": (0, "x2", 2), "second": forms}, view=view, title="both")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["first", "start", "second"]
    globe = Globe(Figure().add_subplot(), ("", "", ""), view)
    known = np.arange(200) != 60
    for i, v in enumerate((x, x @ forms.T)):
        unit = v[known] / np.linalg.norm(v[known], axis=1)[:, None]
        flat, depth = globe.project(unit)
        lines = [line for line in axes.lines if len(line.get_xdata()) == 200 and line.get_color() == colour(i)]
        assert len(lines) in (1, 2)
        project = np.isfinite([line.get_xdata() for line in lines])
        assert not project[:, 60].any() and project[:, known].any(axis=0).all()
        for line, own in zip(lines, project, strict=True):
            np.testing.assert_allclose(data(line)[:, own & known].T, flat[own[known]], rtol=0, atol=1e-12)
        (dot,) = (line for line in axes.lines if len(line.get_xdata()) == 1 and line.get_color() == colour(i))
        np.testing.assert_allclose(data(dot)[:, 0], flat[0], rtol=0, atol=1e-12)
        assert dot.get_markerfacecolor() == (colour(i) if depth[0] >= 0.0 else "white")
    assert axes.get_title() == "both"
    with pytest.raises(CannotShow, match="made of 4 coordinates, and the state has 3"):
        axes_of(made(x), "directions", vectors={"v": np.ones((3, 4))})
    with pytest.raises(CannotShow, match="the state has 3"):
        axes_of(made(x), "directions", vectors={"v": (1, 2, 3)})


# Spheres


@pytest.mark.thinned(1)
@pytest.mark.parametrize("around", [-170.0, -80.0, 10.0, 100.0])
def test_a_path_on_one_side_of_a_sphere_is_seen_from_there(around):
    angles = np.radians(around + np.array([-30.0, -10.0, 10.0, 30.0]))
    points = np.stack([np.cos(angles), np.sin(angles), 0.2 + 0 * angles], axis=-1)
    lost = np.array([[np.nan, 1.0, 0.0], [np.inf, 0.0, 0.0]])
    found = view_of(np.concatenate([lost[:1], points, lost[1:]]))
    assert (found[0] - around) % 360.0 == pytest.approx(25.0) and found[1] == VIEW[1]
    assert view_of(np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])) == VIEW
    axes = axes_of(made(points * 2.0), "directions", vectors={"v": (0, 1, 2)})
    globe = Globe(Figure().add_subplot(), ("", "", ""), found)
    dot = next(line for line in axes.lines if line.get_label() == "start")
    np.testing.assert_allclose(data(dot)[:, 0], globe.project(points[0] / np.linalg.norm(points[0]))[0], atol=1e-12)


@pytest.mark.parametrize("radius", [1.0, 2.5])
def test_the_axes_of_a_sphere_stand_out_of_it_with_their_names(radius):
    axes = Figure().add_subplot()
    globe = Globe(axes, ("a", "b", "c"), (200.0, -30.0), radius)
    arrows = [text for text in axes.texts if not text.get_text()]
    names = [text for text in axes.texts if text.get_text()]
    assert [text.get_text() for text in names] == ["a", "b", "c"]
    for direction, arrow, name in zip(np.eye(3), arrows, names, strict=True):
        foot, depth = globe.project(radius * direction)
        np.testing.assert_allclose(arrow.xyann, foot, atol=1e-12)
        np.testing.assert_allclose(arrow.xy, 1.22 * foot, atol=1e-12)
        beyond = 0.1 * radius * foot / np.linalg.norm(foot)
        np.testing.assert_allclose(name.get_position(), 1.22 * foot + beyond, atol=1e-12)
        assert (arrow.get_zorder() > 0) == (name.get_zorder() > 0) == bool(depth > 0.0)
    # East is to the right of the direction of view, north is up, and the near side has positive depth.
    towards = globe.frame[2]
    assert np.degrees(np.arcsin(towards[2])) == pytest.approx(-30.0)
    assert np.degrees(np.arctan2(towards[1], towards[0])) % 360.0 == pytest.approx(200.0)
    np.testing.assert_allclose(np.cross(globe.frame[0], globe.frame[1]), towards, atol=1e-15)
    assert globe.frame[1][2] > 0.0 and axes.get_xlim() == axes.get_ylim() == (-1.42 * radius, 1.42 * radius)


def test_points_of_a_sphere_that_are_not_joined_are_strong_in_front_and_faint_behind():
    axes = Figure().add_subplot()
    globe = Globe(axes, ("a", "b", "c"), (0.0, 0.0))
    points = np.random.default_rng(2).normal(size=(50, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    before = len(axes.lines)
    globe.path(points, "C0", joined=False)
    near, far = axes.lines[before:]
    for line, own, strength in ((near, points[:, 0] >= 0.0, 1.0), (far, points[:, 0] < 0.0, 0.28)):
        assert len(line.get_xdata()) == 50, "each point has its place, for movies"
        np.testing.assert_allclose(data(line).T[own], points[own][:, 1:], atol=1e-15)
        assert np.isnan(data(line).T[~own]).all()
        assert line.get_linestyle() == "None" and line.get_alpha() == pytest.approx(strength)


@pytest.mark.parametrize(
    "v", [*np.random.default_rng(3).normal(size=(5, 3)), [0, 0, 2.0], [0, 0, -3.0], [1e-9, 0, -1.0]]
)
def test_a_vector_is_raised_by_the_shortest_rotation(v):
    v = np.array(v, dtype=np.float64)
    R, size = _rotation_to_vertical(v), np.linalg.norm(v)
    # The divisor 1 + u3 is at least 1e-12, if u3 is not taken for -1.
    np.testing.assert_allclose(R @ v / size, [0.0, 0.0, 1.0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert np.trace(R) == pytest.approx(1.0 + 2.0 * v[2] / size, abs=1e-8), "the angle is that between both"
    np.testing.assert_array_equal(_rotation_to_vertical(0.0 * v), np.eye(3))


def rotations(axis: Any, angles: np.ndarray) -> np.ndarray:
    """Return rotations about an axis, (k, 3, 3)."""
    u = np.array(axis, dtype=np.float64) / np.linalg.norm(axis)
    hat = np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])
    s, c = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + s * hat + (1.0 - c) * hat @ hat


def test_axes_in_space_of_members_that_hang_down():
    """The vertical of each member is its own, and is up in the picture, whatever its direction in the attitude."""
    A = np.stack([rotations((1, 2, 2), 0.7 + TURN), rotations((0, 1, 0), 0.4 - TURN)], axis=1)
    down = np.array([0.0, 0.0, -2.0]), np.array([1.0, 1.0, 0.5])
    x = np.stack([np.einsum("kji,j->ki", A[:, m], down[m]) for m in range(2)], axis=1)
    run = made(x, attitude=A, carried="representation")
    given = np.array([0.0, 3.0, 4.0])
    axes = axes_of(run, "nutation", axis=given, up=(0, 1, 2), turns=1000.0)
    for m in range(2):
        pointing = A[:, m] @ given / 5.0
        wanted = np.degrees(np.arccos(pointing @ down[m] / np.linalg.norm(down[m])))
        np.testing.assert_allclose(axes.lines[2 * m].get_ydata(), wanted, rtol=0, atol=1e-6)
    path, _ = axis_in_space(PlottedRun(run), given, None)
    np.testing.assert_allclose(path, np.swapaxes(A @ given, 0, 1) / 5.0, rtol=0, atol=1e-15)
    assert given.tolist() == [0.0, 3.0, 4.0] and axes.get_title() == "nutation of the axis of the body (dot: start)"
    for wrong in ((0.0, 0.0, 0.0), (1.0, 2.0)):
        with pytest.raises(ValueError, match="the number of an axis, or a direction"):
            axes_of(run, "nutation", axis=wrong)


def test_a_nutation_ends_for_each_member_where_it_has_turned_enough():
    fast, slow = rotations((0, 0, 1), -2.0 * TURN), rotations((0, 0, 1), 0.2 * TURN)
    tilt = rotations((0, 1, 0), np.full(200, 0.3))
    A = np.stack([fast @ tilt, slow @ tilt], axis=1)
    run = made(np.ones((200, 2, 3)), attitude=A, system=BARE, carried="representation")
    axes = axes_of(run, "nutation", turns=0.5)
    ends = [np.degrees(-2.0 * TURN), np.degrees(0.2 * TURN)]
    for m, azimuth in enumerate(ends):
        kept = azimuth[np.abs(azimuth) <= 180.0 + 1e-9]
        np.testing.assert_allclose(axes.lines[2 * m].get_xdata()[: len(kept) - 1], kept[:-1], rtol=0, atol=1e-9)
        assert len(axes.lines[2 * m].get_xdata()) in (len(kept), len(kept) - 1)
        np.testing.assert_allclose(axes.lines[2 * m + 1].get_data(), [[0.0], [np.degrees(0.3)]], atol=1e-9)
    assert axes.get_title() == "nutation of body axis 3, for the first 180 degrees (dot: start)"
    assert axes_of(run, "nutation", [1]).get_title() == "nutation of body axis 3 (dot: start)"


def test_group_elements_that_are_no_rotations_have_no_axes():
    """The first group element is the unit, also of groups of other matrices."""
    A = np.repeat(np.eye(3)[None], 200, axis=0)
    A[:, 0, 2] = TURN
    for wrong in (A, np.repeat(np.eye(2)[None], 200, axis=0), 1.5 * rotations((1, 0, 0), TURN)):
        with pytest.raises(CannotShow, match="no attitude that is a rotation"):
            axes_of(made(np.ones((200, 3)), attitude=wrong, carried="representation"), "body axis")


# Space


def test_a_path_in_space_is_framed_with_its_strokes():
    g = np.zeros((200, 2, 4, 4))
    for m in range(2):
        g[:, m, :3, :3] = rotations((1, m, 0), TURN)
        g[:, m, :3, 3] = np.stack([3.0 * m + np.cos(TURN), 2.0 * np.sin(TURN), 0.1 * TURN - 5.0 * m], axis=-1)
    g[..., 3, 3] = 1.0
    run = made(np.ones((200, 2, 6)), co.systems.kirchhoff_body(), attitude=g, carried="representation")
    axes = axes_of(run, "path in space", axis=1)
    place = g[..., :3, 3]
    widest = np.max(np.ptp(place, axis=(0, 1)))
    strokes = [np.array(axes.lines[3 * m + 1].get_data_3d()).T.reshape(-1, 3, 3) for m in range(2)]
    for m, own in enumerate(strokes):
        at = np.linspace(0, 199, 40).round().astype(int)
        np.testing.assert_array_equal(own[:, 0], place[at, m])
        np.testing.assert_allclose(own[:, 1] - own[:, 0], 0.09 * widest * g[at, m, :3, 1], rtol=0, atol=1e-12)
        np.testing.assert_array_equal(np.ravel(axes.lines[3 * m + 2].get_data_3d()), place[0, m])
        assert axes.lines[3 * m].get_color() == colour(0)
    ends = np.concatenate([own[:, 1] for own in strokes])
    for i, (low, high) in enumerate((axes.get_xlim(), axes.get_ylim(), axes.get_zlim())):
        assert low < min(place[..., i].min(), ends[:, i].min()) and high > max(place[..., i].max(), ends[:, i].max())
        assert 0.5 * (low + high) == pytest.approx(0.5 * (place[..., i].min() + place[..., i].max()))
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["body axis 2", "start"]


@pytest.mark.parametrize("members", [[1], [2, 0]])
def test_the_surface_is_that_of_the_first_member_drawn(members):
    sizes = np.array([1.0, 2.0, 3.0])
    one = spinning(TURN, T0 + TURN)
    x = sizes[:, None] * one.x[:, None]
    axes = axes_of(made(x, SPIN, one.t), "coadjoint orbit", members, view=(20.0, 70.0))
    assert (axes.azim, axes.elev) == (20.0, 70.0)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()) == ("$x_{1}$", "$x_{2}$", "$x_{3}$")
    radius = np.linalg.norm(x[0, members[0]])
    corners = np.asarray(axes.collections[0]._faces).reshape(-1, 3)
    # Linear interpolation in 36 cells, whose diagonals are 2.2 sqrt(3) / 36 of the radius of the largest orbit.
    largest = np.linalg.norm(x[0, members], axis=-1).max()
    error = (1.1 * 2.0 * 3**0.5 * largest / 36) ** 2 / 8 / radius
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), radius, rtol=0, atol=1.2 * error)
    for place, m in enumerate(members):
        path, dot = axes.lines[2 * place : 2 * place + 2]
        np.testing.assert_array_equal(np.array(path.get_data_3d()).T, x[:, m])
        np.testing.assert_array_equal(np.ravel(dot.get_data_3d()), x[0, m])
        shade = colour(0)
        assert path.get_color() == shade and dot.get_color() == (shade if len(members) > 1 else colour(1))
    several = "orbits, and the level surface of $|x|^2$ of the first"
    assert axes.get_title().startswith(several if len(members) > 1 else "orbit on the level surface of $|x|^2$")


def test_orbits_without_a_surface_are_framed_with_every_member():
    x = np.random.default_rng(7).normal(size=(30, 3, 3)) * np.array([1.0, 5.0, 2.0])[:, None] + 3.0
    axes = axes_of(made(x, BARE), "coadjoint orbit")
    for i, (low, high) in enumerate((axes.get_xlim(), axes.get_ylim(), axes.get_zlim())):
        assert low < x[..., i].min() and x[..., i].max() < high
    assert "no Casimir is known" in axes.get_title() and not axes.collections


def test_long_curves_keep_their_first_and_last_points():
    count = 45_000
    x = np.random.default_rng(4).normal(size=(count, 3))
    drawn = PlottedRun(made(x, t=T0 + np.arange(count)))
    steps = np.diff(drawn.curve_indices)
    assert (drawn.curve_indices[0], drawn.curve_indices[-1]) == (0, count - 1) and len(drawn.curve_indices) <= 20_001
    assert np.all(steps[:-1] == steps[0]) and 0 < steps[-1] <= steps[0]


def test_surfaces_in_a_box_with_unequal_edges():
    box = np.array([(0.0, 1.0), (-2.0, 1.0), (1.0, 4.0)])
    triangles = level_surface(co.Polynomial({(1, 0, 0): 1.0, (0, 1, 0): 2.0}), 0.5, box, cells=6)
    points = triangles.reshape(-1, 3)
    np.testing.assert_allclose(points[:, 0] + 2.0 * points[:, 1], 0.5, rtol=0, atol=8 * 2.0**-53)
    np.testing.assert_allclose(points.min(axis=0), [0.0, -0.25, 1.0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(points.max(axis=0), [1.0, 0.25, 4.0], rtol=0, atol=1e-15)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert 0.5 * np.linalg.norm(normal, axis=1).sum() == pytest.approx(3.0 * np.hypot(1.0, 0.5), rel=1e-13)


# Fields and fluids


@pytest.mark.parametrize("given", ["modes", "values"])
def test_a_field_stands_along_its_axes_in_one_scale(given):
    """f = x1 X + x2 Y^2 - 3 x3 X: its bands along Y = 0 and along X = 0 are known."""
    s = np.linspace(0.0, 1.0, 11)
    x = np.stack([1.0 - 3.0 * s, 0.25 * s, 0.1 * s], axis=-1)
    edge = np.linspace(0.0, 2.0, 161)
    X, Y = np.meshgrid(edge, edge)
    f = lambda x: (x[0] - 3.0 * x[2]) * X + x[1] * Y**2  # noqa: E731
    options: dict[str, Any] = {"modes": lambda body, X, Y: [X, Y**2, -3.0 * X]}
    if given == "values":
        options = {"values": lambda body, x: f(x)}
    axes = axes_of(made(x), "field", width=lambda body: 2.0, at=0.5, label="w", **options)
    (bands,) = axes.collections
    largest = 2.0 * 2.0 + 0.25 * 4.0 + 0.1 * 6.0 if given == "modes" else max(np.abs(f(x[k])).max() for k in (0, 5, 10))
    np.testing.assert_allclose(bands.levels, np.linspace(-largest, largest, 21), rtol=0, atol=1e-12)
    for low, high, path in zip(bands.levels[:-1], bands.levels[1:], bands.get_paths(), strict=True):
        if len(path.vertices):
            right, up = path.vertices.T
            own = (x[5, 0] - 3.0 * x[5, 2]) * right + x[5, 1] * up**2
            # Interpolation in cells of 2 / 160 is wrong by an eighth of the square times the second derivative.
            assert low - 1e-4 <= own.min() and own.max() <= high + 1e-4
    assert axes.get_title() == f"w at $t$ = {T0 + 0.05:.4g}" and axes.get_xlim() == axes.get_ylim() == (0.0, 2.0)


def test_spectra_of_matrices_over_the_part_of_the_eigenvalues_below():
    fluid = co.systems.torus_euler(5)
    W = np.stack([fluid.random(seed, degrees=(1, 2)) for seed in (1, 2, 3)])
    axes = axes_of(made(W, fluid), "eigenvalues", at=0.5)
    size = np.abs(fluid.spectrum(W[0])).max()
    for line, k in zip(axes.lines, (0, 1), strict=True):
        np.testing.assert_allclose(data(line), [(np.arange(5) + 0.5) / 5, fluid.spectrum(W[k]) / size], atol=1e-14)
    moved = np.abs(fluid.spectrum(W[1]) - fluid.spectrum(W[0])).max() / size
    assert axes.get_title() == f"spectrum of $W$: moved by {moved:.1e} of the largest"
    again = axes_of(made(W[:, None] * [[[[1.0]], [[2.0]]]], fluid), "eigenvalues", [1], at=0.5)
    np.testing.assert_allclose(data(again.lines[1]), data(axes.lines[1]), atol=1e-14)


def test_the_six_scales_with_the_largest_share_at_any_time_are_drawn():
    fluid = co.systems.sphere_euler(12)
    # Two scales have a share at all times, six others a larger one at one time, of another size each.
    always = fluid.random(4, degrees=(2, 3))
    parts = [fluid.random(1, degrees=(k, k + 1)) for k in (9, 4, 6)]
    W = np.stack(
        [
            c * (part / fluid.energy(part) ** 0.5 + 0.6 * always / fluid.energy(always) ** 0.5)
            for c, part in zip((0.1, 1.0, 3.0), parts, strict=True)
        ]
    )
    axes = axes_of(made(W, fluid, np.array([T0, T0 - 1.0, T0 - 5.0])), "energy by scale")
    energies = np.array([fluid.energy_spectrum(w)[1] for w in W])
    shares = energies / energies.sum(axis=1)[:, None]
    largest, means, sizes = (
        np.sort(np.argsort(-values)[:6]) for values in (shares.max(axis=0), shares.mean(axis=0), energies.max(axis=0))
    )
    assert largest.tolist() != means.tolist() and largest.tolist() != sizes.tolist()
    assert [line.get_label() for line in axes.lines] == [f"$l = {i + 1}$" for i in largest]
    for line, i in zip(axes.lines, largest, strict=True):
        np.testing.assert_allclose(data(line), [[T0, T0 - 1.0, T0 - 5.0], shares[:, i]], rtol=1e-12, atol=1e-15)
    assert axes.get_ylim()[0] == 0.0


def test_circles_of_latitude_and_meridians_of_a_map():
    fluid = co.systems.sphere_euler(5)
    W = fluid.random(1, degrees=(1, 2))
    axes = axes_of(made(np.stack([W, W]), fluid), "vorticity", projection="outside", centre=(30.0, 0.0))
    edge, *lines = axes.lines
    np.testing.assert_allclose(np.hypot(*edge.get_data()), 1.0, atol=1e-12)
    for line, latitude in zip(lines[:5], (-60, -30, 0, 30, 60), strict=True):
        x, y = data(line)
        np.testing.assert_allclose(y[np.isfinite(y)], np.sin(np.radians(latitude)), atol=1e-12)
        assert np.nanmax(np.abs(x)) == pytest.approx(np.cos(np.radians(latitude)), rel=1e-3)
    for line, longitude in zip(lines[5:], (-180, -120, -60, 0, 60, 120), strict=True):
        x, y = data(line)
        known = np.isfinite(x)
        away = np.radians(longitude - 30.0)
        assert known.any() == bool(np.cos(away) > 1e-9) or abs(np.cos(away)) < 1e-9
        np.testing.assert_allclose(x[known], np.sin(away) * np.sqrt(1.0 - y[known] ** 2), atol=1e-7)
    wide = axes_of(made(np.stack([W, W]), fluid), "vorticity").lines[0]
    np.testing.assert_allclose(np.max(wide.get_data(), axis=1), [PROJECTIONS["mollweide"].half_width, 1.0])


def test_spins_from_the_side_are_named_and_none_is_cut_off():
    lattice = co.systems.spin_lattice("square", (2, 5))
    S = np.random.default_rng(5).normal(size=(4, 2, 30))
    axes = axes_of(made(S, lattice), "spins", [1], at=1.0, seen="side")
    arrows, dots = axes.collections
    np.testing.assert_array_equal(dots.get_array(), arrows.get_array())
    own = S[3, 1].reshape(-1, 3)
    own = own / np.linalg.norm(own, axis=1).max()
    np.testing.assert_allclose(np.stack([arrows.U, arrows.get_array(), arrows.V], axis=-1), own)
    assert axes.get_title() == f"spins of member 1 at $t$ = {T0 + 0.03:g}: arrows $(S_1, S_3)$"
    assert axes.child_axes[-1].get_ylabel() == "$S_2$ over the largest $|S|$" and arrows.get_clim() == (-1.0, 1.0)
    assert axes.get_xlim() == (-0.8, 1.8) and axes.get_ylim() == (-0.8, 4.8)
    np.testing.assert_array_equal(dots.get_offsets(), arrows.XY)


# Curves between saved points


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


def test_complex_matrices_are_refined_entry_by_entry():
    fluid = co.systems.torus_euler(5)
    W = np.stack([3.0 * fluid.random(seed, degrees=(1, 2)) for seed in (1, 2)])
    run = co.integrate(fluid, W, (T0, T0 + 8.0), 0.1, co.IsospectralGauss(), save_every=16)
    filled = PlottedRun(run, [1]).refined
    assert len(filled.t) > 2 * len(run.t)
    states = np.ascontiguousarray(run.at(filled.t).x[:, 1]).reshape(len(filled.t), -1)
    np.testing.assert_array_equal(filled.x[0], states.view(np.float64))
    axes = axes_of(run, "components", [1], chosen=[3])
    np.testing.assert_array_equal(data(axes.lines[0]), [filled.t, states.view(np.float64)[:, 3]])


@pytest.mark.parametrize("sense", SENSES)
def test_the_fastest_attitude_of_a_batch_decides(sense):
    """Bodies that spin about an axis have momenta at rest; the second one turns five times as fast."""
    systems = [co.systems.rigid_body((1.0, 2.0, 3.0)), co.systems.rigid_body((0.5, 0.5, 0.6))]
    span = (T0, T0 + 10.0 * sense)
    run = co.integrate(co.batch(systems), [(0.0, 0.0, 3.0)] * 2, span, 0.1, save_every=10, attitude=True)
    filled = PlottedRun(run).refined
    first = filled.rotation[1][:, :, 0]
    turned = np.arccos(np.clip(np.sum(first[1:] * first[:-1], axis=1), -1.0, 1.0))
    assert 0.9 * 0.14 < turned.max() <= 0.14 * (1.0 + 1e-9)
    chosen = PlottedRun(run, [1]).refined
    np.testing.assert_array_equal(chosen.rotation[0][np.isin(chosen.t, run.t)], run.attitude[:, 1, :3, :3])


# Figures


@pytest.mark.long
def test_a_kind_by_name_is_the_picture_that_the_system_declares():
    run = co.integrate(BODY, (0.1, 1.0, 0.2), (T0, T0 + 2.0), 0.1, attitude=True)
    assert run.plot("body axis").axes[0].get_title() == "body axis 2 in space"
    assert run.plot([Picture("body axis")]).axes[0].get_title() == "body axis 3 in space"
    triad = co.systems.fluid_triad()
    moved = co.integrate(triad, (0.4, 0.9, -0.3), (T0, T0 + 1.0), 0.125)
    frames = frames_of(moved, "field", frames=3, size=(96, 64))
    assert (frames.count, frames.size) == (3, (96, 64))
    shapes = [np.asarray(frame).shape for frame in frames]
    assert shapes == [(64, 96, 4)] * 3


def test_one_axes_for_a_kind_that_is_declared_twice_has_the_first_picture():
    lattice = co.systems.spin_lattice("square", (3, 2))
    run = co.integrate(lattice, np.random.default_rng(4).normal(size=18), (T0, T0 + 1.0), 0.1)
    both = [axes.get_title() for axes in run.plot("spins").axes if axes.get_title()]
    axes, last = Figure().subplots(1, 2)
    run.plot(["spins", "drift"], axes=[axes, last])
    assert len(both) == 2 and axes.get_title() == both[0] != both[1]


def test_components_asked_for_are_those_of_the_figure():
    run = co.integrate(BODY, [(0.1, 1.0, 0.2), (1.0, 0.2, 0.3)], (T0, T0 + 0.5), 0.01)
    axes = Figure().subplots(1, 2)
    run.plot(["drift", "components"], components=["x3", 0], axes=axes)
    several = [line for line in axes[1].lines if len(line.get_xdata()) == len(run.t)]
    for line, (m, i) in zip(several, ((0, 2), (1, 2), (0, 0), (1, 0)), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), run.x[:, m, i])
    with pytest.raises(ValueError, match="components is empty"):
        run.plot(components=[])
    many = made(np.ones((3, 25, 3)))
    with pytest.raises(ValueError, match="give from 1 to 20 different"):
        PlottedRun(many, list(range(21)))
    assert PlottedRun(many, list(range(20))).x.shape == (20, 3, 3)


def test_members_have_the_colours_of_their_energies_at_the_start():
    """Also if forces change their order; the bar runs from the lowest energy to the highest one."""
    energy = np.array([[1.0, 5.0, 3.0], [5.0, 3.0, 0.5], [4.0, 0.25, 8.0]])
    run = made(np.random.default_rng(2).normal(size=(3, 3, 3)), energy=energy)
    axes = axes_of(run, "components", chosen=[1])
    wanted = colormaps["viridis"](LIGHTEST * (energy[0] - 1.0) / 4.0)
    for m, line in enumerate(axes.lines[:3]):
        np.testing.assert_array_equal(data(line), [run.t, run.x[:, m, 1]])
        # Of 256 colours the nearest one.
        np.testing.assert_allclose(line.get_color(), wanted[m], rtol=0, atol=4 / 256)
    (bar,) = axes.child_axes
    assert bar.get_ylim() == (1.0, 5.0) and bar.get_ylabel() == "energy $H$ at the start"
    # The first saved point of chosen times is not the start.
    damped = BODY.with_forces(co.forces.LinearDamping((0.0, 0.5, 2.0)))
    states = np.array([(0.2, 2.0, 0.1), (1.6, 0.1, 0.2), (0.1, 0.3, 2.5)])
    late = co.integrate(damped, states, (0, 2), 0.1, t_eval=[1.0, 1.5, 2.0])
    (bar,) = axes_of(late, "components", [2, 0], chosen=[1]).child_axes
    np.testing.assert_allclose(bar.get_ylim(), sorted(damped.system.energy(states[m]) for m in (2, 0)), rtol=1e-14)


def test_crossings_are_drawn_for_the_coordinates_that_vary_most():
    rng = np.random.default_rng(6)
    top = co.systems.heavy_top()
    x = rng.normal(size=(30, 6)) * [0.1, 2.0, 0.2, 0.0, 3.0, 0.3] + [0.0, 0.0, 50.0, 9.0, 0.0, 0.0]
    events = SectionOf(x, rng.integers(0, 11, 30), top)
    figure = draw_crossings(events)
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == (r"$m_{2}$", r"$\gamma_{2}$")
    shades = colormaps["viridis"]
    for line, m in zip(axes.lines, np.unique(events.member), strict=True):
        own = events.member == m
        np.testing.assert_array_equal(data(line), x[own][:, [1, 4]].T)
        assert line.get_color() == shades(m / 10.0)
    assert sum(len(line.get_xdata()) for line in axes.lines) == 30
    assert axes.get_title() == "30 crossings of up, down"


class SectionOf:
    """Crossings as data."""

    def __init__(self, x: np.ndarray, member: np.ndarray, system: Any) -> None:
        self.x, self.member, self.names = x, member, ("up", "down")
        self.coordinates = PlottedRun(made(np.ones((3, 6)), system)).names

    def __len__(self) -> int:
        return len(self.x)


def test_what_the_page_says_of_a_run():
    run = co.integrate(BODY, (0.1, 1.0, 0.2), (T0, T0 - 2.0), 0.1)
    text = _describe(run)
    assert text.startswith("rigid_body(inertia=(1.0, 2.0, 3.0)), ") and "step 0.1, t from 7.3 to 5.3;" in text
    assert f"stays within {run.drift()['energy']:.1e} of its size {abs(run.energy[0]):.1e}" in text


def test_the_page_has_the_size_of_negative_energies():
    run = co.integrate(SPIN, (1.0, 0.0, -0.5), (T0, T0 + 1.0), 0.1)
    assert "of its size 5.0e-01" in _describe(run)


def test_modified_energies_of_long_runs_are_thinned_in_step():
    run = co.integrate(BODY, (0.1, 1.0, 0.2), (T0, T0 - 1100.0), 0.1)
    (axes,) = draw_modified_energy(run, (4,)).axes
    for line, series in zip(axes.lines, (run.energy, run.modified_energy(4)), strict=True):
        own = np.abs(series - series[0])
        np.testing.assert_array_equal(data(line), [run.t[::3], np.where(own > 0.0, own, np.nan)[::3]])
    assert to_hex(axes.lines[0].get_color()) != to_hex(axes.lines[1].get_color()) != INK
