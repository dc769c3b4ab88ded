"""Known flows on the sphere: Rossby-Haurwitz waves with their exact motion, and a zonal jet."""

from __future__ import annotations

from math import pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.short_repr import short
from coadjoint.systems.matrices.spherical_modes import generators, harmonics_of_matrix, scale
from coadjoint.validation import read_finite, read_integer, read_number, read_positive

if TYPE_CHECKING:
    from coadjoint.systems.fluids.sphere_euler import SphereEuler

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

ROUNDING_TOLERANCE = 1e-12
"""Relative to the largest coefficient: smaller ones are treated as round-off."""
BUMP = (1 / 3, 1 / 15)
"""Widths of the perturbation of the jet in longitude and latitude, in radians."""
JET = (pi / 7, 5 * pi / 14)


def rossby_haurwitz(
    system: SphereEuler,
    degree: int = 5,
    order: int = 4,
    *,
    zonal: float = 1.0,
    wave: float = 1.0,
    longitude: float = 0.0,
) -> Complexes:
    """Return the state of a Rossby-Haurwitz wave: solid rotation and one spherical harmonic.

    It is an exact solution for every N: the pattern rotates eastward with the angular velocity
    ``zonal - 2 (zonal + rotation)/(l(l + 1))`` without change of form; `exact` returns it.

    Parameters
    ----------
    degree, order : int
        l from 2 to N - 1, and m from 0 to l.
    zonal : float
        Angular velocity of the solid rotation, relative to the frame.
    wave : float
        Root mean square of the vorticity of the wave, which is relative to the frame.
    longitude : float
        Longitude of a maximum of the wave, in radians; unused for order 0.

    Returns
    -------
    (N, N) array

    Examples
    --------
    >>> import coadjoint as co
    >>> s = co.systems.sphere_euler(N=12)
    >>> W = s.rossby_haurwitz(5, 4, zonal=1.5)
    >>> turned = s.rossby_haurwitz(5, 4, zonal=1.5, longitude=2.0 * (1.5 - 3.0 / 30))
    >>> bool(np.abs(s.exact(W, 2.0) - turned).max() < 1e-12)
    True
    """
    l = read_integer(degree, "degree", 2, system.algebra.N - 1)
    m = read_integer(order, "order", 0, l)
    c = np.zeros(system.matrix_shape, dtype=np.complex128)
    c[1, 0] = 2 * read_number(zonal, "zonal") * sqrt(4 * pi / 3)
    size = read_number(wave, "wave") * sqrt(2 * pi if m else 4 * pi)
    c[l, m] = size * (-1) ** m * np.exp(-1j * m * read_number(longitude, "longitude")) if m else size
    return system.from_modes(c, absolute=False)


def zonal_jet(
    system: SphereEuler,
    speed: float = 1.0,
    *,
    band: tuple[float, float] = JET,
    perturbation: float = 0.01,
    longitude: float = 0.0,
) -> Complexes:
    """Return the state of an eastward jet between two latitudes, with a small perturbation that makes it break up.

    The jet is that of Galewsky, Scott and Polvani, smooth, and zero outside the band. The perturbation is a bump of
    vorticity in the middle of the jet.

    Parameters
    ----------
    speed : float
        Largest speed relative to the frame, in radii of the sphere per unit of time.
    band : (float, float)
        Southern and northern edge, in radians.
    perturbation : float
        Largest vorticity of the bump, as a fraction of ``speed`` over half the width of the band; with zero the flow is
        steady.
    longitude : float
        Longitude of the bump, in radians.

    Returns
    -------
    (N, N) array

    Raises
    ------
    MissingPackageError
        ducc0 is not installed.

    Notes
    -----
    J. Galewsky, R. K. Scott, L. M. Polvani, Tellus A 56 (2004) 429, who perturb the height of the fluid instead of the
    vorticity.
    """
    south, north = _read_band(band)
    max_speed, fraction = read_positive(speed, "speed"), read_number(perturbation, "perturbation")
    shape = max(4 * system.algebra.N, 512), 2 * max(2 * system.algebra.N, 64)
    latitude, east = system.grid(shape)
    inside = (latitude > south) & (latitude < north)
    product = np.where(inside, (latitude - south) * (latitude - north), -1.0)
    # the speed u, and from it -(1/cos) d(u cos)/d latitude
    with np.errstate(under="ignore"):
        u = np.where(inside, max_speed * np.exp(1 / product + 4 / (north - south) ** 2), 0.0)
        slope = -u * (2 * latitude - south - north) / product**2
    zonal = np.where(inside, u * np.tan(latitude) - slope, 0.0)
    middle, half = (south + north) / 2, (north - south) / 2
    distance = np.mod(east - read_number(longitude, "longitude") + pi, 2 * pi) - pi
    with np.errstate(under="ignore"):
        along = np.exp(-((distance / BUMP[0]) ** 2))
        across = np.cos(latitude) / np.cos(middle) * np.exp(-(((latitude - middle) / BUMP[1]) ** 2))
    field = zonal[:, None] + fraction * max_speed / half * across[:, None] * along
    return system.from_grid(field, absolute=False)


