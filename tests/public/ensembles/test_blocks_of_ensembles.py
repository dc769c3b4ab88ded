"""Ensembles in blocks: members, interruption and resumption, damaged blocks, failed members, and coordinates."""

import errno
import gc
import json
import os
import pickle
import shutil
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import xarray

import coadjoint as co
from hostile_archives import edit_attributes
from own_schemes import NOTHING
from refusals import refused
from same_runs import check_same

BODY = co.systems.rigid_body(inertia=(1, 2, 3))
X = np.random.default_rng(3).standard_normal((11, 3))
SPAN, STEP = (7.5, 3.5), 0.125
HIDDEN = ".coadjoint"
pytestmark = pytest.mark.usefixtures("no_fsync")


def ensemble(path, x0=X, span=SPAN, size=4, **options):
    return co.integrate_ensemble(BODY, x0, span, STEP, archive=path, members_per_block=size, **options)


def test_blocks_of_one_system_have_the_noise_of_their_members():
    """Equal states, so that members differ by their noise alone."""
    stirred, states = BODY.with_forces(co.forces.HeatBath(0.1, temperature=0.5, seed=1)), np.tile(X[0], (8, 1))
    found = co.integrate_ensemble(stirred, states, (0, 1), STEP, members_per_block=3)
    np.testing.assert_array_equal(found.x, co.integrate(stirred, states, (0, 1), STEP).x)
    assert len(np.unique(found.x[-1], axis=0)) == 8


@pytest.mark.parametrize("rate", [[0.2, 0.1, 0.3], 0.2 * np.eye(3) + 0.01], ids=["diagonal", "matrix"])
def test_a_check_of_the_step_changes_no_bits_of_the_blocks(rate):
    """The check rounds up; what a thread keeps for the next call is computed in substeps of two lengths."""
    damped = co.systems.gyrostat().with_forces(co.forces.Torque((0.01, 0.02, 0.03)), co.forces.LinearDamping(rate))
    scheme = co.methods.even_order(co.GaussLegendre(1), 4)
    found = co.integrate_ensemble(damped, X[:3], (0, 3), 0.25, scheme)
    np.testing.assert_array_equal(found.x, co.integrate(damped, X[:3], (0, 3), 0.25, scheme).x)


class Stop:
    """Writing fails at a file of an archive, the first time or later; the names of those that were written."""

    def __init__(self, patched, name, error, after=0):
        self.written, self.error, self.after = [], error, after
        self.patched, self.name, self.replace = patched, name, os.replace

    def __enter__(self):
        self.context = self.patched.context()
        self.context.__enter__().setattr(os, "replace", self.replaced)
        return self

    def replaced(self, source, target, **folders):
        name = os.path.basename(target)
        if name == self.name and self.written.count(name) == self.after:
            raise self.error
        self.replace(source, target, **folders)
        self.written.append(name)

    def __exit__(self, *ended):
        self.context.__exit__(*ended)


def marker(number):
    return f"block-{number:06d}"


def begun(path, monkeypatch, number, chunk=0, **options):
    """Interrupt an ensemble when a chunk of a block is written; return the archive."""
    with Stop(monkeypatch, f"c.{chunk}.{number}.0", KeyboardInterrupt()), pytest.raises(KeyboardInterrupt) as stopped:
        ensemble(path, **options)
    return stopped.value.partial


def test_blocks_have_the_systems_of_their_members():
    """Systems recur in another order in each block, whose tables are built for its own noise."""
    owners = (0, 1, 2, 3, 1, 3, 0, 2, 3, 2, 0)
    bodies = [co.systems.rigid_body(inertia=(1, 2, 2 + 0.0625 * k)) for k in (0, 4, 8, 2)]
    noise = co.forces.HeatBath(0.3, temperature=0.5, seed=4, stream=3)
    distinct = [body.with_forces(noise) for body in bodies]
    found = co.integrate_ensemble(co.batch([distinct[k] for k in owners]), X, (0, 2), STEP, members_per_block=4)
    for m, k in enumerate(owners):
        alone = bodies[k].with_forces(replace(noise, stream=noise.stream + m))
        np.testing.assert_array_equal(found.x[:, m], co.integrate(alone, X[m], (0, 2), STEP).x)


