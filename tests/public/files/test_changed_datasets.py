"""Datasets without a checksum, as other programs change them: read by dimensions and labels, or refused."""

from functools import cache

import numpy as np
import pytest
import xarray

import coadjoint as co
from refusals import refused
from same_runs import check_same

pytestmark = [
    pytest.mark.filterwarnings("ignore::zarr.errors.UnstableSpecificationWarning"),
    pytest.mark.filterwarnings("ignore:Consolidated metadata"),
    pytest.mark.filterwarnings("ignore:the stream .* is called in Python:RuntimeWarning"),
]

X = np.array([1.0, 0.1, 0.5])
BODY = co.systems.rigid_body((1, 2, 2.5))
DAMPED = BODY.with_forces(co.forces.LinearDamping(0.1), co.forces.Torque((0.0, 0.05, 0.1)))
FLUID = co.systems.sphere_euler(4)
FAMILY = co.batch(lambda a, b: co.systems.rigid_body((a, b, 3.0)), a=[1.0, 1.5], b=[2.0, 2.25, 2.5])
Q = co.Polynomial({(1, 1, 0): 1})
RUNS = {
    "one": lambda: co.integrate(BODY, X, (3.0, 1.0), 0.125, save_every=3, attitude=True, observe={"q": Q}),
    "members": lambda: co.integrate(DAMPED, [X, 2 * X], (0, 2), 0.125, co.GaussLegendre(1)),
    "matrices": lambda: co.integrate(FLUID, [FLUID.random(1), FLUID.random(2)], (0, 1), 0.125),
    "family": lambda: co.integrate(FAMILY, X, (0, 1), 0.125, co.Splitting()),
    "events": lambda: co.integrate(BODY, X, (0, 9), 0.125, events=co.Event("x2", terminal=True)),
    "t_eval": lambda: co.integrate(BODY, X, (0, 2), 0.125, t_eval=[0.3, 0.31, 1.9]),
}
RUNS = {name: cache(run) for name, run in RUNS.items()}
WRITERS = {
    "netcdf": lambda data, path: data.to_netcdf(path, engine="h5netcdf"),
    "zarr": lambda data, path: data.to_zarr(path),
}


def stored(data, path, writer="netcdf"):
    """Write a dataset without its checksum, as the message of `load` says, and load it."""
    WRITERS[writer](data.drop_attrs(deep=False).assign_attrs(without_checksum(data.attrs)), path)
    return co.load(path)


def without_checksum(attributes):
    return {name: value for name, value in attributes.items() if name != "content_sha256"}


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("name", RUNS)
def test_transposed_datasets_are_read_by_the_names_of_their_dimensions(tmp_path, name, writer):
    sol = RUNS[name]()
    data = sol.to_xarray()
    found = stored(data.transpose(*reversed(list(data.sizes))), tmp_path / "run", writer)
    check_same(found, sol)
    check_same(co.results.rebuild(found.dataset), sol, left_out=("observed",))


REVERSED = ("component", "invariant", "tenth", "part", "a", "b")


@pytest.mark.parametrize("name", ["one", "members", "matrices", "family"])
@pytest.mark.parametrize("dim", REVERSED)
def test_labels_in_another_order_are_used(tmp_path, name, dim):
    sol = RUNS[name]()
    data = sol.to_xarray()
    if dim in data.dims:
        found = stored(data.isel({dim: slice(None, None, -1)}), tmp_path / "run.nc")
        check_same(found, sol)
        check_same(co.results.rebuild(found.dataset), sol, left_out=("observed",))


def test_permuted_components_of_a_dataset_in_memory_are_used():
    sol = RUNS["one"]()
    check_same(co.results.rebuild(sol.to_xarray().isel(component=[2, 0, 1])), sol, left_out=("observed",))


def test_parts_of_a_run_are_read(tmp_path):
    sol = RUNS["one"]()
    for k, part in enumerate((slice(2, None), slice(None, 3), slice(None, None, 2))):
        found = stored(sol.to_xarray().isel(time=part), tmp_path / f"{k}.nc")
        assert np.array_equal(found.x, sol.x[part]) and np.array_equal(found.t, sol.t[part])


def renamed(data, dim, labels):
    return data.assign_coords({dim: (dim, labels, data[dim].attrs)})


CHANGED = {
    "reversed times": ("one", lambda data: data.isel(time=slice(None, None, -1)), ["time[1]", "sorted"]),
    "times of another span": ("one", lambda data: data.assign_coords(time=data.time + 5.0), ["time[0]", "t_span"]),
    "shifted times": ("one", lambda data: data.isel(time=slice(1, -1)).pipe(
        lambda part: part.assign_coords(time=part.time + 0.0625)), ["saves"]),
    "times of other steps": ("one", lambda data: data.isel(time=slice(1, -1)).pipe(
        lambda part: part.assign_coords(time=part.time + 0.125)), ["saves"]),
    "reversed output times": ("t_eval", lambda data: data.isel(time=slice(None, None, -1)), ["time[1]", "sorted"]),
    "times that are no numbers": ("one", lambda data: data.assign_coords(time=data.time * np.nan), ["time", "finite"]),
    "two energies": ("one", lambda data: renamed(data, "invariant", ["energy", "energy"]), ["invariants", "once"]),
    "no energy": ("one", lambda data: renamed(data, "invariant", ["a", "b"]), ["invariants", "energy"]),
    "other components": ("one", lambda data: renamed(data, "component", ["a", "b", "c"]), ["component", "'a'"]),
    "doubled components": ("one", lambda data: data.isel(component=[0, 0, 1]), ["component"]),
    "an axis of other values": ("family", lambda data: renamed(data, "a", [1.0, 1.25]), ["a is", "1.25"]),
    "doubled values of an axis": ("family", lambda data: data.isel(b=[0, 0, 1]), ["b is"]),
    "two real parts": ("matrices", lambda data: data.isel(part=[0, 0]), ["part"]),
    "energy over components": ("one", lambda data: data.assign(energy=data.x), ["energy", "dimensions"]),
    "x of other members": ("members", lambda data: data.assign(x=data.x.rename(member="other")), ["x"]),
    "no drift": ("one", lambda data: data.drop_vars("drift"), ["drift", "missing"]),
    "a tenth of numbers": ("one", lambda data: data.isel(tenth=slice(3)), ["tenth"]),
    "tenths as text": ("one", lambda data: data.assign_coords(tenth=data.tenth.astype(str)), ["tenth", "'1'"]),
}  # fmt: skip


@pytest.mark.thinned(2)
@pytest.mark.parametrize("case", CHANGED)
def test_datasets_that_describe_no_run_are_refused(tmp_path, case):
    name, change, named = CHANGED[case]
    with refused(ValueError, "run.nc", *named) as error:
        stored(change(RUNS[name]().to_xarray()), tmp_path / "run.nc")
    assert "\n" not in str(error.value)


def test_copies_of_archives_by_other_programs_are_read(tmp_path):
    """Transposed by xarray on the way."""
    sol = co.integrate(DAMPED, [X, 2 * X], (0, 2), 0.125, co.GaussLegendre(1), archive=tmp_path / "run.zarr")
    with xarray.open_zarr(tmp_path / "run.zarr", chunks=None) as opened:
        opened.load().drop_encoding().transpose().to_netcdf(tmp_path / "copy.nc", engine="h5netcdf")
    check_same(co.load(tmp_path / "copy.nc"), sol)
