"""Saved times that are not equidistant, forward and backward: what is drawn stands at its own time."""

from __future__ import annotations

import numpy as np
import pytest
from drawn_runs import BODY, SENSES, SPIN, T0, axes_of, made, sizes_of
from matplotlib import colormaps
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

import coadjoint as co
from coadjoint.pictures.kinds.components import flip_times
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.refinement_times import _divided
from coadjoint.pictures.series import draw_series, envelope


def uneven(count: int, sense: float, span: float = 4.0) -> np.ndarray:
    """Return times of a span, three quarters of them in its first quarter."""
    steps = np.where(np.arange(count - 1) < 0.75 * (count - 1), 1.0, 9.0)
    steps *= np.random.default_rng(count).uniform(0.5, 1.5, count - 1)
    return T0 + sense * span * np.append(0.0, np.cumsum(steps)) / steps.sum()


@pytest.mark.parametrize("sense", SENSES)
def test_a_fraction_of_the_span_is_the_saved_point_nearest_to_that_time(sense):
    t = uneven(40, sense)
    drawn = PlottedRun(made(t, np.random.default_rng(1).normal(size=(40, 3))))
    for part in (0.0, 0.1, 0.25, 0.5, 0.9, 1.0):
        k = drawn.index_at(part)
        assert abs(t[k] - (T0 + sense * 4.0 * part)) == np.abs(t - (T0 + sense * 4.0 * part)).min()
    assert [drawn.index_at(part) for part in (-3.0, 0.0, 1.0, 7.0)] == [0, 0, 39, 39]
    assert PlottedRun(made(t[:1], np.ones((1, 3)))).index_at(0.7) == 0


@pytest.mark.thinned(1)
@pytest.mark.parametrize("count", [30, 1001])
@pytest.mark.parametrize("sense", SENSES)
def test_rows_of_sites_and_their_scale(sense, count):
    t, x = uneven(count, sense), np.random.default_rng(2).normal(size=(count, 2, 6)) - 0.3
    run = made(t, x, co.systems.toda_ring(3))
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
        axes = axes_of(made(t, x), "phase ellipse", times=5, until=until, **options)
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
    axes = axes_of(made(t, x), "error", members)
    at = np.linspace(0, 899, 400).round().astype(int)
    for line, m in zip(axes.lines, members or [0, 1], strict=True):
        np.testing.assert_array_equal(line.get_xdata(), t[at])
        wanted = np.abs(off[at, m]) / np.linalg.norm(starts[m])
        np.testing.assert_allclose(line.get_ydata()[1:], wanted[1:], rtol=0, atol=1e-13)


@pytest.mark.thinned(1)
@pytest.mark.parametrize("members", [None, [1, 0], [2, 0]])
@pytest.mark.parametrize("sense", SENSES)
def test_series_of_members_in_the_order_in_which_they_are_chosen(sense, members):
    """Forces leave, of each change, what is not their work; observations that are vectors are not drawn."""
    t = uneven(50, sense)
    rng = np.random.default_rng(3)
    x = rng.normal(size=(50, 3, 3))
    energy, casimir, damping, torque = rng.normal(size=(4, 50, 3))
    damping[0] = torque[0] = 0.0
    work = {"damping": {"energy": damping, "|x|^2": 2.0 * damping}, "torque": {"energy": torque}}
    vectors, counts = rng.normal(size=(50, 3, 2)), rng.integers(0, 9, size=(50, 3))
    observed = {"vector": vectors, "count": counts, "above": counts > 4, "size": rng.normal(size=(50, 3))}
    run = made(t, x, energy=energy, casimirs={"|x|^2": casimir}, work=work, observed=observed)
    order = members or [0, 1, 2]
    components = axes_of(run, "components", members, chosen=[2, 0])
    curves = iter([line for line in components.lines if len(line.get_xdata()) == 50])
    for i in (2, 0):
        for m in order:
            np.testing.assert_array_equal(next(curves).get_data(), [t, x[:, m, i]])
    lines, sizes = iter(axes_of(run, "drift", members).lines), sizes_of(run)
    for name, series, done in (("energy", energy, damping + torque), ("|x|^2", casimir, 2.0 * damping)):
        size = sizes[name]
        for m in order:
            changed = np.abs(series[:, m] - series[0, m]) / size[m]
            np.testing.assert_array_equal(next(lines).get_data(), [t, np.where(changed > 0.0, changed, np.nan)])
        for m in order:
            wanted = np.abs(series[:, m] - series[0, m] - done[:, m]) / size[m]
            # Sums of four numbers below ten, in another order.
            np.testing.assert_allclose(
                next(lines).get_ydata()[1:], wanted[1:], rtol=0, atol=16 * 10 * 2.0**-53 / size[m]
            )
    shown = axes_of(run, "observed", members)
    assert [text.get_text() for text in shown.get_legend().get_texts()] == ["count", "above", "size"]
    lines = iter(shown.lines)
    for name in ("count", "above", "size"):
        for m in order:
            np.testing.assert_array_equal(next(lines).get_data(), [t, observed[name][:, m]])


def test_of_many_observations_the_first_eight_are_drawn():
    t, values = uneven(5, 1.0), np.arange(5.0)
    observed = {"vector": np.ones((5, 2)), **{f"q{i}": values + i for i in range(10)}}
    axes = axes_of(made(t, np.ones((5, 3)), observed=observed), "observed")
    assert [line.get_ydata()[0] for line in axes.lines] == list(range(8)) and axes.get_title() == "observed (8 of 10)"


