"""Datasets of fluids: the vorticity on a grid, with coordinates and units, in files, ensembles and two fields."""

import numpy as np
import pytest

import coadjoint as co
from refusals import refused

S = co.systems
SPHERE, TORUS = S.sphere_euler(8, rotation=1.0), S.torus_euler(7)
SYSTEMS = {
    "sphere": (SPHERE, SPHERE),
    "torus": (TORUS, TORUS),
    "mhd": (S.reduced_mhd(7, "torus"), TORUS),
    "scalar": (S.passive_scalar(8), S.sphere_euler(8)),
}
AXES = {"sphere": ("latitude", "longitude"), "torus": ("eastward", "northward")}


def run(system, fluid, members=1):
    W, theta = (fluid.random(seed=seed, degrees=(1, 3)) for seed in (1, 2))
    x = W if system is fluid else np.stack([theta, W])
    x = np.stack([x, 0.5 * x]) if members > 1 else x
    return co.integrate(system, x, (0, 1), 0.1, co.IsospectralGauss(), save_every=5)


@pytest.mark.thinned(2)
@pytest.mark.parametrize("members", [1, 2])
@pytest.mark.parametrize("name", SYSTEMS)
def test_the_vorticity_is_on_a_grid(name, members, tmp_path):
    system, fluid = SYSTEMS[name]
    axes = AXES["torus" if fluid is TORUS else "sphere"]
    sol = run(system, fluid, members)
    data = sol.to_xarray()
    dims = ("time", *(("member",) if members > 1 else ()), *axes)
    two = system is not fluid
    assert data.vorticity.dims == dims and ("carried" in data) == two
    W = sol.x[..., 1, :, :] if two else sol.x
    np.testing.assert_array_equal(data.vorticity, fluid.to_grid(fluid.relative(W)))
    if two:
        np.testing.assert_array_equal(data.carried, fluid.to_grid(sol.x[..., 0, :, :]))
    units = ["degrees_north", "degrees_east"] if "latitude" in axes else ["radian", "radian"]
    assert [data[axis].attrs["units"] for axis in axes] == units and data.vorticity.attrs["long_name"]
    for axis, values in zip(axes, fluid.grid(), strict=True):
        np.testing.assert_allclose(data[axis], np.degrees(values) if "latitude" in axes else values, rtol=0, atol=1e-12)
    path = tmp_path / "run.nc"
    data.to_netcdf(path, engine="h5netcdf")
    again = co.load(path)
    assert again.to_xarray().identical(data) and np.array_equal(again.x, sol.x)
    finer = again.to_xarray(grid=(19, 36))
    assert finer.vorticity.sizes[axes[0]] == 19 and "vorticity" not in again.to_xarray(grid=False)
    velocity = [finer[f"{axis}_velocity"] for axis in ("eastward", "northward")]
    assert velocity[0].dims == dims and "eastward_velocity" not in finer.vorticity.coords
    np.testing.assert_array_equal(velocity, fluid.velocity(W, (19, 36)))
    finer.to_netcdf(tmp_path / "finer.nc", engine="h5netcdf")
    assert co.load(tmp_path / "finer.nc").to_xarray().identical(finer)
    rebuilt = co.results.rebuild(data)
    assert rebuilt.to_xarray().vorticity.identical(data.vorticity)


def test_archives_have_it_for_a_given_grid(tmp_path):
    W = TORUS.random(seed=1, degrees=(1, 2))
    sol = co.integrate(TORUS, W, (0, 1), 0.1, co.IsospectralGauss(), archive=tmp_path / "run.zarr")
    assert "vorticity" not in sol.to_xarray()
    np.testing.assert_array_equal(sol.to_xarray(grid=True).vorticity, TORUS.to_grid(np.asarray(sol.x)))


def test_a_grid_of_another_system_is_refused():
    body = co.integrate(S.rigid_body((1, 2, 3)), (1.0, 0.2, 0.1), (0, 1), 0.1)
    with refused(TypeError, "grid", "rigid_body", "no vorticity"):
        body.to_xarray(grid=(3, 4))
    assert "angular_velocity" in body.to_xarray() and "angular_velocity" not in body.to_xarray(grid=False)
    with refused(TypeError, "shape"):
        run(TORUS, TORUS).to_xarray(grid=3)
