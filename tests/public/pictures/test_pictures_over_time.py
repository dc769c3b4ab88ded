"""Pictures over time, read back from their artists: components, drifts, errors, observations, portraits and times."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from drawn_runs import (
    BODY,
    SENSES,
    SPIN,
    T0,
    TURN,
    MemberColours,
    Picture,
    axes_of,
    colour,
    data,
    made,
    made_at,
    shown,
    spinning,
)
from matplotlib import colormaps
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import to_hex, to_rgba
from matplotlib.figure import Figure

import coadjoint as co
from refusals import refused
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


def test_portraits_on_a_circle_have_no_line_across_and_every_point():
    run = bodies(1.0, 3, 699)
    axes = shown(run, Picture("phase portrait", across=lambda x: 40.0 * np.arctan2(x[..., 0], x[..., 1]), cyclic=2.0))
    shades = MemberColours(run)
    for m in range(3):
        (line,) = curves(axes, shades[m])
        x, y = data(line)
        wanted = 40.0 * np.arctan2(run.x[:, m, 0], run.x[:, m, 1])
        kept = np.isfinite(x)
        np.testing.assert_array_equal(y[kept], run.x[:, m, 1])
        np.testing.assert_allclose(np.exp(1j * np.pi * x[kept]), np.exp(1j * np.pi * wanted), rtol=0, atol=1e-9)
        assert np.nanmax(np.abs(np.diff(x))) <= 1.0, "no line from one side to the other"
        assert np.nanmax(np.abs(x)) <= 1.0
    assert axes.get_xlim() == (-1.0, 1.0)


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


@pytest.mark.thinned(2)
@pytest.mark.parametrize("until", [None, 0.5, 0.2, 0.0])
@pytest.mark.parametrize("sense", SENSES)
def test_ellipses_paths_and_colours_up_to_a_time(sense, until):
    t = uneven(60, sense)
    s = np.linspace(0.0, 1.0, 60)
    x = np.stack([1.0 + s, 0.3 - s, 2.0 + 3.0 * s], axis=-1)
    end = 60 if until is None else int(np.argmin(np.abs(t - (T0 + sense * 4.0 * until)))) + 1
    at = np.unique(np.linspace(0, end - 1, min(end, 5)).round().astype(int))
    centres = 3.0 * s, -2.0 * s
    own = {"lumps": lambda x, system: [(*centres, *x.T)]}
    for options, (q, p) in (({"moments": (0, 1, 2)}, (0.0 * s, 0.0 * s)), (own, centres)):
        axes = axes_of(made_at(t, x), "phase ellipse", times=5, until=until, **options)
        path, *ellipses = axes.lines
        np.testing.assert_array_equal(path.get_data(), [q[:end], p[:end]])
        assert len(ellipses) == len(at)
        first, last = min(t[at]), max(t[at])
        for line, k in zip(ellipses, at, strict=True):
            right, up = line.get_data()
            assert right.max() - q[k] == pytest.approx(np.sqrt(x[k, 0]), rel=1e-12)
            # The curve has 121 points, of which the highest misses the top by 1 - cos(pi / 120).
            assert up.max() - p[k] == pytest.approx(np.sqrt(x[k, 2]), rel=4e-4)
            if last > first:
                wanted = colormaps["plasma"](float((t[k] - first) / (last - first)))
                # The colormap has 256 colours, which differ by at most 0.02.
                assert to_rgba(line.get_color()) == pytest.approx(wanted, abs=0.02)
        bar = axes.child_axes[-1]
        if last > first:
            assert sorted(bar.get_ylim()) == pytest.approx([first, last])
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("position $q$", "momentum $p$")


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


def test_errors_need_a_closed_form():
    for system in (co.systems.heavy_top(), co.batch([BODY, co.systems.rigid_body((1, 2, 2.5))])):
        with refused(co.plotting.CannotShow, "closed form"):
            shown(co.integrate(system, np.ones(system.dim), (0.0, 1.0), 0.1), "error")


def test_of_many_observations_the_first_eight_are_drawn():
    t, values = uneven(5, 1.0), np.arange(5.0)
    observed = {"vector": np.ones((5, 2)), **{f"q{i}": values + i for i in range(10)}}
    axes = axes_of(made_at(t, np.ones((5, 3)), observed=observed), "observed")
    assert [line.get_ydata()[0] for line in axes.lines] == list(range(8)) and axes.get_title() == "observed (8 of 10)"


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


@pytest.mark.parametrize("sense", SENSES)
def test_short_times_between_changes_of_sign_are_not_marked(sense):
    tau = np.linspace(0.0, 80.0, 8001)
    run = spinning(tau, T0 + sense * tau, sense)
    assert not axes_of(run, "components", chosen=[0], flips=0).texts
    several = made(np.stack([run.x, run.x], axis=1)[:1000], SPIN, run.t[:1000])
    assert not axes_of(several, "components", chosen=[0], flips=0).texts
    one = axes_of(several, "components", [1], chosen=[0], flips=0).texts
    assert any("changes sign after 3.14159" in text.get_text() for text in one)


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


def test_components_functions_and_titles():
    x = np.random.default_rng(1).normal(size=(40, 2, 3))
    run = made(x)
    axes = axes_of(run, "components", functions={"E": lambda x: x[..., 0] + 2.0 * x[..., 2]}, chosen=[1], quantity="q")
    for line, values in zip(axes.lines, [x[:, 0, 1], x[:, 1, 1], *(x[:, :, 0] + 2.0 * x[:, :, 2]).T], strict=True):
        np.testing.assert_array_equal(data(line), [run.t, values])
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["$x_{2}$", "$E$"]
    assert (axes.get_title(), axes.get_ylabel()) == ("q over time", "q")
    alone = axes_of(run, "components", functions=lambda n: {"E": lambda x: n * x[..., 1]})
    for m, line in enumerate(alone.lines):
        np.testing.assert_array_equal(line.get_ydata(), 3.0 * x[:, m, 1])
        assert line.get_color() == colour(0), "all have the same energy"
    assert alone.get_ylabel() == "angular momentum $E$" and alone.get_legend() is None
    named = axes_of(run, "components", chosen=lambda n: [n - 1, 0])
    assert [line.get_ydata()[0] for line in named.lines] == [x[0, 0, 2], x[0, 1, 2], x[0, 0, 0], x[0, 1, 0]]
    assert (named.get_title(), named.get_ylabel()) == (
        "components of the angular momentum",
        "angular momentum $x_i$",
    )


def test_portraits_have_a_dot_at_each_start_and_the_scales_asked_for():
    starts = np.array([0.2, -0.4])
    x = np.stack(
        [np.cos(TURN)[:, None] + starts, np.sin(TURN)[:, None] * (1 + starts), 0.5 + 0 * starts * TURN[:, None]], -1
    )
    run = made(x)
    options = {"labels": ("a", "b"), "equal": True, "title": "an orbit"}
    axes = axes_of(run, "phase portrait", [1, 0], across=lambda x: 2.0 * x[..., 1], up=0, **options)
    for place, m in enumerate((1, 0)):
        curve, dot = axes.lines[2 * place : 2 * place + 2]
        np.testing.assert_array_equal(data(curve), [2.0 * x[:, m, 1], x[:, m, 0]])
        np.testing.assert_array_equal(data(dot)[:, 0], [2.0 * x[0, m, 1], x[0, m, 0]])
        assert curve.get_color() == dot.get_color() == colour(0)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_aspect()) == ("a", "b", 1.0)
    assert axes.get_title() == "an orbit (dot: start)"
    free = axes_of(run, "phase portrait")
    assert free.get_aspect() == "auto" and (free.get_xlabel(), free.get_ylabel()) == ("$x_{1}$", "$x_{2}$")
    with refused(co.plotting.CannotShow, "coordinate 3"):
        axes_of(run, "phase portrait", up=3)


def test_components_asked_for_are_those_of_the_figure():
    run = co.integrate(BODY, [(0.1, 1.0, 0.2), (1.0, 0.2, 0.3)], (T0, T0 + 0.5), 0.01)
    axes = Figure().subplots(1, 2)
    run.plot(["drift", "components"], components=["x3", 0], axes=axes)
    several = [line for line in axes[1].lines if len(line.get_xdata()) == len(run.t)]
    for line, (m, i) in zip(several, ((0, 2), (1, 2), (0, 0), (1, 0)), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), run.x[:, m, i])
    with refused(ValueError, "components"):
        run.plot(components=[])
    many = made(np.ones((3, 25, 3)))
    with refused(ValueError, "from 1 to 20"):
        axes_of(many, "components", list(range(21)), chosen=[0])
    assert len(axes_of(many, "components", list(range(20)), chosen=[0]).lines) == 20


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


def deviating(deviations, energy):
    """Return a run at rest whose energy and Casimirs, of the size 5, deviate."""
    casimirs = {f"C{i}": 5.0 + values for i, values in enumerate(deviations)}
    return made(np.ones((*energy.shape, 3)), energy=energy, casimirs=casimirs)


@pytest.mark.parametrize(("which", "said"), [("energy", []), ("casimir", []), ("none", ["no deviation in any bit"])])
def test_no_deviation_is_written_only_without_any(which, said):
    energy, casimir = np.ones(9), np.zeros(9)
    if which == "energy":
        energy[4:] += 2.0**-40
    elif which == "casimir":
        casimir[4:] = 2.0**-40
    axes = axes_of(deviating([casimir], energy), "drift")
    assert [text.get_text() for text in axes.texts] == said


def test_deviations_of_almost_one_size_are_seen_in_two_decades():
    energy = 1.0 + 2.0**-20 * np.array([0.0, 1.0, 1.25, 1.5, 1.0, 2.0])
    low, high = axes_of(deviating([], energy), "drift").get_ylim()
    assert high / low == pytest.approx(100.0) and low < 2.0**-20 < 2.0**-19 < high
    wide = 1.0 + np.array([0.0, 2.0**-30, 2.0**-20, 2.0**-10])
    low, high = axes_of(deviating([], wide), "drift").get_ylim()
    assert low < 2.0**-30 < 2.0**-10 < high


def test_one_member_of_an_ensemble_is_drawn_as_one():
    run = co.integrate(BODY, GOOD[:1], (T0, T0 - 2.0), 0.1, attitude=True)
    alone = co.integrate(BODY, GOOD[0], (T0, T0 - 2.0), 0.1, attitude=True)
    for name in ("components", "drift", "body axis"):
        both = [axes_of(each, name) for each in (run, alone)]
        assert both[0].get_title() == both[1].get_title() and len(both[0].lines) == len(both[1].lines)
        for one, other in zip(*(axes.lines for axes in both), strict=True):
            np.testing.assert_array_equal(one.get_data(), other.get_data())
            assert all(getattr(one, f"get_{part}")() == getattr(other, f"get_{part}")() for part in STYLE)


@pytest.mark.parametrize("resting", [0, 1, 2])
def test_legends_have_lines_whose_first_members_are_not_drawn(resting):
    """Deviations of a body at rest are zero, and have no logarithm."""
    starts = [*GOOD[:resting], [0.0, 0.0, 1.0], *GOOD[resting:]]
    axes = axes_of(co.integrate(BODY, starts, (T0, T0 + 2.0), 0.1), "drift")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["$H$", "$|x|^2$"]


def test_a_driven_energy_changes_and_does_not_drift():
    def value(x, t):
        return x[0] * np.cos(t) + 0.5 * x[2] ** 2

    def slope(x, t):
        return np.array([np.cos(t), 0.0, x[2]])

    def curvature(x, t):
        return np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    driven = co.LiePoissonSystem(co.algebras.so(3), co.Hamiltonian(value, slope, curvature))
    axes = shown(co.integrate(driven, (0.2, 0.5, 1.0), (0.0, 5.0), 0.1, co.GaussLegendre(2)), "drift")
    assert axes.get_title().startswith("change of the driven energy")
    assert axes.get_legend().get_texts()[0].get_text() == "$H$, driven"


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


def test_a_section_has_the_crossings():
    body = co.systems.rigid_body(inertia=(1, 2, 3))
    x0 = [(0.1, 1.0, 0.1), (0.2, 1.0, 0.1)]
    run = co.integrate(body, x0, (0.0, 60.0), 0.125, events=[co.Event("x2"), co.Event("x1", name="other")])
    axes = shown(run, Picture("section", event="x2", components=("x3", "x1")))
    assert axes.get_xlabel() == "$x_{3}$" and axes.get_ylabel() == "$x_{1}$"
    for m, line in enumerate(axes.lines):
        own = run.events["x2"].of(m).x
        np.testing.assert_array_equal(np.transpose([line.get_xdata(), line.get_ydata()]), own[:, [2, 0]])
    for seen, options in ((run, {"event": "x9"}), (co.integrate(body, x0, (0.0, 1.0), 0.125), {})):
        with pytest.raises(co.plotting.CannotShow):
            seen.plot([Picture("section", **options)])


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
    assert np.linalg.norm(0.5 * (x[1:] + x[:-1]) - exact, axis=1).max() < 1.5 * CHORD_TOLERANCE * size
    path = np.array(orbit.lines[0].get_data_3d()).T
    assert orbit.lines[0].get_linestyle() == "-" and np.array_equal(path, x)


def test_noise_leaves_dots():
    noisy = co.systems.spin_lattice("chain", 2).with_forces(co.forces.HeatBath(0.3, temperature=0.5, seed=3))
    run = co.integrate(noisy, [1.0, 0.0, 0.0, 0.0, 1.0, 0.0], (0.0, 20.0), 0.05, save_every=40)
    assert styles(run.plot(["components"]).axes[0]) == {"None"}


def test_too_many_oscillations_are_not_filled():
    run = co.integrate(BODY, X0, (0.0, 20_000.0), 0.1, save_every=500)
    assert styles(run.plot(["components"]).axes[0]) == {"None"}
    # One hundredth of it is.
    short = co.integrate(BODY, X0, (0.0, 200.0), 0.1, save_every=500)
    line = short.plot(["components"]).axes[0].lines[0]
    assert line.get_linestyle() == "-" and len(short.t) < len(line.get_xdata()) <= 20_000


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


def test_members_by_forces_have_a_key_and_many_have_a_bar():
    laws = [co.forces.LinearDamping(rate) for rate in (0.1, 0.2)]
    damped = co.batch([BODY.with_forces(law) for law in laws])
    run = co.integrate(damped, X0, (T0, T0 + 1.0), 0.1)
    assert list(keys_of(run, Picture("components", chosen=[0]))) == ["rate = 0.1", "rate = 0.2"]
    thirds = np.linspace(2.25, 3.0, 12)
    many = co.integrate(co.batch([co.systems.rigid_body((1, 2, k)) for k in thirds]), (1, 0, 0), (T0, T0 + 1), 0.1)
    for name in ("components", "coadjoint orbit"):
        picture = Picture(name, **({"chosen": [0]} if name == "components" else {}))
        axes = shown(many, picture)
        (bar,) = (child for child in axes.child_axes if "members" in child.get_label())
        assert bar.get_ylabel() == "inertia[2]"
    axes = shown(many, Picture("components", chosen=[0]))
    assert len({to_hex(line.get_color()) for line in axes.lines}) == 12


@pytest.mark.long  # each law is compiled
def test_pointing_errors_of_gains_have_a_key():
    def pointed(k):
        return co.systems.body((0.03, 0.04, 0.05)).with_forces(co.forces.Pointing(stiffness=k, damping=0.01))

    x0 = pointed(0.002).state([0.6, 0.0, 0.0, 0.8])
    run = co.integrate(co.batch(pointed, k=[0.002, 0.004]), x0, (T0, T0 + 1.0), 0.125)
    assert list(keys_of(run, "pointing error")) == ["k = 0.002", "k = 0.004"]


def test_members_are_chosen():
    starts = np.random.default_rng(5).normal(size=(30, 3))
    run = co.integrate(BODY, starts, (0.0, 2.0), 0.1)
    lines = shown(run, "components", [7, 2]).lines
    np.testing.assert_array_equal([line.get_ydata() for line in lines], run.x[:, [7, 2] * 3, [0, 0, 1, 1, 2, 2]].T)
    portraits = shown(run, "phase portrait", [7, 2]).lines[::2]
    np.testing.assert_array_equal([line.get_xdata() for line in portraits], run.x[:, [7, 2], 0].T)
    for wrong, what in [([30], "not 30"), ([], "members"), ([1, 1], "members"), (3, "members")]:
        with refused((TypeError, ValueError), what):
            run.plot(members=wrong)


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