def _read_band(band: Any) -> tuple[float, float]:
    edges = read_finite(band, "band")
    if edges.shape != (2,) or not -pi / 2 <= edges[0] < edges[1] <= pi / 2:
        raise ValueError(f"band is {short(band)}; give a southern and a northern latitude in radians, in this order")
    return float(edges[0]), float(edges[1])


def exact_motion(W: Complexes, t: Any, rotation: float) -> Complexes:
    """Return the exact motion, (N, N) or (k, N, N), of a zonal flow, or of a state of degree 1 and another one."""
    # With A the part of degree 1, F that of the rotation of the frame and ``k = 1/(l(l + 1)) - 1/2``, W is conjugated
    # by ``exp(t F/2) exp(t k A)``: the frame rotates backward, and the pattern about the axis of A.
    times, N = read_finite(t, "t"), W.shape[-1]
    if W.ndim != 2 or times.ndim > 1:
        raise ValueError(f"x0 has the shape {W.shape} and t {times.shape}; give ({N}, {N}), and one time or several")
    c = harmonics_of_matrix(W)
    size = np.abs(c).max(initial=0.0)
    degrees = [l for l in range(2, N) if np.abs(c[l]).max() > ROUNDING_TOLERANCE * size]
    if np.abs(c[:, 1:]).max(initial=0.0) <= ROUNDING_TOLERANCE * size:
        return np.broadcast_to(W, (*times.shape, N, N)).copy()
    if len(degrees) > 1:
        raise ValueError(
            f"x0 has the degrees {short(degrees)}; a closed form is known for a zonal flow, and for the degree 1 and "
            "one further degree: integrate it"
        )
    l = degrees[0] if degrees else 1
    S = np.stack(generators(N))
    A = np.einsum("a,aij->ij", _components(W, N), S)
    speeds, columns = np.linalg.eigh(1j * (1 / (l * (l + 1)) - 1 / 2) * A)
    frame = np.exp(np.multiply.outer(-rotation * times, np.diagonal(S[2])))
    rotation_about_A = (np.exp(-1j * np.multiply.outer(times, speeds))[..., None, :] * columns) @ np.conj(columns.T)
    rotation_matrix = frame[..., :, None] * rotation_about_A
    return np.asarray(rotation_matrix @ W @ np.conj(np.swapaxes(rotation_matrix, -1, -2)))


def _components(W: Complexes, N: int) -> Floats:
    """Return a in W = sum a_b S_b + higher degrees, for matrices (..., N, N)."""
    squared = N * (N * N - 1) / 12
    return np.asarray(np.einsum("aij,...ij->...a", np.conj(np.stack(generators(N))), W).real / squared)


def angular_momentum(W: Any) -> Floats:
    """Return the integral of (x, y, z) omega over the sphere for matrices (..., N, N), shape (..., 3)."""
    W = np.asarray(W, dtype=np.complex128)
    N = W.shape[-1]
    return -_components(W, N) * (N * (N * N - 1) / 12) / scale(N) ** 2


def momentum_along(axis: str, W: Any) -> Any:
    """Return the angular momentum along the axis "x", "y" or "z" of states (..., N, N)."""
    component = angular_momentum(W)[..., "xyz".index(axis)]
    return float(component) if component.ndim == 0 else component
