"""Latitude-longitude grids on the sphere: synthesis from and analysis into spherical harmonics."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.memory import check_available_memory
from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.validation import check_finite, read_choice, read_finite, read_integer, read_numbers, to_array

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

GRIDS = {"clenshaw-curtis": "CC", "fejer": "F1", "gauss-legendre": "GL"}
"""Rows of latitude: equally spaced with the poles, equally spaced without them, Gauss-Legendre nodes."""
MAX_GRID_SIZE = 2**16  # rows or columns; a larger grid exceeds any memory


def read_shape(shape: Any, min_shape: tuple[int, int], default: tuple[int, int]) -> tuple[int, int]:
    """Validate the numbers of rows and columns of a grid."""
    if shape is None:
        return default
    try:
        rows, columns = shape
    except (TypeError, ValueError):
        raise TypeError(f"shape is {short(shape)}; give two whole numbers, such as {default}") from None
    return read_integer(rows, "shape[0]", min_shape[0], MAX_GRID_SIZE), read_integer(
        columns, "shape[1]", min_shape[1], MAX_GRID_SIZE
    )


def default_shape(N: int) -> tuple[int, int]:
    """Return the smallest grid with poles and an even number of columns that resolves all degrees below N."""
    return N + 1, 2 * N


def resolved(points: str, rows: int) -> int:
    """Return the largest degree that a grid with this number of rows resolves."""
    return rows - 2 if points == "clenshaw-curtis" else rows - 1


def latitudes(points: str, rows: int) -> Floats:
    """Return the latitudes of the rows in radians, from north to south."""
    points = read_choice(points, "points", GRIDS)
    if points == "gauss-legendre":
        return np.arcsin(np.polynomial.legendre.leggauss(rows)[0])[::-1].copy()
    row = np.arange(rows)
    return pi / 2 - (pi * row / (rows - 1) if points == "clenshaw-curtis" else pi * (row + 0.5) / rows)


def longitudes(columns: int, first: float = 0.0) -> Floats:
    """Return the longitudes of the columns in radians, eastward."""
    return first + 2 * pi * np.arange(columns) / columns


def values_of(c: Complexes, shape: tuple[int, int], points: str) -> Floats:
    """Return values (..., rows, columns) of the field with coefficients ``c[l, m]``, (..., N, N), at grid points."""
    code = GRIDS[read_choice(points, "points", GRIDS)]
    require_packages("a grid on the sphere", "ducc0")
    from ducc0.sht import synthesis_2d

    N, lead = c.shape[-1], c.shape[:-2]
    check_available_memory(
        8 * (2 + int(np.prod(lead))) * shape[0] * shape[1], f"values on {shape[0]} x {shape[1]} points"
    )
    rows, columns = _triangle(N - 1, N - 1)
    values = np.empty((*lead, *shape))
    for index in np.ndindex(lead):
        alm = np.ascontiguousarray(c[index][rows, columns])[None]
        values[index] = synthesis_2d(
            alm=alm, spin=0, lmax=N - 1, mmax=N - 1, geometry=code, ntheta=shape[0], nphi=shape[1]
        )[0]
    return values


def coefficients_of(values: Any, N: int, points: str, first: float = 0.0) -> Complexes:
    """Return c (..., N, N), ``c[l, m]``, of real values (..., rows, columns), for degrees that N and grid resolve."""
    # Exact for degrees up to `resolved` and orders up to (columns - 1)/2; `first` is the longitude of the first column.
    code = GRIDS[read_choice(points, "points", GRIDS)]
    require_packages("a grid on the sphere", "ducc0")
    from ducc0.sht import analysis_2d

    field = read_values(values)
    rows, columns = field.shape[-2:]
    degree_bound = resolved(points, rows)
    if degree_bound < 1:
        raise ValueError(
            f"values has {rows} rows of latitude; a grid of this kind needs at least {rows - degree_bound + 1}"
        )
    l_most, m_most = degree_bound, min(degree_bound, (columns - 1) // 2)
    lead = field.shape[:-2]
    check_available_memory(
        16 * (int(np.prod(lead)) * N * N + l_most * m_most), f"coefficients up to the degree {l_most}"
    )
    l, m = _triangle(l_most, m_most)
    resolved_modes = l < N
    c = np.zeros((*lead, N, N), dtype=np.complex128)
    for index in np.ndindex(lead):
        map_ = np.ascontiguousarray(field[index])[None]
        alm = analysis_2d(map=map_, spin=0, lmax=l_most, mmax=m_most, geometry=code, phi0=first)[0]
        c[(*index, l[resolved_modes], m[resolved_modes])] = alm[resolved_modes]
    return c


def read_values(values: Any, what: str = "values") -> Floats:
    """Validate real, finite values on a grid, (..., rows, columns)."""
    field = read_numbers(to_array(values, what), what)
    if field.ndim < 2:
        raise ValueError(f"{what} has the shape {field.shape}; give (..., rows, columns)")
    check_finite(field, what)
    return field


def delta_coefficients(points: Floats, strengths: Floats, N: int) -> Complexes:
    """Return c (N, N) of a sum of delta functions at points (k, 2), latitudes and longitudes, with strengths (k,)."""
    require_packages("fields about points on the sphere", "ducc0")
    from ducc0.sht import adjoint_synthesis_general

    locations = np.ascontiguousarray(np.stack([pi / 2 - points[:, 0], np.mod(points[:, 1], 2 * pi)], axis=-1))
    alm = adjoint_synthesis_general(
        map=np.ascontiguousarray(strengths)[None], spin=0, lmax=N - 1, mmax=N - 1, loc=locations, epsilon=3e-13
    )[0]
    c = np.zeros((N, N), dtype=np.complex128)
    c[_triangle(N - 1, N - 1)] = alm
    return c


def cap_profile(radius: float, N: int) -> Floats:
    """Return the integrals of P_l(cos distance) over a cap, for l from 0 to N - 1."""
    if not 0.0 < radius < pi:
        raise ValueError(f"a radius is {short(radius)}; give radians below pi")
    x = np.cos(radius)
    P = np.empty(N + 2)
    P[0], P[1] = 1.0, x
    for l in range(1, N + 1):
        P[l + 1] = ((2 * l + 1) * x * P[l] - l * P[l - 1]) / (l + 1)
    integrals = np.empty(N)
    integrals[0] = 2 * pi * (1 - x)
    integrals[1:] = 2 * pi * (P[: N - 1] - P[2 : N + 1]) / (2 * np.arange(1, N) + 1)
    return integrals


def read_places(places: Any, what: str) -> Floats:
    """Validate latitudes and longitudes (k, 2) in radians."""
    points = read_finite(places, what)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"{what} has the shape {points.shape}; give (k, 2), a latitude and a longitude in each row")
    if (np.abs(points[:, 0]) > pi / 2).any():
        latitude = points[np.abs(points[:, 0]) > pi / 2][0, 0]
        raise ValueError(f"{what} has the latitude {latitude:g}; give radians, from -pi/2 to pi/2")
    return points


def grid_orientation(rows: Floats, columns: Floats) -> tuple[int, str, int]:
    """Return the direction of rows (1 from north to south, else -1), the kind of points, and that of columns."""
    if rows.ndim != 1 or columns.ndim != 1 or min(len(rows), len(columns)) < 3:
        raise ValueError("a grid on the sphere needs at least three rows and columns, and a coordinate of each")
    north, east = (-1 if rows[0] < rows[-1] else 1), (-1 if columns[0] > columns[-1] else 1)
    # coordinates in files may be float32 in degrees
    tolerance = 1e-5
    expected = longitudes(len(columns), float(columns[::east][0]))
    if np.abs(columns[::east] - expected).max() > tolerance:
        raise ValueError("the longitudes are not equally spaced over 2 pi; give one period without its end point")
    for points in GRIDS:
        if np.abs(rows[::north] - latitudes(points, len(rows))).max() <= tolerance:
            return north, points, east
    raise ValueError(f"the latitudes match no known grid ({', '.join(GRIDS)}); interpolate to one of them")


def _triangle(l_most: int, m_most: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the degrees and orders of the coefficients in the order of ducc0, by orders."""
    m, l = np.divmod(np.arange((m_most + 1) * (l_most + 1)), l_most + 1)
    valid = l >= m
    return l[valid], m[valid]
