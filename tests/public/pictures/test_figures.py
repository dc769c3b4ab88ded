"""Figures of runs: panels in the order that was asked for, within the figure, and in the style of the user."""

from __future__ import annotations

import html
import re
from typing import Any

import matplotlib
import numpy as np
import pytest
from drawn_runs import BODY, PALETTE, T0, Picture
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


@pytest.mark.thinned(2)
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


LONG_WORDS = "kinetic energy of the second body in the frame at rest, "


LONG_WORD = "kinetic_energy_of_the_second_body_in_the_frame_at_rest_"


@pytest.mark.thinned(12)
@pytest.mark.parametrize("words", [LONG_WORDS, LONG_WORD])
@pytest.mark.parametrize("length", [10, 90, 108, 200])
@pytest.mark.parametrize("width", [None, 4.0, 8.0])
@pytest.mark.parametrize("panels", [None, ["observed"], ["drift", "components", "observed"]])
def test_long_legends_are_within_the_first_drawing(words, length, width, panels):
    name = (words * 4)[:length]
    observe = {name: lambda x: x[0], f"{name}, squared": lambda x: x[0] ** 2}
    run = co.integrate(co.systems.rigid_body((1, 2, 3)), (1.0, 0.2, 0.1), (0, 5), 0.25, observe=observe, attitude=True)
    figure = run.plot(panels, width=width)
    assert inside(figure) == []
    labels = next(axes for axes in figure.axes if axes.get_title() == "observed").get_legend().get_texts()
    # Of names up to 100 characters nothing is lost, of longer ones the middle.
    for text, given in zip(labels, observe, strict=True):
        shown, wanted = "".join(text.get_text().split()), "".join(given.split())
        assert shown == wanted if len(given) <= 100 else "..." in shown and shown.endswith(wanted[-20:])
    for axes in figure.axes:
        others = [other.get_window_extent() for other in figure.axes if other is not axes]
        assert axes.get_legend() is None or axes.get_legend().get_window_extent().count_overlaps(others) == 0


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


def test_names_options_and_axes_that_are_wrong_are_refused():
    run = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.1, 1.0, 0.2), (0.0, 1.0), 0.1)
    for wrong, said in [
        (["drfit"], "did you mean 'drift'"),
        ([Picture("phase portrait", acros=1)], "did you mean 'across'"),
        ([Picture("drift", axis=1)], "takes no options"),
        ([], "empty"),
        ("path in space", "SE"),
        ("observed", "observe="),
    ]:
        with refused(ValueError, said):
            run.plot(wrong)
    with refused(TypeError, "panel"):
        run.plot([3])
    with refused(ValueError, "x9"):
        run.plot(components=["x9"])
    with refused(ValueError, "coordinate", "3"):
        run.plot(components=[3])
    flat = Figure().subplots(1, 2)
    with refused(ValueError, "axes", "2", "1"):
        run.plot("drift", axes=flat)
    with refused(ValueError, "3d"):
        run.plot("coadjoint orbit", axes=flat[0])
    with refused(TypeError, "axes", "here"):
        run.plot("drift", axes=["here"])
    assert run.plot(["drift", "components"], axes=flat) is flat[0].figure
    assert [len(axes.lines) for axes in flat] == [2, 3]


def test_entries_of_the_gallery_are_checked():
    for wrong, error in (({"pictures": ["drift"]}, TypeError), ({"step": -0.1}, ValueError)):
        arguments = {"x0": (1.0, 0.0, 0.0), "t_span": (0.0, 1.0), "step": 0.1, "caption": "It moves."} | wrong
        with refused(error, "picture" if error is TypeError else "step"):
            co.plotting.GalleryEntry(**arguments)


# Functions take seconds to compile, and many spins a second to draw.
SLOW = {"double_spherical_pendulum", "sphere_euler", "satellite", "separable_cosh", "sklyanin", "spin_lattice"}
NAMES = [pytest.param(name, marks=pytest.mark.long) if name in SLOW else name for name in co.systems.names()]


@pytest.mark.thinned(8)
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


def test_one_axes_for_a_kind_that_is_declared_twice_has_the_first_picture():
    lattice = co.systems.spin_lattice("square", (3, 2))
    run = co.integrate(lattice, np.random.default_rng(4).normal(size=18), (T0, T0 + 1.0), 0.1)
    both = [axes.get_title() for axes in run.plot("spins").axes if axes.get_title()]
    axes, last = Figure().subplots(1, 2)
    run.plot(["spins", "drift"], axes=[axes, last])
    assert len(both) == 2 and axes.get_title() == both[0] != both[1]


