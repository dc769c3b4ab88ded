"""The vorticity of fluids on a grid, and the field that it carries, as variables of a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coadjoint.files.datasets.content_checksum import CHECKSUM, with_checksum
from coadjoint.files.datasets.named_axes import unstacked
from coadjoint.files.datasets.variables import Variables, cf_attributes
from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import installed
from coadjoint.short_repr import short
from coadjoint.systems.fluids.reduced_mhd import fluid_of
from coadjoint.systems.matrices.fluid_system import FluidSystem

if TYPE_CHECKING:
    import xarray

    from coadjoint.runs.results.solution import Solution

Floats = NDArray[np.float64]

MAX_DEFAULT_BYTES = 1 << 27
"""Size of the fields above which a dataset has them only for a given grid."""


def vorticity_variables(solution: Solution, grid: Any) -> tuple[Variables, Variables]:
    """Return variables and coordinates; both empty without a fluid, for ``grid=False``, and by default if large.

    `grid` is a shape, True for the default one of the system, None for this one if it is not large, or False.
    """
    fluid = None if solution.system.is_batch else fluid_of(solution.system.unforced)
    if fluid is None:
        if grid is None or grid is False:
            return {}, {}
        raise TypeError(f"grid is {short(grid)}, and {solution.system.name} has no vorticity on a grid; omit it")
    on_sphere = fluid.surface == "sphere"
    if grid is False or (grid is None and on_sphere and not installed("ducc0")):
        return {}, {}
    shape = None if grid is None or grid is True else grid
    rows, columns = fluid.grid(shape)
    dims = ("time", *(() if solution.failed is None else ("member",)))
    names = ("carried", "vorticity") if solution.x.ndim == len(dims) + 3 else ("vorticity",)
    size = 8 * int(np.prod(solution.x.shape[: len(dims)])) * len(rows) * len(columns) * len(names)
    if grid is None and size > MAX_DEFAULT_BYTES:
        return {}, {}
    check_available_memory(2 * size, f"the vorticity on a grid of {len(rows)} x {len(columns)} points", "take fewer")
    axes = ("latitude", "longitude") if on_sphere else ("eastward", "northward")
    found: Variables = {}
    for layer, name in enumerate(names):
        W = fluid.matrices(solution.x if len(names) == 1 else solution.x[..., layer, :, :])
        about = "carried field" if name == "carried" else "vorticity relative to the frame of the surface"
        values = _on_grid(fluid, W if name == "carried" else fluid.relative(W), shape)
        found[name] = ((*dims, *axes), values, cf_attributes(about))
    return found, _coordinates(on_sphere, rows, columns)


def with_vorticity(dataset: xarray.Dataset, solution: Solution, grid: Any) -> xarray.Dataset:
    """Return the dataset of a stored run with the fields on a grid, in place of those that it has."""
    import xarray

    names = ("vorticity", "carried", "latitude", "longitude", "eastward", "northward")
    rest = dataset.drop_vars(names, errors="ignore")
    found, coordinates = vorticity_variables(solution, grid)
    of_run = xarray.Dataset(found, coordinates, dict(dataset.attrs))
    fields = unstacked(of_run)
    result = rest.assign(fields.data_vars).assign_coords({name: fields[name] for name in coordinates})
    return with_checksum(result) if CHECKSUM in dataset.attrs else result


def _on_grid(fluid: FluidSystem, W: NDArray[Any], shape: Any) -> Floats:
    """Return the field of matrices (..., N, N) on a grid; NaN for states after a failure."""
    finite = np.isfinite(W).all(axis=(-2, -1))
    values = fluid.to_grid(W[finite], shape)
    result = np.full((*finite.shape, *values.shape[1:]), np.nan)
    result[finite] = values
    return result


def _coordinates(on_sphere: bool, rows: Floats, columns: Floats) -> Variables:
    if not on_sphere:
        units = {"units": "radian"}
        return {
            "eastward": (("eastward",), rows, {"long_name": "position x, to the right", **units}),
            "northward": (("northward",), columns, {"long_name": "position y, up", **units}),
        }
    named = (("latitude", rows, "degrees_north"), ("longitude", columns, "degrees_east"))
    return {
        # Rounded, so that whole degrees are found by their labels.
        name: ((name,), np.round(np.degrees(values), 12), {"standard_name": name, "long_name": name, "units": units})
        for name, values, units in named
    }
