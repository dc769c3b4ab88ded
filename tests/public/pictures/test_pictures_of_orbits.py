"""Orbits on the level surfaces of Casimirs, and the surfaces themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drawn_runs import SPIN, T0, TURN, axes_of, colour, made, made_at, spinning
from mpl_toolkits.mplot3d.proj3d import proj_transform

import coadjoint as co

level_surface = co.plotting.level_surface


@pytest.mark.parametrize("members", [[1], [2, 0]])
def test_the_surface_is_that_of_the_first_member_drawn(members):
    sizes = np.array([1.0, 2.0, 3.0])
    one = spinning(TURN, T0 + TURN)
    x = sizes[:, None] * one.x[:, None]
    axes = axes_of(made(x, SPIN, one.t), "coadjoint orbit", members, view=(20.0, 70.0))
    assert (axes.azim, axes.elev) == (20.0, 70.0)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_zlabel()) == ("$x_{1}$", "$x_{2}$", "$x_{3}$")
    radius = np.linalg.norm(x[0, members[0]])
    # The sphere, seen without perspective, has the extent of points on it in the picture.
    axes.figure.draw_without_rendering()
    n = np.random.default_rng(1).normal(size=(4000, 3))
    points = radius * n / np.linalg.norm(n, axis=1)[:, None]
    wanted = np.ptp(np.array(proj_transform(*points.T, axes.get_proj()))[:2], axis=1)
    corners = np.concatenate([path.vertices for path in axes.collections[0].get_paths()])
    np.testing.assert_allclose(np.ptp(corners, axis=0), wanted, rtol=0.02)
    for place, m in enumerate(members):
        path, dot = axes.lines[2 * place : 2 * place + 2]
        np.testing.assert_array_equal(np.array(path.get_data_3d()).T, x[:, m])
        np.testing.assert_array_equal(np.ravel(dot.get_data_3d()), x[0, m])
        shade = colour(0)
        assert path.get_color() == shade and dot.get_color() == (shade if len(members) > 1 else colour(1))
    several = "orbits, and the level surface of $|x|^2$ of the first"
    assert axes.get_title().startswith(several if len(members) > 1 else "orbit on the level surface of $|x|^2$")


def test_surfaces_in_a_box_with_unequal_edges():
    box = np.array([(0.0, 1.0), (-2.0, 1.0), (1.0, 4.0)])
    triangles = level_surface(co.Polynomial({(1, 0, 0): 1.0, (0, 1, 0): 2.0}), 0.5, box, cells=6)
    points = triangles.reshape(-1, 3)
    np.testing.assert_allclose(points[:, 0] + 2.0 * points[:, 1], 0.5, rtol=0, atol=8 * 2.0**-53)
    np.testing.assert_allclose(points.min(axis=0), [0.0, -0.25, 1.0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(points.max(axis=0), [1.0, 0.25, 4.0], rtol=0, atol=1e-15)
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    assert 0.5 * np.linalg.norm(normal, axis=1).sum() == pytest.approx(3.0 * np.hypot(1.0, 0.5), rel=1e-13)


def test_the_surface_of_an_angle_goes_through_the_orbit_along_its_cut() -> None:
    """A spiral r = exp(2 angle) beside the axis of A3,7, on which the logarithm with the angle is a constant."""
    angle = np.linspace(0.5 * np.pi, 1.5 * np.pi, 400)
    radius = np.exp(2.0 * (angle - np.pi))
    x = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.1 * angle], axis=1)
    run = made_at(0.1 * np.arange(len(x)), x[:, None], co.systems.paper_a37(2.0))
    axes = axes_of(run, "coadjoint orbit", view=(-90.0, 90.0))  # along the axis
    axes.figure.draw_without_rendering()
    corners = np.concatenate([path.vertices for path in axes.collections[0].get_paths()])
    seen = np.array(proj_transform(*x.T, axes.get_proj()))[:2].T
    distances = np.linalg.norm(seen[::20, None] - corners, axis=-1).min(axis=1)
    # A cell of the surface is a 36th of the box.
    assert np.max(distances) < 1.5 / 36 * np.ptp(corners, axis=0).max()


BOX = [(-1.3, 1.2)] * 3


CELLS = 24


def _area(triangles: np.ndarray) -> float:
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(0.5 * np.linalg.norm(normal, axis=1).sum())


def test_sphere_has_its_radius_and_its_area() -> None:
    sphere = co.algebras.so(3).casimirs_known["|x|^2"]
    triangles = level_surface(sphere, 1.0, BOX, cells=CELLS)
    cell = 2.5 / CELLS
    # Linear interpolation on edges of length d is off by d^2/8 times the curvature; the longest edge is a diagonal.
    assert np.max(np.abs(np.linalg.norm(triangles, axis=2) - 1.0)) < 3 * cell**2 / 8 * 1.2
    assert _area(triangles) == pytest.approx(4 * np.pi, rel=2 * cell**2)


def test_surface_is_closed() -> None:
    sphere = co.algebras.so(3).casimirs_known["|x|^2"]
    triangles = np.round(level_surface(sphere, 1.0, BOX, cells=8), 9)
    # Divergence theorem: the vector areas of a closed surface cancel, whichever way each triangle is turned outward.
    normal = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    outward = np.sign(np.einsum("ij,ij->i", normal, triangles.mean(axis=1)))
    assert np.linalg.norm((normal * outward[:, None]).sum(axis=0)) < 1e-7 * np.abs(normal).sum()


@pytest.mark.parametrize(
    ("function", "level"),
    [
        (lambda x: math.log(x[0]), math.log(0.7)),  # a ValueError below zero
        (lambda x: 1.0 / max(0.0, float(x[0])), 1.0 / 0.7),  # a ZeroDivisionError there
        (lambda x: np.log(x[0]), math.log(0.7)),  # NaN and a warning there
    ],
)
def test_surfaces_of_functions_that_are_not_defined_everywhere_are_complete(function, level) -> None:
    box = [(-1.0, 1.4), (-0.5, 0.7), (0.0, 0.6)]
    points = level_surface(function, level, box, cells=12).reshape(-1, 3)
    # Linear interpolation over cells of 0.2: an eighth of the square times the second derivative, over the slope.
    assert np.max(np.abs(points[:, 0] - 0.7)) <= 0.2**2 / 8 * (2.0 / 0.5**3) / (1.0 / 0.9**2)
    np.testing.assert_allclose(points[:, 1:].min(axis=0), [-0.5, 0.0], rtol=0, atol=1e-15)
    np.testing.assert_allclose(points[:, 1:].max(axis=0), [0.7, 0.6], rtol=0, atol=1e-15)
