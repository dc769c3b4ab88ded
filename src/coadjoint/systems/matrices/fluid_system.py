"""What the fluids on sphere and torus have in common: modes, grids, spectra and initial states."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.systems.matrices import initial_states
from coadjoint.systems.matrices.matrix_system import MatrixSystem

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]


class FluidSystem(MatrixSystem):
    """An ideal fluid on a closed surface, with the ways between matrices W, modes of the vorticity and grids.

    The vorticity is counted counterclockwise, seen from outside of the sphere, or from above the torus with x to the
    right and y up. A state W is a vorticity in physical units: lengths are those of the unit sphere, or of a torus of
    side 2 pi, and the time of ``W' = [P, W]`` is the time of ``d omega/dt + u . grad omega = 0``.

    The ways between W, modes and grids are linear, and serve every scalar field. The initial states
    (`random`, `blobs`, `patches`, `zonal_jet`, ...) are those of the vorticity that is seen on the rotating sphere:
    they return ``absolute(W)``.
    """

    states_by_name: tuple[str, ...] = ("random", "blobs", "patches", "from_file")
    """Methods that make a state; configuration files name them."""

    random = initial_states.random
    blobs = initial_states.blobs
    patches = initial_states.patches
    from_file = initial_states.from_file

    @abstractmethod
    def mode_array(self, W: Any) -> Complexes:
        """Return the modes of matrices (..., N, N) as an array (..., N, N), which `from_modes` takes.

        On the sphere its entry [l, m], m >= 0, is the coefficient of Y_lm; on the torus the entry [n1, n2] is w_n, both
        counted mod N.
        """

    @abstractmethod
    def from_modes(self, modes: Any) -> Complexes:
        """Return W of modes, a mapping or an array as `mode_array` returns it."""

    @abstractmethod
    def modes(self, W: Any) -> dict[tuple[int, int], complex]:
        """Return the modes of one matrix W, those that are not zero to round-off."""

    @abstractmethod
    def grid(self, shape: Any = None) -> tuple[Floats, Floats]:
        """Return the two coordinates of the points of a grid, in radians."""

    @abstractmethod
    def to_grid(self, W: Any, shape: Any = None) -> Floats:
        """Return the values of the field of matrices (..., N, N) at the points of a grid."""

    @abstractmethod
    def from_grid(self, values: Any) -> Complexes:
        """Return W of the values of a field at the points of a grid, without its mean."""

    @property
    @abstractmethod
    def area(self) -> float:
        """That of the surface."""

    @property
    @abstractmethod
    def complete_degree(self) -> int:
        """The largest degree, or wave number, of which every mode is resolved."""

    @property
    @abstractmethod
    def degrees(self) -> npt.NDArray[np.int64]:
        """Of each entry of `mode_array` the degree l, or the wave number |n|, rounded; 0 where nothing stands."""

    @property
    @abstractmethod
    def eigenvalues(self) -> Floats:
        """Of each entry of `mode_array` that of minus the Laplacian, l(l + 1) or |n|^2."""

    @property
    @abstractmethod
    def squares(self) -> Floats:
        """Of each entry of `mode_array` what its absolute square adds to the integral of the square of the field."""

    @abstractmethod
    def random_modes(self, rng: np.random.Generator, last: int) -> Complexes:
        """Return a mode array of independent normal numbers of variance one for all degrees up to the last one."""

    @abstractmethod
    def point_modes(self, places: Floats, strengths: Floats) -> Complexes:
        """Return the mode array of a sum of delta functions at places (k, 2) with strengths (k,)."""

    @abstractmethod
    def disc_profile(self, radius: float) -> Floats:
        """Return what multiplies the modes of a delta function to make a disc of value one about its point."""

    @abstractmethod
    def read_places(self, places: Any, what: str) -> Floats:
        """Return places (k, 2) on the surface, checked."""

    @abstractmethod
    def from_coordinates(self, values: Any, first: Floats, second: Floats) -> Complexes:
        """Return W of values at the points of a grid that is told by its coordinates, in radians."""

    def relative(self, W: Any) -> Complexes:
        """Return the matrix of the vorticity that is seen in the rotating frame, from that of the absolute one, W."""
        return np.array(self.matrices(W))

    def absolute(self, W: Any) -> Complexes:
        """Return the state W of a vorticity that is seen in the rotating frame: the inverse of `relative`."""
        return np.array(self.matrices(W))

    def energy_spectrum(self, W: Any) -> tuple[npt.NDArray[np.int64], Floats]:
        """Return the kinetic energy of the flow, degree by degree, the integral of |u|^2/2 over the surface.

        Parameters
        ----------
        W : (..., N, N) array
            States; on the rotating sphere the energy is that of the relative motion.

        Returns
        -------
        degrees : (k,) array
            Degrees l of the sphere; wave numbers of the torus, of which each has the modes with |n| from k - 1/2 to
            k + 1/2.
        energy : (..., k) array
        """
        return self.spectrum_of_modes(self.mode_array(self.relative(W)), self.energy_weights)

    def enstrophy_spectrum(self, W: Any) -> tuple[npt.NDArray[np.int64], Floats]:
        """Return the enstrophy degree by degree, the integral of omega^2/2 over the surface, as `energy_spectrum`."""
        return self.spectrum_of_modes(self.mode_array(self.relative(W)), 0.5 * self.squares)

    @property
    def energy_weights(self) -> Floats:
        """Of each entry of `mode_array` what its absolute square adds to the kinetic energy."""
        inside = self.degrees > 0
        return np.where(inside, 0.5 * self.squares / np.where(inside, self.eigenvalues, 1.0), 0.0)

    def spectrum_of_modes(self, modes: Complexes, weights: Floats) -> tuple[npt.NDArray[np.int64], Floats]:
        """Return degrees from 1 on, and the sums over each of the weighted absolute squares of modes (..., N, N)."""
        number = self.degrees.ravel()
        count = int(number.max()) + 1
        each = weights * (modes.real**2 + modes.imag**2)
        rows = each.reshape(-1, number.size)
        found = np.stack([np.bincount(number, row, count) for row in rows]).reshape(*each.shape[:-2], count)
        return np.arange(1, count, dtype=np.int64), np.asarray(found[..., 1:], dtype=np.float64)
