"""Initial states of fluids (random fields, blobs, patches, files), as methods of every `FluidSystem`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coadjoint.errors import in_one_line
from coadjoint.keyword_hints import suggest_keywords
from coadjoint.labels import is_xarray
from coadjoint.short_repr import short
from coadjoint.systems.matrices.labelled_fields import kind_of, read_field
from coadjoint.systems.matrices.planet import RotatingPlanet, read_planet
from coadjoint.validation import read_finite, read_integer, read_number, read_positive

if TYPE_CHECKING:
    from coadjoint.systems.matrices.fluid_system import FluidSystem

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

MAX_WIDTH = 1e100
"""Upper limit of widths, whose squares would overflow; the smoothing is already complete."""
DEFAULT_DEGREES = (2, 10)
"""First and last degree of a random field by default."""


@suggest_keywords
def random(
    self: FluidSystem,
    seed: int,
    *,
    degrees: tuple[int, int] | None = None,
    spectrum: Callable[[Floats], Any] | npt.ArrayLike | None = None,
    energy: float | None = None,
    enstrophy: float | None = None,
) -> Complexes:
    """Return the state of a random smooth vorticity with a given spectrum, relative to a rotating frame.

    The vector of the modes of each degree has a uniformly distributed random direction and a prescribed length. Numbers
    are drawn degree by degree, so a seed determines the same field for every N that resolves it.

    Parameters
    ----------
    seed : int
        Seed of NumPy's default generator.
    degrees : (int, int), optional
        First and last degree (on the torus wave number) that is not zero. By default 2 to 10, or up to the largest
        that N resolves; with a spectrum all degrees of it.
    spectrum : callable or array_like, optional
        The energy of each degree: ``spectrum(l)`` of an array of degrees, or ``spectrum[l]``. By default every mode has
        the same share of the enstrophy.
    energy, enstrophy : float, optional
        The field is scaled so that the integral of |u|^2/2, or of omega^2/2, over the surface has this value, in the
        frame.
        With neither, and without a spectrum, the vorticity has a root mean square of 1.

    Returns
    -------
    (N, N) array

    Raises
    ------
    TypeError, ValueError
        Degrees that N does not resolve, a spectrum that is negative or zero, or both energy and enstrophy given.

    Examples
    --------
    >>> import coadjoint as co
    >>> s = co.systems.sphere_euler(N=12)
    >>> W = s.random(1, spectrum=lambda l: l**-3.0, degrees=(3, 6), energy=2.0)
    >>> l, E = s.energy_spectrum(W)
    >>> (E[2:6] * l[2:6] ** 3.0 / E[2] / 27).round(12), round(float(E.sum()), 12)
    (array([1., 1., 1., 1.]), 2.0)
    """
    generator = np.random.default_rng(read_integer(seed, "seed", 0))
    first, last = _read_degrees(degrees, spectrum, self)
    modes = self.random_modes(generator, last)
    if spectrum is None:
        weights = 0.5 * self.squares
        target = np.asarray(np.bincount(self.degrees.ravel(), self.squares.ravel())[first : last + 1], dtype=float)
        if energy is None and enstrophy is None:
            enstrophy = self.area / 2
    else:
        weights = self.energy_weights
        target = _read_spectrum(spectrum, first, last)
    factors = np.zeros(int(self.degrees.max()) + 1)
    factors[first : last + 1] = np.sqrt(target / self.spectrum_of_modes(modes, weights)[1][first - 1 : last])
    return self.from_modes(_scaled(self, modes * factors[self.degrees], energy, enstrophy), absolute=False)


@suggest_keywords
def blobs(self: FluidSystem, places: Any, strengths: Any, widths: Any) -> Complexes:
    """Return the state of round blobs of vorticity, diffused point vortices, relative to a rotating frame.

    On the torus, and approximately on the sphere, each is a Gaussian. The vorticity of a flow on a closed surface has
    zero mean: strength over area is subtracted everywhere.

    Parameters
    ----------
    places : (k, 2) array_like
        Latitudes and longitudes in radians; x and y on the torus.
    strengths : float or (k,) array_like
        Circulations, the integrals of the vorticity of each blob.
    widths : float or (k,) array_like
        Standard deviations in radians. Narrow blobs cause ripples: use at least pi over the largest degree that N
        resolves.

    Returns
    -------
    (N, N) array

    Raises
    ------
    TypeError, ValueError
        Places off the surface, or numbers that do not fit.

    Examples
    --------
    >>> import coadjoint as co
    >>> s = co.systems.torus_euler(N=33)
    >>> W = s.blobs([(3.0, 3.5), (3.0, 2.5)], strengths=[1.0, -1.0], widths=0.3)
    >>> s.to_grid(W).shape
    (33, 33)
    """
    modes = _sum_about_points(self, ("blobs", "strengths", "widths"), places, strengths, widths, lambda width: 1.0)
    return self.from_modes(modes, absolute=False)


@suggest_keywords
def patches(self: FluidSystem, places: Any, radii: Any, vorticities: Any, *, edge: float | None = None) -> Complexes:
    """Return the state of round patches of constant vorticity, relative to a rotating frame.

    The mean of the vorticity is subtracted, so that the total is zero.

    Parameters
    ----------
    places : (k, 2) array_like
        Centres: latitudes and longitudes in radians; x and y on the torus.
    radii : float or (k,) array_like
        Distances from centre to edge along the surface, in radians, below pi.
    vorticities : float or (k,) array_like
        Vorticities inside the patches.
    edge : float, optional
        Standard deviation of the Gaussian that smooths edges, in radians; by default pi over the largest degree that N
        resolves. Zero leaves the ripples of a truncated series.

    Returns
    -------
    (N, N) array

    Raises
    ------
    TypeError, ValueError
        Places off the surface, or numbers that do not fit.

    Examples
    --------
    >>> import coadjoint as co
    >>> s = co.systems.torus_euler(N=65)
    >>> W = s.patches([(3.0, 3.0)], radii=1.0, vorticities=2.0)
    >>> x, y = s.grid()
    >>> bool(np.ptp(s.to_grid(W)) < 2.01 and np.ptp(s.to_grid(W)) > 1.99)
    True
    """
    sigma = np.pi / self.resolved_degree if edge is None else read_number(edge, "edge")
    if sigma < 0.0:
        raise ValueError(f"edge is {sigma:g}; give a width of at least 0")
    names = "patches", "vorticities", "radii"
    modes = _sum_about_points(self, names, places, vorticities, radii, self.disc_profile, sigma)
    return self.from_modes(modes, absolute=False)


@suggest_keywords
def from_file(
    self: FluidSystem,
    path: str | Path,
    *,
    variable: str | None = None,
    select: Mapping[str, int] | None = None,
    absolute: bool | None = None,
    planet: RotatingPlanet | None = None,
) -> Complexes:
    """Return the state read from a file, such as a dataset of a run or the restart of another model.

    Parameters
    ----------
    path : str or Path
        ``.npy``: a complex (N, N) array is a state W; a real array contains values of the vorticity at the points of a
        grid, as for `from_grid`. ``.nc``: NetCDF with two coordinates, as for `from_grid` of an `xarray.DataArray`.
    variable : str, optional
        Variable of the NetCDF file, if it has several over these coordinates.
    select : mapping of str to int, optional
        Index along each further axis of the NetCDF variable, such as ``{"time": -1}``.
    absolute : bool, optional
        Whether values on a grid are of the absolute vorticity, for quasi-geostrophic flows of the potential one; by
        default what the variable names by its long name, its standard name, or its own: ``vor``, ``vo``, ``vorticity``,
        ``zeta`` a relative vorticity, ``q``, ``pv`` the absolute or potential one, ``psi`` a stream function; other
        ones are relative to the rotating frame.
    planet : RotatingPlanet, optional
        Units of the planet, needed if the variable has units other than 1.

    Returns
    -------
    (..., N, N) array

    Raises
    ------
    OSError, TypeError, ValueError
        The file does not exist, or does not contain such data.
    MissingPackageError
        xarray or h5netcdf is needed for NetCDF and is not installed.
    """
    values = read_field(path, self.surface, variable, select)
    if planet is not None and not is_xarray(values):
        raise ValueError(f"{Path(path).name} has no units; omit planet")
    if np.iscomplexobj(values):
        return self.algebra.read(values, short(str(path)))
    if is_xarray(values):
        values = values if planet is None else read_planet(planet).without_units(values)
        absolute = False if absolute is None and kind_of(values) is None else absolute
    else:
        absolute = absolute if absolute is not None else False
    return self.from_grid(values, absolute=absolute)


def _sum_about_points(
    system: FluidSystem,
    names: tuple[str, str, str],
    places: Any,
    strengths: Any,
    sizes: Any,
    profile: Callable[[float], Any],
    edge: float | None = None,
) -> Complexes:
    """Return the modes of fields about points; `sizes` are the widths of blobs or the radii of patches."""
    points = system.read_places(places, f"places of {names[0]}")
    factors, radii = (
        _one_per_point(argument, len(points), name)
        for argument, name in zip((strengths, sizes), names[1:], strict=True)
    )
    if not (radii > 0.0).all():
        raise ValueError(f"{names[2]} is {short(sizes)}; give positive numbers")
    total = np.zeros(system.degrees.shape, dtype=np.complex128)
    for radius in np.unique(radii):
        selected = radii == radius
        smoothing = np.exp(-system.eigenvalues * min(radius if edge is None else edge, MAX_WIDTH) ** 2 / 2)
        total += system.point_modes(points[selected], factors[selected]) * profile(float(radius)) * smoothing
    total[system.degrees < 1] = 0.0
    return total


def _one_per_point(argument: Any, count: int, what: str) -> Floats:
    numbers = read_finite(argument, what)
    if numbers.shape not in ((), (count,)):
        raise ValueError(f"{what} has the shape {numbers.shape}; give one number, or one for each of {count} places")
    return np.array(np.broadcast_to(numbers, (count,)))


def _read_degrees(degrees: Any, spectrum: Any, system: FluidSystem) -> tuple[int, int]:
    resolved = system.resolved_degree
    if degrees is None:
        if spectrum is None:
            return min(DEFAULT_DEGREES[0], resolved), min(DEFAULT_DEGREES[1], resolved)
        highest = resolved if callable(spectrum) else np.size(read_finite(spectrum, "spectrum")) - 1
        if highest > resolved:
            raise ValueError(f"spectrum goes to the degree {highest}; N resolves those up to {resolved}")
        return 1, max(1, highest)
    try:
        first, last = degrees
    except (TypeError, ValueError):
        raise TypeError(f"degrees is {short(degrees)}; give the first and the last one, such as (2, 10)") from None
    first = read_integer(first, "degrees[0]", 1, resolved)
    return first, read_integer(last, "degrees[1]", first, resolved)


def _read_spectrum(spectrum: Any, first: int, last: int) -> Floats:
    if callable(spectrum):
        try:
            returned = spectrum(np.arange(first, last + 1.0))
        except (TypeError, ValueError) as reason:
            message = in_one_line(str(reason), 200)
            raise TypeError(f"spectrum is {short(spectrum)}; it must take an array of degrees ({message})") from None
        energies = read_finite(returned, "spectrum of degrees")
        if energies.shape != (last + 1 - first,):
            raise ValueError(f"spectrum returns the shape {energies.shape}; it must return one number for each degree")
    else:
        argument = read_finite(spectrum, "spectrum")
        if argument.ndim != 1 or len(argument) <= last:
            raise ValueError(f"spectrum has the shape {argument.shape}; give the energy of the degrees 0, ..., {last}")
        energies = argument[first : last + 1]
    if (energies < 0.0).any() or not energies.any():
        raise ValueError("spectrum must be positive or zero, and not zero at all degrees")
    return energies


def _scaled(system: FluidSystem, modes: Complexes, energy: Any, enstrophy: Any) -> Complexes:
    if energy is not None and enstrophy is not None:
        raise ValueError("energy and enstrophy are both given; give only one of them")
    if energy is None and enstrophy is None:
        return modes
    target = read_positive(energy, "energy") if enstrophy is None else read_positive(enstrophy, "enstrophy")
    weights = system.energy_weights if enstrophy is None else 0.5 * system.squares
    return modes * np.sqrt(target / system.spectrum_of_modes(modes, weights)[1].sum())
