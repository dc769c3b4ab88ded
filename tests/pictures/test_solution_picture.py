"""The figure of a run: panels, level surfaces, and the flip of the middle axis that the README shows."""

import importlib.util
import math
import re
from pathlib import Path
from typing import Any

import matplotlib
import mpmath
import numpy as np
import pytest
from drawn_runs import BODY
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.analysis.periods import period
from coadjoint.pictures.hidden_lines import hides_behind
from coadjoint.pictures.kinds.coadjoint_orbit import surface_casimir
from coadjoint.pictures.kinds.components import flip_times
from coadjoint.pictures.level_surface import level_surface
from coadjoint.pictures.style import symbol
from coadjoint.runs.example_run import run_example


@pytest.fixture(scope="module")
def body_run() -> co.Solution:
    return co.integrate(BODY, (0.1, 1.0, 0.1), (0.0, 20.0), 0.1, co.Splitting(order=2))


def _three_dimensional(figure: Figure) -> list:
    return [axes for axes in figure.axes if axes.name == "3d"]


def _corners(orbit: Any) -> np.ndarray:
    return np.asarray(orbit.collections[0]._faces).reshape(-1, 3)


def test_panels_of_a_body(body_run: co.Solution) -> None:
    figure = body_run.plot()
    assert isinstance(figure, Figure)
    drift, components, orbit = figure.axes
    assert drift.get_yscale() == "log"
    assert "drift" in drift.get_title()
    assert "deviation" in drift.get_ylabel()
    assert components.get_xlabel() == "time $t$"
    assert orbit.name == "3d"
    assert "level surface of $|x|^2$" in orbit.get_title()
    assert "rigid_body" in figure.get_suptitle()


TITLES = {"drift": "drift", "components": "components", "body axis": "in space", "coadjoint orbit": "level surface"}


@pytest.mark.parametrize("width", [None, 6.8, 3.4])
@pytest.mark.parametrize(
    "panels",
    [
        ("body axis", "drift", "components"),
        ("components", "coadjoint orbit", "drift"),
        ("drift", "body axis", "components", "coadjoint orbit"),
        ("body axis", "coadjoint orbit", "drift", "body axis", "components"),
    ],
)
def test_panels_have_the_order_in_which_they_are_requested(panels: tuple[str, ...], width: float | None) -> None:
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    run = co.integrate(body, (0.01, 1.0, 0.01), (0, 40), 0.05, attitude=True)
    figure = run.plot(list(panels), width=width)
    figure.draw_without_rendering()
    titles = [" ".join(axes.get_title().split()) for axes in figure.axes]
    assert all(TITLES[name] in title for name, title in zip(panels, titles, strict=True))
    cells = [axes.get_subplotspec().get_position(figure) for axes in figure.axes]
    timed = [name in ("drift", "components") for name in panels]
    for k in range(len(cells) - 1):
        if cells[k].x1 <= cells[k + 1].x0:
            continue
        assert cells[k + 1].y1 <= cells[k].y0 + 1e-9 and cells[k].x0 == pytest.approx(cells[k + 1].x0)
    joined = [k for k in range(len(cells) - 1) if timed[k] and timed[k + 1]]
    assert all(cells[k].x0 == pytest.approx(cells[k + 1].x0) for k in joined)
    first = timed.index(True)
    shared = [axes for axes, is_timed in zip(figure.axes, timed, strict=True) if is_timed]
    assert all(axes.get_shared_x_axes().joined(axes, figure.axes[first]) for axes in shared)


