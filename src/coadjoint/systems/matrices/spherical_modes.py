"""Spherical harmonics as matrices and on grids: coefficients of a vorticity, its matrix W, its values, the Laplacian.

The vorticity is ``omega = sum over l, m of c_lm Y_lm`` with orthonormal spherical harmonics in the phase convention of
Condon and Shortley; c_l(-m) = (-1)^m conj(c_lm) for a real field. Its matrix is
``W = i S sum of c_lm T_lm`` with ``S^2 = N (N^2 - 1)/(16 pi)``, where tr(T_lm* T_l'm') = 1 or 0:

- T_lm, m >= 0, is real and lies on the diagonal of the entries (i, i + m); i = 0 is the north pole;
- on each diagonal it is an eigenvector of the Hoppe-Yau Laplacian, with the eigenvalue l(l + 1);
- ``T_l(-m) = (-1)^m`` times the transpose of T_lm;
- the coordinates x, y, z of the sphere have the matrices -S_1, -S_2, -S_3 of `generators`.

W is ``(i/hbar)`` times the Hermitian matrix that represents omega, ``hbar = 2/sqrt(N^2 - 1)``, and [P, W] is then the
matrix of ``{psi, omega}`` up to O(1/N^2): ``W' = [P, W]`` is the Euler equation of the unit sphere in physical time,
``d omega/dt + u . grad omega = 0`` with ``u = r x grad psi``, ``laplacian psi = omega``.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from math import pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.optional_packages import require_packages
from coadjoint.short_repr import short
from coadjoint.validation import (
    read_choice,
    read_complex,
    read_finite,
)

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

MAX_CACHE_BYTES = 2**32
"""Cache size in bytes for matrix harmonics, about N^3/6 numbers for N; beyond it they are recomputed on each use."""


def scale(N: int) -> float:
    """Return S in ``W = i S sum c_lm T_lm``: integrals over the sphere are traces over S^2."""
    return sqrt(N * (N * N - 1) / (16 * pi))


def laplacian(N: int) -> tuple[Floats, Floats]:
    """Return L = -sum_a [S_a, [S_a, .]] by diagonal: ``main[i, m]`` for entry (i, i + m), and couplings `beside`."""
    # The eigenvalues on diagonal m are l(l + 1), l = m, ..., N - 1. J. Hoppe and S.-T. Yau, "Some properties of matrix
    # harmonics on S^2", Comm. Math. Phys. 195, 67 (1998).
    i, m = np.arange(N)[:, None], np.arange(N)[None, :]
    valid = i + m < N
    main = np.where(valid, (N - 1) * (2 * i + 1 + m) - 2 * i * (i + m), 1).astype(float)
    # (i (N - i)) (j (N - j)) with j = i + m is an integer below 2^53, exact for N up to about ten thousand
    product = (i * (N - i)) * ((i + m) * np.maximum(N - i - m, 0))
    return main, -np.sqrt(np.where(valid, product, 0).astype(float))


@lru_cache(maxsize=8)
def generators(N: int) -> tuple[Complexes, Complexes, Complexes]:
    """Return the anti-Hermitian generators S_1, S_2, S_3 of spin (N - 1)/2, with [S_1, S_2] = S_3 and cyclic."""
    s = (N - 1) / 2
    raising = np.diag(np.sqrt(np.arange(1, N) * np.arange(N - 1, 0, -1.0)), 1)
    first, second = (raising + raising.T) / 2, (raising - raising.T) / 2j
    # S_a = -i J_a with [J_1, J_2] = i J_3
    return -1j * first, -1j * second, -1j * np.diag(s - np.arange(N)).astype(complex)


@lru_cache(maxsize=1)
def _cached_orders(N: int) -> dict[int, Floats]:
    """Return the harmonics of the most recent N that are cached, by order."""
    return {}


def _cached_harmonics(N: int, m: int) -> Floats:
    cached = _cached_orders(N)
    entries = cached.get(m)
    if entries is None:
        entries = harmonics(N, m)
        size = sum(others.nbytes for others in tuple(cached.values()))
        if size + entries.nbytes <= MAX_CACHE_BYTES:
            cached[m] = entries
    return entries


def harmonics(N: int, m: int) -> Floats:
    """Return the entries (i, i + m) of T_lm as [l - m, i], for i up to the middle; the parity is that of l - m."""
    # The position along the diagonal times T_lm is a sum of its neighbours in l, with positive factors that rise and
    # fall with l. Such a recurrence is stable from either end up to the maximum.
    n, m2 = N - m, m * m
    half = n - n // 2
    positions: Floats = np.asarray((n - 1) / 2 - np.arange(half), dtype=np.float64)
    l = np.arange(m + 1, N, dtype=float)
    beside: Floats = np.sqrt((l * l - m2) * (N * N - l * l) / (4 * l * l - 1)) / 2
    peak = int(np.argmax(beside)) if n > 1 else 0
    V = np.empty((n, half))
    V[: peak + 2] = _recurrence(positions, beside[: peak + 1])
    if peak + 2 < n:
        from_above = _recurrence(positions, beside[peak:][::-1])[::-1]
        forward, backward = V[peak : peak + 2], from_above[:2]
        V[peak:] = from_above * (np.sum(forward * backward, axis=0) / np.sum(backward * backward, axis=0))
    # near the north pole T_lm has the sign of (-1)^m
    V *= (-1.0) ** m / np.sqrt(np.sum(V * V, axis=0))
    return V


def _recurrence(positions: Floats, beside: Floats) -> Floats:
    """Return v, one row more than `beside`, with ``position v_k = beside_(k-1) v_(k-1) + beside_k v_(k+1)``."""
    # Columns begin with a positive number, and are scaled so that growing ones end with entries of order 1.
    v = np.ones((len(beside) + 1, len(positions)))
    for k in range(len(beside)):
        np.multiply(positions, v[k], out=v[k + 1])
        if k:
            v[k + 1] -= beside[k - 1] * v[k - 1]
        v[k + 1] /= beside[k]
        if k % 32 == 31 or k == len(beside) - 1:
            size = np.maximum(np.abs(v[k]), np.abs(v[k + 1]))
            large = size > (2.0**300 if k < len(beside) - 1 else 1.0)
            if large.any():
                v[: k + 2, large] /= size[large]
    return v


def diagonal_of(c: Complexes, N: int, m: int) -> Complexes:
    """Return the entries (i, i + m) of sum over l of c_l T_lm, from c of shape (..., N - m)."""
    V, n = _cached_harmonics(N, m), N - m
    even, odd = _times(c[..., ::2], V[::2]), _times(c[..., 1::2], V[1::2])
    return np.concatenate([even + odd, (even - odd)[..., : n // 2][..., ::-1]], axis=-1)


def coefficients_of_diagonal(d: Complexes, N: int, m: int) -> Complexes:
    """Return c of entries (i, i + m); inverse of `diagonal_of`."""
    V, n = _cached_harmonics(N, m), N - m
    half = n - n // 2
    upper, lower = d[..., :half], d[..., ::-1][..., :half]
    total = upper + lower
    if n % 2:
        total[..., -1] /= 2
    c = np.empty(d.shape, dtype=np.complex128)
    c[..., ::2] = _times(total, V[::2].T)
    c[..., 1::2] = _times(upper - lower, V[1::2].T)
    return c


def _times(x: Complexes, T: Floats) -> Complexes:
    products = np.stack([x.real, x.imag]) @ T
    return np.asarray(products[0] + 1j * products[1])


def matrix_of_harmonics(c: Complexes) -> Complexes:
    """Return W, (..., N, N), of coefficients ``c[l, m]``, m >= 0, of a real vorticity; m > l and l = 0 are ignored."""
    N = c.shape[-1]
    factor = 1j * scale(N)
    W = np.zeros(c.shape, dtype=np.complex128)
    for m in range(N):
        column = np.array(c[..., m:, m], dtype=np.complex128)
        if m == 0:
            column.imag, column[..., 0] = 0.0, 0.0
        if not column.any():
            continue
        d, i = factor * diagonal_of(column, N, m), np.arange(N - m)
        W[..., i + m, i] = -np.conj(d)
        W[..., i, i + m] = d
    return W


def harmonics_of_matrix(W: Any) -> Complexes:
    """Return c of W, shape (..., N, N), zero for m > l; inverse of `matrix_of_harmonics`."""
    W = np.asarray(W, dtype=np.complex128)
    N = W.shape[-1]
    factor = -1j / scale(N)
    c = np.zeros(W.shape, dtype=np.complex128)
    for m in range(N):
        c[..., m:, m] = coefficients_of_diagonal(factor * np.diagonal(W, m, -2, -1), N, m)
    c[..., :, 0].imag = 0.0
    c[..., 0, 0] = 0.0
    return c


def read_mode(mode: Any, value: Any, form: str) -> tuple[int, int, complex]:
    """Return the two whole numbers of a mode and its coefficient; TypeError or ValueError with the `form` to give."""
    try:
        first, second = (int(number) for number in mode)
        coefficient = complex(value)
        if (first, second) != tuple(mode):
            raise ValueError
    except (TypeError, ValueError):
        raise TypeError(f"modes has {short(mode)}: {short(value)}; give {form}") from None
    except OverflowError:
        raise ValueError(f"modes has {short(mode)}: {short(value)}, too large for float64; give {form}") from None
    return first, second, coefficient


def read_harmonics(argument: Any, N: int) -> Complexes:
    """Validate a mapping of (l, m) to a coefficient, or an array, and return c (..., N, N) of a real field."""
    if not isinstance(argument, Mapping):
        return _read_array(argument, N)
    c = np.zeros((N, N), dtype=np.complex128)
    for mode, value in argument.items():
        l, m, number = read_mode(mode, value, "(l, m): coefficient")
        if not (0 < l < N and abs(m) <= l and np.isfinite(number)):
            raise ValueError(
                f"mode {short(mode)}: {short(value)}; give a degree l from 1 to {N - 1}, an order m from -l to l, and "
                "a finite coefficient"
            )
        mirrored = (-1) ** m * number.conjugate()
        try:
            conjugate = complex(argument.get((l, -m), mirrored))
        except (TypeError, ValueError, OverflowError):
            continue  # reported at its own key
        if abs(conjugate - mirrored) > 1e-12 * abs(number):
            raise ValueError(
                f"modes ({l}, {m}) and ({l}, {-m}) do not belong to a real vorticity: c_l(-m) = (-1)^m conj(c_lm)"
            )
        c[l, abs(m)] = number if m > 0 else mirrored if m < 0 else number.real
    return c


def read_mode_array(argument: Any, N: int, pair: str, coefficient: str) -> Complexes:
    """Validate modes given as an array (..., N, N); messages name the pair of numbers of a mode and its coefficient."""
    c = read_complex(argument, "modes")
    if c.ndim < 2 or c.shape[-2:] != (N, N):
        raise ValueError(
            f"modes has the shape {c.shape}; give a mapping of {pair} to {coefficient}, or (..., {N}, {N})"
        )
    if not np.isfinite(c).all():
        raise ValueError(f"modes contains NaN or infinity; every {coefficient.split()[-1]} must be finite")
    return c


def _read_array(argument: Any, N: int) -> Complexes:
    c = read_mode_array(argument, N, "(l, m)", "a coefficient")
    violation = np.abs(np.where(np.arange(N)[:, None] < np.arange(N), c, 0)).max(initial=0.0)
    violation = max(violation, np.abs(c[..., 0, 0]).max(initial=0.0), np.abs(np.imag(c[..., 0])).max(initial=0.0))
    if violation > 1e-12 * np.abs(c).max(initial=0.0):
        raise ValueError("modes has entries [l, m] with m > l, or [0, 0], or complex ones of m = 0; these must be zero")
    return c


def as_mapping(c: Complexes) -> dict[tuple[int, int], complex]:
    """Return coefficients (N, N) as a mapping of (l, m), m from -l to l, without round-off."""
    modes: dict[tuple[int, int], complex] = {}
    for l, m in np.argwhere(np.abs(c) > 1e-14 * np.abs(c).max(initial=0.0)).tolist():
        number = complex(c[l, m])
        if m:
            modes[l, -m] = (-1) ** m * number.conjugate()
        modes[l, m] = number
    return dict(sorted(modes.items()))


GRIDS = {"clenshaw-curtis": "CC", "fejer": "F1", "gauss-legendre": "GL"}
"""Rows of latitude: equally spaced with the poles, equally spaced without them, Gauss-Legendre nodes."""


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
    return _synthesis(c, shape, points, spin=0)[..., 0, :, :]


def velocity_of(c: Complexes, shape: tuple[int, int], points: str) -> tuple[Floats, Floats]:
    """Return the eastward and northward velocity of a stream function with coefficients ``c[l, m]``, (..., N, N)."""
    # u = -d psi/d latitude, the derivative southward, and v = d psi/d longitude/cos(latitude)
    gradient = _synthesis(c, shape, points, spin=1, mode="DERIV1")
    return gradient[..., 0, :, :], gradient[..., 1, :, :]


def _synthesis(c: Complexes, shape: tuple[int, int], points: str, spin: int, mode: str = "STANDARD") -> Floats:
    """Return fields (..., 1 + spin, rows, columns) of coefficients at grid points."""
    code = GRIDS[read_choice(points, "points", GRIDS)]
    require_packages("a grid on the sphere", "ducc0")
    from ducc0.sht import synthesis_2d

    N, lead = c.shape[-1], c.shape[:-2]
    rows, columns = _triangle(N - 1, N - 1)
    values = np.empty((*lead, 1 + spin, *shape))
    for index in np.ndindex(lead):
        alm = np.ascontiguousarray(c[index][rows, columns])[None]
        values[index] = synthesis_2d(
            alm=alm, spin=spin, lmax=N - 1, mmax=N - 1, geometry=code, ntheta=shape[0], nphi=shape[1], mode=mode
        )
    return values


def coefficients_of(field: Floats, N: int, points: str, first: float = 0.0) -> Complexes:
    """Return c (..., N, N), ``c[l, m]``, of real values (..., rows, columns), for degrees that N and grid resolve."""
    # Exact for degrees up to `resolved` and orders up to (columns - 1)/2; `first` is the longitude of the first column.
    code = GRIDS[read_choice(points, "points", GRIDS)]
    require_packages("a grid on the sphere", "ducc0")
    from ducc0.sht import analysis_2d

    rows, columns = field.shape[-2:]
    degree_bound = resolved(points, rows)
    if degree_bound < 1:
        raise ValueError(
            f"values has {rows} rows of latitude; a grid of this kind needs at least {rows - degree_bound + 1}"
        )
    l_most, m_most = degree_bound, min(degree_bound, (columns - 1) // 2)
    lead = field.shape[:-2]
    l, m = _triangle(l_most, m_most)
    resolved_modes = l < N
    c = np.zeros((*lead, N, N), dtype=np.complex128)
    for index in np.ndindex(lead):
        map_ = np.ascontiguousarray(field[index])[None]
        alm = analysis_2d(map=map_, spin=0, lmax=l_most, mmax=m_most, geometry=code, phi0=first)[0]
        c[(*index, l[resolved_modes], m[resolved_modes])] = alm[resolved_modes]
    return c


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
        span = float(np.ptp(columns))
        if abs(span - 2 * pi) <= tolerance:
            raise ValueError(
                "the first and the last longitude are the same meridian; omit the last one, such as by "
                "isel(lon=slice(-1))"
            )
        if span + np.abs(np.diff(columns)).max() < 2 * pi - tolerance:
            raise ValueError(
                f"the longitudes span {np.degrees(span):.6g} degrees, a part of the sphere; give all of it"
            )
        raise ValueError("the longitudes are not equally spaced over 2 pi; give one period without its end point")
    for points in GRIDS:
        if np.abs(rows[::north] - latitudes(points, len(rows))).max() <= tolerance:
            return north, points, east
    first, last, step = rows.min(), rows.max(), np.abs(np.diff(rows)).max() + tolerance
    if first > step - pi / 2 or last < pi / 2 - step:
        raise ValueError(
            f"the latitudes go from {np.degrees(first):.6g} to {np.degrees(last):.6g} degrees, a part of the sphere; "
            "give all of it"
        )
    raise ValueError(f"the latitudes match no known grid ({', '.join(GRIDS)}); interpolate to one of them")


def _triangle(l_most: int, m_most: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the degrees and orders of the coefficients in the order of ducc0, by orders."""
    m, l = np.divmod(np.arange((m_most + 1) * (l_most + 1)), l_most + 1)
    valid = l >= m
    return l[valid], m[valid]