def test_members_have_attitudes_of_their_own(tmp_path):
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = np.stack([np.linalg.matrix_power(quarter, k) for k in range(11)])
    check_same(ensemble(tmp_path / "many", attitude=turned), co.integrate(BODY, X, SPAN, STEP, attitude=turned))


@pytest.mark.parametrize("span", [(2.0, -1.0), (1.0, 1.0)])
@pytest.mark.parametrize("size", [None, 1, 4, 11])
def test_backward_and_empty_spans_in_blocks_of_any_size(span, size):
    found = co.integrate_ensemble(BODY, X, span, 0.25, members_per_block=size)
    assert found.finished and (found.status == 1).all()
    check_same(found, co.integrate(BODY, X, span, 0.25))


@pytest.mark.parametrize(
    ("number", "options"),
    [(0, {}), (1, {"attitude": True, "observe": {"first": co.Polynomial({(1, 0, 0): 1})}}), (2, {"save_every": 5})],
)
def test_second_call_computes_the_missing_blocks(tmp_path, monkeypatch, number, options):
    """Or `resume`; finished blocks are not computed again, nor is an ensemble that is finished."""
    path = tmp_path / "many.zarr"
    partial = begun(path, monkeypatch, number, **options)
    assert partial.status.tolist() == [1] * 4 * number + [0] * (11 - 4 * number) and not partial.finished
    assert partial.progress_text == f"{4 * number} of 11 members" and partial.progress_text in repr(partial)
    expected = co.integrate(BODY, X, SPAN, STEP, **options)
    for again in (lambda: ensemble(path, **options), lambda: co.resume(path)):
        with Stop(monkeypatch, "none", None) as watched:
            check_same(again(), expected)
        markers = [name for name in watched.written if name.startswith("block-")]
        assert markers == (
            [] if co.open_archive(path).finished and number == 3 else [marker(k) for k in range(number, 3)]
        )
        number = 3
    assert not list((path / HIDDEN).glob("*.lock")), "locks of blocks are removed at the end"


ROWS = 43690
LONG = (0.0, 100_000 * STEP)
"""A run of three chunks: 4 MB have so many points of four members."""


@cache
def long_run():
    return co.integrate(BODY, X, LONG, STEP)


@pytest.mark.parametrize(("number", "chunk"), [(0, 1), (1, 2), (2, 1)])
@pytest.mark.thinned(2)
def test_block_resumes_from_its_marker(tmp_path, monkeypatch, number, chunk):
    """Committed points are read, the others are NaN."""
    path, expected, done = tmp_path / "many.zarr", long_run(), ROWS * chunk
    partial = begun(path, monkeypatch, number, chunk, span=LONG)
    for found in (partial, co.load(path)):
        assert not found.finished and found.reached == (0 if number < 2 else done - 1)
        for k in range(3):
            own, rows = slice(4 * k, min(4 * k + 4, 11)), 100_001 if k < number else done if k == number else 0
            for x in (found.x, found.to_xarray()["x"].values):
                np.testing.assert_array_equal(x[:rows, own], expected.x[:rows, own])
                assert np.isnan(x[rows:, own]).all()
            assert (found.status[own] == (k < number)).all()
    with Stop(monkeypatch, "none", None) as watched:
        resumed = co.resume(path)
    check_same(resumed, expected)
    assert resumed.stats.seconds > partial.stats.seconds > 0.0
    assert watched.written.count(marker(number)) == 3 - chunk, "it goes on from the last marker"


