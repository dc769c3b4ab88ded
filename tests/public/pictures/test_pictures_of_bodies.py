"""Bodies and spheres, read back from their artists: axes in space, directions, nutations, paths and boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from drawn_runs import (
    BARE,
    SENSES,
    T0,
    TURN,
    VIEW,
    Globe,
    MemberColours,
    Picture,
    axes_of,
    data,
    made,
    rotations,
    shown,
)
from test_pictures_over_time import bodies, curves

import coadjoint as co
from group_elements import random_element
from long import long_beyond
from refusals import refused


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
    globe, shades = Globe(view), MemberColours(run)
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


@pytest.mark.thinned(1)
@pytest.mark.parametrize("around", [-170.0, -80.0, 10.0, 100.0])
def test_a_path_on_one_side_of_a_sphere_is_seen_from_there(around):
    angles = np.radians(around + np.array([-30.0, -10.0, 10.0, 30.0]))
    points = np.stack([np.cos(angles), np.sin(angles), 0.2 + 0 * angles], axis=-1)
    axes = axes_of(made(points * 2.0), "directions", vectors={"v": (0, 1, 2)})
    globe = Globe((around + 25.0, VIEW[1]))  # beside the middle, where the label of an axis may stand
    dot = next(line for line in axes.lines if line.get_label() == "start")
    np.testing.assert_allclose(data(dot)[:, 0], globe.project(points[0] / np.linalg.norm(points[0]))[0], atol=1e-12)


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
    assert given.tolist() == [0.0, 3.0, 4.0] and axes.get_title() == "nutation of the axis of the body (dot: start)"
    for wrong in ((0.0, 0.0, 0.0), (1.0, 2.0)):
        with refused(ValueError, "axis"):
            axes_of(run, "nutation", axis=wrong)


@pytest.mark.parametrize("sense", SENSES)
def test_an_axis_that_goes_round_a_cone_has_its_azimuth_and_its_tilt(sense):
    tilted = rotations((0, 0, 1), 0.4 + sense * TURN) @ rotations((1, 0, 0), np.array([0.5]))
    run = made(np.ones((len(TURN), 3)), BARE, attitude=tilted, carried="representation")
    found = data(axes_of(run, "nutation", turns=2.0).lines[0])
    np.testing.assert_allclose(found, np.degrees([sense * TURN, 0.5 + 0.0 * TURN]), rtol=0, atol=1e-10)


def test_the_path_in_space_is_the_integral_of_the_velocity():
    body = co.systems.kirchhoff_body()
    run = co.integrate(body, (0.5, 1.5, 1.0, 0.8, 0.1, 0.1), (0.0, 4.0), 0.01, co.Splitting(order=4), attitude=True)
    axes = shown(run, Picture("path in space", axis=1))
    path = np.array(axes.lines[0].get_data_3d()).T
    v = run.x[:, 3:] / np.array(body.parameters["mass"])
    speed = np.einsum("kij,kj->ki", run.attitude[:, :3, :3], v)
    # Simpson's rule: h^4 / 180 times the span and a fourth derivative, here below 100
    end = 0.01 / 3.0 * (speed[0] + speed[-1] + 4.0 * speed[1:-1:2].sum(axis=0) + 2.0 * speed[2:-1:2].sum(axis=0))
    np.testing.assert_allclose(path[-1] - path[0], end, atol=0.01**4 / 180.0 * 4.0 * 100.0 + 1e-8)
    np.testing.assert_array_equal(path, run.attitude[:, :3, 3])
    strokes = np.array(axes.lines[1].get_data_3d()).T.reshape(-1, 3, 3)
    along = strokes[:, 1] - strokes[:, 0]
    np.testing.assert_allclose(along[0] / np.linalg.norm(along[0]), run.attitude[0, :3, 1], atol=1e-12)


def test_ellipses_have_the_moments():
    beam = co.systems.vlasov_moments(2, "1/2*x20 + 0.1*x20^2")
    run = co.integrate(beam, (1.0, 0.3, 0.5), (0.0, 3.0), 0.05)
    axes = shown(run, Picture("phase ellipse", moments=("x20", "x11", "x02"), times=4, until=0.5))
    curves = [np.array(line.get_data()).T for line in axes.lines[1:]]
    assert len(curves) == 4
    for curve, k in zip(curves, (0, 10, 20, 30), strict=True):
        qq, qp, pp = run.x[k]
        level = np.einsum("ki,ij,kj->k", curve, np.linalg.inv([[qq, qp], [qp, pp]]), curve)
        np.testing.assert_allclose(level, 1.0, rtol=1e-12)
    with refused(TypeError, "moments"):
        shown(run, Picture("phase ellipse"))
    with refused(co.plotting.CannotShow, "3"):
        shown(run, Picture("phase ellipse", moments=(0, 1, 7)))


def test_lumps_are_drawn_where_they_are():
    lumps = co.systems.decorated_particles(weights=(1.0, 2.0), pair=(0.0,))
    x0 = (-1.0, 0.5, 0.4, 1.0, 1.0, 0.02, 0.0, 0.04, 0.06, 0.0, 0.02)
    run = co.integrate(lumps, x0, (0.0, 2.0), 0.05)
    axes = run.plot().axes[2]
    # a thin line of the centre and 7 ellipses for each of both
    assert len(axes.lines) == 2 * 8
    centre, first = axes.lines[8], np.array(axes.lines[9].get_data())
    np.testing.assert_allclose(centre.get_data(), [run.x[:, 1], run.x[:, 3] / 2.0])
    np.testing.assert_allclose(first[:, :-1].mean(axis=1), [0.5, 0.5], atol=1e-14)
    assert np.ptp(first[0]) == pytest.approx(2.0 * np.sqrt(0.06 / 2.0), rel=1e-12)


@pytest.mark.parametrize("sign", [1, -1])
def test_an_axis_in_space_is_seen_with_its_constant_vector_upward(sign):
    inertia = np.array([[2.0, 0.3, 0.1], [0.3, 3.0, -0.2], [0.1, -0.2, 4.0]])
    M = np.linalg.inv(inertia)
    body = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0.5 * (M + M.T)), sign=sign)
    first = random_element(body.representation, 2)
    run = co.integrate(body, (0.3, -1.0, 0.4), (0.0, 9.0), 0.1, attitude=first)
    picture = Picture("body axis", axis=run.x[0] / np.linalg.norm(run.x[0]), up=(0, 1, 2))
    (axes,) = run.plot([picture]).axes
    start = next(line for line in axes.lines if line.get_label() == "start")
    # the momentum itself, drawn as an axis of the body, starts at the pole, which appears at (0, cos of the view)
    np.testing.assert_allclose(np.ravel(start.get_data()), [0.0, np.cos(np.radians(22.0))], atol=1e-9)


X = np.array([0.0, 0.2, 3.0, 0.5, 0.0, 0.75**0.5])


def drawn_polygons(run: Any, **options: Any) -> list[np.ndarray]:
    """The corners of each polygon from above, in the first two axes of space, the near ones last."""
    (shapes,) = shown(run, Picture("bodies", view=(-90.0, 90.0), **options)).collections
    return [path.vertices[:-1] for path in shapes.get_paths()]


def test_molecules_are_discs_in_the_box():
    """Of the diameters of their sites, near ones in front; sites without one are smaller. The second one, across the
    border, stays whole.
    """
    water = co.systems.rigid_molecules(box=1.5, cutoff=0.5)
    run = made(np.stack([water.state([[0.7, 1.6, 0.2], [-1.49, 0.4, 0.9]])] * 2), water)
    sites = water.sites(run.x[0]) - np.repeat([[0.0, 1.5, 0.0], [-1.5, 0.0, 0.0]], 3, axis=0)
    order = np.argsort(sites[:, 2], kind="stable")
    discs = drawn_polygons(run)
    np.testing.assert_allclose([disc.mean(axis=0) for disc in discs], sites[order, :2], atol=1e-12)
    radii = [np.linalg.norm(disc - disc.mean(axis=0), axis=1).max() for disc in discs]
    np.testing.assert_allclose(radii, 0.315061 * np.where(order % 3 == 0, 0.3, 0.18), rtol=1e-12)


def test_bodies_are_boxes_of_their_moments():
    """Half sides 1, 2 and 3; a rod is a thin one, and a point is small."""
    a, m = np.array([1.0, 2.0, 3.0]), 1.5
    several = co.systems.bodies([m / 3 * (a @ a - a**2), (2.0, 2.0, 0.0), (0, 0, 0)], [m, 1.0, 1.0])
    run = made(np.stack([several.state([[5.0, 0, 0], [0, 9.0, 3.0], [0, 0, 4.0]])] * 2), several)
    box, rod, point = (faces for faces in np.split(np.array(drawn_polygons(run)), 3))
    assert np.abs(box - [5.0, 0.0]).max(axis=(0, 1)) == pytest.approx([1.0, 2.0])
    assert np.abs(rod - [0.0, 9.0]).max(axis=(0, 1)) == pytest.approx([0.1 * 6**0.5] * 2)
    assert 0.0 < np.abs(point).max() < 0.1
    with refused(co.plotting.CannotShow, "rigid_body", "positions"):
        shown(co.integrate(co.systems.rigid_body(), (0.1, 1.0, 0.2), (0.0, 1.0), 0.1), "bodies")


def arrows_of(axes: Any) -> dict[str, np.ndarray]:
    """Return where the arrows of a sphere point in its picture, relative to its radius, by their labels."""
    pairs = zip(axes.texts[::2], axes.texts[1::2], strict=True)
    return {name: np.array(arrow.xy) / 1.22 for arrow, text in pairs for name in text.get_text().split("\n")}


def run_in_space(name: str, members: int | None) -> co.Solution:
    """Run a ready-made body from starts that are turned, with its attitude."""
    system, rng = co.systems.get(name), np.random.default_rng(2)
    x0 = rng.normal(size=(members or 1, system.dim))
    if hasattr(system, "state"):
        turned = random_element(co.algebras.so(3).representation, 3, members or 1)
        x0 = np.stack([system.state(A, (0.2, -1.0, 0.4)) for A in turned])
    carried = not getattr(system, "has_attitude", False)
    return co.integrate(system, x0 if members else x0[0], (T0, T0 + 1.0), 0.1, co.Splitting(2), attitude=carried)


@pytest.mark.parametrize("members", long_beyond(1, [3, None]))
def test_labels_of_space_are_where_its_axes_point(members):
    """The picture of an axis of any ready-made body is the sum of its components times the arrows of X, Y and Z."""
    found = []
    bodies = [name for name in co.systems.names() if hasattr(co.systems.get(name), "angular_velocity")]
    for name in bodies:
        if name == "satellite" or hasattr(co.systems.get(name), "positions"):  # they draw other pictures
            continue
        run = run_in_space(name, members)
        pictures = [axes for axes in run.plot().axes if axes.get_title().endswith("body axis in space")]
        declared = bool(pictures)
        for axes in pictures or [axes_of(run, "body axis")]:
            arrows, number = arrows_of(axes), ["first", "second", "third"].index(axes.get_title().split()[0])
            if "$X$" not in arrows:  # members whose vertical is upward are turned by different rotations
                assert members and declared and len(arrows) == 1
                np.testing.assert_allclose(next(iter(arrows.values())), [0.0, np.cos(np.radians(22.0))], atol=1e-12)
                continue
            ends = run.rotation.as_matrix()[-(members or 1) :, :, number]
            space = np.stack([arrows[axis] for axis in ("$X$", "$Y$", "$Z$")])
            marks = [line for line in axes.lines if line.get_marker() == "s"]
            for mark, end in zip(marks, ends, strict=True):
                np.testing.assert_allclose(np.ravel(mark.get_data()), end @ space, rtol=0, atol=1e-4)
            found.append(name)
    assert len(found) > 3 and {"body", "satellite_on_orbit"} <= set(found)
