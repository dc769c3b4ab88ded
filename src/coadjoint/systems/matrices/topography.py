"""Topography of quasi-geostrophic flows: modes from functions, modes, labelled arrays and files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.errors import in_one_line
from coadjoint.labels import is_xarray
from coadjoint.long_operations import warn_caller
from coadjoint.optional_packages import MissingPackageError
from coadjoint.short_repr import short
from coadjoint.systems.matrices.labelled_fields import WITHOUT_UNITS, labelled_field, read_field, units_of
from coadjoint.validation import read_finite, read_numbers, to_array

if TYPE_CHECKING:
    from coadjoint.systems.matrices.fluid_system import FluidSystem

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

ROUNDING = 1e-14
"""Relative to the largest mode: smaller ones are round-off."""
MEAN_TOLERANCE = 1e-6
"""Relative to the largest value, for fields of float32."""
FORMS = (
    "a function of the two coordinates in radians, modes, an xarray.DataArray with coordinates, a NetCDF file, or an "
    "array in the order of grid()"
)


def topography_rows(given: Any, surface: FluidSystem, quantity: str = "height", what: str = "topography") -> Floats:
    """Return the modes of a topography, relative to the depth, as rows: two numbers, real and imaginary part, (k, 4).

    `surface` is a fluid without rotation on the same surface and of the same N, which converts fields; `what` names the
    argument.
    """
    if isinstance(given, Mapping):
        return _of_modes(given, surface, quantity, what)
    if callable(given) and not is_xarray(given):
        given = _values_of(given, surface, what)
    elif isinstance(given, str | Path):
        given = read_field(given, surface.surface, None, None)
    if is_xarray(given):
        if units_of(given) not in WITHOUT_UNITS:
            raise ValueError(
                f"{what} has the units {units_of(given)}; give the height divided by the mean depth of the fluid, "
                "as RotatingPlanet.without_units returns it from metres"
            )
        values, first, second, _ = labelled_field(given, surface.surface, str(given.name or what))
        if values.ndim != 2:
            raise ValueError(f"{what} has the shape {values.shape}; select one field over the two coordinates")
        return _checked(values, surface.modes_with_mean(values, first, second), surface, quantity, what)
    values = read_numbers(to_array(given, what), what)
    if values.ndim == 2 and values.shape[1] == 4:
        whole = values[:, :2].astype(np.int64)
        if (whole != values[:, :2]).any():
            raise ValueError(f"{what} is {short(given)}; rows of modes begin with two whole numbers")
        modes = {(int(a), int(b)): complex(*row[2:]) for (a, b), row in zip(whole, values, strict=True)}
        if len(modes) < len(values):
            raise ValueError(f"{what} has a mode twice; give each once")
        return _of_modes(modes, surface, quantity, what)
    shape = tuple(map(len, surface.grid()))
    if values.shape != shape:
        raise ValueError(
            f"{what} has the shape {values.shape} and no coordinates; give {FORMS}, here of the shape {shape}"
        )
    return _checked(values, surface.modes_with_mean(values), surface, quantity, what)


def _values_of(function: Callable[..., Any], surface: FluidSystem, what: str) -> Floats:
    """Return the values of a function of two arrays of coordinates on the default grid."""
    first, second = surface.grid()
    mesh = np.meshgrid(first, second, indexing="ij")
    try:
        values = np.broadcast_to(np.asarray(function(*mesh), dtype=np.float64), mesh[0].shape)
    except (TypeError, ValueError) as reason:
        message = in_one_line(str(reason), 200)
        raise TypeError(f"{what} is {short(function)}; it must take two arrays of coordinates ({message})") from None
    return np.array(read_finite(values, f"the value of {what}"))


def _checked(values: Floats, modes: Complexes, surface: FluidSystem, quantity: str, what: str) -> Floats:
    """Return modes as rows; warn if the values are no fractions of a depth, or have a mean, which is dropped."""
    size = float(np.abs(values).max(initial=0.0))
    _warn_unless_small(size, quantity, what)
    mean = float(modes[0, 0].real) * surface.mean_factor
    if abs(mean) > MEAN_TOLERANCE * size:
        text = f"{what} has the mean {mean:g}, which is dropped: heights are relative to the mean depth"
        warn_caller(text, UserWarning)
    modes[0, 0] = 0.0
    return _rows(modes, surface)


def _of_modes(given: Mapping[Any, Any], surface: FluidSystem, quantity: str, what: str) -> Floats:
    """Return given modes as rows; warn as for values on a grid, or without ducc0 by their root mean square."""
    modes = surface.read_modes(given)
    if quantity == "height" and modes.any():
        try:
            size = np.abs(surface.to_grid(surface.from_modes(modes))).max()
        except MissingPackageError:
            size = np.sqrt((np.sum(np.abs(modes) ** 2) + np.sum(np.abs(modes[:, 1:]) ** 2)) / (4.0 * np.pi))
        _warn_unless_small(float(size), quantity, what)
    return _rows(modes, surface)


def _warn_unless_small(size: float, quantity: str, what: str) -> None:
    """Warn if heights of this largest size are no fractions of a depth: the ground is above the fluid."""
    if quantity == "height" and size > 1.0:
        warn_caller(
            f"{what} reaches {size:g}; it is the height divided by the mean depth, which is small in "
            "quasi-geostrophic flow, and at 1 the ground is above the fluid; divide heights by the depth",
            UserWarning,
        )


def _rows(modes: Complexes, surface: FluidSystem) -> Floats:
    """Return the modes of an array as rows, of each pair of conjugate ones the first; round-off is dropped."""
    chosen = np.argwhere(np.abs(modes) > ROUNDING * np.abs(modes).max(initial=0.0))
    n = np.arange(len(modes))
    if surface.surface == "torus":
        n = np.where(n > len(modes) // 2, n - len(modes), n)
        chosen = np.array([(i, j) for i, j in chosen if (n[i], n[j]) > (0, 0)], dtype=np.int64).reshape(-1, 2)
    c = modes[chosen[:, 0], chosen[:, 1]]
    return np.column_stack([n[chosen[:, 0]], n[chosen[:, 1]], c.real, c.imag]).astype(np.float64)


def modes_of_rows(rows: Floats) -> dict[tuple[int, int], complex]:
    """Return rows of modes as a mapping."""
    return {(int(a), int(b)): complex(real, imaginary) for a, b, real, imaginary in rows}


def plain_rows(rows: Floats | None) -> tuple[tuple[float, ...], ...] | None:
    """Return rows of modes as tuples of numbers, in the form of parameters."""
    return None if rows is None else tuple(map(tuple, rows.tolist()))
