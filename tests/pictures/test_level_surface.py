"""Triangles of level surfaces lie on them, and miss nothing."""

import math

import numpy as np
import pytest

import coadjoint as co
from coadjoint.pictures.level_surface import level_surface

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


def test_plane_is_exact() -> None:
    triangles = level_surface(co.Polynomial({(0, 0, 1): 2.0}), 0.5, BOX, cells=5)
    assert np.max(np.abs(triangles[:, :, 2] - 0.25)) <= 4 * 2.0**-53
    assert _area(triangles) == pytest.approx(2.5**2, rel=1e-13)


@pytest.mark.long
def test_multivalued_casimir_is_followed_across_its_cut() -> None:
    a = 0.2
    casimir = co.algebras.A3_7(a).casimirs_known["log C"]
    triangles = level_surface(casimir, 0.0, [(-3.0, 3.0), (-3.0, 3.0), (0.0, 1.0)], cells=40, period=casimir.period)
    points = triangles.reshape(-1, 3)
    angle = np.arctan2(points[:, 1], points[:, 0])
    # r = exp(a theta) on every turn: log r - a theta is a multiple of 2 pi a.
    turns = (0.5 * np.log(points[:, 0] ** 2 + points[:, 1] ** 2) - a * angle) / (2 * np.pi * a)
    far = np.hypot(points[:, 0], points[:, 1]) > 0.8
    assert np.max(np.abs(turns - np.rint(turns))[far]) < 0.02
    # Both sides of the cut of the arctangent, theta = pi, on the turn through r = exp(a pi).
    for side in (-1.0, 1.0):
        near = (
            (np.abs(points[:, 0] + np.exp(a * np.pi)) < 0.2) & (side * points[:, 1] > 0) & (np.abs(points[:, 1]) < 0.3)
        )
        assert np.any(near)


def test_level_that_is_not_met_gives_nothing() -> None:
    assert level_surface(co.algebras.so(3).casimirs_known["|x|^2"], 100.0, BOX, cells=5).shape == (0, 3, 3)


def test_wrong_box_is_refused() -> None:
    with pytest.raises(ValueError, match="three pairs"):
        level_surface(lambda x: x[0], 0.0, [(0.0, 0.0)] * 3)


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
