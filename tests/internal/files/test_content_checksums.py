"""Checksums of datasets that are stored, and the fields of fluids that are stored by default."""

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


def test_checksum_of_stored_files(monkeypatch):
    """Files that exist were written with this one; numbers in pieces have that of the whole."""
    numbers = dataset().drop_vars(["text", "object"])
    in_pieces = checksum_of(numbers)
    monkeypatch.undo()
    assert checksum_of(numbers) == in_pieces
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
