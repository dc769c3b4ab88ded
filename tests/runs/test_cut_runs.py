"""Runs that were interrupted or failed state this in their text, summary, pictures and files."""

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.datasets.export import mark_failed
from coadjoint.kernels.loop import MemberBatch

BODY, X0 = co.systems.rigid_body(inertia=(1.0, 2.0, 3.0)), (1.0, 0.2, 0.1)
STATED = "31 points from t = 0 to 600 of 20000, interrupted"


@pytest.fixture
def cut(monkeypatch):
    """Return a run that was interrupted after 600 of 20000 time units."""
    advance = MemberBatch.advance

    def interrupted(self, layout, schedule, saved, state, k0, k1, stop):
        advance(self, layout, schedule, saved, state, k0, 6000, stop)
        saved["x"][31:] = np.nan
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(MemberBatch, "advance", interrupted)
        with pytest.raises(KeyboardInterrupt) as raised:
            co.integrate(BODY, X0, (0, 20000), 0.1, save_every=200, method=co.Splitting(order=4))
    return raised.value.partial


def test_text_and_summary_of_an_interrupted_run(cut):
    assert cut.incomplete == "interrupted" and len(cut.t) == 31
    assert STATED in repr(cut)
    assert STATED in cut._repr_html_()


def test_pictures_of_an_interrupted_run(cut, tmp_path):
    title = cut.plot(["components"])._suptitle.get_text()
    assert STATED in " ".join(title.split())


@pytest.mark.parametrize("t0, sense", [(0.0, 1), (7.0, -1)])
def test_interrupted_ensembles_work_on_members_as_far_as_they_ran(t0, sense, monkeypatch, tmp_path):
    """The first member runs for 60 units of time, the second for 20, and the third has not begun."""
    advance = MemberBatch.advance
    states = np.array([X0, (0.3, 1.0, 0.1), (0.2, 0.3, 1.0)])

    def interrupted(self, layout, schedule, saved, state, k0, k1, stop):
        advance(self, layout, schedule, saved, state, k0, 600, stop)
        for m, points in enumerate((31, 11, 0)):
            for name in ("x", "values"):
                saved[name][points:, m] = np.nan
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(MemberBatch, "advance", interrupted)
        with pytest.raises(KeyboardInterrupt) as raised:
            co.integrate(BODY, states, (t0, t0 + sense * 20000), 0.1, save_every=20, threads=1)
    cut = raised.value.partial
    first, second = (
        co.integrate(BODY, states[m], (t0, t0 + sense * end), 0.1, save_every=20) for m, end in ((0, 60.0), (1, 20.0))
    )
    energies = cut.drift()["energy"].members
    assert np.isnan(energies[2]) and 0 < cut.drift()["energy"] == max(energies[:2])
    error = cut.error_estimate()
    np.testing.assert_array_equal(error, [first.error_estimate(), np.nan, np.nan])
    cut.to_xarray().to_netcdf(tmp_path / "cut.nc", engine="h5netcdf")
    for found in (cut, co.load(tmp_path / "cut.nc")):
        # The last ones are just before the last saved point of the second member, and of the first.
        for after, lost in ((15.05, False), (45.05, True), (19.95, False), (59.95, True)):
            there, t = found.at(t0 + sense * after).x, t0 + sense * after
            np.testing.assert_array_equal(there[0], first.at(t).x)
            np.testing.assert_array_equal(there[1], [np.nan] * 3 if lost else second.at(t).x)
            assert np.isnan(there[2]).all()
    assert len(cut.plot("components", members=[0, 1]).axes) == 1
    with pytest.raises(ValueError, match=r"members \[2\] of the run have not been computed, and 2 of 3 have"):
        cut.plot("components", members=[0, 2])


@pytest.mark.parametrize("suffix", ["nc", "zarr"])
def test_interrupted_runs_are_read_back_as_such(cut, suffix, tmp_path):
    path, dataset = tmp_path / f"run.{suffix}", cut.to_xarray()
    assert dataset.attrs["run_incomplete"] == 1 and dataset.attrs["incomplete_time"] == 600.0
    dataset.to_netcdf(path, engine="h5netcdf") if suffix == "nc" else dataset.to_zarr(path, zarr_format=2)
    loaded = co.load(path)
    assert loaded.incomplete == "interrupted" and STATED in repr(loaded) and STATED in loaded._repr_html_()
    np.testing.assert_array_equal(loaded.x, cut.x)
    assert STATED in repr(co.load(path)), "again"


def test_complete_runs_are_not_marked(tmp_path):
    sol = co.integrate(BODY, X0, (0, 1), 0.1, archive=tmp_path / "run.zarr")
    plain = co.integrate(BODY, X0, (0, 1), 0.1)
    for run in (sol, plain, co.load(tmp_path / "run.zarr")):
        assert run.incomplete is None and "interrupted" not in repr(run) + run._repr_html_()
    assert "11 points from t = 0 to 1, step" in repr(plain)
    assert "run_incomplete" not in plain.to_xarray().attrs


def test_unfinished_archives(tmp_path):
    from coadjoint.files.archives.resume import archive_run

    prepared = co.prepare(BODY, co.Splitting(), 0.1)
    sol = archive_run(prepared, X0, (0.0, 20.0), 10, tmp_path / "run.zarr", until=50)
    assert sol.incomplete == "unfinished" and "6 points from t = 0 to 5 of 20, unfinished" in sol._repr_html_()
    assert co.resume(tmp_path / "run.zarr").incomplete is None


def test_failed_runs(tmp_path):
    """The exact flow of a dilation overflows."""
    H = co.Quadratic(((1.0, 0.3, 0.0), (0.3, -2.0, 0.1), (0.0, 0.1, 0.5)))
    dilation = co.LiePoissonSystem(co.algebras.get("A3,7", a=2.0), H)
    with pytest.raises(co.IntegrationError) as raised:
        co.integrate(dilation, (1e3, 2e3, 3e3), (0, 20), 0.5)
    partial = raised.value.partial
    assert partial.incomplete == "failed" and repr(partial).count(" of 20, failed,") == 1
    path = tmp_path / "run.nc"
    mark_failed(partial.to_xarray(), raised.value).to_netcdf(path, engine="h5netcdf")
    assert co.load(path).incomplete == "failed"


def test_a_failed_run_is_marked_in_a_file(tmp_path):
    top = co.systems.heavy_top()
    with pytest.raises(co.IntegrationError) as raised:
        co.integrate(top, (0.3, 0.2, 3, 0.6, 0, 0.8), (0, 100), 5.0, co.Taylor(order=8))
    raised.value.partial.to_xarray().to_netcdf(tmp_path / "failed.nc", engine="h5netcdf")
    found = co.load(tmp_path / "failed.nc")
    assert found.incomplete == raised.value.partial.incomplete == "failed"
    assert "failed" in repr(found)