@pytest.mark.long
@pytest.mark.parametrize(
    ("system", "x0", "name"),
    [
        (co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 0.5, 0.7])), (1.0, 0.3, 0.5), "x1*x3 + x2^2"),
        (co.systems.paper_a37(), (1.0, 1.0, 1.0), "log C"),
    ],
)
def test_surfaces_that_are_not_compact(system: co.LiePoissonSystem, x0: tuple[float, ...], name: str) -> None:
    run = co.integrate(system, x0, (0.0, 10.0), 0.02)
    orbit = _three_dimensional(run.plot())[0]
    assert symbol(name) in orbit.get_title()
    corners = _corners(orbit)
    casimir = system.casimirs[name]
    period = getattr(casimir, "period", 0.0)
    values = np.array([casimir(corner) for corner in corners]) - casimir(np.array(x0))
    if period:
        values -= period * np.rint(values / period)
    near = np.linalg.norm(corners[:, :2], axis=1) > 0.3
    assert np.max(np.abs(values[near])) < 0.05
    for i, limits in enumerate((orbit.get_xlim(), orbit.get_ylim(), orbit.get_zlim())):
        assert limits[0] < run.x[:, i].min() and run.x[:, i].max() < limits[1]


def test_many_coordinates_are_thinned_and_said() -> None:
    body = co.LiePoissonSystem(co.algebras.so(5), co.Quadratic(np.arange(1.0, 11.0)))
    run = co.integrate(body, np.linspace(-1.0, 1.0, 10), (0.0, 1.0), 0.01)
    figure = run.plot()
    assert len(figure.axes) == 2
    components = figure.axes[1]
    assert len(components.lines) == 8
    assert "8 of 10" in components.get_title()
    labels = [line.get_label() for line in components.lines]
    assert labels[0] == "$x_{1}$" and labels[-1] == "$x_{10}$"
    assert np.array_equal(components.lines[-1].get_ydata(), run.x[:, 9])


def test_long_runs_are_thinned_to_what_can_be_seen() -> None:
    run = co.integrate(BODY, (0.1, 1.0, 0.1), (0.0, 18000.0), 0.1)
    _, components, orbit = run.plot().axes
    (path,) = (line for line in orbit.lines if len(line.get_data_3d()[0]) > 1)
    assert len(path.get_data_3d()[0]) <= 20_001
    # 180 001 points and more than 600 turning points of each component: three envelopes that reach as far as they do
    assert [band.get_label() for band in components.collections] == ["$x_{1}$", "$x_{2}$", "$x_{3}$"]
    for i, band in enumerate(components.collections):
        corners = band.get_paths()[0].vertices
        assert corners[:, 0].max() == run.t[-1]
        assert (corners[:, 1].min(), corners[:, 1].max()) == (run.x[:, i].min(), run.x[:, i].max())


@pytest.mark.long
def test_nothing_global_changes(body_run: co.Solution, tmp_path) -> None:
    before = dict(matplotlib.rcParams)
    body_run.plot().savefig(tmp_path / "run.png")
    assert dict(matplotlib.rcParams) == before
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("count", "members"), [(1, None), (3, None), (3, [2, 0]), (20, None), (21, None), (21, [20])])
def test_the_headline_has_the_numbers_of_members(count: int, members: Any) -> None:
    starts = np.random.default_rng(count).normal(size=(count, 3))
    figure = co.integrate(BODY, starts, (0.0, 0.5), 0.125).plot(["drift"], members=members)
    shown = min(count, 20) if members is None else len(members)
    said = f"{shown} of {count} members" if shown < count else f"{count} members" if count > 1 else "step 0.125"
    assert " ".join(figure.get_suptitle().split()).split(", ")[-1] == said


def test_the_surface_is_that_of_a_polynomial_if_there_is_one() -> None:
    def value(x: Any) -> Any:
        return x[0] * x[1]

    other = co.Invariant(value, lambda x: np.array([x[1], x[0], 0.0 * x[2]]))
    square, plane = co.Polynomial({(2, 0, 0): 1}), co.Polynomial({(0, 0, 1): 1})
    assert surface_casimir({"f": other, "x1^2": square, "x3": plane}) == "x1^2"
    assert surface_casimir({"x3": plane, "f": other, "x1^2": square}) == "x3"
    assert surface_casimir({"f": other, "g": other}) == "f"
    assert surface_casimir({}) is None
    assert symbol("100$") == r"100\$"


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


