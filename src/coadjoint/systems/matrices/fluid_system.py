"""Base class of ideal fluids on the sphere and the torus: modes, grids, spectra, initial states, scale separation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.long_operations import warn_caller
from coadjoint.short_repr import short
from coadjoint.systems.gallery_entry import GalleryEntry, Picture
from coadjoint.systems.matrices import initial_states
from coadjoint.systems.matrices.labelled_fields import (
    RELATIVE,
    RELATIVE_VORTICITY,
    STATE,
    STREAM,
    VELOCITY,
    WITHOUT_UNITS,
    kind_of,
    labelled_field,
    units_of,
)
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.validation import check_finite, read_bool, read_integer, read_numbers, to_array

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

MEAN_TOLERANCE = 1e-3
"""Relative to the largest value of a field: a smaller mean may come from the interpolation of another model."""
MAX_GRID_SIZE = 2**16  # rows or columns; a larger grid exceeds any memory


class RelativeVorticity(np.ndarray):
    """Matrices of the vorticity relative to a rotating frame, marked so that the frame is not subtracted again."""

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        # Multiples, sums and differences of relative vorticities are relative; what is computed with others is not.
        operands = () if context is None else context[1][: context[0].nin]
        kept = all(isinstance(one, RelativeVorticity) or np.ndim(one) == 0 for one in operands)
        return array[()] if return_scalar else np.asarray(array).view(RelativeVorticity if kept else np.ndarray)

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        # So are stacks of them.
        found = super().__array_function__(function, types, arguments, options)
        kept = type(found) is np.ndarray and all(issubclass(one, RelativeVorticity) for one in types)
        return found.view(RelativeVorticity) if kept else found


@cache
def _warn_of_frame(name: str) -> None:
    """Warn, once for each name, that the default of `absolute` has changed."""
    warn_caller(
        f"the default of absolute= has changed: {name} of a rotating sphere means the vorticity relative to the frame; "
        "give absolute=False, or absolute=True for the absolute vorticity and for other fields",
        FutureWarning,
    )


class FluidSystem(MatrixSystem):
    """An ideal fluid on a closed surface, with conversions between matrices W, modes of the vorticity and grids.

    The vorticity is positive counterclockwise, seen from outside the sphere, or from above the torus with x to the
    right and y up. A state W is a vorticity in physical units: lengths are those of the unit sphere, or of a torus of
    side 2 pi, and the time of ``W' = [P, W]`` is the time of ``d omega/dt + u . grad omega = 0``.

    On a rotating sphere a state is the absolute vorticity. Fields, modes, files, spectra and the initial states
    (`random`, `blobs`, `patches`, `zonal_jet`, ...) are of the vorticity relative to the frame: what makes a state adds
    the vorticity of the frame, what shows one subtracts it, unless it is of a matrix returned by `relative`. With
    ``absolute=True`` conversions are linear, and apply to the absolute vorticity and to every other scalar field.
    """

    surface: str
    """"sphere" or "torus"."""
    rotation: float = 0.0
    """Angular velocity of the frame."""

    @property
    def has_frame(self) -> bool:
        """Whether states differ from relative vorticities."""
        return bool(self.rotation)

    states_by_name: tuple[str, ...] = ("random", "blobs", "patches", "from_modes", "from_grid", "from_file")
    """Methods that return a state, available by name in configuration files."""

    random = initial_states.random
    blobs = initial_states.blobs
    patches = initial_states.patches
    from_file = initial_states.from_file

    @property
    def fluid(self) -> FluidSystem:
        return self

    @abstractmethod
    def mode_array(self, W: Any, *, absolute: bool | None = None) -> Complexes:
        """Return the modes of states (..., N, N) as an array (..., N, N), which `from_modes` accepts."""
        # On the sphere [l, m], m >= 0, is the coefficient of Y_lm; on the torus [n1, n2] is w_n, both indices mod N.

    @abstractmethod
    def from_modes(self, modes: Any, *, absolute: bool | None = None) -> Complexes:
        """Return the state W of modes, given as a mapping or as an array in the form of `mode_array`."""

    @abstractmethod
    def modes(self, W: Any, *, absolute: bool | None = None) -> dict[tuple[int, int], complex]:
        """Return the modes of one state W that are nonzero beyond round-off."""

    @abstractmethod
    def grid(self, shape: Any = None) -> tuple[Floats, Floats]:
        """Return the two coordinates of the points of a grid, in radians."""

    @abstractmethod
    def to_grid(self, W: Any, shape: Any = None, *, absolute: bool | None = None) -> Floats:
        """Return the values of the field of states (..., N, N) at the points of a grid."""

    @abstractmethod
    def velocity(self, W: Any, shape: Any = None) -> tuple[Floats, Floats]:
        """Return the two components of the velocity of states (..., N, N) relative to the frame, on a grid."""

    def _stream_shown(self, W: Any) -> Complexes:
        """Return the stream matrices of states, or of matrices that `relative` returned."""
        return self.stream_of(self.absolute(W) if isinstance(W, RelativeVorticity) else W)

    @abstractmethod
    def from_grid(self, values: Any, *, absolute: bool | None = None) -> Complexes:
        """Return the state W of the values of a field at the points of a grid; the mean is removed."""

    def states_by_label(self, x: Any, what: str = "x") -> Any:
        """Return labelled states as arrays; raise ValueError for relative vorticities in place of states."""
        if self.has_frame and isinstance(x, RelativeVorticity):
            raise ValueError(
                f"{what} is a vorticity relative to the frame of {self.name}; give the state, by absolute, or the "
                "matrix alone by np.asarray"
            )
        return super().states_by_label(x, what)

    def _shown(self, W: Any, absolute: Any, name: str) -> Complexes:
        """Return the matrices that a conversion of states shows: of the relative vorticity by default."""
        relative = isinstance(W, RelativeVorticity)
        if not self._is_absolute(absolute, name, relative):
            return self.relative(W)
        return self.matrices(np.asarray(W) if relative else W)

    def _state(self, W: Complexes, absolute: Any, name: str) -> Complexes:
        """Return the states of matrices that a conversion has made: of a relative vorticity by default."""
        return W if self._is_absolute(absolute, name) else self.absolute(W)

    def _is_absolute(self, absolute: Any, name: str, clear: bool = False) -> bool:
        """Validate `absolute`, by default False; warn of this default unless it is clear that it is meant."""
        if absolute is not None:
            return read_bool(absolute, "absolute")
        if self.rotation and not clear:
            _warn_of_frame(name)
        return not self.rotation

    def _of_labelled(self, values: Any, absolute: Any) -> Complexes:
        """Return the states of an array of xarray, by its coordinates, and by its attributes if `absolute` is None."""
        kind = kind_of(values) if absolute is None else STATE if read_bool(absolute, "absolute") else RELATIVE
        name, units = str(values.name or "values"), units_of(values)
        if kind == VELOCITY:
            raise ValueError(f"{name} is a component of a velocity; give a vorticity or a stream function")
        if units not in WITHOUT_UNITS:
            raise ValueError(
                f"{name} has the units {short(units)}, and a system has none; give planet= of from_file, or a field of "
                "RotatingPlanet.without_units"
            )
        field = labelled_field(values, self.surface, name)
        try:
            matrix = self.from_coordinates(*field[:3])
        except ValueError as reason:
            raise ValueError(f"{reason}{field.assumed}") from None
        # with absolute=True it may be any field
        if not absolute and (wanted := self._mean_of(kind)) is not None:
            mean = self.modes_with_mean(*field[:3])[..., 0, 0].real * self.mean_factor
            size, excess = np.abs(field.values).max(initial=0.0), np.abs(mean - wanted)
            if excess.max(initial=0.0) > MEAN_TOLERANCE * size:
                worst = float(np.ravel(mean)[excess.argmax()])
                text = (
                    f"{name} has the mean {worst:.6g} and the largest value {size:.6g}, in the units of {self.name}; "
                    f"the mean must be {wanted:g}, and the difference is dropped"
                )
                warn_caller(text, UserWarning)
        if kind == STREAM:
            return self.from_stream(matrix)
        return self._state(matrix, None if kind is None else kind == STATE, "from_grid")

    def from_stream(self, P: Any) -> Complexes:
        """Return the state of a stream function without its mean, given by matrices; inverse of `stream_of`.

        Parameters
        ----------
        P : (..., N, N) array
            Such as ``from_grid(psi, absolute=True)``, ``from_modes(modes, absolute=True)``.

        Returns
        -------
        (..., N, N) array
        """
        inverse: Any = self.stream
        return self.absolute(inverse.inverse(self.matrices(P)))

    @property
    def shown_fields(self) -> dict[str, tuple[str, Callable[[Any], Any], float]]:
        """Name -> long name of a field in datasets, the function from states to its matrices, and its mean."""
        return {"vorticity": (RELATIVE_VORTICITY, self.relative, 0.0)}

    def _mean_of(self, kind: str | None) -> float | None:
        """Return the mean that a labelled field of a kind must have; None if another one is dropped."""
        return None

    @property
    @abstractmethod
    def area(self) -> float:
        """Area of the surface."""

    @property
    @abstractmethod
    def resolved_degree(self) -> int:
        """Largest degree, or wave number, of which every mode is resolved."""

    @property
    @abstractmethod
    def degrees(self) -> npt.NDArray[np.int64]:
        """Degree l, or wave number |n| rounded, of each entry of `mode_array`; 0 for unused entries."""

    @property
    @abstractmethod
    def eigenvalues(self) -> Floats:
        """Eigenvalue of minus the Laplacian for each entry of `mode_array`, l(l + 1) or |n|^2."""

    @property
    @abstractmethod
    def squares(self) -> Floats:
        """Weight of the absolute square of each entry of `mode_array` in the integral of the squared field."""

    @abstractmethod
    def random_modes(self, rng: np.random.Generator, last: int) -> Complexes:
        """Return a mode array of independent standard normal numbers for all degrees up to `last`."""

    @abstractmethod
    def point_modes(self, places: Floats, strengths: Floats) -> Complexes:
        """Return the mode array of a sum of delta functions at points (k, 2) with strengths (k,)."""

    @abstractmethod
    def disc_profile(self, radius: float) -> Floats:
        """Return the factors from the modes of a delta function to those of a disc of value one about its point."""

    @abstractmethod
    def read_places(self, places: Any, what: str) -> Floats:
        """Validate points (k, 2) on the surface."""

    @abstractmethod
    def from_coordinates(self, values: Any, first: Floats, second: Floats) -> Complexes:
        """Return the matrix of values at the points of a grid given by its coordinates, in radians."""

    @abstractmethod
    def read_modes(self, modes: Any) -> Complexes:
        """Validate modes, as for `from_modes`, and return them in the form of `mode_array`."""

    mean_factor: float
    """The mean of a field over its mode 0."""

    @abstractmethod
    def modes_with_mean(self, values: Floats, first: Floats | None = None, second: Floats | None = None) -> Complexes:
        """Return the mode array of values at the points of a grid, by default that of `grid`, with the mode 0."""

    def relative(self, W: Any) -> Complexes:
        """Return the matrix of the vorticity relative to the rotating frame, from a state W or from such a matrix."""
        return np.array(self.matrices(W))

    def absolute(self, W: Any) -> Complexes:
        """Return the state W of a vorticity relative to the rotating frame; inverse of `relative`."""
        return np.array(self.matrices(W))

    def energy_spectrum(self, W: Any, *, absolute: bool = False) -> tuple[npt.NDArray[np.int64], Floats]:
        """Return the kinetic energy of the flow by degree, the integral of |u|^2/2 over the surface.

        Parameters
        ----------
        W : (..., N, N) array
            States, or relative vorticities from `relative`.
        absolute : bool
            Whether the motion is that of the matrices themselves; by default that relative to the rotating frame.

        Returns
        -------
        degrees : (k,) array
            Degrees l on the sphere; wave numbers k on the torus, each with the modes of |n| from k - 1/2 to k + 1/2.
        energy : (..., k) array
        """
        return self.spectrum_of_modes(self.mode_array(W, absolute=absolute), self.energy_weights)

    def enstrophy_spectrum(self, W: Any, *, absolute: bool = False) -> tuple[npt.NDArray[np.int64], Floats]:
        """Return the enstrophy by degree, the integral of omega^2/2 over the surface, as `energy_spectrum`.

        The default is that of the relative vorticity; with ``absolute=True`` its sum is constant.
        """
        return self.spectrum_of_modes(self.mode_array(W, absolute=absolute), 0.5 * self.squares)

    @property
    def energy_weights(self) -> Floats:
        """Weight of the absolute square of each entry of `mode_array` in the kinetic energy."""
        resolved = self.degrees > 0
        return np.where(resolved, 0.5 * self.squares / np.where(resolved, self.eigenvalues, 1.0), 0.0)

    def spectrum_of_modes(self, modes: Complexes, weights: Floats) -> tuple[npt.NDArray[np.int64], Floats]:
        """Return the degrees from 1, and the sums over each of the weighted absolute squares of modes (..., N, N)."""
        degrees = self.degrees.ravel()
        count = int(degrees.max()) + 1
        weighted = weights * (modes.real**2 + modes.imag**2)
        rows = weighted.reshape(-1, degrees.size)
        sums = np.array([np.bincount(degrees, row, count) for row in rows]).reshape(*weighted.shape[:-2], count)
        return np.arange(1, count, dtype=np.int64), np.asarray(sums[..., 1:], dtype=np.float64)


def entry_of_fluid(x0: Callable[[], Any], N: int, caption: str, end: float = 10.0, **parameters: Any) -> GalleryEntry:
    """Return the gallery entry of a fluid whose jets or eddies break up; `parameters` beside N."""
    return GalleryEntry(
        x0=x0,
        t_span=(0.0, end),
        step=0.00625,
        caption=caption,
        pictures=(
            Picture("vorticity", at=0.0),
            Picture("vorticity", at=1.0),
            Picture("field spectra"),
            Picture("eigenvalues"),
        ),
        components=Picture("energy by scale"),
        parameters={"N": N, **parameters},
        save_every=20,
        quantity="vorticity",
    )


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


def read_values(values: Any) -> Floats:
    """Validate real, finite values on a grid, (..., rows, columns)."""
    field = read_numbers(to_array(values, "values"), "values")
    if field.ndim < 2:
        raise ValueError(f"values has the shape {field.shape}; give (..., rows, columns)")
    check_finite(field, "values")
    return field


Matrix = npt.NDArray[Any]


def large_scales(P: Matrix, W: Matrix) -> Matrix:
    """Return the part of W, (..., N, N), that commutes with its stream matrix P: its diagonal in an eigenbasis of P."""
    # In a fluid it is the vorticity averaged along streamlines. With distinct eigenvalues of P it is an orthogonal
    # projection. K. Modin, M. Viviani, J. Fluid Mech. 943 (2022) A36.
    _, V = np.linalg.eigh(-1j * P)
    adjoint = np.conj(np.swapaxes(V, -1, -2))
    diagonal = np.einsum("...ji,...jk,...ki->...i", np.conj(V), W, V, optimize=True)
    return np.asarray((V * (1j * diagonal.imag)[..., None, :]) @ adjoint)
