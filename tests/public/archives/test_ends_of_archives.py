"""Archives that are resumed to a later end."""

import numpy as np
import pytest
from storing import BODY, STEP

import coadjoint as co
from refusals import refused
from same_runs import check_same

X0 = [(1.0, 0.2, 0.5), (0.1, 1.0, 0.1)]
pytestmark = pytest.mark.usefixtures("no_fsync")


@pytest.mark.parametrize("save_every", [20, 1000])
def test_last_point_of_a_short_interval_that_was_replaced_is_refused(save_every, tmp_path):
    opened, dataset = opened_and_resumed(tmp_path / "run.zarr", save_every)
    for read in (lambda: opened.x, lambda: opened.energy, lambda: opened.t, lambda: dataset["x"][:2].values):
        with refused(ValueError, "later end", "open it again"):
            read()


def opened_and_resumed(path, save_every):
    co.integrate(BODY, X0, (2, -1), 0.1, save_every=save_every, archive=path)
    opened = co.open_archive(path)
    dataset = opened.to_xarray()
    co.resume(path, t_end=-2.0)
    return opened, dataset


def test_points_of_equal_intervals_are_those_of_the_opened_run(tmp_path):
    opened, dataset = opened_and_resumed(tmp_path / "run.zarr", 10)
    expected = co.integrate(BODY, X0, (2, -1), 0.1, save_every=10)
    assert np.array_equal(opened.x, expected.x)
    assert np.array_equal(opened.t, expected.t)
    assert np.array_equal(dataset["energy"].values, expected.energy)


@pytest.mark.parametrize("way", [1, -1])
def test_ends_that_are_refused(way, tmp_path):
    """Between two steps, at or before what was reached, and on the other side of the start."""
    path = tmp_path / "run.zarr"
    co.integrate(BODY, X0, (2, 2 + way * 3), STEP, archive=path)
    with refused(ValueError, "t_end", 2 + way * 3.2, 2 + way * 3.125, 2 + way * 3.25):
        co.resume(path, t_end=2 + way * 3.2)
    co.resume(path, 2 + way * 10, until=41)
    for end in (2.0, 2 + way * 41 * STEP - way * STEP, 2 - way * 10.0, 2 + way * 24 * STEP):
        with refused(ValueError, "t_end", f"{end:g}"):
            co.resume(path, end)
    for end in (np.nan, np.inf, "x", [1.0]):
        with refused((ValueError, TypeError), "t_end"):
            co.resume(path, end)
    assert co.open_archive(path).reached == 41
    found = co.resume(path, 2 + way * 60 * STEP)
    check_same(found, co.integrate(BODY, X0, (2, 2 + way * 60 * STEP), STEP))
    assert co.resume(path, 2 + way * 60 * STEP).finished


@pytest.mark.parametrize("span", [(0.0, 30.0), (2.0, -28.0)])
def test_ends_that_are_sums_of_steps(span, tmp_path):
    """They are accepted up to their rounding; beyond, the message shows the digits that differ."""
    way, path = np.sign(span[1] - span[0]), tmp_path / "run.zarr"
    half = span[0] + way * np.cumsum(np.full(1500, 0.01))[-1]
    whole = span[0] + way * np.cumsum(np.full(3000, 0.01))[-1]
    assert half != span[0] + way * 15.0 and whole != span[1]
    co.integrate(BODY, X0, (span[0], half), 0.01, archive=path, save_every=500)
    resumed = co.resume(path, t_end=whole)
    expected = co.integrate(BODY, X0, span, 0.01, save_every=500)
    assert np.array_equal(resumed.x, expected.x) and resumed.t_span == expected.t_span
    assert np.array_equal(co.resume(path, t_end=whole).x, expected.x)
    assert np.array_equal(resumed.at(whole).x, expected.x[-1])
    # A sum of 3000 terms may have eight units in the last place of its largest time for each.
    rounding = 16 * 2.0**-53 * max(*map(abs, span), 30.0) * 3000
    assert np.array_equal(co.resume(path, t_end=span[1] + way * 0.9 * rounding).x, expected.x)
    beyond = float(span[1] + way * 1.2 * rounding)
    with refused(ValueError, f"t_end {beyond!r} is"):
        co.resume(path, t_end=beyond)
    with refused(ValueError, f"{span[1]:g}."):
        resumed.at(beyond)


@pytest.mark.parametrize("cuts", [(176, 208, None), (159, 176, 177)])
def test_deviations_that_fall_again_stay_in_their_tenth_of_a_longer_run(tmp_path, cuts):
    """The axis turns over at t = 19, in the seventh tenth of 28 and the fifth of 40; steps 177 to 208 are in two.

    Step 160 is the last one of its tenth of 40, and step 177 alone is less than a 64th of either run.
    """
    x0, method, path = (0.02, 1.0, 0.02), co.Splitting(order=2), tmp_path / "run.zarr"
    expected = co.integrate(BODY, x0, (0.0, 40.0), STEP, method)
    deviations = np.abs(expected.energy - expected.energy[0])
    assert deviations.argmax() == 151 and deviations[192:].max() < 0.5 * deviations.max()
    assert deviations[160] > deviations[161:193].max() and deviations[177] > deviations[225:257].max()
    co.integrate(BODY, x0, (0.0, 2 * STEP), STEP, method, archive=path)
    for k, until in enumerate(cuts):
        co.resume(path, None if k else 28.0, until=until)
    check_same(co.resume(path, 40.0), expected, work=False)


def test_runs_of_one_kind_are_not_resumed_as_the_other(tmp_path):
    one, many = tmp_path / "one.zarr", tmp_path / "many.zarr"
    co.integrate(BODY, X0, (0, 1), STEP, archive=one)
    co.integrate_ensemble(BODY, X0, (0, 1), STEP, archive=many)
    for given in ({"workers": 2}, {"client": 3}):
        with refused(ValueError, *given):
            co.resume(one, **given)
    for given in ({"t_end": 8.0}, {"until": 3}, {"events": co.Event("x1")}):
        with refused(ValueError, *given):
            co.resume(many, **given)
    with refused(ValueError, "one run"):
        co.integrate_ensemble(BODY, X0, (0, 1), STEP, archive=one)