@pytest.fixture(scope="module")
def run():
    return co.integrate(BODY, (0.3, 1.0, 0.2), (0.0, 5.0), 0.05)


def sizes(figure):
    """Sizes of the headline, and of title, labels, ticks and legend of the components, in points."""
    axes = figure.axes[0]
    ticks = {label.get_fontsize() for axis in (axes.xaxis, axes.yaxis) for label in axis.get_ticklabels()}
    texts = {text.get_fontsize() for text in axes.get_legend().get_texts()}
    labels = {axes.xaxis.label.get_fontsize(), axes.yaxis.label.get_fontsize()}
    return figure.texts[0].get_fontsize(), axes.title.get_fontsize(), *labels, *ticks, *texts


OWN = (10.5, 9.5, 9.0, 8.0, 8.0)


@pytest.mark.parametrize(
    "style, expected",
    [
        (None, OWN),
        ({"font.size": 14.0}, (16.8, 16.8, 14.0, 14.0, 14.0)),  # "large" is 1.2 times the size
        ({"axes.titlesize": 20.0}, (10.5, 20.0, 9.0, 8.0, 8.0)),
        (["grayscale", {"legend.fontsize": 5.0}], (10.5, 9.5, 9.0, 8.0, 5.0)),
    ],
)
@pytest.mark.parametrize("how", ["style", "rcParams", "axes"])
def test_sizes_of_text_are_those_of_the_user(run, style, expected, how):
    """Given as a style, set in rcParams, or in effect where the axes of the user are drawn into."""
    from matplotlib import style as styles

    if how == "style":
        figure = run.plot(["components"], style=style)
    else:
        with styles.context(style or []):
            axes = Figure().add_subplot() if how == "axes" else None
            figure = run.plot(["components"], axes=axes)
    if how == "axes":
        figure.suptitle("", fontsize=expected[0])
    assert sizes(figure) == pytest.approx(expected)


def test_narrow_figures_have_smaller_text(run):
    assert sizes(run.plot(["components"], width=4.9)) == pytest.approx([0.84 * size for size in OWN])
    assert sizes(run.plot(["components"], width=5.1)) == pytest.approx(OWN)


def test_lines_and_colours_are_those_of_the_user(run):
    style = {
        "lines.linewidth": 3.0,
        "axes.linewidth": 2.0,
        "axes.edgecolor": "red",
        "grid.color": "green",
        "text.color": "blue",
        "axes.prop_cycle": matplotlib.cycler(color=["#111111", "#222222"]),
    }
    own, users = (run.plot(["components"], style=chosen).axes[0] for chosen in (None, style))
    assert [line.get_color() for line in own.lines[:3]] == PALETTE
    assert [line.get_color() for line in users.lines[:3]] == ["#111111", "#222222", "#111111"]
    for line, other in zip(own.lines, users.lines, strict=True):
        assert other.get_linewidth() == pytest.approx(3.0 * line.get_linewidth())
    assert own.spines["left"].get_linewidth() == 0.6 and users.spines["left"].get_linewidth() == 2.0
    np.testing.assert_allclose(users.spines["left"].get_edgecolor(), (1.0, 0.0, 0.0, 1.0))
    assert {line.get_color() for line in users.get_xgridlines()} == {"green"}
    assert users.title.get_color() == "blue" and own.title.get_color() == "#333333"


@pytest.mark.parametrize(
    "style, message",
    [
        ("grayscal", "which Matplotlib does not know; did you mean 'grayscale'"),
        (["no such"], "which Matplotlib does not know; give the name of a style"),
        (3, "which Matplotlib does not know; give the name of a style"),
        ({"font.sizes": 9.0}, "which Matplotlib refuses: .*font.sizes"),
        ({"font.size": "huge"}, "which Matplotlib refuses: .*huge"),
        (["grayscale", {"font.size": "huge"}], "which Matplotlib refuses: .*huge"),
    ],
)
def test_styles_that_do_not_exist_are_refused(run, style, message):
    before = dict(matplotlib.rcParams)
    with pytest.raises(ValueError, match=f"^style is .*{message}"):
        run.plot(["components"], style=style)
    assert dict(matplotlib.rcParams) == before


def test_settings_end_with_the_figure(run):
    before = dict(matplotlib.rcParams)
    run.plot(["components"], style={"font.size": 14.0}, width=4.0)
    with refused(ValueError, "component"):
        run.plot(["component"], style="grayscale")
    assert dict(matplotlib.rcParams) == before
