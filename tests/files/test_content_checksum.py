"""Checksums of datasets depend on every entry, name and attribute, and not on the memory layout."""

import random
import signal
from contextlib import nullcontext

import numpy as np
import pytest
import xarray
from configuration_files import GROWING, READY_MADE

import coadjoint as co
from coadjoint import cli
from coadjoint.files.configuration.configuration import Configuration
from coadjoint.files.configuration.loading import load as load_configuration
from coadjoint.files.datasets.content_checksum import CHECKSUM, checksum_of, with_checksum
from coadjoint.files.datasets.export import mark_failed
from coadjoint.files.output.output_files import write_dataset
from coadjoint.interruption import Interrupted

PIECE, LENGTH = 4, 11
VALUES = {
    "number": np.arange(LENGTH) / 8 - 1.0,
    "single": np.arange(LENGTH, dtype=np.float32) / 8 - 1,
    "whole": np.arange(LENGTH) - 5,
    "flag": np.arange(LENGTH) % 3 == 0,
    "text": np.array([f"é{k}" for k in range(LENGTH)]),
    "object": np.array([f"o{k}" for k in range(LENGTH)], dtype=object),
}
GOLDEN = "584d1ae2b3b215769cdf3b7491e68a4c1b3a6bbd611c75beca1670ed5fbe0405"


def dataset(**changed):
    found = VALUES | changed
    return xarray.Dataset({name: ("time", values) for name, values in found.items()}, attrs={"step": 0.125})


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr("coadjoint.files.datasets.content_checksum.BUFFER_BYTES", PIECE)


@pytest.mark.parametrize("name", VALUES)
def test_checksum_depends_on_every_entry(name):
    """In the first piece, the following ones, and the shorter last one."""
    sums = [checksum_of(dataset())]
    for index in range(LENGTH):
        values = VALUES[name].copy()
        kind = values.dtype.kind
        values[index] = (
            not values[index] if kind == "b" else values[index] + 1 if kind == "i" else
            np.nextafter(values[index], values.dtype.type(9)) if kind == "f" else "z"
        )  # fmt: skip
        sums.append(checksum_of(dataset(**{name: values})))
    assert len(set(sums)) == LENGTH + 1


@pytest.mark.parametrize("name", VALUES)
def test_checksum_depends_on_the_order(name):
    assert checksum_of(dataset(**{name: VALUES[name][::-1]})) != checksum_of(dataset())


def test_checksum_depends_on_names_types_and_attributes():
    first = dataset()
    square = xarray.Dataset({"x": (("row", "column"), np.zeros((2, 3)))})
    others = [
        first.rename(number="numbers"),
        first.rename(time="times"),
        first.drop_vars("flag"),
        first.assign(number=first["number"].astype("float32")),
        first.assign(whole=first["whole"].astype("float64")),
        first.assign(flag=first["flag"].astype("int64")),
        first.assign_attrs(step=0.25),
        first.assign_attrs(more=0.125),
        first.assign(number=first["number"].assign_attrs(units="1")),
        square,
        square.transpose(),
        xarray.Dataset({"x": (("column", "row"), np.zeros((2, 3)))}),
        xarray.Dataset({"x": (("row", "column"), np.zeros((1, 6)))}),
    ]
    sums = [checksum_of(each) for each in (first, *others)]
    assert len(set(sums)) == len(sums)


def test_checksum_ignores_memory_layout():
    """Byte order, strides, width of integers, order of variables, and text as bytes."""
    wanted = checksum_of(dataset())
    swapped = {
        name: VALUES[name].astype(VALUES[name].dtype.newbyteorder(">")) for name in ("number", "single", "whole")
    }
    strided = {name: np.repeat(values, 2)[::2] for name, values in VALUES.items()}
    narrow = {"whole": VALUES["whole"].astype("int8")}
    text = {"text": np.array([each.encode() for each in VALUES["text"]])}
    for changed in (swapped, strided, narrow, text):
        assert checksum_of(dataset(**changed)) == wanted
    first = dataset()
    assert checksum_of(first[sorted(first, reverse=True)]) == wanted
    matrix = np.arange(15.0).reshape(5, 3)
    sums = {checksum_of(xarray.Dataset({"x": (("a", "b"), np.array(matrix, order=order))})) for order in "CF"}
    assert len(sums) == 1


def test_checksum_of_earlier_versions(monkeypatch):
    monkeypatch.undo()
    assert checksum_of(dataset()) == GOLDEN