def test_chunks_without_a_marker_are_overwritten(tmp_path, monkeypatch):
    """A worker was killed between writing its chunks and its marker, which has another state."""
    path = tmp_path / "many.zarr"
    begun(path, monkeypatch, 0, 1, span=LONG)
    held = (path / HIDDEN / marker(0)).read_bytes()
    begun(path, monkeypatch, 0, 2, span=LONG)
    assert (path / HIDDEN / marker(0)).read_bytes() != held
    (path / HIDDEN / marker(0)).write_bytes(held)
    check_same(ensemble(path, span=LONG), long_run())


@pytest.mark.parametrize(
    "what", ["marker", "numbers", "no marker", "energy/c.0.1", "drift/c.1.0.0", "failed/c.1", "folder"]
)
def test_damaged_blocks_are_computed_again(tmp_path, monkeypatch, what):
    path = tmp_path / "many.zarr"
    ensemble(path)
    file = path / HIDDEN / marker(1)
    if what == "marker":
        file.write_bytes(file.read_bytes().replace(b'"failed": 0', b'"failed": 4'))
    elif what == "numbers":
        # Its first line is intact and marks the block as finished; its numbers have the checksums of the chunks.
        file.write_bytes(file.read_bytes()[:-1] + b"x")
    elif what == "no marker":
        file.unlink()
    elif "/" in what:
        (path / what).unlink()
    else:
        for chunk in (path / "x").glob("c.*"):
            chunk.unlink()
    with Stop(monkeypatch, "none", None) as watched:
        check_same(ensemble(path), co.integrate(BODY, X, SPAN, STEP))
    ran = [k for k in range(3) if marker(k) in watched.written]
    assert ran == ([0, 1, 2] if what == "folder" else [1])


# [e1, e2] = e2 with H = x1 gives x2' = x2: it overflows where it begins large.
GROWING = co.LiePoissonSystem(
    co.LieAlgebra.from_brackets(2, {(0, 1): {1: 1.0}}), co.Quadratic(0.0, linear=[1.0, 0.0]), sign=-1
)


@pytest.mark.thinned(4)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("failing", [{2, 3}, {0, 4}, {0, 1, 2, 3, 4}], ids=str)
@pytest.mark.parametrize("members_per_block", [1, 3, 5])
def test_failed_members_leave_the_others(tmp_path, failing, members_per_block):
    x0 = np.array([[1.0, 1e290 * (1 + m) if m in failing else 1.0 + m] for m in range(5)])
    run, given = (GROWING, x0, (0, 100), 0.5), {"archive": tmp_path / "many", "members_per_block": members_per_block}
    with pytest.raises(co.IntegrationError) as expected:
        co.integrate(*run)
    for _ in range(2):
        with refused(co.IntegrationError, f"{len(failing)} of 5 members", f"member {min(failing)}") as error:
            co.integrate_ensemble(*run, **given)
        for name in ("step", "time", "residual"):
            np.testing.assert_equal(getattr(error.value, name), getattr(expected.value, name))
        found, reference = error.value.partial, expected.value.partial
        assert found.finished and found.stats.steps == reference.stats.steps
        np.testing.assert_array_equal(found.failed, [m in failing for m in range(5)])
        np.testing.assert_array_equal(found.status, [1 + (m in failing) for m in range(5)])
        np.testing.assert_array_equal(found.x, reference.x)
    assert co.open_archive(tmp_path / "many").to_xarray()["status"].attrs["flag_meanings"] == "not_computed done failed"


