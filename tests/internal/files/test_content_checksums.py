"""Checksums of datasets depend on every entry, name and attribute, and not on the memory layout."""

import numpy as np
import pytest
import xarray

import coadjoint as co
from coadjoint.files.datasets import variables
from coadjoint.files.datasets.writers import checksum_of

PIECE, LENGTH = 4, 11
VALUES = {
    "number": np.arange(LENGTH) / 8 - 1.0,
    "single": np.arange(LENGTH, dtype=np.float32) / 8 - 1,
    "whole": np.arange(LENGTH) - 5,
    "flag": np.arange(LENGTH) % 3 == 0,
    "text": np.array([f"é{k}" for k in range(LENGTH)]),
    "object": np.array([f"o{k}" for k in range(LENGTH)], dtype=object),
}


def dataset(**changed):
    found = VALUES | changed
    return xarray.Dataset({name: ("time", values) for name, values in found.items()}, attrs={"step": 0.125})


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    monkeypatch.setattr("coadjoint.files.datasets.writers.BUFFER_BYTES", PIECE)


@pytest.mark.parametrize("name", VALUES)
def test_checksum_depends_on_entries(name):
    """In the first piece, the following ones, and the shorter last one; and on their order."""
    sums = [checksum_of(dataset()), checksum_of(dataset(**{name: VALUES[name][::-1]}))]
    for index in range(LENGTH):
        values = VALUES[name].copy()
        kind = values.dtype.kind
        values[index] = (
            not values[index] if kind == "b" else values[index] + 1 if kind == "i" else
            np.nextafter(values[index], values.dtype.type(9)) if kind == "f" else "z"
        )  # fmt: skip
        sums.append(checksum_of(dataset(**{name: values})))
    assert len(set(sums)) == LENGTH + 2


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


def test_checksum_of_stored_files(monkeypatch):
    """Files that exist were written with this one."""
    monkeypatch.undo()
    assert checksum_of(dataset()) == "584d1ae2b3b215769cdf3b7491e68a4c1b3a6bbd611c75beca1670ed5fbe0405"


def test_large_fields_of_fluids_are_in_datasets_for_a_given_grid_only(monkeypatch):
    """On both sides of the limit."""
    found = {}
    for N in (9, 11):
        fluid = co.systems.torus_euler(N)
        found[N] = co.integrate(fluid, fluid.random(seed=1, degrees=(1, 3)), (0, 1), 0.5)
    monkeypatch.setattr(variables, "MAX_DEFAULT_BYTES", 8 * 3 * 9 * 9)
    assert "vorticity" in found[9].to_xarray() and "vorticity" not in found[11].to_xarray()
    assert found[11].to_xarray(grid=True).vorticity.shape == (3, 11, 11)