def test_checksum_is_updated_with_attributes():
    once = with_checksum(dataset())
    assert once.attrs[CHECKSUM] == checksum_of(once) == checksum_of(dataset())
    error = co.IntegrationError("overflow", step=3, time=0.25, residual=0.5)
    marked = mark_failed(once, error)
    assert marked.attrs[CHECKSUM] == checksum_of(marked) != once.attrs[CHECKSUM]
    failure = {name: marked.attrs[name] for name in ("run_failed", "failed_step", "failed_time", "failed_residual")}
    assert failure == {"run_failed": 1, "failed_step": 3, "failed_time": 0.25, "failed_residual": 0.5}
    assert marked.attrs["failed_reason"] == str(error)


CONFIGURED = """
[system]
name = "heavy_top"
[initial]
x = [[0.1, 0.3, 2.0, 0.6, 0.0, 0.8], [0.2, -0.3, 1.5, 0.0, 0.6, 0.8]]
attitude = true
[method]
name = "Splitting"
order = 4
[run]
t_span = [0.5, 2.0]
step = 0.125
save_every = 2
[observe]
"x1 x2" = "x1*x2"
"""
SWEPT = READY_MADE + '[sweep.over]\n"system.parameters.inertia[2]" = [2.25, 2.5, 2.75]\n'
COMMANDS = {"members": (CONFIGURED, 0), "sweep": (SWEPT, 0), "failure": (GROWING, 1), "interrupt": (CONFIGURED, 130)}
ENGINE = {"nc": "h5netcdf", "zarr": "zarr"}


def write_by_command(text, status, path, monkeypatch):
    (path.parent / "run.toml").write_text(text)
    with monkeypatch.context() as patch:
        if status == 130:
            interrupt = Interrupted(signal.SIGINT)
            interrupt.partial = load_configuration(path.parent / "run.toml").integrate()
            patch.setattr(Configuration, "integrate", lambda *args, **kwargs: (_ for _ in ()).throw(interrupt))
        assert cli.main(["run", str(path.parent / "run.toml"), "--out", str(path), "--quiet"]) == status


def another(value):
    """Return a different value; floats may be NaN, or too large for a sum to differ."""
    if isinstance(value, str):
        return f"{value}z"
    if isinstance(value, bool | np.bool_):
        return not value
    return value + 1 if isinstance(value, int | np.integer) else 0.375


def single_changes(found):
    """Yield datasets with one change each: the last entry of a variable, or an attribute."""
    for name in found.variables:
        numbers = found[name].dtype.kind in "iubf"
        values = found[name].values.copy() if numbers else found[name].values.astype(object)
        values[(-1,) * values.ndim] = another(values[(-1,) * values.ndim])
        other = {name: (found[name].dims, values, found[name].attrs)}
        yield name, found.assign_coords(other) if name in found.coords else found.assign(other)
    for name in [name for name in found.attrs if name != CHECKSUM]:
        yield name, found.assign_attrs({name: f"{found.attrs[name]} "})


@pytest.mark.thinned(8)
@pytest.mark.parametrize("suffix", ENGINE)
@pytest.mark.parametrize("command", COMMANDS)
def test_changed_files_of_the_command_are_refused(tmp_path, monkeypatch, command, suffix):
    """All changes have different checksums; a random one of them is loaded."""
    monkeypatch.undo()
    path = tmp_path / f"run.{suffix}"
    write_by_command(*COMMANDS[command], path, monkeypatch)
    with xarray.open_dataset(path, engine=ENGINE[suffix]) as opened:
        found = opened.load()
    assert co.load(path).x.shape == found["x"].shape
    changes = dict(single_changes(found))
    assert len({found.attrs[CHECKSUM], *map(checksum_of, changes.values())}) == len(changes) + 1
    drawn = list(changes)[random.Random(f"{command} {suffix}").randrange(len(changes))]
    monkeypatch.setattr(xarray, "open_dataset", lambda *args, **options: nullcontext(changes[drawn]))
    with pytest.raises(ValueError, match="checksum"):
        co.load(path)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("suffix", ENGINE)
@pytest.mark.parametrize("stale", [{}, {CHECKSUM: "0" * 64}, {CHECKSUM: GOLDEN}], ids=["none", "of nothing", "another"])
def test_files_have_the_checksum_of_their_content(tmp_path, suffix, stale):
    """Whatever checksum the dataset had; files have no types of their own for text and flags."""
    first = dataset().drop_vars("object").assign_attrs(step=0.25, **stale)
    write_dataset(first, tmp_path / f"run.{suffix}")
    with xarray.open_dataset(tmp_path / f"run.{suffix}", engine=ENGINE[suffix]) as found:
        assert found.attrs[CHECKSUM] == checksum_of(found) != GOLDEN
        changed = found.load().assign(number=found["number"] + 1.0)
    assert checksum_of(changed) != changed.attrs[CHECKSUM]
