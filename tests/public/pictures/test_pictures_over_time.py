"""Pictures over time, read back from their artists: components, drifts, errors, observations, portraits and times."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from drawn_runs import (
    BODY,
    SENSES,
    T0,
    Picture,
    axes_of,
    data,
    made,
    made_at,
    shown,
    spinning,
)
from matplotlib import colormaps
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import to_hex

import coadjoint as co
from rounding import UNIT_ROUNDOFF

CHORD_TOLERANCE = 1e-3
"""Largest distance of a chord from the motion, of the size of the path."""
X0 = (0.1, 1.0, 0.1)
GOOD = [[0.1, 1.0, 0.2], [1.0, 0.2, 0.3]]
STYLE = ("color", "label", "linewidth")


INERTIAS = ((1.0, 2.0, 3.0), (1.0, 2.0, 2.5), (1.5, 2.0, 3.2))


STARTS = np.array([[1.0, 0.2, 0.5], [0.4, 0.1, 1.1], [1.3, -0.3, 0.2]])


@functools.cache
def bodies(sense: float = 1.0, count: int = 3, steps: int = 240) -> co.Solution:
    """Return a batch of different bodies, saved so densely that no state between is needed."""
    systems = [co.systems.rigid_body(INERTIAS[m % 3]) for m in range(count)]
    starts = np.array([STARTS[m % 3] * (1.0 + 0.01 * m) for m in range(count)])
    span = (T0, T0 + sense * steps * 0.0625)
    observe = {"first": lambda x: x[..., 0], "sum": lambda x: x[..., 1] + 2.0 * x[..., 2]}
    return co.integrate(co.batch(systems), starts, span, 0.0625, attitude=True, observe=observe)


def curves(axes: Any, shade: Any | None = None, least: int = 20) -> list[Any]:
    """Return the lines of an axes with many points, of one colour."""
    found = [line for line in axes.lines if len(line.get_xdata()) >= least]
    return [line for line in found if shade is None or to_hex(line.get_color()) == to_hex(shade)]


def uneven(count: int, sense: float, span: float = 4.0) -> np.ndarray:
    """Return times of a span, three quarters of them in its first quarter."""
    steps = np.where(np.arange(count - 1) < 0.75 * (count - 1), 1.0, 9.0)
    steps *= np.random.default_rng(count).uniform(0.5, 1.5, count - 1)
    return T0 + sense * span * np.append(0.0, np.cumsum(steps)) / steps.sum()


@pytest.mark.thinned(2)
@pytest.mark.parametrize("count", [30, 1001])
@pytest.mark.parametrize("sense", SENSES)
def test_rows_of_sites_and_their_scale(sense, count):
    t, x = uneven(count, sense), np.random.default_rng(2).normal(size=(count, 2, 6)) - 0.3
    run = made_at(t, x, co.systems.toda_ring(3))
    rows = np.unique(np.linspace(0, count - 1, min(count, 400)).round().astype(int))
    for centred in (True, False):
        axes = axes_of(run, "space-time", [1], sites=lambda n: [4, 0, 5], label="b", centred=centred)
        (mesh,) = (found for found in axes.collections if isinstance(found, QuadMesh))
        values = x[rows, 1][:, [4, 0, 5]]
        np.testing.assert_array_equal(mesh.get_array(), values)
        edges = mesh.get_coordinates()[:, 0, 1]
        np.testing.assert_allclose(edges[1:-1], 0.5 * (t[rows][1:] + t[rows][:-1]), rtol=0, atol=1e-12)
        assert edges[0] == pytest.approx(1.5 * t[0] - 0.5 * t[rows[1]])
        assert mesh.get_coordinates()[0, :, 0].tolist() == [0.5, 1.5, 2.5, 3.5]
        largest = np.abs(values).max()
        assert mesh.get_clim() == ((-largest, largest) if centred else (values.min(), values.max()))
    assert axes.get_title() == "b over site and time, member 1" and axes.get_xlabel() == "site"


@pytest.mark.thinned(1)
@pytest.mark.parametrize("members", [None, [1], [1, 0]])
@pytest.mark.parametrize("sense", SENSES)
def test_errors_are_those_of_each_member_at_its_times(sense, members):
    t = uneven(900, sense)
    starts = np.array([[1.0, 0.2, 0.5], [0.6, -1.0, 2.0]])
    off = np.stack([1e-3 * (t - T0) ** 2, 1e-2 * np.sin(t - T0)], axis=-1)
    x = np.stack([BODY.exact(start, t - T0) for start in starts], axis=1) + off[..., None] * [0.0, 0.6, -0.8]
    axes = axes_of(made_at(t, x), "error", members)
    at = np.linspace(0, 899, 400).round().astype(int)
    for line, m in zip(axes.lines, members or [0, 1], strict=True):
        np.testing.assert_array_equal(line.get_xdata(), t[at])
        wanted = np.abs(off[at, m]) / np.linalg.norm(starts[m])
        np.testing.assert_allclose(line.get_ydata()[1:], wanted[1:], rtol=0, atol=1e-13)
        assert not line.get_ydata()[0] > 1e-15 and axes.get_yscale() == "log"


@pytest.mark.thinned(2)
@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize(
    ("side", "first", "last", "span"), [("center", 0.0, 5.0, 5.0), ("left", 0.0, 4.0, 12.0), ("right", 8.0, 12.0, 12.0)]
)
def test_changes_of_sign_are_marked_at_their_times(sense, side, first, last, span):
    """A spin turns between two times, and rests before and after; it is at right angles half a unit after the first."""
    tau = np.linspace(0.0, span, 2001)
    run = spinning(np.pi / 2 - 0.5 + np.clip(tau, first, last) - first, T0 + sense * tau, sense)
    axes = axes_of(run, "components", chosen=[0], flips=0)
    times = T0 + sense * (first + 0.5 + np.array([0.0, np.pi]))
    dotted = [line for line in axes.lines if line.get_linestyle() == ":"]
    np.testing.assert_allclose([line.get_xdata() for line in dotted], np.stack([times] * 2, axis=1), rtol=0, atol=1e-9)
    (text,) = (found for found in axes.texts if found.get_text())
    assert float(text.get_text().rpartition(" ")[2]) == pytest.approx(np.pi, abs=1e-5)
    (arrow,) = (found for found in axes.texts if not found.get_text())
    ends = np.array([arrow.xyann, arrow.xy])
    np.testing.assert_allclose(np.sort(ends[:, 0]), np.sort(times), rtol=0, atol=1e-9)
    low, high = axes.get_ylim()
    assert ends[0, 1] == ends[1, 1] == text.get_position()[1] == dotted[0].get_ydata()[1]
    assert low < run.x[:, 0].min() and run.x[:, 0].max() < ends[0, 1] < high
    shown = side if sense > 0 or side == "center" else {"left": "right", "right": "left"}[side]
    assert text.get_ha() == shown
    where = {"left": times.min(), "right": times.max(), "center": times.mean()}[shown]
    assert text.get_position()[0] == pytest.approx(where, abs=1e-9)


def test_changes_of_sign_are_those_of_the_member_that_is_chosen():
    """Each member of a batch has a field of its own, by which the cubic between two points is made."""
    systems = [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, w])) for w in (-5.0, 1.0)]
    tau = 0.2 * np.arange(30)
    rising = np.sign(systems[1].vector_field(np.array([1.0, 0.0, 0.0]))[1])
    x = np.stack([np.cos(tau), rising * np.sin(tau), 0.0 * tau], axis=-1)
    run = made(np.stack([x, x], axis=1), co.batch(systems), T0 + tau)
    texts = axes_of(run, "components", [1], chosen=[0], flips=0).texts
    (said,) = (float(text.get_text().rpartition(" ")[2]) for text in texts if text.get_text())
    # Both cubics are wrong by h^4 / 384; with the other field by a fifth of the interval.
    assert said == pytest.approx(np.pi, abs=2 * 0.2**4 / 384 + 1e-5)


def test_members_have_the_colours_of_their_energies_at_the_start():
    """Also if forces change their order; the bar runs from the lowest energy to the highest one."""
    energy = np.array([[1.0, 5.0, 3.0], [5.0, 3.0, 0.5], [4.0, 0.25, 8.0]])
    run = made(np.random.default_rng(2).normal(size=(3, 3, 3)), energy=energy)
    axes = axes_of(run, "components", chosen=[1])
    wanted = colormaps["viridis"](0.88 * (energy[0] - 1.0) / 4.0)
    for m, line in enumerate(axes.lines[:3]):
        np.testing.assert_array_equal(data(line), [run.t, run.x[:, m, 1]])
        # Of 256 colours the nearest one.
        np.testing.assert_allclose(line.get_color(), wanted[m], rtol=0, atol=4 / 256)
    (bar,) = axes.child_axes
    assert bar.get_ylim() == (1.0, 5.0) and bar.get_ylabel() == "energy $H$ at the start"
    # The first saved point of chosen times is not the start.
    damped = BODY.with_forces(co.forces.LinearDamping((0.0, 0.5, 2.0)))
    states = np.array([(0.2, 2.0, 0.1), (1.6, 0.1, 0.2), (0.1, 0.3, 2.5)])
    late = co.integrate(damped, states, (0, 2), 0.1, t_eval=[1.0, 1.5, 2.0])
    (bar,) = axes_of(late, "components", [2, 0], chosen=[1]).child_axes
    np.testing.assert_allclose(bar.get_ylim(), sorted(damped.energy(states[m]) for m in (2, 0)), rtol=1e-14)


def test_one_member_of_an_ensemble_is_drawn_as_one():
    run = co.integrate(BODY, GOOD[:1], (T0, T0 - 2.0), 0.1, attitude=True)
    alone = co.integrate(BODY, GOOD[0], (T0, T0 - 2.0), 0.1, attitude=True)
    for name in ("components", "drift", "body axis"):
        both = [axes_of(each, name) for each in (run, alone)]
        assert both[0].get_title() == both[1].get_title() and len(both[0].lines) == len(both[1].lines)
        for one, other in zip(*(axes.lines for axes in both), strict=True):
            np.testing.assert_array_equal(one.get_data(), other.get_data())
            assert all(getattr(one, f"get_{part}")() == getattr(other, f"get_{part}")() for part in STYLE)


SYSTEMS = {
    "body": BODY,
    "fluid": co.systems.torus_euler(5),
    "active field": co.systems.get("reduced_mhd", N=5, surface="torus"),
}


@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize("forced", [False, True])
@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("members", [None, [2, 0]])
def test_deviations_and_what_the_work_of_forces_leaves_are_relative_to_the_start(name, forced, sense, members):
    """The energy, and of more than five Casimirs the worst four and a band of all."""
    system, rng = SYSTEMS[name], np.random.default_rng(4)
    shape = getattr(system, "shape", (3,))
    fluid = co.systems.torus_euler(5)
    states = [fluid.random(seed, degrees=(1, 2)) for seed in range(6)] if len(shape) > 1 else None
    x0 = rng.normal(size=(3, 3)) if states is None else np.array(states).reshape(-1, *shape)[:3]
    x0 = x0 * np.array([1.0, 1.5, 0.2]).reshape(-1, *[1] * len(shape))
    if forced:
        system = system.with_forces(co.forces.LinearDamping(0.1), co.forces.LinearDamping(0.2))
    run = co.integrate(system, x0, (T0, T0 + sense), 0.0625)
    axes, order = axes_of(run, "drift", members), members or [0, 1, 2]
    scales = {each: np.atleast_1d(change.scale)[order] for each, change in run.change().items()}
    series = {"energy": run.energy, **run.casimirs}
    changes = {each: (values - run.initial[each])[:, order] / scales[each] for each, values in series.items()}
    casimirs = [each for each in changes if each != "energy"]
    if len(casimirs) > 5:
        deviations = np.abs(np.stack([changes[each] for each in casimirs]))
        (band,) = (drawn for drawn in axes.collections if isinstance(drawn, PolyCollection))
        heights = band.get_paths()[0].vertices[:, 1]
        wanted = deviations[deviations > 0.0].min(), deviations.max()
        np.testing.assert_allclose((heights.min(), heights.max()), wanted, rtol=1e-6)
        assert band.get_label() == f"all {len(casimirs)} Casimirs"
        casimirs = sorted(casimirs, key=lambda each: -np.nanmax(np.abs(changes[each])))[:4]
    lines = list(axes.lines)
    for each in ("energy", *casimirs):
        drawn, lines = lines[: len(order)], lines[len(order) :]
        for column, line in enumerate(drawn):
            wanted = np.abs(changes[each][:, column])
            np.testing.assert_array_equal(line.get_xdata(), run.t)
            np.testing.assert_allclose(line.get_ydata(), np.where(wanted > 0.0, wanted, np.nan), rtol=1e-7)
        if not forced:
            continue
        drawn, lines = lines[: len(order)], lines[len(order) :]
        done = sum(by[each][:, order] for by in run.work.values() if each in by) / scales[each]
        for column, line in enumerate(drawn):
            assert line.get_linestyle() == ":"
            rest = np.abs(changes[each] - done)[:, column]
            # Differences of numbers of the size of the changes.
            np.testing.assert_allclose(np.nan_to_num(line.get_ydata()), rest, rtol=1e-7, atol=16 * UNIT_ROUNDOFF)
    assert not lines and axes.get_ylabel() == "relative deviation from start"
    assert ("change of the energy" in axes.get_title()) == forced and ("drift" in axes.get_title()) != forced


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
    assert np.linalg.norm(0.5 * (x[1:] + x[:-1]) - exact, axis=1).max() < 1.5 * CHORD_TOLERANCE * size
    path = np.array(orbit.lines[0].get_data_3d()).T
    assert orbit.lines[0].get_linestyle() == "-" and np.array_equal(path, x)


def test_members_of_a_batch_have_their_own_fields():
    """The second member turns fifty times faster, and needs as many more points."""
    slow, fast = (co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, w])) for w in (0.1, 5.0))
    run = co.integrate(co.batch([slow, fast]), [[1.0, 0.0, 0.5]] * 2, (0.0, 20.0), 0.5)
    axes = axes_of(run, "components", [1], chosen=[0, 1, 2])
    steps = np.linalg.norm(np.diff([line.get_ydata() for line in axes.lines[:3]], axis=1), axis=0)
    # A circle of the radius 1, whose range has the size 2 sqrt 2: its chords leave it by their square over 8.
    assert steps.max() ** 2 / 8 < 1.1 * CHORD_TOLERANCE * 2 * 2**0.5


def keys_of(run, picture, **options):
    """Return the labels in the key of a picture, with their colours."""
    key = shown(run, picture, **options).get_legend()
    return {text.get_text(): line.get_color() for text, line in zip(key.get_texts(), key.get_lines(), strict=True)}


def test_members_of_a_batch_have_a_key_of_the_parameters_in_which_they_differ(tmp_path):
    """The energy is the same for all, that of a rotation about the first axis."""
    settings, third = [(k, d) for k in (1.5, 2.0) for d in (2.25, 2.375)], Picture("components", chosen=[2])
    named = co.batch(lambda k, d: co.systems.rigid_body((1.0, k, d)), k=[1.5, 2.0], d=[2.25, 2.375])
    run = co.integrate(named, (1.0, 0.0, 0.0), (T0, T0 + 1.0), 0.1)
    co.integrate(named, (1.0, 0.0, 0.0), (T0, T0 + 1.0), 0.1).to_xarray().to_netcdf(tmp_path / "run.nc")
    for one in (run, co.load(tmp_path / "run.nc")):
        found = keys_of(one, third)
        assert list(found) == [f"k = {k:.4g}, d = {d:.4g}" for k, d in settings] and len(set(found.values())) == 4
        for m, shade in enumerate(found.values()):
            (line,) = (line for line in shown(one, third).lines if line.get_color() == shade)
            np.testing.assert_array_equal(line.get_ydata(), run.x[:, m, 2])
    assert list(keys_of(run, third, members=[0, 2])) == ["k = 1.5", "k = 2"], "d is the same"


PAIR = np.array([(1.0, 0.2, 0.5), (0.1, 1.0, 0.1)])
END, STEP, TIMES = 13.0, 0.26, (5.05, 13.0)


@pytest.mark.parametrize("kind", ["drift", "error", "drift with forces"])
@pytest.mark.parametrize("x0", [PAIR[0], PAIR], ids=["one", "members"])
def test_deviations_do_not_depend_on_whether_the_start_is_saved(kind, x0):
    system, lines = BODY.with_forces(co.forces.LinearDamping(0.1)) if "forces" in kind else BODY, []
    for times in (TIMES, (0.0, *TIMES)):
        sol = co.integrate(system, x0, (0, END), STEP, co.Splitting(order=2), t_eval=times)
        lines.append([line.get_ydata() for line in sol.plot(kind.split()[0]).axes[0].lines])
    found, expected = lines
    assert len(found) == len(expected) > 0
    for values, reference in zip(found, expected, strict=True):
        assert np.array_equal(values, reference[1:])


@pytest.mark.parametrize("ends", [(0.0, END), (END, 0.0)], ids=["forward", "backward"])
@pytest.mark.parametrize("x0", [PAIR[0], PAIR], ids=["one", "members"])
def test_modified_energies_deviate_from_those_of_the_initial_state(x0, ends):
    lines = []
    for times in (TIMES[:1], (ends[0], *TIMES[:1])):
        sol = co.integrate(BODY, x0, ends, STEP, co.Splitting(order=2), t_eval=times)
        lines.append([line.get_ydata()[-1] for line in co.plotting.draw_modified_energy(sol, (4, 6)).axes[0].lines])
    assert np.allclose(*lines, rtol=1e-6, atol=0)
    assert len(lines[0]) == 3 and min(lines[0]) > 0