@pytest.mark.parametrize("sense", SENSES)
def test_intervals_are_divided_into_equal_parts_of_their_own(sense):
    t, parts = uneven(20, sense), np.random.default_rng(4).integers(1, 6, 19)
    found = _divided(t, parts)
    at = np.append(0, np.cumsum(parts))
    np.testing.assert_array_equal(found[at], t)
    for k, (first, count) in enumerate(zip(at, parts, strict=False)):
        wanted = t[k] + (t[k + 1] - t[k]) * np.arange(count + 1) / count
        # Rounding of times below 16.
        np.testing.assert_allclose(found[first : first + count + 1], wanted, rtol=0, atol=4 * 16 * 2.0**-53)


@pytest.mark.parametrize("sense", SENSES)
def test_changes_of_sign_between_unequal_times_at_saved_points_and_at_gaps(sense):
    t = uneven(200, sense, 10.0)
    x = np.stack([np.cos(t - T0), -np.sin(t - T0), 0.0 * t + 0.5], axis=-1)
    if np.sign(SPIN.vector_field(x[0])[1]) > 0:
        x[:, 1] *= -1.0
    field, wanted = SPIN.vector_field, T0 + sense * np.pi * (0.5 + np.arange(3))
    error = np.abs(np.diff(t)).max() ** 4 / 384.0
    np.testing.assert_allclose(flip_times(field, t, x, 0), wanted, rtol=0, atol=error)
    np.testing.assert_allclose(flip_times(field, t, x, 0, max_count=2), wanted[:2], rtol=0, atol=error)
    # A saved point exactly at the second one, and a start and an end at which the coordinate is zero.
    k = int(np.argmin(np.abs(t - wanted[1])))
    t[k], x[k] = wanted[1], [0.0, x[k, 1], 0.5]
    found = flip_times(field, t, x, 0)
    assert len(found) == 3 and found[1] == pytest.approx(wanted[1], abs=1e-12)
    np.testing.assert_allclose(flip_times(field, t, x, 1), T0 + sense * np.pi * np.arange(1, 4), rtol=0, atol=error)
    x[k] = np.nan
    assert len(flip_times(field, t, x, 0)) == 2


def test_changes_of_sign_of_complex_matrices():
    fluid = co.systems.torus_euler(3)
    run = co.integrate(fluid, fluid.random(1, degrees=(1, 1)), (T0, T0 + 20.0), 0.125, co.IsospectralGauss())
    drawn = PlottedRun(run)
    real = drawn.x[0]
    i = int(np.argmax([np.count_nonzero(np.diff(np.sign(column))) for column in real.T]))
    found = flip_times(drawn.slope, run.t, real, i)
    crossed = np.flatnonzero(np.diff(np.sign(real[:, i])))
    assert len(found) == len(crossed) > 0
    part = real[crossed, i] / (real[crossed, i] - real[crossed + 1, i])
    # A straight line misses by h^2 / 8 times the second derivative over the slope, both of the size of the motion.
    np.testing.assert_allclose(found, run.t[crossed] + 0.125 * part, rtol=0, atol=0.125**2)


@pytest.mark.parametrize("lost", ["some", "first", "all but one"])
@pytest.mark.parametrize("sense", SENSES)
def test_envelopes_span_what_is_known_in_each_group(sense, lost):
    rng = np.random.default_rng(5)
    t, values = uneven(6000, sense), rng.normal(size=6000)
    groups = np.arange(6000).reshape(200, 30)
    gone = {"some": groups[:, ::4], "first": groups[:, :1], "all but one": groups[:, 1:]}[lost].ravel()
    kept = np.setdiff1d(np.arange(6000), gone)
    values[gone] = np.resize([np.nan, np.inf, -np.inf], len(gone))
    middle, low, high = envelope(t, values, 200)
    known = np.isin(groups, kept)
    for k, (points, own) in enumerate(zip(groups, known, strict=True)):
        assert (low[k], high[k]) == (values[points][own].min(), values[points][own].max())
    np.testing.assert_array_equal(middle[1:-1], 0.5 * (t[groups[1:-1, 0]] + t[groups[1:-1, -1]]))
    assert (middle[0], middle[-1]) == (t[0], t[-1])


def test_envelopes_have_the_colour_of_their_line_and_leave_out_what_overflows():
    t, values = uneven(4000, 1.0), np.random.default_rng(6).normal(size=4000)
    values[7], values[8], values[9] = 1e300, -1e300, np.inf
    axes = Figure().add_subplot()
    draw_series(axes, t, values, True, label="x", color="#D55E00", alpha=0.5)
    (band,) = (found for found in axes.collections if isinstance(found, PolyCollection))
    assert to_rgba(band.get_facecolor()[0])[:3] == to_rgba("#D55E00")[:3] == tuple(band.get_edgecolor()[0][:3])
    heights = band.get_paths()[0].vertices[:, 1]
    small = values[np.abs(values) < 1e3]
    assert (heights.min(), heights.max()) == (small.min(), small.max()) and band.get_label() == "x"


@pytest.mark.parametrize(
    ("alone", "style"),
    [(slice(1, None, 2), "None"), (slice(2, None, 3), "-"), (slice(30, 31), "-"), (slice(0, 0), "-")],
)
def test_points_between_gaps_are_dots_since_lines_do_not_show_them(alone, style):
    t, values = uneven(100, 1.0), np.linspace(1.0, 2.0, 100)
    values[alone] = np.nan
    axes = Figure().add_subplot()
    draw_series(axes, t, values, True, color="C0", linewidth=1.0)
    (line,) = axes.lines
    assert line.get_linestyle() == style
    np.testing.assert_array_equal(line.get_data(), [t, values])
