"""Settings of figures: those of the user before those of the project, and none that stays."""

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.layout import PanelLayout
from coadjoint.pictures.style import COLOURS

BODY = co.systems.rigid_body((1, 2, 3))


@pytest.fixture(scope="module")
def run():
    return co.integrate(BODY, (0.3, 1.0, 0.2), (0.0, 5.0), 0.05)


def sizes(figure):
    """Sizes of the headline, and of title, labels, ticks and legend of the components, in points."""
    axes = figure.axes[0]
    ticks = {label.get_fontsize() for axis in (axes.xaxis, axes.yaxis) for label in axis.get_ticklabels()}
    texts = {text.get_fontsize() for text in axes.get_legend().get_texts()}
    labels = {axes.xaxis.label.get_fontsize(), axes.yaxis.label.get_fontsize()}
    return figure._suptitle.get_fontsize(), axes.title.get_fontsize(), *labels, *ticks, *texts


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
    assert [line.get_color() for line in own.lines[:3]] == list(COLOURS[:3])
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
    with pytest.raises(ValueError, match="unknown kind of picture"):
        run.plot(["component"], style="grayscale")
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("name", ["title", "xlabel", "ylabel"])
def test_titles_and_labels_are_wrapped_to_their_panels(name):
    """Anew where a figure is resized; texts that fit are not broken."""
    words = " ".join(f"word{k}" for k in range(20))
    figure = Figure(layout=PanelLayout())
    axes = figure.add_subplot()
    axes.set(**{"title": "one title", "xlabel": "one label", "ylabel": "one label", name: words})
    texts = {"title": axes.title, "xlabel": axes.xaxis.label, "ylabel": axes.yaxis.label}
    side, lines = "height" if name == "ylabel" else "width", []
    for size in ((9.0, 9.0), (5.0, 3.5), (9.0, 9.0), (20.0, 20.0)):
        figure.set_size_inches(size)
        figure.draw_without_rendering()
        length, available = (getattr(part.get_window_extent(), side) for part in (texts[name], axes))
        lines.append(texts[name].get_text().split("\n"))
        assert " ".join(lines[-1]) == words and length < 1.05 * available
        assert all(text.get_text() in ("one title", "one label") for other, text in texts.items() if other != name)
    assert lines[0] == lines[2] and len(lines[1]) > len(lines[0]) > len(lines[3]) == 1
