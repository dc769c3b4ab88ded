"""The figure of a run shows the run: its panels, its lines, its numbers."""

from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.kinds.coadjoint_orbit import surface_casimir
from coadjoint.pictures.solution import draw_solution
from coadjoint.pictures.style import symbol


@pytest.fixture(scope="module")
def body_run() -> co.Solution:
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    return co.integrate(body, (0.1, 1.0, 0.1), (0.0, 20.0), 0.1, co.Splitting(order=2))


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


def test_drift_lines_are_the_deviations(body_run: co.Solution) -> None:
    lines = {line.get_label(): line for line in body_run.plot().axes[0].lines}
    assert set(lines) == {"$H$", "$|x|^2$"}
    deviation = np.abs(body_run.energy - body_run.energy[0])
    shown = lines["$H$"].get_ydata()
    assert np.array_equal(shown[deviation > 0], deviation[deviation > 0])
    assert np.all(np.isnan(shown[deviation == 0]))


def test_component_lines_and_orbit_are_the_momentum(body_run: co.Solution) -> None:
    _, components, orbit = body_run.plot().axes
    for i, line in enumerate(components.lines):
        assert np.array_equal(line.get_xdata(), body_run.t)
        assert np.array_equal(line.get_ydata(), body_run.x[:, i])
    path = np.array(orbit.lines[0].get_data_3d()).T
    assert np.array_equal(path, body_run.x)


@pytest.mark.long
def test_sphere_is_drawn_whole(body_run: co.Solution) -> None:
    orbit = _three_dimensional(body_run.plot())[0]
    corners = _corners(orbit).T
    radius = np.linalg.norm(body_run.x[0])
    assert np.linalg.norm(corners, axis=0) == pytest.approx(np.full(corners.shape[1], radius), rel=0.01)
    assert np.all(np.abs([corners.min(axis=1), corners.max(axis=1)]) > 0.99 * radius)
    assert orbit.get_xlim()[1] > radius


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


def test_no_casimir_is_said() -> None:
    bare = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic([1.0, 0.5, 0.7]), casimirs={})
    orbit = _three_dimensional(co.integrate(bare, (1.0, 0.3, 0.5), (0.0, 5.0), 0.1).plot())[0]
    assert "no Casimir" in orbit.get_title()
    assert len(orbit.collections) == 0


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


def test_ensemble_draws_twenty_members_and_says_so() -> None:
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    starts = np.random.default_rng(5).normal(size=(30, 3))
    run = co.integrate(body, starts, (0.0, 2.0), 0.1)
    figure = draw_solution(run)
    assert "20 of 30 members" in figure.get_suptitle()
    drift, components, orbit = figure.axes
    assert len(components.lines) == 3 * 20
    assert len(drift.lines) == 2 * 20
    assert len(drift.get_legend().get_texts()) == 2
    assert np.array_equal(components.lines[0].get_ydata(), run.x[:, 0, 0])
    assert np.array_equal(components.lines[19].get_ydata(), run.x[:, 29, 0])
    assert len(orbit.lines) == 2 * 20


def test_fixed_point_says_that_nothing_moves() -> None:
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    drift = co.integrate(body, (0.0, 0.0, 0.0), (0.0, 1.0), 0.1).plot().axes[0]
    assert [text.get_text() for text in drift.texts] == ["no deviation in any bit"]


def test_long_runs_are_thinned_to_what_can_be_seen() -> None:
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    run = co.integrate(body, (0.1, 1.0, 0.1), (0.0, 18000.0), 0.1)
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


def test_names() -> None:
    assert str(co.GaussLegendre(stages=3)) == "GaussLegendre(stages=3)"
    assert "Splitting(order=2)" in str(co.Composition(co.Splitting(order=2), (0.5, 0.5)))
    assert symbol("100$") == r"100\$"
    assert surface_casimir({}) is None


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("count", "members"), [(1, None), (3, None), (3, [2, 0]), (20, None), (21, None), (21, [20])])
def test_the_headline_has_the_numbers_of_members(count: int, members: Any) -> None:
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    starts = np.random.default_rng(count).normal(size=(count, 3))
    figure = co.integrate(body, starts, (0.0, 0.5), 0.125).plot(["drift"], members=members)
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
