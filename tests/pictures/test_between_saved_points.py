"""Curves are smooth where the scheme gives the states between the saved points, and dots where it cannot."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.kinds.spins import site_positions
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.refinement_times import (
    MAX_REFINED_POINTS,
    REFINED_TOLERANCE,
    REFINED_TURN,
    coarse_times,
    times_between,
)
from coadjoint.runs.solution import Solution
from coadjoint.systems.gallery_entry import Picture

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
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


def test_a_long_chain_is_folded_into_rows():
    places = site_positions("chain", 100, 100)
    assert len(np.unique(places, axis=0)) == 100
    assert np.ptp(places[:, 0]) == 14 and np.ptp(places[:, 1]) < 14
    assert site_positions("chain", 30, 30)[:, 1].max() == 0.0


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
    spin = co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, 1]))
    for every, joined in ((42, False), (18, True)):  # 15 and 35 points each turn
        run = co.integrate(spin, (1.0, 0.0, 0.5), (0.0, 300.0), 0.01, save_every=every)
        drawn = PlottedRun(run)
        assert drawn.joined is joined and drawn.dense


def test_states_between_are_not_computed_if_their_steps_take_long() -> None:
    """A state takes a partial step in addition to the steps of the run, which are repeated."""
    run = co.integrate(co.systems.rigid_body((1.0, 2.0, 3.0)), (1.0, 0.2, 0.5), (0.0, 1.0), 0.25)
    for seconds, steps, enough in ((0.01, 4, True), (1.0, 4, False), (1.0, 4000, True), (1.6, 4000, False)):
        stats = replace(run.stats, seconds=seconds, steps=steps)
        drawn = PlottedRun(run)
        drawn.solution = copy.copy(run)
        object.__setattr__(drawn.solution, "stats", stats)
        assert (coarse_times(drawn) is not None) == enough, (seconds, steps)
