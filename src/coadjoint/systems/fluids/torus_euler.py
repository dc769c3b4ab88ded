"""Quantized ideal fluids on the torus with the sine bracket: Zeitlin's model."""

from __future__ import annotations

from functools import cached_property
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.algebra.families.matrix_algebra import MatrixAlgebra
from coadjoint.labels import is_xarray
from coadjoint.systems.matrices import torus_modes
from coadjoint.systems.matrices.fluid_system import FluidSystem, entry_of_fluid, read_shape, read_values
from coadjoint.systems.matrices.streams import Circulants
from coadjoint.systems.matrices.torus_modes import matrix_of_modes, modes_of_matrix, read_modes, representatives
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_integer, read_number, read_positive

MAX_N = 1001
Floats = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.complex128]


class TorusEuler(FluidSystem):
    """A fluid on the torus of side 2 pi, with conversions between matrices, Fourier modes and grids.

    The vorticity is ``omega(x, y) = sum of w_n exp(i (n1 x - n2 y))``: with this sign of n2 the equation of the modes
    converges, as N grows, to the Euler equation ``d omega/dt + u . grad omega = 0`` in physical time, with x to the
    right, y up and vorticity positive counterclockwise. W is ``-i N/(4 pi) sum of w_n T_n``.
    """

    surface = "torus"
    states_by_name = (*FluidSystem.states_by_name, "zonal_jet")

    def __init__(self, N: int) -> None:
        self._build(N, stream_of_modes(N, squared_wavenumbers(N)), None, "torus_euler")

    def _build(self, N: int, stream: Circulants, linear: Matrix | None, name: str, **others: Any) -> None:
        """Build the system of a stream and of a constant added to it; `others` are parameters."""
        super().__init__(
            MatrixAlgebra("su", N), stream, linear, energy_sign=-1, name=name, parameters={"N": N, **others}
        )
        self.energy_unit = 64.0 * pi**4 / N**3  # of integrals over the torus

    def zonal_jet(
        self, speed: float = 1.0, *, width: float = 0.3, perturbation: float = 0.01, waves: int = 2
    ) -> Matrix:
        """Return the state of two jets along x, eastward at y = pi/2 and westward at 3 pi/2, slightly perturbed.

        They are Bickley jets, ``speed / cosh(y/width)^2`` with the distance y from the middle, periodic on the torus.

        Parameters
        ----------
        speed : float
            Largest speed.
        width : float
            Width in radians, at most 0.5.
        perturbation : float
            Largest vorticity of the perturbation of both jets, as a fraction of ``speed/width``; with zero the flow is
            steady.
        waves : int
            Number of waves of the perturbation along x.

        Returns
        -------
        (N, N) array

        Examples
        --------
        >>> import coadjoint as co
        >>> s = co.systems.torus_euler(N=65)
        >>> W = s.zonal_jet(perturbation=0.0)
        >>> bool(np.abs(s.vector_field(W)).max() < 1e-12 * np.abs(W).max() ** 2)
        True
        """
        max_speed, thickness = read_positive(speed, "speed"), read_positive(width, "width")
        if thickness > 0.5:
            raise ValueError(f"width is {thickness:g}; give at most 0.5, so that the jets do not overlap")
        fraction = read_number(perturbation, "perturbation")
        along = read_integer(waves, "waves", 1, self.resolved_degree)
        x, y = self.grid((4 * along, max(256, 4 * self.algebra.N)))
        field = np.zeros((len(x), len(y)))
        for sign, middle in ((1, pi / 2), (-1, 3 * pi / 2)):
            for turn in (-2 * pi, 0.0, 2 * pi):
                with np.errstate(
                    over="ignore", invalid="ignore"
                ):  # values that are not finite are reported by from_grid
                    distance = (y - middle + turn) / thickness
                    bell = 1 / np.cosh(distance) ** 2
                    # the vorticity of the speed u along x is -du/dy
                    field += sign * max_speed / thickness * 2 * np.tanh(distance) * bell
                    field += fraction * max_speed / thickness * np.cos(along * x)[:, None] * bell
        return self.from_grid(field)

    def mode_array(self, W: Any, *, absolute: bool | None = None) -> Matrix:
        """Return the modes of matrices (..., N, N) as an array, ``[..., n1 mod N, n2 mod N]``."""
        return modes_of_matrix(self._shown(W, absolute, "mode_array"))

    def from_modes(self, modes: Any, *, absolute: bool | None = None) -> Matrix:
        """Return the matrix W from Fourier modes.

        Parameters
        ----------
        modes : mapping or (..., N, N) array
            ``(n1, n2) -> w``, from -(N - 1)/2 to (N - 1)/2; missing ones are conjugates, or zero. Or an array in the
            form of `mode_array`.
        absolute : bool, optional
            Unused: the torus does not rotate. So in the other conversions.

        Returns
        -------
        (..., N, N) array

        Examples
        --------
        >>> s = torus_euler(N=5)
        >>> bool(abs(s.modes(s.from_modes({(1, 2): 0.5 - 1j}))[-1, -2] - (0.5 + 1j)) < 1e-15)
        True
        """
        W = self.algebra.projected(matrix_of_modes(self.read_modes(modes)))
        return self._state(W, absolute, "from_modes")

    def modes(self, W: Any, *, absolute: bool | None = None) -> dict[tuple[int, int], complex]:
        """Return the modes of a matrix W that are nonzero beyond round-off."""
        N = self.algebra.N
        w = modes_of_matrix(self._shown(W, absolute, "modes"))
        n, size = representatives(N), np.abs(w).max(initial=0.0)
        return {
            (int(n[i]), int(n[j])): complex(round_off(w[i, j], size)) for i, j in np.argwhere(np.abs(w) > 1e-14 * size)
        }

    def grid(self, shape: Any = None) -> tuple[Floats, Floats]:
        """Return x and y of a grid, from 0 to 2 pi without the end point.

        Parameters
        ----------
        shape : (int, int), optional
            Numbers of points along x and y; by default (N, N), the smallest grid that resolves all modes.

        Returns
        -------
        x, y : 1-d arrays

        Examples
        --------
        >>> x, y = torus_euler(N=9).grid((4, 2))
        >>> x / np.pi, y / np.pi
        (array([0. , 0.5, 1. , 1.5]), array([0., 1.]))
        """
        nx, ny = read_shape(shape, (1, 1), self.algebra.shape)
        return torus_modes.coordinates(nx), torus_modes.coordinates(ny)

    def to_grid(self, W: Any, shape: Any = None, *, absolute: bool | None = None) -> Floats:
        """Return the values of the field of matrices at the points of a grid of any shape, exactly.

        Parameters
        ----------
        W : (..., N, N) array
            Matrices, such as states.
        shape : (int, int), optional
            As for `grid`.
        absolute : bool, optional
            Unused, as for `from_modes`.

        Returns
        -------
        (..., nx, ny) array

        Examples
        --------
        >>> s = torus_euler(N=9)
        >>> W = s.from_modes({(0, 1): 0.5j})
        >>> s.to_grid(W, (1, 4)).round(12) + 0.0
        array([[ 0.,  1.,  0., -1.]])
        """
        w = modes_of_matrix(self._shown(W, absolute, "to_grid"))
        return torus_modes.values_of(w, read_shape(shape, (1, 1), self.algebra.shape))

    def velocity(self, W: Any, shape: Any = None) -> tuple[Floats, Floats]:
        """Return the velocity along x and y at the points of a grid of any shape, exactly.

        It is ``-d psi/dy, d psi/dx`` of the stream function.

        Parameters
        ----------
        W : (..., N, N) array
            States, or relative vorticities from `relative`.
        shape : (int, int), optional
            As for `grid`.

        Returns
        -------
        u, v : (..., nx, ny) arrays

        Examples
        --------
        >>> s = torus_euler(N=9)
        >>> u, v = s.velocity(s.from_modes({(0, 1): 0.5j}), (1, 4))
        >>> u.round(12) + 0.0
        array([[ 1.,  0., -1.,  0.]])
        """
        modes = modes_of_matrix(self._stream_shown(W))
        return torus_modes.velocity_of(modes, read_shape(shape, (1, 1), self.algebra.shape))

    def from_grid(self, values: Any, *, absolute: bool | None = None) -> Matrix:
        """Return the matrix of a field given at the points of a grid; the mean is removed.

        Parameters
        ----------
        values : (..., nx, ny) array
            Values on a grid of any shape: modes that it does not resolve are zero, those that N does not resolve are
            dropped. Exact for fields with |n1| < nx/2 and |n2| < ny/2; higher modes in the values look like lower ones
            there (aliases). An `xarray.DataArray` is read by its coordinates, x and y, or eastward and northward as in
            datasets, in any order and direction, once around: in degrees or radians by their units; without units in
            degrees if they span more than 2 pi.
        absolute : bool, optional
            Unused, as for `from_modes`.

        Returns
        -------
        (..., N, N) array
        """
        if is_xarray(values):
            return self._of_labelled(values, absolute)
        # the mean is a multiple of the unit matrix, which is not in the algebra
        W = self.algebra.projected(matrix_of_modes(torus_modes.modes_of(read_values(values), self.algebra.N)))
        return self._state(W, absolute, "from_grid")

    def from_coordinates(self, values: Any, first: Floats, second: Floats) -> Matrix:
        return self.algebra.projected(matrix_of_modes(self.modes_with_mean(values, first, second)))

    def read_modes(self, modes: Any) -> Matrix:
        return read_modes(modes, self.algebra.N)

    mean_factor = 1.0

    def modes_with_mean(self, values: Floats, first: Floats | None = None, second: Floats | None = None) -> Matrix:
        x = y = 1
        if first is not None and second is not None:
            x, y = torus_modes.grid_orientation(first, "x"), torus_modes.grid_orientation(second, "y")
        w = torus_modes.modes_of(values[..., ::x, ::y], self.algebra.N)
        if first is None or second is None:
            return w
        n = representatives(self.algebra.N)
        # shift, since the first point is not at 0
        return np.asarray(w * np.exp(-1j * n * first[::x][0])[:, None] * np.exp(1j * n * second[::y][0]))

    @property
    def area(self) -> float:
        return (2 * pi) ** 2

    @property
    def resolved_degree(self) -> int:
        return self.algebra.N // 2

    @cached_property
    def eigenvalues(self) -> Floats:
        n = representatives(self.algebra.N)
        return (n[:, None] ** 2 + n[None, :] ** 2).astype(float)

    @cached_property
    def degrees(self) -> npt.NDArray[np.int64]:
        return np.rint(np.sqrt(self.eigenvalues)).astype(np.int64)

    @property
    def squares(self) -> Floats:
        return np.where(self.degrees > 0, self.area, 0.0)

    def random_modes(self, rng: np.random.Generator, last: int) -> Matrix:
        n, w = representatives(self.algebra.N), np.zeros(self.algebra.shape, dtype=np.complex128)
        n1, n2 = (grid.ravel() for grid in np.meshgrid(n, n, indexing="ij"))
        degree = self.degrees.ravel()
        chosen = np.flatnonzero(((n1 > 0) | ((n1 == 0) & (n2 > 0))) & (degree <= last))
        chosen = chosen[np.lexsort((n2[chosen], n1[chosen], degree[chosen]))]
        drawn = rng.standard_normal((len(chosen), 2)) / np.sqrt(2)
        w[n1[chosen], n2[chosen]] = drawn[:, 0] + 1j * drawn[:, 1]
        w[-n1[chosen], -n2[chosen]] = drawn[:, 0] - 1j * drawn[:, 1]
        return w

    def point_modes(self, places: Floats, strengths: Floats) -> Matrix:
        return torus_modes.delta_coefficients(places, strengths, self.algebra.N)

    def disc_profile(self, radius: float) -> Floats:
        return torus_modes.disc_profile(radius, np.sqrt(self.eigenvalues))

    def read_places(self, places: Any, what: str) -> Floats:
        return torus_modes.read_places(places, what)


