"""Pictures of ensembles in which a member fails: the others are drawn whole, and what is lost leaves gaps."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import drawn_runs
import numpy as np
import pytest
from drawn_runs import BARE, BODY, T0, axes_of

import coadjoint as co
from coadjoint.pictures.plot_data import PlottedRun
from coadjoint.pictures.register import CannotShow
from coadjoint.systems.gallery_entry import Picture

STYLE = ("color", "label", "linewidth")
GOOD = [[0.1, 1.0, 0.2], [1.0, 0.2, 0.3]]


def partial(*args: Any, **options: Any) -> co.Solution:
    with pytest.raises(co.IntegrationError) as raised:
        co.integrate(*args, **options)
    found: co.Solution = raised.value.partial
    return found


@cache
def bodies(bad: int) -> co.Solution:
    """Return a run of three bodies, of which one grows beyond every bound."""
    starts = [*GOOD[:bad], [30.0, 40.0, -50.0], *GOOD[bad:]]
    run = partial(BODY, starts, (T0, T0 + 2.0), 0.1, co.ExplicitRungeKutta("rk4"), attitude=True)
    assert run.failed.tolist() == [m == bad for m in range(3)]
    return run


@pytest.mark.parametrize("bad", [0, 1, 2])
def test_bodies_are_drawn_with_the_gaps_of_those_that_fail(bad):
    run = bodies(bad)
    assert len(run.plot(["drift", "components", "body axis"]).axes) == 3
    components = axes_of(run, "components", chosen=[1])
    for m in range(3):
        line = components.lines[m]
        np.testing.assert_array_equal(line.get_xdata(), run.t)
        wanted = np.where(np.abs(run.x[:, m, 1]) < 1e280, run.x[:, m, 1], np.nan)
        np.testing.assert_array_equal(line.get_ydata(), wanted)
    orbit = axes_of(run, "coadjoint orbit")
    for m, line in enumerate(orbit.lines[::2]):
        path = np.array(line.get_data_3d()).T
        assert m == bad or np.array_equal(path, run.x[:, m])
        assert np.array_equal(path[:2], run.x[:2, m])
    for limits in (orbit.get_xlim(), orbit.get_ylim(), orbit.get_zlim()):
        assert np.isfinite(limits).all()


HYPERBOLIC = co.LiePoissonSystem(co.algebras.sl(2), co.Quadratic([1.0, 0.5, 0.7]))


def limits_of(axes: Any) -> np.ndarray:
    return np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])


@pytest.mark.thinned(36)
@pytest.mark.parametrize("lost", [np.nan, 1e80, -1e80, np.inf])
@pytest.mark.parametrize("bad", [0, 1, 2])
@pytest.mark.parametrize("system", [BODY, BARE, HYPERBOLIC], ids=["sphere", "no surface", "surface without bounds"])
def test_orbits_are_framed_with_every_point_that_is_left(system, bad, lost):
    """The states of the member that fails are lost from its fourth point on, all of them or one component."""
    rng = np.random.default_rng(bad)
    x = rng.normal(size=(20, 3, 3)) * [1.0, 5.0, 2.0] + [3.0, 0.0, -4.0]
    x[4:, bad, 1] = lost
    if np.isnan(lost):
        x[5:, bad] = lost
    axes = axes_of(drawn_runs.made(T0 + 0.1 * np.arange(20), x, system), "coadjoint orbit")
    left = np.where(np.abs(x) < 1e75, x, np.nan)
    limits = limits_of(axes)
    if system is BODY:  # a cube about the whole sphere
        size = np.sqrt(np.nanmax(np.sum(left**2, axis=-1)))
        np.testing.assert_allclose(limits, 1.1 * size * np.array([[-1.0, 1.0]] * 3), rtol=1e-12)
    else:
        low, high = np.nanmin(left, axis=(0, 1)), np.nanmax(left, axis=(0, 1))
        np.testing.assert_allclose(limits.mean(axis=1), (low + high) / 2, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.diff(limits)[:, 0], 1.4 * (high - low), rtol=1e-12)
    assert len(axes.collections) == (system is not BARE)
    for m, line in enumerate(axes.lines[::2]):
        np.testing.assert_array_equal(np.array(line.get_data_3d()).T, left[:, m])


@pytest.mark.parametrize("x", [(0.0, 0.0, 0.0), (2.0, -3.0, 1.0)])
def test_a_motion_that_stays_in_a_plane_or_at_a_point_has_a_box(x):
    """A twentieth of the widest extent is left on both sides, or of 1 around a point."""
    still = np.tile(x, (10, 1))
    axes = axes_of(drawn_runs.made(0.1 * np.arange(10), still, BARE), "coadjoint orbit")
    np.testing.assert_allclose(limits_of(axes), np.transpose([still[0] - 0.05, still[0] + 0.05]), atol=1e-15)
    flat = still + np.outer(np.linspace(-1.0, 1.0, 10), [4.0, 0.0, -1.0])
    limits = limits_of(axes_of(drawn_runs.made(0.1 * np.arange(10), flat, BARE), "coadjoint orbit"))
    np.testing.assert_allclose(limits, np.add.outer(x, [-1.0, 1.0]) * 1.0 + np.outer([4.6, -0.6, 0.4], [-1, 1]))


def test_a_path_in_space_has_the_limits_of_the_members_that_go_on():
    body = co.systems.kirchhoff_body()
    starts = [(0.5, 1.5, 1.0, 0.8, 0.1, 0.1), (100.0, -100.0, 100.0, 100.0, 0.1, 0.1)]
    run = partial(body, starts, (T0, T0 + 2.0), 0.1, co.ExplicitRungeKutta("rk4"), attitude=True)
    axes = axes_of(run, "path in space")
    np.testing.assert_array_equal(np.array(axes.lines[0].get_data_3d()).T, run.attitude[:, 0, :3, 3])
    for i, (low, high) in enumerate((axes.get_xlim(), axes.get_ylim(), axes.get_zlim())):
        assert low < np.nanmin(run.attitude[..., i, 3]) and np.nanmax(run.attitude[..., i, 3]) < high


@pytest.mark.parametrize("bad", [0, 1])
def test_fluids_whose_first_member_fails_have_no_spectrum_at_the_end(bad):
    fluid = co.systems.torus_euler(5)
    W = [fluid.random(1, degrees=(1, 2)), fluid.random(2, degrees=(1, 2))]
    W[bad] = 1e5 * W[bad]
    run = partial(fluid, np.stack(W), (T0, T0 + 1.0), 0.1)
    assert run.failed[bad]
    titles = [axes.get_title() for axes in run.plot(["energy by scale", Picture("vorticity", at=1.0)]).axes]
    assert "energy by scale of member 0" in titles and f"vorticity of member 0 at $t$ = {run.t[-1]:.4g}" in titles
    known = np.isfinite(run.x[:, 0]).all(axis=(1, 2))
    for line in axes_of(run, "energy by scale").lines:
        np.testing.assert_array_equal(np.isfinite(line.get_ydata()), known)
    (image,) = axes_of(run, "vorticity", at=1.0).images
    assert np.isfinite(np.ma.filled(image.get_array(), np.nan)).all() == (bad == 1)
    assert np.isfinite(image.get_clim()).all() and image.get_clim()[1] > 0.0
    assert len(axes_of(run, "eigenvalues", at=0.0).lines) == 2
    if bad == 0:
        with pytest.raises(CannotShow, match=r"failed before t = 8\.3"):
            axes_of(run, "eigenvalues")
    else:
        assert len(axes_of(run, "eigenvalues").lines) == 2


@pytest.mark.parametrize(("first", "other", "joined"), [(0.1, 10.0, False), (10.0, 0.1, True)])
def test_whether_lines_are_drawn_is_seen_on_a_member_that_lives_with_its_own_field(first, other, joined):
    systems = [co.LiePoissonSystem(co.algebras.so(3), co.Quadratic(0, linear=[0, 0, w])) for w in (first, other)]
    t = T0 + 0.1 * np.arange(200)
    sense = np.sign(systems[0].vector_field(np.array([1.0, 0.0, 0.0]))[1])
    x = np.stack(
        [np.stack([np.cos(w * (t - T0)), sense * np.sin(w * (t - T0)), 0.0 * t], -1) for w in (first, other)], 1
    )
    x[1:, 0] = np.nan
    run = SimpleNamespace(
        incomplete=None, t=t, x=x, system=co.batch(systems), failed=np.array([True, False]), carried=None, attitude=None
    )
    drawn = PlottedRun(run)
    assert (drawn.dense, drawn.joined) == (joined, joined)
    alone = SimpleNamespace(
        t=t, x=x[:, 1:], system=co.batch(systems[1:]), failed=np.array([False]), carried=None, incomplete=None
    )
    assert PlottedRun(alone).dense is joined


def made(deviations: Any, energy: Any, failed: Any = None) -> Any:
    t = T0 + 0.1 * np.arange(len(energy))
    casimirs = {f"C{i}": 5.0 + values for i, values in enumerate(deviations)}
    return drawn_runs.made(t, np.ones((*energy.shape, 3)), failed=failed, energy=energy, casimirs=casimirs)


def test_the_worst_casimirs_are_those_of_the_members_that_live_and_the_band_spans_all():
    rng = np.random.default_rng(1)
    sizes = np.array([3.0, 40.0, 2.0, 30.0, 1.0, 20.0, 10.0])
    deviations = sizes[:, None, None] * 2.0**-10 * rng.integers(-64, 64, size=(7, 12, 2))
    deviations[:, 0] = 0.0
    deviations[:, 5, 0] = sizes[:, None].T * 2.0**-4
    deviations[:, 6:, 1] = np.nan
    deviations[2, 3] = 0.0
    deviations[[1, 3, 5, 6], -1, 0] = 2.0**-30
    run = made(deviations, np.zeros((12, 2)), np.array([False, True]))
    deviations = deviations / 5.0  # relative to the initial value
    axes = axes_of(run, "drift")
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["all 7 Casimirs", "C1", "C3", "C5", "C6"], "the energy rests, and is not drawn"
    for lines, i in zip(np.reshape(axes.lines[2:], (4, 2)), (1, 3, 5, 6), strict=True):
        for m, line in enumerate(lines):
            wanted = np.abs(deviations[i, :, m])
            np.testing.assert_array_equal(line.get_ydata(), np.where(wanted > 0.0, wanted, np.nan))
    (band,) = axes.collections
    corners = np.concatenate([path.vertices for path in band.get_paths()])
    every = np.where(deviations == 0.0, np.nan, np.abs(deviations)).transpose(1, 0, 2).reshape(12, 14)
    for k in range(1, 12):
        heights = corners[np.isclose(corners[:, 0], run.t[k], rtol=0, atol=1e-9), 1]
        assert (heights.min(), heights.max()) == (np.nanmin(every[k]), np.nanmax(every[k]))
    assert not np.isclose(corners[:, 0], run.t[0], rtol=0, atol=1e-9).any(), "the start has no deviation"


@pytest.mark.parametrize(("which", "said"), [("energy", []), ("casimir", []), ("none", ["no deviation in any bit"])])
def test_no_deviation_is_written_only_without_any(which, said):
    energy, casimir = np.ones(9), np.zeros(9)
    if which == "energy":
        energy[4:] += 2.0**-40
    elif which == "casimir":
        casimir[4:] = 2.0**-40
    axes = axes_of(made([casimir], energy), "drift")
    assert [text.get_text() for text in axes.texts] == said


def test_deviations_of_almost_one_size_are_seen_in_two_decades():
    energy = 1.0 + 2.0**-20 * np.array([0.0, 1.0, 1.25, 1.5, 1.0, 2.0])
    low, high = axes_of(made([], energy), "drift").get_ylim()
    assert high / low == pytest.approx(100.0) and low < 2.0**-20 < 2.0**-19 < high
    wide = 1.0 + np.array([0.0, 2.0**-30, 2.0**-20, 2.0**-10])
    low, high = axes_of(made([], wide), "drift").get_ylim()
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
