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
    axes_of,
    data,
    made,
    made_at,
)
from matplotlib import colormaps
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex

import coadjoint as co
from rounding import UNIT_ROUNDOFF

CHORD_TOLERANCE = 1e-3
"""Largest distance of a chord from the motion, of the size of the path."""
X0 = (0.1, 1.0, 0.1)


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
