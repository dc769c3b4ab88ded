"""Contradictions in the metadata of an archive are refused by name before any data is read."""

import json
import os

import numpy as np
import pytest

import coadjoint as co
from coadjoint.files.archives.metadata_checks import as_archive_errors, check_archive
from coadjoint.files.archives.reading import ArchiveError, read_root
from coadjoint.files.archives.resume import archive_run
from coadjoint.runs.prepared_run import PreparedRun

BODY, X = co.systems.rigid_body(inertia=(1, 2, 2.5)), (0.3, -1.0, 0.7)
SPAN, STEP = (7.0, 3.0), 0.125
DAMPED = BODY.with_forces(co.forces.LinearDamping(0.125))
FLUID = co.systems.torus_euler(3)


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """Return arrays and attributes of archives of each kind: backward, with forces, of matrices, and in blocks."""
    folder = tmp_path_factory.mktemp("archives")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "fsync", lambda descriptor: None)
        gauss = co.GaussLegendre(1)
        archive_run(PreparedRun(BODY, gauss, STEP), X, SPAN, 3, folder / "vector", until=13)
        archive_run(PreparedRun(DAMPED, gauss, STEP), [X, X], SPAN[::-1], 2, folder / "forces", until=13)
        co.integrate(FLUID, FLUID.random(seed=1), SPAN, STEP, archive=folder / "matrices")
        co.ensemble(BODY, [X] * 3, SPAN, STEP, archive=folder / "blocks", members_per_block=2)
    return {path.name: (path, *read_root(path)) for path in folder.iterdir()}


def checked(archives, name, change):
    path, arrays, attributes = archives[name]
    arrays, attributes = dict(arrays), dict(attributes)
    change(attributes, arrays)
    check_archive(path, arrays, attributes)


@pytest.mark.parametrize("name", ["vector", "forces", "matrices", "blocks"])
def test_written_metadata_is_accepted(archives, name):
    checked(archives, name, lambda attributes, arrays: None)


def with_array(name, **changed):
    return lambda _, arrays: arrays.update({name: arrays[name]._replace(**changed)})


def with_rows(count):
    """Change the length of all arrays over time."""

    def change(_, arrays):
        for name, each in arrays.items():
            if each.grows:
                arrays[name] = each._replace(shape=(count, *each.shape[1:]))

    return change


def with_states(change):
    def changed(attributes, _):
        found = json.loads(attributes["archive_states"])
        attributes["archive_states"] = json.dumps(change(found))

    return changed


def with_state(**kwargs):
    return with_states(lambda found: [*found[:-1], [*found[-1][:2], {**found[-1][2], **kwargs}]])


def combined(*changes):
    def change(attributes, arrays):
        for each in changes:
            each(attributes, arrays)

    return change


def with_attributes(**kwargs):
    return lambda attributes, arrays: attributes.update(kwargs)


def without_array(name):
    return lambda attributes, arrays: arrays.pop(name)


