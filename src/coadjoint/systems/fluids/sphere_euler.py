"""Quantized ideal fluids on the sphere: Zeitlin's model."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, partial
from math import pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.labels import is_xarray
from coadjoint.systems.matrices import sphere_states, spherical_modes
from coadjoint.systems.matrices.fluid_system import (
    FluidSystem,
    RelativeVorticity,
    entry_of_fluid,
    read_shape,
    read_values,
)
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.spherical_modes import (
    as_mapping,
    generators,
    harmonics_of_matrix,
    laplacian,
    matrix_of_harmonics,
    read_harmonics,
    scale,
)
from coadjoint.systems.matrices.streams import DiagonalSolve
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_integer, read_number

MAX_ROTATION = 1e100
MAX_N = 4096  # a state has 256 MB, and a step some minutes
Floats = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.complex128]


class SphereEuler(FluidSystem):
    """A fluid on the unit sphere, with conversions between matrices, spherical harmonics and grids.

    `coadjoint.systems.matrices.spherical_modes` documents the conventions of modes and matrices. Latitudes and
    longitudes are in radians; rows of a grid go from north to south, and columns from longitude 0 eastward.

    Attributes
    ----------
    rotation : float
        Angular velocity of the frame about the axis z. A state is the *absolute* vorticity, which exceeds the relative
        vorticity in the frame by 2 rotation sin(latitude); modes, grids and spectra are of the relative one.
    planetary : (N, N) array
        The matrix of 2 rotation sin(latitude), -2 rotation S_3.
    scale : float
        Integrals over the sphere are traces over its square.
    """

    def __init__(self, N: int, rotation: float) -> None:
        planetary = -2.0 * rotation * generators(N)[2]
        # of degree 1, where the stream is -1/2
        stream = DiagonalSolve(*laplacian(N), factor=-1.0)
        self._build(N, stream, planetary, 0.5 * planetary, "sphere_euler", rotation, {"rotation": rotation})

    def _build(
        self,
        N: int,
        stream: Any,
        planetary: Matrix,
        linear: Matrix,
        name: str,
        rotation: float,
        parameters: dict[str, Any],
    ) -> None:
        """Build the system of a stream, the vorticity of the frame and minus its stream; `parameters` beside N."""
        self.rotation, self.scale = rotation, scale(N)
        self.energy_unit = self.scale**-2
        self.planetary = planetary
        self.planetary.flags.writeable = False
        MatrixSystem.__init__(
            self,
            MatrixAlgebra("su", N),
            stream,
            energy_sign=-1,
            linear=linear if linear.any() else None,
            name=name,
            parameters={"N": N, **parameters},
        )

    surface = "sphere"
    states_by_name = (*FluidSystem.states_by_name, "rossby_haurwitz", "zonal_jet")

    rossby_haurwitz = sphere_states.rossby_haurwitz
    zonal_jet = sphere_states.zonal_jet

    def mode_array(self, W: Any, *, absolute: bool | None = None) -> Matrix:
        """Return the coefficients of states (..., N, N) as an array, ``[..., l, m]`` with m >= 0; see `modes`."""
        return harmonics_of_matrix(self._shown(W, absolute, "mode_array"))

    def from_modes(self, modes: Any, *, absolute: bool | None = None) -> Matrix:
        """Return the state W of coefficients of orthonormal spherical harmonics in the phase of Condon and Shortley.

        Parameters
        ----------
        modes : mapping or (..., N, N) array
            ``(l, m) -> c``, 0 < l < N; missing ones of -m are ``(-1)^m conj(c)``. Or an array in the form of
            `mode_array`.
        absolute : bool, optional
            Whether the modes are of the absolute vorticity, or of a field that is no vorticity; by default they are of
            the vorticity relative to the frame.

        Returns
        -------
        (..., N, N) array

        Examples
        --------
        >>> s = sphere_euler(N=5)
        >>> modes = s.modes(s.from_modes({(3, 2): 0.5 - 1j}))
        >>> list(modes), bool(abs(modes[3, -2] - (0.5 + 1j)) < 1e-14)
        ([(3, -2), (3, 2)], True)
        """
        return self._state(matrix_of_harmonics(self.read_modes(modes)), absolute, "from_modes")

    def modes(self, W: Any, *, absolute: bool | None = None) -> dict[tuple[int, int], complex]:
        """Return the coefficients of one state by (l, m) that are nonzero beyond round-off.

        They are of the vorticity relative to the frame; with ``absolute=True`` of the absolute one, or of the field
        that a matrix is.
        """
        return as_mapping(harmonics_of_matrix(self._single_matrix(self._shown(W, absolute, "modes"))))

    def _single_matrix(self, matrix: Matrix) -> Matrix:
        if matrix.shape != self.algebra.shape:
            raise ValueError(
                f"W has the shape {matrix.shape}; give one matrix, {self.algebra.shape}, or use mode_array"
            )
        return matrix

    def grid(self, shape: Any = None, points: str = "clenshaw-curtis") -> tuple[Floats, Floats]:
        """Return the latitudes of the rows and the longitudes of the columns of a grid, in radians.

        Parameters
        ----------
        shape : (int, int), optional
            Rows and columns; by default (N + 1, 2 N), the smallest grid that resolves all modes.
        points : {"clenshaw-curtis", "fejer", "gauss-legendre"}
            Rows equally spaced including the poles; equally spaced half a row from the poles; or Gauss-Legendre nodes.

        Returns
        -------
        latitudes, longitudes : 1-d arrays

        Examples
        --------
        >>> latitudes, longitudes = sphere_euler(N=4).grid()
        >>> len(latitudes), len(longitudes), round(float(latitudes[0]), 4)
        (5, 8, 1.5708)
        """
        rows, columns = self._shape(shape)
        return spherical_modes.latitudes(points, rows), spherical_modes.longitudes(columns)

    def _shape(self, shape: Any) -> tuple[int, int]:
        N = self.algebra.N  # by default the smallest grid with poles and an even number of columns for all degrees
        return read_shape(shape, (2, 1), (N + 1, 2 * N))

    def to_grid(
        self, W: Any, shape: Any = None, points: str = "clenshaw-curtis", *, absolute: bool | None = None
    ) -> Floats:
        """Return the values of the vorticity at the points of a grid of any shape, exactly.

        Parameters
        ----------
        W : (..., N, N) array
            States, or other matrices with ``absolute=True``.
        shape, points
            As for `grid`.
        absolute : bool, optional
            Whether to return the absolute vorticity, or the field of other matrices such as a stream function; by
            default the vorticity is relative to the frame.

        Returns
        -------
        (..., rows, columns) array

        Raises
        ------
        MissingPackageError
            ducc0 is not installed.

        Examples
        --------
        >>> s = sphere_euler(N=4)
        >>> s.to_grid(-2 * generators(4)[2], (3, 1))[:, 0].round(12) + 0.0
        array([ 2.,  0., -2.])
        """
        modes = harmonics_of_matrix(self._shown(W, absolute, "to_grid"))
        return spherical_modes.values_of(modes, self._shape(shape), points)

    def velocity(self, W: Any, shape: Any = None, points: str = "clenshaw-curtis") -> tuple[Floats, Floats]:
        """Return the eastward and northward velocity at the points of a grid of any shape, exactly.

        It is relative to the frame, in radii per unit of time: the derivatives ``-d psi/d latitude`` and
        ``d psi/d longitude/cos(latitude)`` of the stream function. At a pole it is along the meridian of each column.

        Parameters
        ----------
        W : (..., N, N) array
            States, or relative vorticities from `relative`.
        shape, points
            As for `grid`.

        Returns
        -------
        u, v : (..., rows, columns) arrays

        Raises
        ------
        MissingPackageError
            ducc0 is not installed.

        Examples
        --------
        >>> s = sphere_euler(N=4)
        >>> u, v = s.velocity(-2 * generators(4)[2], (3, 1))
        >>> u[:, 0].round(12) + 0.0
        array([0., 1., 0.])
        """
        modes = harmonics_of_matrix(self._stream_shown(W))
        return spherical_modes.velocity_of(modes, self._shape(shape), points)

    def from_grid(
        self,
        values: Any,
        points: str = "clenshaw-curtis",
        longitude: float = 0.0,
        *,
        absolute: bool | None = None,
    ) -> Matrix:
        """Return the state of a vorticity given at the points of a grid; the mean is removed.

        Parameters
        ----------
        values : (..., rows, columns) array
            Values on a grid of any shape: degrees that it does not resolve are zero, those from N on are dropped. Exact
            for fields of degrees up to ``rows - 2`` (without poles ``rows - 1``) and orders up to
            ``(columns - 1)/2``; higher ones in the values look like lower ones there (aliases). An `xarray.DataArray`
            is read by its coordinates, latitude and longitude (by name, standard name or units) in any order and
            direction, of any of the kinds of `points`, once around: in degrees or radians by their units; without
            units in degrees if they span more than 2 pi.
        points : str
            As for `grid`.
        longitude : float
            Longitude of the first column, in radians.
        absolute : bool, optional
            Whether the values are of the absolute vorticity, or of a field that is no vorticity; by default they are
            relative to the frame, or what the attributes of an `xarray.DataArray` name: those of datasets of runs, and
            the standard names of CF.

        Returns
        -------
        (..., N, N) array
        """
        first = read_number(longitude, "longitude")
        if is_xarray(values):
            if points != "clenshaw-curtis" or first:
                raise ValueError("values have coordinates, which determine points and longitude; omit these")
            return self._of_labelled(values, absolute)
        return self._state(self._from_values(read_values(values), points, first), absolute, "from_grid")

    def _from_values(self, field: Floats, points: str, longitude: float) -> Matrix:
        return matrix_of_harmonics(spherical_modes.coefficients_of(field, self.algebra.N, points, longitude))

    def from_coordinates(self, values: Any, first: Floats, second: Floats) -> Matrix:
        return matrix_of_harmonics(self.modes_with_mean(values, first, second))

    def read_modes(self, modes: Any) -> Matrix:
        return read_harmonics(modes, self.algebra.N)

    mean_factor = 1 / sqrt(4 * pi)

    def modes_with_mean(self, values: Floats, first: Floats | None = None, second: Floats | None = None) -> Matrix:
        points, start = "clenshaw-curtis", 0.0
        if first is not None and second is not None:
            north, points, east = spherical_modes.grid_orientation(first, second)
            values, start = values[..., ::north, ::east], float(second[::east][0])
        c = spherical_modes.coefficients_of(values, self.algebra.N, points, start)
        c[..., :, 0].imag = 0.0  # round-off
        return c

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return the kinetic energy of the relative motion, of matrices (..., N, N) or of vectors."""
        V = self._moving(x)
        value = 0.5 * self.energy_factor * self.algebra.pairing(self.slope_of(V), V)
        return float(value) if np.ndim(value) == 0 else value

    def _moving(self, x: Any) -> Matrix:
        """Return the part of a state, or of a relative vorticity, that moves relative to the frame."""
        return self.relative(x)

    @property
    def area(self) -> float:
        return 4 * pi

    @property
    def resolved_degree(self) -> int:
        return self.algebra.N - 1

    @cached_property
    def degrees(self) -> npt.NDArray[np.int64]:
        return np.tril(np.broadcast_to(np.arange(self.algebra.N)[:, None], self.algebra.shape))

    @property
    def eigenvalues(self) -> Floats:
        return self.degrees * (self.degrees + 1.0)

    @property
    def squares(self) -> Floats:
        return np.where(self.degrees > 0, np.where(np.arange(self.algebra.N) > 0, 2.0, 1.0), 0.0)

    def random_modes(self, rng: np.random.Generator, last: int) -> Matrix:
        c = np.zeros(self.algebra.shape, dtype=np.complex128)
        for l in range(1, last + 1):
            drawn = rng.standard_normal(2 * l + 1)
            c[l, 0], c[l, 1 : l + 1] = drawn[0], (drawn[1::2] + 1j * drawn[2::2]) / np.sqrt(2)
        return c

    def point_modes(self, places: Floats, strengths: Floats) -> Matrix:
        return spherical_modes.delta_coefficients(places, strengths, self.algebra.N)

    def disc_profile(self, radius: float) -> Floats:
        return spherical_modes.cap_profile(radius, self.algebra.N)[:, None]

    def read_places(self, places: Any, what: str) -> Floats:
        return spherical_modes.read_places(places, what)

    def relative(self, W: Any) -> Matrix:
        if isinstance(W, RelativeVorticity):
            return W
        relative = np.asarray(self.matrices(W) - self.planetary)
        return relative.view(RelativeVorticity) if self.rotation else relative

    def absolute(self, W: Any) -> Matrix:
        return np.asarray(self.matrices(np.asarray(W)) + self.planetary)

    def exact(self, x0: Any, t: Any, attitude: Any = False) -> Matrix:
        """Return the exact motion (N, N) or (k, N, N) of a state at one time or several (k,).

        It is known for zonal flows, and for states of degree 1, about any axis, plus one further degree, such as those
        of `rossby_haurwitz`; other states raise ValueError.
        """
        if self.forces or attitude is not False:
            return super().exact(x0, t, attitude)
        return sphere_states.exact_motion(self.matrices(x0), t, self.rotation)

    def angular_momentum(self, W: Any) -> Floats:
        """Return the angular momentum of the absolute motion, the integral of (x, y, z) omega over the sphere.

        It is constant if the frame does not rotate. Otherwise its component along the axis z is constant, and the
        others rotate westward in the frame with the angular velocity `rotation`.

        Parameters
        ----------
        W : (..., N, N) array
            States.

        Returns
        -------
        (..., 3) array
        """
        return sphere_states.angular_momentum(self.matrices(W))

    @property
    def integrals(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Name to function of states (..., N, N): the constant components of the angular momentum.

        These are all three, or in a rotating frame the one along z; `integrate` records them with
        ``observe=system.integrals``.
        """
        axes = "z" if self.rotation else "xyz"
        return {f"angular momentum {axis}": partial(sphere_states.momentum_along, axis) for axis in axes}


def _unstable_jet() -> Matrix:
    return sphere_euler(48).zonal_jet(band=(0.2, 1.2), perturbation=0.1)


@ready_made(
    gallery_entry=entry_of_fluid(
        _unstable_jet,
        48,
        "An eastward jet is unstable: a small bump grows to waves, which roll up and break into vortices "
        "of both signs. In the middle, the vorticity at the start and at the end. Energy moves to larger and to "
        "smaller scales, and the spectrum of the matrix is constant.",
    )
)
def sphere_euler(N: int = 32, rotation: float = 0.0) -> SphereEuler:
    """Return the Euler equations of an ideal fluid on the sphere for a vorticity matrix: ``W' = [P, W]``, ``L P = -W``.

    W is the vorticity, a matrix in su(N), P the stream matrix, and L the Hoppe-Yau Laplacian. All traces of powers of W
    are preserved, which correspond to the integrals of powers of the vorticity. The time is that of the Euler equations
    on the unit sphere, to which the model converges like 1/N^2.

    Parameters
    ----------
    N : int
        Size of the matrices, from 2 to 4096: spherical harmonics of degrees l < N are resolved.
    rotation : float
        Angular velocity of the frame about the axis through the poles. Then W is the absolute vorticity, and
        ``L P = -(W - F)`` with F the matrix of 2 rotation sin(latitude). Initial states, modes, grids and spectra are
        of the relative vorticity, of W - F.

    Returns
    -------
    SphereEuler
        With `to_grid`, `modes`, initial states. The energy is the kinetic energy of the relative motion, the integral
        of ``|u|^2/2`` over the sphere: tr(V* L^-1 V)/(2 scale^2) of V = W - F. Casimirs tr W^k.

    Notes
    -----
    V. Zeitlin, "Self-consistent finite-mode approximations for the hydrodynamics of an incompressible fluid on
    nonrotating and rotating spheres", Phys. Rev. Lett. 93, 264501 (2004); J. Hoppe and S.-T. Yau, Comm. Math. Phys.
    195, 67 (1998).

    Examples
    --------
    >>> s = sphere_euler(N=16)
    >>> s.shape, list(s.casimirs)[:2]
    ((16, 16), ['tr W^2', 'tr W^3'])
    """
    rate = read_number(rotation, "rotation")
    if abs(rate) > MAX_ROTATION:
        raise ValueError(f"rotation is {rate:g}; give at most {MAX_ROTATION:g} in magnitude")
    return SphereEuler(read_integer(N, "N", 2, MAX_N), rate)
