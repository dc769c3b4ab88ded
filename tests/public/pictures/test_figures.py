"""Figures of runs: panels in the order that was asked for, within the figure, and in the style of the user."""

from __future__ import annotations

import html
import re
from typing import Any

import matplotlib
import numpy as np
import pytest
from drawn_runs import BODY
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import coadjoint as co
from refusals import refused


@pytest.fixture(scope="module")
def body_run() -> co.Solution:
    return co.integrate(BODY, (0.1, 1.0, 0.1), (0.0, 20.0), 0.1, co.Splitting(order=2))


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


@pytest.mark.thinned(4)
@pytest.mark.parametrize("width", [None, 3.4])
@pytest.mark.parametrize(
    "panels",
    [
        ("components", "coadjoint orbit", "drift"),
        ("drift", "body axis", "components", "coadjoint orbit"),
        ("body axis", "coadjoint orbit", "drift", "body axis", "components"),
    ],
)
def test_panels_have_the_order_in_which_they_are_requested(panels: tuple[str, ...], width: float | None) -> None:
    run = co.integrate(BODY, (0.1, 1.0, 0.1), (0, 10), 0.1, attitude=True)
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


@pytest.mark.thinned(2)
@pytest.mark.parametrize(("count", "members"), [(1, None), (3, None), (3, [2, 0]), (20, None), (21, None), (21, [20])])
def test_the_headline_has_the_numbers_of_members(count: int, members: Any) -> None:
    starts = np.random.default_rng(count).normal(size=(count, 3))
    figure = co.integrate(BODY, starts, (0.0, 0.5), 0.125).plot(["drift"], members=members)
    shown = min(count, 20) if members is None else len(members)
    said = f"{shown} of {count} members" if shown < count else f"{count} members" if count > 1 else "step 0.125"
    assert " ".join(figure.get_suptitle().split()).split(", ")[-1] == said