FAILED = {"run_failed": 1, "failed_step": 3, "failed_time": 0.5, "failed_residual": 0.25, "failed_reason": "overflow"}
CASES = [
    ("vector", with_attributes(seconds=-0.5), "seconds is -0.5"),
    ("vector", with_attributes(seconds=float("nan")), "seconds is nan"),
    ("vector", with_attributes(steps=31), "steps is 31"),
    ("vector", with_attributes(step=0.25), "steps is 32"),
    ("vector", with_attributes(t_span="[7.0, 3.0, 1.0]"), "t_span is"),
    ("vector", with_attributes(archive_steps=33), "steps is 32"),
    ("blocks", with_attributes(archive_steps=33), "steps is 32"),
    ("blocks", with_attributes(archive_steps=31), "archive_steps is 31"),
    ("blocks", with_attributes(archive_block=0), "archive_block is 0"),
    ("vector", with_attributes(save_every=0), "save_every is 0"),
    ("vector", with_attributes(archive_save_every=0), "archive_save_every is 0"),
    ("vector", with_attributes(watch=2), "watch is 2"),
    ("vector", with_attributes(evaluations=-1), "evaluations is -1"),
    ("vector", with_attributes(iterations=0.5), "iterations is 0.5"),
    *(
        ("vector", with_attributes(**{name: 3}), f"{name} is 3")
        for name in ("platform", "system_repr", "archive_first_step")
    ),
    *(
        ("vector", with_attributes(**FAILED | {name: True}), f"{name} is True")
        for name in ("failed_time", "failed_residual")
    ),
    ("vector", with_attributes(**FAILED | {"failed_reason": 3}), "failed_reason is 3"),
    ("vector", with_attributes(**FAILED | {"failed_step": 0.5}), "failed_step is 0.5"),
    ("vector", with_attributes(**FAILED | {"run_failed": 2}), "run_failed is 2"),
    ("vector", with_attributes(archive_given='{"system": {"named": [3]}}'), "archive_given"),
    ("vector", with_attributes(archive_observed='{"names": [3], "stored": {}}'), "archive_observed"),
    ("vector", with_attributes(archive_observed='{"names": [], "stored": []}'), "archive_observed"),
    *(
        ("vector", without_array(name), f"the array {name} is missing")
        for name in ("time", "x", "x0", "energy", "invariant", "tenth", "drift")
    ),
    *(("forces", without_array(name), f"the array {name} is missing") for name in ("work", "change", "balance")),
    ("blocks", without_array("status"), "array over the members is missing"),
    ("vector", with_attributes(archive_accounts='[["damping", "energy"]]'), "the array balance is missing"),
    ("forces", with_attributes(archive_accounts='[["damping", "energy"]]'), "contradicts"),
    ("forces", with_attributes(archive_accounts='[["damping"]]'), "archive_accounts"),
    *(
        ("forces", with_array(name, kind="int64"), f"the array {name} is of int64")
        for name in ("time", "x", "x0", "energy", "work", "change", "balance", "casimir_x_2", "failed", "invariant")
    ),
    ("vector", with_array("drift", kind="int64"), "the array drift is of int64"),
    ("vector", with_array("tenth", kind="float64"), "the array tenth is of float64"),
    ("blocks", with_array("status", kind="float64"), "the array status is of float64"),
    ("vector", with_array("casimir_x_2", attributes={}), "the array casimir_x_2 has no long_name"),
    ("vector", with_array("casimir_x_2", attributes={"long_name": 3}), "the array casimir_x_2 has no long_name"),
    ("vector", with_array("x0", dims=("time",), shape=(3,)), "the array x0 is over time"),
    ("vector", with_array("x", dims=("row", "component"), shape=(5, 3)), "the array x is over row, component"),
    ("vector", with_array("casimir_x_2", dims=("row",)), "the array casimir_x_2 is over row"),
    ("vector", with_array("x", shape=(5, 4)), "along component"),
    ("vector", with_array("x", dims=("time", "row")), "over other dimensions"),
    ("vector", with_array("energy", dims=("time", "component"), shape=(5, 3)), "over other dimensions"),
    ("forces", with_array("energy", dims=("time",), shape=(7,)), "over other dimensions"),
    ("matrices", with_array("x", shape=(33, 3, 4, 2)), "arrays x and x0"),
    ("matrices", combined(with_array("x", shape=(33, 0, 3, 2)), with_array("x0", shape=(0, 3, 2))), "arrays x and x0"),
    (
        "matrices",
        combined(
            with_array("x", shape=(33, 3, 3, 3)), with_array("x0", shape=(3, 3, 3)), with_array("part", shape=(3,))
        ),
        "contradicts",
    ),
    ("vector", combined(with_rows(4), with_state(time=4)), "there are 4 saved points after 13 steps, not 5"),
    ("vector", combined(with_rows(6), with_state(time=6)), "there are 6 saved points after 13 steps, not 5"),
    ("vector", with_rows(4), "list of states"),
    ("vector", with_state(number=12), "list of states"),
    ("vector", with_states(lambda found: []), "list of states"),
    (
        "vector",
        with_states(lambda found: [[*found[-1][:2], {**found[-1][2], "number": n}] for n in (9, 5, 13)]),
        "list of states",
    ),
    ("vector", with_state(block=2), "block"),
    ("vector", with_state(time=-1), "time"),
    ("vector", with_states(lambda found: [[3, *found[-1][1:]]]), "archive_states"),
    ("blocks", with_rows(32), "there are 32 saved points after 32 steps, not 33"),
]


@pytest.mark.parametrize(
    ("name", "change", "message"), CASES, ids=[f"{k} {name}" for k, (name, *_) in enumerate(CASES)]
)
def test_contradiction_is_named(archives, name, change, message):
    with pytest.raises(ArchiveError) as refused:
        checked(archives, name, change)
    assert message in str(refused.value) and "\n" not in str(refused.value)


def test_failed_run_has_points_before_the_failure(archives):
    checked(archives, "vector", combined(with_rows(4), with_state(time=4), with_attributes(**FAILED)))
    with pytest.raises(ArchiveError, match="there are 6 saved points after 13 steps, not 5"):
        checked(archives, "vector", combined(with_rows(6), with_state(time=6), with_attributes(**FAILED)))


@pytest.mark.parametrize(
    "error",
    [ValueError, KeyError, IndexError, TypeError, AttributeError, ZeroDivisionError, RecursionError, MemoryError],
)
def test_errors_of_damaged_content_are_wrapped(error):
    with pytest.raises(ArchiveError, match=r"^run.zarr: .*damaged \((first second|\w+)\)$"):
        with as_archive_errors("run.zarr"):
            raise error("first\nsecond") if error is not KeyError else error
    for other in (ArchiveError("a"), co.IntegrationError("a", step=1, time=0.0, residual=0.0), OSError("a")):
        with pytest.raises(type(other), match="a"), as_archive_errors("run.zarr"):
            raise other


def test_state_shapes_match_the_invariants(tmp_path):
    """A state of another run with a matching digest is refused when the archive is opened."""
    archive_run(PreparedRun(DAMPED, co.GaussLegendre(1), STEP), [X, X], SPAN[::-1], 2, tmp_path / "run", until=13)
    from coadjoint.files.archives.archived_run import states_of
    from coadjoint.files.archives.archived_solution import REPORTED_ARRAYS
    from coadjoint.files.archives.metadata_checks import check_reported
    from coadjoint.files.archives.reading import read_state

    arrays, attributes = read_root(tmp_path / "run")
    stored = read_state(tmp_path / "run", states_of(attributes)[-1])
    check_reported(stored, arrays)
    for name in REPORTED_ARRAYS:
        values = stored[name]
        for other in (values[:1], values[..., :1], np.float32(values), values[..., None], np.zeros(())):
            with pytest.raises(ValueError, match=f"{name} of the state has the shape"):
                check_reported({**stored, name: other}, arrays)
