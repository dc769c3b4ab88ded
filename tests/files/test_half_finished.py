"""Archives of ensembles of which some members have not run: drifts, errors, states between points, and pictures."""

import pickle
import re

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives import run_in_blocks
from coadjoint.files.archives.block_run import run_block
from coadjoint.files.output.atomic_output import PendingOutput

HALF_STATES = np.random.default_rng(5).standard_normal((6, 3))


@pytest.fixture(params=["blocks", "no block"])
def half_finished(request, tmp_path, monkeypatch):
    """An archive of six members of which the first four, or none, have been computed, and how many these are."""
    count = 4 if request.param == "blocks" else 0
    remaining = iter(range(count // 2))

    def interrupted(*arguments):
        if next(remaining, None) is None:
            raise KeyboardInterrupt
        return run_block(*arguments)

    monkeypatch.setattr(run_in_blocks, "run_block", interrupted)
    options = {"archive": tmp_path / "half.zarr", "members_per_block": 2, "attitude": True, "save_every": 5}
    with pytest.raises(KeyboardInterrupt):
        co.integrate_ensemble(co.systems.rigid_body((1, 2, 3)), HALF_STATES, (0, 5), 0.1, **options)
    return co.open_archive(tmp_path / "half.zarr"), count


def test_half_finished_archives_work_on_members_that_have_run(half_finished):
    sol, count = half_finished
    if not count:
        assert all(np.isnan(drift) and np.isnan(drift.members).all() for drift in sol.drift().values())
        with pytest.raises(ValueError, match="no member has a state at the end"):
            sol.error_estimate()
        with pytest.raises(ValueError, match="which all members of this run have not reached"):
            sol.at(1.23)
        with pytest.raises(ValueError, match=r"members \[0, 1, 2, 3, 4, 5\] of the run have not been computed"):
            sol.plot()
        return
    alone = co.integrate(
        co.systems.rigid_body((1, 2, 3)), HALF_STATES[:count], (0, 5), 0.1, attitude=True, save_every=5
    )
    for relative in (True, False):
        for name, drift in sol.drift(relative).items():
            expected = alone.drift(relative)[name]
            assert drift == expected and drift.absolute == expected.absolute
            np.testing.assert_array_equal(drift.members, [*expected.members, np.nan, np.nan])
            assert pickle.loads(pickle.dumps(drift)) == drift
    np.testing.assert_array_equal(sol.error_estimate(), [*alone.error_estimate(), np.nan, np.nan])
    there, expected = sol.at([1.23, 4.9]), alone.at([1.23, 4.9])
    for name in ("x", "energy", "attitude"):
        np.testing.assert_array_equal(getattr(there, name)[:, :count], getattr(expected, name))
        assert np.isnan(getattr(there, name)[:, count:]).all()


def test_pictures_of_half_finished_archives_name_members_that_have_not_run(half_finished):
    sol, count = half_finished
    if count:
        assert "4 of 6 members" in sol.plot(["components"]).get_suptitle()
        assert len(sol.plot(["components"], members=[0, 3]).axes) == 1
        with pytest.raises(ValueError, match=r"attitudes of the members \[4, 5\] are missing"):
            _ = sol.rotation
    for chosen in ([5], [0, 5]):
        numbers = [m for m in chosen if m >= count]
        with pytest.raises(ValueError, match=re.escape(f"members {numbers} of the run have not been computed")):
            sol.plot("components", members=chosen)


def test_errors_at_the_end_of_members_that_have_failed():
    """The others are those of runs alone; the second member escapes at t = 1."""
    escape = co.LiePoissonSystem(
        co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1}}), co.Polynomial("x1*x2", basis=("x1", "x2")), sign=-1
    )
    with pytest.raises(co.IntegrationError) as failure:
        co.integrate(escape, [(1.0, 0.1), (1.0, 1.0)], (0, 2), 0.1, co.GaussLegendre(2))
    found = failure.value.partial.error_estimate()
    alone = co.integrate(escape, (1.0, 0.1), (0, 2), 0.1, co.GaussLegendre(2)).error_estimate()
    np.testing.assert_array_equal(found, [alone, np.nan])


@pytest.mark.parametrize("members", [0, 6])
def test_an_interrupt_before_the_first_step_leaves_an_archive_that_is_free(tmp_path, monkeypatch, members):
    """It comes when the archive has its name, and what was written beside it is removed."""
    path, left = tmp_path / "run.zarr", PendingOutput.__exit__
    body, x0 = co.systems.rigid_body((1, 2, 3)), HALF_STATES[:members] if members else HALF_STATES[0]
    run = co.integrate_ensemble if members else co.integrate

    def interrupted(output, *ended):
        left(output, *ended)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(PendingOutput, "__exit__", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(body, x0, (0, 5), 0.1, archive=path)
    resumed = co.resume(path)
    np.testing.assert_array_equal(resumed.x, co.integrate(body, x0, (0, 5), 0.1).x)