def test_work_of_blocks_is_added(tmp_path):
    """Of blocks with different work."""
    x0 = X * np.geomspace(0.1, 2.0, len(X))[:, None]
    found = ensemble(tmp_path / "many", x0, method=co.GaussLegendre(2))
    expected = co.integrate(BODY, x0, SPAN, STEP, co.GaussLegendre(2))
    assert found.stats.evaluations == found.attributes["evaluations"] == expected.stats.evaluations
    assert found.stats.iterations == found.attributes["iterations"] == expected.stats.iterations
    lines = [(tmp_path / "many" / HIDDEN / marker(k)).read_bytes().split(b"\n")[0] for k in range(3)]
    heads = [json.loads(line.partition(b" ")[2])["about"] for line in lines]
    assert len({head["iterations"] / size for head, size in zip(heads, (4, 4, 3), strict=True)}) == 3
    for name in ("evaluations", "iterations", "seconds"):
        # Seconds are added in another order.
        assert getattr(found.stats, name) == pytest.approx(sum(head[name] for head in heads), rel=1e-12)
    assert found.attributes["seconds"] == pytest.approx(found.stats.seconds, rel=1e-12)


@pytest.mark.thinned(3)
@dataclass(frozen=True)
class Unregistered(co.methods.StepMethod):
    """A scheme of a user, which no file can name."""

    order, explicit, symmetric = 2, True, False

    def properties(self, system):
        return NOTHING

    def step(self, system, x, t, h):
        first = h * system.vector_field(x, t)
        return x + 0.5 * (first + h * system.vector_field(x + first, t + h))


