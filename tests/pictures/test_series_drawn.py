"""A series is drawn as what is known of it: a line, dots, or an envelope."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.kinds.components import flip_times
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.series import draw_series, envelope, turning_points
from coadjoint.runs.solution import Solution
from coadjoint.systems.gallery_entry import Picture

BODY = co.systems.rigid_body(inertia=(1, 2, 3))


def not_to_be_had(self, t):
    raise ValueError("there are no states between the saved points")


def drawn_with(t, values, joined):
    axes = Figure().add_subplot()
    draw_series(axes, t, values, joined, color="C0", linewidth=1.0)
    return axes


def test_a_smooth_series_is_one_line():
    t = np.linspace(0.0, 10.0, 101)
    (line,) = drawn_with(t, np.sin(t), True).lines
    assert line.get_linestyle() == "-" and len(line.get_xdata()) == 101


def test_points_far_apart_are_dots():
    t = np.linspace(0.0, 10.0, 11)
    (line,) = drawn_with(t, np.sin(t), False).lines
    assert line.get_linestyle() == "None" and line.get_marker() == "o"


def test_more_oscillations_than_columns_are_an_envelope_of_all_points():
    t = np.linspace(0.0, 1000.0, 30_001)
    values = np.sin(5.0 * t)
    values[12_345] = 7.0  # one point of the run alone
    axes = drawn_with(t, values, True)
    assert not axes.lines
    (band,) = axes.collections
    corners = band.get_paths()[0].vertices
    assert corners[:, 1].max() == 7.0 and corners[:, 1].min() == pytest.approx(-1.0, abs=1e-3)
    assert corners[:, 0].min() == 0.0 and corners[:, 0].max() == 1000.0


def test_the_envelope_holds_every_value_and_gaps():
    rng = np.random.default_rng(11)
    t, values = np.linspace(-3.0, 4.0, 5000), rng.normal(size=5000)
    values[1000:1100] = np.nan
    middle, low, high = envelope(t, values, 50)
    assert len(middle) == 50 and np.isnan(low[10]) and np.isnan(high[10])
    for part in range(50):
        if part != 10:
            own = values[100 * part : 100 * (part + 1)]
            assert (low[part], high[part]) == (own.min(), own.max())
    assert turning_points(np.array([0.0, 1.0, 0.0, 1.0])) == 2
    assert turning_points(np.ones(5)) == 0


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("every", "joined"), [(1, True), (4, True), (60, False)])
@pytest.mark.parametrize("span", [(0.0, 60.0), (60.0, 0.0)])
def test_lines_where_the_motion_between_points_is_flat(every, joined, span, monkeypatch):
    run = co.integrate(BODY, (1.0, 0.2, 0.5), span, 0.05, save_every=every)
    monkeypatch.setattr(Solution, "at", not_to_be_had)
    assert PlottedRun(run).dense is joined
    lines = run.plot([Picture("components")], axes=Figure().add_subplot()).axes[0].lines
    assert {line.get_linestyle() for line in lines} == {"-" if joined else "None"}
    axes = Figure().add_subplot()
    run.plot(Picture("phase portrait", across=0, up=2), axes=axes)
    assert axes.lines[0].get_linestyle() == ("-" if joined else "None")


def test_a_motion_seen_once_in_a_period_is_not_joined():
    """The points nearly stand still, and a line through them would show a slow motion that is none."""
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, 1]))
    run = co.integrate(spin, (1.0, 0.0, 0.5), (0.0, 630.0), 0.063, save_every=100)
    assert not PlottedRun(run).dense


def test_flips_backward_and_forward():
    x0 = (0.02, 1.0, 0.02)
    forward = co.integrate(BODY, x0, (0.0, 60.0), 0.05, co.GaussLegendre(4))
    backward = co.integrate(BODY, x0, (0.0, -60.0), 0.05, co.GaussLegendre(4))
    there, back = (flip_times(BODY.vector_field, run.t, run.x, 1) for run in (forward, backward))
    assert len(there) > 1 and len(back) > 1
    # x2 at a flip is as small as the cubic is wrong: h^4 x2'''' / 384, with rates below 1
    for times in (there, back):
        assert np.abs([BODY.exact(x0, t)[1] for t in times]).max() < 0.05**4


@pytest.mark.parametrize(("stretch", "joined"), [(0.2, True), (1.5, False)])
@pytest.mark.parametrize("members", [None, 3])
def test_states_that_are_complex_matrices(stretch, joined, members):
    """W' = [P, W] turns what is off the diagonal: real and imaginary parts are coordinates."""
    P = np.diag([1j, -1j])
    t = stretch * np.arange(41)
    W = np.array([[1j, 1.0], [-1.0, -1j]])
    turned = np.stack([np.diag(np.exp(time * np.diag(P))) @ W @ np.diag(np.exp(-time * np.diag(P))) for time in t])
    x = turned if members is None else np.repeat(turned[:, None], members, axis=1)
    system = SimpleNamespace(
        name="quantized", dim=8, shape=(2, 2), algebra=None, vector_field=lambda W, t: P @ W - W @ P
    )
    run = SimpleNamespace(t=t, x=x, system=system, failed=None if members is None else np.zeros(members, dtype=bool))
    drawn = PlottedRun(run)
    assert drawn.x.shape == (members or 1, 41, 8) and drawn.names == tuple(f"x{i + 1}" for i in range(8))
    np.testing.assert_array_equal(drawn.x[0, :, 2], turned[:, 0, 1].real)
    np.testing.assert_array_equal(drawn.x[0, :, 3], turned[:, 0, 1].imag)
    assert drawn.dense is joined
    np.testing.assert_array_equal(drawn.state(drawn.index_at(0.5)), turned[20])


@pytest.mark.parametrize("turns", [3, 290, 310])
@pytest.mark.parametrize("joined", [True, False])
@pytest.mark.parametrize("points", [4000, 5000])
def test_long_series_are_lines_where_they_are_smooth_and_envelopes_where_they_are_dense(points, joined, turns):
    """A column resolves eight dots; half a column resolves a turning point."""
    t = np.linspace(2.0, 9.0, points)
    axes = drawn_with(t, np.sin(np.pi * turns * (t - 2.0) / 7.0), joined)
    if turns > 300 or (points > 4800 and not joined):
        assert not axes.lines and len(axes.collections) == 1
        return
    (line,) = axes.lines
    assert (line.get_linestyle() == "-") == joined and len(line.get_xdata()) == points
