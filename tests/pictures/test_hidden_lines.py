"""Lines in space that are faint behind a surface: the direction of view, and the parts that are drawn."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3D
from mpl_toolkits.mplot3d.proj3d import proj_transform

from coadjoint.pictures.hidden_lines import FAR_ALPHA, FadingLine, towards_viewer


def space(elevation, around):
    """Return orthographic axes with unequal limits and sides."""
    axes = Figure().add_subplot(projection="3d")
    axes.set_proj_type("ortho")
    axes.view_init(elevation, around)
    axes.set(xlim=(-1.0, 3.0), ylim=(0.0, 1.5), zlim=(5.0, 6.0))
    axes.set_box_aspect((2.0, 1.0, 3.0))
    return axes


@pytest.mark.parametrize("elevation, around", [(20.0, 35.0), (-50.0, 200.0), (0.0, -90.0)])
def test_points_along_the_line_of_sight_are_drawn_at_one_place(elevation, around):
    axes = space(elevation, around)
    towards, start = towards_viewer(axes), np.array([0.7, 0.4, 5.3])
    places = np.array([proj_transform(*(start + s * towards), axes.get_proj()) for s in (0.0, 0.1, 0.7)])
    np.testing.assert_allclose(places[1:, :2], [places[0, :2]] * 2, rtol=0, atol=1e-12)
    assert places[0, 2] > places[1, 2] > places[2, 2], "towards the viewer the depth decreases"


@pytest.mark.parametrize("joined", [True, False])
@pytest.mark.parametrize("alpha", [None, 0.5])
def test_hidden_points_are_faint_and_gaps_between_the_parts_are_closed(joined, alpha, monkeypatch):
    points = np.random.default_rng(1).normal(size=(8, 3))
    hidden = np.array([False, False, True, True, True, False, False, True])
    seen = []

    def recorded(self, renderer):
        seen.append((np.array(self.get_data_3d()).T, self.get_alpha(), self.get_markerfacecolor()))

    monkeypatch.setattr(Line3D, "draw", recorded)
    axes = space(20.0, 35.0)
    style = {} if joined else {"linestyle": "none", "marker": "o"}
    line = FadingLine(points, lambda points, towards: hidden[: len(points)], alpha=alpha, color="red", **style)
    axes.add_line(line)
    line.draw(RendererAgg(10, 10, 72))
    assert [opacity for _, opacity, _ in seen] == [FAR_ALPHA * (alpha or 1.0), alpha or 1.0]
    for (drawn, _, _), part in zip(seen, (hidden, ~hidden), strict=True):
        # A part of a line begins at the last point of the other one.
        shown = part | np.append(part[1:], False) if joined else part
        np.testing.assert_array_equal(drawn, np.where(shown[:, None], points, np.nan))
    np.testing.assert_array_equal(np.array(line.get_data_3d()).T, points)
    assert line.get_alpha() == alpha


@pytest.mark.parametrize("behind", [True, False])
def test_a_hidden_mark_is_hollow_and_not_faint(behind, monkeypatch):
    seen = []
    monkeypatch.setattr(Line3D, "draw", lambda self, _: seen.append((self.get_alpha(), self.get_markerfacecolor())))
    axes = space(20.0, 35.0)
    mark = FadingLine(np.ones((1, 3)), lambda points, _: np.array([behind]), marker="o", linestyle="none", color="red")
    axes.add_line(mark)
    mark.draw(RendererAgg(10, 10, 72))
    ((alpha, face),) = seen
    assert alpha == 1.0 and (face == "red") == (not behind) and mark.get_markerfacecolor() == "red"
