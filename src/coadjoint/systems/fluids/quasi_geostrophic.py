"""Quasi-geostrophic flows on the sphere and the torus: potential vorticity, deformation radius, topography."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from math import ceil, expm1, log, pi, sqrt
from typing import Any

import numpy as np
import numpy.typing as npt

from coadjoint.long_operations import warn_caller
from coadjoint.memory import check_available_memory
from coadjoint.systems.fluids.sphere_euler import MAX_N, MAX_ROTATION, SphereEuler, sphere_euler
from coadjoint.systems.fluids.torus_euler import TorusEuler, squared_wavenumbers, stream_of_modes, torus_euler
from coadjoint.systems.matrices import sphere_states
from coadjoint.systems.matrices.fluid_system import FluidSystem, RelativeVorticity, entry_of_fluid
from coadjoint.systems.matrices.labelled_fields import (
    BUOYANCY,
    POTENTIAL_VORTICITY,
    RELATIVE,
    STATE,
    STREAM,
    STREAM_FUNCTION,
    kind_of,
)
from coadjoint.systems.matrices.matrix_system import MatrixSystem
from coadjoint.systems.matrices.spherical_modes import generators, laplacian, matrix_of_harmonics
from coadjoint.systems.matrices.streams import DiagonalSolve, HarmonicStream, ScreenedSolve, tridiagonal_product
from coadjoint.systems.matrices.topography import modes_of_rows, plain_rows, topography_rows
from coadjoint.systems.registry import ready_made
from coadjoint.validation import read_choice, read_integer, read_nonnegative, read_number, read_positive

KAPPA_BITS = -24.0, 40.0
"""Binary digits of the range in which the Lagrange multiplier of the energy is searched, well above round-off."""
Floats = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.complex128]


class QuasiGeostrophic(FluidSystem):
    """What the quasi-geostrophic flows on both surfaces share: three fields, of which the state is the first.

    - The **potential vorticity** q is the state W, without its mean, which is that of the planetary term. Conversions
      with ``absolute=True`` show and take matrices as they are, so this field of a state.
    - The **relative vorticity**, the Laplacian of psi: everything that makes or shows a field, by default, as for a
      rotating `sphere_euler`: initial states, modes, grids, files, spectra of kinetic energy, pictures.
    - The **stream function** psi without its mean: ``stream_of(W)`` is its matrix, and `from_stream` the inverse.
    """

    topography: Floats | None
    """Modes of h as rows: two numbers of a mode, real and imaginary part."""
    planetary: Matrix
    """The matrix of q at rest."""
    planetary_mean: float
    """The mean of q."""

    @property
    def has_frame(self) -> bool:
        return True

    @property
    def shown_fields(self) -> dict[str, tuple[str, Callable[[Any], Any], float]]:
        return {
            **super().shown_fields,
            "potential_vorticity": (POTENTIAL_VORTICITY, self.matrices, self.planetary_mean),
            "stream_function": (STREAM_FUNCTION, self.stream_of, 0.0),
        }

    def _mean_of(self, kind: str | None) -> float | None:
        return None if kind == STREAM else self.planetary_mean if kind == STATE else 0.0

    def from_stream(self, P: Any) -> Matrix:
        return np.asarray(self._anomaly(self.matrices(P)) + self.planetary)

    def _anomaly(self, P: Matrix) -> Matrix:
        """Return q without the planetary term, from a stream function."""
        raise NotImplementedError

    def _vorticity(self, V: Matrix) -> Matrix:
        """Return the relative vorticity of q without the planetary term."""
        raise NotImplementedError

    def _stream_of_vorticity(self, W: Matrix) -> Matrix:
        """Return the stream function of a relative vorticity."""
        raise NotImplementedError

    def _is_absolute(self, absolute: Any, name: str, clear: bool = False) -> bool:
        return False if absolute is None else super()._is_absolute(absolute, name, clear)

    def relative(self, W: Any) -> Matrix:
        """Return the matrix of the relative vorticity of states (..., N, N)."""
        if isinstance(W, RelativeVorticity):
            return W
        return self._vorticity(self.matrices(W) - self.planetary).view(RelativeVorticity)

    def absolute(self, W: Any) -> Matrix:
        """Return the state of a relative vorticity, (..., N, N); inverse of `relative`."""
        return self.from_stream(self._stream_of_vorticity(self.matrices(np.asarray(W))))

    def _moving(self, x: Any) -> Matrix:
        return (self.absolute(x) if isinstance(x, RelativeVorticity) else self.matrices(x)) - self.planetary

    def energy(self, x: Any, t: float = 0.0) -> Any:
        """Return the energy of the motion relative to the frame, the integral of minus psi (q - q at rest)/2."""
        V = self._moving(x)
        value = 0.5 * self.energy_factor * self.algebra.pairing(self.slope_of(V), V)
        return float(value) if np.ndim(value) == 0 else value


class SphereQG(QuasiGeostrophic, SphereEuler):
    """A quasi-geostrophic flow on the unit sphere, with conversions between matrices, modes, grids and three fields.

    Grids, modes and states are those of `sphere_euler`; each of them is of the relative vorticity, the Laplacian of
    psi, unless ``absolute=True`` says that it is the potential vorticity q, the state itself. `from_stream` takes a
    stream function.

    Attributes
    ----------
    lamb, gamma, rotation : float
        Lamb's parameter, the squared inverse of a constant deformation radius, and the angular velocity of the frame.
    topography : (k, 4) array or None
        Modes of the height: l, m, real and imaginary part.
    planetary : (N, N) array
        The matrix of q at rest, 2 rotation mu (1 + h) without its mean.
    planetary_mean : float
        That mean, which is also that of q.
    """

    stream: ScreenedSolve
    states_by_name = (*(name for name in SphereEuler.states_by_name if name != "rossby_haurwitz"), "rossby_wave")

    def __init__(self, N: int, lamb: float, rotation: float, topography: Any, gamma: float) -> None:
        self.lamb, self.gamma = lamb, gamma
        fluid = sphere_euler(N)
        self.topography = None if topography is None else topography_rows(topography, fluid)
        modes = {} if self.topography is None else modes_of_rows(self.topography)
        field = 2.0 * rotation * sine_times(fluid.read_modes(modes))
        self.planetary_mean = float(field[0, 0].real) / sqrt(4 * pi)
        planetary = matrix_of_harmonics(field) - 2.0 * rotation * generators(N)[2]
        self._unscreened = DiagonalSolve(*laplacian(N), factor=-1.0)
        stream = ScreenedSolve(N, lamb, gamma)
        parameters = {"lamb": lamb, "rotation": rotation, "topography": plain_rows(self.topography), "gamma": gamma}
        self._build(N, stream, planetary, -stream(planetary), "sphere_qg", rotation, parameters)

    def _screened(self, P: Matrix) -> Matrix:
        """Return ``(gamma + lamb mu^2)`` times psi, of the mean of psi for which that of the product is zero."""
        N = self.algebra.N
        product = tridiagonal_product(*self.stream.screening, P)
        if not self.lamb and not self.gamma:
            return product
        of_one = tridiagonal_product(*self.stream.screening, np.eye(N, dtype=np.complex128))
        mean = np.trace(product, axis1=-2, axis2=-1) / np.trace(of_one)
        return product - mean[..., None, None] * of_one

    def _anomaly(self, P: Matrix) -> Matrix:
        return self._unscreened.inverse(P) - self._screened(P)

    def _vorticity(self, V: Matrix) -> Matrix:
        return V + self._screened(self.slope_of(V))

    def _stream_of_vorticity(self, W: Matrix) -> Matrix:
        return self._unscreened(W)

    def rossby_wave(self, degree: int = 5, order: int = 4, *, wave: float = 1.0, longitude: float = 0.0) -> Matrix:
        """Return the state of a Rossby wave, an exact solution for every N if there is no topography.

        The stream function is a spheroidal harmonic, S(mu) cos(m (phi - c t)), that turns with the angular velocity c
        of `rossby_speed`, at any amplitude; without a deformation radius it is that of a Rossby-Haurwitz wave.

        Parameters
        ----------
        degree, order : int
            n from 1 to N - 1, and m from 1 to n; the wave has n - m zeros between the poles.
        wave : float
            Root mean square of its relative vorticity.
        longitude : float
            Longitude of a maximum of the vorticity in the northern hemisphere, in radians.

        Returns
        -------
        (N, N) array
        """
        n, m = self._read_wave(degree, order)
        vector = self.stream.eigenmodes(m)[1][:, n - m]
        P, i = np.zeros(self.algebra.shape, dtype=np.complex128), np.arange(self.algebra.N - m)
        entries = 1j * vector * np.exp(-1j * m * read_number(longitude, "longitude"))
        P[i, i + m], P[i + m, i] = entries, -np.conj(entries)
        V = self._anomaly(P)
        squared = self.enstrophy_spectrum(self._vorticity(V).view(RelativeVorticity))[1].sum() / (2 * pi)
        size = read_number(wave, "wave") / sqrt(float(squared))
        # Near the north pole the vorticity of entries i v has the sign of v.
        return np.asarray(self.planetary - np.sign(vector[0]) * size * V)

    def rossby_speed(self, degree: int, order: int) -> float:
        """Return the angular velocity in the frame (rad/time, eastward) of the wave of `rossby_wave`.

        It is ``-2 rotation/lambda`` with the eigenvalue lambda of minus the Laplacian plus ``gamma + lamb mu^2``, which
        is ``n (n + 1) + gamma`` for ``lamb = 0`` and else that of spheroidal harmonics, to order 1/N^4. The solid
        rotation n = 1 is steady in the inertial frame if there is no deformation radius.

        Parameters
        ----------
        degree, order : int
            n and m as for `rossby_wave`.

        Returns
        -------
        float

        Examples
        --------
        >>> s = sphere_qg(N=32, lamb=0.0, rotation=3.0, gamma=10.0)
        >>> round(s.rossby_speed(4, 2) * (4 * 5 + 10.0), 12)
        -6.0
        """
        n, m = self._read_wave(degree, order)
        return float(-2.0 * self.rotation / self.stream.eigenmodes(m)[0][n - m])

    def _read_wave(self, degree: Any, order: Any) -> tuple[int, int]:
        n = read_integer(degree, "degree", 1, self.algebra.N - 1)
        if self.topography is not None:
            raise ValueError("a Rossby wave is an exact solution without topography; make the system without it")
        return n, read_integer(order, "order", 1, n)

    def minimum_enstrophy(self, energy: float, angular_momentum: float | None = None) -> Matrix:
        """Return the steady state of the least potential enstrophy, the integral of q^2/2, of an energy.

        It is the state ``q = kappa psi + d`` with the largest kappa, to which selective decay leads. With topography it
        is a flow along the contours of q at rest; without, it is zonal. Of a given angular momentum as well it is
        ``q = kappa psi + alpha mu + d``, zonal.

        Parameters
        ----------
        energy : float
            As `energy` of states returns it, positive.
        angular_momentum : float, optional
            Along the axis of rotation, the integral of mu q, as ``integrals["angular momentum z"]`` of states returns
            it, which is constant if the topography is zonal.

        Returns
        -------
        (N, N) array

        Raises
        ------
        ValueError
            There is no such state: no rotation, or an energy beyond the largest one, above which the least enstrophy is
            that of waves of any phase on this flow; or below the least one of the angular momentum. An angular momentum
            with a topography that is not zonal.

        Notes
        -----
        F. P. Bretherton, D. B. Haidvogel, J. Fluid Mech. 78 (1976) 129.

        Examples
        --------
        >>> import numpy as np
        >>> s = sphere_qg(N=12, lamb=10.0, rotation=2.0, topography={(3, 2): 0.1})
        >>> W = s.minimum_enstrophy(0.01)
        >>> round(s.energy(W), 12), bool(np.abs(s.vector_field(W)).max() < 1e-12)
        (0.01, True)
        """
        wanted, momentum = read_positive(energy, "energy"), angular_momentum
        if momentum is not None:
            momentum = read_number(momentum, "angular_momentum")
            if not self.integrals:
                raise ValueError("the angular momentum is not constant, since the topography is not zonal; omit it")
        lowest = self._lowest_eigenvalue()  # that of a wave, which has no angular momentum
        # kappa + lowest, relative to lowest, from where waves are free to where the flow is almost at rest
        first, last = (bits * log(2.0) for bits in KAPPA_BITS)

        def at(logarithm: float) -> Matrix:
            return self._along_stream(lowest * expm1(logarithm), momentum)

        def excess(logarithm: float) -> float:
            return log(self.energy(at(logarithm)) / wanted)

        least, most = self.energy(at(last)), self.energy(at(first))
        if not least < wanted < most:
            raise ValueError(
                f"energy is {wanted:g}; with this rotation and topography, states of minimum enstrophy "
                + ("" if momentum is None else f"of the angular momentum {momentum:g} ")
                + (f"have energies up to {abs(most):.3g}" if least < wanted else f"have energies above {least:.3g}")
            )
        from scipy.optimize import brentq

        return at(brentq(excess, first, last, xtol=1e-15, rtol=1e-15))

    def _along_stream(self, kappa: float, momentum: float | None) -> Matrix:
        """Return ``q = kappa psi + d``, or with ``+ alpha mu`` of an angular momentum; psi has the mean of states."""
        N = self.algebra.N
        solve, one = DiagonalSolve(self.stream.main + kappa, self.stream.beside), 1j * np.eye(N)
        of_one = solve(one)

        def along(rest: Matrix) -> Matrix:
            P, d = solve(rest), 0.0
            if self.lamb:  # else the mean of P is zero already
                d = float(-kappa * np.trace(P).imag / (N - kappa * np.trace(of_one).imag))
            return np.asarray(kappa * (P - d * of_one) + d * one)

        q = along(self.planetary)
        if momentum is None:
            return q
        sine = -generators(N)[2]
        added = sine - along(sine)
        share = (momentum - sphere_states.momentum_along("z", q)) / sphere_states.momentum_along("z", added)
        return np.asarray(q + share * added)

    def _lowest_eigenvalue(self) -> float:
        """Return the smallest eigenvalue of the inverse of minus the stream, whose matrices have trace zero."""
        N = self.algebra.N
        columns = np.zeros((N, N, N), dtype=np.complex128)
        columns[np.arange(N), np.arange(N), np.arange(N)] = 1j
        zonal = np.diagonal(self.stream(columns), 0, -2, -1).imag
        return float(min(-1.0 / np.linalg.eigvalsh(zonal)[0], self.stream.eigenmodes(1)[0][0]))

    def exact(self, x0: Any, t: Any, attitude: Any = False) -> Matrix:
        """Raise TypeError: no closed form is registered; `rossby_wave` with `rossby_speed` is one."""
        return MatrixSystem.exact(self, x0, t, attitude)

    @property
    def integrals(self) -> Mapping[str, Any]:  # type: ignore[override]
        """Name to function of states (..., N, N): the components of the angular momentum that are constant.

        The component along z is constant if the topography is zonal; all three without deformation radius and rotation.
        """
        if np.count_nonzero(self.planetary - np.diag(np.diagonal(self.planetary))):
            return {}
        axes = "z" if self.rotation or self.lamb else "xyz"
        return {f"angular momentum {axis}": partial(sphere_states.momentum_along, axis) for axis in axes}


def sine_times(c: Matrix) -> Matrix:
    """Return the coefficients (N, N) of mu times a field, with those of their means, to degree N - 1."""
    N = len(c)
    l, m = np.arange(1, N)[:, None], np.arange(N)[None, :]
    beside = np.sqrt(np.maximum(l * l - m * m, 0) / (4.0 * l * l - 1.0))  # between l - 1 and l
    product = np.zeros_like(c)
    product[1:] += beside * c[:-1]
    product[:-1] += beside * c[1:]
    return product


class TorusQG(QuasiGeostrophic, TorusEuler):
    """A quasi-geostrophic flow on the torus of side 2 pi, with conversions between matrices, modes, grids and fields.

    Grids, modes and states are those of `torus_euler`; each of them is of the relative vorticity, the Laplacian of psi,
    unless ``absolute=True`` says that it is the potential vorticity q, the state itself. `from_stream` takes a stream
    function.

    Attributes
    ----------
    gamma : float
        Squared inverse of the deformation radius.
    topography : (k, 4) array or None
        Modes of the topographic potential vorticity: n1, n2, real and imaginary part.
    planetary : (N, N) array
        Its matrix, that of q at rest.
    """

    def __init__(self, N: int, gamma: float, topography: Any) -> None:
        fluid = torus_euler(N)
        self.gamma = gamma
        self.topography = None if topography is None else topography_rows(topography, fluid, "potential vorticity")
        modes = {} if self.topography is None else modes_of_rows(self.topography)
        self.planetary = fluid.from_modes(modes)
        self.planetary.flags.writeable = False
        self.planetary_mean = 0.0
        self._squares = squared_wavenumbers(N)
        self._unscreened: Any = fluid.stream
        stream = stream_of_modes(N, self._squares + gamma)
        linear = -stream(self.planetary) if modes else None
        self._build(N, stream, linear, "torus_qg", gamma=gamma, topography=plain_rows(self.topography))

    def _anomaly(self, P: Matrix) -> Matrix:
        return np.asarray(self._unscreened.inverse(P) - self.gamma * P)

    def _vorticity(self, V: Matrix) -> Matrix:
        return np.asarray(V + self.gamma * self.slope_of(V))

    def _stream_of_vorticity(self, W: Matrix) -> Matrix:
        return np.asarray(self._unscreened(W))


class SurfaceQG(FluidSystem):
    """A surface quasi-geostrophic flow: the state is the buoyancy, and energies by degree are those of `energy`.

    Modes, grids, files and initial states are of the buoyancy q. `stream_of` is psi.
    """

    @property
    def shown_fields(self) -> dict[str, tuple[str, Callable[[Any], Any], float]]:
        return {"buoyancy": (BUOYANCY, self.matrices, 0.0)}

    def _of_labelled(self, values: Any, absolute: Any) -> Matrix:
        if kind_of(values) == RELATIVE:
            raise ValueError(f"{values.name} is a vorticity; surface_qg takes a buoyancy, or a stream function")
        return super()._of_labelled(values, absolute)

    @property
    def energy_weights(self) -> Floats:
        """Weight of the absolute square of each entry of `mode_array` in the energy."""
        resolved = self.degrees > 0
        return np.where(resolved, 0.5 * self.squares / np.sqrt(np.where(resolved, self.eigenvalues, 1.0)), 0.0)


class SphereSurfaceQG(SurfaceQG, SphereEuler):
    """A surface quasi-geostrophic flow on the unit sphere; see `SurfaceQG` and `sphere_euler`."""

    states_by_name = tuple(name for name in SphereEuler.states_by_name if name not in ("rossby_haurwitz", "zonal_jet"))

    def __init__(self, N: int) -> None:
        l = np.arange(N)
        stream = HarmonicStream(np.where(l > 0, -1.0 / np.sqrt(np.maximum(l * (l + 1.0), 1.0)), 0.0))
        zero = np.zeros((N, N), dtype=np.complex128)
        self._build(N, stream, zero, zero, "surface_qg", 0.0, {"surface": "sphere"})

    def exact(self, x0: Any, t: Any, attitude: Any = False) -> Matrix:
        """Raise TypeError: no closed form is known."""
        return MatrixSystem.exact(self, x0, t, attitude)


class TorusSurfaceQG(SurfaceQG, TorusEuler):
    """A surface quasi-geostrophic flow on the torus; see `SurfaceQG` and `torus_euler`."""

    states_by_name = tuple(name for name in TorusEuler.states_by_name if name != "zonal_jet")

    def __init__(self, N: int) -> None:
        self._build(N, stream_of_modes(N, np.sqrt(squared_wavenumbers(N))), None, "surface_qg", surface="torus")


RANGES = ((4.0, 3.0, 0.1, 0.0), (2.0, 1.0, 0.05, 0.05))
"""Modes of the mountains of the example."""


def _eddies_over_mountains() -> Matrix:
    return sphere_qg(48, 100.0, 5.0, RANGES).random(seed=3, degrees=(2, 8))


def _two_jets_with_screening() -> Matrix:
    return torus_qg(49, 9.0).zonal_jet(width=0.5, perturbation=0.1)


def _random_buoyancy() -> Matrix:
    return surface_qg(49, "torus").random(seed=3, degrees=(2, 5))


@ready_made(
    gallery_entry=entry_of_fluid(
        _eddies_over_mountains,
        48,
        "Eddies on a rotating planet with mountains, whose deformation radius at the poles is a tenth of its own. In "
        "the middle, the relative vorticity at the start and at the end. The spectrum of the potential vorticity is "
        "constant.",
        lamb=100.0,
        rotation=5.0,
        topography=RANGES,
    )
)
def sphere_qg(
    N: int = 32, lamb: float = 0.0, rotation: float = 0.0, topography: Any = None, gamma: float = 0.0
) -> SphereQG:
    """Return quasi-geostrophic flow on the sphere: ``q_t + {psi, q} = 0`` for a potential vorticity matrix.

    ``q = (Laplacian - gamma - lamb mu^2) psi + 2 rotation mu (1 + h)`` with mu = sin(latitude). Choose it for the flow
    of an atmosphere or ocean whose deformation radius is that of the local Coriolis parameter, without a beta plane;
    `sphere_euler` is its limit of an infinite radius. The state is q without its mean; all traces of its powers are
    preserved. Initial states, modes, grids, spectra and pictures are of the relative vorticity, the Laplacian of psi.

    Parameters
    ----------
    N : int
        Size of the matrices, from 3 to 4096: spherical harmonics of degrees l < N are resolved.
    lamb : float
        Lamb's parameter, 4 Omega^2 a^2/(g H) of a planet of radius a that turns with Omega, for a fluid of depth H:
        the deformation radius at the latitude theta is ``1/(sqrt(lamb) |sin theta|)`` radii. Not negative. A warning
        names an N that resolves the radius at the poles, if N does not.
    rotation : float
        Angular velocity of the frame about the axis through the poles, in the unit of time of the run: 2 pi if this is
        a day, and 1/(2 Ro) for a Rossby number Ro = U/(2 Omega a) and the time a/U.
    topography : optional
        The height h of the ground divided by the mean depth: a function of latitude and longitude in radians; modes
        ``{(l, m): c}`` as for `SphereEuler.from_modes`, or rows [l, m, real, imaginary]; values on the default grid of
        `sphere_euler`; an `xarray.DataArray` with coordinates; the path of a NetCDF file. A mean is dropped with a
        warning.
    gamma : float
        Squared inverse of a deformation radius that is constant, in place of or beside `lamb`. Not negative.

    Returns
    -------
    SphereQG
        The energy is that of the relative motion, the integral of ``(|u|^2 + (gamma + lamb mu^2) psi^2)/2``.

    Raises
    ------
    TypeError, ValueError
        A negative parameter, or a `lamb` beyond N^4, for which the matrices are too small; a topography without
        coordinates, in metres, or with NaN, which is named with its place.
    MissingPackageError
        ducc0 is needed for a topography on a grid and is not installed.

    Notes
    -----
    The mean of q is that of its planetary term, so the mean of psi is that for which the product
    ``(gamma + lamb mu^2) psi`` has the mean zero. mu^2 psi is quantized to order 1/N^4 by a matrix that is tridiagonal
    on each diagonal, so a step costs what it costs in `sphere_euler`.

    W. T. M. Verkley, J. Atmos. Sci. 66 (2009) 1735; W. H. Schubert, R. K. Taft, L. G. Silvers, J. Adv. Model. Earth
    Syst. 1 (2009) 2; A. Franken, M. Caliaro, P. Cifani, B. Geurts, arXiv:2306.15481.

    Examples
    --------
    >>> import coadjoint as co
    >>> s = sphere_qg(N=16, lamb=10.0, rotation=2.0, topography={(3, 2): 0.05})
    >>> sol = co.integrate(s, s.random(1), (0, 1), 0.05, co.IsospectralGauss())
    >>> bool(abs(s.spectrum(sol.x[-1]) - s.spectrum(sol.x[0])).max() < 1e-12)
    True
    """
    size = read_integer(N, "N", 3, MAX_N)
    of_latitude, constant = read_nonnegative(lamb, "lamb"), read_nonnegative(gamma, "gamma")
    rate = read_number(rotation, "rotation")
    if abs(rate) > MAX_ROTATION:
        raise ValueError(f"rotation is {rate:g}; give at most {MAX_ROTATION:g} in magnitude")
    smallest = of_latitude + constant
    _warn_unless_resolved(smallest, size - 1, size, ceil(sqrt(smallest)) + 1)
    return SphereQG(size, of_latitude, rate, topography, constant)


@ready_made(
    gallery_entry=entry_of_fluid(
        _two_jets_with_screening,
        49,
        "Two jets, one against the other, on a plane with a deformation radius of a third of the unit of length, which "
        "holds them together: without it they roll up. In the middle, the relative vorticity at the start and at the "
        "end. The spectrum of the potential vorticity is constant.",
        gamma=9.0,
    )
)
def torus_qg(N: int = 33, gamma: float = 0.0, topography: Any = None) -> TorusQG:
    """Return quasi-geostrophic flow on the torus with the sine bracket: ``q_t + {psi, q} = 0``.

    ``q = (Laplacian - gamma) psi + eta``. The beta effect is a force, ``co.forces.BetaPlane(beta)``, that acts on psi
    of this system, with the exact dispersion. The state is q; initial states, modes, grids, spectra and pictures are of
    the relative vorticity, the Laplacian of psi.

    Parameters
    ----------
    N : int
        Size of the matrices, odd, as for `torus_euler`.
    gamma : float
        Squared inverse of the deformation radius, not negative, in units of the torus of side 2 pi.
    topography : optional
        The topographic potential vorticity eta, f0 times the height divided by the mean depth: a function of x and y in
        radians; modes ``{(n1, n2): w}`` or rows [n1, n2, real, imaginary]; values on the default grid of `torus_euler`;
        an `xarray.DataArray` with coordinates; the path of a NetCDF file. A mean is dropped with a warning.

    Returns
    -------
    TorusQG
        The energy is the integral of ``(|u|^2 + gamma psi^2)/2``.

    Raises
    ------
    TypeError, ValueError
        As for `sphere_qg`.

    Examples
    --------
    A Rossby wave has the frequency ``-beta n1/(|n|^2 + gamma)``:

    >>> import coadjoint as co
    >>> import numpy as np
    >>> s = torus_qg(N=9, gamma=3.0)
    >>> sol = co.integrate(
    ...     s.with_forces(co.forces.BetaPlane(2.0)), s.from_modes({(1, 2): 1.0}), (0, 3), 0.25, co.IsospectralGauss()
    ... )
    >>> bool(abs(s.modes(sol.x[-1])[1, 2] - np.exp(2j * 3 / 8)) < 1e-13)
    True
    """
    size = torus_euler(N).algebra.N
    constant = read_nonnegative(gamma, "gamma")
    _warn_unless_resolved(constant, size // 2, size, 2 * ceil(sqrt(constant)) + 1)
    return TorusQG(size, constant, topography)


@ready_made(
    gallery_entry=entry_of_fluid(
        _random_buoyancy,
        49,
        "Random buoyancy at a surface is drawn out into fronts. In the middle, the buoyancy at the start and at the "
        "end. Its distribution over area, the spectrum of the matrix, is constant.",
        end=2.5,
        surface="torus",
    )
)
def surface_qg(N: int = 32, surface: str = "sphere") -> SphereSurfaceQG | TorusSurfaceQG:
    """Return surface quasi-geostrophic flow: ``q_t + {psi, q} = 0`` with ``psi = -(-Laplacian)^(-1/2) q``.

    The buoyancy q at the surface of a deep rotating fluid is carried by the flow that it induces; warm air turns
    counterclockwise. Fronts form faster than in `sphere_euler`. All traces of powers of q are preserved.

    Parameters
    ----------
    N : int
        Size of the matrices, as for `sphere_euler` and `torus_euler`.
    surface : {"sphere", "torus"}
        Surface of the fluid. On the sphere the stream needs N^3/6 numbers of memory.

    Returns
    -------
    SurfaceQG
        Initial states, modes and grids are of q. The energy is the integral of ``-psi q/2``, by degree in
        `energy_spectrum`.

    Notes
    -----
    I. M. Held, R. T. Pierrehumbert, S. T. Garner, K. L. Swanson, J. Fluid Mech. 282 (1995) 1.

    Examples
    --------
    >>> s = surface_qg(N=9, surface="torus")
    >>> W = s.from_modes({(3, 4): 1.0})
    >>> round(s.energy(W) / (0.5 * s.area * 2 / 5), 12)
    1.0
    """
    if read_choice(surface, "surface", ("sphere", "torus")) == "torus":
        return TorusSurfaceQG(torus_euler(N).algebra.N)
    size = read_integer(N, "N", 2, MAX_N)
    check_available_memory(8 * size**3 // 6, f"the stream of surface_qg for N = {size}")
    return SphereSurfaceQG(size)


def _warn_unless_resolved(squared: float, degree: int, N: int, needed: int) -> None:
    """Warn if the deformation radius, of this inverse square, is smaller than the scale of the largest degree."""
    if squared > degree**2:
        warn_caller(
            f"the smallest deformation radius is {1 / sqrt(squared):.3g}, and N = {N} resolves scales down to "
            f"{1 / degree:.3g}; N = {needed} resolves it",
            UserWarning,
        )
