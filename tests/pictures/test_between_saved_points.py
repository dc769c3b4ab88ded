"""Series are drawn as lines, dots or envelopes, and refined between the saved points where the scheme gives states."""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from drawn_runs import BODY, SPIN
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.kinds.components import flip_times
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.refinement_times import (
    MAX_REFINED_POINTS,
    REFINED_TOLERANCE,
    REFINED_TURN,
    coarse_times,
    times_between,
)
from coadjoint.pictures.series import draw_series, envelope, turning_points
from coadjoint.runs.results.solution import Solution
from coadjoint.systems.gallery_entry import Picture

X0 = (0.1, 1.0, 0.1)


def not_to_be_had(self, t):
    raise ValueError("there are no states between the saved points")


def styles(axes):
    return {line.get_linestyle() for line in axes.lines if len(line.get_xdata()) > 1}


@pytest.mark.thinned(6)
@pytest.mark.parametrize("span", [(0.0, 60.0), (60.0, 0.0)])
@pytest.mark.parametrize("every", [20, 50, 600])
def test_chords_stay_by_the_motion_however_sparse_the_saved_points_are(span, every):
    run = co.integrate(BODY, X0, span, 0.1, co.Splitting(order=6), save_every=every)
    _, components, orbit = run.plot().axes
    lines = components.lines[:3]
    assert {line.get_linestyle() for line in lines} == {"-"}
    t = lines[0].get_xdata()
    assert set(run.t.tolist()) <= set(t.tolist())
    x = np.stack([line.get_ydata() for line in lines], axis=1)
    middle = 0.5 * (t[1:] + t[:-1])
    size = np.linalg.norm(np.ptp(x, axis=0))
    exact = BODY.exact(np.array(X0), middle - span[0])
    # The turning of the path is looked at in 64 places; between them it may be larger, here by less than a half.
    assert np.linalg.norm(0.5 * (x[1:] + x[:-1]) - exact, axis=1).max() < 1.5 * REFINED_TOLERANCE * size
    path = np.array(orbit.lines[0].get_data_3d()).T
    assert orbit.lines[0].get_linestyle() == "-" and np.array_equal(path, x)


def test_a_run_that_ends_where_it_began_is_a_circle_all_the_same():
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, 2 * np.pi / 10]))
    run = co.integrate(spin, (1.0, 0.0, 0.5), (0.0, 10.0), 0.1, save_every=100)
    filled = PlottedRun(run).refined
    assert len(run.t) == 2 and len(filled.t) >= 40 and filled.joined


def test_saved_points_that_are_close_stay_as_they_are():
    run = co.integrate(BODY, X0, (0.0, 20.0), 0.05)
    drawn = PlottedRun(run)
    assert drawn.refined is drawn


def test_runs_for_an_accuracy_have_smooth_paths_of_their_axes():
    top = co.systems.heavy_top()
    run = co.integrate(top, (0.3, 0.2, 3.0, 0.6, 0.0, 0.8), (0.0, 20.0), accuracy=1e-8, attitude=True)
    filled = PlottedRun(run).refined
    path = filled.rotation[0] @ np.array([0.0, 0.0, 1.0])
    turned = np.arccos(np.clip(np.sum(path[1:] * path[:-1], axis=1), -1.0, 1.0))
    assert turned.max() <= 1.05 * REFINED_TURN
    assert np.isin(run.t, filled.t).all()
    at_saved = filled.rotation[0][np.isin(filled.t, run.t)]
    np.testing.assert_array_equal(at_saved, run.attitude[:, :3, :3])


def test_an_attitude_turns_where_the_momentum_rests():
    """A body that spins about its axis has a momentum that never moves, and an attitude that always does."""
    run = co.integrate(BODY, (0.0, 0.0, 3.0), (0.0, 20.0), 0.1, save_every=20, attitude=True)
    filled = PlottedRun(run).refined
    first = filled.rotation[0][:, :, 0]
    turned = np.arccos(np.clip(np.sum(first[1:] * first[:-1], axis=1), -1.0, 1.0))
    # It turns by one radian in a unit of time.
    assert 0.9 * REFINED_TURN < turned.max() <= REFINED_TURN * (1 + 1e-9)


def test_noise_leaves_dots():
    noisy = co.systems.spin_lattice("chain", 2).with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=3))
    run = co.integrate(noisy, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], (0.0, 20.0), 0.05, save_every=40)
    assert styles(run.plot(["components"]).axes[0]) == {"None"}


def test_members_that_failed_leave_dots_where_the_others_went_far():
    fast = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, 3]))
    run = co.integrate(fast, [[1.0, 0.0, 0.5]] * 2, (0.0, 20.0), 0.5, save_every=4)
    assert PlottedRun(run).refined is not PlottedRun(run) and len(PlottedRun(run).refined.t) > 400
    run.x[3:, 1] = np.nan
    drawn = PlottedRun(run)
    assert drawn.refined is drawn and not drawn.dense


def test_too_many_oscillations_are_not_filled():
    run = co.integrate(BODY, X0, (0.0, 20_000.0), 0.1, save_every=500)
    assert times_between(PlottedRun(run), PlottedRun(run)) is None
    assert styles(run.plot(["components"]).axes[0]) == {"None"}
    # One hundredth of it is.
    short = co.integrate(BODY, X0, (0.0, 200.0), 0.1, save_every=500)
    assert len(short.t) < len(PlottedRun(short).refined.t) <= MAX_REFINED_POINTS


