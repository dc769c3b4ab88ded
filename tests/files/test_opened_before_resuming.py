"""Solutions of archives that are resumed to a later end after they were opened."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives.reading import ArchiveError

BODY, X0 = co.systems.rigid_body(inertia=(1, 2, 3)), [(1.0, 0.2, 0.5), (0.1, 1.0, 0.1)]


def _opened_and_resumed(path, save_every):
    co.integrate(BODY, X0, (2, -1), 0.1, save_every=save_every, archive=path)
    opened = co.open_archive(path)
    dataset = opened.to_xarray()
    co.resume(path, t_end=-2.0)
    return opened, dataset


@pytest.mark.parametrize("save_every", [20, 1000])
def test_last_point_of_a_short_interval_that_was_replaced_is_refused(save_every, tmp_path):
    opened, dataset = _opened_and_resumed(tmp_path / "run.zarr", save_every)
    for read in (lambda: opened.x, lambda: opened.energy, lambda: opened.t, lambda: dataset["x"][-1].values):
        with pytest.raises(ArchiveError, match=r"resumed to a later end.*open it again"):
            read()
    expected = co.integrate(BODY, X0, (2, -1), 0.1, save_every=save_every).x
    assert np.array_equal(dataset["x"][:-1].values, expected[:-1])


def test_points_of_equal_intervals_are_those_of_the_opened_run(tmp_path):
    opened, dataset = _opened_and_resumed(tmp_path / "run.zarr", 10)
    expected = co.integrate(BODY, X0, (2, -1), 0.1, save_every=10)
    assert np.array_equal(opened.x, expected.x)
    assert np.array_equal(opened.t, expected.t)
    assert np.array_equal(dataset["energy"].values, expected.energy)


def test_end_between_two_steps_is_refused_with_those_around_it(tmp_path):
    co.integrate(BODY, X0, (2, -1), 0.125, archive=tmp_path / "run.zarr")
    with pytest.raises(ArchiveError, match=r"t_end -1\.2 is between two steps of 0\.125; give -1\.125 or -1\.25$"):
        co.resume(tmp_path / "run.zarr", t_end=-1.2)
    assert co.resume(tmp_path / "run.zarr", t_end=-1.25).finished


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
    with pytest.raises(ArchiveError, match="is between two steps") as refused:
        co.resume(path, t_end=span[1] + way * 1.2 * rounding)
    assert f"t_end {float(span[1] + way * 1.2 * rounding)!r} is" in str(refused.value)
    with pytest.raises(ValueError, match="must lie within the run") as refused:
        resumed.at(span[1] + way * 1.2 * rounding)
    assert f"{span[1]:g}." in str(refused.value).partition(";")[0]
