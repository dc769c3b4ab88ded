"""Every ready-made system has an example run, whose plots show it."""

import html
import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.gallery import gallery
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow, kind, kinds, read_picture
from coadjoint.runs.example_run import run_example
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.registry import gallery_entry_of, gallery_systems
from group_elements import random_element
from long import long_where


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


@pytest.mark.thinned(9)
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


def test_every_ready_made_system_says_what_is_seen_first():
    assert set(co.systems.names()) == set(gallery_systems())
    shown = {picture.kind for name in co.systems.names() for picture in gallery_entry_of(name).pictures}
    assert shown <= set(kinds())


# Functions take seconds to compile, and many spins a second to draw.
SLOW = {"double_spherical_pendulum", "sphere_euler", "satellite", "separable_cosh", "sklyanin", "spin_lattice"}


@pytest.mark.thinned(12)
@pytest.mark.parametrize("name", long_where(SLOW, co.systems.names()))
def test_the_telling_run_is_true_and_can_be_shown(name):
    run, told = run_example(name), gallery_entry_of(name)
    size = np.abs(run.energy).max() + np.ptp(run.energy)
    if not getattr(run.system.hamiltonian, "timed", False):
        assert run.drift()["energy"] <= 1e-5 * size
    assert np.ptp(run.x, axis=0).max() > 0.1 * np.abs(run.x).max(), "nothing moves"
    drawn = PlottedRun(run)
    assert drawn.dense, "the points lie too far apart"
    for picture in (told.components, *told.pictures):
        found, read = read_picture(picture)
        found.prepare(drawn, **read.options)
    assert told.caption.endswith(".") and len(told.caption) > 60


# One system at least for each kind of picture that systems declare
@pytest.mark.long
@pytest.mark.parametrize(
    "name",
    long_where(
        {"lagrange_top", "maxwell_bloch", "so_n_body"},
        ["rigid_body", "lagrange_top", "kirchhoff_body", "maxwell_bloch", "toda_ring", "so_n_body", "fluid_triad"],
    ),
)
def test_nothing_reaches_out_of_the_picture(name):
    figure = run_example(name).plot()
    panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    assert len(panels) == 2 + len(gallery_entry_of(name).pictures)
    assert inside(figure) == []
    for axes in panels:
        assert axes.get_title()
        if axes.name == "rectilinear" and axes.axison:
            assert axes.get_ylabel()
        if axes.name == "rectilinear" and not axes.axison:
            assert axes.get_aspect() == 1.0, "spheres are round"


def test_the_page_shows_every_picture_and_says_it_in_words():
    drawn, said = {}, []
    names = ("lagrange_top", "riccati")
    page = gallery(names, lambda figure, file: drawn.update({file: figure}), said.append)
    assert list(drawn) == ["lagrange_top.png", "riccati.png"]
    assert said == ["1 of 2: lagrange_top", "2 of 2: riccati"]
    pictures = re.findall(r'<img src="([^"]+)" alt="([^"]+)">', page)
    assert [file for file, _ in pictures] == list(drawn)
    assert [html.unescape(text) for _, text in pictures] == [gallery_entry_of(name).caption for name in names]
    assert "http" not in page and "<script" not in page and 'lang="en"' in page


def test_pictures_that_need_an_attitude_are_left_out_without_one():
    top = co.systems.lagrange_top()
    x0, span = gallery_entry_of("lagrange_top").start(), (0.0, 4.0)
    bare = co.integrate(top, x0, span, 0.05)
    assert [axes.get_xlabel() for axes in bare.plot().axes] == ["", "time $t$"]
    with pytest.raises(CannotShow, match="attitude=True"):
        bare.plot("nutation")
    carried = co.integrate(top, x0, span, 0.05, attitude="coadjoint")
    with pytest.raises(CannotShow, match="attitude=True"):
        carried.plot("body axis")


def test_a_run_read_back_shows_what_its_system_declares():
    from coadjoint.files.datasets.export import dataset_of, solution_inputs

    top = co.systems.lagrange_top(lever=0.5)
    run = co.integrate(top, gallery_entry_of("lagrange_top").start(), (0.0, 4.0), 0.05, attitude=True)
    again = co.integrate(**solution_inputs(dataset_of(run)))
    assert [axes.get_title() for axes in again.plot().axes] == [axes.get_title() for axes in run.plot().axes]


