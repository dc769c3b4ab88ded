"""Fields with coordinates: arrays of xarray, and files of NumPy and NetCDF."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coadjoint.optional_packages import require_packages
from coadjoint.regular_files import open_regular, read_array_file
from coadjoint.short_repr import short
from coadjoint.validation import read_finite, read_integer, read_path

if TYPE_CHECKING:
    import xarray

Floats = npt.NDArray[np.float64]

AXES = {
    "sphere": (("lat", "latitude", "degrees_north"), ("lon", "longitude", "degrees_east")),
    "torus": (("x", "eastward"), ("y", "northward")),
}
"""Names, standard names and units of the two coordinates of a surface."""
RELATIVE_VORTICITY, CARRIED_FIELD = "vorticity relative to the frame of the surface", "carried field"
"""Long names of the fields in datasets of runs."""
POTENTIAL_VORTICITY, STREAM_FUNCTION = "potential vorticity", "stream function"
BUOYANCY = "buoyancy at the surface"
VELOCITIES = {
    "eastward_velocity": ("eastward velocity relative to the frame", "eastward_wind"),
    "northward_velocity": ("northward velocity relative to the frame", "northward_wind"),
}
"""Name of a component in datasets of runs -> its long name, and its standard name of CF in those with units."""
RELATIVE, STATE, STREAM, VELOCITY = "relative vorticity", "field of the state", "stream function", "velocity"
KINDS = {
    RELATIVE_VORTICITY: RELATIVE,
    CARRIED_FIELD: STATE,
    POTENTIAL_VORTICITY: STATE,
    BUOYANCY: STATE,
    STREAM_FUNCTION: STREAM,
    "atmosphere_relative_vorticity": RELATIVE,
    "atmosphere_upward_relative_vorticity": RELATIVE,
    "ocean_relative_vorticity": RELATIVE,
    "atmosphere_absolute_vorticity": STATE,
    "atmosphere_upward_absolute_vorticity": STATE,
    "atmosphere_horizontal_streamfunction": STREAM,
    **{name: VELOCITY for names in VELOCITIES.values() for name in names},
    **dict.fromkeys(("eastward_sea_water_velocity", "northward_sea_water_velocity"), VELOCITY),
}
"""Long or standard name -> kind of a field; one that is no field of a fluid is taken as it is, as the state."""
LONG_NAMES = {RELATIVE: RELATIVE_VORTICITY, STATE: POTENTIAL_VORTICITY, STREAM: STREAM_FUNCTION}
KINDS_BY_NAME = {
    **dict.fromkeys(("vor", "vo", "vort", "vorticity", "relative_vorticity", "zeta"), RELATIVE),
    **dict.fromkeys(("q", "pv", "potential_vorticity", "absolute_vorticity"), STATE),
    **dict.fromkeys(("psi", "streamfunction", "stream_function"), STREAM),
}
"""Name of a variable in files of other models -> kind of its field."""


class LabelledField(NamedTuple):
    """Values (..., k, l), the coordinates of the last two axes in radians, and which units were assumed, if any."""

    values: Floats
    first: Floats
    second: Floats
    assumed: str


def labelled_field(field: xarray.DataArray, surface: str, name: str) -> LabelledField:
    """Return an array of xarray as values over the two coordinates of a surface, in any order of its axes."""
    first, second = (_coordinate(field, known) for known in AXES[surface])
    for coordinate, known in zip((first, second), AXES[surface], strict=True):
        if coordinate is None:
            raise ValueError(
                f"{name} has the dimensions {short(list(field.dims))} and no coordinate {known[0]} or {known[1]} along "
                "one of them; name it so, or give to_numpy() of values in the order of grid()"
            )
    assert first is not None and second is not None
    axes = (*first.dims, *second.dims)
    if axes[0] == axes[1]:
        raise ValueError(f"both coordinates of {name} are along {short(axes[0])}; give values over two dimensions")
    rest = [axis for axis in field.dims if axis not in axes]
    _check_gaps(field, name)
    values = read_finite(field.transpose(*rest, *axes).to_numpy(), name)
    (rows, of_rows), (columns, of_columns) = (_radians(one, name) for one in (first, second))
    if surface == "torus":
        rows = np.unwrap(rows)
    # Longitudes may begin again in the middle, as those from -180 of a field whose columns begin at 0.
    return LabelledField(values, rows, np.unwrap(columns), of_rows + of_columns)


def _check_gaps(field: xarray.DataArray, name: str) -> None:
    """Raise ValueError for NaN, as over land, with the coordinates of the first one."""
    gaps = np.argwhere(field.isnull().to_numpy()) if field.dtype.kind == "f" else np.zeros((0, 0))
    if len(gaps):
        first = dict(zip(field.dims, gaps[0].tolist(), strict=True))
        place = ", ".join(f"{axis} = {field[axis].to_numpy()[index]}" for axis, index in first.items())
        raise ValueError(
            f"{name} is NaN at {len(gaps)} points, first at {place}; fill them: land by the field's fillna(0.0), "
            "for a vorticity or a height about the mean depth (about sea level, 0 is a wall as high as the fluid)"
        )


WITHOUT_UNITS = ("", "1", "dimensionless")


def units_of(field: xarray.DataArray) -> str:
    """Return the units of a field; without an attribute it has none."""
    return str(field.attrs.get("units", "")).strip()


def kind_of(field: xarray.DataArray) -> str | None:
    """Return the kind of field of an array of xarray, by its attributes; None without."""
    names = (str(field.attrs.get(key)) for key in ("long_name", "standard_name"))
    return next((KINDS[name] for name in names if name in KINDS), None)


def _coordinate(field: xarray.DataArray, known: tuple[str, ...]) -> xarray.DataArray | None:
    """Return the coordinate along one dimension that has one of these names, standard names or units."""
    for label, coordinate in field.coords.items():
        names = (label, coordinate.attrs.get("standard_name"), coordinate.attrs.get("units"))
        if coordinate.ndim == 1 and any(str(name).lower() in known for name in names):
            return coordinate
    return None


def _radians(coordinate: xarray.DataArray, name: str) -> tuple[Floats, str]:
    """Return a coordinate in radians, and a text about its units if it has none."""
    values = read_finite(coordinate.to_numpy(), f"{coordinate.name} of {name}")
    units = str(coordinate.attrs.get("units", "")).lower()
    if units in ("", "1"):
        # A grid goes around once, or from pole to pole: in degrees it spans 100 or more, in radians at most 2 pi.
        in_degrees = bool(np.ptp(values) > 2 * pi) if values.size else False
        taken = "degrees" if in_degrees else "radians"
        assumed = f"; {coordinate.name} has no units and was taken as {taken}, of its range"
        return np.radians(values) if in_degrees else values, assumed
    if units.startswith("deg"):
        return np.radians(values), ""
    if units.startswith("rad"):
        return values, ""
    raise ValueError(f"{coordinate.name} of {name} has the units {short(units)}; they must be degrees or radians")


def read_field(path: str | Path, surface: str, variable: str | None, select: Mapping[str, int] | None) -> Any:
    """Return the array of a .npy file, or a variable of a .nc file over two coordinates as an array of xarray."""
    file = read_path(path, "path")
    if file.suffix == ".npy":
        if variable is not None or select is not None:
            raise ValueError(f"{short(file.name)} contains one array; variable= and select= are for NetCDF")
        return read_array_file(file, file.name)
    if file.suffix != ".nc":
        raise ValueError(
            f"{short(file.name)} ends with {short(file.suffix) if file.suffix else 'nothing'}; give a file .npy or .nc"
        )
    require_packages(f"{short(file.name)}: NetCDF", "xarray", "h5netcdf")
    import xarray

    open_regular(file).close()
    with xarray.open_dataset(file) as dataset:
        return _of_dataset(dataset, surface, short(file.name), variable, select).load()


def _of_dataset(
    dataset: xarray.Dataset, surface: str, name: str, variable: str | None, select: Mapping[str, int] | None
) -> xarray.DataArray:
    names = [str(key) for key, array in dataset.data_vars.items() if array.ndim >= 2]
    on_surface = [key for key in names if all(_coordinate(dataset[key], known) is not None for known in AXES[surface])]
    fields = [key for key in on_surface if kind_of(dataset[key]) != VELOCITY]
    if variable is None and len(fields or names) != 1:
        raise ValueError(f"{name} has the variables {short(fields or names)}; choose one by variable=")
    chosen = (fields or names)[0] if variable is None else variable
    if chosen not in dataset.data_vars:
        raise ValueError(f"{name} has no variable {short(chosen)}; choose one of {short(fields or names)}")
    field = dataset[chosen]
    for axis, index in dict(select or {}).items():
        if axis not in field.dims:
            raise ValueError(f"{chosen} of {name} has no axis {short(axis)}; choose from {short(list(field.dims))}")
        size = field.sizes[axis]
        field = field.isel({axis: read_integer(index, f"select[{axis!r}]", -size, size - 1)})
    axes = {axis for known in AXES[surface] if (found := _coordinate(field, known)) is not None for axis in found.dims}
    if kind_of(field) is None and str(chosen).lower() in KINDS_BY_NAME:
        field = field.assign_attrs(long_name=LONG_NAMES[KINDS_BY_NAME[str(chosen).lower()]])
    rest = [axis for axis in field.dims if axis not in axes]
    long = [axis for axis in rest if field.sizes[axis] > 1]
    if long and len(axes) == 2:
        raise ValueError(f"{chosen} of {name} has the axis {short(long[0])} too; give the index along it by select=")
    return field.squeeze(rest if len(axes) == 2 else []).rename(f"{chosen} of {name}")