ROOT = Path(__file__).parents[2]


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
    flipped = period(body.vector_field, x0).time / wanted
    assert flipped == pytest.approx(2.0, abs=1e-9)


def test_the_picture_says_the_time_between_flips():
    run = run_example("rigid_body")
    assert run.system.parameters == {"inertia": (1.0, 2.0, 3.0)}
    _, components, orbit, axis = run.plot().axes
    (said,) = [text.get_text() for text in components.texts if text.get_text()]
    wanted = half_period((1, 2, 3), run.x[0])
    # Splitting of order 4 at the step 0.05: its phase is late by about 1e-5 of the time, measured beside 2 K / lambda
    assert said.startswith("$x_{2}$ changes sign after ")
    assert float(said.rpartition(" ")[2]) == pytest.approx(wanted, rel=1e-4)
    assert orbit.name == "3d" and axis.get_title() == "body axis 2 in space"
    start = next(line for line in axis.lines if line.get_label() == "start")
    height = float(np.ravel(start.get_ydata())[0])
    assert height > 0.9, "the axis begins near the momentum, which points up"
    # and goes down: A^T of the momentum has its middle component reversed
    assert run.x[:, 1].min() < -0.99 * np.linalg.norm(run.x[0])


def test_the_readme_shows_what_is_drawn(tmp_path):
    specification = importlib.util.spec_from_file_location("draw_flip", ROOT / "docs" / "draw_flip.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = re.findall(r"!\[[^]]*]\((docs/[^)]*)\)", readme)
    for path, expected in zip(shown, (module.MOVIE, module.PICTURE), strict=False):
        assert ROOT / path == expected and expected.stat().st_size > 20_000
    assert module.MOVIE.stat().st_size < 2_000_000
    assert [axes.get_title() for axes in module.run().plot().axes][-1] == "body axis 2 in space"


@pytest.mark.parametrize("turns", [0.0, 3.0])
@pytest.mark.parametrize("turn", [0.3, np.pi - 0.1, np.pi, -2.0])
def test_half_planes_of_an_angle_also_along_its_cut(turn: float, turns: float) -> None:
    """The level of an angle with the period 2 pi is a half plane, of which the box holds a known area."""

    def angle(x: np.ndarray) -> float:
        return float(np.arctan2(x[1], x[0]))

    direction = np.array([np.cos(turn), np.sin(turn)])
    middle = 2.0 * direction
    box = [(middle[0] - 0.5, middle[0] + 0.5), (middle[1] - 0.5, middle[1] + 0.5), (0.0, 0.7)]
    level, period = turn + 2 * np.pi * turns, 2 * np.pi
    triangles = level_surface(angle, level, box, cells=10, period=period)
    points = triangles.reshape(-1, 3)
    across = points[:, :2] @ (-direction[1], direction[0])
    # Linear interpolation: an eighth of the square of a diagonal of 0.17 times the second derivative, over the slope.
    assert np.max(np.abs(across)) < 0.17**2 / 8 / 1.3
    length = 1.0 / np.max(np.abs(direction))
    assert _area(triangles) == pytest.approx(0.7 * length, rel=0.01)
    # Seen across the half plane, points on the far side are hidden; a sample of a ray at the angle pi lies on it.
    towards = np.array([-direction[1], direction[0], 0.0])
    centre = np.append(middle, 0.35)
    hides = hides_behind(angle, level, np.array(box), period)
    start = np.array([centre - 0.2 * towards, centre + 0.2 * towards, centre - 0.3 * towards + [0.0, 0.0, 0.3]])
    assert hides(start, towards).tolist() == [True, False, True]
    assert hides(start, -towards).tolist() == [False, True, False]
    assert not hides_behind(angle, level + np.pi, np.array(box), period)(start, towards).any()