def test_systems_of_another_dimension_fall_back():
    body = co.systems.so_n_body((1.0, 2.0, 3.0, 4.0, 5.0))
    figure = co.integrate(body, np.linspace(-1.0, 1.0, 10), (0.0, 1.0), 0.05).plot()
    assert len(figure.axes) == 2
    assert "8 of 10" in figure.axes[1].get_title()
    flat = co.integrate(co.systems.so_n_body((1.0, 2.0, 3.0)), (0.1, 1.0, 0.2), (0.0, 5.0), 0.05).plot()
    assert [axes.name for axes in flat.axes] == ["rectilinear", "rectilinear", "3d"]


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
    x0 = 0.2 + 0.1 * np.cos(np.arange(system.dim))
    figure = co.integrate(system, x0, (0.0, -0.5), 0.1).plot()
    assert len(figure.axes) >= 2 and len(figure.axes[1].lines) > 0
    if system.dim > 3:  # surfaces take time
        ensemble = co.integrate(system, np.stack([x0, 1.1 * x0]), (0.0, 0.5), 0.1).plot()
        assert "2 members" in ensemble.get_suptitle()


def test_lagranges_top_turns_as_its_momenta_say():
    """Azimuth' = (m.gamma - m3 cos) / (I1 sin^2), by the momenta alone; inclination from gamma3."""
    run = run_example("lagrange_top")
    (axes,) = run.plot([Picture("nutation", axis=2, up=(3, 4, 5), turns=100.0)]).axes
    azimuth, inclination = axes.lines[0].get_data()
    cosine = run.x[:, 5]
    np.testing.assert_allclose(np.cos(np.radians(inclination)), cosine, rtol=0, atol=1e-11)
    rate = (run.x[0, :3] @ run.x[0, 3:] - run.x[0, 2] * cosine) / (1.0 - cosine**2)
    h = run.step
    # Simpson's rule over pairs of steps errs by h^4 / 180 times the span and the fourth derivative, here some 3^4
    total = h / 3.0 * (rate[0] + rate[-1] + 4.0 * rate[1:-1:2].sum() + 2.0 * rate[2:-1:2].sum())
    bound = h**4 / 180.0 * 24.0 * 3.0**4 * np.abs(rate).max()
    assert len(rate) % 2 == 1 and np.radians(azimuth[-1]) == pytest.approx(total, abs=max(bound, 1e-5))


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
        with pytest.raises(ValueError, match=said):
            run.plot(wrong)
    with pytest.raises(TypeError, match="panel"):
        run.plot([3])
    with pytest.raises(ValueError, match="did you mean"):
        run.plot(components=["x9"])
    with pytest.raises(ValueError, match="from 0 to 2"):
        run.plot(components=[3])
    flat = Figure().subplots(1, 2)
    with pytest.raises(ValueError, match="2 entries, and there are 1 panels"):
        run.plot("drift", axes=flat)
    with pytest.raises(ValueError, match="3d"):
        run.plot("coadjoint orbit", axes=flat[0])
    with pytest.raises(TypeError, match="axes of Matplotlib"):
        run.plot("drift", axes=["here"])
    assert run.plot(["drift", "components"], axes=flat) is flat[0].figure
    assert [len(axes.lines) for axes in flat] == [2, 3]


def test_a_kind_and_a_telling_of_ones_own():
    from coadjoint.pictures import register

    @kind("speed over time", over_time=True)
    def speed(drawn, factor=1.0):
        def paint(axes):
            axes.plot(drawn.t, factor * np.linalg.norm(drawn.x[0], axis=1))

        return paint

    try:
        run = co.integrate(co.systems.rigid_body((1, 2, 3)), (0.1, 1.0, 0.2), (0.0, 1.0), 0.1)
        (axes,) = run.plot([Picture("speed over time", factor=2.0)]).axes
        assert axes.lines[0].get_ydata()[0] == 2.0 * np.linalg.norm(run.x[0])
        assert read_picture("speed over time")[0].prepare is speed
    finally:
        del register._KINDS["speed over time"]
    with pytest.raises(TypeError, match="picture"):
        GalleryEntry((1.0, 0.0, 0.0), (0.0, 1.0), 0.1, "It moves.", pictures=["drift"])
    with pytest.raises(ValueError, match="step"):
        GalleryEntry((1.0, 0.0, 0.0), (0.0, 1.0), -0.1, "It moves.")
