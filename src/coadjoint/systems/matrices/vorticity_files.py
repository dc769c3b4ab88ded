"""Reading of vorticity fields from files: NumPy arrays, and NetCDF with coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.validation import read_array_file, read_finite, read_integer

if TYPE_CHECKING:
    import xarray

Floats = npt.NDArray[np.float64]

FIRST = ("lat", "latitude", "x")
SECOND = ("lon", "longitude", "y")


def read_field(
    path: str | Path, variable: str | None = None, select: Mapping[str, int] | None = None
) -> tuple[npt.NDArray[Any], tuple[Floats, Floats] | None]:
    """Return the array of a .npy or .nc file and, for NetCDF, the coordinates of its last two axes in radians."""
    if not isinstance(path, str | Path):
        raise TypeError(f"path is {short(path)}; give the name of a file")
    file = Path(path)
    if file.suffix == ".npy":
        if variable is not None or select is not None:
            raise ValueError(f"{short(file.name)} contains one array; variable= and select= are for NetCDF")
        return read_array_file(file, file.name), None
    if file.suffix != ".nc":
        raise ValueError(
            f"{short(file.name)} ends with {short(file.suffix) if file.suffix else 'nothing'}; give a file .npy or .nc"
        )
    require_packages(f"{short(file.name)}: NetCDF", "xarray", "h5netcdf")
    import xarray

    with xarray.open_dataset(file) as dataset:
        return _read_dataset(dataset, short(file.name), variable, select)


def _read_dataset(
    dataset: xarray.Dataset, name: str, variable: str | None, select: Mapping[str, int] | None
) -> tuple[npt.NDArray[Any], tuple[Floats, Floats]]:
    names = [str(key) for key, array in dataset.data_vars.items() if array.ndim >= 2]
    if variable is None and len(names) != 1:
        raise ValueError(f"{name} has the variables {short(names)}; choose one by variable=")
    chosen = names[0] if variable is None else variable
    if chosen not in dataset.data_vars:
        raise ValueError(f"{name} has no variable {short(chosen)}; choose one of {short(names)}")
    field = dataset[chosen]
    for axis, index in dict(select or {}).items():
        if axis not in field.dims:
            raise ValueError(f"{chosen} of {name} has no axis {short(axis)}; choose from {short(list(field.dims))}")
        size = field.sizes[axis]
        field = field.isel({axis: read_integer(index, f"select[{axis!r}]", -size, size - 1)})
    axes = [_find_axis(field, known, name) for known in (FIRST, SECOND)]
    rest = [axis for axis in field.dims if axis not in axes]
    long = [axis for axis in rest if field.sizes[axis] > 1]
    if long:
        raise ValueError(f"{chosen} of {name} has the axis {short(long[0])} too; give the index along it by select=")
    values = field.squeeze(rest).transpose(*axes).values
    first, second = (_read_radians(field[axis], name) for axis in axes)
    return read_finite(values, f"{chosen} of {name}"), (first, second)


def _find_axis(field: xarray.DataArray, known: tuple[str, ...], name: str) -> Any:
    for axis in field.dims:
        kind = field[axis].attrs.get("standard_name", axis) if axis in field.coords else axis
        if str(kind).lower() in known or str(axis).lower() in known:
            if axis in field.coords:
                return axis
            raise ValueError(f"the axis {short(axis)} of {name} has no coordinate")
    raise ValueError(f"{name} has the axes {short(list(field.dims))}; one must be called {' or '.join(known)}")


def _read_radians(coordinate: xarray.DataArray, name: str) -> Floats:
    values = read_finite(coordinate.values, f"{coordinate.name} of {name}")
    units = str(coordinate.attrs.get("units", "radians"))
    if units.startswith("degree"):
        return np.radians(values)
    if units.startswith("rad") or units in ("1", ""):
        return values
    raise ValueError(f"{coordinate.name} of {name} has the units {short(units)}; they must be degrees or radians")