def stream_of_modes(N: int, divisors: Floats) -> Circulants:
    """Return the stream ``psi_n = -w_n/divisor`` from divisors ``[n1 mod N, n2 mod N]``; the mode 0 is dropped."""
    by_mode = -1.0 / divisors
    by_mode[0, 0] = 0.0
    # along the diagonal d = n2 the phase of mode n1 advances by 2 n1 from entry to entry
    spectrum = np.empty((N, N))
    spectrum[:, (2 * np.arange(N)) % N] = by_mode.T
    return Circulants(spectrum)


def squared_wavenumbers(N: int) -> Floats:
    """Return |n|^2 of modes ``[n1 mod N, n2 mod N]``, and 1 for the mode 0."""
    n = representatives(N).astype(float)
    squares = n[:, None] ** 2 + n[None, :] ** 2
    squares[0, 0] = 1.0
    return squares


def round_off(value: complex, size: float) -> complex:
    """Return a number with its parts that are round-off relative to `size` set to zero."""
    real, imaginary = (part if abs(part) > 1e-15 * size else 0.0 for part in (value.real, value.imag))
    return complex(round(real / size, 15) * size, round(imaginary / size, 15) * size)


def _two_jets() -> Matrix:
    return torus_euler(49).zonal_jet(width=0.5, perturbation=0.1)