def inside(figure: Figure) -> list[str]:
    """Return what reaches out of a figure as it is drawn first, and what a second drawing moves."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    first = [axes.get_window_extent().extents for axes in figure.axes]
    limits = figure.bbox.padded(1.0)
    out = []
    for axes in figure.axes:
        parts = [axes.get_legend(), axes.title, axes.xaxis.label, axes.yaxis.label]
        for part in parts:
            if part is None or (hasattr(part, "get_text") and not part.get_text()):
                continue
            box = part.get_window_extent()
            if not (limits.x0 <= box.x0 and box.x1 <= limits.x1 and limits.y0 <= box.y0 and box.y1 <= limits.y1):
                out.append(f"{axes.get_title()}: {part}")
    canvas.draw()
    for axes, before in zip(figure.axes, first, strict=True):
        if np.abs(axes.get_window_extent().extents - before).max() > 1.0:
            out.append(f"{axes.get_title()} moves")
    return out


def test_pictures_that_need_an_attitude_are_left_out_without_one():
    top = co.systems.lagrange_top()
    x0, span = (0.1, 0.0, 2.0, 0.6, 0.0, 0.8), (0.0, 4.0)
    bare = co.integrate(top, x0, span, 0.05)
    assert [axes.get_xlabel() for axes in bare.plot().axes] == ["", "time $t$"]
    with refused(co.plotting.CannotShow, "attitude=True"):
        bare.plot("nutation")
    carried = co.integrate(top, x0, span, 0.05, attitude="coadjoint")
    with refused(co.plotting.CannotShow, "attitude=True"):
        carried.plot("body axis")


@pytest.mark.thinned(6)
@pytest.mark.parametrize(
    "system",
    [
        co.systems.toda(2),
        co.systems.toda(9),
        co.systems.toda_ring(2),
        co.systems.toda_ring(5),
        co.systems.so_n_body((1.0, 2.0, 3.0)),
        co.systems.manakov_top((1.0, 2.0, 4.0, 7.0, 9.0), (1.0, 3.0, 2.0, 5.0, 1.0)),
        co.systems.spin_lattice("chain", 1),
        co.systems.spin_lattice([(0, 1), (1, 3), (2, 3)], 4),
        co.systems.spin_lattice("cubic", (2, 2, 2)),
        co.systems.vlasov_moments(6),
        co.systems.decorated_particles([1.0]),
        co.systems.decorated_particles([1.0, 2.0, 3.0]),
        pytest.param(co.systems.separable_cosh("e(3)", np.ones(6)), marks=pytest.mark.long),
    ],
    ids=lambda system: f"{system.name}-{system.dim}",
)
def test_other_sizes_than_the_gallerys_are_drawn(system):
    central = system.casimirs["z"].gradient(np.zeros(system.dim)) if "z" in system.casimirs else np.zeros(system.dim)
    x0 = np.where(central, 1.0, 0.2 + 0.1 * np.cos(np.arange(system.dim)))
    figure = co.integrate(system, x0, (0.0, -0.5), 0.1).plot()
    assert len(figure.axes) >= 2 and len(figure.axes[1].lines) > 0
    if system.dim > 3:  # surfaces take time
        ensemble = co.integrate(system, np.stack([x0, np.where(central, 1.0, 1.1 * x0)]), (0.0, 0.5), 0.1).plot()
        assert "2 members" in ensemble.get_suptitle()


# Functions take seconds to compile, and many spins a second to draw.
SLOW = {"double_spherical_pendulum", "sphere_euler", "satellite", "separable_cosh", "sklyanin", "spin_lattice"}
NAMES = [pytest.param(name, marks=pytest.mark.long) if name in SLOW else name for name in co.systems.names()]


@pytest.mark.thinned(16)
@pytest.mark.parametrize("name", NAMES)
def test_the_gallery_shows_every_system_and_says_it_in_words(name):
    """Lines, not dots; nothing reaches out of the figure; the energy is kept."""
    drawn, said = {}, []
    page = co.plotting.gallery((name,), lambda figure, file: drawn.update({file: figure}), said.append)
    assert list(drawn) == [f"{name}.png"] and said == [f"1 of 1: {name}"]
    ((file, caption),) = re.findall(r'<img src="([^"]+)" alt="([^"]+)">', page)
    assert file == f"{name}.png" and html.unescape(caption).endswith(".") and len(caption) > 60
    assert "http" not in page and "<script" not in page and 'lang="en"' in page
    drifts = re.findall(r"energy stays within ([-+.e\d]+) of its size", page)  # relative to it
    assert drifts and all(float(drift) <= 1e-5 for drift in drifts)
    (figure,) = drawn.values()
    assert inside(figure) == []
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    assert all(axes.get_title() for axes in panels) and len(panels) >= 2
    assert {line.get_linestyle() for line in panels[1].lines if len(line.get_xdata()) > 20} <= {"-", "--", ":"}
    for axes in panels:
        if axes.name == "rectilinear" and axes.axison and len(axes.get_yticks()):
            assert axes.get_ylabel()
        if axes.name == "rectilinear" and not axes.axison:
            assert axes.get_aspect() == 1.0, "spheres are round"


@pytest.fixture(scope="module")
def run():
    return co.integrate(BODY, (0.3, 1.0, 0.2), (0.0, 5.0), 0.05)


def test_settings_end_with_the_figure(run):
    before = dict(matplotlib.rcParams)
    run.plot(["components"], style={"font.size": 14.0}, width=4.0)
    with refused(ValueError, "component"):
        run.plot(["component"], style="grayscale")
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("name", ["drift", "spins"])
def test_names_of_kinds_are_taken(name: str) -> None:
    """Also before those of the library are read."""

    def mine(drawn: Any) -> Any:
        """Show nothing."""

    with refused(ValueError, name, "kind of picture", "pictures.kinds"):
        co.plotting.kind(name)(mine)
    assert co.plotting.kinds()[name].prepare is not mine