def test_members_of_a_batch_have_their_own_fields():
    """The second member turns fifty times faster, and needs as many more points."""
    slow, fast = (co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, w])) for w in (0.1, 5.0))
    run = co.integrate(co.batch([slow, fast]), [[1.0, 0.0, 0.5]] * 2, (0.0, 20.0), 0.5)
    filled = PlottedRun(run).refined
    steps = np.linalg.norm(np.diff(filled.x[1], axis=0), axis=1)
    # A circle of the radius 1, whose range has the size 2 sqrt 2: its chords leave it by their square over 8.
    assert steps.max() ** 2 / 8 < 1.1 * REFINED_TOLERANCE * 2 * 2**0.5


def test_members_are_chosen():
    starts = np.random.default_rng(5).normal(size=(30, 3))
    run = co.integrate(BODY, starts, (0.0, 2.0), 0.1)
    figure = run.plot(["components"], members=[7, 2])
    lines = figure.axes[0].lines
    np.testing.assert_array_equal(lines[0].get_ydata(), run.x[:, 7, 0])
    np.testing.assert_array_equal(lines[1].get_ydata(), run.x[:, 2, 0])
    assert len(lines) == 6 and "2 of 30 members" in figure.get_suptitle()
    for wrong, what in [([30], "from 0 to 29, not 30"), ([], "members are"), ([1, 1], "members are"), (3, "members")]:
        with pytest.raises((TypeError, ValueError), match=what):
            run.plot(members=wrong)


def test_a_flip_too_short_to_be_seen_is_not_written():
    run = co.integrate(BODY, X0, (0.0, 2000.0), 0.1)
    assert not [text for text in run.plot(["components"]).axes[0].texts if "changes sign" in text.get_text()]
    short = co.integrate(BODY, X0, (0.0, 60.0), 0.1)
    assert [text for text in short.plot(["components"]).axes[0].texts if "changes sign" in text.get_text()]


@pytest.mark.long
def test_a_notebook_shows_the_figure_by_itself():
    run = co.integrate(BODY, X0, (0.0, 1.0), 0.1)
    figure = run.plot()
    assert isinstance(figure, Figure) and figure._repr_png_().startswith(b"\x89PNG")


@pytest.mark.long
def test_no_legend_reaches_out_of_the_figure():
    lattice = co.systems.spin_lattice("chain", 101)
    x0 = np.random.default_rng(1).normal(size=303)
    figure = co.integrate(lattice, x0, (0.0, 2.0), 0.1).plot()
    figure.draw_without_rendering()
    drift = figure.axes[0]
    # The energy, the worst four of 101, and a band of all.
    assert drift.get_legend().get_texts()[0].get_text() == "all 101 Casimirs"
    assert len(drift.lines) == 5 and len(drift.collections) == 1
    for axes in figure.axes:
        if axes.get_legend() is not None:
            box = axes.get_legend().get_window_extent()
            assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("every", "style"), [(5, "-"), (7, "None")])
def test_the_path_of_an_axis_is_lines_only_where_it_turns_by_little(every, style, sign, monkeypatch):
    """A body in steady rotation: its momentum stands still in the body, its axis turns by 1/4 or 1/3."""
    monkeypatch.setattr(Solution, "at", not_to_be_had)
    run = co.integrate(BODY, (1.0, 0.0, 0.0), (0.0, 60.0 * sign), 0.05, save_every=every, attitude=True)
    assert PlottedRun(run).joined
    axes = Figure().add_subplot()
    run.plot(Picture("body axis", axis=1), axes=axes)
    circles = 181  # points of the meridians and the equator
    assert {line.get_linestyle() for line in axes.lines if 1 < len(line.get_xdata()) != circles} == {style}


def test_points_of_a_curve_that_closes_make_no_ribbon(monkeypatch):
    """Chords of 15 points a turn would make a ribbon of a hundredth of the size; dots are the curve."""
    monkeypatch.setattr(Solution, "at", not_to_be_had)
    for every, joined in ((42, False), (18, True)):  # 15 and 35 points each turn
        run = co.integrate(SPIN, (1.0, 0.0, 0.5), (0.0, 300.0), 0.01, save_every=every)
        drawn = PlottedRun(run)
        assert drawn.joined is joined and drawn.dense


def test_states_between_are_not_computed_if_their_steps_take_long() -> None:
    """A state takes a partial step in addition to the steps of the run, which are repeated."""
    run = co.integrate(BODY, (1.0, 0.2, 0.5), (0.0, 1.0), 0.25)
    for seconds, steps, enough in ((0.01, 4, True), (1.0, 4, False), (1.0, 4000, True), (1.6, 4000, False)):
        stats = replace(run.stats, seconds=seconds, steps=steps)
        drawn = PlottedRun(run)
        drawn.solution = copy.copy(run)
        object.__setattr__(drawn.solution, "stats", stats)
        assert (coarse_times(drawn) is not None) == enough, (seconds, steps)


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
    run = co.integrate(SPIN, (1.0, 0.0, 0.5), (0.0, 630.0), 0.063, save_every=100)
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
    failed = None if members is None else np.zeros(members, dtype=bool)
    run = SimpleNamespace(t=t, x=x, system=system, failed=failed, incomplete=None)
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