@ready_made(
    gallery_entry=entry_of_fluid(
        _two_jets,
        49,
        "Two jets, one against the other, meander and roll up into rows of vortices. In the middle, the "
        "vorticity at the start and at the end. The spectrum of the matrix is constant.",
    )
)
def torus_euler(N: int = 33) -> TorusEuler:
    """Return the Euler equations of an ideal fluid on the torus with the sine bracket: ``W' = [P, W]``, ``L P = -W``.

    ``w_n' = sum over m of N/(2 pi) sin(2 pi (m cross n)/N) w_m w_(n-m) / |m|^2`` for the Fourier modes w_n of the
    vorticity, m cross n = m1 n2 - m2 n1, modes counted mod N.
    As N grows it converges to the Euler equation on a torus of side 2 pi, in physical time; `TorusEuler` documents the
    conventions.

    Parameters
    ----------
    N : int
        Size of the matrices, odd, from 3 to 1001: modes n1, n2 from -(N - 1)/2 to (N - 1)/2 are resolved.

    Returns
    -------
    TorusEuler
        With grids, modes and initial states. Energy: the integral of ``|u|^2/2``, ``4 pi^2 sum |w_n|^2 / |n|^2 / 2``.

    Notes
    -----
    D. Fairlie and C. Zachos, Phys. Lett. B 224 (1989) 101; V. Zeitlin, Physica D 49 (1991) 353.

    Examples
    --------
    >>> s = torus_euler(N=9)
    >>> W = s.from_modes({(1, 0): 1.0, (0, 1): 0.5})
    >>> s.shape, bool(np.abs(s.vector_field(W)).max() < 1.0)
    ((9, 9), True)
    """
    N = read_integer(N, "N", 3, MAX_N)
    if N % 2 == 0:
        raise ValueError(f"N is {N}; the sine bracket needs an odd N")
    return TorusEuler(N)
