"""Files and stores that other programs have written or changed: read if they are whole, else refused."""

import json
import random

import numpy as np
import pytest
import xarray

import coadjoint as co
from command import command
from refusals import refused

pytestmark = [
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
    pytest.mark.filterwarnings("ignore:Consolidated metadata"),
    pytest.mark.filterwarnings("ignore:Failed to open Zarr store with consolidated metadata"),
]


@pytest.fixture(scope="module")
def sol():
    fluid = co.systems.torus_euler(N=3)
    return co.integrate(fluid, fluid.random(1, degrees=(1, 1)), (7.5, 8.5), 0.125)


@pytest.mark.thinned(3)
@pytest.mark.parametrize("names", ["fixed", "variable"])
@pytest.mark.parametrize(("version", "index"), [(2, "whole"), (2, "absent"), (3, "whole"), (3, "absent"), (3, "null")])
def test_runs_are_read_with_any_index_and_text_type(tmp_path, sol, version, index, names):
    """The index of format 3 is part of its root and may be null."""
    path, dataset = tmp_path / "run.zarr", sol.to_xarray()
    texts = [name for name, values in dataset.variables.items() if values.dtype.kind in "UO"]
    assert texts
    kinds = {name: dataset[name].astype({"fixed": "U", "variable": object}[names]) for name in texts}
    dataset.assign_coords(kinds).to_zarr(path, zarr_format=version, consolidated=index == "whole")
    if index == "null":
        root = json.loads((path / "zarr.json").read_text())
        (path / "zarr.json").write_text(json.dumps({**root, "consolidated_metadata": None}))
    found = co.load(path)
    for name, values in sol.to_xarray().variables.items():
        np.testing.assert_array_equal(found.dataset[name].values, values.values, err_msg=str(name))
    assert found.attributes == sol.to_xarray().attrs


RUN = """
[system]
name = "heavy_top"
[initial]
x = [[0.1, 0.3, 2.0, 0.6, 0.0, 0.8], [0.2, -0.3, 1.5, 0.0, 0.6, 0.8]]
attitude = true
[run]
t_span = [0.5, 2.0]
step = 0.125
save_every = 2
[observe]
"x1 x2" = "x1*x2"
"""
SWEEP = """
[system]
name = "rigid_body"
parameters = { inertia = [1.0, 2.0, 2.5] }
[initial]
x = [1.0, 0.1, 0.5]
[run]
t_span = [0, 1]
step = 0.125
[sweep.over]
"system.parameters.inertia[2]" = [2.25, 2.5, 2.75]
"""


def another(value):
    """Return a different value; floats may be NaN, or too large for a sum to differ."""
    if isinstance(value, str):
        return f"{value}z"
    if isinstance(value, bool | np.bool_):
        return not value
    return value + 1 if isinstance(value, int | np.integer) else 0.375


def changes_of(found):
    """Yield datasets with one change each: the last entry of a variable, or an attribute."""
    for name in found.variables:
        numbers = found[name].dtype.kind in "iubf"
        values = found[name].values.copy() if numbers else found[name].values.astype(object)
        values[(-1,) * values.ndim] = another(values[(-1,) * values.ndim])
        other = {name: (found[name].dims, values, found[name].attrs)}
        yield name, found.assign_coords(other) if name in found.coords else found.assign(other)
    for name in found.attrs:
        yield name, found.assign_attrs({name: f"{found.attrs[name]} "})


@pytest.mark.thinned(2)
@pytest.mark.parametrize("suffix", ["nc", "zarr"])
@pytest.mark.parametrize("text", [RUN, SWEEP], ids=["members", "sweep"])
def test_changed_files_of_the_command_are_refused(tmp_path, monkeypatch, capsys, text, suffix):
    """Any number, name or attribute; some of all changes, drawn anew for each kind of file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.toml").write_text(text)
    assert command(capsys, "run", "run.toml", "--out", f"run.{suffix}", "--quiet").status == 0
    engine = {"nc": "h5netcdf", "zarr": "zarr"}[suffix]
    with xarray.open_dataset(f"run.{suffix}", engine=engine) as opened:
        found = opened.load()
    assert co.load(f"run.{suffix}").x.shape == found["x"].shape
    changes = dict(changes_of(found))
    for number, name in enumerate(random.Random(f"{len(text)} {suffix}").sample(sorted(changes), 4)):
        path, changed = f"changed{number}.{suffix}", changes[name].drop_encoding()
        changed.to_netcdf(path, engine=engine) if suffix == "nc" else changed.to_zarr(path)
        with refused(ValueError, path):
            co.load(path)


def test_failure_is_part_of_a_file(tmp_path):
    """Marking a dataset as failed keeps its checksum right."""
    with pytest.raises(co.IntegrationError) as failure:
        body, x0 = co.systems.rigid_body(inertia=(1, 2, 3)), (3.0, -20.0, 7.0)
        co.integrate(body, x0, (7.0, 107.0), 0.125, co.ExplicitRungeKutta("runge2"))
    marked = co.results.mark_failed(failure.value.partial.to_xarray(), failure.value)
    marked.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    attributes = co.load(tmp_path / "run.nc").attributes
    assert (attributes["run_failed"], attributes["failed_reason"]) == (1, str(failure.value))
    for name in ("step", "time", "residual"):
        np.testing.assert_equal(attributes[f"failed_{name}"], getattr(failure.value, name))
    marked.assign_attrs(failed_step=3).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    if "content_sha256" in attributes:
        with refused(ValueError, "other.nc"):
            co.load(tmp_path / "other.nc")