def test_schemes_that_are_not_registered_have_the_drift_of_their_runs():
    """Deviations are relative to the sizes of invariants, which the system has, whatever the scheme."""
    top = co.systems.heavy_top()
    states = np.random.default_rng(3).uniform(-0.9, 0.9, (3, 6))
    found = co.integrate_ensemble(top, states, (0.0, 1.5), 0.125, Unregistered(), members_per_block=2)
    whole = co.integrate(top, states, (0.0, 1.5), 0.125, Unregistered())
    assert found.system.name == top.name
    for name, drift in whole.drift().items():
        assert np.array_equal(found.drift()[name].tenths, drift.tenths), name
        assert np.array_equal(found.drift()[name].scale, drift.scale), name


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.EIO, "broken"), MemoryError(), SystemExit()])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_temporary_archive_lives_as_long_as_the_partial_result(tmp_path, monkeypatch, error, number):
    """After an interrupt; after other errors it is removed."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with Stop(monkeypatch, f"c.0.{number}.0", error), pytest.raises(type(error)) as stopped:
        co.integrate_ensemble(BODY, X, (0, 1), STEP, members_per_block=4)
    partial = getattr(stopped.value, "partial", None)
    assert (partial is None) == (not isinstance(error, KeyboardInterrupt))
    if partial is not None:
        expected = co.integrate(BODY, X, (0, 1), STEP)
        np.testing.assert_array_equal(partial.x0, X)
        np.testing.assert_array_equal(partial.x[:, : 4 * number], expected.x[:, : 4 * number])
        check_same(co.resume(partial.path), expected)
        error.__dict__.clear()
    error.with_traceback(None).__cause__ = error.__context__ = None
    del stopped, partial
    gc.collect()
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_temporary_archive_is_removed_with_its_solution(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    found = co.integrate_ensemble(BODY, X, (0, 1), STEP)
    assert found.path.is_dir() and found.x.shape == (9, 11, 3)
    del found
    with pytest.raises(co.IntegrationError) as failed:
        co.integrate_ensemble(GROWING, [[1.0, 1e300]], (0, 100), 0.5)
    assert failed.value.partial.failed.all()
    del failed
    with refused(ValueError, "step 0.3"):
        co.integrate_ensemble(BODY, X, (0, 1), 0.3)
    gc.collect()
    assert not list(tmp_path.iterdir())


# Errors of disks.


@pytest.mark.thinned(3)
@pytest.mark.parametrize(("size", "number"), [(1, 0), (1, 10), (3, 1), (3, 3), (4, 0), (11, 0)])
@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device"),
        (OSError("the disk is asleep"), "the disk is asleep"),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "c.0"), "No such file or directory"),
    ],
)
def test_members_of_an_unwritten_block_are_named(tmp_path, monkeypatch, size, number, error, said):
    """The archive lacks these and the later ones, which were not begun."""
    path, first, last = tmp_path / "many.zarr", size * number, min(size * (number + 1), 11) - 1
    with Stop(monkeypatch, marker(number), error), refused(OSError, path, f"{first} to {last}", said) as unwritten:
        ensemble(path, size=size)
    assert unwritten.value.__cause__ is error and unwritten.value.partial is None
    done = co.open_archive(path).status == 1
    assert done[:first].all() and not done[last + 1 :].any()
    check_same(ensemble(path, size=size), co.integrate(BODY, X, SPAN, STEP))


def move(path):
    path.rename(path.with_name("aside"))


def replace_by_copy(path):
    move(path)
    shutil.copytree(path.with_name("aside"), path)


@pytest.mark.parametrize("change", [move, replace_by_copy, shutil.rmtree])
@pytest.mark.parametrize("number", [0, 1])
def test_archive_moved_between_blocks(tmp_path, monkeypatch, change, number):
    """Nothing is written to the new content of the path."""
    path, replaced = tmp_path / "many.zarr", os.replace

    def then(source, target, **folders):
        replaced(source, target, **folders)
        if os.path.basename(target) == marker(number) and not (tmp_path / "aside").exists():
            change(path)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", then)
        with refused(OSError, path, *(["moved or replaced"] if change is not shutil.rmtree else [])):
            ensemble(path)
    assert not (path / HIDDEN / marker(number + 1)).exists()
    if change is not shutil.rmtree:
        check_same(ensemble(tmp_path / "aside"), co.integrate(BODY, X, SPAN, STEP))


def test_ensemble_that_cannot_be_marked_as_finished(tmp_path, monkeypatch):
    """All members are present, and the next call computes none."""
    path, replaced = tmp_path / "many.zarr", os.replace

    def full(source, target, **folders):
        if (path / HIDDEN / marker(2)).exists():
            raise OSError(errno.ENOSPC, "No space left on device")
        replaced(source, target, **folders)

    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", full)
        with refused(OSError, path, "No space left on device", "continues"):
            ensemble(path)
    found = co.open_archive(path)
    assert found.status.tolist() == [1] * 11 and found.attributes["archive_finished"] == 0
    with Stop(monkeypatch, marker(0), AssertionError("a block is run again")):
        check_same(ensemble(path), co.integrate(BODY, X, SPAN, STEP))
    assert co.open_archive(path).attributes["archive_finished"] == 1


@pytest.mark.parametrize("how", ["missing", "damaged", "folder", "lock"])
def test_obstacles_to_a_block_are_named(tmp_path, monkeypatch, how):
    """Initial states that cannot be read, and a lock that is a link, which is not followed."""
    path = tmp_path / "many.zarr"
    begun(path, monkeypatch, 1)
    file, error, named = path / "x0" / "c.1.0", ValueError, ("x0/c.1.0",)
    if how == "lock":
        file, error, named = path / HIDDEN / f"{marker(1)}.lock", OSError, (path, "members 4 to 7", "symbolic link")
    content = None if how == "lock" else file.read_bytes()
    file.unlink(missing_ok=True)
    if how == "damaged":
        file.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    elif how == "folder":
        file.mkdir()
    elif how == "lock":
        file.symlink_to(tmp_path / "elsewhere")
    with refused(error, *named):
        co.resume(path)
    assert os.listdir(tmp_path) == ["many.zarr"]
    file.rmdir() if how == "folder" else file.unlink(missing_ok=True)
    if content:
        file.write_bytes(content)
    check_same(co.resume(path), co.integrate(BODY, X, SPAN, STEP))


# Results of some members.


def test_results_of_members_that_have_run(tmp_path, monkeypatch):
    """Drifts, errors and states between the saved ones are those of these members alone."""
    sol = begun(tmp_path / "half", monkeypatch, 1, attitude=True, save_every=5)
    alone, rest = co.integrate(BODY, X[:4], SPAN, STEP, attitude=True, save_every=5), [np.nan] * 7
    for relative in (True, False):
        for name, drift in sol.drift(relative).items():
            expected = alone.drift(relative)[name]
            assert drift == expected and drift.absolute == expected.absolute
            np.testing.assert_array_equal(drift.members, [*expected.members, *rest])
            assert pickle.loads(pickle.dumps(drift)) == drift
    np.testing.assert_array_equal(sol.error_estimate(), [*alone.error_estimate(), *rest])
    there, expected = sol.at([7.3, 3.6]), alone.at([7.3, 3.6])
    for name in ("x", "energy", "attitude"):
        np.testing.assert_array_equal(getattr(there, name)[:, :4], getattr(expected, name))
        assert np.isnan(getattr(there, name)[:, 4:]).all()
    assert "4 of 11 members" in sol.plot(["components"]).get_suptitle()
    assert len(sol.plot(["components"], members=[0, 3]).axes) == 1
    with refused(ValueError, "[4, 5, 6, 7, 8, 9, 10]"):
        _ = sol.rotation
    for chosen, missing in (([5], [5]), ([0, 5], [5])):
        with refused(ValueError, missing):
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


# Coordinates along the members.


def test_coordinates_along_the_members(tmp_path):
    third = np.linspace(2.0, 3.0, 11)
    ensemble(tmp_path / "many", coordinates={"third": third})
    with xarray.open_zarr(tmp_path / "many") as plain:
        assert "third" in plain.coords
        np.testing.assert_array_equal(plain["third"], third)
        assert plain["energy"].swap_dims(member="third").sel(third=2.5).shape == (33,)


def test_reserved_coordinate_names_are_refused(tmp_path):
    """Variables and dimensions of any run are reserved, also if this run has none of them."""
    fluid, damped = co.systems.sphere_euler(3), BODY.with_forces(co.forces.LinearDamping(0.1))
    options = {"attitude": True, "observe": {"q": co.Polynomial({(1, 1, 0): 1.0})}, "events": [co.Event("x2")]}
    runs = [
        co.integrate(damped, X[:2], (0, 1), STEP, co.GaussLegendre(2), **options),
        co.integrate(fluid, [fluid.random(seed=1)], (0, 1), STEP),
        co.integrate_ensemble(BODY, X[:2], (0, 1), STEP),
    ]
    datasets = [sol.to_xarray(grid=False) for sol in runs]
    names = {str(name) for data in datasets for name in (*data.variables, *data.dims)} - {"member"}
    assert {"drift", "change", "work", "attitude0", "observed_q", "event_x", "part", "crossing", "status"} < names
    for name in (*names, "layer", "casimir_", "observed_rate", "event_rate"):
        with refused(ValueError, f"'{name}'", "reserved"):
            co.integrate_ensemble(
                BODY, X, (0, 1), STEP, archive=tmp_path / "many.zarr", coordinates={"a": X[:, 0], name: X[:, 1]}
            )
    assert not list(tmp_path.iterdir())
    others = {name: X[:, k % 3] for k, name in enumerate(("rate", "casimirs", "event", "observed", "member", "rows"))}
    found = co.integrate_ensemble(BODY, X, (0, 1), STEP, archive=tmp_path / "many.zarr", coordinates=others)
    found.to_xarray().to_netcdf(tmp_path / "many.nc", engine="h5netcdf")
    for again in (co.open_archive(tmp_path / "many.zarr"), co.load(tmp_path / "many.nc")):
        data = again.to_xarray()
        for name, numbers in others.items():
            assert name in data.coords and np.array_equal(data[name], numbers), name
        assert again.drift() == found.drift()


# Refusals.


@pytest.mark.thinned(3)
@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"x0": X + 1e-15}, "x0"),
        ({"x0": X[:10]}, "x0"),
        ({"system": co.systems.rigid_body(inertia=(1, 2, 2.5))}, "the system"),
        ({"t_span": (0, 8)}, "t_span"),
        ({"step": 0.25}, "the step"),
        ({"method": co.Splitting(order=4)}, "the scheme"),
        ({"save_every": 2}, "save_every"),
        ({"watch": False}, "watch"),
        ({"attitude": True}, "the initial attitude"),
        ({"observe": {"first": co.Polynomial({(1, 0, 0): 1})}}, "observe"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_another_ensemble_is_refused(tmp_path, change, named):
    path, given = tmp_path / "many.zarr", {"system": BODY, "x0": X, "t_span": (0, 4), "step": STEP}
    co.integrate_ensemble(**given, archive=path)
    before = sorted(path.name for path in path.rglob("*"))
    with refused(ValueError, "another ensemble", named, "differs"):
        co.integrate_ensemble(**{**given, **change}, archive=path)
    assert sorted(path.name for path in path.rglob("*")) == before


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"coadjoint_version": "0.0.1"}, "the version of coadjoint"),
        ({"archive_first_step": "0"}, "the first step"),
        ({"sign": -BODY.sign}, "the sign of the system"),
        ({"archive_observed": '{"names": [], "stored": {"more": 1}}'}, "observe"),
    ],
)
def test_hidden_differences_are_refused(tmp_path, changed, named):
    path = tmp_path / "many.zarr"
    ensemble(path)
    edit_attributes(path, **changed)
    with refused(ValueError, "another ensemble", named, "differs"):
        ensemble(path)


@pytest.mark.parametrize("member", [0, 5, 10])
def test_difference_in_one_member_is_refused(tmp_path, member):
    """The last bit or the sign of a zero, in any block; and another kind of attitude."""
    path, x0 = tmp_path / "many.zarr", X.copy()
    x0[:, 2] = 0.0
    ensemble(path, x0, attitude=True)
    nearest, negative, turned = x0.copy(), x0.copy(), np.tile(np.eye(3), (11, 1, 1))
    nearest[member, 1] = np.nextafter(nearest[member, 1], 9.0)
    negative[member, 2] = -0.0
    turned[member] = np.diag([-1.0, -1.0, 1.0])
    for other, attitude, named in (
        (nearest, True, "x0"),
        (negative, True, "x0"),
        (x0, turned, "the initial attitude"),
        (x0, "coadjoint", "the attitude"),
    ):
        with refused(ValueError, "another ensemble", f"{named} differs"):
            ensemble(path, other, attitude=attitude)
    assert ensemble(path, x0, attitude=True).finished


def test_functions_that_are_not_stored_are_compared(tmp_path):
    def system(factor):
        H = co.Separable({0: (lambda y: factor * np.cos(y), lambda y: -factor * np.sin(y))})
        return co.LiePoissonSystem(co.algebras.so(3), H, name="mine")

    path = tmp_path / "many.zarr"
    first = co.integrate_ensemble(system(1.0), X, (0, 4), STEP, archive=path)
    check_same(co.integrate_ensemble(system(1.0), X, (0, 4), STEP, archive=path), first)
    with refused(ValueError, "functions of system"):
        co.integrate_ensemble(system(1.5), X, (0, 4), STEP, archive=path)


@pytest.mark.skipif(os.name == "nt", reason="locks of files")
def test_concurrent_calls_are_refused(tmp_path, monkeypatch):
    """The archive is locked while blocks are run, and each block too."""
    import fcntl

    path = tmp_path / "many.zarr"
    begun(path, monkeypatch, 1)
    for file, error, named in (
        ("lock", ValueError, "another process is writing"),
        (f"{marker(1)}.lock", OSError, "another process is still running"),
    ):
        with open(path / HIDDEN / file, "a") as held:
            fcntl.flock(held, fcntl.LOCK_EX)
            with refused(error, path, named):
                ensemble(path)
    check_same(ensemble(path), co.integrate(BODY, X, SPAN, STEP))
