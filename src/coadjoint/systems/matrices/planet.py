"""Units of a planet: its rotation and Lamb's parameter, and fields with units from and to SI."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np

from coadjoint.keyword_hints import suggest_keywords
from coadjoint.labels import is_xarray
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.systems.matrices.labelled_fields import (
    POTENTIAL_VORTICITY,
    RELATIVE_VORTICITY,
    STREAM_FUNCTION,
    VELOCITIES,
    WITHOUT_UNITS,
    units_of,
)
from coadjoint.systems.matrices.spherical_modes import coefficients_of, latitudes, longitudes
from coadjoint.validation import check_parameters, read_number, read_path, read_positive, set_fields

if TYPE_CHECKING:
    import xarray

RATES = ("s-1", "s**-1", "s^-1", "1/s", "/s", "per second", "s^{-1}")
DIFFUSIVITIES = ("m2 s-1", "m**2 s**-1", "m^2/s", "m2/s", "m^2 s^-1", "m**2/s")
METRES = ("m", "metre", "metres", "meter", "meters")
KILOMETRES = ("km", "kilometre", "kilometres", "kilometer", "kilometers")


MOUNTAINS = ((45.0, 250.0, 12.0, 0.1), (35.0, 90.0, 15.0, 0.1), (-30.0, 290.0, 8.0, 0.06), (-55.0, 60.0, 20.0, -0.1))
"""Latitude, longitude and width in degrees, and height divided by the depth, of the mountains of an example."""


def unit_vectors(latitude: Any, longitude: Any) -> Any:
    """Return points of the unit sphere, (..., 3)."""
    across = np.cos(latitude)
    return np.stack(
        [across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude) + 0.0 * longitude], axis=-1
    )


@suggest_keywords
@dataclass(frozen=True)
class RotatingPlanet:
    """A rotating planet with a layer of fluid in SI units, and the numbers of its models on the unit sphere.

    Lengths are in radii, and times in `time`. Choose it to make `sphere_qg` or `sphere_euler` of a real planet, to
    start from files in SI units, and to write runs in them.

    Parameters
    ----------
    radius : float
        Radius (m).
    day : float
        Period of the rotation relative to the stars (s); negative if the planet turns to the west.
    gravity, depth : float
        Acceleration (m/s^2) and mean depth of the fluid (m); for an internal mode reduced gravity or equivalent depth.
    time : float, optional
        Unit of time of runs (s); by default the length of `day`.

    Attributes
    ----------
    rotation : float
        Angular velocity in radians per unit of time, 2 pi by default.
    lamb : float
        Lamb's parameter, 4 Omega^2 radius^2/(gravity depth).
    deformation_radius : float
        ``sqrt(gravity depth)/(2 Omega)``, of the poles (m).

    Raises
    ------
    TypeError, ValueError
        A number that is not positive and finite, or a day of zero.

    Examples
    --------
    >>> import coadjoint as co
    >>> earth = co.systems.RotatingPlanet(radius=6.371e6, day=86164.1, gravity=9.81, depth=2000.0)
    >>> s = co.systems.sphere_qg(N=32, lamb=earth.lamb, rotation=earth.rotation)
    >>> round(earth.lamb, 2), round(earth.deformation_radius / 1e3), round(earth.rossby_number(10.0), 4)
    (44.0, 960, 0.0108)
    """

    radius: float
    day: float
    gravity: float
    depth: float
    time: float | None = None

    def __post_init__(self) -> None:
        values = {name: read_positive(getattr(self, name), name) for name in ("radius", "gravity", "depth")}
        day = read_number(self.day, "day")
        if day == 0.0:
            raise ValueError("day is 0; give the period of the rotation in seconds")
        time = abs(day) if self.time is None else read_positive(self.time, "time")
        set_fields(self, day=day, time=time, **values)

    @property
    def rotation(self) -> float:
        return 2 * pi * self.seconds / self.day

    @property
    def lamb(self) -> float:
        return (self.radius / self.deformation_radius) ** 2

    @property
    def deformation_radius(self) -> float:
        return float((self.gravity * self.depth) ** 0.5 * abs(self.day) / (4 * pi))

    @property
    def seconds(self) -> float:
        """Seconds of a unit of time."""
        assert self.time is not None
        return self.time

    def rossby_number(self, speed: float) -> float:
        """Return the Rossby number, U/(2 Omega radius), of a speed U (m/s).

        Parameters
        ----------
        speed : float
            Speed of the flow relative to the planet.

        Returns
        -------
        float
        """
        return read_positive(speed, "speed") * abs(self.day) / (4 * pi * self.radius)

    def without_units(self, field: Any) -> xarray.DataArray:
        """Return a field in the units of the model, as `from_grid` and ``topography=`` take it.

        Parameters
        ----------
        field : xarray.DataArray
            Its attribute ``units`` says which quantity it is: s-1 a vorticity, m2 s-1 a stream function, m or km a
            height, and 1 a number.

        Returns
        -------
        xarray.DataArray

        Raises
        ------
        TypeError, ValueError
            No `xarray.DataArray`, no attribute ``units``, or other units.
        """
        if not is_xarray(field):
            raise TypeError(f"field is {short(field)}; give an xarray.DataArray with the attribute units")
        units = units_of(field)
        scales = {
            **dict.fromkeys(filter(None, WITHOUT_UNITS), 1.0),
            **dict.fromkeys(RATES, self.seconds),
            **dict.fromkeys(DIFFUSIVITIES, self.seconds / self.radius**2),
            **dict.fromkeys(METRES, 1.0 / self.depth),
            **dict.fromkeys(KILOMETRES, 1e3 / self.depth),
        }
        if not units:
            raise ValueError(
                f'{field.name or "field"} has no attribute units; give them, such as by assign_attrs(units="m") for '
                "heights in metres, or 1 for numbers in the units of the model"
            )
        if units not in scales:
            raise ValueError(
                f"{field.name or 'field'} has the units {short(units)}; convert it to s-1 (a vorticity), m2 s-1 (a "
                "stream function), m (a height), or 1"
            )
        found: xarray.DataArray = (field * scales[units]).assign_attrs({**field.attrs, "units": "1"})
        return found.rename(field.name)

    def example_topography(self, path: Any) -> xarray.DataArray:
        """Write a small NetCDF file of mountains, in metres about the mean depth, and return the field.

        Two ranges, an island and a basin of a tenth of the depth, every 2.5 degrees, for examples and tests.

        Parameters
        ----------
        path : str or Path
            The file, which ends with ``.nc``; an older one is replaced.

        Returns
        -------
        xarray.DataArray
            Over latitude and longitude, with the standard name of CF.

        Raises
        ------
        MissingPackageError
            xarray, h5netcdf or ducc0 is not installed.
        """
        require_packages("a topography", "xarray", "h5netcdf", "ducc0")
        import xarray

        latitude, east = latitudes("clenshaw-curtis", 73), longitudes(144)
        here = unit_vectors(*np.meshgrid(latitude, east, indexing="ij"))
        field = np.zeros(here.shape[:2])
        for north, centre, width, height in MOUNTAINS:
            there = unit_vectors(np.radians(north), np.radians(centre))
            field += height * self.depth * np.exp((here @ there - 1.0) / np.radians(width) ** 2)
        field -= coefficients_of(field, 2, "clenshaw-curtis")[0, 0].real / np.sqrt(4 * np.pi)
        about = {"standard_name": "surface_altitude", "long_name": "height about the mean depth", "units": "m"}
        found = xarray.DataArray(
            field,
            {
                name: ((name,), np.round(np.degrees(values), 12), {"standard_name": name, "units": units})
                for name, values, units in (
                    ("latitude", latitude, "degrees_north"),
                    ("longitude", east, "degrees_east"),
                )
            },
            ("latitude", "longitude"),
            "height",
            about,
        )
        found.to_netcdf(read_path(path, "path"), engine="h5netcdf")
        return found

    def with_units(self, dataset: xarray.Dataset) -> xarray.Dataset:
        """Return the fields of a dataset of a run in SI units, with standard names of CF.

        Parameters
        ----------
        dataset : xarray.Dataset
            As ``sol.to_xarray()`` returns it, with fields over latitude and longitude.

        Returns
        -------
        xarray.Dataset
            Vorticities (s-1), stream function (m2 s-1), velocities (m s-1), and beside a stream function `height` (m),
            the displacement of the free surface in geostrophic balance, ``f psi/gravity`` of the uppermost layer with
            psi without its mean (of an interface, if `gravity` is a reduced one); over the time of the run in seconds.

        Raises
        ------
        ValueError
            The dataset has no fields over latitude and longitude.

        Examples
        --------
        >>> import coadjoint as co
        >>> earth = co.systems.RotatingPlanet(radius=6.371e6, day=86164.1, gravity=9.81, depth=2000.0)
        >>> s = co.systems.sphere_qg(N=16, lamb=earth.lamb, rotation=earth.rotation)
        >>> run = co.integrate(s, s.random(1, energy=1e-3), (0, 1), 0.1, co.IsospectralGauss())
        >>> found = earth.with_units(run.to_xarray())
        >>> found.vorticity.attrs["standard_name"], found.vorticity.attrs["units"], float(found.time[-1])
        ('atmosphere_relative_vorticity', 's-1', 86164.1)
        """
        known = {
            RELATIVE_VORTICITY: (1 / self.seconds, "s-1", {"standard_name": "atmosphere_relative_vorticity"}),
            POTENTIAL_VORTICITY: (1 / self.seconds, "s-1", {}),
            STREAM_FUNCTION: (
                self.radius**2 / self.seconds,
                "m2 s-1",
                {"standard_name": "atmosphere_horizontal_streamfunction"},
            ),
            **{
                long_name: (self.radius / self.seconds, "m s-1", {"standard_name": standard_name})
                for long_name, standard_name in VELOCITIES.values()
            },
        }
        fields = {}
        for name, field in dataset.data_vars.items():
            long_name = field.attrs.get("long_name")
            if long_name in known and {"latitude", "longitude"} <= set(field.dims):
                factor, units, more = known[long_name]
                about = {"long_name": long_name, "units": units, "cell_methods": "time: point", **more}
                fields[name] = (field * factor).assign_attrs(about)
        if not fields:
            raise ValueError("dataset has no vorticity over latitude and longitude; give sol.to_xarray(grid=True)")
        import xarray

        psi = next((one for one in fields.values() if one.attrs["long_name"] == STREAM_FUNCTION), None)
        if psi is not None:
            upper = psi.isel(layer=0, drop=True) if "layer" in psi.dims else psi
            coriolis = 2.0 * self.rotation / self.seconds * np.sin(np.radians(psi.latitude))
            about = {"long_name": "height of the free surface in geostrophic balance", "units": "m"}
            fields["height"] = (upper * coriolis / self.gravity).assign_attrs(about | {"cell_methods": "time: point"})
        found = xarray.Dataset(fields, attrs={"Conventions": "CF-1.11"})
        seconds = (dataset.time * self.seconds).assign_attrs(standard_name="time", long_name="time", units="s")
        return found.assign_coords(time=seconds)


def read_planet(value: Any) -> RotatingPlanet:
    """Validate a planet, which is a table of its parameters in configuration files."""
    if isinstance(value, Mapping):
        parameters = inspect.signature(RotatingPlanet).parameters
        required = [key for key, one in parameters.items() if one.default is inspect.Parameter.empty]
        check_parameters("planet", value, parameters, required)
        return RotatingPlanet(**value)
    if not isinstance(value, RotatingPlanet):
        raise TypeError(f"planet is {short(value)}; give a RotatingPlanet(radius, day, gravity, depth)")
    return value
